"""TAA and TAAU: jittered frames accumulated at display size along their motion.

Paper:   Yang, Liu, Salvi, "A Survey of Temporal Antialiasing Techniques", Computer Graphics Forum 39(2), 2020,
         https://doi.org/10.1111/cgf.14018; the clamp by moments is Salvi's, the kernel Karis'.
Follows: the survey's upsampling: history along the vector of the nearest surface in 3 x 3, Catmull-Rom; rejected off
         screen and where depth says it was hidden; clamped in YCoCg to mean and deviation of the neighbourhood; mixed
         with the enlarged frame by alpha times confidence, all in x / (1 + max(r, g, b)).
Differs: alpha is not fixed. Each pixel keeps the sum of the confidences of its samples, so that a still history is
         their weighted mean, whatever came in whichever order. Reading between pixels blurs, so motion by fractions of
         a pixel takes some of that sum away. What is still for two periods of the jitter is complete and stays.
         The box that history is clamped to is not that of one frame: at twice the size a neighbourhood changes with
         every phase, and clipping to it makes the picture pulsate with the jitter. Mean and square of the
         neighbourhood are accumulated themselves, over 16 frames where still and 2 where moving. What lies outside of
         what was ever seen there starts them anew, so that changes of light on smooth surfaces do not wait; on busy
         ones they take about those 16 frames. On a still checker of display pixels at twice the size, of which every
         frame shows one colour alone, no pixel changes by 1/255 after 64 frames (tests/test_taau.py); a box of the
         frame's own neighbourhood makes it jump between both colours, by 0.8 of 1.
         Beside what moves by other pixels there is no history (`larger.unseen`): the vector of the nearest surface
         leads to what lay beside that thing then.
Needs:   color, depth, motion
Modes:   pass
State:   the accumulated image, its confidence and how long it stood still at display size; depth, motion and the
         moments of neighbourhoods at render size
"""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor, nn

from framecast.color import tonemap, untonemap
from framecast.frame import Frame
from framecast.methods.filters import bounded_lanczos
from framecast.methods.larger import SAME, TWICE, Config, output_size, require, unseen, warn_of_stillness, where
from framecast.methods.mobfgsr import present
from framecast.methods.reproject import reaching
from framecast.resample import (
    Box,
    enlarge,
    enlarged_motion,
    foreground,
    from_ycocg,
    gaussian,
    moments,
    nearest_sample,
    phases,
    sharp_warp,
    tent,
    to_ycocg,
)
from framecast.warp import inside, pick, warp

FIRST = 0.05
"""Confidence of an enlarged frame where none of its samples is near."""
BLUR = 0.8
"""Part of its confidence that history loses when it is read half-way between pixels in both directions."""
MOST = 64.0
"""Largest sum of confidences."""
STILL, MOVING = 1 / 16, 1 / 2
"""Share of the newest frame in the moments of neighbourhoods, without motion and from `STIR` on."""
STIR = 0.1
"""Motion in display pixels a frame from which on a pixel counts as moving."""
GAMMA = 2.0
"""Half the size of the box in standard deviations."""
GROWN = 12
"""Frames after which the moments of what is still are complete."""
CHANGED = 2.0
"""Standard deviations by which a neighbourhood must leave what was seen there to be taken for another one."""


@dataclass(frozen=True)
class History:
    """What is known of the frames before. Colours are YCoCg of tone-mapped colour."""

    color: Float[Tensor, "b 3 H W"]
    weight: Float[Tensor, "b 1 H W"]
    """Sum of the confidences of the samples in `color`; 0: nothing is known."""
    still: Float[Tensor, "b 1 H W"]
    """Frames since the pixel moved or changed."""
    depth: Float[Tensor, "b 1 h w"]
    motion: Float[Tensor, "b 2 h w"]
    mean: Float[Tensor, "b 3 h w"]
    square: Float[Tensor, "b 3 h w"]
    age: Float[Tensor, "b 1 h w"]
    """Frames that `mean` and `square` are made of."""
    time: Float[Tensor, " b"]
    jitter: Float[Tensor, "b 2"]


@dataclass(frozen=True)
class Sample:
    """A frame and what is known where its pixels were, before they are mixed. Colours as in `History`."""

    history: History
    """At the places where this frame's pixels were, as far as it may be believed."""
    image: Float[Tensor, "b 3 H W"]
    """The frame enlarged sharply."""
    first: Float[Tensor, "b 3 H W"]
    """The frame enlarged softly, for where nothing is known."""
    confidence: Float[Tensor, "b 1 H W"]
    """What the frame's sample counts."""
    unsettled: Float[Tensor, "b 1 H W"]
    """1, falling to 0 where nothing has changed for two periods of the jitter, and nothing more is mixed in."""


for _kind in (History, Sample):
    torch.export.register_dataclass(_kind)


class TAAU(nn.Module):
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
        require(frame, type(self).__name__.lower(), self.needs)
        color, depth = present(frame.color), present(frame.depth)
        batch, (tall, wide) = len(color), output_size(frame, self.config.scale)
        none = color.new_zeros(batch, 1, tall, wide)
        return History(
            color=color.new_zeros(batch, 3, tall, wide),
            weight=none,
            still=none.clone(),
            depth=torch.ones_like(depth),
            motion=torch.zeros_like(present(frame.motion)),
            mean=torch.zeros_like(color),
            square=torch.zeros_like(color),
            age=torch.zeros_like(depth),
            time=frame.time,
            jitter=torch.ones_like(frame.jitter),
        )

    def forward(self, frame: Frame, state: History) -> tuple[Float[Tensor, "b 3 H W"], History]:
        """The image of a shaded frame at display size, linear and at least 0, and what is known then.

        Raises:
            ValueError: the frame was not shaded, or its buffers are of different sizes.
        """
        name = type(self).__name__.lower()
        require(frame, name, self.needs)
        warn_of_stillness(state.jitter, frame.jitter, name)
        return self.accumulate(reaching(frame, state.time), state)

    def accumulate(self, frame: Frame, state: History) -> tuple[Float[Tensor, "b 3 H W"], History]:
        """The arithmetic of `forward`, for a frame with motion to the last one."""
        return mix(self.look(frame, state))

    def look(self, frame: Frame, state: History, trust: Float[Tensor, "b 1 h w"] | None = None) -> Sample:
        """What `mix` takes; `trust`, 0 to 1: what each sample counts, where not all are the renderer's."""
        size = output_size(frame, self.config.scale)
        color = to_ycocg(tonemap(present(frame.color)))
        nearest = nearest_sample((color.shape[-2], color.shape[-1]), size, frame.jitter)
        seen = reprojected(frame, state, color, nearest, self.config.scale)
        confidence = enlarge(color, size, frame.jitter, self.kernel, 3).peak
        if trust is not None:
            confidence = confidence * pick(trust, nearest)
        image = bounded_lanczos(color, size, frame.jitter)
        unsettled = (2 - seen.still / phases(self.config.scale)).clamp(0, 1)
        # Where nothing is known, what a sharp kernel makes of samples with aliasing is farther from the truth.
        first = enlarge(color, size, frame.jitter, tent, 2).image
        return Sample(seen, image, first, confidence, unsettled)

    def kernel(self, x: Tensor) -> Tensor:
        """Confidence in a sample at a distance along one axis, in pixels of the render size."""
        return gaussian(x * self.config.scale)


class TAA(TAAU):
    """TAAU at the size of the frames."""

    scales: tuple[float, ...] = (1.0,)

    def __init__(self, config: Config = SAME) -> None:
        super().__init__(config)


def mix(
    sample: Sample, kept: Float[Tensor, "b 1 H W"] | float = 1.0, worth: Float[Tensor, "b 1 H W"] | float = 1.0
) -> tuple[Float[Tensor, "b 3 H W"], History]:
    """The image, linear and at least 0, and what is known then: each side by the samples that it is made of.

    Args:
        kept: by how much history counts less than that.
        worth: by how much the frame counts more or less.
    """
    seen, confidence = sample.history, sample.confidence * worth
    known, weight = seen.weight > 0, seen.weight * kept
    share = sample.unsettled * confidence / (weight + confidence)
    mixed = torch.where(known, seen.color + share * (sample.image - seen.color), sample.first)
    weight = torch.where(known, weight + confidence, FIRST + sample.confidence).clamp(max=MOST)
    return untonemap(from_ycocg(mixed).clamp(0, 1)), replace(seen, color=mixed, weight=weight)


def reprojected(frame: Frame, state: History, color: Tensor, nearest: Tensor, scale: float) -> History:
    """What is known at the places where the frame's pixels were, as far as it may be believed."""
    depth, motion = present(frame.depth), present(frame.motion)
    motion = where(frame.reset, torch.zeros_like(motion), motion)
    # From where this frame's samples lie to where the same points lie between the samples of the frame before.
    between = (frame.jitter - state.jitter)[:, :, None, None]
    hidden = unseen(frame, motion, state.depth, state.motion, state.jitter) | frame.reset[:, None, None, None]
    moved = foreground(depth, motion)[1]
    large = enlarged_motion(moved, (state.color.shape[-2], state.color.shape[-1]), frame.jitter)
    lost = pick(hidden.float(), nearest) + (~inside(large)).float() > 0
    weight, still = warp(torch.cat((state.weight, state.still), 1), large).split(1, 1)
    fraction = large - large.floor()
    weight = weight * (1 - BLUR * (2 * fraction * (1 - fraction)).sum(1, keepdim=True))
    speed = large.square().sum(1, keepdim=True).sqrt()

    mean, square, age, changed = accumulated_moments(color, state, moved, between, hidden | ~inside(moved), scale)
    deviation = (square - mean * mean).clamp(min=0).sqrt()
    box = Box(pick(mean - GAMMA * deviation, nearest), pick(mean + GAMMA * deviation, nearest))
    history = sharp_warp(state.color, large)
    clamped = box.clamp(history)
    off = (clamped - history).abs().amax(1, keepdim=True)
    stirred = (speed > STIR) | (off > 0.02) | pick(changed.float(), nearest).bool()
    return History(
        color=clamped,
        weight=torch.where(lost, 0.0, weight),
        still=torch.where(stirred | lost, 0.0, still + 1),
        depth=depth,
        motion=motion,
        mean=mean,
        square=square,
        age=age,
        time=frame.time,
        jitter=frame.jitter,
    )


def accumulated_moments(
    color: Tensor, state: History, moved: Tensor, between: Tensor, unknown: Tensor, scale: float
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Mean and square of 3 x 3 neighbourhoods over some frames, how many, and where they cannot be what was there.

    That is not asked of what is still before it was seen in some phases: one frame may show one colour of two.
    """
    mean, deviation = moments(color)
    square = mean * mean + deviation * deviation
    old = warp(torch.cat((state.mean, state.square, state.age), 1), moved + between)
    old_mean, old_square, age = old.split((3, 3, 1), 1)
    old_deviation = (old_square - old_mean * old_mean).clamp(min=0).sqrt()
    apart = ((mean - old_mean).abs() > CHANGED * (old_deviation + deviation) + 0.02).any(1, keepdim=True)
    speed = moved.square().sum(1, keepdim=True).sqrt() * (scale / STIR)
    changed = apart & ((age >= GROWN) | (speed > 1))
    rate = torch.maximum(STILL + (MOVING - STILL) * speed.clamp(max=1), 1 / (age + 1))
    anew = unknown | changed
    mixed = old_mean + rate * (mean - old_mean), old_square + rate * (square - old_square)
    age = torch.where(anew, 1.0, age + 1).clamp(max=64)
    return torch.where(anew, mean, mixed[0]), torch.where(anew, square, mixed[1]), age, changed
