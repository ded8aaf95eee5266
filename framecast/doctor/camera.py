"""Do the vectors hold what the camera does? Pixels without a vector, and whether the picture moves there."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from framecast.doctor.motion import EMPTY_SHARE, Scene, at_points, blank, resampled
from framecast.doctor.probe import POINTS, Pair, fit_shift, misfit, pair_of, pick_points, sample, votes
from framecast.doctor.take import Take
from framecast.frame import SKY

FAR = 1e7
"""Distance that stands for the background."""


@dataclass(frozen=True)
class Distance:
    """How stored depth may be read while nothing else is known of it."""

    kind: Literal["planar", "inverse", "device"] = "planar"
    scale: float = 1.0

    def of(self, stored: np.ndarray) -> np.ndarray:
        """Distances from numbers."""
        divisor = 1 - stored if self.kind == "device" else stored
        plain = stored if self.kind == "planar" else 1 / np.maximum(divisor, 1e-9)
        distances: np.ndarray = np.clip(self.scale * plain, 1e-6, FAR)
        return distances


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
    code: np.ndarray
    """What is stored there, a number a channel."""
    depth: Distance | None
    """Of stored depth, with which recorded cameras say so; None where it was fitted to the pictures, light that moves
    included."""

    @property
    def found(self) -> bool:
        """Whether a moving camera explains those pixels beyond doubt."""
        return self.votes >= 4 and self.still > (1.04 if self.depth else 1.18) * self.moved


def blanks_of(take: Take, scene: Scene) -> Blanks | None:
    """What becomes of pixels without vectors; None where there are too few of them, too little texture on them, or
    where in most pairs of frames a camera would move them as the whole picture moves."""
    still: list[np.ndarray] = []
    moved, blocks, shares, surfaces = [], [], [], []
    code, depth = np.zeros(2), None
    for k, before in enumerate(scene.pairs):
        empty, code = blank(take.stored[before.here]["motion"])
        empty = resampled(empty, take.size)
        shares.append(empty.mean())
        surfaces.append((empty & ~background(take, before.here)).mean())
        points = blank_points(take, before.here, k)
        if len(points) < 200:
            continue
        pair = between(take, before.here, before.there, points)
        depth = depth if still else distance_of(take, pair, points)
        field = camera_motion(take, pair, points, depth)
        zero = np.zeros_like(pair.x)
        shift = fit_shift(pair, zero, zero)
        rest = fit_shift(pair, field[0], field[1])
        apart = np.hypot(field[0] + rest[0] - shift[0], field[1] + rest[1] - shift[1]) > 0.3
        if apart.sum() < 25:
            continue
        still.append(misfit(pair, zero + shift[0], zero + shift[1])[apart])
        moved.append(misfit(pair, field[0] + rest[0], field[1] + rest[1])[apart])
        blocks.append((pair.block + k * 100)[apart])
    if len(still) < len(scene.pairs) / 3:  # a cut is no camera that moves
        return None
    a, b = np.concatenate(still), np.concatenate(moved)
    if len(a) < 200:
        return None
    sure = votes(b, a, np.concatenate(blocks))
    return Blanks(
        float(np.mean(shares)), float(np.mean(surfaces)), float(a.mean()), float(b.mean()), float(sure), code, depth
    )


def blank_points(take: Take, t: int, seed: int) -> np.ndarray:
    """Textured pixels without vectors, by linear index: of surfaces where there are enough of them."""
    empty = resampled(blank(take.stored[t]["motion"])[0], take.size)
    solid = empty & ~background(take, t)
    return pick_points(take.images[t], solid if solid.mean() > EMPTY_SHARE else empty, POINTS // 2, seed)


def camera_fields(take: Take, scene: Scene, depth: Distance | None) -> tuple[tuple[np.ndarray, np.ndarray | None], ...]:
    """What the camera does in the points of each pair of a scene, `2 n`, to the frame before and to the next one."""
    out = []
    for k, (before, after) in enumerate(zip(scene.pairs, scene.after, strict=True)):
        points = blank_points(take, before.here, k)
        points = points if len(points) >= 200 else scene.points[k]
        back, forth = (p and between(take, p.here, p.there, points) for p in (before, after))
        assert back is not None
        onward = camera_motion(take, forth, scene.points[k], depth) if forth else None
        out.append((camera_motion(take, back, scene.points[k], depth), onward))
    return tuple(out)


def between(take: Take, here: int, there: int, points: np.ndarray) -> Pair:
    """Two frames of a take in pixels of the first, given by linear index."""
    return pair_of(take.images, here, there, points)


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


def distance_of(take: Take, pair: Pair, points: np.ndarray) -> Distance | None:
    """The reading of depth with which the recorded cameras make two frames agree best, as distances in their unit where
    that is as good. None without cameras or depth, or where a smooth motion of the picture does better."""
    if "cameras" not in take.recorded or "depth" not in take.stored[pair.here]:
        return None

    numbers, sky = stored_depth(take, pair.here, points)

    def error(reading: Distance) -> float:
        field = caused(take, pair.here, pair.there, points, np.where(sky, FAR, reading.of(numbers)))
        rest = fit_shift(pair, field[0], field[1], steps=2)
        return float(misfit(pair, field[0] + rest[0], field[1] + rest[1]).mean())

    kinds: tuple[Literal["planar", "inverse", "device"], ...] = ("planar", "inverse", "device")
    best = min((Distance(kind, 10 ** (k / 2)) for kind in kinds for k in range(-6, 7)), key=error)
    for finer in (1 / 6, 1 / 18, 1 / 54):
        best = min((replace(best, scale=best.scale * 10 ** (k * finer)) for k in (-1, 0, 1)), key=error)
    least = error(best)
    best, least = (Distance(), error(Distance())) if error(Distance()) < 1.02 * least else (best, least)
    smooth = (polynomial(pair.x, pair.y, take.size) @ fit_camera(pair)).T
    return best if least < 1.1 * float(misfit(pair, smooth[0], smooth[1]).mean()) else None


def camera_motion(take: Take, pair: Pair, places: np.ndarray, depth: Distance | None) -> np.ndarray:
    """What the camera does between two frames at linear indices, `2 n` in pixels: what the recorded cameras say, and
    without `depth` the smooth motion that fits the pictures in the points of the pair."""
    if depth is not None:
        numbers, sky = stored_depth(take, pair.here, places)
        z = np.where(sky, FAR, depth.of(numbers))
        return caused(take, pair.here, pair.there, places, z).astype(np.float32)
    x, y = places % take.size[1] + 0.5, places // take.size[1] + 0.5
    field: np.ndarray = (polynomial(x, y, take.size) @ fit_camera(pair)).T.astype(np.float32)
    return field


def stored_depth(take: Take, t: int, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Depth as stored at linear indices, and whether there is background."""
    stored = take.stored[t]["depth"]
    numbers = np.nan_to_num(at_points(stored, places, take.size)[0].astype(np.float64), nan=SKY, posinf=SKY)
    return numbers, at_points(sky_of(stored[0])[None], places, take.size)[0]


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
