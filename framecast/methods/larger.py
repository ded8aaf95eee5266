"""What methods that make frames larger share: what they ask of frames, said before they meet a shape that they cannot
explain, and how networks see colour and depth."""

import warnings
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from framecast.color import decode_srgb, encode_srgb, tonemap, untonemap
from framecast.frame import SKY, Frame
from framecast.resample import size_at
from framecast.warp import disoccluded, fetch, inside


@dataclass(frozen=True)
class Config:
    """The size."""

    scale: float = 2.0
    """Output size divided by input size."""


ELSEWHERE = 0.25
"""Render pixels a frame by which two surfaces beside each other move apart."""
NEARER = 0.05
"""Part of its depth by which what hid a surface was nearer."""

WHITE = 1 - 2.0**-10
"""Largest tone-mapped value that comes back: 1023 in scene-linear colour."""

SAME, TWICE = Config(scale=1.0), Config()


def require(frame: Frame, name: str, needs: tuple[str, ...]) -> None:
    """Raises ValueError where `frame` has no colour or lacks buffers, or where they are not all of one size."""
    lacking = [field for field in needs if getattr(frame, field) is None]
    if lacking:
        raise ValueError(
            f"{name} makes shaded frames larger and needs their {' and '.join(needs)}; the frame at time "
            f"{float(frame.time[0]):g} has no {' and no '.join(lacking)}"
        )
    sizes = {field: tuple(getattr(frame, field).shape[-2:]) for field in needs}
    odd = next((field for field in needs if sizes[field] != sizes["color"]), None)
    if odd is not None:
        (height, width), (tall, wide) = sizes["color"], sizes[odd]
        raise ValueError(
            f"{odd} has {wide}x{tall} pixels and color {width}x{height}; {name} needs all buffers at the size of the "
            f"colour: write {odd} at render size, in pixels of that size"
        )


def warn_of_stillness(before: Tensor, now: Tensor, name: str) -> None:
    """Warns where neither of two frames after one another was jittered."""
    if not bool(before.any() | now.any()):
        warnings.warn(
            f"these frames are not jittered, so every one of them samples a still scene at the same places, and {name} "
            f"cannot show more than one frame holds; render with jitter (Halton (2, 3), see framecast.resample), or "
            f"import the clip again with the jitter it was rendered with",
            stacklevel=3,
        )


def uncovered(
    frame: Frame, motion: Tensor, depth_before: Tensor, motion_before: Tensor, jitter_before: Tensor
) -> Tensor:
    """Pixels on the screen of the frame before whose surface it did not show there: b 1 h w.

    Asked of each pixel's own depth and vector: those of the nearest surface around it would say that what a thing
    uncovers beside itself is that thing.

    Args:
        motion: from each pixel to its place in the frame before, b 2 h w; that frame's own `motion_before` likewise.
        jitter_before: of the frame before, b 2: its samples lie elsewhere.
    """
    assert frame.depth is not None
    target = motion + (frame.jitter - jitter_before)[:, :, None, None]
    covered = disoccluded(frame.depth, depth_before, target)
    # Beside an edge the 3 x 3 pixels of that test hold both sides: what lay in front and moves elsewhere hid it, too.
    before = fetch(torch.cat((depth_before, motion_before), 1), target)
    elsewhere = (before[:, 1:] - motion).abs().amax(1, keepdim=True) > ELSEWHERE
    return (covered & inside(target)) | (elsewhere & (before[:, :1] < frame.depth * (1 - NEARER)))


def output_size(frame: Frame, scale: float) -> tuple[int, int]:
    """Height and width of the image made from a shaded frame."""
    assert frame.color is not None
    return size_at((frame.color.shape[-2], frame.color.shape[-1]), scale)


def where(choose: Tensor, a: Tensor, b: Tensor) -> Tensor:
    """Of each batch entry `a` where chosen, else `b`."""
    return torch.where(choose.view(-1, *[1] * (a.ndim - 1)), a, b)


def nearness(depth: Float[Tensor, "b 1 h w"]) -> Float[Tensor, "b 1 h w"]:
    """Depth d as 1/2 + 5 / (d + 10): 1 at the camera, 1/2 at the sky, the same from frame to frame."""
    return torch.where(depth < SKY, 0.5 + 5 / (depth + 10), 0.5)


def decoded(image: Float[Tensor, "b 3 H W"]) -> Float[Tensor, "b 3 H W"]:
    """Scene-linear colour of an image that was tone-mapped and put under the sRGB curve."""
    return untonemap(decode_srgb(image.clamp(0, 1)).clamp(max=WHITE))


def encoded(color: Float[Tensor, "b 3 H W"]) -> Float[Tensor, "b 3 H W"]:
    """Inverse of `decoded`, up to WHITE."""
    return encode_srgb(tonemap(color).clamp(max=WHITE))
