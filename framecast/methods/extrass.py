"""ExtraSS: every second frame shaded at half size; all frames at full size, extrapolated where they were not shaded.

Paper:   Wu, Kim, Zeng, Vembar, Jha, Kaplanyan, Yan, "ExtraSS: A Framework for Joint Spatial Super Sampling and Frame
         Extrapolation", SIGGRAPH Asia 2023 Conference Papers, https://doi.org/10.1145/3610548.3618224
Follows: section 4: an unshaded frame begins as the last shaded one, warped by its G-buffers (`guided.py`, Eq. 1 to 3);
         two encoders, one for shaded frames and one for extrapolated ones, and one decoder for both (Eq. 10); the last
         full-size image warped along the motion enters both (recurrent); a spatial loss with a term of its own where
         the warp found nothing, and a temporal loss between the features that the two encoders make of the same frame
         (Eq. 13).
Differs: The flow that refines moving shading before the network (section 4.2) is not part of it, so extrapolated frames
         begin as the guided warp alone, with a mask of what it found.
         Layers and widths are ours, for none are published: U-Nets at the size of the input, 24 to 64 channels, full
         size entering and leaving as blocks of 2 x 2 pixels.
         The network mixes the enlarged frame and the warped last image by a weight of its own, and adds to that.
         The enlarged frame is made from samples where they lie (jitter), and the network is told where.
         Colour is x / (1 + max) under the sRGB curve. No loss in VGG features, whose weights the package does not have.
Needs:   color, depth, motion, albedo, metallic, normal; of the generated frame the same but color
Modes:   extrapolate, pass
State:   the last shaded frame (light, surfaces), and the last image at full size
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from framecast.color import decode_log, decode_srgb, modulate, tonemap
from framecast.frame import Frame
from framecast.losses import difference
from framecast.methods.guided import Seen, extrapolated, guides
from framecast.methods.larger import WHITE, decoded, encoded, nearness, require
from framecast.methods.mnss import State as Last
from framecast.methods.mnss import moved, shown
from framecast.methods.reproject import light, surface
from framecast.nets import padded
from framecast.recipe import Recipe
from framecast.resample import enlarge, size_at, tent

BUFFERS = ("depth", "motion", "albedo", "metallic", "normal")

TRUST = 1.0
"""Logit of the last image's weight that an untrained network gives: 0.73."""


@dataclass(frozen=True)
class Config:
    """The network."""

    scale: float = 2.0
    """Output size divided by input size."""
    widths: tuple[int, int, int, int] = (24, 32, 48, 64)
    """Channels at the size of the input, a half, a quarter and an eighth of it."""


@dataclass(frozen=True)
class State:
    """What the next frame sees."""

    shaded: Seen
    """The last shaded frame, for guided warping."""
    last: Last
    """The last image."""


@dataclass(frozen=True)
class Made:
    """What became of a frame."""

    image: Float[Tensor, "b 3 H W"]
    """Tone-mapped under the sRGB curve."""
    features: tuple[Tensor, ...]
    """The encoder's, from the size of the input down."""
    known: Float[Tensor, "b 1 h w"]
    """1 where the frame was shaded or its surface found in the last shaded one."""
    depth: Float[Tensor, "b 1 H W"]
    """As `nearness` encodes it."""


torch.export.register_dataclass(State)


def stage(inputs: int, outputs: int, stride: int) -> nn.Sequential:
    """Two convolutions with rectifiers."""
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, 3, stride, 1), nn.ReLU(), nn.Conv2d(outputs, outputs, 3, 1, 1), nn.ReLU()
    )


class Encoder(nn.Module):
    """Features at four sizes."""

    def __init__(self, inputs: int, widths: Sequence[int]) -> None:
        super().__init__()
        pairs = zip((inputs, *widths), widths, strict=False)
        self.stages = nn.ModuleList(stage(a, b, 1 if k == 0 else 2) for k, (a, b) in enumerate(pairs))

    def forward(self, x: Float[Tensor, "b c h w"]) -> tuple[Tensor, ...]:
        found = []
        for each in self.stages:
            x = each(x)
            found.append(x)
        return tuple(found)


class Decoder(nn.Module):
    """From those features what is added to the image, and how much of the last one is kept, as blocks of 2 x 2."""

    def __init__(self, widths: Sequence[int]) -> None:
        super().__init__()
        pairs = reversed(list(pairwise(widths)))
        self.stages = nn.ModuleList(stage(a + b, a, 1) for a, b in pairs)
        self.leave = nn.Conv2d(widths[0], 16, 3, 1, 1)
        nn.init.normal_(self.leave.weight, std=1e-3)
        with torch.no_grad():
            assert self.leave.bias is not None
            self.leave.bias.zero_()
            self.leave.bias[12:] = TRUST

    def forward(self, features: tuple[Tensor, ...]) -> Float[Tensor, "b 4 H W"]:
        *others, x = features
        for each, skip in zip(self.stages, reversed(others), strict=True):
            x = each(torch.cat((F.interpolate(x, scale_factor=2.0, mode="bilinear"), skip), 1))
        found: Tensor = F.pixel_shuffle(self.leave(x), 2)
        return found


class ExtraSS(nn.Module):
    """See the top of this file."""

    needs: tuple[str, ...] = ("color", *BUFFERS)
    needs_generated: tuple[str, ...] = BUFFERS
    modes: tuple[str, ...] = ("extrapolate", "pass")
    scales: tuple[float, ...] = (2.0,)
    parts: tuple[str, ...] = ("seen", "make")
    history: int | None = None
    step_motion: bool = True

    def __init__(self, config: Config = Config()) -> None:
        super().__init__()
        self.config = config
        self.shaded = Encoder(31, config.widths)
        self.extrapolated = Encoder(35, config.widths)
        self.decoder = Decoder(config.widths)

    def start(self, frame: Frame) -> State:
        """The state before the first frame, which is `frame`: nothing is known.

        Raises:
            ValueError: a buffer is missing.
        """
        require(frame, "extrass", self.needs)
        assert frame.depth is not None
        size = size_at((frame.depth.shape[-2], frame.depth.shape[-1]), self.config.scale)
        image = frame.depth.new_zeros(frame.depth.shape[0], 4, *size)
        return State(self.seen(frame), Last(image, frame.time, frame.jitter, torch.zeros_like(frame.reset)))

    def seen(self, frame: Frame) -> Seen:
        """A shaded frame as guided warping reads it."""
        return Seen(light(frame), guides(frame), frame.jitter, frame.time)

    def forward(self, frame: Frame, state: State) -> tuple[Float[Tensor, "b 3 H W"], State]:
        """The frame at full size; it becomes the history of the next one, generated or not."""
        made = self.make(frame, state)
        return decoded(made.image), self.kept(made, frame, state)

    def kept(self, made: Made, frame: Frame, state: State) -> State:
        """The state after a frame."""
        image = torch.cat((decode_srgb(made.image.clamp(0, 1)).clamp(max=WHITE), made.depth), 1)
        last = Last(image, frame.time, frame.jitter, torch.ones_like(frame.reset))
        return State(state.shaded if frame.color is None else self.seen(frame), last)

    def make(self, frame: Frame, state: State, *, warped: bool = False) -> Made:
        """The image and what it was made of; with `warped` a shaded frame is treated as if it had not been."""
        assert frame.depth is not None
        assert frame.albedo is not None
        size = (state.last.image.shape[-2], state.last.image.shape[-1])
        generated = frame.color is None or warped
        with torch.autocast(frame.depth.device.type, enabled=False):
            color, known = self.extrapolate(frame, state) if generated else (frame.color, torch.ones_like(frame.depth))
            assert color is not None
            near = nearness(frame.depth)
            samples = torch.cat((tonemap(color).clamp(max=WHITE), near), 1)
            current = shown(enlarge(samples, size, frame.jitter, tent, 2).image)
            history, usable = moved(frame, state.last, size)
            history = shown(history) * usable
            where = frame.jitter[:, :, None, None].expand(-1, -1, *near.shape[-2:])
            large = torch.cat((current[:, :3], history[:, :3], usable), 1)
            inputs = [F.pixel_unshuffle(large, 2), near, where]
            if generated:
                inputs += [frame.albedo, known]
        encoder = self.extrapolated if generated else self.shaded
        features = encoder(padded(torch.cat(inputs, 1), 8))
        added = self.decoder(features).float()[..., : size[0], : size[1]]
        kept = torch.sigmoid(added[:, 3:]) * usable
        image = current[:, :3] + kept * (history[:, :3] - current[:, :3]) + added[:, :3]
        return Made(image, features, known, current[:, 3:])

    def extrapolate(self, frame: Frame, state: State) -> tuple[Float[Tensor, "b 3 h w"], Float[Tensor, "b 1 h w"]]:
        """The last shaded frame on this frame's surfaces, linear, and 1 where they were found in it."""
        image, known = extrapolated(frame, state.shaded)
        return modulate(decode_log(image), surface(frame)), known.float()


# Training.


def loss(method: ExtraSS, frames: Sequence[Frame], targets: Float[Tensor, "b n 3 H W"]) -> dict[str, Float[Tensor, ""]]:
    """Means over the frames: the terms of the images, the error in holes, and the difference of the two encoders."""
    state, terms = method.start(frames[0]), list[dict[str, Tensor]]()
    for frame, target in zip(frames, targets.unbind(1), strict=True):
        made, truth = method.make(frame, state), encoded(target)
        found = difference(made.image, truth)
        hole = F.interpolate(1 - made.known, (truth.shape[-2], truth.shape[-1]))
        found["hole"] = ((made.image - truth).abs() * hole).mean((1, 2, 3)).sum() / hole.mean((1, 2, 3)).sum().clamp(
            1e-2
        )
        if frame.color is not None and len(terms) > 0:
            other = method.make(frame, state, warped=True).features
            pairs = zip(made.features, other, strict=True)
            found["temporal"] = 0.05 * torch.stack([(a - b).float().abs().mean() for a, b in pairs]).mean()
        terms.append(found)
        state = method.kept(made, frame, state)
    names = {name for term in terms for name in term}
    return {name: torch.stack([term[name] for term in terms if name in term]).mean() for name in sorted(names)}


recipe = Recipe(
    loss=loss, mode="alternate", shaded=3, truths=6, crop=(64, 64), batch=2, steps=2000, rate=5e-4, warmup=100
)
