"""ExtraSS: every second frame shaded at half size; all frames at full size, extrapolated where they were not shaded.

Paper:   Wu, Kim, Zeng, Vembar, Jha, Kaplanyan, Yan, "ExtraSS: A Framework for Joint Spatial Super Sampling and Frame
         Extrapolation", SIGGRAPH Asia 2023 Conference Papers, https://doi.org/10.1145/3610548.3618224
Follows: section 4: an unshaded frame begins as the last shaded one, warped by its G-buffers (`guided.py`, Eq. 1 to 3);
         two encoders, one for shaded frames and one for extrapolated ones, and one decoder for both (Eq. 10); the last
         full-size image warped along the motion enters both (recurrent); a spatial loss with a term of its own where
         the warp found nothing, and a temporal loss between the features that the two encoders make of the same frame
         (Eq. 13).
Differs: What the network guides is an accumulated image: TAAU's, which takes unshaded frames in, too. Guided warping
         makes samples of them: last light on the surfaces that were rendered, at their own jitter. The network says how
         far history is still believed and how much more or less the frame counts, and how far the image then goes
         towards the pixels around each, or away from them. It makes no colour: the paper's network makes its image
         from nothing, for which a few small clips are not enough. `ACCUMULATED` is what needs no network.
         What is accumulated learns through all frames of a sample, so that it learns what to keep for later ones.
         The last image enters by at most nine tenths, read between its pixels without overshoot: errors die out.
         Where a picture stands still for two periods of the jitter nothing is added any more, and it comes to rest.
         Extrapolated frames begin as the guided warp alone, without the flow of section 4.2 (`refine.py`).
         Layers and widths are ours, for none are published: U-Nets at the size of the input, 24 to 64 channels, full
         size entering and leaving as blocks of 2 x 2 pixels.
         Samples count where they lie (jitter), and the network is told where.
         Colour is x / (1 + max) under the sRGB curve. The spatial loss is the root of the mean square error as
         displayed, not L1; none in VGG features, whose weights the package does not have.
Needs:   color, depth, motion, albedo, metallic, normal; of the generated frame the same but color
Modes:   extrapolate, pass
State:   the last shaded frame (light, surfaces) and the way to it; what TAAU keeps; the last image at full size
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from framecast.color import decode_log, encode_srgb, modulate, to_display, tonemap
from framecast.frame import Frame
from framecast.losses import similarity
from framecast.methods import larger
from framecast.methods.guided import GUESSED, Seen, after_cut, extrapolated, require, seen
from framecast.methods.larger import AROUND, WHITE, decoded, encoded, nearness, sharpened, warn_of_stillness
from framecast.methods.reproject import chosen, steps, surface
from framecast.methods.taau import TAAU, History, Sample, mix
from framecast.nets import padded
from framecast.recipe import Recipe
from framecast.resample import enlarge, enlarged_motion, foreground, from_ycocg, sharp_warp, tent
from framecast.warp import chain, inside

BUFFERS = ("depth", "motion", "albedo", "metallic", "normal")

KEPT = 0.9
"""Largest part of an image that comes from the last one."""

CHOICE = (-3.0, -4.0)
"""Logits of what an untrained network takes of the last image and of the enlarged frame: 4 and 2 hundredths."""

BELIEVED = 5.0
"""Logit of the part of its weight that an untrained network leaves to history."""

FINE = 15
"""Channels at full size that the network sees."""

TOLD = 8
"""Channels that the decoder tells of each pixel."""

INSIDE = 32
"""Channels of what follows it at full size."""

RANGE = 2.0
"""The network makes a frame count up to this many factors e more or less."""

ALONE = 4
"""Unshaded frames in a row from which on a warning says that nothing was measured with so many."""


@dataclass(frozen=True)
class Config:
    """The network."""

    scale: float = 2.0
    """Output size divided by input size."""
    widths: tuple[int, int, int, int] = (24, 32, 48, 64)
    """Channels at the size of the input, a half, a quarter and an eighth of it."""
    network: bool = True
    """Without it images are what is accumulated of shaded frames and guided warps."""


ACCUMULATED = Config(network=False)
"""What needs no training."""


@dataclass(frozen=True)
class State:
    """What the next frame sees."""

    shaded: Seen
    """The last shaded frame, for guided warping."""
    reach: Float[Tensor, "b 2 h w"]
    """From the pixels of the last frame to the same surfaces in the last shaded one; 0 where they are the same."""
    history: History
    """What TAAU knows."""
    last: Float[Tensor, "b 3 H W"]
    """The last image, tone-mapped under the sRGB curve."""
    time: Float[Tensor, " b"]
    """Of the last frame."""
    known: Bool[Tensor, " b"]
    """False before the first frame."""
    alone: Int[Tensor, " b"]
    """Frames since the last shaded one."""


@dataclass(frozen=True)
class Gathered:
    """What is known of a frame before the network sees it; images are tone-mapped, under the sRGB curve."""

    inputs: Float[Tensor, "b c h w"]
    """Of its encoder."""
    fine: Float[Tensor, "b f H W"]
    """What of them is of full size, which `Head` sees once more."""
    current: Float[Tensor, "b 3 H W"]
    """The frame itself, or the guided warp, enlarged."""
    sample: Sample
    """The same and history, as TAAU mixes them."""
    last: Float[Tensor, "b 3 H W"]
    """The last image, moved here."""
    usable: Float[Tensor, "b 1 H W"]
    """1 where there is one."""
    known: Float[Tensor, "b 1 h w"]
    """1 where the frame was shaded or its surface found in the last shaded one."""
    reach: Float[Tensor, "b 2 h w"]
    """As in `State`, of this frame."""


@dataclass(frozen=True)
class Predicted:
    """What became of it."""

    image: Float[Tensor, "b 3 H W"]
    """Tone-mapped, under the sRGB curve."""
    history: History
    """With this frame."""
    features: tuple[Tensor, ...]
    """Of the encoder, from the size of the input down."""


for _kind in (State, Gathered, Predicted):
    torch.export.register_dataclass(_kind)


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
    """From those features, in blocks of 2 x 2, what `Head` is told of each pixel beside what lies there."""

    def __init__(self, widths: Sequence[int]) -> None:
        super().__init__()
        pairs = reversed(list(pairwise(widths)))
        self.stages = nn.ModuleList(stage(a + b, a, 1) for a, b in pairs)
        self.leave = nn.Conv2d(widths[0], 4 * TOLD, 3, 1, 1)

    def forward(self, features: tuple[Tensor, ...]) -> Float[Tensor, "b g H W"]:
        *others, x = features
        for each, skip in zip(self.stages, reversed(others), strict=True):
            x = each(torch.cat((F.interpolate(x, scale_factor=2.0, mode="bilinear"), skip), 1))
        found: Tensor = F.pixel_shuffle(self.leave(x), 2)
        return found


class Head(nn.Sequential):
    """At full size: how far the image goes towards the pixels around (`larger.sharpened`), the logits of `CHOICE` and
    `BELIEVED`, and how much more or less the frame counts."""

    def __init__(self) -> None:
        leave = nn.Conv2d(INSIDE, len(AROUND) + 4, 1)
        super().__init__(nn.Conv2d(FINE + TOLD, INSIDE, 3, 1, 1), nn.ReLU(), leave)
        nn.init.normal_(leave.weight, std=1e-3)
        with torch.no_grad():
            assert leave.bias is not None
            leave.bias.copy_(torch.tensor([0.0] * len(AROUND) + [*CHOICE, BELIEVED, 0.0]))


class ExtraSS(nn.Module):
    """See the top of this file."""

    needs: tuple[str, ...] = ("color", *BUFFERS)
    needs_generated: tuple[str, ...] = BUFFERS
    modes: tuple[str, ...] = ("extrapolate", "pass")
    scales: tuple[float, ...] = (2.0,)
    parts: tuple[str, ...] = ("gather", "predict")
    history: int | None = None
    step_motion: bool = True

    def __init__(self, config: Config = Config()) -> None:
        super().__init__()
        if config.scale not in self.scales:
            raise ValueError(f"extrass makes images of 2 times the size, not {config.scale:g}; use scale 2, or taau")
        self.config = config
        self.taau = TAAU(larger.Config(config.scale))
        if config.network:
            self.shaded = Encoder(4 * FINE + 3, config.widths)
            self.extrapolated = Encoder(4 * FINE + 7, config.widths)
            self.decoder = Decoder(config.widths)
            self.head = Head()

    def start(self, frame: Frame) -> State:
        """The state before the first frame, which is `frame`: nothing is known.

        Raises:
            ValueError: the frame was not shaded, or a buffer is missing.
        """
        larger.require(frame, "extrass", self.needs)
        history = self.taau.start(frame)
        unknown = torch.zeros_like(frame.reset)
        last = torch.zeros_like(history.color)
        reach = torch.zeros_like(history.motion)
        alone = torch.zeros_like(frame.reset, dtype=torch.int32)
        return State(seen(frame), reach, history, last, frame.time, unknown, alone)

    def forward(self, frame: Frame, state: State) -> tuple[Float[Tensor, "b 3 H W"], State]:
        """The frame at full size; it becomes the history of the next one, generated or not.

        Raises:
            ValueError: a buffer is missing.
        """
        warn_of_stillness(state.history.jitter, frame.jitter, "extrass")
        if frame.color is None:
            require(frame, "extrass", self.needs, self.needs_generated)
            warn_of_solitude(state)
            state = replace(state, shaded=after_cut(frame, state.shaded, "extrass"))
        else:
            larger.require(frame, "extrass", self.needs)
        gathered = self.gather(frame, state)
        made = self.predict(gathered, frame.color is None)
        return decoded(made.image), kept(made, gathered, frame, state)

    def gather(self, frame: Frame, state: State, *, warped: bool = False) -> Gathered:
        """Everything but the network; with `warped` a shaded frame is treated as if it had not been."""
        assert frame.depth is not None
        assert frame.albedo is not None
        size = (state.last.shape[-2], state.last.shape[-1])
        with torch.autocast(frame.depth.device.type, enabled=False):
            motion = steps(frame, state.time, frame.jitter)
            motion = chosen(frame.reset, torch.zeros_like(motion), motion)
            spans = frame.time - state.time, state.time - state.shaded.time
            reach = chain([motion, state.reach], [frame.depth, state.history.depth], spans)
            reach = chosen(frame.reset, torch.zeros_like(motion), reach)
            color, known = frame.color, torch.ones_like(frame.depth)
            if color is None or warped:
                color, known = self.extrapolate(frame, state.shaded, reach)
            shown = replace(frame, color=color, motion=motion)
            sample = self.taau.look(shown, state.history, GUESSED + (1 - GUESSED) * known)
            near, none = nearness(frame.depth), state.last[:, :1]
            if not self.config.network:  # which alone asks for the rest
                return Gathered(near, none, state.last, sample, state.last, none, known, reach)
            current = encode_srgb(enlarge(tonemap(color).clamp(max=WHITE), size, frame.jitter, tent, 2).image)
            large = enlarged_motion(foreground(frame.depth, motion)[1], size, frame.jitter)
            usable = (inside(large) & (state.known & ~frame.reset)[:, None, None, None]).float()
            last = sharp_warp(state.last, large) * usable
            where = frame.jitter[:, :, None, None].expand(-1, -1, *near.shape[-2:])
            base, history = mix(sample)
            past = encode_srgb(from_ycocg(sample.history.color).clamp(0, 1)) * (sample.history.weight > 0)
            confidence = history.weight / (1 + history.weight)
            fine = torch.cat((current, encoded(base), past, last, usable, confidence, sample.unsettled), 1)
            inputs = [F.pixel_unshuffle(fine, 2), near, where]
            if frame.color is None or warped:
                inputs += [frame.albedo, known]
        return Gathered(torch.cat(inputs, 1), fine, current, sample, last, usable, known, reach)

    def extrapolate(
        self, frame: Frame, shaded: Seen, reach: Float[Tensor, "b 2 h w"]
    ) -> tuple[Float[Tensor, "b 3 h w"], Float[Tensor, "b 1 h w"]]:
        """The last shaded frame on this frame's surfaces, linear; 1 where they were found, nowhere after a cut."""
        effective = reach + (frame.jitter - shaded.jitter)[:, :, None, None]
        image, known = extrapolated(frame, shaded, motion=effective)
        known = known & ~frame.reset[:, None, None, None]
        return modulate(decode_log(image), surface(frame)), known.float()

    def predict(self, gathered: Gathered, generated: bool) -> Predicted:
        """The image, and what it leaves to the next one."""
        g = gathered
        if not self.config.network:
            image, history = mix(g.sample)
            return Predicted(encoded(image), history, ())
        height, width = g.last.shape[-2:]
        features = (self.extrapolated if generated else self.shaded)(padded(g.inputs, 8))
        told = self.decoder(features)[..., :height, :width]
        found = self.head(torch.cat((g.fine, told), 1)).float()
        with torch.autocast(found.device.type, enabled=False):
            taps, of_last, of_frame, believed, counts = found.split((len(AROUND), 1, 1, 1, 1), 1)
            base, history = mix(g.sample, torch.sigmoid(believed), torch.exp(RANGE * torch.tanh(counts)))
            base, of_last = encoded(base), KEPT * torch.sigmoid(of_last) * g.usable
            beside = of_last * (g.last - base) + torch.sigmoid(of_frame) * (g.current - base) + sharpened(base, taps)
            return Predicted(base + g.sample.unsettled * beside, history, features)


def kept(made: Predicted, gathered: Gathered, frame: Frame, state: State) -> State:
    """The state after a frame. What is accumulated also learns for the images after this one."""
    known, history = torch.ones_like(frame.reset), made.history
    last = made.image.detach().clamp(0, 1)
    if frame.color is None:
        return State(state.shaded, gathered.reach, history, last, frame.time, known, state.alone + 1)
    nowhere = torch.zeros_like(gathered.reach)
    return State(seen(frame), nowhere, history, last, frame.time, known, torch.zeros_like(state.alone))


def warn_of_solitude(state: State) -> None:
    """Warns before the first frame with too many others between it and the last shaded one."""
    if bool((state.alone + 1 == ALONE).any()):
        warnings.warn(
            f"{ALONE} frames in a row were not shaded; extrass is trained for one between shaded ones and measured "
            f"with up to {ALONE - 1}: all show the light of the last shaded frame; shade one of {ALONE}, at least",
            stacklevel=3,
        )


# Training.


def loss(method: ExtraSS, frames: Sequence[Frame], targets: Float[Tensor, "b n 3 H W"]) -> dict[str, Float[Tensor, ""]]:
    """Means over the frames: the terms of the images and the error in holes; the last shaded frame is also made as if
    it had not been, which adds the difference of the two encoders' features."""
    state, terms = method.start(frames[0]), list[dict[str, Tensor]]()
    for k, (frame, target) in enumerate(zip(frames, targets.unbind(1), strict=True)):
        gathered = method.gather(frame, state)
        made = method.predict(gathered, frame.color is None)
        terms.append(compared(made.image, gathered, encoded(target)))
        if frame.color is not None and 0 < k >= len(frames) - 2:
            other = method.gather(frame, state, warped=True)
            guess = method.predict(other, True)
            unlikeness = unlike(made.features, guess.features)
            terms.append({**compared(guess.image, other, encoded(target)), "temporal": unlikeness})
        state = kept(made, gathered, frame, state)
    names = {name for term in terms for name in term}
    return {name: torch.stack([term[name] for term in terms if name in term]).mean() for name in sorted(names)}


def unlike(shaded: Sequence[Tensor], extrapolated: Sequence[Tensor]) -> Float[Tensor, ""]:
    """How far the features of an extrapolated frame are from those of the same frame shaded, which they shall become.

    Relative, and those of the shaded frame are given: were both free to move, they would meet at 0, where no image
    can be made of them.
    """
    pairs = [(a.detach().float(), b.float()) for a, b in zip(shaded, extrapolated, strict=True)]
    return 0.01 * torch.stack([(a - b).abs().mean() / a.abs().mean().clamp(min=1e-6) for a, b in pairs]).mean()


def compared(image: Float[Tensor, "b 3 H W"], made: Gathered, truth: Float[Tensor, "b 3 H W"]) -> dict[str, Tensor]:
    """5 times the root of the mean square error as displayed, 1 - SSIM, and L1 where nothing was found (Eq. 11)."""
    hole = F.interpolate(1 - made.known, (truth.shape[-2], truth.shape[-1]))
    error = ((image - truth).abs() * hole).mean((1, 2, 3)).sum() / hole.mean((1, 2, 3)).sum().clamp(1e-2)
    shown = to_display(decoded(image)) - to_display(decoded(truth))
    root = (shown.square().mean((1, 2, 3)) + 1e-6).sqrt().mean()
    return {"image": 5 * root, "ssim": 0.2 * (1 - similarity(image, truth)), "hole": 0.2 * error}


recipe = Recipe(
    loss=loss, mode="alternate", shaded=4, truths=8, crop=(64, 64), batch=2, steps=1500, rate=2e-3, warmup=50
)
