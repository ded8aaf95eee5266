"""G-buffer guided warping: light read from wherever the last frame shows a surface like the one to light.

Paper:   Wu, Vembar, Sochenov, Panneer, Kim, Kaplanyan, Yan, "ExtraSS: A Framework for Joint Spatial Super Sampling and
         Frame Extrapolation", SIGGRAPH Asia 2023 Conference Papers, https://doi.org/10.1145/3610548.3618224
Follows: section 4.1: candidates around the end of the motion vector at strides 1, 3, 5 and 9 (Eq. 1), weighed by base
         colour, normal and distance on the screen (Eq. 2), the four heaviest averaged (Eq. 3), demodulated, modulated
         again by the new frame's base colour.
Differs: Where the plain bilinear read meets a like surface it is kept: with the candidates alone every read is of whole
         pixels, which loses sub-pixel motion (a sine moved by 0.4 pixels: 22 dB, bilinear 36). In the paper four copies
         of the middle candidate do it; here every candidate stands once.
         Distance is measured from where the vector exactly leads, so that among like surfaces the nearest win, and ties
         do not shift the image. Candidates beyond the screen do not count.
         Where frames have objects, no surface is like one of another object.
         Where no candidate is alike the pixel is a hole, and filled from like surfaces around it in this frame
         (`reproject.filled`; worth 0.3 dB on training scenes).
         Jitter of both frames is part of the motion. The sky counts as a surface of its own.
Needs:   color, depth, albedo, metallic, normal; of the generated frame the same but colour, and motion; of both the
         object, where they have it
Modes:   extrapolate
State:   the last shaded frame: light and surfaces
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, fields

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, library, nn

from framecast.color import decode_log, modulate
from framecast.frame import SKY, Frame, missing
from framecast.methods.reproject import as_image, as_rows, chosen, filled, light, likeness, squared, steps, surface
from framecast.warp import inside, landing, warp

STRIDES = (1, 3, 5, 9)
"""Distances of the candidates from the middle one, pixels (Eq. 1)."""

OFFSETS = ((0, 0), *((i * s, j * s) for s in STRIDES for j in (-1, 0, 1) for i in (-1, 0, 1) if (i, j) != (0, 0)))
"""The candidates, (x, y) from the pixel that the vector leads to: 33, nearest first."""

HEAVIEST = 4
"""Candidates that are averaged (Eq. 3)."""

FAINT = 1e-6
"""Weight of a candidate whose surface is unlike, relative to a like one; it counts only where all are unlike."""

LIKE = 2 * FAINT
"""Weight from which on a candidate is alike."""

GUESSED = 0.25
"""What a pixel counts as a sample that was not found in the last shaded frame, but filled in from like surfaces."""


@dataclass(frozen=True)
class Config:
    """Widths of the Gaussians, which the paper does not give: the best found on ten clips of training scenes.

    There 30.95 dB (`warp-occlusion` 27.32); with `alike` at 2 30.81, at 3 30.64; at 3 and half of `albedo` and `normal`
    30.52. `screen` hardly matters.
    """

    albedo: float = 0.05
    normal: float = 0.1
    screen: float = 4.0
    """Pixels."""
    alike: float = 1.0
    """Widths by which a surface read bilinearly may differ and still be kept."""


@dataclass(frozen=True)
class Seen:
    """A shaded frame as guided warping reads it."""

    light: Float[Tensor, "b 3 h w"]
    """Colour without texture, encoded by `encode_log`."""
    guides: Float[Tensor, "b 8 h w"]
    """Base colour, normal, 1 at the sky, object: see `guides`."""
    jitter: Float[Tensor, "b 2"]
    time: Float[Tensor, " b"]


torch.export.register_dataclass(Seen)


def guides(frame: Frame) -> Float[Tensor, "b 8 h w"]:
    """Base colour (linear), unit normal, and 1 at the sky, where the others are 0; the object, NaN without objects."""
    assert frame.albedo is not None
    assert frame.normal is not None
    assert frame.depth is not None
    sky = (frame.depth >= SKY).float()
    objects = torch.full_like(sky, torch.nan) if frame.object is None else frame.object.float()
    return torch.cat((frame.albedo * (1 - sky), frame.normal * (1 - sky), sky, objects), 1)


def guided_warp(
    past: Seen, now: Float[Tensor, "b 8 h w"], motion: Float[Tensor, "b 2 h w"], config: Config = Config()
) -> tuple[Float[Tensor, "b 3 h w"], Bool[Tensor, "b 1 h w"]]:
    """The light of an earlier frame on the surfaces of this one, and where it was found on a like surface (Eq. 1 to 3).

    Args:
        past: the earlier frame.
        now: `guides` of this frame.
        motion: from each pixel to the same surface in the earlier frame, pixels; what leads off the screen finds
            candidates inside of it, within nine pixels.

    A shift of whole pixels over like surfaces returns the shifted image exactly; any other bilinear one.
    """
    widths = now.new_tensor([config.albedo] * 3 + [config.normal] * 5).view(1, 8, 1, 1)
    here, there = (each / widths for each in comparable(now, past.guides))
    straight, read = warp(torch.cat((past.light, there), 1), motion).split((3, 8), 1)
    kept = (squared(read - here) <= config.alike**2) & inside(motion)
    arguments = past.light, there, here, motion, config.screen
    found = search_elsewhere(kept, *arguments) if motion.device.type == "cpu" else _searched_everywhere(*arguments)
    return torch.where(kept, straight, found[:, :3]), kept | (found[:, 3:] > LIKE)


def comparable(
    a: Float[Tensor, "b 8 h w"], b: Float[Tensor, "b 8 h w"]
) -> tuple[Float[Tensor, "b 8 h w"], Float[Tensor, "b 8 h w"]]:
    """Two frames' `guides`, with object 0 everywhere where one of the two has no objects."""
    unknown = (a[:, 7:] + b[:, 7:]).isnan().any()
    first, second = (torch.cat((each[:, :7], torch.where(unknown, 0.0, each[:, 7:])), 1) for each in (a, b))
    return first, second


@library.custom_op("framecast::search_elsewhere", mutates_args=())
def search_elsewhere(kept: Tensor, image: Tensor, there: Tensor, here: Tensor, motion: Tensor, screen: float) -> Tensor:
    """Candidates searched where the straight read is not kept: on few cores they are what takes the time.

    A GPU would have to wait for their number, and searches at every pixel. Compiled code calls this as it is.
    """
    return _searched_at((~kept).flatten().nonzero()[:, 0], image, there, here, motion, screen)


@search_elsewhere.register_fake
def _(kept: Tensor, image: Tensor, there: Tensor, here: Tensor, motion: Tensor, screen: float) -> Tensor:
    return image.new_empty(image.shape[0], 4, *image.shape[-2:])


def _searched_at(
    pixels: Int[Tensor, " n"],
    image: Float[Tensor, "b 3 h w"],
    there: Float[Tensor, "b 8 h w"],
    here: Float[Tensor, "b 8 h w"],
    motion: Float[Tensor, "b 2 h w"],
    screen: float,
) -> Float[Tensor, "b 4 h w"]:
    """At these of the batch's pixels the mean of the heaviest candidates, those that weigh at least as much as the
    fourth, and the largest weight; 0 at the other pixels."""
    height, width = image.shape[-2:]
    rows = as_rows(torch.cat((image, there), 1))
    own, vector = as_rows(here)[pixels], as_rows(motion)[pixels]
    column, row, first = pixels % width, pixels // width % height, pixels // (width * height) * (width * height)
    x, y = column + vector[:, 0], row + vector[:, 1]
    middle_x, middle_y = (x + 0.5).floor().clamp(0, width - 1).long(), (y + 0.5).floor().clamp(0, height - 1).long()
    places, weights = [], []
    for dx, dy in OFFSETS:
        i, j = middle_x + dx, middle_y + dy
        exists = (i >= 0) & (i < width) & (j >= 0) & (j < height)
        place = first + j.clamp(0, height - 1) * width + i.clamp(0, width - 1)
        near = torch.exp(-0.5 * ((i - x).square() + (j - y).square()) / screen**2)
        alike = torch.exp(-0.5 * (rows[place, 3:] - own).square().sum(1).clamp(max=60))
        places.append(place)
        weights.append(exists * near * (alike + FAINT))
    most = heaviest(weights)
    total = torch.zeros_like(own[:, :3])
    for place, weight in zip(places, weights, strict=True):
        total = total + (weight * (weight >= most[-1]))[:, None] * rows[place, :3]
    sums = sum(weight * (weight >= most[-1]) for weight in weights)
    found = torch.cat((total / torch.as_tensor(sums).clamp(min=1e-30)[:, None], most[0][:, None]), 1)
    return as_image(found.new_zeros(len(rows), 4).index_copy(0, pixels, found), image)


def _searched_everywhere(
    image: Float[Tensor, "b 3 h w"],
    there: Float[Tensor, "b 8 h w"],
    here: Float[Tensor, "b 8 h w"],
    motion: Float[Tensor, "b 2 h w"],
    screen: float,
) -> Float[Tensor, "b 4 h w"]:
    """`_searched_at` of every pixel, by planes, all candidates at once: it compiles to a few short loops."""
    height, width = motion.shape[-2:]
    x = torch.arange(width, device=motion.device) + motion[:, 0]
    y = torch.arange(height, device=motion.device)[:, None] + motion[:, 1]
    middle = landing(motion)
    dx, dy = torch.tensor(OFFSETS, dtype=torch.int32, device=motion.device).T[..., None, None, None]
    i, j = middle % width + dx, middle // width + dy
    place = (middle + dy * width + dx).clamp(0, height * width - 1)

    def read(plane: Float[Tensor, "b h w"]) -> Float[Tensor, "k b h w"]:
        flat = plane.flatten(1).expand(len(OFFSETS), -1, -1)
        return flat.gather(2, place.flatten(2).long()).view(place.shape)

    exists = (i >= 0) & (i < width) & (j >= 0) & (j < height)
    near = torch.exp(-0.5 * ((i - x).square() + (j - y).square()) / screen**2)
    apart = torch.zeros_like(near)
    for past, now in zip(there.unbind(1), here.unbind(1), strict=True):
        apart = apart + (read(past) - now).square()
    weights = exists * near * (torch.exp(-0.5 * apart.clamp(max=60)) + FAINT)
    most = heaviest(weights.unbind(0))
    weights = weights * (weights >= most[-1])
    total = weights.sum(0).clamp(min=1e-30)
    return torch.stack([(weights * read(plane)).sum(0) / total for plane in image.unbind(1)] + [most[0]], 1)


def heaviest(weights: Sequence[Float[Tensor, "*n"]]) -> list[Float[Tensor, "*n"]]:
    """The largest `HEAVIEST` of each place, in order, by running maxima: nothing is sorted."""
    most = [torch.zeros_like(weights[0]) for _ in range(HEAVIEST)]
    for weight in weights:
        for k in range(HEAVIEST):
            most[k], weight = torch.maximum(most[k], weight), torch.minimum(most[k], weight)
    return most


class GuidedWarp(nn.Module):
    """Light from like surfaces of the last shaded frame, on the surfaces of this one."""

    needs: tuple[str, ...] = ("color", "depth", "albedo", "metallic", "normal")
    needs_generated: tuple[str, ...] = ("depth", "albedo", "metallic", "normal", "motion")
    modes: tuple[str, ...] = ("extrapolate",)
    scales: tuple[float, ...] = (1.0,)
    parts: tuple[str, ...] = ("generate",)
    history: int | None = 1
    step_motion: bool = False

    def __init__(self, config: Config = Config()) -> None:
        super().__init__()
        self.config = config

    def start(self, frame: Frame) -> Seen:
        """The state before the first frame, which is `frame`.

        Raises:
            ValueError: a buffer is missing.
        """
        require(frame, "extrass-warp", self.needs, self.needs_generated)
        return seen(frame)

    def forward(self, frame: Frame, state: Seen) -> tuple[Float[Tensor, "b 3 h w"], Seen]:
        """The frame's own image where it was shaded, else the last light on this frame's surfaces.

        Raises:
            ValueError: a buffer is missing.
        """
        require(frame, "extrass-warp", self.needs, self.needs_generated)
        if frame.color is not None:
            return frame.color, seen(frame)
        state = after_cut(frame, state, "extrass-warp")
        return self.generate(frame, state), state

    def generate(self, frame: Frame, state: Seen) -> Float[Tensor, "b 3 h w"]:
        """The last light, found by its surfaces, on those of the frame."""
        image, _ = extrapolated(frame, state, self.config)
        return modulate(decode_log(image), surface(frame))


def seen(frame: Frame) -> Seen:
    """A shaded frame as guided warping reads it."""
    return Seen(light(frame), guides(frame), frame.jitter, frame.time)


def extrapolated(
    frame: Frame, past: Seen, config: Config = Config(), motion: Float[Tensor, "b 2 h w"] | None = None
) -> tuple[Float[Tensor, "b 3 h w"], Bool[Tensor, "b 1 h w"]]:
    """The light of an earlier frame on the surfaces of this one, its holes filled from like surfaces around them, and
    where it was found. Encoded by `encode_log`. `motion`: effective, to that frame, where the frame's own leads to
    another; after a cut none counts."""
    assert frame.depth is not None
    now = guides(frame)
    motion = steps(frame, past.time, past.jitter) if motion is None else motion
    motion = chosen(frame.reset, torch.zeros_like(motion), motion)
    image, known = guided_warp(past, now, motion, config)
    return filled([(image, known)], image, likeness(now[:, 3:6], frame.depth, now[:, :3])), known


def after_cut(frame: Frame, past: Seen, name: str) -> Seen:
    """What a frame that was not shaded goes by: the past, but where a shot begins with this very frame its own surfaces
    under the mean light of that past, for nothing else is known of the new shot; with a warning that says so."""
    if not begins_unshaded(frame, name):
        return past
    fresh = Seen(mean_of(past.light), guides(frame), frame.jitter, frame.time)
    return Seen(**{f.name: chosen(frame.reset, getattr(fresh, f.name), getattr(past, f.name)) for f in fields(Seen)})


def begins_unshaded(
    frame: Frame, name: str, shown: str = "its surfaces are shown under the mean light of the shot before"
) -> bool:
    """Whether a shot begins with a frame that was not shaded; warns of it, and says what is `shown`."""
    if not bool(frame.reset.any()):
        return False
    warnings.warn(
        f"a shot begins with the frame at time {float(frame.time[0]):g}, which was not shaded, so that {name} has "
        f"nothing to extrapolate from: {shown}; shade the first frame of every shot",
        stacklevel=4,
    )
    return True


def mean_of(image: Float[Tensor, "b c h w"]) -> Float[Tensor, "b c h w"]:
    """The mean over the pixels of each image, everywhere."""
    return image.mean((2, 3), keepdim=True).expand_as(image)


def require(frame: Frame, name: str, needs: tuple[str, ...], needs_generated: tuple[str, ...]) -> None:
    """Raises ValueError where a frame lacks buffers, one that was not shaded some of `needs_generated`."""
    wanted = needs if frame.is_shaded else needs_generated
    if lacking := missing(frame, wanted):
        kind = "shaded" if frame.is_shaded else "not shaded"
        raise ValueError(
            f"the frame at time {float(frame.time[0]):g} was {kind} and has no {' and no '.join(lacking)}; {name} "
            f"needs the {', '.join(wanted)} of such frames: render those passes for every frame, shaded or not"
        )
