"""FLIP, the difference that a viewer sees when two images take turns (Andersson et al. 2020, for HDR 2021).

Both images are seen as an eye sees them at a distance: colours blurred by contrast sensitivity and compared in a
perceptual space, edges and points compared apart, and the colour difference raised the more these differ. Every filter
is separable and runs as blocks of matrix products: a pair of 320 x 180 takes 29 ms of processor time, the C++ of its
authors, against which the tests hold it, 122 ms.
"""

import math
from functools import lru_cache
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

from framecast.color import decode_srgb, luminance

PIXELS_PER_DEGREE = 67.02
"""Viewing condition: a 0.7 m wide 4K display seen from 0.7 m, the default of its authors."""

BLOCK = 64
"""Pixels that one matrix product makes of a row or a column."""

SENSITIVITY = ((0, 1.0, 0.0047), (1, 1.0, 0.0053), (2, 34.1, 0.04), (2, 13.5, 0.025))
"""Contrast sensitivity of light, red-green and yellow-blue: channel, a and b of Gaussians of degrees d,
a sqrt(pi / b) exp(-pi^2 d^2 / b)."""

WIDEST = 0.04
"""Largest b: all filters reach as far as three standard deviations of it."""

FEATURE = 0.082
"""Width of the features that are compared, degrees."""

COLOR_POWER, FEATURE_POWER = 0.7, 0.5
CUT, CUT_TO = 0.4, 0.95
"""Colour differences up to CUT of the largest one become 0..CUT_TO, the rest what is left up to 1."""

XYZ = (
    (10135552 / 24577794, 8788810 / 24577794, 4435075 / 24577794),
    (2613072 / 12288897, 8788810 / 12288897, 887015 / 12288897),
    (1425312 / 73733382, 8788810 / 73733382, 70074185 / 73733382),
)
"""Linear sRGB to XYZ, white at the sum of the rows."""

ACES = (0.9036, 0.018, 0.0, 0.8748, 0.354, 0.14)
"""Tone curve (a x^2 + b x + c) / (d x^2 + e x + f) of HDR images, a fit of ACES."""

HIGH = 0.85
"""Part of the display's range at which an exposure puts the brightest, and the median, of the reference."""


def flip_map(image: Float[Tensor, "b 3 h w"], target: Float[Tensor, "b 3 h w"]) -> Float[Tensor, "b 1 h w"]:
    """Difference in 0..1 of display images in [0, 1] (LDR-FLIP), at PIXELS_PER_DEGREE."""
    return difference(perceived(decode_srgb(image)), perceived(decode_srgb(target)))


def hdr_flip_map(image: Float[Tensor, "b 3 h w"], target: Float[Tensor, "b 3 h w"]) -> Float[Tensor, "b 1 h w"]:
    """Largest difference over all exposures at which the target shows something (HDR-FLIP); images are linear."""
    return torch.cat([_hdr(*pair) for pair in zip(image.split(1), target.split(1), strict=True)])


def _hdr(image: Tensor, target: Tensor) -> Tensor:
    found = torch.zeros_like(image[:, :1])
    for stops in exposures(target):
        pair = (perceived(toned(one * 2.0**stops)) for one in (image, target))
        found = torch.maximum(found, difference(*pair))
    return found


def exposures(target: Float[Tensor, "1 3 h w"]) -> list[float]:
    """Stops from the one that brings the brightest pixel to HIGH to the one that brings the median there."""
    a, b, c, d, e, f = ACES
    second, first, rest = a - HIGH * d, b - HIGH * e, c - HIGH * f
    bright = (-first + math.sqrt(first * first - 4 * second * rest)) / (2 * second)
    light = luminance(target).flatten().sort().values
    largest, median = (max(float(light[k]), 1e-5) for k in (-1, len(light) // 2))
    start, stop = math.log2(bright / largest), math.log2(bright / median)
    count = max(2, math.ceil(stop - start))
    return [start + (stop - start) * k / (count - 1) for k in range(count)]


def toned(linear: Float[Tensor, "b 3 h w"]) -> Float[Tensor, "b 3 h w"]:
    """HDR colour as a display shows it, still linear, in [0, 1]."""
    a, b, c, d, e, f = ACES
    square = linear * linear
    return ((a * square + b * linear + c) / (d * square + e * linear + f)).clamp(0, 1)


# What an eye sees of one image.


def perceived(linear: Float[Tensor, "b 3 h w"]) -> tuple[Float[Tensor, "b 3 h w"], Float[Tensor, "b 4 h w"]]:
    """Perceptual colour (Lab after Hunt) of a linear image, and its features: edges x y, points x y."""
    opponent = opponents(linear)
    return hunt(lab(displayable(blurred(opponent)))), features((opponent[:, 0] + 16) / 116)


def opponents(linear: Float[Tensor, "b 3 h w"]) -> Float[Tensor, "b 3 h w"]:
    """Light, red against green and yellow against blue: the linear part of Lab."""
    x, y, z = _relative(linear)
    return torch.stack((116 * y - 16, 500 * (x - y), 200 * (y - z)), 1)


def displayable(opponent: Float[Tensor, "b 3 h w"]) -> Float[Tensor, "b 3 h w"]:
    """XYZ divided by white, of opponents after what no display can show is cut off."""
    y = (opponent[:, 0] + 16) / 116
    relative = torch.stack((y + opponent[:, 1] / 500, y, y - opponent[:, 2] / 200), 1)
    inverse = torch.linalg.inv(_to_relative(torch.float64)).to(relative)
    linear = torch.einsum("ij,bjhw->bihw", inverse, relative).clamp(0, 1)
    return torch.stack(_relative(linear), 1)


def lab(relative: Float[Tensor, "b 3 h w"]) -> Float[Tensor, "b 3 h w"]:
    """CIE Lab of XYZ divided by white."""
    edge = 6 / 29
    curve = torch.where(relative > edge**3, relative.clamp(min=edge**3) ** (1 / 3), relative / (3 * edge**2) + 4 / 29)
    x, y, z = curve.unbind(1)
    return torch.stack((116 * y - 16, 500 * (x - y), 200 * (y - z)), 1)


def hunt(colour: Float[Tensor, "b 3 h w"]) -> Float[Tensor, "b 3 h w"]:
    """Chroma grows with lightness (Hunt effect)."""
    return torch.cat((colour[:, :1], 0.01 * colour[:, :1] * colour[:, 1:]), 1)


def difference(
    one: tuple[Float[Tensor, "b 3 h w"], Float[Tensor, "b 4 h w"]],
    other: tuple[Float[Tensor, "b 3 h w"], Float[Tensor, "b 4 h w"]],
) -> Float[Tensor, "b 1 h w"]:
    """FLIP of two perceived images."""
    largest = _largest()
    distance = hyab(one[0], other[0]) ** COLOR_POWER
    low = CUT_TO / (CUT * largest) * distance
    high = CUT_TO + (distance - CUT * largest) / (largest - CUT * largest) * (1 - CUT_TO)
    colour = torch.where(distance < CUT * largest, low, high)
    apart = [a.square().sum(1, keepdim=True).sqrt() for f in (one[1], other[1]) for a in f.split(2, 1)]
    feature = torch.maximum((apart[0] - apart[2]).abs(), (apart[1] - apart[3]).abs())
    return colour ** (1 - (feature / math.sqrt(2)).clamp(max=1) ** FEATURE_POWER)


def hyab(one: Float[Tensor, "b 3 h w"], other: Float[Tensor, "b 3 h w"]) -> Float[Tensor, "b 1 h w"]:
    """Distance of large colour differences: of lightness plus of chroma."""
    apart = one - other
    return apart[:, :1].abs() + apart[:, 1:].square().sum(1, keepdim=True).sqrt()


@lru_cache(maxsize=1)
def _largest() -> float:
    """Difference of green and blue, the largest there is."""
    pure = torch.eye(3)[1:, :, None, None]
    seen = hunt(lab(torch.stack(_relative(pure), 1)))
    return float(hyab(seen[:1], seen[1:])) ** COLOR_POWER


@lru_cache(maxsize=2)
def _to_relative(dtype: torch.dtype) -> Tensor:
    matrix = torch.tensor(XYZ, dtype=torch.float64)
    return (matrix / matrix.sum(1, keepdim=True)).to(dtype)


def _relative(linear: Tensor) -> tuple[Tensor, ...]:
    """XYZ divided by white."""
    return torch.einsum("ij,bjhw->bihw", _to_relative(linear.dtype).to(linear.device), linear).unbind(1)


# Filters.


def blurred(opponent: Float[Tensor, "b 3 h w"]) -> Float[Tensor, "b 3 h w"]:
    """Each opponent channel as far as an eye resolves it."""
    spread = [math.sqrt(b / (2 * math.pi**2)) * PIXELS_PER_DEGREE for _, _, b in SENSITIVITY]
    radius = math.ceil(3 * math.sqrt(WIDEST / (2 * math.pi**2)) * PIXELS_PER_DEGREE)
    kernels = [_gaussian(sigma, radius) for sigma in spread]
    weights = [a * math.sqrt(math.pi / b) * sum(k) ** 2 for (_, a, b), k in zip(SENSITIVITY, kernels, strict=True)]
    totals = [0.0, 0.0, 0.0]
    for (channel, _, _), weight in zip(SENSITIVITY, weights, strict=True):
        totals[channel] += weight
    found: list[Tensor | None] = [None, None, None]
    for (channel, _, _), weight, kernel in zip(SENSITIVITY, weights, kernels, strict=True):
        unit = tuple(k / sum(kernel) for k in kernel)
        part = along_columns(along_rows(opponent[:, channel], (unit,))[0], unit) * (weight / totals[channel])
        before = found[channel]
        found[channel] = part if before is None else before + part
    return torch.stack([one for one in found if one is not None], 1)


def features(light: Float[Tensor, "b h w"]) -> Float[Tensor, "b 4 h w"]:
    """Edges along x and y, then points: first and second derivative of a Gaussian, each half of them summing to 1."""
    sigma = 0.5 * FEATURE * PIXELS_PER_DEGREE
    radius = math.ceil(3 * sigma)
    smooth = _gaussian(sigma, radius)
    edge = tuple(-x * g for x, g in zip(range(-radius, radius + 1), smooth, strict=True))
    point = tuple((x * x / sigma**2 - 1) * g for x, g in zip(range(-radius, radius + 1), smooth, strict=True))
    unit = tuple(g / sum(smooth) for g in smooth)
    even, first, second = along_rows(light, (unit, _halves(edge), _halves(point)))
    pairs = ((first, unit), (even, _halves(edge)), (second, unit), (even, _halves(point)))
    return torch.stack([along_columns(image, kernel) for image, kernel in pairs], 1)


Kernel = tuple[float, ...]
Edge = Literal["replicate", "reflect"]


def _gaussian(sigma: float, radius: int) -> Kernel:
    return tuple(math.exp(-x * x / (2 * sigma**2)) for x in range(-radius, radius + 1))


def _halves(kernel: Kernel) -> Kernel:
    """The kernel with its positive weights summing to 1 and its negative ones to -1."""
    above, below = sum(k for k in kernel if k > 0), -sum(k for k in kernel if k < 0)
    return tuple(k / (above if k > 0 else below) for k in kernel)


def along_rows(
    image: Float[Tensor, "b h w"], kernels: tuple[Kernel, ...], edge: Edge = "replicate"
) -> Float[Tensor, "n b h w"]:
    """Correlation of rows with kernels of one odd length.

    Beyond the border the last pixel goes on, or the image is mirrored (where it is larger than half of a kernel).
    """
    width, matrix = image.shape[-1], _toeplitz(kernels).to(image)
    reach = len(kernels[0]) // 2
    padded = _padded(image, reach, edge)
    # Copied, all blocks are one product; left as they lie, each row would be one of its own.
    made = padded.unfold(-1, BLOCK + 2 * reach, BLOCK).contiguous() @ matrix
    parts = made.unflatten(-1, (len(kernels), BLOCK)).movedim(-2, 0)
    return parts.flatten(-2)[..., :width]


def along_columns(image: Float[Tensor, "b h w"], kernel: Kernel, edge: Edge = "replicate") -> Float[Tensor, "b h w"]:
    """The same of columns, with one kernel."""
    height, matrix = image.shape[-2], _toeplitz((kernel,)).to(image)
    reach = len(kernel) // 2
    padded = _padded(image.transpose(-1, -2), reach, edge).transpose(-1, -2)
    made = matrix.T @ padded.unfold(-2, BLOCK + 2 * reach, BLOCK).transpose(-1, -2)
    return made.flatten(1, 2)[:, :height]


def _padded(image: Float[Tensor, "b h w"], reach: int, edge: Edge) -> Float[Tensor, "b h l"]:
    """Rows with `reach` more pixels at both ends, then as many without meaning as whole blocks take.

    The memory is laid out as that of the image.
    """
    width = image.shape[-1]
    wide = width + 2 * reach + -width % BLOCK
    turned = image.stride(-1) != 1
    sizes = (*image.shape[:-2], wide, image.shape[-2]) if turned else (*image.shape[:-1], wide)
    padded = image.new_zeros(sizes).transpose(-1, -2) if turned else image.new_zeros(sizes)
    padded[..., reach : reach + width] = image
    if edge == "reflect" and width > reach:
        padded[..., :reach] = image[..., 1 : reach + 1].flip(-1)
        padded[..., reach + width : 2 * reach + width] = image[..., -reach - 1 : -1].flip(-1)
    else:
        padded[..., :reach] = image[..., :1]
        padded[..., reach + width : 2 * reach + width] = image[..., -1:]
    return padded


@lru_cache(maxsize=16)
def _toeplitz(kernels: tuple[Kernel, ...]) -> Tensor:
    """Matrix that takes BLOCK pixels and their surroundings to BLOCK results of each kernel."""
    taps = len(kernels[0])
    matrix = torch.zeros(BLOCK + taps - 1, len(kernels), BLOCK)
    for n, kernel in enumerate(kernels):
        for k, weight in enumerate(kernel):
            matrix[torch.arange(BLOCK) + k, n, torch.arange(BLOCK)] = weight
    return matrix.flatten(1)
