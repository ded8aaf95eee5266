"""Light mixed of what is known, in place of colours that a network would have to know of scenes it has never seen."""

from collections.abc import Sequence

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from framecast.methods.larger import AROUND
from framecast.methods.reproject import squared

REACH = (1, 3)
"""How far away the pixels around are, in rows and columns."""

BESIDE = len(REACH) * len(AROUND)
"""How many they are."""

SMOOTH = 9
"""Side of the square over which changes of light are means, pixels."""

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
    height, width = base.shape[-2:]
    first, *beside = torch.tanh(logits).split((len(differences), *[len(AROUND)] * len(REACH)), 1)
    added = torch.zeros_like(base)
    for difference, part in zip(differences, first.split(1, 1), strict=True):
        added = added + part * difference
    known = torch.cat((base, surfaces), 1)
    for distance, parts in zip(REACH, beside, strict=True):
        wide = F.pad(known, [distance] * 4, mode="replicate")
        for (y, x), part in zip(AROUND, parts.split(1, 1), strict=True):
            apart = wide[..., distance * y :, distance * x :][..., :height, :width] - known
            alike = torch.exp(-squared(apart[:, 3:]).clamp(max=30))
            added = added + part * alike * apart[:, :3]
    return added


def change(before: Float[Tensor, "b 4 h w"], after: Float[Tensor, "b 4 h w"]) -> Float[Tensor, "b 4 h w"]:
    """Change of light from one warped frame to another, and 1, where both show the surface (fourth channel); else 0."""
    both = before[:, 3:] * after[:, 3:]
    return torch.cat(((after - before)[:, :3] * both, both), 1)


def around(change: Float[Tensor, "b 4 h w"]) -> Float[Tensor, "b 3 h w"]:
    """Its mean over a square of `SMOOTH` pixels, of those where it is known; less where hardly any are."""
    mean = F.avg_pool2d(change, SMOOTH, 1, SMOOTH // 2)
    return mean[:, :3] / mean[:, 3:].clamp(min=FEW)
