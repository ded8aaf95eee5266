"""Do the vectors hold what the camera does? Pixels without a vector, and whether the picture moves there."""

from dataclasses import dataclass, replace

import numpy as np
import torch

from framecast.doctor.motion import Scene, at_points, resampled
from framecast.doctor.probe import POINTS, Pair, fit_shift, misfit, pair_of, pick_points, sample, textured, votes
from framecast.doctor.take import Take
from framecast.frame import SKY, Frame, camera_motion

EMPTY_SHARE = 0.02
"""Share of the picture that has to be without vectors for a verdict."""


@dataclass(frozen=True)
class Blanks:
    """Pixels without vectors whose picture moves."""

    share: float
    """Of the picture, surfaces and background."""
    surfaces: float
    """Share of the picture that is surface, not background, and without vectors."""
    still: float
    """Error of taking them as not moving, and of letting a camera move them."""
    moved: float
    votes: float
    code: float
    """What is stored there."""
    fields: tuple[np.ndarray, ...]
    """What the camera does in the points of each pair of a scene, `2 n`."""

    @property
    def found(self) -> bool:
        """Whether a moving camera explains those pixels beyond doubt."""
        return self.votes >= 4 and self.still > 1.04 * self.moved


def blank(stored: np.ndarray) -> tuple[np.ndarray, float]:
    """Pixels that hold exactly the most usual number in all channels, and that number; none where it is rare."""
    values, counts = np.unique(stored[0], return_counts=True)
    code = values[np.argmax(counts)]
    same = (stored == code).all(0)
    return (same, float(code)) if same.mean() >= EMPTY_SHARE else (np.zeros_like(same), float(code))


def blanks_of(take: Take, scene: Scene) -> Blanks | None:
    """What becomes of pixels without vectors; None where there are too few of them, or too little texture on them."""
    still, moved, blocks, fields, shares, surfaces, code = [], [], [], [], [], [], 0.0
    for k, before in enumerate(scene.pairs):
        empty, code = blank(take.stored[before.here]["motion"])
        empty = resampled(empty, take.size)
        shares.append(empty.mean())
        solid = empty & ~background(take, before.here)
        surfaces.append(solid.mean())
        image = take.images[before.here].astype(np.float32)
        points = pick_points(textured(image), solid if solid.mean() > EMPTY_SHARE else empty, POINTS // 2, k)
        if len(points) < 200:
            continue
        pair = replace(
            pair_of([image, take.images[before.there].astype(np.float32)], 0, 1, points),
            here=before.here, there=before.there,
        )  # fmt: skip
        field = recorded_field(take, pair, points)
        everywhere = recorded_field(take, before, scene.points[k])
        if field is None or everywhere is None:
            model = fit_camera(pair)
            field = polynomial(pair.x, pair.y, take.size) @ model
            everywhere = polynomial(before.x, before.y, take.size) @ model
            field, everywhere = field.T, everywhere.T
        zero = np.zeros_like(pair.x)
        shift = fit_shift(pair, zero, zero)
        rest = fit_shift(pair, field[0], field[1])
        apart = np.hypot(field[0] + rest[0] - shift[0], field[1] + rest[1] - shift[1]) > 0.3
        still.append(misfit(pair, zero + shift[0], zero + shift[1])[apart])
        moved.append(misfit(pair, field[0] + rest[0], field[1] + rest[1])[apart])
        blocks.append((pair.block + k * 100)[apart])
        fields.append(everywhere.astype(np.float32))
    if len(still) < max(1, len(scene.pairs) // 2):
        return None
    a, b = np.concatenate(still), np.concatenate(moved)
    if len(a) < 200:
        return None
    sure = votes(b, a, np.concatenate(blocks))
    complete = tuple(fields) if len(fields) == len(scene.pairs) else ()
    return Blanks(
        float(np.mean(shares)), float(np.mean(surfaces)), float(a.mean()), float(b.mean()), float(sure), code, complete
    )


def background(take: Take, t: int) -> np.ndarray:
    """Pixels whose stored depth is the one of the sky: the extreme that more than a hundredth of the picture holds."""
    depth = take.stored[t].get("depth")
    if depth is None:
        return np.zeros(take.size, bool)
    return resampled(sky_of(depth[0]), take.size)


def sky_of(depth: np.ndarray) -> np.ndarray:
    """Pixels that hold exactly the largest or exactly the smallest number, where it is that of a background."""
    out = np.zeros(depth.shape, bool)
    finite = np.nan_to_num(depth.astype(np.float32), nan=0, posinf=3e38, neginf=0)
    for extreme in (finite.max(), finite.min()):
        same = finite == extreme
        if same.mean() > 0.005 and (extreme in (0.0, 1.0) or abs(extreme) >= SKY * 0.99):
            out |= same
    return out


def recorded_field(take: Take, pair: Pair, points: np.ndarray) -> np.ndarray | None:
    """What the recorded cameras do in points, from depth as it stands; None without cameras or depth."""
    here, there = take.records[pair.here], take.records[pair.there]
    depth = take.stored[pair.here].get("depth")
    if depth is None or "cameras" not in take.recorded or here.view is None or there.view is None:
        return None
    near = resampled(np.clip(np.nan_to_num(depth[0].astype(np.float32), nan=SKY), 1e-6, SKY), take.size)

    def frame(record_view: object, projection: object) -> Frame:
        return Frame(
            depth=torch.from_numpy(np.ascontiguousarray(near))[None, None],
            view=torch.tensor([record_view]), projection=torch.tensor([projection]),
            jitter=torch.zeros(1, 2), time=torch.zeros(1), reset=torch.zeros(1, dtype=torch.bool), span=torch.ones(1),
        )  # fmt: skip

    motion = camera_motion(frame(here.view, here.projection), frame(there.view, there.projection))[0].numpy()
    return at_points(motion, points, take.size)


def polynomial(x: np.ndarray, y: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """1, x, y, x², xy, y² of positions, the image being 2 wide: `n 6`."""
    u, v = 2 * x / size[1] - 1, (2 * y - size[0]) / size[1]
    return np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], 1)


def fit_camera(pair: Pair, steps: int = 12) -> np.ndarray:
    """Coefficients `6 2` of the smooth displacement that makes both frames agree best, from a rough first guess on."""
    height, width = pair.other.shape[1:]
    basis = polynomial(pair.x, pair.y, (height, width))
    model = np.zeros((6, 2))
    model[0] = rough_shift(pair)
    for step in range(steps):
        d = basis @ model
        error = pair.value - sample(pair.other, pair.x + d[:, 0], pair.y + d[:, 1])
        error = error - np.median(error)
        spread = 2 * np.median(np.abs(error)) + 1e-6
        weight = 1 / (1 + (error / spread) ** 2) ** 2
        used = basis if step > 3 else basis[:, :3]
        n = used.shape[1]
        jacobian = np.concatenate([pair.slope_x[:, :, None] * used, pair.slope_y[:, :, None] * used], 2)
        normal = np.einsum("cni,cn,cnj->ij", jacobian, weight, jacobian)
        right = np.einsum("cni,cn,cn->i", jacobian, weight, error)
        change = np.linalg.solve(normal + 1e-6 * np.trace(normal) * np.eye(2 * n), right)
        model[:n] += np.clip(change.reshape(2, n).T, -3, 3)
    return model


def rough_shift(pair: Pair, reach: int = 24) -> np.ndarray:
    """The whole-pixel shift, up to `reach`, with which most points agree; searched coarse to fine."""
    best = np.zeros(2)
    for step in (8.0, 3.0, 1.0):
        offsets = np.arange(-3, 4) * step
        trials = [best + np.array([dx, dy]) for dx in offsets for dy in offsets]
        some = slice(None, None, max(1, len(pair.x) // 800))
        errors = [
            np.minimum(
                np.abs(pair.value[:, some] - sample(pair.other, pair.x[some] + t[0], pair.y[some] + t[1])), 0.5
            ).mean()
            for t in trials
        ]
        best = np.clip(trials[int(np.argmin(errors))], -reach, reach)
    return best
