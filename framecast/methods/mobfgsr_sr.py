"""Super-resolution of Mob-FGSR (section 3.5): a large history, warped by table, rectified, blended with samples.

Images of the history are compressed (`color.tonemap`) and lie on the pixels of the large image; vectors, depth and
what is decided from them stay small and are read at the sample nearest to each large pixel.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from framecast.frame import Frame
from framecast.methods.pair import Pair
from framecast.resample import (
    Box,
    catmull_rom,
    enlarge,
    enlarged_motion,
    nearest_sample,
    neighbourhood,
    size_at,
    tent,
)
from framecast.table import LEVELS, resample
from framecast.warp import fetch, inside, pick

PATIENCE = 32.0
"""Frames for which a still pixel may lie a little outside of its neighbourhood's colours before it is clamped: a cycle
of jitter at twice the size, in which samples meet whatever is thinner than a pixel."""

ALARM = 16.0
"""How many more frames each of them counts for, per distance outside: light that changes is not waited for so long."""

REST = 4.0
"""Samples' worth after which new samples change still pixels less and less, so that they come to rest."""

LEAST = 0.02
"""Weight of the farthest sample, so that every pixel is made of something."""


@dataclass(frozen=True)
class Enlarging:
    """State: the last two shaded frames, and their large images as far as they are known."""

    pair: Pair
    """Both frames as frame generation keeps them, without colour."""
    before: Float[Tensor, "b 3 H W"]
    """Image of the previous shaded frame, compressed."""
    image: Float[Tensor, "b 3 H W"]
    """Image of the current one, compressed."""
    weight: Float[Tensor, "b 1 H W"]
    """How many samples, each counted by how near it lay, the image is made of."""
    missed: Float[Tensor, "b 1 H W"]
    """Frames in a row in which a still pixel lay outside of its neighbourhood; more where it lay far outside."""
    depth: Float[Tensor, "b 1 h w"]
    """Of the current frame, each pixel's own."""
    motion: Float[Tensor, "b 2 h w"]
    """The same."""
    jitter: Float[Tensor, "b 2"]
    """Of the current frame."""


torch.export.register_dataclass(Enlarging)


@dataclass(frozen=True)
class Samples:
    """One shaded frame on the pixels of the large image."""

    color: Float[Tensor, "b 3 h w"]
    """As it was shaded, compressed."""
    image: Float[Tensor, "b 3 H W"]
    """Enlarged by itself, compressed."""
    weight: Float[Tensor, "b 1 H W"]
    """What its sample nearest to each pixel counts, at most 1."""
    nearest: Int[Tensor, "b H W"]
    """Index of that sample."""
    first: Float[Tensor, "b 3 H W"]
    """The frame enlarged softly, for pixels of which nothing else is known."""


def samples(color: Float[Tensor, "b 3 h w"], jitter: Float[Tensor, "b 2"], scale: float, falloff: float) -> Samples:
    """A shaded frame's compressed colour on large pixels, never beyond the colours around; the weight is the one of
    Eq. 2, 1 - b d, with d the distance to the nearest sample in small pixels."""
    small = (color.shape[-2], color.shape[-1])
    size = size_at(small, scale)
    nearest = nearest_sample(small, size, jitter)
    image = within(neighbourhood(color), enlarge(color, size, jitter, catmull_rom).image, nearest)
    x, y = _offset(small[1], size[1], jitter[:, 0])[:, None, :], _offset(small[0], size[0], jitter[:, 1])[:, :, None]
    weight = (1 - falloff * (x * x + y * y).sqrt()).clamp(min=LEAST)
    return Samples(color, image, weight[:, None], nearest, enlarge(color, size, jitter, tent, 2).image)


def within(box: Box, image: Float[Tensor, "b 3 H W"], nearest: Int[Tensor, "b H W"]) -> Float[Tensor, "b 3 H W"]:
    """A large image clamped to the small pixels' boxes."""
    return Box(pick(box.low, nearest), pick(box.high, nearest)).clamp(image)


def _offset(small: int, large: int, jitter: Float[Tensor, " b"]) -> Float[Tensor, "b n"]:
    """From each large pixel's centre to the nearest sample along one axis, in small pixels."""
    position = (torch.arange(large, device=jitter.device) + 0.5) * (small / large) - 0.5 - jitter[:, None]
    return (position + 0.5).floor() - position


def begin(pair: Pair, frame: Frame, first: Samples) -> Enlarging:
    """The state before the first frame, which knows nothing yet: the frame enters when it is shaded."""
    assert frame.depth is not None
    assert frame.motion is not None
    nothing = torch.zeros_like(first.weight)
    return Enlarging(pair, first.image, first.image, nothing, nothing, frame.depth, frame.motion, frame.jitter)


def advance(
    state: Enlarging,
    pair: Pair,
    frame: Frame,
    now: Samples,
    back: Float[Tensor, "b 2 h w"],
    gone: Bool[Tensor, "b 1 h w"],
    table: Float[Tensor, "32 32 16"],
    blend: float,
) -> Enlarging:
    """The state after a shaded frame.

    Args:
        pair: of this frame, as it is kept, and the one before; `back` leads from the first to the second, in small
            pixels.
        gone: small pixels of which the frame before shows nothing.
        blend: a of Eq. 2, what a sample counts that lies on the centre of a pixel.
    """
    assert frame.depth is not None
    assert frame.motion is not None
    motion = enlarged_motion(back, (now.image.shape[-2], now.image.shape[-1]), frame.jitter)
    gone = pick(gone, now.nearest)
    kept = ~gone & inside(motion) & ~frame.reset[:, None, None, None]
    history = resample(state.image, motion, table)
    clamped = within(neighbourhood(now.color), history, now.nearest)
    still = (motion.abs().amax(1, keepdim=True) < 0.5 / LEVELS) & kept
    outside = (clamped - history).abs().amax(1, keepdim=True)
    missed = torch.where(still & (outside > 0), state.missed + 1 + ALARM * outside, 0.0)
    steady = still & (missed <= PATIENCE)
    history = torch.where(steady, history, clamped)
    # There is time to wait for samples close to still pixels, which makes sharper images: the others count less.
    sample = torch.where(steady, now.weight**2, now.weight)
    weight = fetch(state.weight, motion)
    weight = torch.where(steady, weight, torch.where(kept, weight.clamp(max=1 / blend - 1), 0.0))
    known, weight = weight > 0, weight + sample
    share = sample / weight * torch.where(steady, (REST / weight).clamp(max=1), 1.0)
    image = torch.where(known, history + share * (now.image - history), now.first)
    before = torch.where(frame.reset[:, None, None, None], image, state.image)
    return Enlarging(pair, before, image, weight, missed, frame.depth, frame.motion, frame.jitter)
