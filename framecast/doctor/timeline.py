"""From frame to frame: cuts, frames left out or repeated, exposure that changes; and borders that hold no picture."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from framecast.doctor.follow import Step
from framecast.doctor.take import Take

PLAIN = 0.02
"""Share of the picture from which on a colour is that of a background."""


def cuts(steps: Sequence[Step]) -> list[int]:
    """Frames that show something else than the frames before, although nothing says so."""
    best = {s.frame: max(s.likeness, s.standing) for s in steps}
    usual = float(np.median(list(best.values()))) if best else 0.0
    return [t for t, likeness in best.items() if likeness < 0.5 and likeness < usual - 0.3]


def repeats(steps: Sequence[Step]) -> list[int]:
    """Frames that are the one before once more, while the others change."""
    usual = float(np.median([s.change for s in steps])) if steps else 0.0
    return [s.frame for s in steps if s.change < 0.02 * usual and usual > 1e-3]


def skips(steps: Sequence[Step]) -> dict[int, float]:
    """Frames before which the picture moves at least one and a half times as far as the vectors, unlike the others, and
    how far."""
    factors = {s.frame: s.factor for s in steps if s.factor is not None}
    usual = float(np.median(list(factors.values()))) if factors else 1.0
    return {t: factor for t, factor in factors.items() if factor > 1.55 and factor > 1.5 * usual}


def reversals(steps: Sequence[Step]) -> dict[int, int]:
    """Frames that the vectors explain better when they are turned around, unlike most, and whose vectors those are."""
    turned = {s.frame: s.source for s in steps if s.turned < 0.75}
    return turned if len(turned) <= len(steps) // 3 else {}


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
    """Columns at the right and rows at the bottom that hold one and the same colour in all frames looked at, a colour
    that is rare elsewhere: a thing before a plain background has some of it on every side."""
    columns, rows = [], []
    for image in take.images[:: max(1, len(take.images) // 4)]:
        flat = np.asarray(image, np.float32)
        columns.append(_flat_end(flat))
        rows.append(_flat_end(flat.transpose(0, 2, 1)))
    right, below = min(columns), min(rows)
    height, width = take.size
    first = take.images[0]
    elsewhere = np.abs(first - first[:, -1:, -1:]).max(0)[: height - below - 1, : width - right - 1] < 1e-3
    if elsewhere.mean() > PLAIN:
        return 0, 0
    # The image was smoothed, so that the line beside the padding is mixed with it.
    return (right + 1 if 0 < right < width // 4 else 0), (below + 1 if 0 < below < height // 4 else 0)


def _flat_end(image: np.ndarray) -> int:
    """Columns at the end that are constant and equal to the last one, in an image that is not flat elsewhere."""
    same = np.abs(image - image[:, :1, -1:]).max((0, 1)) < 1e-3
    if same.all():
        return 0
    return int(np.argmin(same[::-1]))
