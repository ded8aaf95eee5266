"""What `classifier` looks at: the buffers of its supplement at display size, of a frame and of what is known before it.

Colours are tone-mapped, x / (1 + max).
"""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

from framecast.color import encode_srgb, tonemap
from framecast.frame import Frame, inverse_depth
from framecast.methods.larger import WHITE, nearness
from framecast.methods.reproject import chosen, steps
from framecast.resample import (
    Box,
    catmull_rom,
    enlarge,
    enlarged_motion,
    foreground,
    gaussian,
    nearest_sample,
    neighbourhood,
    sharp_warp,
    tent,
)
from framecast.warp import fetch, inside, pick, warp

CLASSES = 6
"""Ghosting: visibility, shading, none; aliasing: geometry, texture, none."""

BLUR = 0.8
"""Part of its worth that history loses when it is read half-way between pixels in both directions."""


STILL = 1e-3
"""Motion in display pixels a frame below which a pixel stands still."""
BLOCK = 8
"""Side of the squares of display pixels whose brightness tells whether light changed."""
LATELY = 8
"""Frames over which that is averaged, so that one phase of the jitter does not decide."""
CHANGED = 0.02
"""How much brighter or darker squares have to be, as displayed, beyond half of what their pixels differ by."""


@dataclass(frozen=True)
class Rest:
    """What stands still."""

    frames: Float[Tensor, "b 1 H W"]
    """Since the pixel moved or changed."""
    drift: Float[Tensor, "b 3 n m"]
    """By how much squares of frames were brighter than history of late, under the sRGB curve."""


@dataclass(frozen=True)
class State:
    """The last frame, at display size."""

    image: Float[Tensor, "b 3 H W"]
    """Tone-mapped; what was accumulated, before it was sharpened."""
    worth: Float[Tensor, "b 1 H W"]
    """Samples that it is made of."""
    depth: Float[Tensor, "b 1 H W"]
    """Reversed: 1 / depth, 0 at the sky."""
    counter: Float[Tensor, "b 1 H W"]
    """Frames before it since history failed."""
    range: Float[Tensor, "b 6 H W"]
    """Smallest and largest tone-mapped colour, under the sRGB curve."""
    classes: Float[Tensor, "b 6 H W"]
    """Likelihoods, in the order of `CLASSES`; 1/3 each: nothing is known."""
    rest: Rest
    time: Float[Tensor, " b"]
    jitter: Float[Tensor, "b 2"]
    known: Bool[Tensor, " b"]
    """False before the first frame."""


for _kind in (Rest, State):
    torch.export.register_dataclass(_kind)


@dataclass(frozen=True)
class Seen:
    """A frame and what is known of the last one at its places; where nothing is, the frame itself stands in."""

    sharp: Float[Tensor, "b 3 H W"]
    """The frame enlarged by cubics, tone-mapped."""
    smooth: Float[Tensor, "b 3 H W"]
    """The same, linearly."""
    history: Float[Tensor, "b 3 H W"]
    """Tone-mapped."""
    bounded: Float[Tensor, "b 3 H W"]
    """The same within the colours of the 3 x 3 samples around."""
    worth: Float[Tensor, "b 1 H W"]
    """Samples that history is made of; 0 where not valid."""
    valid: Bool[Tensor, "b 1 H W"]
    """Where there is history at all."""
    motion: Float[Tensor, "b 2 H W"]
    """To the last frame, display pixels; 0 where not valid."""
    depth: Float[Tensor, "b 1 H W"]
    """Reversed."""
    nearness: Float[Tensor, "b 1 H W"]
    """Depth for networks."""
    difference: Float[Tensor, "b 1 H W"]
    """Reversed depth there less that here, relative to the larger: above 0 something nearer was there."""
    counter: Float[Tensor, "b 1 H W"]
    """Of the last frame."""
    range: Float[Tensor, "b 6 H W"]
    """Of the last frame."""
    range_now: Float[Tensor, "b 6 H W"]
    classes: Float[Tensor, "b 6 H W"]
    """Of the last frame."""
    confidence: Float[Tensor, "b 1 H W"]
    """1 where a sample of the frame lies on the pixel's centre, falling with its distance."""
    blur: Float[Tensor, "b 1 H W"]
    """0 where history was read on the centre of a pixel, 1 half-way between pixels in both directions."""
    shown: Float[Tensor, "b 6 H W"]
    """`sharp` and `history` under the sRGB curve."""


def look(frame: Frame, state: State, scale: float) -> Seen:
    """The auxiliary buffers of a frame, at display size."""
    assert frame.color is not None
    assert frame.depth is not None
    small, size = ((x.shape[-2], x.shape[-1]) for x in (frame.depth, state.image))
    color, jitter = tonemap(frame.color).clamp(max=WHITE), frame.jitter
    nearest = nearest_sample(small, size, jitter)
    around = neighbourhood(color)
    depth, low, high = pick(torch.cat((frame.depth, around.low, around.high), 1), nearest).split((1, 3, 3), 1)
    # By itself: as a part of others it would lie otherwise in memory than that of `start`, and be compiled for twice.
    range_now = pick(encode_srgb(torch.cat((around.low, around.high), 1)), nearest)
    motion = steps(frame, state.time, jitter)  # both images lie on whole pixels: their jitter is the same
    motion = foreground(frame.depth, chosen(frame.reset, torch.zeros_like(motion), motion))[1]
    motion = enlarged_motion(motion, size, jitter)
    valid = inside(motion) & (state.known & ~frame.reset)[:, None, None, None]
    motion = torch.where(valid, motion, 0.0)
    sharp = enlarge(color, size, jitter, catmull_rom, 4).image.clamp(0, WHITE)
    smooth = enlarge(color, size, jitter, tent, 2).image
    there, counter, range_there = fetch(torch.cat((state.depth, state.counter, state.range), 1), motion).split(
        (1, 1, 6), 1
    )
    here = inverse_depth(depth)
    difference = (there - here) / torch.maximum(there, here).clamp(min=1e-6)
    fraction = motion - motion.floor()
    blur = 2 * (fraction * (1 - fraction)).sum(1, keepdim=True)
    worth, classes = warp(torch.cat((state.worth, state.classes), 1), motion).split((1, 6), 1)
    history = torch.where(valid, sharp_warp(state.image, motion), smooth)
    return Seen(
        sharp=sharp,
        smooth=smooth,
        history=history,
        bounded=Box(low, high).clamp(history),
        worth=torch.where(valid, worth * (1 - BLUR * blur), 0.0),
        valid=valid,
        motion=motion,
        depth=here,
        nearness=nearness(depth),
        difference=torch.where(valid, difference, 0.0),
        counter=torch.where(valid, counter, 0.0),
        range=torch.where(valid, range_there, range_now),
        range_now=range_now,
        classes=torch.where(valid, classes, 1 / 3),
        confidence=enlarge(frame.depth, size, jitter, lambda x: gaussian(scale * x), 3).peak,
        blur=blur,
        shown=encode_srgb(torch.cat((sharp, history), 1)),
    )


def rested(seen: Seen, before: Rest, ghost: Bool[Tensor, "b 1 H W"], fresh: Bool[Tensor, " b"]) -> Rest:
    """What stands still with this frame, too.

    Args:
        ghost: pixels whose history fails.
        fresh: frames without any history.
    """
    sharp, history = seen.shown.chunk(2, 1)
    mean, size = (squares(off) for off in (sharp - history, (sharp - history).abs()))
    drift = chosen(fresh, mean, before.drift + (mean - before.drift) / LATELY)
    changed = (drift.abs() > CHANGED + size / 2).any(1, keepdim=True).float()
    height, width = seen.depth.shape[-2:]
    changed = F.interpolate(changed, scale_factor=float(BLOCK), mode="nearest")[..., :height, :width] > 0
    still = seen.valid & (seen.motion.abs().amax(1, keepdim=True) < STILL) & ~ghost & ~changed
    return Rest(torch.where(still, before.frames + 1, 0.0), drift)


def squares(image: Float[Tensor, "b c H W"]) -> Float[Tensor, "b c n m"]:
    """Means over squares of pixels, the last ones cut off by the border."""
    return F.avg_pool2d(image, BLOCK, BLOCK, ceil_mode=True, count_include_pad=False)
