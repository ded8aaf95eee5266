"""ExtraNet: a frame that was not shaded, from its G-buffers and the last three shaded frames warped to it.

Paper:   Guo, Fu, Lin, Ma, Guo, Liu, Yan, "ExtraNet: Real-time Extrapolated Rendering for Low-latency Temporal
         Supersampling", ACM Transactions on Graphics 40(6) (SIGGRAPH Asia) 2021,
         https://doi.org/10.1145/3478513.3480531
Follows: section 4: demodulation, three shaded frames warped by accumulated motion, holes marked by object, normal and
         position (5.2), light-weight gated U-Net with a shared history encoder, residual on the warped image, log
         domain, and the three losses. `Config()` is the published network, layer by layer: 262,141 parameters, 50.1
         GMAC at 1280 x 720.
Differs: Motion is accumulated from the newest frame on, each vector read where the one before leads and on the same
         surface; the public code starts at the oldest.
         The normal test marks small cosines (below 0.98), as the public code does; reading notes print the opposite.
         Depth enters as d / (d + 10), which does not change from frame to frame as min-max scaling does.
         Position tolerance is relative to depth, so that it does not depend on the scene's unit.
         The divisor of demodulation is base colour + 0.04 (1 - metallic), and 1 at the sky: the sky needs no image of
         its own. Jitter of all frames is part of the motion.
         The residual is 0 at the sky, which is its own light.
         Losses compare colours in the log domain, not light: an error of light on a black surface is not seen.
         They are means of each image, so that they do not depend on how a batch is spread over processes.
         What ships (`BETTER`) begins with the guided warp of ExtraSS (`guided.py`), whose holes are filled from older
         frames that show the surface, then from like surfaces around. Its network adds no colour, which it would have
         to know of scenes it has not seen: it says how far the light goes towards that of like surfaces around, of the
         older frames and of the occlusion warp, and how far changes of light go on. Beside these images it sees how
         they changed, at full size. Nothing is added where the frames agree. It learns by errors as displayed.
         `Config(scale=2)` is ExtraNet+, the baseline of FASSET (Qin et al.): zeros between the pixels, the network at
         display size, without demodulation because base colour is there at render size alone. Its shaded frames go
         through the same network, with themselves as the newest of the three.
Needs:   color and every G-buffer; of the generated frame every G-buffer, motion and cameras
Modes:   extrapolate
State:   the last three shaded frames: light, surfaces, accumulated motion
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor, nn

from framecast.color import decode_log, encode_log, modulate, to_display
from framecast.frame import SKY, Frame
from framecast.methods.guided import Seen, begins_unshaded, guided_warp, guides, mean_of
from framecast.methods.mixing import BESIDE, around, change, mixed, of_nine
from framecast.methods.reproject import (
    GEOMETRY,
    Geometry,
    choose,
    chosen,
    filled,
    geometry,
    light,
    likeness,
    occluder_motion,
    steps,
    surface,
    valid,
)
from framecast.nets import GatedConv, Up, conv, padded
from framecast.recipe import Recipe
from framecast.warp import chain, warp

FEATURES = 6
"""Channels of `features`."""


@dataclass(frozen=True)
class Config:
    """The network; the defaults are the published one."""

    widths: tuple[int, int, int, int] = (24, 24, 32, 32)
    """Channels at full, half, quarter and eighth size."""
    history: bool = True
    """Encode the three warped frames; without it the network sees the newest alone."""
    occlusion: bool = True
    """Show the network the image warped by occlusion motion; without it the plain warp twice."""
    residual: Literal["warp", "filled", "guided"] = "warp"
    """What the output is added to: the plain warp, as published; one whose holes are filled from the older frames and
    from like surfaces around them (`reproject.filled`); or the same of the guided warp of ExtraSS (`guided.py`)."""
    weights: bool = False
    """Say how far light goes towards what is known (`mixing.py`), at scale 1; without it add a colour, as published."""
    steady: bool = False
    """Add nothing where the three warped frames agree (`unsteady`); without it everywhere, as published."""
    scale: int = 1
    """Output size divided by input size; above 1 shaded frames are super-resolved too, and nothing is demodulated."""


BETTER = Config(residual="guided", weights=True, steady=True)
"""What ships: the network begins with holes filled, has less to paint, mixes what is known in place of painting, and
leaves alone what does not change."""

DIFFERENCES = ("occlusion warp", "middle frame", "oldest frame", "last change", "change before")
"""What light can go towards besides that of the pixels around: see `differences`."""

CHANGE = 0.05
"""Difference of two warped frames, in the log domain, from which on all of the residual is added: light that changed by
a twentieth."""


@dataclass(frozen=True)
class Past:
    """One shaded frame of the history."""

    light: Float[Tensor, "b 3 h w"]
    """Colour without texture, encoded by `encode_log`."""
    shows: Geometry
    motion: Float[Tensor, "b 2 h w"]
    """Effective motion from the newest shaded frame to this one; 0 for the newest."""
    guides: Float[Tensor, "b g h w"]
    """`guided.guides`; no channels where guided warping is not used."""


@dataclass(frozen=True)
class History:
    """The last three shaded frames; the oldest one repeated while there are fewer since the last reset."""

    newest: Past
    middle: Past
    oldest: Past


@dataclass(frozen=True)
class Inputs:
    """What the network sees, at render size; colours are light in the log domain."""

    base: Float[Tensor, "b 3 h w"]
    """Newest frame warped; in its holes whatever lay there, or what `Config.residual` fills them with."""
    occluded: Float[Tensor, "b 3 h w"]
    """The same with holes read beside their occluders."""
    mask: Float[Tensor, "b 1 h w"]
    """1 = the newest frame shows the surface, 0 = hole."""
    features: Float[Tensor, "b 6 h w"]
    """Normal, depth in [0, 1], roughness, metallic."""
    surfaces: Float[Tensor, "b d h w"]
    """`reproject.likeness` of the same."""
    past: tuple[Float[Tensor, "b 4 h w"], ...]
    """Warped light and mask, oldest to newest."""
    jitter: Float[Tensor, "b 2"]
    """Where in each pixel all of this was sampled."""


for _kind in (Past, History):
    torch.export.register_dataclass(_kind)


class Encoder(nn.Module):
    """One warped frame to features at an eighth of the size: nine convolutions, shared by the three frames."""

    def __init__(self, widths: tuple[int, int, int, int]) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        for inputs, outputs in zip((4, *widths[1:3]), widths[1:], strict=True):
            layers += [conv(inputs, outputs, 2), conv(outputs, outputs), conv(outputs, outputs)]
        self.layers = nn.Sequential(*layers)

    def forward(self, x: Float[Tensor, "b 4 h w"]) -> Float[Tensor, "b c H W"]:
        encoded: Tensor = self.layers(x)
        return encoded


class Network(nn.Module):
    """The in-painting U-Net and its history encoder; sizes have to be multiples of 8."""

    def __init__(self, config: Config) -> None:
        super().__init__()
        a, b, c, d = config.widths
        self.enter = nn.Sequential(GatedConv(12 + config.weights + FEATURES, a), GatedConv(a, a))
        self.down = nn.ModuleList(
            nn.Sequential(GatedConv(x, x, stride=2, norm=False), GatedConv(x, y), GatedConv(y, y))
            for x, y in ((a, b), (b, c), (c, d))
        )
        self.encoder = Encoder(config.widths) if config.history else None
        self.fuse = GatedConv(3 * d, d, norm=False) if config.history else None
        bottom = 2 * d if config.history else d
        joined = (bottom + c, c + b, b + a)
        self.up = nn.ModuleList(Up(x, x // 2, y) for x, y in zip(joined, (c, b, a), strict=True))
        self.leave = nn.Conv2d(a, len(DIFFERENCES) + BESIDE if config.weights else 3, 1)
        nn.init.normal_(self.leave.weight, std=1e-3)  # the first image is, nearly, the warped one

    def forward(self, x: Float[Tensor, "b c h w"], past: tuple[Tensor, ...]) -> Float[Tensor, "b n h w"]:
        """What is added to the warped image, or logits of what is. `past`: the three warped frames, b 4 h w, oldest
        first."""
        level = [self.enter(x)]
        for down in self.down:
            level.append(down(level[-1]))
        bottom = level.pop()
        if self.encoder is not None and self.fuse is not None:
            encoded = self.encoder(torch.cat(past))
            bottom = torch.cat((bottom, self.fuse(torch.cat(encoded.chunk(3), 1))), 1)
        for up in self.up:
            bottom = up(bottom, level.pop())
        residual: Tensor = self.leave(bottom)
        return residual


class ExtraNet(nn.Module):
    """See the top of this file."""

    needs: tuple[str, ...] = ("color", "albedo", "metallic", *GEOMETRY)
    needs_generated: tuple[str, ...] = ("albedo", "roughness", "metallic", *GEOMETRY)
    modes: tuple[str, ...] = ("extrapolate",)
    scales: tuple[float, ...] = (1.0,)
    parts: tuple[str, ...] = ("remember", "prepare", "predict")
    history: int | None = 3
    step_motion: bool = False

    def __init__(self, config: Config = Config()) -> None:
        super().__init__()
        self.config = config
        self.network = Network(config)
        if config.scale > 1:
            self.scales = (float(config.scale),)
            self.needs_generated = ("roughness", "metallic", *GEOMETRY)  # colour is not taken off the surfaces
            self.needs = ("color", *self.needs_generated)

    def start(self, frame: Frame) -> History:
        """The state before the first frame, which is `frame`."""
        only = self.past(frame)
        return History(only, only, only)

    def past(self, frame: Frame) -> Past:
        """The frame as part of the history, not moved."""
        assert frame.color is not None
        seen = encode_log(frame.color) if self.config.scale > 1 else light(frame)
        known = guides(frame) if self.config.residual == "guided" else seen[:, :0]
        return Past(seen, geometry(frame), torch.zeros_like(seen[:, :2]), known)

    def forward(self, frame: Frame, state: History) -> tuple[Float[Tensor, "b 3 H W"], History]:
        """The frame's own image where it was shaded (super-resolved where `scale` says so), else a generated one."""
        if frame.color is None:
            past = after_cut(frame, state)
            return self.image(frame, past, steps(frame, past.newest.shows.time, past.newest.shows.jitter)), state
        state = self.remember(frame, state)
        if self.config.scale == 1:
            return frame.color, state
        return self.image(frame, state, torch.zeros_like(state.newest.motion)), state

    def image(self, frame: Frame, state: History, motion: Tensor) -> Float[Tensor, "b 3 H W"]:
        """The image from the history and the motion to its newest frame."""
        predicted = decode_log(self.predict(self.prepare(frame, state, motion)))
        return predicted if self.config.scale > 1 else modulate(predicted, surface(frame))

    def remember(self, frame: Frame, state: History) -> History:
        """The history after one more shaded frame; where the frame resets, that frame alone."""
        now = self.past(frame)
        motion = steps(frame, state.newest.shows.time, state.newest.shows.jitter)
        middle = replace(state.newest, motion=motion)
        oldest = replace(state.middle, motion=self.reach(now.shows, state, motion, state.middle))
        return History(now, _where(frame.reset, now, middle), _where(frame.reset, now, oldest))

    def reach(self, now: Geometry, state: History, motion: Tensor, past: Past) -> Float[Tensor, "b 2 h w"]:
        """Motion to an earlier frame of the history, from a frame whose motion to the newest one is given."""
        newest = state.newest.shows
        spans = (now.time - newest.time, newest.time - past.shows.time)
        return chain([motion, past.motion], [now.depth, newest.depth], spans)

    def prepare(self, frame: Frame, state: History, motion: Float[Tensor, "b 2 h w"]) -> Inputs:
        """Everything before the network: the history warped to the frame, and its holes marked."""
        with torch.autocast(motion.device.type, enabled=False):
            now = geometry(frame)
            motions = [self.reach(now, state, motion, past) for past in (state.oldest, state.middle)]
            pasts = (state.oldest, state.middle, state.newest)
            seen = [
                (warp(past.light, m), valid(now, past.shows, m))
                for past, m in zip(pasts, (*motions, motion), strict=True)
            ]
            image, mask = seen[-1]
            occluded = image
            if self.config.occlusion:
                elsewhere = occluder_motion(now.depth, motion)
                occluded = torch.where(mask, image, warp(state.newest.light, elsewhere))
            described = features(frame)
            surfaces = likeness(now.normal, now.depth, described[:, 4:])
            base = self.base(frame, seen, occluded, surfaces, state.newest, motion)
            past = tuple(torch.cat((image, valid.float()), 1) for image, valid in seen)
            return Inputs(base, occluded, mask.float(), described, surfaces, past, frame.jitter)

    def base(
        self,
        frame: Frame,
        seen: list[tuple[Tensor, Tensor]],
        occluded: Tensor,
        surfaces: Tensor,
        newest: Past,
        motion: Tensor,
    ) -> Float[Tensor, "b 3 h w"]:
        """What the output is added to, of the warped frames and where they are valid, oldest to newest."""
        if self.config.residual == "warp":
            return seen[-1][0]
        if self.config.residual == "guided":
            again = Seen(newest.light, newest.guides, newest.shows.jitter, newest.shows.time)
            seen = [*seen[:-1], guided_warp(again, guides(frame), motion)]
        return filled(seen, occluded, surfaces)

    def shown(self, inputs: Inputs) -> Float[Tensor, "b c h w"]:
        """What the U-Net sees at full size."""
        images = torch.cat((inputs.base, inputs.occluded), 1)
        if not self.config.weights:
            return torch.cat((images, images * inputs.mask, inputs.features), 1)
        oldest, middle, newest = inputs.past
        changes = change(middle, newest)[:, :3], change(oldest, middle)[:, :3]
        return torch.cat((images, *changes, inputs.mask, inputs.features), 1)

    def predict(self, inputs: Inputs) -> Float[Tensor, "b 3 H W"]:
        """Light in the log domain, from the network."""
        scale, jitter = self.config.scale, inputs.jitter
        surfaces = (inputs.features[:, 3:4] < 1).float()  # the sky is its own light, and only warped
        if self.config.steady:
            surfaces = surfaces * unsteady(inputs)
        if not self.config.history:
            inputs = replace(inputs, past=inputs.past[2:] * 3)
        x = self.shown(inputs)
        past = tuple(padded(scattered(image, jitter, scale), 8) for image in inputs.past)
        residual = self.network(padded(scattered(x, jitter, scale), 8), past).float()
        base = enlarged(inputs.base, jitter, scale)
        residual = residual[..., : base.shape[-2], : base.shape[-1]]
        if self.config.weights:
            residual = mixed(base, differences(inputs), inputs.surfaces, residual)
        return base + (residual if scale > 1 else residual * surfaces)


def differences(inputs: Inputs) -> list[Float[Tensor, "b 3 h w"]]:
    """From the base to the occlusion warp, and to the middle and the oldest frame where they show the surface; the mean
    changes of light from the middle frame to the newest, and from the oldest to the middle one."""
    oldest, middle, newest = inputs.past
    older = [past[:, 3:] * (past[:, :3] - inputs.base) for past in (middle, oldest)]
    return [inputs.occluded - inputs.base, *older, around(change(middle, newest)), around(change(oldest, middle))]


def after_cut(frame: Frame, state: History) -> History:
    """What a frame that was not shaded goes by: the history, but where a shot begins with this very frame its own
    surfaces under the mean light of the last one, with a warning."""
    if not begins_unshaded(frame, "extranet"):
        return state
    mean = mean_of(state.newest.light)
    known = guides(frame) if state.newest.guides.shape[1] else mean[:, :0]
    fresh = Past(mean, geometry(frame), torch.zeros_like(mean[:, :2]), known)
    return History(*(_where(frame.reset, fresh, past) for past in (state.newest, state.middle, state.oldest)))


def unsteady(inputs: Inputs) -> Float[Tensor, "b 1 h w"]:
    """0 where the warped frames agree, 1 within four pixels of a hole or of a difference of `CHANGE` and more."""
    *older, newest = inputs.past
    apart = torch.stack([(image - newest).abs().amax(1, keepdim=True) for image in older]).amax(0)
    apart = torch.where(inputs.mask > 0, apart / CHANGE, 1).clamp(max=1)
    return of_nine(torch.maximum, apart)


def scattered(x: Float[Tensor, "b c h w"], jitter: Float[Tensor, "b 2"], scale: int) -> Float[Tensor, "b c H W"]:
    """The image `scale` times as large: each value in the pixel that its sample lies in, zeros between."""
    if scale == 1:
        return x
    cell = ((jitter + 0.5) * scale).floor().clamp(0, scale - 1)
    column, row = (cell[:, :, None] == torch.arange(scale, device=x.device)).to(x.dtype).unbind(1)
    batch, channels, height, width = x.shape
    spread = x[..., None, :, None] * row[:, None, None, :, None, None] * column[:, None, None, None, None, :]
    return spread.reshape(batch, channels, height * scale, width * scale)


def enlarged(x: Float[Tensor, "b c h w"], jitter: Float[Tensor, "b 2"], scale: int) -> Float[Tensor, "b c H W"]:
    """The image `scale` times as large, bilinear between its samples; also under autocast, which would round places to
    eight bits."""
    if scale == 1:
        return x
    batch, channels, height, width = x.shape
    shift = -2 * jitter / torch.tensor([width, height], device=x.device)
    across = torch.eye(2, device=x.device).expand(batch, 2, 2)
    size = [batch, channels, height * scale, width * scale]
    with torch.autocast(x.device.type, enabled=False):
        grid = F.affine_grid(torch.cat((across, shift[:, :, None]), 2), size, align_corners=False)
    return F.grid_sample(x, grid, padding_mode="border", align_corners=False)


def features(frame: Frame) -> Float[Tensor, "b 6 h w"]:
    """Normal, depth as d / (d + 10) with 1 at the sky, roughness, metallic: the same from frame to frame."""
    assert frame.depth is not None
    assert frame.normal is not None
    assert frame.roughness is not None
    assert frame.metallic is not None
    depth = torch.where(frame.depth < SKY, frame.depth / (frame.depth + 10), 1)
    return torch.cat((frame.normal, depth, frame.roughness, frame.metallic), 1)


def _where(fresh: Bool[Tensor, " b"], a: Past, b: Past) -> Past:
    """Per image of the batch, `a` where `fresh`, else `b`."""
    light, motion, known = (chosen(fresh, getattr(a, name), getattr(b, name)) for name in ("light", "motion", "guides"))
    return Past(light, choose(fresh, a.shows, b.shows), motion, known)


# Training.

WORST = 0.1
"""Part of the pixels whose errors are the largest, those of light that moved."""

LEAST = 64
"""Pixels that holes count as at least, so that one of them does not decide alone."""


def loss(
    method: ExtraNet, frames: Sequence[Frame], targets: Float[Tensor, "b n 3 H W"]
) -> dict[str, Float[Tensor, ""]]:
    """The three terms, in the log domain: everywhere, in holes, and where the error is largest."""
    seen, target, hole = seen_and_target(method, frames, targets)
    if method.config.scale == 1:  # measured with texture: light on black surfaces is bright, and not seen
        seen = torch.log1p(modulate(torch.expm1(seen), surface(frames[-1])).clamp(min=-0.5))
    error = (seen - encode_log(target)).abs()
    return {"l1": error.mean(), "hole": hole_loss(error, hole), "shade": shading_loss(error)}


def loss_as_shown(
    method: ExtraNet, frames: Sequence[Frame], targets: Float[Tensor, "b n 3 H W"]
) -> dict[str, Float[Tensor, ""]]:
    """The same three, each the root of the mean square of each image's error as displayed: what PSNR is made of."""
    seen, target, hole = seen_and_target(method, frames, targets)
    shown = to_display(modulate(torch.expm1(seen), surface(frames[-1])))
    error = (shown - to_display(target)).square()
    holes = (error * hole).mean(1).sum((1, 2)) / hole.sum((1, 2, 3)).clamp(min=LEAST)
    worst = error.mean(1).flatten(1)
    worst = worst.topk(max(1, round(WORST * worst.shape[1])), dim=1).values.mean(1)
    return {
        name: times * (mean + 1e-6).sqrt().mean()
        for name, times, mean in (("image", 5, error.mean((1, 2, 3))), ("hole", 0.5, holes), ("shade", 0.5, worst))
    }


def seen_and_target(
    method: ExtraNet, frames: Sequence[Frame], targets: Float[Tensor, "b n 3 H W"]
) -> tuple[Float[Tensor, "b 3 H W"], Float[Tensor, "b 3 H W"], Float[Tensor, "b 1 H W"]]:
    """What the method makes of the frames before the last, in the log domain; the truth, linear; 1 in holes."""
    *shaded, frame = frames
    state = method.start(shaded[0])
    for past in shaded[1:]:
        state = method.remember(past, state)
    inputs = method.prepare(frame, state, steps(frame, state.newest.shows.time, state.newest.shows.jitter))
    target, hole = targets[:, -1], 1 - inputs.mask
    if method.config.scale > 1:
        hole = F.interpolate(hole, (target.shape[-2], target.shape[-1]))
    return method.predict(inputs), target, hole


def loss_without_shading(
    method: ExtraNet, frames: Sequence[Frame], targets: Float[Tensor, "b n 3 H W"]
) -> dict[str, Float[Tensor, ""]]:
    """The ablation of the paper: no term for the largest errors."""
    return {name: term for name, term in loss_as_shown(method, frames, targets).items() if name != "shade"}


def hole_loss(error: Float[Tensor, "b 3 h w"], hole: Float[Tensor, "b 1 h w"]) -> Float[Tensor, ""]:
    """Mean error over the holes (1 = hole) of each image; 0 for an image without any."""
    per_image = (error * hole).mean(1).sum((1, 2)) / hole.sum((1, 2, 3)).clamp(min=1)
    return per_image.mean()


def shading_loss(error: Float[Tensor, "b 3 h w"]) -> Float[Tensor, ""]:
    """Mean of the largest errors, a tenth of the pixels, of each image and channel on its own."""
    flat = error.flatten(2)
    return flat.topk(max(1, round(WORST * flat.shape[2])), dim=2).values.mean()


recipe = Recipe(loss=loss)
better_recipe = Recipe(loss=loss_as_shown, crop=(96, 96), batch=4, steps=9000)
