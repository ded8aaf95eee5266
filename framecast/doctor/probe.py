"""What experiments are made of: images that can be compared, points at which to look, errors with a margin.

A pair of frames is looked at in a few thousand points where the picture has texture and the vectors matter. Positions
are pixels (column + 0.5, row + 0.5 at centres), vectors are pixels, x right, y down, as in `frame.py`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

POINTS = 3000
"""Points of one pair of frames."""

BLOCKS = 6
"""Points are counted in this many rows and columns of blocks, which vote."""

DARK = 0.05
"""Share of the median brightness below which differences stop to count."""


def comparable(color: Float[np.ndarray, "3 h w"], level: float) -> Float[np.ndarray, "3 h w"]:
    """Colour on a scale on which equal ratios look equally different, smoothed by 1-2-1; `level` is its median."""
    bright = np.minimum(np.fmax(color, 0, dtype=np.float32), 65504)  # NaN becomes 0
    bright /= level
    bright += DARK
    return smooth(np.log(bright, out=bright))


def smooth(image: Float[np.ndarray, "c h w"]) -> Float[np.ndarray, "c h w"]:
    """Filtered by 1-2-1 over four in both directions; the edge is continued."""
    tall = np.concatenate([image[:, :1], image, image[:, -1:]], 1)
    tall = tall[:, :-1] + tall[:, 1:]
    image = tall[:, :-1] + tall[:, 1:]
    wide = np.concatenate([image[:, :, :1], image, image[:, :, -1:]], 2)
    wide = wide[:, :, :-1] + wide[:, :, 1:]
    smoothed: np.ndarray = wide[:, :, :-1] + wide[:, :, 1:]
    smoothed /= 16
    return smoothed


def thinned(height: int) -> slice:
    """Every so many rows that some hundred are left: enough for statistics of large pictures."""
    return slice(None, None, max(1, height // 240))


def slopes(image: Float[np.ndarray, "c h w"], points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Central differences along x and y, a pixel, `c n` at linear indices; 0 at the border."""
    height, width = image.shape[1:]
    row, column = points // width, points % width
    inner = (row > 0) & (row < height - 1) & (column > 0) & (column < width - 1)
    flat, at = image.reshape(len(image), -1), np.where(inner, points, width + 1)
    half = inner.astype(np.float32) / 2
    return (flat[:, at + 1] - flat[:, at - 1]) * half, (flat[:, at + width] - flat[:, at - width]) * half


def sample(
    image: Float[np.ndarray, "c h w"], x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "c n"]:
    """Bilinear values at positions; outside, those of the edge."""
    height, width = image.shape[1:]
    x = np.clip(x - 0.5, 0, width - 1)
    y = np.clip(y - 0.5, 0, height - 1)
    left = np.minimum(x.astype(np.int32), max(width - 2, 0))
    top = np.minimum(y.astype(np.int32), max(height - 2, 0))
    right, below = np.minimum(left + 1, width - 1), np.minimum(top + 1, height - 1)
    fx, fy = (x - left).astype(np.float32), (y - top).astype(np.float32)
    flat, row, under = image.reshape(len(image), -1), top * width, below * width
    upper = flat[:, row + left] * (1 - fx) + flat[:, row + right] * fx
    lower = flat[:, under + left] * (1 - fx) + flat[:, under + right] * fx
    return upper * (1 - fy) + lower * fy


def spline(
    image: Float[np.ndarray, "3 h w"], x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "3 n"]:
    """Values at positions under a quadratic B-spline; outside, those of the edge.

    It blurs equally wherever a position lies. Bilinear values are blurred between pixels and sharp on them, so that of
    two readings of the vectors the one that leads onto pixels, standing still above all, would be favoured.
    """
    height, width = image.shape[1:]
    column, row = np.clip(np.floor(x), 1, width - 2), np.clip(np.floor(y), 1, height - 2)
    across = _weights(np.clip(x - column - 0.5, -0.5, 0.5))
    down = _weights(np.clip(y - row - 0.5, -0.5, 0.5))
    flat, at = image.reshape(len(image), -1), row.astype(np.int64) * width + column.astype(np.int64)
    rows = [sum(flat[:, at + j * width + i] * across[i + 1] for i in (-1, 0, 1)) for j in (-1, 0, 1)]
    blended: np.ndarray = rows[0] * down[0] + rows[1] * down[1] + rows[2] * down[2]
    return blended


def _weights(d: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of three neighbours, for a position `d` pixels beside the middle one."""
    return (0.5 - d) ** 2 / 2, 0.75 - d * d, (0.5 + d) ** 2 / 2


@dataclass(frozen=True)
class Pair:
    """A frame and another one, as seen in points of the frame."""

    here: int
    there: int
    """Positions of the two frames in the looked-at sequence."""
    x: Float[np.ndarray, " n"]
    y: Float[np.ndarray, " n"]
    value: Float[np.ndarray, "3 n"]
    """The frame's own image in the points."""
    soft: Float[np.ndarray, "3 n"]
    """The same under a `spline`."""
    slope_x: Float[np.ndarray, "3 n"]
    slope_y: Float[np.ndarray, "3 n"]
    other: Float[np.ndarray, "3 h w"]
    """The other frame's image."""
    block: np.ndarray
    """Number of the block in which each point lies."""

    def at(self, use: Bool[np.ndarray, " n"]) -> "Pair":
        """Some of the points."""
        return replace(
            self, x=self.x[use], y=self.y[use], value=self.value[:, use], soft=self.soft[:, use],
            slope_x=self.slope_x[:, use], slope_y=self.slope_y[:, use], block=self.block[use],
        )  # fmt: skip


MARGIN = 4
"""Pixels beside the border in which no points lie."""


def pick_points(image: Float[np.ndarray, "3 h w"], where: Bool[np.ndarray, "h w"], count: int, seed: int) -> np.ndarray:
    """Linear indices of up to `count` pixels of the textured half of `where`, the same on every run.

    Of many pixels sixteen times as many as asked for are looked at.
    """
    inner = np.zeros(where.shape, bool)
    inner[MARGIN:-MARGIN, MARGIN:-MARGIN] = where[MARGIN:-MARGIN, MARGIN:-MARGIN]
    candidates, chance = np.flatnonzero(inner), np.random.default_rng(seed)
    if len(candidates) > 16 * count:
        candidates = chance.choice(candidates, 16 * count, replace=False)
    along_x, along_y = slopes(image, candidates)
    strength = (along_x**2 + along_y**2).sum(0)
    candidates, strength = candidates[strength > 0], strength[strength > 0]
    if len(candidates) == 0:
        return candidates
    candidates = candidates[strength >= np.median(strength)]
    if len(candidates) > count:
        candidates = chance.choice(candidates, count, replace=False)
    return np.sort(candidates)


def pair_of(images: Sequence[Float[np.ndarray, "3 h w"]], here: int, there: int, points: np.ndarray) -> Pair:
    """What experiments need of two frames, in pixels given by linear index."""
    image = images[here]
    height, width = image.shape[1:]
    row, column = points // width, points % width
    along_x, along_y = slopes(image, points)
    block = (row * BLOCKS // height) * BLOCKS + column * BLOCKS // width
    x, y = (column + 0.5).astype(np.float32), (row + 0.5).astype(np.float32)
    return Pair(
        here, there, x, y, image.reshape(3, -1)[:, points], spline(image, x, y), along_x, along_y, images[there], block,
    )  # fmt: skip


def misfit(pair: Pair, dx: Float[np.ndarray, " n"], dy: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """How different the other frame looks where each point is said to have been, at most 1; gain taken out."""
    difference = pair.soft - spline(pair.other, pair.x + dx, pair.y + dy)
    return np.minimum(np.abs(difference - np.median(difference[:, ::4])).mean(0), 1)


def fit_shift(
    pair: Pair, dx: Float[np.ndarray, " n"], dy: Float[np.ndarray, " n"], *, limit: float = 1.2, steps: int = 4
) -> tuple[float, float]:
    """The one displacement in pixels that, added to all vectors, makes both frames agree best; robust, sub-pixel."""
    shift = np.zeros(2)
    for _ in range(steps):
        got = sample(pair.other, pair.x + dx + shift[0], pair.y + dy + shift[1])
        error = pair.value - got
        error = error - np.median(error[:, ::4])
        spread = 2 * np.median(np.abs(error[:, ::4])) + 1e-6
        weight = 1 / (1 + (error / spread) ** 2) ** 2
        gx, gy = weight * pair.slope_x, weight * pair.slope_y
        a, b, c = (gx * pair.slope_x).sum(), (gx * pair.slope_y).sum(), (gy * pair.slope_y).sum()
        u, v = (gx * error).sum(), (gy * error).sum()
        determinant = a * c - b * b
        if not determinant > 1e-9 * max(a * c, 1e-12):
            break
        step = np.array([c * u - b * v, a * v - b * u]) / determinant
        shift = np.clip(shift + step, -limit, limit)
    return float(shift[0]), float(shift[1])


def votes(better: Float[np.ndarray, " n"], worse: Float[np.ndarray, " n"], block: np.ndarray) -> float:
    """How surely `better` is smaller: standard deviations by which blocks that vote for it outnumber the others."""
    count = np.bincount(block)
    gain = np.bincount(block, worse - better) / np.maximum(count, 1)
    gain = gain[count >= 4]
    ahead, behind = int((gain > 1e-6).sum()), int((gain < -1e-6).sum())
    return (ahead - behind) / np.sqrt(max(ahead + behind, 1))
