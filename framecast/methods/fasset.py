"""FASSET: every frame larger, shaded or not, by one network for both, queried at any size of the image.

Paper:   Qin, Zhang, Guo, Yang, Bai, Guo, "FASSET: Frame Supersampling and Extrapolation using Implicit Neural
         Representations of Rendering Contents", Nanjing University, 2023
Follows: section 3: the frame, or the last one warped, multiplied by a mask of its holes in both cases, with depth and
         normal through a U-Net of light-weight gated convolutions with skips and a recurrent module (FrameEncoder);
         base colour, depth and normal through three convolutions (GEncoder); a weight in (0, 10) for each of both, by
         three more; RenderINR (`inr.py`): features read bilinearly at a pixel, and the pixel size, through three hidden
         layers of 128. One set of weights for shaded frames and extrapolated ones, the log domain, the three losses
         (`published_loss`), residual learning. No code was ever released.
Differs: Widths, which are not published, are ours: 0.27 million parameters, as published.
         The residual is added to an image at full size, and an untrained network shows that image. In `PUBLISHED` it is
         the frame enlarged, or the last one warped: without its texture, which the new frame's base colour gives back.
         What is trained (`BETTER`) adds to more: what TAAU accumulates, for a frame that was not shaded warped to it,
         and where the last frame did not show the surface guided warping enlarged (`guided.py`). RenderINR sees that
         image at the pixel, how much of it is known, and where the nearest sample lies; it also gives a share of the
         difference between the image and the frame alone, which is added.
         Holes are where the last shaded frame did not show the surface (`larger.uncovered`), for both kinds of frames.
         The pixel size is in pixels of the frame, not in parts of the image, so that what is learnt on small images
         holds for large ones. Features lie on samples, whose jitter is part of where they are read.
         The recurrent module is a gated unit of convolutions at an eighth of the size; what it keeps moves along.
         Extrapolated frames leave no trace in the state. Where a pixel stands still, the mean of what was added counts,
         as in NSRR. No batch normalisation, as batches are of two.
         `loss` compares what is displayed, x / (1 + max) under the sRGB curve, and learns other sizes from the images
         of one: from every second sample of a frame, and from smaller truths.
Needs:   color, depth, motion, albedo, metallic, normal; of the generated frame the same but color
Modes:   extrapolate, pass
State:   the last shaded frame (light, surfaces), what TAAU keeps, the features that the recurrent module keeps, and
         what was added to the last image
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from framecast.color import decode_log, encode_log, modulate, tonemap, untonemap
from framecast.frame import BUFFERS, Frame, missing
from framecast.methods import larger
from framecast.methods.fasset_network import Config, Network
from framecast.methods.guided import Seen, after_cut, extrapolated, guides
from framecast.methods.reproject import chosen, light, steps, surface
from framecast.methods.taau import STIR, TAAU, History
from framecast.nets import padded
from framecast.recipe import Recipe
from framecast.resample import (
    at_samples,
    enlarge,
    enlarged_motion,
    foreground,
    from_ycocg,
    nearest_sample,
    positions,
    sharp_warp,
    size_at,
    tent,
)
from framecast.warp import inside, pick, warp

GBUFFERS = ("depth", "motion", "albedo", "metallic", "normal")


PUBLISHED = Config()

BETTER = Config(base="accumulated", looks=True, offset=True)
"""What is trained: it begins with the best image that needs no training."""


@dataclass(frozen=True)
class State:
    """What the next frame sees of those before."""

    shaded: Seen
    """The last shaded frame, for guided warping."""
    history: History
    """What TAAU knows; with another `Config.base` its depth, motion and jitter alone."""
    kept: Float[Tensor, "b k h w"]
    """Features of the recurrent module, at an eighth of the size of the frame."""
    gap: Float[Tensor, " b"]
    """Time between the last two shaded frames; 0 where there was one."""
    added: Float[Tensor, "b 3 H W"]
    """What was added to the image of the last shaded frame, in the log domain."""


@dataclass(frozen=True)
class Base:
    """What the network begins with."""

    image: Float[Tensor, "b 3 H W"]
    """What its output is added to, in the log domain."""
    alone: Float[Tensor, "b 3 H W"]
    """The frame by itself, enlarged; where it was not shaded, the last one warped. In the log domain."""
    support: Float[Tensor, "b 1 H W"]
    """How much of the image was accumulated: w / (1 + w) of its weight."""
    color: Float[Tensor, "b 3 h w"]
    """The frame, or the last one warped, in the log domain."""
    mask: Float[Tensor, "b 1 h w"]
    """1 where the last shaded frame shows the surface."""
    still: Float[Tensor, "b 1 H W"]
    """Frames since what was accumulated moved or changed; 0 where nothing was."""


torch.export.register_dataclass(State)
torch.export.register_dataclass(Base)


class FASSET(nn.Module):
    """See the top of this file."""

    needs: tuple[str, ...] = ("color", *GBUFFERS)
    needs_generated: tuple[str, ...] = GBUFFERS
    modes: tuple[str, ...] = ("extrapolate", "pass")
    scales: tuple[float, ...] = (1.5, 2.0, 3.0)
    parts: tuple[str, ...] = ("accumulate", "extrapolate", "extract", "render")
    history: int | None = None
    step_motion: bool = False

    def __init__(self, config: Config = PUBLISHED) -> None:
        super().__init__()
        if config.scale < 1:
            raise ValueError(f"fasset makes frames larger, and {config.scale:g} times is smaller; use at least 1")
        self.config = config
        self.taau = TAAU(larger.Config(config.scale))
        self.networks = nn.ModuleList(Network(config) for _ in range(1 if config.shared else 2))

    def at(self, scale: float) -> "FASSET":
        """The same networks for another size."""
        other = FASSET(replace(self.config, scale=scale))
        other.networks = self.networks
        return other

    def _network(self, generated: bool) -> Network:
        """That of a kind of frames."""
        found = self.networks[generated and not self.config.shared]
        assert isinstance(found, Network)
        return found

    def start(self, frame: Frame) -> State:
        """The state before the first frame, which is `frame`: nothing is known.

        Raises:
            ValueError: a buffer is missing, or of another size than the colour.
        """
        larger.require(frame, "fasset", self.needs)
        assert frame.depth is not None
        batch, _, height, width = frame.depth.shape
        kept = frame.depth.new_zeros(batch, self.config.kept, -(-height // 8), -(-width // 8))
        history = self.taau.start(frame)
        history = replace(history, depth=frame.depth, jitter=frame.jitter, still=history.still - 1)
        return State(last(frame), history, kept, torch.zeros_like(frame.time), torch.zeros_like(history.color))

    def forward(self, frame: Frame, state: State) -> tuple[Float[Tensor, "b 3 H W"], State]:
        """The frame at full size, and the state with it where it was shaded.

        Raises:
            ValueError: a buffer is missing, of another size than the others, or the state is of another size.
        """
        self.require(frame, state)
        if frame.color is None:
            past = replace(state, shaded=after_cut(frame, state.shaded, "fasset"))
            base, frame = self.extrapolate(frame, past)
            maps, _ = self.extract(frame, base, past, generated=True)
            return self.render(maps, frame, base, past, generated=True)[0], state
        known = (frame.time > state.shaded.time)[:, None]
        larger.warn_of_stillness(torch.where(known, state.shaded.jitter, 1.0), frame.jitter, "fasset")
        base, frame, history = self.accumulate(frame, state)
        maps, kept = self.extract(frame, base, state)
        image, added = self.render(maps, frame, base, state)
        return image, State(last(frame), history, kept, frame.span, added)

    def require(self, frame: Frame, state: State) -> None:
        """Raises what `forward` does."""
        lacking = missing(frame, self.needs_generated)
        if frame.color is not None:
            larger.require(frame, "fasset", self.needs)
        elif lacking:
            raise ValueError(
                f"fasset makes frames from their {' and '.join(self.needs_generated)}; the frame to generate at time "
                f"{float(frame.time[0]):g} has no {' and no '.join(lacking)}: render these buffers for it"
            )
        (height, width), (tall, wide) = frame.size or (0, 0), state.history.depth.shape[-2:]
        if (height, width) != (tall, wide):
            raise ValueError(
                f"the frame at time {float(frame.time[0]):g} has {width}x{height} pixels and those before it "
                f"{wide}x{tall}; start anew where the size changes"
            )

    def accumulate(self, frame: Frame, state: State) -> tuple[Base, Frame, History]:
        """What the network begins with for a shaded frame, and the frame with motion to the one before it."""
        with torch.no_grad(), torch.autocast(frame.time.device.type, enabled=False):
            frame = aimed(frame, state)
            assert frame.color is not None
            mask, color, alone = seen(frame, state), encode_log(frame.color), self.enlarged(frame.color, frame)
            if self.config.base == "accumulated":
                image, history = self.taau.accumulate(frame, state.history)
                support = history.weight / (1 + history.weight)
                return Base(encode_log(image), alone, support, color, mask, history.still), frame, history
            assert frame.depth is not None
            assert frame.motion is not None
            kept = replace(state.history, depth=frame.depth, motion=frame.motion, jitter=frame.jitter)
            nothing = torch.zeros_like(alone[:, :1])
            return Base(alone, alone, nothing, color, mask, nothing), frame, kept

    def extrapolate(self, frame: Frame, state: State) -> tuple[Base, Frame]:
        """What the network begins with for a frame to generate, and the frame with motion to the last shaded one."""
        with torch.no_grad(), torch.autocast(frame.time.device.type, enabled=False):
            frame = aimed(frame, state)
            if self.config.base == "warped":
                found = warp(state.shaded.light, steps(frame, state.shaded.time, state.shaded.jitter))
            else:
                found, _ = extrapolated(frame, state.shaded)
            color, mask = modulate(decode_log(found), surface(frame)), seen(frame, state)
            alone = self.enlarged(color, frame)
            if self.config.base == "accumulated":
                image, share, weight, still = carried(frame, state.history, mask)
                image = alone + share * (image - alone)
                return Base(image, alone, weight / (1 + weight), encode_log(color), mask, still), frame
            nothing = torch.zeros_like(alone[:, :1])
            return Base(alone, alone, nothing, encode_log(color), mask, nothing), frame

    def enlarged(self, color: Float[Tensor, "b 3 h w"], frame: Frame) -> Float[Tensor, "b 3 H W"]:
        """A frame alone at full size, in the log domain."""
        size = size_at((color.shape[-2], color.shape[-1]), self.config.scale)
        return encode_log(untonemap(enlarge(tonemap(color), size, frame.jitter, tent, 2).image))

    def extract(
        self, frame: Frame, base: Base, state: State, *, generated: bool = False
    ) -> tuple[Float[Tensor, "b c h w"], Float[Tensor, "b k i j"]]:
        """Features for RenderINR, and those that the recurrent module keeps."""
        assert frame.depth is not None
        assert frame.albedo is not None
        assert frame.normal is not None
        mask = base.mask if generated or self.config.mask else torch.ones_like(base.mask)
        around = torch.cat((base.color, frame.albedo, larger.nearness(frame.depth), frame.normal), 1)
        x = [base.color * mask, mask, around[:, 6:]]
        height, width = mask.shape[-2:]
        if self.config.base == "accumulated":
            x.append(at_samples(base.image, (height, width), frame.jitter) - base.color)
        maps, kept = self._network(generated).extract(
            padded(torch.cat(x, 1), 8), padded(around, 8), moved(state.kept, frame)
        )
        return maps[..., :height, :width], kept

    def render(
        self, maps: Float[Tensor, "b c h w"], frame: Frame, base: Base, state: State, *, generated: bool = False
    ) -> tuple[Float[Tensor, "b 3 H W"], Float[Tensor, "b 3 H W"]]:
        """The image from features, linear, and what was added to the one that the network began with."""
        added = self.added(maps, frame, base, generated=generated)
        if self.config.base == "accumulated":
            added = larger.settled(frame, added, state.added, base.still, self.config.scale)
        return decode_log(base.image + added), added

    def added(self, maps: Tensor, frame: Frame, base: Base, *, generated: bool = False) -> Float[Tensor, "b 3 H W"]:
        """What the network adds, in the log domain."""
        small, size = ((x.shape[-2], x.shape[-1]) for x in (maps, base.image))
        pixel = torch.tensor([small[1] / size[1], small[0] / size[0]], device=maps.device)
        known = [pixel[None, :, None, None].expand(len(maps), 2, *size)]
        difference = base.alone - base.image
        if self.config.looks:
            known += [base.image, difference, base.support]
        if self.config.offset:
            at = positions(small, size, frame.jitter)
            known.append(at.round() - at)
        values = self._network(generated).render(maps, torch.cat(known, 1), frame.jitter)
        return values[:, :3] + values[:, 3:] * difference if self.config.base == "accumulated" else values


def last(frame: Frame) -> Seen:
    """A shaded frame as guided warping reads it."""
    return Seen(light(frame), guides(frame), frame.jitter, frame.time)


def aimed(frame: Frame, state: State) -> Frame:
    """The frame with motion to the last shaded one, jitter left out; 0 where it resets."""
    assert frame.motion is not None
    motion = steps(frame, state.shaded.time, frame.jitter)
    motion = chosen(frame.reset, torch.zeros_like(motion), motion)
    return replace(frame, motion=motion, motion_next=None, span=frame.time - state.shaded.time)


def seen(frame: Frame, state: State) -> Float[Tensor, "b 1 h w"]:
    """1 where the last shaded frame shows the surface, and in all of a shaded frame that resets; in nothing of one
    that resets without having been shaded."""
    assert frame.motion is not None
    old = state.history
    part = torch.where(state.gap > 0, frame.span / state.gap, 1.0)  # vectors of both frames over the same time
    moving = old.motion * part[:, None, None, None]
    hole = larger.uncovered(frame, frame.motion, old.depth, moving, old.jitter) | ~inside(frame.motion)
    return chosen(frame.reset, torch.full_like(hole, frame.color is not None), ~hole).float()


def carried(
    frame: Frame, history: History, mask: Float[Tensor, "b 1 h w"]
) -> tuple[Float[Tensor, "b 3 H W"], Float[Tensor, "b 1 H W"], Float[Tensor, "b 1 H W"], Float[Tensor, "b 1 H W"]]:
    """The accumulated image where the frame shows its content, in the log domain; the share of it that may be shown,
    less where there is more of a hole around, so that a few pixels beside thin things do not tear it; what it weighs;
    and for how many frames it stood still, 0 where it moves now."""
    assert frame.depth is not None
    assert frame.motion is not None
    small, size = ((x.shape[-2], x.shape[-1]) for x in (frame.depth, history.color))
    motion = enlarged_motion(foreground(frame.depth, frame.motion)[1], size, frame.jitter)
    around = F.avg_pool2d(mask, 3, 1, 1, count_include_pad=False)
    share = pick(around, nearest_sample(small, size, frame.jitter)) * inside(motion)
    still = history.still * (share == 1) * (motion.abs().amax(1, keepdim=True) < STIR)
    image = untonemap(from_ycocg(sharp_warp(history.color, motion)).clamp(0, 1))
    return encode_log(image), share, warp(history.weight, motion) * share, still


def moved(kept: Float[Tensor, "b k i j"], frame: Frame) -> Float[Tensor, "b k i j"]:
    """What the recurrent module keeps where the frame shows its content; nothing where it resets."""
    assert frame.motion is not None
    motion = F.avg_pool2d(padded(frame.motion, 8), 8) / 8
    return chosen(frame.reset, torch.zeros_like(kept), warp(kept, motion))


# Training.

PUBLISHED_WEIGHTS = {"l1": 1.0, "hole": 5.0, "hard": 1.0}
"""Of the three terms as published; those of the first and the last are not, and as in ExtraNet."""

WEIGHTS = {"l1": 1.0, "hole": 0.1, "hard": 1.0}
"""What `loss` takes: where holes are a fiftieth of a frame, one of their pixels then counts as much as five others."""

HARD = 0.1
"""Part of the pixels, those with the largest errors, that the last term is about."""

LAST = 4
"""Frames of a sample that are judged; those before them are only accumulated."""

PLACES = ((0, 0), (1, 1), (1, 0), (0, 1))
"""Which of 2 x 2 pixels (x, y) is taken from shaded frames in turn, and from what follows each, for smaller frames."""


def loss(method: FASSET, frames: Sequence[Frame], targets: Float[Tensor, "b n 3 H W"]) -> dict[str, Float[Tensor, ""]]:
    """The three terms as displayed, at sizes that take turns: means over the last frames.

    What is left out and which size it is follows from the time of the sample, so that a run goes on as it was.
    """
    number = int(frames[0].time.sum())
    frames, turn = frames[2 * (number % 3) :], number % 5
    if turn >= 3:
        targets = smaller(targets)
        method = method.at(3.0 if turn == 4 else 1.5)
    if turn == 4:
        frames = [coarser(frame, PLACES[k // 2 % 4]) for k, frame in enumerate(frames)]
    judged = [
        terms(larger.encoded(decode_log(image)), larger.encoded(target), mask)
        for image, target, mask in shown(method, frames, targets)
    ]
    return weighted(judged, WEIGHTS)


def published_loss(
    method: FASSET, frames: Sequence[Frame], targets: Float[Tensor, "b n 3 H W"]
) -> dict[str, Float[Tensor, ""]]:
    """The three terms in the log domain, with their published weights: means over the last frames."""
    judged = [terms(image, encode_log(target), mask) for image, target, mask in shown(method, frames, targets)]
    return weighted(judged, PUBLISHED_WEIGHTS)


def weighted(judged: Sequence[dict[str, Tensor]], weights: dict[str, float]) -> dict[str, Float[Tensor, ""]]:
    """Means of the terms of several frames, times their weights."""
    return {name: weight * torch.stack([each[name] for each in judged]).mean() for name, weight in weights.items()}


def shown(
    method: FASSET, frames: Sequence[Frame], targets: Float[Tensor, "b n 3 H W"]
) -> list[tuple[Float[Tensor, "b 3 H W"], Float[Tensor, "b 3 H W"], Float[Tensor, "b 1 H W"]]]:
    """Image in the log domain, truth and mask of the frames that have a truth; those before are accumulated alone."""
    state, first, found = method.start(frames[0]), len(frames) - targets.shape[1], []
    for frame in frames[:first]:
        if frame.color is not None:
            _, frame, history = method.accumulate(frame, state)
            state = State(last(frame), history, state.kept, frame.span, state.added)
    for frame, target in zip(frames[first:], targets.unbind(1), strict=True):
        generated = frame.color is None
        if generated:
            base, frame = method.extrapolate(frame, state)
        else:
            base, frame, history = method.accumulate(frame, state)
        maps, kept = method.extract(frame, base, state, generated=generated)
        image = base.image + method.added(maps, frame, base, generated=generated)
        found.append((image, target, F.interpolate(base.mask, (target.shape[-2], target.shape[-1]))))
        if not generated:
            state = State(last(frame), history, kept, frame.span, state.added)
    return found


def terms(
    image: Float[Tensor, "b 3 H W"], target: Float[Tensor, "b 3 H W"], mask: Float[Tensor, "b 1 H W"]
) -> dict[str, Float[Tensor, ""]]:
    """The three of the paper (Eq. 2 to 4), means over the images. Errors of a pixel are the mean of its channels'.

    L1: over all n pixels. Hole: over the n - sum(mask) pixels of holes, 0 where there are none. Hard: the sum over the
    tenth of the pixels with the largest errors, divided by n.
    """
    error = (image - target).abs().mean(1).flatten(1)
    hole = 1 - mask.flatten(1)
    count = error.shape[1]
    hard = error.topk(max(1, round(HARD * count)), 1).values.sum(1) / count
    holes = (error * hole).sum(1) / hole.sum(1).clamp(min=1)
    return {"l1": error.mean(), "hole": holes.mean(), "hard": hard.mean()}


def coarser(frame: Frame, place: tuple[int, int]) -> Frame:
    """The frame as a renderer would have sampled it at half the size: of each 2 x 2 pixels one, at `place` (x, y)."""
    x, y = place
    changes: dict[str, Tensor | None] = dict.fromkeys(BUFFERS)
    changes |= {
        name: image[..., y::2, x::2] / (2 if name.startswith("motion") else 1)
        for name in ("color", *GBUFFERS)
        if (image := getattr(frame, name)) is not None
    }
    jitter = (frame.jitter + torch.tensor([x - 0.5, y - 0.5], device=frame.jitter.device)) / 2
    return replace(frame, **changes, jitter=jitter)  # type: ignore[arg-type]


def smaller(images: Float[Tensor, "b n 3 H W"]) -> Float[Tensor, "b n 3 h w"]:
    """Linear images at three quarters of their size, each pixel the mean of those in it, as references are taken."""
    fine = tonemap(images.flatten(0, 1)).repeat_interleave(3, 2).repeat_interleave(3, 3)
    return untonemap(F.avg_pool2d(fine, 4)).unflatten(0, images.shape[:2])


recipe = Recipe(
    loss=loss, mode="alternate", shaded=5, truths=LAST, crop=(64, 64), batch=2, steps=1500, rate=1e-3, warmup=100
)

published_recipe = replace(recipe, loss=published_loss)
