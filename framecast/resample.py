"""Sizes: sample positions, enlarging from samples where they really lie, sharp warps, what a history may look like.

A frame's pixel (i, j) holds what was seen at (i + 0.5, j + 0.5) + jitter. Enlarging weighs samples by their distance
to the centre of each large pixel, in pixels of the small image, so that nothing shifts from frame to frame. Small and
large image show the same rectangle: an axis of n pixels becomes one of m by the factor m / n. Beyond its border an
image goes on with its edge pixels. Written per plane and without branches on data, so that `torch.compile` fuses it.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor

from framecast.warp import nearest_neighbour, pick

Kernel = Callable[[Tensor], Tensor]
"""Weight of a sample at a signed distance in pixels along one axis."""

# Sample positions.


def halton(index: int, base: int) -> float:
    """The index-th number (from 0) of the van der Corput sequence, in (0, 1): halton(0, 2) is 1/2."""
    value, step, index = 0.0, 1.0, index + 1
    while index:
        step /= base
        value += step * (index % base)
        index //= base
    return value


def jitter(number: int, phases: int) -> tuple[float, float]:
    """Sample minus pixel centre of a frame: Halton(2, 3) less 1/2, again from `phases` frames on; 0 where that is 0."""
    if phases == 0:
        return 0.0, 0.0
    return halton(number % phases, 2) - 0.5, halton(number % phases, 3) - 0.5


def phases(scale: float) -> int:
    """Length of the jitter sequence for an upsampling scale: 8 samples for each display pixel."""
    return max(1, math.ceil(8 * scale * scale - 1e-9))


def size_at(size: tuple[int, int], scale: float) -> tuple[int, int]:
    """Height and width of an image enlarged by `scale`."""
    return round(size[0] * scale), round(size[1] * scale)


# Kernels. All but the Gaussian are 1 at 0 and 0 at other whole distances, so that samples keep their values.


def tent(x: Tensor) -> Tensor:
    """Linear interpolation: 1 - |x| within one pixel; two taps."""
    return (1 - x.abs()).clamp(min=0)


def gaussian(x: Tensor) -> Tensor:
    """exp(-2.29 x^2), a fit of the Blackman-Harris window 3.3 pixels wide; three taps."""
    return torch.exp(-2.29 * x * x)


def lanczos(x: Tensor) -> Tensor:
    """sinc(x) sinc(x / 2) within two pixels; four taps, whose sum is 1 within 1 %."""
    return torch.where(x.abs() < 2, torch.sinc(x) * torch.sinc(x / 2), 0.0)


def catmull_rom(x: Tensor) -> Tensor:
    """The cubic through four samples with the slope of their neighbours (Keys, a = -1/2); four taps, whose sum is 1."""
    a = x.abs()
    near, far = (1.5 * a - 2.5) * a * a + 1, ((-0.5 * a + 2.5) * a - 4) * a + 2
    return torch.where(a < 1, near, torch.where(a < 2, far, 0.0))


# Enlarging.


@dataclass(frozen=True)
class Enlarged:
    """An image made of weighted samples, and how much there was to make it of."""

    image: Float[Tensor, "b c H W"]
    """Weighted mean of the samples."""
    total: Float[Tensor, "b 1 H W"]
    """Sum of their weights."""
    peak: Float[Tensor, "b 1 H W"]
    """Largest weight: 1 where a sample lies on the pixel's centre."""


def enlarge(
    image: Float[Tensor, "b c h w"],
    size: tuple[int, int],
    jitter: Float[Tensor, "b 2"],
    kernel: Kernel = lanczos,
    taps: int = 4,
) -> Enlarged:
    """The image at another size, from the `taps` x `taps` samples nearest to each pixel's centre.

    The weight of a sample is kernel(dx) kernel(dy), of distances in pixels of `image`. A constant stays what it is.
    Whatever the jitter, what is smooth stays where it is.

    Args:
        size: height and width of the result, at least those of `image`.
        jitter: where the samples lie, from their pixels' centres.
    """
    across = _taps(image.shape[-1], size[1], jitter[:, 0], kernel, taps)
    down = _taps(image.shape[-2], size[0], jitter[:, 1], kernel, taps)
    wide = _gathered(image, across, 3)
    total, peak = (
        (along_y[:, None, :, None] * along_x[:, None, None, :])
        for along_y, along_x in ((down.weight.sum(-1), across.weight.sum(-1)), (_peak(down), _peak(across)))
    )
    return Enlarged(_gathered(wide, down, 2), total, peak)


@dataclass(frozen=True)
class _Taps:
    """Samples that each pixel of one axis is made of."""

    index: Int[Tensor, "b n k"]
    weight: Float[Tensor, "b n k"]


def _taps(small: int, large: int, jitter: Float[Tensor, " b"], kernel: Kernel, count: int) -> _Taps:
    centre = (torch.arange(large, dtype=torch.float32, device=jitter.device) + 0.5) * (small / large) - 0.5
    position = centre - jitter[:, None]
    first = (position - count / 2).ceil()
    index = first[..., None] + torch.arange(count, device=jitter.device)
    return _Taps(index.clamp(0, small - 1).long(), kernel(index - position[..., None]))


def _peak(taps: _Taps) -> Float[Tensor, "b n"]:
    return taps.weight.amax(-1)


def _gathered(image: Tensor, taps: _Taps, axis: int) -> Tensor:
    """Weighted mean of the taps along an axis of b c h w."""
    shape = [image.shape[0], 1, 1, 1]
    shape[axis] = taps.index.shape[1]
    weight = taps.weight / taps.weight.sum(-1, keepdim=True)
    whole = [*image.shape]
    whole[axis] = shape[axis]
    result = torch.zeros(1, device=image.device)
    for k in range(taps.index.shape[-1]):
        index = taps.index[..., k].view(shape).expand(whole)
        result = result + image.gather(axis, index) * weight[..., k].view(shape)
    return result


def nearest_sample(small: tuple[int, int], size: tuple[int, int], jitter: Float[Tensor, "b 2"]) -> Int[Tensor, "b H W"]:
    """Linear index of the sample nearest to the centre of each pixel of an image of `size`."""
    column = _taps(small[1], size[1], jitter[:, 0], tent, 1).index
    row = _taps(small[0], size[0], jitter[:, 1], tent, 1).index
    return row * small[1] + column.transpose(1, 2)


def enlarged_motion(
    motion: Float[Tensor, "b 2 h w"], size: tuple[int, int], jitter: Float[Tensor, "b 2"]
) -> Float[Tensor, "b 2 H W"]:
    """Motion at another size: the vector of the nearest sample, in pixels of the new size."""
    small = (motion.shape[-2], motion.shape[-1])
    x, y = pick(motion, nearest_sample(small, size, jitter)).unbind(1)
    return torch.stack((x * (size[1] / small[1]), y * (size[0] / small[0])), 1)


def foreground(
    depth: Float[Tensor, "b 1 h w"], motion: Float[Tensor, "b 2 h w"]
) -> tuple[Float[Tensor, "b 1 h w"], Float[Tensor, "b 2 h w"]]:
    """Depth and motion of the nearest surface in each pixel's 3 x 3 neighbourhood.

    Edges of what lies in front then move as a whole, mixed pixels included.
    """
    nearest = nearest_neighbour(depth)
    return pick(depth, nearest), pick(motion, nearest)


def positions(small: tuple[int, int], size: tuple[int, int], jitter: Float[Tensor, "b 2"]) -> Float[Tensor, "b 2 H W"]:
    """Column and row of the centre of each display pixel on the grid of samples, which lie on whole numbers."""
    x, y = (
        (torch.arange(large, device=jitter.device) + 0.5) * (few / large) - 0.5 - jitter[:, axis, None]
        for axis, few, large in ((0, small[1], size[1]), (1, small[0], size[0]))
    )
    return torch.stack((x[:, None].expand(-1, *size), y[:, :, None].expand(-1, *size)), 1)


def place(
    values: Float[Tensor, "b c h w"], at: Float[Tensor, "b 2 H W"]
) -> tuple[Float[Tensor, "b c H W"], Float[Tensor, "b 1 H W"]]:
    """Samples on display pixels that lie at these columns and rows of their grid: the nearest one, and its cover.

    Cover falls from 1 on the sample to 0 one display pixel away, per axis; beyond the grid it is 0. Value times cover
    is what bilinear warping makes of the image with each sample in its display pixel and zeros between.
    """
    (height, width), size = values.shape[-2:], at.shape[-2:]
    whole = at.round()
    x, y = whole[:, 0].clamp(0, width - 1), whole[:, 1].clamp(0, height - 1)
    away_x, away_y = (at[:, 0] - x).abs() * (size[1] / width), (at[:, 1] - y).abs() * (size[0] / height)
    cover = (1 - away_x).clamp(min=0) * (1 - away_y).clamp(min=0)
    image = torch.arange(values.shape[0], device=at.device)[:, None, None] * (height * width)
    rows = values.permute(0, 2, 3, 1).flatten(0, 2)  # all channels of a sample lie together
    nearest = rows[(y.long() * width + x.long() + image).flatten()]
    return nearest.view(values.shape[0], *size, -1).permute(0, 3, 1, 2), cover[:, None]


def centres(size: tuple[int, int], jitter: Float[Tensor, "b 2"]) -> Float[Tensor, "b h w 2"]:
    """Where the samples of a frame lie on an image whose sides go from -1 to 1."""
    x, y = (
        (torch.arange(n, device=jitter.device) + 0.5 + jitter[:, axis, None]) * (2 / n) - 1
        for axis, n in ((0, size[1]), (1, size[0]))
    )
    return torch.stack((x[:, None].expand(-1, *size), y[:, :, None].expand(-1, *size)), -1)


def at_samples(
    image: Float[Tensor, "b 3 H W"], small: tuple[int, int], jitter: Float[Tensor, "b 2"]
) -> Float[Tensor, "b 3 h w"]:
    """A display image at the places where a frame of this size has its samples."""
    return F.grid_sample(image, centres(small, jitter), padding_mode="border", align_corners=False)


# Warps that keep what is sharp.


def sharp_warp(
    image: Float[Tensor, "b c h w"],
    motion: Float[Tensor, "b 2 h w"],
    kernel: Kernel = catmull_rom,
    *,
    bounded: bool = True,
) -> Float[Tensor, "b c h w"]:
    """Like `warp.warp`, out(p) = image(p + motion(p)), but from 4 x 4 pixels; exact at whole-pixel motion.

    Args:
        kernel: `catmull_rom` or `lanczos`, whose inner weights are positive and outer ones negative.
        bounded: keep every value between the smallest and the largest of the four nearest pixels, so that edges do
            not ring.
    """
    height, width = image.shape[-2:]
    x = (torch.arange(width, dtype=torch.float32, device=image.device) + motion[:, 0]).clamp(-1, width)
    y = (torch.arange(height, dtype=torch.float32, device=image.device)[:, None] + motion[:, 1]).clamp(-1, height)
    left, top = x.floor(), y.floor()
    across, down = _weights(x - left, kernel), _weights(y - top, kernel)
    if not torch.compiler.is_compiling() and min(height, width) > 1:
        return _merged(image, (left, top), across, down, bounded)
    # Joined, places and weights are made before pixels are read, instead of anew for every one of them.
    first = torch.stack((first_of_sixteen(top, left, width),))[0]
    weights = torch.stack((*across, *down)).unbind(0)
    planes = []
    for taps in sixteen(image, first):
        lines = [_weighted(weights[:4], taps[k : k + 4]) for k in (0, 4, 8, 12)]
        value = _weighted(weights[4:], lines)
        planes.append(between([taps[k] for k in INNER], value) if bounded else value)
    return torch.stack(planes, 1)


INNER = (5, 6, 9, 10)
"""The four of sixteen pixels around the position."""


def first_of_sixteen(row: Float[Tensor, "b H W"], column: Float[Tensor, "b H W"], width: int) -> Int[Tensor, "b H W"]:
    """For `sixteen`: the pixel left of and above the one at (row, column), which may lie one pixel off the image."""
    return (row.to(torch.int32) + 1) * (width + 5) + column.to(torch.int32) + 1


def sixteen(image: Float[Tensor, "b c h w"], first: Int[Tensor, "b H W"]) -> list[list[Float[Tensor, "b H W"]]]:
    """Of each channel the 4 x 4 pixels from `first` on, row by row; off the image they are those of its edge.

    Edges are copied around the image once: every pixel read is then a constant number of pixels after the first.
    """
    wide, shape = image.shape[-1] + 5, first.shape
    whole = torch.stack([F.pad(plane, (2, 3, 2, 3), mode="replicate") for plane in image.unbind(1)], 1).flatten(2)
    first = first.clamp(min=0).flatten(1).long()  # never negative, which compiled code would have to ask every time
    offsets = [y * wide + x for y in range(4) for x in range(4)]
    return [[plane.gather(1, first + o).view(shape) for o in offsets] for plane in whole.unbind(1)]


def _weighted(weights: Sequence[Tensor], values: Sequence[Tensor]) -> Tensor:
    total = weights[0] * values[0]
    for weight, value in zip(weights[1:], values[1:], strict=True):
        total = total + weight * value
    return total


def between(around: Sequence[Tensor], value: Tensor) -> Tensor:
    """A value kept between the smallest and the largest of four."""
    a, b, c, d = around
    low, high = torch.minimum(torch.minimum(a, b), torch.minimum(c, d)), torch.maximum(a, b)
    return torch.minimum(torch.maximum(value, low), torch.maximum(high, torch.maximum(c, d)))


def _merged(
    image: Tensor, corner: tuple[Tensor, Tensor], across: list[Tensor], down: list[Tensor], bounded: bool
) -> Tensor:
    """`sharp_warp` from nine bilinear reads, which take the two inner weights of an axis as one: the faster way where
    `grid_sample` is a kernel of its own."""
    height, width = image.shape[-2:]
    result = torch.zeros_like(image)
    for at_y, weight_y in _reads(corner[1], down, height):
        for at_x, weight_x in _reads(corner[0], across, width):
            read = F.grid_sample(image, torch.stack((at_x, at_y), -1), padding_mode="border", align_corners=True)
            result = result + read * (weight_x * weight_y)[:, None]
    if not bounded:
        return result
    around = F.pad(image, (1, 1, 1, 1), mode="replicate")
    row, column = (corner[1] + 1).clamp(max=height), (corner[0] + 1).clamp(max=width)
    index = row.to(torch.int32) * (width + 1) + column.to(torch.int32)
    low, high = pick(-F.max_pool2d(-around, 2, 1), index), pick(F.max_pool2d(around, 2, 1), index)
    return torch.minimum(torch.maximum(result, low), high)


def _reads(first: Tensor, weights: list[Tensor], size: int) -> list[tuple[Tensor, Tensor]]:
    """Positions (-1 to 1) and weights of three reads along an axis; `first` is the second of the four pixels."""
    inner = weights[1] + weights[2]
    at = ((first - 1, weights[0]), (first + weights[2] / inner, inner), (first + 2, weights[3]))
    return [(position * (2 / (size - 1)) - 1, weight) for position, weight in at]


def _weights(fraction: Tensor, kernel: Kernel) -> list[Tensor]:
    """Weights of the four pixels around a position between the second and the third; their sum is 1."""
    weights = [kernel(fraction - k) for k in (-1, 0, 1, 2)]
    total = weights[0] + weights[1] + weights[2] + weights[3]
    return [weight / total for weight in weights]


# What a history may look like.


def to_ycocg(rgb: Float[Tensor, "b 3 *s"]) -> Float[Tensor, "b 3 *s"]:
    """Brightness (r + 2g + b) / 4, orange minus blue (r - b) / 2, green minus purple (2g - r - b) / 4.

    Boxes around colours of one material are tighter along these axes than along red, green and blue.
    """
    r, g, b = rgb.unbind(1)
    return torch.stack((0.25 * r + 0.5 * g + 0.25 * b, 0.5 * r - 0.5 * b, -0.25 * r + 0.5 * g - 0.25 * b), 1)


def from_ycocg(ycocg: Float[Tensor, "b 3 *s"]) -> Float[Tensor, "b 3 *s"]:
    """Inverse of `to_ycocg`."""
    y, co, cg = ycocg.unbind(1)
    return torch.stack((y + co - cg, y + cg, y - co - cg), 1)


@dataclass(frozen=True)
class Box:
    """Values that a pixel may take, channel by channel."""

    low: Float[Tensor, "b c h w"]
    high: Float[Tensor, "b c h w"]

    def clamp(self, image: Float[Tensor, "b c h w"]) -> Float[Tensor, "b c h w"]:
        """The nearest value inside: each channel by itself."""
        return torch.minimum(torch.maximum(image, self.low), self.high)

    def clip(self, image: Float[Tensor, "b c h w"]) -> Float[Tensor, "b c h w"]:
        """Where the straight line from the value to the middle of the box enters it: hues stay as they are."""
        middle, half = (self.low + self.high) / 2, (self.high - self.low) / 2
        away = image - middle
        times = (away.abs() / half.clamp(min=1e-6)).amax(1, keepdim=True).clamp(min=1)
        return middle + away / times


def neighbourhood(image: Float[Tensor, "b c h w"]) -> Box:
    """Smallest and largest value in each pixel's 3 x 3 neighbourhood."""
    return Box(-F.max_pool2d(-image, 3, 1, 1), F.max_pool2d(image, 3, 1, 1))


def moments(image: Float[Tensor, "b c h w"]) -> tuple[Float[Tensor, "b c h w"], Float[Tensor, "b c h w"]]:
    """Mean and standard deviation of each pixel's 3 x 3 neighbourhood; nothing counts beyond the border."""
    mean, square = (F.avg_pool2d(v, 3, 1, 1, count_include_pad=False) for v in (image, image * image))
    return mean, (square - mean * mean).clamp(min=0).sqrt()


def spread(image: Float[Tensor, "b c h w"], gamma: float) -> Box:
    """Variance clipping: mean plus and minus `gamma` standard deviations of the neighbourhood, but never beyond its
    smallest and largest value."""
    mean, deviation = moments(image)
    around = neighbourhood(image)
    return Box(around.clamp(mean - gamma * deviation), around.clamp(mean + gamma * deviation))
