"""How far an image is from its target: PSNR, SSIM, FLIP and LPIPS, over all pixels or over a region.

Images are display-referred, `b 3 h w` in [0, 1]: the caller applies `color.to_display` once, to both; those of
"flip-hdr" are linear. A metric first makes error maps (the costly part), then averages them over as many regions as are
asked for: `measure` does both, `psnr`, `ssim`, `flip` and `lpips` are the same for one region. A region without pixels
gives NaN.
"""

import importlib.util
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Literal

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor, nn

from framecast.flip import along_columns, along_rows, flip_map, hdr_flip_map

Maps = tuple[Tensor, ...]
"""Error maps `b 1 h w`; LPIPS has one for each layer, of its size."""

PSNR_LIMIT = 100.0
"""PSNR of equal images in dB, so that averages stay finite; rounding to 8 bits alone gives 59 dB."""

_WINDOW, _SIGMA = 11, 1.5

_ALEXNET = ((0, 4, 2, False), (3, 1, 2, True), (6, 1, 1, True), (8, 1, 1, False), (10, 1, 1, False))
"""Convolutions of AlexNet: number in torchvision's file, stride, padding, and whether a 3 x 3 maximum goes before."""


@dataclass(frozen=True)
class Metric:
    """A metric in two parts: maps of one image pair, and the number that the average over a region becomes."""

    maps: Callable[[Tensor, Tensor], Maps]
    higher_is_better: bool
    perfect: float
    """Value of equal images."""
    value: Callable[[Tensor], Tensor] = lambda average: average
    compares: Literal["display", "linear", "change", "roles"] = "display"
    """What it is given: an image and what it should be, as displayed or linear; how both changed along true motion
    since the image before; or one frame as a method made it in its two roles, generated and shaded."""


def average(maps: Maps, mask: Bool[Tensor, "b 1 h w"] | None = None) -> Float[Tensor, " b"]:
    """Mean of each map over the mask, summed over the maps; NaN where the mask of an image is empty.

    A map of another size sees the mask as the share of it in each of its pixels. Without a mask all pixels count.
    """
    total: Tensor = maps[0].new_zeros(maps[0].shape[0])
    for error in maps:
        if mask is None:
            total = total + error.mean((1, 2, 3))
            continue
        weight = mask.to(error.dtype)
        if mask.shape[-2:] != error.shape[-2:]:
            weight = F.adaptive_avg_pool2d(weight, (error.shape[-2], error.shape[-1]))
        total = total + (error * weight).sum((1, 2, 3)) / weight.sum((1, 2, 3))
    return total


def squared_error(image: Float[Tensor, "b 3 h w"], target: Float[Tensor, "b 3 h w"]) -> Float[Tensor, "b 1 h w"]:
    """Squared difference of each pixel, mean over the channels."""
    return (image - target).square().mean(1, keepdim=True)


def decibels(mean_squared_error: Float[Tensor, " b"]) -> Float[Tensor, " b"]:
    """PSNR of values with peak 1, in dB, at most PSNR_LIMIT."""
    return -10 * torch.log10(mean_squared_error.clamp(min=10 ** (-PSNR_LIMIT / 10)))


def ssim_map(image: Float[Tensor, "b 3 h w"], target: Float[Tensor, "b 3 h w"]) -> Float[Tensor, "b 1 h w"]:
    """Structural similarity around each pixel, mean over the channels; 1 is equal.

    Wang et al. 2004: Gaussian window 11 x 11 of sigma 1.5, K 0.01 and 0.03, range 1. Beyond the border the image is
    mirrored, and the pixels there count (some implementations leave them out).
    """
    mean_a, mean_b = _blur(image), _blur(target)
    square, product = _blur(image.square() + target.square()), _blur(image * target)
    means, mean_product = mean_a.square() + mean_b.square(), mean_a * mean_b
    c1, c2 = 0.01**2, 0.03**2
    luminance = (2 * mean_product + c1) / (means + c1)
    structure = (2 * (product - mean_product) + c2) / (square - means + c2)
    return (luminance * structure).mean(1, keepdim=True)


def _blur(image: Float[Tensor, "b c h w"]) -> Float[Tensor, "b c h w"]:
    """Gaussian window of 11 x 11 pixels; beyond the border the image is mirrored."""
    weights = [math.exp(-((k - _WINDOW // 2) ** 2) / (2 * _SIGMA**2)) for k in range(_WINDOW)]
    kernel = tuple(weight / sum(weights) for weight in weights)
    planes = image.flatten(0, 1)
    made = along_columns(along_rows(planes, (kernel,), "reflect")[0], kernel, "reflect")
    return made.unflatten(0, image.shape[:2])


def lpips_maps(image: Float[Tensor, "b 3 h w"], target: Float[Tensor, "b 3 h w"]) -> Maps:
    """Distances between AlexNet features of the two, one map for each of five layers (Zhang et al. 2018, version 0.1).

    Raises:
        FileNotFoundError: the weights are not on this machine (nothing is ever downloaded).
        ValueError: images below 31 pixels, on which the network has no output.
    """
    if min(image.shape[-2:]) < 31:
        raise ValueError(f"LPIPS needs images of at least 31x31 pixels; these are {image.shape[-1]}x{image.shape[-2]}")
    layers, heads = (part.to(image.device) for part in _alexnet(Path(torch.hub.get_dir())))
    shift = torch.tensor([0.485, 0.456, 0.406], device=image.device)[:, None, None]
    scale = torch.tensor([0.229, 0.224, 0.225], device=image.device)[:, None, None]
    features = (torch.cat((image, target)) - shift) / scale
    maps = []
    with torch.no_grad():
        for layer, head in zip(layers, heads, strict=True):
            features = layer(features)
            unit = features / (features.square().sum(1, keepdim=True) + 1e-8).sqrt()
            a, b = unit.chunk(2)
            maps.append(head((a - b).square()))
    return tuple(maps)


def lpips_missing() -> str | None:
    """One sentence on which weights LPIPS lacks on this machine; None where it can run."""
    backbone, heads = _weight_files(Path(torch.hub.get_dir()))
    if not backbone.is_file():
        return f"LPIPS is left out: the AlexNet weights of torchvision are not at {backbone}"
    return None if heads.is_file() else f"LPIPS is left out: torchmetrics holds no {heads.name} at {heads}"


def _weight_files(hub: Path) -> tuple[Path, Path]:
    """AlexNet in torchvision's cache, and the weights of the LPIPS layers that torchmetrics ships."""
    spec = importlib.util.find_spec("torchmetrics")
    package = Path(spec.origin).parent if spec is not None and spec.origin is not None else Path("torchmetrics")
    return hub / "checkpoints" / "alexnet-owt-7be5be79.pth", package / "functional/image/lpips_models/alex.pth"


@lru_cache(maxsize=1)
def _alexnet(hub: Path) -> tuple[nn.ModuleList, nn.ModuleList]:
    """The five convolution stages of AlexNet, and one 1 x 1 convolution for the differences of each."""
    backbone, linear = _weight_files(hub)
    if not (backbone.is_file() and linear.is_file()):
        raise FileNotFoundError(lpips_missing())
    weights = torch.load(backbone, map_location="cpu", weights_only=True)
    scales = torch.load(linear, map_location="cpu", weights_only=True)
    stages, heads = nn.ModuleList(), nn.ModuleList()
    for k, (index, stride, padding, pool) in enumerate(_ALEXNET):
        kernel, bias = weights[f"features.{index}.weight"], weights[f"features.{index}.bias"]
        conv = nn.Conv2d(kernel.shape[1], kernel.shape[0], kernel.shape[-1], stride, padding)
        conv.load_state_dict({"weight": kernel, "bias": bias})
        head = nn.Conv2d(kernel.shape[0], 1, 1, bias=False)
        head.load_state_dict({"weight": scales[f"lin{k}.model.1.weight"]})
        stages.append(nn.Sequential(nn.MaxPool2d(3, 2) if pool else nn.Identity(), conv, nn.ReLU()))
        heads.append(head)
    return stages.requires_grad_(False), heads.requires_grad_(False)


def _difference(a: Tensor, b: Tensor) -> Maps:
    """Absolute difference, mean over the channels."""
    return ((a - b).abs().mean(1, keepdim=True),)


METRICS: dict[str, Metric] = {
    "psnr": Metric(lambda a, b: (squared_error(a, b),), True, PSNR_LIMIT, value=decibels),
    "ssim": Metric(lambda a, b: (ssim_map(a, b),), True, 1.0),
    "flip": Metric(lambda a, b: (flip_map(a, b),), False, 0.0),
    "flip-hdr": Metric(lambda a, b: (hdr_flip_map(a, b),), False, 0.0, compares="linear"),
    "lpips": Metric(lpips_maps, False, 0.0),
    "warped": Metric(_difference, False, 0.0, compares="change"),
    "flicker": Metric(_difference, False, 0.0, compares="roles"),
}
"""Every metric of images by name; for lpips see `lpips_missing`. warped is 0 where an image is wrong in the same way in
every frame, flicker where nobody can tell a generated frame from a shaded one."""


def psnr(
    image: Float[Tensor, "b 3 h w"], target: Float[Tensor, "b 3 h w"], mask: Bool[Tensor, "b 1 h w"] | None = None
) -> Float[Tensor, " b"]:
    """Peak signal-to-noise ratio in dB, from the mean squared error of all channels of the masked pixels."""
    return _score("psnr", image, target, mask)


def ssim(
    image: Float[Tensor, "b 3 h w"], target: Float[Tensor, "b 3 h w"], mask: Bool[Tensor, "b 1 h w"] | None = None
) -> Float[Tensor, " b"]:
    """Mean structural similarity, 1 for equal images; windows see the whole image, the mean the masked pixels."""
    return _score("ssim", image, target, mask)


def flip(
    image: Float[Tensor, "b 3 h w"], target: Float[Tensor, "b 3 h w"], mask: Bool[Tensor, "b 1 h w"] | None = None
) -> Float[Tensor, " b"]:
    """Mean FLIP, 0 for equal images, at most 1; the map sees the whole image, the mean the masked pixels."""
    return _score("flip", image, target, mask)


def lpips(
    image: Float[Tensor, "b 3 h w"], target: Float[Tensor, "b 3 h w"], mask: Bool[Tensor, "b 1 h w"] | None = None
) -> Float[Tensor, " b"] | None:
    """LPIPS-Alex, 0 for equal images; None where its weights are not on this machine (`lpips_missing` says which).

    A mask weights each feature by the share of masked pixels in its cell; features see beyond the mask.
    """
    return None if lpips_missing() else _score("lpips", image, target, mask)


def _score(name: str, image: Tensor, target: Tensor, mask: Tensor | None) -> Tensor:
    metric = METRICS[name]
    return metric.value(average(metric.maps(image, target), mask))


def measure(
    image: Float[Tensor, "1 3 h w"],
    target: Float[Tensor, "1 3 h w"],
    metrics: Sequence[str],
    regions: Mapping[str, Bool[Tensor, "1 1 h w"] | None],
) -> dict[tuple[str, str], float]:
    """Values of one image by (region, metric); a region is a mask, or None for all pixels.

    The maps of a metric are made once for all regions, and not at all for equal images, whose values are known.
    Regions without pixels are left out.
    """
    filled = {name: mask for name, mask in regions.items() if mask is None or bool(mask.any())}
    equal = torch.equal(image, target)
    values = {}
    for name in metrics:
        metric = METRICS[name]
        maps = () if equal else metric.maps(image, target)
        for region, mask in filled.items():
            value = metric.perfect if equal else float(metric.value(average(maps, mask)))
            values[region, name] = value
    return values
