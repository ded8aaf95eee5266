"""Do the vectors hold what the camera does? Pixels without a vector, and whether the picture moves there."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from framecast.doctor.motion import Scene, at_points, resampled
from framecast.doctor.probe import POINTS, Pair, fit_shift, misfit, pair_of, pick_points, sample, thinned, votes
from framecast.doctor.take import Take
from framecast.frame import SKY

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
    depth: str
    """The one of `DEPTHS` with which recorded cameras say so; empty where it was fitted to the pictures, light that
    moves included."""

    @property
    def found(self) -> bool:
        """Whether a moving camera explains those pixels beyond doubt."""
        return self.votes >= 4 and self.still > (1.04 if self.depth else 1.18) * self.moved


def blank(stored: np.ndarray) -> tuple[np.ndarray, float]:
    """Pixels that hold exactly the most usual number in all channels, and that number; none where it is rare."""
    some = thinned(stored.shape[1])
    values, counts = np.unique(stored[0, some, some], return_counts=True)
    code = values[np.argmax(counts)]
    same = (stored == code).all(0)
    return (same, float(code)) if same.mean() >= EMPTY_SHARE else (np.zeros_like(same), float(code))


def blanks_of(take: Take, scene: Scene) -> Blanks | None:
    """What becomes of pixels without vectors; None where there are too few of them, or too little texture on them."""
    still, moved, blocks, fields, shares, surfaces, code = [], [], [], [], [], [], 0.0
    depth: str | None = None
    for k, before in enumerate(scene.pairs):
        empty, code = blank(take.stored[before.here]["motion"])
        empty = resampled(empty, take.size)
        shares.append(empty.mean())
        solid = empty & ~background(take, before.here)
        surfaces.append(solid.mean())
        image = take.images[before.here].astype(np.float32)
        points = pick_points(image, solid if solid.mean() > EMPTY_SHARE else empty, POINTS // 2, k)
        if len(points) < 200:
            continue
        pair = replace(
            pair_of([image, take.images[before.there].astype(np.float32)], 0, 1, points),
            here=before.here, there=before.there,
        )  # fmt: skip
        depth = best_depth(take, pair, points) if depth is None else depth
        field = recorded_field(take, pair, points, depth)
        everywhere = recorded_field(take, before, scene.points[k], depth)
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
        float(np.mean(shares)), float(np.mean(surfaces)), float(a.mean()), float(b.mean()), float(sure), code, complete,
        depth or "",
    )  # fmt: skip


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


DEPTHS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "distance": lambda v: v,
    "reversed": lambda v: NEAR / np.maximum(v, 1e-9),
    "device": lambda v: NEAR / np.maximum(1 - v, 1e-9),
    "hundredth": lambda v: v / 100,
    "hundredfold": lambda v: v * 100,
}
"""What stored depth may be while nothing is known of it: distances from numbers."""

NEAR = 0.1
"""Near plane, where it matters before it is known."""


def best_depth(take: Take, pair: Pair, points: np.ndarray) -> str:
    """The one of `DEPTHS` with which the recorded cameras make two frames agree best; empty without cameras or depth,
    or where a smooth motion of the picture does better."""
    errors = {}
    for name in DEPTHS:
        field = recorded_field(take, pair, points, name)
        if field is not None:
            rest = fit_shift(pair, field[0], field[1])
            errors[name] = float(misfit(pair, field[0] + rest[0], field[1] + rest[1]).mean())
    if not errors:
        return ""
    best = min(errors, key=errors.__getitem__)
    best = "distance" if errors["distance"] < 1.02 * errors[best] else best
    smooth = (polynomial(pair.x, pair.y, take.size) @ fit_camera(pair)).T
    return best if errors[best] < 1.1 * float(misfit(pair, smooth[0], smooth[1]).mean()) else ""


def recorded_field(take: Take, pair: Pair, points: np.ndarray, reading: str = "distance") -> np.ndarray | None:
    """What the recorded cameras do in points, from depth as one of `DEPTHS`; None without cameras or depth."""
    depth = take.stored[pair.here].get("depth")
    if not reading or depth is None or "cameras" not in take.recorded:
        return None
    numbers = at_points(depth, points, take.size)[0].astype(np.float64)
    sky = at_points(sky_of(depth[0])[None], points, take.size)[0]
    z = np.where(sky, 1e7, np.clip(DEPTHS[reading](np.nan_to_num(numbers, nan=SKY, posinf=SKY)), 1e-6, 1e7))
    return caused(take, pair.here, pair.there, points, z).astype(np.float32)


def caused(take: Take, here: int, there: int, places: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Displacement `2 n` in pixels that recorded cameras cause at linear indices, of surfaces at these distances."""
    (height, width), a, b = take.size, take.records[here], take.records[there]
    p, q = np.array(a.projection), np.array(b.projection)
    x, y = places % width + 0.5, places // width + 0.5
    w = -p[3, 2] * z + p[3, 3]
    camera = np.stack([
        ((2 * x / width - 1) * w + p[0, 2] * z - p[0, 3]) / p[0, 0],
        ((1 - 2 * y / height) * w + p[1, 2] * z - p[1, 3]) / p[1, 1], -z, np.ones_like(z),
    ])  # fmt: skip
    clip = q @ np.array(b.view) @ np.linalg.inv(np.array(a.view)) @ camera
    w = np.where(np.abs(clip[3]) < 1e-8, 1e-8, clip[3])
    moved: np.ndarray = np.stack([(clip[0] / w + 1) * width / 2 - x, (1 - clip[1] / w) * height / 2 - y])
    return moved


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
