"""What methods that make frames larger share: what they ask of frames, said before they meet a shape that they cannot
explain, and how networks see colour and depth."""

import warnings
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

from framecast.color import decode_srgb, encode_srgb, tonemap, untonemap
from framecast.frame import SKY, Frame
from framecast.resample import enlarged_motion, foreground, phases, size_at
from framecast.warp import disoccluded, fetch, inside, warp


@dataclass(frozen=True)
class Config:
    """The size."""

    scale: float = 2.0
    """Output size divided by input size."""


ELSEWHERE = 0.25
"""Render pixels a frame by which two surfaces beside each other move apart."""
TORN = 1.0
"""The same, from which on a vector of the one says nothing of what lies beside it."""
NEARER = 0.05
"""Part of its depth by which what hid a surface was nearer."""

WHITE = 1 - 2.0**-10
"""Largest tone-mapped value that comes back: 1023 in scene-linear colour."""

AROUND = tuple((y, x) for y in range(3) for x in range(3) if (y, x) != (1, 1))
"""Rows and columns, of 3 x 3 pixels, of those around the one in the middle."""
TAP = 0.5
"""Most that one of them adds to it or takes from it."""

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


class Unjittered(UserWarning):
    """Frames that say nothing of jitter, which is then taken as zero."""


def warn_of_stillness(before: Tensor, now: Tensor, name: str) -> None:
    """Warns where neither of two frames after one another was jittered."""
    if not bool(before.any() | now.any()):
        warnings.warn(
            f"these frames are not jittered: (0, 0) is written for each of them, or nothing, which is taken as that. "
            f"Every one samples a still scene at the same places then, and {name} cannot show more than one frame "
            f"holds; render with jitter (Halton (2, 3), see framecast.resample). If they were jittered, write it: in "
            f"clip.json, or by framecast import with the jitter in its settings (framecast doctor finds it). If they "
            f"were not, --jitter zero says so",
            Unjittered,
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


def unseen(
    frame: Frame, motion: Tensor, depth_before: Tensor, motion_before: Tensor, jitter_before: Tensor
) -> Bool[Tensor, "b 1 h w"]:
    """Pixels without history for methods that follow the nearest surface around: `uncovered` ones, and those that lie
    or lay beside something fast. Arguments are those of `uncovered`."""
    assert frame.depth is not None
    hidden = uncovered(frame, motion, depth_before, motion_before, jitter_before)
    beside = torch.cat(foreground(depth_before, motion_before), 1)
    passed = fetch(beside, motion + (frame.jitter - jitter_before)[:, :, None, None])
    return hidden | torn(frame.depth, motion) | in_front(passed, frame.depth, motion)


def torn(depth: Float[Tensor, "b 1 h w"], motion: Float[Tensor, "b 2 h w"]) -> Bool[Tensor, "b 1 h w"]:
    """Pixels beside something nearer that moves by another pixel and more.

    Their history is not to be had: the vector of the nearest surface leads to what lay beside it then, which was
    something else, and on the way of their own vector that thing's edge has left its colours.
    """
    return in_front(torch.cat(foreground(depth, motion), 1), depth, motion)


def in_front(near: Float[Tensor, "b 3 h w"], depth: Tensor, motion: Tensor) -> Bool[Tensor, "b 1 h w"]:
    """Where depth and vector of something near are those of a nearer thing that moves otherwise by `TORN`."""
    return ((near[:, 1:] - motion).abs().amax(1, keepdim=True) > TORN) & (near[:, :1] < depth * (1 - NEARER))


def settled(
    frame: Frame,
    added: Float[Tensor, "b c H W"],
    before: Float[Tensor, "b c H W"],
    still: Float[Tensor, "b 1 H W"],
    scale: float,
) -> Float[Tensor, "b c H W"]:
    """What a network adds to an accumulated image: where that stands still the mean of what it made of all those
    frames, newer ones counting more, complete after two periods of the jitter; elsewhere what it made of this one.

    Args:
        before: the same of the last frame.
        still: frames since a pixel moved or changed.
    """
    assert frame.depth is not None
    assert frame.motion is not None
    motion = where(frame.reset, torch.zeros_like(frame.motion), frame.motion)
    large = enlarged_motion(foreground(frame.depth, motion)[1], (added.shape[-2], added.shape[-1]), frame.jitter)
    share = (2 - still / phases(scale)).clamp(0, 1) * 2 / (still + 2)
    return (1 - share) * warp(before, large) + share * added


def sharpened(image: Float[Tensor, "b 3 H W"], taps: Float[Tensor, "b 8 H W"]) -> Float[Tensor, "b 3 H W"]:
    """What to add to an image for it to go towards each of the 8 pixels around (`AROUND`), or away from them.

    Beyond the border the pixel at it is seen. `taps` are logits: 0 adds nothing, and none more than `TAP` of a
    difference.
    """
    height, width = image.shape[-2:]
    wide, added = F.pad(image, (1, 1, 1, 1), mode="replicate"), torch.zeros_like(image)
    for (y, x), tap in zip(AROUND, (TAP * torch.tanh(taps)).split(1, 1), strict=True):
        added = added + tap * (wide[..., y : y + height, x : x + width] - image)
    return added


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
