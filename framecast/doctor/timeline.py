"""From frame to frame: cuts, frames left out or repeated, exposure that changes; and borders that hold no picture."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from framecast.doctor.motion import Reading, Shifts, displacement, resampled
from framecast.doctor.probe import pair_of, pick_points, sample
from framecast.doctor.take import Take

BRIGHT = -0.7
"""Value of a comparable image from which on a factor on the light is a step of nearly its logarithm."""


@dataclass(frozen=True)
class Step:
    """One frame against the one before."""

    frame: int
    likeness: float
    """Correlation of the two pictures along the vectors."""
    standing: float
    """Correlation of the two pictures as they are."""
    gain: float
    """Natural logarithm of the factor on the brightness."""
    unevenness: float
    """How much that differs between parts of the picture (median deviation)."""
    change: float
    """Mean difference of the two pictures as they are; 0: the same picture twice."""


def steps_of(take: Take, reading: Reading, shifts: Shifts | None) -> list[Step]:
    """Every frame that is said to follow another one, whatever the vectors' direction."""
    return [step for t in take.pairs if (step := step_of(take, t, reading, shifts)) is not None]


def step_of(take: Take, t: int, reading: Reading, shifts: Shifts | None) -> Step | None:
    """Frame `t` against the one before; None without texture."""
    image, other = take.images[t].astype(np.float32), take.images[t - 1].astype(np.float32)
    everywhere = np.ones(take.size, bool)
    points = pick_points(image, everywhere, 3000, t)
    if len(points) < 50:
        return None
    pair = pair_of([image, other], 0, 1, points)
    v = np.zeros((2, len(points)), np.float32)
    source = t - reading.offset
    if "motion" in take.stored[t] and 0 <= source < len(take.stored) and "motion" in take.stored[source]:
        stored = take.stored[source]["motion"]
        own = (stored.shape[1], stored.shape[2])
        row = ((points // take.size[1] + 0.5) * own[0] / take.size[0]).astype(int)
        column = ((points % take.size[1] + 0.5) * own[1] / take.size[1]).astype(int)
        v = displacement(stored[:, row, column], reading.motion, take.size, own) * np.float32(take.stretch)
        v = -v if "next" in reading.motion.direction else v
    dx, dy = (shifts or {}).get((t, t - 1), (0.0, 0.0))
    along = sample(pair.other, pair.x + v[0] + dx, pair.y + v[1] + dy)
    still = sample(pair.other, pair.x, pair.y)
    ratio = (pair.value - along).mean(0)
    lit = pair.value.mean(0) > BRIGHT
    gain = float(np.median(ratio[lit])) if lit.sum() > 50 else 0.0
    blocks = [
        np.median(ratio[lit & (pair.block == b)])
        for b in np.unique(pair.block[lit])
        if (lit & (pair.block == b)).sum() > 15
    ]
    return Step(
        t, _likeness(pair.value, along), _likeness(pair.value, still), gain,
        float(np.median(np.abs(np.array(blocks) - gain))) if len(blocks) > 3 else np.inf,
        float(np.abs(image - other).mean()),
    )  # fmt: skip


def _likeness(a: np.ndarray, b: np.ndarray) -> float:
    """Correlation over points and channels."""
    a, b = a - a.mean(), b - b.mean()
    return float((a * b).mean() / max(np.sqrt((a * a).mean() * (b * b).mean()), 1e-9))


def cuts(steps: Sequence[Step]) -> list[int]:
    """Frames that show something else than the frames before, although nothing says so."""
    best = {s.frame: max(s.likeness, s.standing) for s in steps}
    usual = float(np.median(list(best.values()))) if best else 0.0
    return [t for t, likeness in best.items() if likeness < 0.5 and likeness < usual - 0.3]


def repeats(steps: Sequence[Step]) -> list[int]:
    """Frames that are the one before once more, while the others change."""
    usual = float(np.median([s.change for s in steps])) if steps else 0.0
    return [s.frame for s in steps if s.change < 0.02 * usual and usual > 1e-3]


def skips(scales: Mapping[int, float]) -> list[int]:
    """Frames before which the picture moves at least one and a half times as far as the vectors, unlike the others."""
    usual = float(np.median(list(scales.values()))) if scales else 1.0
    return [t for t, scale in scales.items() if scale > 1.55 and scale > 1.5 * usual]


@dataclass(frozen=True)
class Exposure:
    """How the brightness of the whole picture changes."""

    gains: Mapping[int, float]
    """Logarithm of the factor against the frame before, of frames whose parts agree about it."""
    expected: Mapping[int, float]
    """What the recorded exposures say."""
    even: float
    """Share of the frames whose parts agree."""

    @property
    def swing(self) -> float:
        """Median size of the gains."""
        return float(np.median(np.abs(list(self.gains.values())))) if self.gains else 0.0

    @property
    def unexplained(self) -> float:
        """Median size of what the recorded exposures leave."""
        left = [abs(g - self.expected[t]) for t, g in self.gains.items()]
        return float(np.median(left)) if left else 0.0


def exposure_of(take: Take, steps: Sequence[Step]) -> Exposure:
    """Gains that are the same all over the picture: light that moves or fades is not."""
    agreed = {s.frame: s.gain for s in steps if s.unevenness < max(0.3 * abs(s.gain), 0.01) and s.likeness > 0.4}
    told = {
        t: float(np.log(max(take.records[t].exposure, 1e-9) / max(take.records[t - 1].exposure, 1e-9))) for t in agreed
    }
    return Exposure(agreed, told, len(agreed) / max(len(steps), 1))


def padding(take: Take) -> tuple[int, int]:
    """Columns at the right and rows at the bottom that hold one and the same colour in all frames looked at."""
    columns, rows = [], []
    for image in take.images[:: max(1, len(take.images) // 4)]:
        flat = np.asarray(image, np.float32)
        columns.append(_flat_end(flat))
        rows.append(_flat_end(flat.transpose(0, 2, 1)))
    right, below = min(columns), min(rows)
    height, width = take.size
    # The image was smoothed, so that the line beside the padding is mixed with it.
    return (right + 1 if 0 < right < width // 4 else 0), (below + 1 if 0 < below < height // 4 else 0)


def _flat_end(image: np.ndarray) -> int:
    """Columns at the end that are constant and equal to the last one, in an image that is not flat elsewhere."""
    same = np.abs(image - image[:, :1, -1:]).max((0, 1)) < 1e-3
    if same.all():
        return 0
    return int(np.argmin(same[::-1]))


__all__ = ["Exposure", "Step", "cuts", "exposure_of", "padding", "repeats", "resampled", "skips", "steps_of"]
