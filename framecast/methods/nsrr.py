"""NSRR: a frame at twice its size, from its own samples and those of the four frames before it.

Paper:   Xiao, Nouri, Chapman, Fix, Lanman, Kaplanyan, "Neural Supersampling for Real-time Rendering", ACM Transactions
         on Graphics 39(4) (SIGGRAPH) 2020, https://doi.org/10.1145/3386569.3392376
Follows: features of every frame (one network for the current, one that the earlier ones share), zeros between the
         samples at display size, backward warping by accumulated motion, reweighting of the earlier frames in (0, 10),
         reconstruction by a U-Net. Layers and widths are those that public implementations agree on: with one network
         for the features of all frames they have 719,535 parameters and 382.7 GMAC from 480 x 270 to 1920 x 1080.
Differs: Samples lie where the renderer took them: the jitter of every frame is part of the warp. The public code puts
         them in the corners of their pixels.
         Zeros between samples are never made: reading the nearest sample, weighted by its distance, is the same as
         warping an image of them.
         Colour is x / (1 + max) under the sRGB curve; the paper's images are not HDR, reimplementations use YCbCr.
         Depth enters in [1/2, 1], so that a sample is never mistaken for nothing.
         The network adds to an image that it sees (`Config.residual`): the mean of the samples of all frames under the
         same weights, or what TAAU makes (`Config.accumulated`), which knows more than five frames and ships. The
         paper's network makes the image from nothing.
         Where TAAU's image stands still, what is added to it is the mean over the frames, complete after two periods of
         the jitter; that of five frames changes with every phase. It fades to one half as that image becomes exact.
         Motion is accumulated surface by surface, as in ExtraNet. Features of earlier frames are kept, not made again.
         The loss is 1 - SSIM + 5 L1, without the differences in VGG features, whose weights the package does not have.
Needs:   color, depth, motion
Modes:   pass
State:   samples, features and accumulated motion of the last four frames; where TAAU is asked what it keeps, and what
         was added to its image
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from framecast.color import encode_srgb, tonemap
from framecast.frame import Frame
from framecast.losses import difference
from framecast.methods import larger
from framecast.methods.larger import WHITE, decoded, encoded, nearness, require, settled, warn_of_stillness
from framecast.methods.reproject import chosen, reaching, steps
from framecast.methods.taau import TAAU, History
from framecast.nets import padded
from framecast.recipe import Recipe
from framecast.resample import (
    enlarge,
    nearest_sample,
    phases,
    place,
    positions,
    size_at,
    tent,
)
from framecast.warp import chain, pick

PAST = 4
"""Earlier frames that the network sees."""

BASE = 0.4
"""Weight, in the mean of all samples, of the current frame enlarged; a sample on the pixel's centre has 1."""


@dataclass(frozen=True)
class Config:
    """The network; the defaults are the published widths."""

    scale: float = 2.0
    """Output size divided by input size."""
    features: tuple[int, int] = (32, 8)
    """Channels inside of the feature networks, and of what they make."""
    weights: int = 32
    """Channels inside of the reweighting network."""
    widths: tuple[int, int, int] = (64, 32, 128)
    """Channels of the U-Net: outside and at half size, at its full-size joints, and at a quarter of the size."""
    residual: bool = True
    """Show the network the weighted mean of all samples and add its output to it; without it the published layers."""
    accumulated: bool = False
    """Instead of that mean, the image of TAAU."""


FAST = Config(weights=16, widths=(32, 16, 64))
"""Half the channels at display size, as the "fast" variant of public implementations has them in the U-Net."""

STEADY = replace(FAST, accumulated=True)
"""The same, adding to the image of TAAU."""


@dataclass(frozen=True)
class Past:
    """One earlier frame, on its own grid of samples."""

    color: Float[Tensor, "b 3 h w"]
    """Tone-mapped."""
    shown: Float[Tensor, "b 4 h w"]
    """The same under the sRGB curve, and depth as `nearness` encodes it: what networks see."""
    features: Float[Tensor, "b f h w"]
    depth: Float[Tensor, "b 1 h w"]
    motion: Float[Tensor, "b 2 h w"]
    """From each sample of the newest frame to its place on this one's grid of samples; 0 for the newest."""
    time: Float[Tensor, " b"]
    jitter: Float[Tensor, "b 2"]
    known: Bool[Tensor, " b"]
    """False for what was before the last reset."""


@dataclass(frozen=True)
class State:
    """The last four frames, newest first; unknown ones where there were fewer since the last reset."""

    past: tuple[Past, ...]
    history: History | None = None
    """What TAAU knows, where the network adds to its image."""
    added: Float[Tensor, "b 3 H W"] | None = None
    """What was added to that image, under the sRGB curve."""


for _kind in (Past, State):
    torch.export.register_dataclass(_kind)


def layer(inputs: int, outputs: int) -> nn.Sequential:
    """3 x 3 convolution and rectifier."""
    return nn.Sequential(nn.Conv2d(inputs, outputs, 3, 1, 1), nn.ReLU())


def up(channels: int) -> nn.Sequential:
    """Twice the size by a transposed 3 x 3 convolution, and a rectifier."""
    return nn.Sequential(nn.ConvTranspose2d(channels, channels, 3, 2, 1, 1), nn.ReLU())


class Reconstruction(nn.Module):
    """The U-Net: 64, 32 at display size, 64, 64 at half and 128, 128 at a quarter of it as published.

    Sizes have to be multiples of 4.
    """

    def __init__(self, inputs: int, widths: tuple[int, int, int]) -> None:
        super().__init__()
        a, b, c = widths
        self.enter = nn.Sequential(layer(inputs, a), layer(a, b))
        self.middle = nn.Sequential(nn.MaxPool2d(2), layer(b, a), layer(a, a))
        self.bottom = nn.Sequential(nn.MaxPool2d(2), layer(a, c), layer(c, c), up(c))
        self.join_middle = nn.Sequential(layer(c + a, a), layer(a, a), up(a))
        self.join = layer(a + b, b)
        self.leave = nn.Conv2d(b, 3, 3, 1, 1)

    def forward(self, x: Float[Tensor, "b c H W"]) -> Float[Tensor, "b 3 H W"]:
        full = self.enter(x)
        half = self.middle(full)
        half = self.join_middle(torch.cat((self.bottom(half), half), 1))
        image: Tensor = self.leave(self.join(torch.cat((half, full), 1)))
        return image


class NSRR(nn.Module):
    """See the top of this file."""

    needs: tuple[str, ...] = ("color", "depth", "motion")
    needs_generated: tuple[str, ...] = ()
    modes: tuple[str, ...] = ("pass",)
    scales: tuple[float, ...] = (2.0,)
    parts: tuple[str, ...] = ("look", "moved", "accumulate", "predict")
    step_motion: bool = False

    def __init__(self, config: Config = Config()) -> None:
        super().__init__()
        self.config = config
        self.history = None if config.accumulated else PAST + 1
        self.taau = TAAU(larger.Config(config.scale)) if config.accumulated else None
        inner, outer = config.features
        self.extract = nn.ModuleList(
            nn.Sequential(layer(4, inner), layer(inner, inner), layer(inner, outer)) for _ in ("current", "past")
        )
        self.reweight = nn.Sequential(
            layer(4 * (PAST + 1), config.weights),
            layer(config.weights, config.weights),
            nn.Conv2d(config.weights, PAST, 3, 1, 1),
            nn.Tanh(),
        )
        seen = (PAST + 1) * (4 + outer)
        self.reconstruct = Reconstruction(seen + 3 if config.residual else seen, config.widths)
        nn.init.constant_(self.reweight[2].bias, -1.0986)  # type: ignore[arg-type]  # every frame weighs 1
        if config.residual:
            nn.init.normal_(self.reconstruct.leave.weight, std=1e-3)  # the first image is, nearly, the mean
            nn.init.zeros_(self.reconstruct.leave.bias)  # type: ignore[arg-type]

    def start(self, frame: Frame) -> State:
        """The state before the first frame, which is `frame`: nothing is known."""
        require(frame, "nsrr", self.needs)
        assert frame.depth is not None
        b, _, h, w = frame.depth.shape
        color, shown, features, depth, still = (
            frame.depth.new_zeros(b, c, h, w) for c in (3, 4, self.config.features[1], 1, 2)
        )
        known = torch.zeros_like(frame.reset)
        nothing = Past(color, shown, features, depth, still, frame.time, frame.jitter, known)
        if self.taau is None:
            return State((nothing,) * PAST)
        history = self.taau.start(frame)
        return State((nothing,) * PAST, history, torch.zeros_like(history.color))

    def forward(self, frame: Frame, state: State) -> tuple[Float[Tensor, "b 3 H W"], State]:
        """The frame at display size, and the state with it as the newest of the past.

        Raises:
            ValueError: the frame was not shaded, or its buffers are of different sizes.
        """
        require(frame, "nsrr", self.needs)
        newest = state.past[0]
        warn_of_stillness(torch.where(newest.known[:, None], newest.jitter, 1.0), frame.jitter, "nsrr")
        frame = reaching(frame, newest.time)
        now, past = self.look(frame), self.moved(frame, state)
        base, history = self.accumulate(frame, state.history)
        image, added = self.predict(now, past, base), None
        if base is not None and history is not None and state.added is not None:
            added = settled(frame, image - base, state.added, history.still, self.config.scale)
            image = base + added * (1 - history.still / (2 * phases(self.config.scale))).clamp(min=0.5)
        return decoded(image), State((now, *past[:-1]), history, added)

    def accumulate(
        self, frame: Frame, history: History | None
    ) -> tuple[Float[Tensor, "b 3 H W"] | None, History | None]:
        """The image of TAAU, tone-mapped under the sRGB curve, and what it knows then; None where not asked."""
        if self.taau is None or history is None:
            return None, None
        with torch.no_grad(), torch.autocast(frame.time.device.type, enabled=False):
            image, history = self.taau.accumulate(frame, history)
        return encoded(image), history

    def look(self, frame: Frame) -> Past:
        """The frame as it will be remembered."""
        assert frame.color is not None
        assert frame.depth is not None
        color = tonemap(frame.color).clamp(max=WHITE)
        shown = torch.cat((encode_srgb(color), nearness(frame.depth)), 1)
        features = self.extract[1](shown).float()
        still, known = torch.zeros_like(color[:, :2]), torch.ones_like(frame.reset)
        return Past(color, shown, features, frame.depth, still, frame.time, frame.jitter, known)

    def moved(self, frame: Frame, state: State) -> tuple[Past, ...]:
        """The past as the frame sees it: motion leads from the frame on, and before a reset nothing is known."""
        assert frame.depth is not None
        newest = state.past[0]
        motion = steps(frame, newest.time, newest.jitter)
        motion = chosen(frame.reset, torch.zeros_like(motion), motion)
        reached = [motion]
        for past in state.past[1:]:
            spans = (frame.time - newest.time, newest.time - past.time)
            reached.append(chain([motion, past.motion], [frame.depth, newest.depth], spans))
        return tuple(
            replace(past, motion=m, known=past.known & ~frame.reset)
            for past, m in zip(state.past, reached, strict=True)
        )

    def predict(
        self, now: Past, past: tuple[Past, ...], base: Float[Tensor, "b 3 H W"] | None = None
    ) -> Float[Tensor, "b 3 H W"]:
        """The image, tone-mapped under the sRGB curve; the network adds to `base`, or to the mean of the samples."""
        small = (now.depth.shape[-2], now.depth.shape[-1])
        size = size_at(small, self.config.scale)
        features = self.extract[0](now.shown).float()
        with torch.autocast(now.depth.device.type, enabled=False):
            here, nearest = positions(small, size, now.jitter), nearest_sample(small, size, now.jitter)
            placed = [place(torch.cat((now.color, now.shown, features), 1), here)]
            for one in past:
                values = torch.cat((one.color, one.shown, one.features), 1)
                values, cover = place(values, here + pick(one.motion, nearest))
                placed.append((values, cover * one.known[:, None, None, None]))
        weights = 5 * (self.reweight(torch.cat([v[:, 3:7] * cover for v, cover in placed], 1)).float() + 1)
        each = (torch.ones_like(weights[:, :1]), *weights.split(1, 1))
        weighted = [(values, cover * weight) for (values, cover), weight in zip(placed, each, strict=True)]
        x = torch.cat([values[:, 3:] * weight for values, weight in weighted], 1)
        if not self.config.residual:
            return self.reconstructed(x)
        if base is None:
            alone = enlarge(now.color, size, now.jitter, tent, 2).image
            base = encode_srgb(average([(values[:, :3], weight) for values, weight in weighted], alone))
        return base + self.reconstructed(torch.cat((x, base), 1))

    def reconstructed(self, x: Float[Tensor, "b c H W"]) -> Float[Tensor, "b 3 H W"]:
        """What the U-Net makes of its input, at any size."""
        height, width = x.shape[-2:]
        image: Tensor = self.reconstruct(padded(x, 4)).float()
        return image[..., :height, :width]


def average(
    weighted: Sequence[tuple[Float[Tensor, "b 3 H W"], Float[Tensor, "b 1 H W"]]], base: Float[Tensor, "b 3 H W"]
) -> Float[Tensor, "b 3 H W"]:
    """Weighted mean of the samples on each display pixel; `base`, weakly, where there are none."""
    total, sum_of_weights = BASE * base, torch.full_like(base[:, :1], BASE)
    for values, weight in weighted:
        total, sum_of_weights = total + values * weight, sum_of_weights + weight
    return total / sum_of_weights


# Training.


def loss(method: NSRR, frames: Sequence[Frame], targets: Float[Tensor, "b n 3 H W"]) -> dict[str, Float[Tensor, ""]]:
    """The two terms on the last frame, tone-mapped under the sRGB curve."""
    history = method.start(frames[0]).history
    first = len(frames) - PAST - 1  # frames before it are only for the image that the network adds to
    for frame in frames[: first + 1]:
        _, history = method.accumulate(frame, history)
    state = State((method.look(frames[first]),), history)
    for frame in frames[first + 1 : -1]:
        _, history = method.accumulate(frame, state.history)
        state = State((method.look(frame), *method.moved(frame, state)), history)
    base, _ = method.accumulate(frames[-1], state.history)
    image = method.predict(method.look(frames[-1]), method.moved(frames[-1], state), base)
    return difference(image, encoded(targets[:, -1]))


recipe = Recipe(loss=loss, mode="pass", shaded=PAST + 1, crop=(64, 64), batch=2, steps=4000, rate=5e-4, warmup=100)

steady_recipe = replace(recipe, shaded=2 * PAST + 2)
"""For `STEADY`: the first five frames are TAAU's alone."""
