"""FSR2: temporal upsampling with locks for thin features and a test of depth for what was hidden.

Paper:   AMD, FidelityFX Super Resolution 2.2, published description of its passes, 2022, https://gpuopen.com/fidelityfx-fsr2.
         Written from the description alone.
Follows: nearest depth and its vector in 3 x 3; depth scattered to where it was one frame ago, and pixels hidden there
         by something nearer; locks where one pixel stands out as a ridge, with a life that samples use up; changes of
         coarse brightness that end locks; history by a Lanczos kernel of 4 x 4; the box around a Gaussian neighbourhood
         whose size depends on speed; instability of brightness over four frames; weights limited by speed.
Differs: No exposure, reactive or transparency masks, no divergence of motion, no sharpening: nothing that a frame here
         carries feeds them.
         Kernels are separable. A one-dimensional Lanczos of the distance, as published, sharpens along diagonals.
         Surfaces must be apart by a fiftieth of their depth at least: the published constant, which falls with
         resolution, takes slanted floors of small frames for edges; twice the surface's own slope is allowed, too.
         Weights are not limited to 12 samples where nothing moves, and what has been still for two periods of the
         jitter stays as long as coarse brightness does: published, a still picture goes on to shimmer.
         History read between pixels loses weight, because that blurs it; not where it is locked.
         Beside what moves by other pixels there is no history (`larger.torn`): reconstructed depth is that of the
         nearest surface around, which hides nothing there.
         A lock holds all display pixels nearest to its sample: the one that contains it is, in motion, spread out and
         lost before the next sample meets the feature. For the same reason samples far from a pixel do not lower the
         weight of its history. A wire thinner than a display pixel keeps most of its contrast (tests/test_fsr2.py).
Needs:   color, depth, motion
Modes:   pass
State:   the accumulated image, its weight, locks and four frames of brightness at display size
"""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor, nn

from framecast.color import encode_srgb, luminance, tonemap, untonemap
from framecast.frame import Frame
from framecast.methods.filters import bounded_lanczos
from framecast.methods.larger import TWICE, Config, output_size, require, torn, warn_of_stillness, where
from framecast.methods.mobfgsr import present
from framecast.methods.reproject import reaching
from framecast.resample import (
    Box,
    enlarge,
    enlarged_motion,
    foreground,
    from_ycocg,
    lanczos,
    nearest_sample,
    neighbourhood,
    phases,
    sharp_warp,
    to_ycocg,
)
from framecast.warp import inside, key_depth, pick, splat, warp

FULL = 12.0
"""Sum of the weights of as many samples as a moving history may weigh."""
APART = 0.02
"""Part of the depth by which two surfaces differ at least."""
RIDGE = 1.05
"""Ratio of brightness from which on neighbours differ."""
SHADED = 0.1
"""Change of coarse brightness that ends a lock."""
STILL = 0.1
"""Motion in display pixels a frame below which a pixel counts as still."""
BLUR = 0.8
"""Part of its weight that history loses when it is read half-way between pixels in both directions."""


@dataclass(frozen=True)
class History:
    """What is known of the frames before, at display size. Colour is YCoCg of tone-mapped colour."""

    color: Float[Tensor, "b 3 H W"]
    weight: Float[Tensor, "b 1 H W"]
    """Sum of the weights of samples; 0: nothing is known."""
    life: Float[Tensor, "b 1 H W"]
    """Of a lock: 0 none, up to 2."""
    coarse: Float[Tensor, "b 1 H W"]
    """Brightness of the surroundings, accumulated."""
    lumas: Float[Tensor, "b 4 H W"]
    """Brightness of the last four frames, newest first."""
    still: Float[Tensor, "b 1 H W"]
    """Frames since the pixel moved or changed."""
    time: Float[Tensor, " b"]
    jitter: Float[Tensor, "b 2"]


torch.export.register_dataclass(History)


class FSR2(nn.Module):
    """See the top of this file."""

    needs: tuple[str, ...] = ("color", "depth", "motion")
    needs_generated: tuple[str, ...] = ()
    modes: tuple[str, ...] = ("pass",)
    scales: tuple[float, ...] = (1.5, 2.0, 3.0)
    parts = ("accumulate",)
    history: int | None = None
    step_motion: bool = False

    def __init__(self, config: Config = TWICE) -> None:
        super().__init__()
        self.config = config

    def start(self, frame: Frame) -> History:
        """The state before the first frame, which is `frame`: nothing."""
        require(frame, "fsr2", self.needs)
        size = output_size(frame, self.config.scale)
        color = present(frame.color)
        three, four, *ones = (color.new_zeros(len(color), channels, *size) for channels in (3, 4, 1, 1, 1, 1))
        weight, life, coarse, still = ones
        return History(three, weight, life, coarse, four, still, frame.time, torch.ones_like(frame.jitter))

    def forward(self, frame: Frame, state: History) -> tuple[Float[Tensor, "b 3 H W"], History]:
        """The image of a shaded frame at display size, linear and at least 0, and what is known then.

        Raises:
            ValueError: the frame was not shaded, or its buffers are of different sizes.
        """
        require(frame, "fsr2", self.needs)
        warn_of_stillness(state.jitter, frame.jitter, "fsr2")
        return self.accumulate(reaching(frame, state.time), state)

    def accumulate(self, frame: Frame, state: History) -> tuple[Float[Tensor, "b 3 H W"], History]:
        """The arithmetic of `forward`, for a frame with motion to the last one."""
        return accumulate(frame, state, self.config.scale)


def hidden_before(depth: Float[Tensor, "b 1 h w"], motion: Float[Tensor, "b 2 h w"]) -> Float[Tensor, "b 1 h w"]:
    """0 where the surface was visible one frame ago, 1 where something nearer covered it then.

    Both arguments are of the nearest surface in 3 x 3. Every surface of this frame is sent to where it was, to the four
    pixels around that place, the nearest one staying; a surface that finds another one in front of it was hidden.
    """
    corners = [motion + motion.new_tensor([x, y]).view(1, 2, 1, 1) for x in (-0.5, 0.5) for y in (-0.5, 0.5)]
    keys = splat(depth, corners[0])
    for corner in corners[1:]:
        keys = torch.minimum(keys, splat(depth, corner))
    gap = depth - warp(key_depth(keys).clamp(max=65504.0), motion)
    required = APART * depth + 2 * slope(depth)
    return (1 - required / gap.clamp(min=1e-6)).clamp(0, 1) * (gap > 0)


def slope(depth: Float[Tensor, "b 1 h w"]) -> Float[Tensor, "b 1 h w"]:
    """How much the depth of a surface changes from pixel to pixel, along both axes; edges do not count."""
    around = F.pad(depth, (1, 1, 1, 1), mode="replicate")
    up, down = around[..., :-2, 1:-1], around[..., 2:, 1:-1]
    left, right = around[..., 1:-1, :-2], around[..., 1:-1, 2:]
    across = torch.minimum((right - depth).abs(), (depth - left).abs())
    return across + torch.minimum((down - depth).abs(), (depth - up).abs())


def ridges(luma: Float[Tensor, "b 1 h w"]) -> Bool[Tensor, "b 1 h w"]:
    """Pixels that stand out from their 3 x 3 neighbourhood and belong to nothing two pixels wide: what deserves a lock.

    A neighbour differs when one of the two is brighter by a twentieth. The pixel must be brighter, or darker, than all
    that differ, and no 2 x 2 block that contains it may be alike. `luma` must be positive.
    """
    height, width = luma.shape[-2:]
    around = F.pad(luma, (1, 1, 1, 1), mode="replicate")
    ring = {(y, x): around[..., 1 + y : 1 + y + height, 1 + x : 1 + x + width] for y in (-1, 0, 1) for x in (-1, 0, 1)}
    del ring[0, 0]
    alike = {at: torch.maximum(v, luma) < RIDGE * torch.minimum(v, luma) for at, v in ring.items()}
    above = torch.stack([alike[at] | (luma > v) for at, v in ring.items()]).all(0)
    below = torch.stack([alike[at] | (luma < v) for at, v in ring.items()]).all(0)
    blocks = [alike[y, 0] & alike[0, x] & alike[y, x] for y in (-1, 1) for x in (-1, 1)]
    return (above | below) & ~(blocks[0] | blocks[1] | blocks[2] | blocks[3])


def brightness(linear: Float[Tensor, "b 3 h w"]) -> Float[Tensor, "b 1 h w"]:
    """Perceived brightness of tone-mapped colour, at least 0.01."""
    return encode_srgb(luminance(tonemap(linear))).clamp(min=0.01)


def coarse_brightness(luma: Float[Tensor, "b 1 h w"], size: tuple[int, int]) -> Float[Tensor, "b 1 H W"]:
    """Geometric mean of blocks of 8 x 8 pixels, smoothly enlarged to `size`."""
    blocks = F.avg_pool2d(luma.log(), 8, 8, ceil_mode=True, count_include_pad=False)
    return F.interpolate(blocks, size, mode="bilinear").exp()


@dataclass(frozen=True)
class Now:
    """What one frame shows, at display size."""

    image: Float[Tensor, "b 3 H W"]
    weight: Float[Tensor, "b 1 H W"]
    mean: Float[Tensor, "b 3 H W"]
    deviation: Float[Tensor, "b 3 H W"]
    around: Box
    luma: Float[Tensor, "b 1 H W"]
    coarse: Float[Tensor, "b 1 H W"]
    lock: Bool[Tensor, "b 1 H W"]
    """Where a lock begins: the pixels nearest to the sample of a ridge."""
    motion: Float[Tensor, "b 2 H W"]
    hidden: Float[Tensor, "b 1 H W"]
    """1 where history shows something else, 0 where it can be used."""


def enlarged(frame: Frame, scale: float) -> Now:
    """A shaded frame at display size."""
    color, size = present(frame.color), output_size(frame, scale)
    luma, mapped = brightness(color), to_ycocg(tonemap(color))
    nearest = nearest_sample((color.shape[-2], color.shape[-1]), size, frame.jitter)
    motion = where(frame.reset, torch.zeros_like(present(frame.motion)), present(frame.motion))
    beside = torn(present(frame.depth), motion)
    depth, motion = foreground(present(frame.depth), motion)
    soft = enlarge(torch.cat((mapped, mapped * mapped), 1), size, frame.jitter, lambda x: torch.exp(-2.5 * x * x), 3)
    mean, square = soft.image.split(3, 1)
    box = neighbourhood(mapped)
    narrow = enlarge(luma, size, frame.jitter, lambda x: lanczos(x * scale).clamp(min=0), 3)
    lost = pick(torch.maximum(hidden_before(depth, motion), beside.to(depth.dtype)), nearest)
    large = enlarged_motion(motion, size, frame.jitter)
    gone = ~inside(large) | frame.reset[:, None, None, None]
    image = bounded_lanczos(mapped, size, frame.jitter)
    return Now(
        image=image,
        weight=narrow.peak.clamp(min=0.02),
        mean=mean,
        deviation=(square - mean * mean).clamp(min=0).sqrt(),
        around=Box(pick(box.low, nearest), pick(box.high, nearest)),
        luma=(image[:, :1] * 255).round() / 255,
        coarse=coarse_brightness(luma, size),
        lock=pick(ridges(luma), nearest),
        motion=large,
        hidden=torch.where(gone, 1.0, lost),
    )


def accumulate(frame: Frame, state: History, scale: float) -> tuple[Float[Tensor, "b 3 H W"], History]:
    """The image of a shaded frame at display size and what is known then."""
    now = enlarged(frame, scale)
    known = torch.cat((state.weight, state.life, state.coarse, state.lumas, state.still), 1)
    weight, life, coarse, lumas, still = warp(known, now.motion).split((1, 1, 1, 4, 1), 1)
    history = sharp_warp(state.color, now.motion, lanczos)
    fresh = (now.hidden > 0.99) | (weight <= 0)
    speed = now.motion.square().sum(1, keepdim=True).sqrt()
    coarse = torch.where(fresh, now.coarse, coarse)
    change = 1 - torch.minimum(coarse, now.coarse) / torch.maximum(coarse, now.coarse).clamp(min=1e-6)
    shaded = change > SHADED
    still = torch.where(fresh | shaded | (speed > STILL), 0.0, still + 1)
    period = phases(scale)
    done = (still / period - 1).clamp(0, 1)

    keep = ~shaded & (now.hidden < 0.1) & ~fresh
    life = torch.where(keep, life, 0.0)
    life = torch.where(now.lock, torch.where(life > 0, 2.0, 1.0), life)
    locked = (4 * (life - 1)).clamp(0, 1) * (1 - change)

    # The box, and how much of what lies outside of it is believed.
    wide = min(20.0, scale**6)
    calm = 1 - torch.maximum(now.hidden, (speed / 20).clamp(max=1))
    half = now.deviation * (1 + (wide - 1) * calm)
    box = Box(torch.maximum(now.mean - half, now.around.low), torch.minimum(now.mean + half, now.around.high))
    clamped = box.clamp(history)
    trust = torch.maximum(torch.maximum(locked, done), unstable(now, lumas, change))
    outside = ((clamped - history).abs().amax(1, keepdim=True) > 1e-4) & (trust < 1)
    believed = clamped + trust * (history - clamped)
    fraction = now.motion - now.motion.floor()
    blurred = BLUR * (1 - locked) * (2 * fraction * (1 - fraction)).sum(1, keepdim=True)
    weight = weight * (1 - blurred) * (1 - now.hidden)
    limited = torch.minimum(weight, 10 - 9 * (speed / 20).clamp(max=1))
    weight = torch.where(speed > STILL, limited, weight)
    weight = torch.where(outside, torch.minimum(weight, 1 + trust * (weight - 1)), weight)

    share = (1 - done) * now.weight / (weight + now.weight)
    mixed = torch.where(fresh, now.image, believed + share * (now.image - believed))
    made = untonemap(from_ycocg(mixed).clamp(0, 1))
    most = torch.where(speed > STILL, FULL, 64.0)
    return made, History(
        color=mixed,
        weight=torch.minimum(torch.where(fresh, 0.0, weight) + now.weight, most),
        life=(life - now.weight / (period * 0.74)).clamp(min=0),
        coarse=torch.where(life > 0, coarse + 0.5 * (now.coarse - coarse), now.coarse),
        lumas=torch.cat((now.luma, torch.where(fresh, now.luma, lumas)[:, :3]), 1),
        still=still,
        time=frame.time,
        jitter=frame.jitter,
    )


def unstable(now: Now, lumas: Float[Tensor, "b 4 H W"], change: Float[Tensor, "b 1 H W"]) -> Float[Tensor, "b 1 H W"]:
    """1 where brightness returns to what it was some frames ago, as thin features do under jitter, else 0."""
    steps = now.luma - lumas
    last, older = steps[:, :1], steps[:, 1:]
    returns = ((older * last > 0) & (older.abs() < last.abs())).any(1, keepdim=True)
    busy = (now.deviation[:, :1] / 0.1).clamp(max=1) ** 6 > 1 / 255
    return (returns & busy & (now.hidden < 0.1) & (change < SHADED)).to(last.dtype)
