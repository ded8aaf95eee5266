"""Light mixed of what is known, in place of colours that a network would have to know of scenes it has never seen."""

from collections.abc import Callable, Sequence

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, library

from framecast.methods.larger import AROUND
from framecast.methods.reproject import squared

REACH = (1, 3)
"""How far away the pixels around are, in rows and columns."""

BESIDE = len(REACH) * len(AROUND)
"""How many they are."""

TILE = 65536
"""Pixels that are done at a time on a CPU."""

SMOOTH = 9
"""Side of the square over which changes of light are means, pixels: that of `of_nine`."""

FEW = 0.02
"""Part of that square that has to be known for its mean to count fully."""


def mixed(
    base: Float[Tensor, "b 3 h w"],
    differences: Sequence[Float[Tensor, "b 3 h w"]],
    surfaces: Float[Tensor, "b d h w"],
    logits: Float[Tensor, "b n h w"],
) -> Float[Tensor, "b 3 h w"]:
    """What is added to the base for it to go a part of the way, in (-1, 1), towards other light; 0 for logits of 0.

    Args:
        differences: to other images, or any images to be added: the first logits.
        surfaces: `reproject.likeness` of the frame. The other logits, for each distance of `REACH` 8, are of the pixels
            around, which count by as much as their surface is like. Beyond the border lies the pixel at it.
    """
    first, parts = torch.tanh(logits).split((len(differences), BESIDE), 1)
    on_few_cores = base.device.type == "cpu" and not torch.is_grad_enabled()
    added = light_around(base, surfaces, parts) if on_few_cores else _around(base, surfaces, parts, base.shape[-2])
    for difference, part in zip(differences, first.split(1, 1), strict=True):
        added = added + part * difference
    return added


@library.custom_op("framecast::light_around", mutates_args=())
def light_around(base: Tensor, surfaces: Tensor, parts: Tensor) -> Tensor:
    """What the pixels around add, a few rows at a time, which stay in the caches of a core. Compiled code calls this as
    it is."""
    return _around(base, surfaces, parts, max(1, TILE // base.shape[-1])).contiguous()


@light_around.register_fake
def _(base: Tensor, surfaces: Tensor, parts: Tensor) -> Tensor:
    return torch.empty_like(base, memory_format=torch.contiguous_format)


def _around(
    base: Float[Tensor, "b 3 h w"], surfaces: Float[Tensor, "b d h w"], parts: Float[Tensor, "b n h w"], rows: int
) -> Float[Tensor, "b 3 h w"]:
    """The same, `rows` rows at a time."""
    (height, width), edge, found = base.shape[-2:], max(REACH), []
    wide = F.pad(torch.cat((base, surfaces), 1), [edge] * 4, mode="replicate")
    places = [((y - 1) * distance, (x - 1) * distance) for distance in REACH for y, x in AROUND]
    for top in range(0, height, rows):
        end = min(top + rows, height)
        here = wide[..., edge + top : edge + end, edge : edge + width]
        added = torch.zeros_like(here[:, :3])
        for (y, x), part in zip(places, parts[..., top:end, :].split(1, 1), strict=True):
            apart = wide[..., edge + y + top : edge + y + end, edge + x : edge + x + width] - here
            added = added + part * torch.exp(-squared(apart[:, 3:])) * apart[:, :3]
        found.append(added)
    return torch.cat(found, 2)


def change(before: Float[Tensor, "b 4 h w"], after: Float[Tensor, "b 4 h w"]) -> Float[Tensor, "b 4 h w"]:
    """Change of light from one warped frame to another, and 1, where both show the surface (fourth channel); else 0."""
    both = before[:, 3:] * after[:, 3:]
    return torch.cat(((after - before)[:, :3] * both, both), 1)


def around(change: Float[Tensor, "b 4 h w"]) -> Float[Tensor, "b 3 h w"]:
    """Its mean over a square of `SMOOTH` pixels, of those where it is known; less where hardly any are."""
    mean = of_nine(torch.add, change) / SMOOTH**2
    return mean[:, :3] / mean[:, 3:].clamp(min=FEW)


def of_nine(combine: Callable[[Tensor, Tensor], Tensor], image: Float[Tensor, "b c h w"]) -> Float[Tensor, "b c h w"]:
    """The sum, or the maximum, of the 9 x 9 pixels around each, zeros beyond the border: by two, four and eight, first
    across, then down, eight steps where a pool takes eighty."""
    for dim, pad in ((-1, (4, 4, 0, 0)), (-2, (0, 0, 4, 4))):
        one = F.pad(image, pad)
        size = one.shape[dim]
        two = combine(one.narrow(dim, 0, size - 1), one.narrow(dim, 1, size - 1))
        four = combine(two.narrow(dim, 0, size - 3), two.narrow(dim, 2, size - 3))
        eight = combine(four.narrow(dim, 0, size - 7), four.narrow(dim, 4, size - 7))
        image = combine(eight.narrow(dim, 0, size - 8), one.narrow(dim, 8, size - 8))
    return image
