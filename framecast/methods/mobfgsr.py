"""Mob-FGSR: frames generated from rendered frames alone, by splatting their motion to the moment that is asked for.

Paper:    Yang, Zhu, Zhuge, Qiu, Li, Yan, Xu, Yan, Jin: Mob-FGSR, Frame Generation and Super Resolution for Mobile
          Real-Time Rendering. SIGGRAPH Conference Papers 2024. doi:10.1145/3641519.3657424
Follows:  section 3.3 (quadratic motion, nearest-depth splat, refinement of gaps), 3.4 (interpolation with Eq. 1,
          extrapolation with disocclusion filling) and 3.5 (super-resolution, alone or with generated frames), images
          read through a learned table of 32 x 32 x 16 weights (section 4).
Differs:  each choice measured in docs/results/frame-generation.md.
          True motion: where frames carry `motion_next`, paths go through the recorded positions before and after,
          and for interpolation the earlier frame is splatted too, which the paper cannot do: it knows no vectors
          forward. The paper's estimate from two earlier vectors is `Config(motion="quadratic")`.
          The older vector counts only where it belongs to the same surface (depth within a tenth, on screen);
          elsewhere motion is straight. The paper does not say, the public code reads whatever is there.
          Depth thresholds are relative, so that they do not depend on the scene's unit.
          T_B is 0 by default: both frames are always mixed by time; the paper's 0.13 takes the frame nearer in time
          where brightness agrees, which is sharper and farther from the truth.
          Gaps copy the nearest surface's vector as the public code does; the paper's mean filter mixes surfaces.
          The public code splats extrapolated pixels on straight and gathers them on quadratic paths; here both are one.
          At scale 1 images are read bilinearly, from compressed colour: 29.83 dB interpolated and 27.26 extrapolated
          (linear colour: 29.63 and 27.21). `Config(kernel="table")` gives 30.14 and 27.28, from sixteen pixels
          in place of four.
          One table for all scales: trained on references or on shaded colour, tables differ by 0.04 dB.
          Eq. 2 as printed loses light (its weights do not sum to 1). Here 1 - b d is what a sample counts against the
          history, 1 / a - 1 the most that a moving history counts, and Catmull-Rom makes the sample's image; a = 0.5,
          b = 1.5 by search on training scenes (the paper's 0.34 and 0.81 with its own form). What was hidden is asked
          of each pixel's own depth and vector (`larger.uncovered`), not of the dilated ones; it starts bilinearly.
          Pixels that stand still are averaged without that limit, and clamped only when they stay outside of their
          neighbourhood: else jitter makes them flicker for ever.
          Interpolated large images mix the large images on both sides; the paper's later one is small.
Needs:    color, depth, motion; motion_next if there. Nothing of the generated frame but its time.
Modes:    interpolate, extrapolate, pass
State:    the last two shaded frames, depth and vectors dilated (3 x 3, nearest depth); with a scale above 1 their large
          images, how many samples they are made of, and for how long they disagreed.
"""

from dataclasses import dataclass, replace
from typing import Literal

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from framecast.color import luminance, to_display, tonemap, untonemap
from framecast.frame import Frame
from framecast.methods import mobfgsr_sr as sr
from framecast.methods.larger import require, uncovered, warn_of_stillness
from framecast.methods.pair import Pair, advance, begin
from framecast.resample import enlarged_motion, nearest_sample
from framecast.table import resample, shipped_table
from framecast.warp import (
    EMPTY,
    Trajectory,
    depth_key,
    fetch,
    inside,
    key_depth,
    key_index,
    nearest_neighbour,
    pick,
    splat,
    trajectory,
    warp,
)


@dataclass(frozen=True)
class Config:
    """What may be chosen; the defaults are the best of those measured."""

    motion: Literal["true", "quadratic"] = "true"
    """Paths of pixels: through recorded positions on both sides where there, or always the paper's estimate."""
    dilate: bool = True
    """Give each pixel the depth and vectors of the nearest surface in its 3 x 3 neighbourhood."""
    gap_threshold: float = 0.02
    """Part of its depth by which a neighbour must be nearer to count as another surface when gaps are closed."""
    depth_threshold: float = 0.1
    """T_D of Eq. 1 as a part of the depth: beyond it only the farther, newly revealed side is used."""
    brightness_threshold: float = 0.0
    """T_B of Eq. 1 in display luminance: up to it the frame nearer in time is taken alone. 0: always mix."""
    kernel: Literal["bilinear", "table"] = "bilinear"
    """How generated frames of scale 1 read the shaded ones; larger images are always read through the table."""
    scale: float = 1.0
    """Size of the images divided by that of the frames; 1: shaded frames pass through."""
    blend: float = 0.5
    """a of Eq. 2: what a sample counts against the history that lies on the centre of a pixel."""
    falloff: float = 1.5
    """b of Eq. 2: how much less it counts for each small pixel that it lies away."""


State = Pair | sr.Enlarging


class MobFGSR(nn.Module):
    """Interpolation between the last two shaded frames, or extrapolation beyond the last one, by the time asked for;
    built for a scale, larger images of these and of the shaded frames."""

    needs = ("color", "depth", "motion")
    needs_generated: tuple[str, ...] = ()
    modes = ("interpolate", "extrapolate", "pass")
    scales: tuple[float, ...] = (1.0, 1.5, 2.0, 3.0)
    parts = ("shade", "interpolate", "extrapolate")
    table: Tensor

    def __init__(self, config: Config = Config()) -> None:
        super().__init__()
        self.config = config
        self.enlarges = config.scale > 1
        self.history = None if self.enlarges else 3
        # A history needs exact vectors between shaded frames more than generated frames need those halfway.
        self.step_motion = config.motion == "true" and not self.enlarges
        buffers = ("depth", "motion") if self.enlarges else self.needs
        self.keeps = (*buffers, "motion_next") if config.motion == "true" else buffers
        self.register_buffer("table", shipped_table(), persistent=False)

    def start(self, frame: Frame) -> State:
        """State before the first frame: nothing but that frame."""
        require(frame, "mobfgsr", self.needs)
        pair = begin(self.prepared(frame), self.keeps)
        return sr.begin(pair, frame, self.samples(frame)) if self.enlarges else pair

    def forward(self, frame: Frame, state: State) -> tuple[Float[Tensor, "b 3 H W"], State]:
        """A shaded frame passes through, or is enlarged, and enters the state; for others the image at `frame.time`.

        Images are linear and at least 0. Where no frame shows a pixel's surface, the older frame's background is
        taken (interpolation), or the newest frame's surroundings (extrapolation).
        """
        if frame.color is not None:
            require(frame, "mobfgsr", self.needs)
            if not isinstance(state, Pair):
                known = (frame.time > state.pair.current.time)[:, None]
                warn_of_stillness(torch.where(known, state.jitter, 1.0), frame.jitter, "mobfgsr")
            state = self.shade(frame, state)
            return (frame.color if isinstance(state, Pair) else untonemap(state.image)), state
        if bool((frame.time > pair_of(state).current.time).all()):
            return self.extrapolate(state, frame.time), state
        return self.interpolate(state, frame.time), state

    def shade(self, frame: Frame, state: State) -> State:
        """The state after a shaded frame."""
        pair = advance(self.prepared(frame), pair_of(state), self.keeps)
        if isinstance(state, Pair):
            return pair
        back, own = (path(f, pair.prev).displacement(pair.prev.time - pair.current.time) for f in (pair.current, frame))
        gone = uncovered(frame, own, state.depth, state.motion, state.jitter)
        return sr.advance(state, pair, frame, self.samples(frame), back, gone, self.table, self.config.blend)

    def samples(self, frame: Frame) -> sr.Samples:
        """A shaded frame on the pixels of the large image."""
        return sr.samples(tonemap(present(frame.color)), frame.jitter, self.config.scale, self.config.falloff)

    def prepared(self, frame: Frame) -> Frame:
        """A shaded frame as it is kept."""
        frame = dilated(frame) if self.config.dilate else frame
        return replace(frame, color=tonemap(present(frame.color)))

    def interpolate(self, state: State, time: Float[Tensor, " b"]) -> Float[Tensor, "b 3 H W"]:
        """The image at `time` between the two shaded frames."""
        sources = interpolate(pair_of(state), time, self.config)
        if isinstance(state, Pair):
            return self.blend(present(state.prev.color), present(state.current.color), sources)
        return self.blend(state.before, state.image, enlarged(sources, state.image))

    def extrapolate(self, state: State, time: Float[Tensor, " b"]) -> Float[Tensor, "b 3 H W"]:
        """The image at `time` after the newest shaded frame."""
        source = extrapolate(pair_of(state), time, self.config)
        if isinstance(state, Pair):
            return untonemap(self.read(present(state.current.color), source))
        return untonemap(self.read(state.image, scaled(source, state.image)))

    def blend(
        self, previous: Float[Tensor, "b 3 H W"], current: Float[Tensor, "b 3 H W"], sources: "Sources"
    ) -> Float[Tensor, "b 3 H W"]:
        """Eq. 1: both compressed images warped and mixed; the linear image."""
        images = self.read(previous, sources.to_previous), self.read(current, sources.to_current)
        return untonemap(mixed(*images, sources.weight, self.config.brightness_threshold))

    def read(self, image: Float[Tensor, "b 3 H W"], motion: Float[Tensor, "b 2 H W"]) -> Float[Tensor, "b 3 H W"]:
        """A compressed image along the motion."""
        if self.enlarges or self.config.kernel == "table":
            return resample(image, motion, self.table, bounded=True)
        return warp(image, motion)


def pair_of(state: State) -> Pair:
    """The last two shaded frames."""
    return state if isinstance(state, Pair) else state.pair


def dilated(frame: Frame) -> Frame:
    """The frame with depth and vectors of the nearest surface in each pixel's 3 x 3 neighbourhood."""
    depth, motion, ahead = present(frame.depth), present(frame.motion), frame.motion_next
    nearest = nearest_neighbour(depth)
    ahead = None if ahead is None else pick(ahead, nearest)
    return replace(frame, depth=pick(depth, nearest), motion=pick(motion, nearest), motion_next=ahead)


def present(buffer: Tensor | None) -> Tensor:
    """A buffer in `needs`, which was checked where frames enter."""
    assert buffer is not None
    return buffer


def _wide(values: Tensor) -> Tensor:
    """One value per batch entry, shaped to meet images."""
    return values[:, None, None, None]


def path(frame: Frame, previous: Frame) -> Trajectory:
    """Paths of the pixels of a shaded frame: through true positions, or estimated (figure 3).

    With motion m1 of this frame and m0 of the previous one read where m1 leads, both over one gap s: velocity
    (m0 - 3 m1) / 2s, acceleration (m0 - m1) / s^2 with the signs of `Frame.motion`. Straight where m0 does not belong
    to the same surface, where the vectors do not lead to the previous frame, and where m0 reaches over another time.
    """
    depth, motion = present(frame.depth), present(frame.motion)
    if frame.motion_next is not None:
        return trajectory(motion, frame.motion_next, frame.span)
    same = (fetch(present(previous.depth), motion) / depth - 1).abs() < 0.1
    reaches = (frame.time - previous.time - frame.span).abs() < 1e-3 * frame.span
    even = (frame.span - previous.span).abs() < 1e-3 * frame.span
    usable = same & inside(motion) & _wide(reaches & even & ~previous.reset)
    change = torch.where(usable, fetch(present(previous.motion), motion) - motion, 0.0)
    s = _wide(frame.span)
    return Trajectory(change / (2 * s) - motion / s, change / (s * s))


def refine(keys: Int[Tensor, "b H W"], threshold: float) -> Int[Tensor, "b h w"]:
    """Gaps of a splat closed (section 3.3): holes, and pixels of the background seen through a spread-out surface.

    A pixel stays when it is part of a 2 x 2 block in which nothing is nearer than it by more than `threshold` of its
    depth; else it lies in a gap one pixel wide and takes the key of the nearest neighbour. Larger holes stay EMPTY.
    `keys` have a border of one pixel, which is lost.
    """
    height, width = keys.shape[-2] - 2, keys.shape[-1] - 2
    around = [[keys[:, y : y + height, x : x + width] for x in range(3)] for y in range(3)]
    limit = depth_key(key_depth(around[1][1]) * (1 - threshold))
    similar = [[key >= limit for key in row] for row in around]
    blocks = [similar[y][x] & similar[y][1] & similar[1][x] for y in (0, 2) for x in (0, 2)]
    keep = blocks[0] | blocks[1] | blocks[2] | blocks[3]
    rows = [torch.minimum(torch.minimum(a, b), c) for a, b, c in around]
    nearest = torch.minimum(torch.minimum(rows[0], rows[1]), rows[2])
    return torch.where(keep, around[1][1], nearest)


@dataclass(frozen=True)
class Arrivals:
    """What a shaded frame sends to each pixel of the generated one."""

    depth: Float[Tensor, "b 1 h w"]
    """Depth of what arrived; infinite where nothing did."""
    to_own: Float[Tensor, "b 2 h w"]
    """From the pixel to where it came from, pixels."""
    to_other: Float[Tensor, "b 2 h w"]
    """From the pixel to where the same path was in the other shaded frame."""


def arrivals(frame: Frame, moving: Trajectory, time: Tensor, other: Tensor, threshold: float) -> Arrivals:
    """A frame's pixels splatted along their paths to `time`, gaps closed; `other` is the other frame's time."""
    to_time = moving.displacement(time - frame.time)
    across = moving.displacement(other - frame.time)
    keys = refine(splat(present(frame.depth), to_time, border=1), threshold)
    # Joined, both are computed before pixels are picked: compiled code would compute them anew for every one picked.
    to_time, across = pick(torch.cat((to_time, across), 1), key_index(keys)).split(2, 1)
    return Arrivals(key_depth(keys), -to_time, across - to_time)


@dataclass(frozen=True)
class Sources:
    """Where each pixel of an interpolated image comes from."""

    to_previous: Float[Tensor, "b 2 h w"]
    """From the pixel to its place in the previous shaded frame."""
    to_current: Float[Tensor, "b 2 h w"]
    """From the pixel to its place in the current one."""
    weight: Float[Tensor, "b 1 h w"]
    """How much of the current one is taken: 0 and 1 where only one of them shows the surface, else by time."""


def interpolate(state: Pair, time: Float[Tensor, " b"], config: Config) -> Sources:
    """Sources of the image at `time` between the two shaded frames."""
    previous, current = state.prev, state.current
    late = arrivals(current, path(current, previous), time, previous.time, config.gap_threshold)
    depth, to_previous, to_current = late.depth, late.to_other, late.to_own
    if previous.motion_next is not None:
        # Both frames know where their pixels go. One surface: each frame's own place. Two: the farther, as in Eq. 1.
        early = arrivals(previous, path(previous, previous), time, current.time, config.gap_threshold)
        same = (early.depth / late.depth - 1).abs() < config.depth_threshold
        use_late = torch.isfinite(late.depth) & ((late.depth >= early.depth) | torch.isinf(early.depth))
        depth = torch.where(use_late, late.depth, early.depth)
        to_previous = torch.where(use_late & ~same, late.to_other, early.to_own)
        to_current = torch.where(use_late | same, late.to_own, early.to_other)
    # Nothing arrived: the background that the previous frame saw, on a straight path.
    landed = torch.isfinite(depth)
    speed = -present(previous.motion) / _wide(previous.span)
    to_current = torch.where(landed, to_current, speed * _wide(current.time - time))
    to_previous = torch.where(landed, to_previous, speed * _wide(previous.time - time))
    alpha = (time - previous.time) / (current.time - previous.time).clamp(min=1e-6)
    return Sources(to_previous, to_current, visible(state, to_previous, to_current, alpha, config.depth_threshold))


def visible(
    state: Pair,
    to_previous: Float[Tensor, "b 2 h w"],
    to_current: Float[Tensor, "b 2 h w"],
    alpha: Float[Tensor, " b"],
    threshold: float,
) -> Float[Tensor, "b 1 h w"]:
    """Eq. 1 as far as depth decides: the weight of the current frame; `alpha`, 0 at the previous one, where both show
    the surface."""
    depth_before = fetch(present(state.prev.depth), to_previous)
    depth_after = fetch(present(state.current.depth), to_current)
    seen_before, seen_after = inside(to_previous), inside(to_current)
    only_before = seen_before & ((depth_before > depth_after * (1 + threshold)) | ~seen_after)
    only_after = seen_after & ((depth_after > depth_before * (1 + threshold)) | ~seen_before)
    return torch.where(only_before, 0.0, torch.where(only_after, 1.0, _wide(alpha).expand_as(depth_after)))


def mixed(
    before: Float[Tensor, "b 3 H W"],
    after: Float[Tensor, "b 3 H W"],
    weight: Float[Tensor, "b 1 H W"],
    threshold: float,
) -> Float[Tensor, "b 3 H W"]:
    """Two compressed images mixed; where their display luminance differs by up to `threshold`, the nearer in time."""
    if threshold > 0:
        change = luminance(to_display(untonemap(after))) - luminance(to_display(untonemap(before)))
        alike = (change.abs() <= threshold) & (weight > 0) & (weight < 1)
        weight = torch.where(alike, (weight > 0.5).to(weight.dtype), weight)
    return before + weight * (after - before)


def extrapolate(state: Pair, time: Float[Tensor, " b"], config: Config) -> Float[Tensor, "b 2 h w"]:
    """From each pixel at `time` after the newest shaded frame to its place in that frame (section 3.4)."""
    current, depth = state.current, present(state.current.depth)
    later = time - current.time
    moving = path(current, state.prev)
    to_time = moving.displacement(later)
    keys = refine(splat(depth, to_time, border=1), config.gap_threshold)
    back = -pick(to_time, key_index(keys))
    # Disoccluded: this pixel's own motion continued, unless that would copy something nearer; then what is here now.
    straight = -moving.velocity * _wide(later)
    background = fetch(depth, straight) >= depth * (1 - config.gap_threshold)
    filled = torch.where(background, straight, 0.0)
    return torch.where((keys != EMPTY)[:, None], back, filled)


def enlarged(sources: Sources, image: Float[Tensor, "b 3 H W"]) -> Sources:
    """Sources at the size of an image."""
    size = (image.shape[-2], image.shape[-1])
    index = nearest_sample((sources.weight.shape[-2], sources.weight.shape[-1]), size, sources.weight.new_zeros(1, 2))
    return Sources(
        scaled(sources.to_previous, image),
        scaled(sources.to_current, image),
        pick(sources.weight, index.expand(len(image), -1, -1)),
    )


def scaled(field: Float[Tensor, "b 2 h w"], image: Float[Tensor, "b 3 H W"]) -> Float[Tensor, "b 2 H W"]:
    """Vectors at the size of an image."""
    size = (image.shape[-2], image.shape[-1])
    return enlarged_motion(field, size, torch.zeros(len(image), 2, device=image.device))
