"""Earlier shaded frames seen from a frame with G-buffers: exact motion, light without texture, what is valid, holes.

The inputs of every method that extrapolates with G-buffers. Motion here is *effective*: from a pixel's sample to the
same sample's place on the other frame's grid of samples, so that the jitter of both frames is part of it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int, Shaped
from torch import Tensor, library

from framecast.color import demodulate, encode_log
from framecast.frame import SKY, Frame, world_position
from framecast.warp import EMPTY, inside, key_index, landing, nearest_key, pick, splat, trajectory, warp

SPECULAR = 0.04
"""Reflectance of dielectrics: what is left to divide by where the base colour is black."""

AROUND = 11
"""Pixels around a hole in which `filled` looks for like surfaces."""

PLACES = tuple(
    (round(radius * math.cos(math.pi * (k + turn) / 4)), round(radius * math.sin(math.pi * (k + turn) / 4)))
    for radius, turn in ((1.4, 0), (3, 0.5), (6, 0), (AROUND, 0.5))
    for k in range(8)
)
"""Where it looks: (x, y) of four rings, eight places each, in pixels."""

TURNED, NEAR, ALIKE = 0.35, 0.08, 0.2
"""Differences that make one surface weigh 1/e of a like one: between normals, of the logarithm of depth, and of
whatever else is compared."""

DOUBT = 1e-3
"""What the fallback weighs, where a like surface one pixel away weighs 1."""

GEOMETRY = ("depth", "motion", "normal", "object", "view", "projection")
"""Fields that `geometry` and `steps` read."""


@dataclass(frozen=True)
class Geometry:
    """What a frame shows, without its light."""

    depth: Float[Tensor, "b 1 h w"]
    position: Float[Tensor, "b 3 h w"]
    """World-space, scene units."""
    normal: Float[Tensor, "b 3 h w"]
    object: Int[Tensor, "b 1 h w"]
    joined: Int[Tensor, "b 1 h w"]
    """Which neighbours show the same surface: see `join`."""
    facing: Float[Tensor, "b 1 h w"]
    """|n·v|, 0 at the sky."""
    jitter: Float[Tensor, "b 2"]
    time: Float[Tensor, " b"]


torch.export.register_dataclass(Geometry)


def geometry(frame: Frame) -> Geometry:
    """What the frame shows, at its jittered sample positions."""
    assert frame.depth is not None
    assert frame.normal is not None
    assert frame.object is not None
    assert frame.view is not None
    assert frame.projection is not None
    position = world_position(frame.depth, frame.view, jittered(frame))
    eye = torch.linalg.inv(frame.view)[:, :3, 3, None, None]
    to_eye = eye - position
    facing = (frame.normal * to_eye).sum(1, keepdim=True).abs() / squared(to_eye).sqrt().clamp(min=1e-6)
    joined = join(frame.object, position, 2 * tolerance(frame.depth, facing))
    return Geometry(frame.depth, position, frame.normal, frame.object, joined, facing, frame.jitter, frame.time)


def jittered(frame: Frame) -> Float[Tensor, "b 4 4"]:
    """The projection whose pixel centres are the frame's sample positions."""
    assert frame.projection is not None
    assert frame.size is not None
    height, width = frame.size
    p, (x, y) = frame.projection, frame.jitter.unbind(1)
    shift_x = p[:, 3] * (2 * x / width)[:, None]
    shift_y = p[:, 3] * (-2 * y / height)[:, None]
    return torch.stack((p[:, 0] - shift_x, p[:, 1] - shift_y, p[:, 2], p[:, 3]), 1)


def surface(frame: Frame) -> Float[Tensor, "b 3 h w"]:
    """What light is multiplied by: base colour and the reflectance of dielectrics; 1 at the sky, which is its own."""
    assert frame.depth is not None
    assert frame.albedo is not None
    assert frame.metallic is not None
    return torch.where(frame.depth < SKY, frame.albedo + SPECULAR * (1 - frame.metallic), 1)


def light(frame: Frame) -> Float[Tensor, "b 3 h w"]:
    """The frame's colour without its texture, encoded by `encode_log`."""
    assert frame.color is not None
    return encode_log(demodulate(frame.color, surface(frame)))


def steps(frame: Frame, time: Float[Tensor, " b"], jitter: Float[Tensor, "b 2"]) -> Float[Tensor, "b 2 h w"]:
    """Effective motion from the frame to the shaded one before it, which has this time and jitter.

    Exact where the frame's vectors reach just there; elsewhere along the path that they define.
    """
    assert frame.motion is not None
    path = trajectory(frame.motion, frame.motion_next, frame.span).displacement(time - frame.time)
    exact = ((frame.time - time) - frame.span).abs() < 1e-4
    motion = torch.where(exact[:, None, None, None], frame.motion, path)
    return motion + (frame.jitter - jitter)[:, :, None, None]


def reaching(frame: Frame, time: Float[Tensor, " b"]) -> Frame:
    """The frame with motion to the moment of the frame that was seen last, whatever its own vectors reach, jitter left
    out; as it is where it resets, and where none was seen before it."""
    if frame.motion is None:
        return frame
    kept = frame.reset | (frame.time == time)
    motion = chosen(kept, frame.motion, steps(frame, time, frame.jitter))
    return replace(frame, motion=motion, motion_next=None, span=chosen(kept, frame.span, frame.time - time))


def valid(now: Geometry, past: Geometry, motion: Float[Tensor, "b 2 h w"]) -> Bool[Tensor, "b 1 h w"]:
    """Where the past frame shows, at the end of `motion`, the surface that the frame shows now.

    Not valid: off the screen; another object; on things that move by themselves a normal turned by more than 11
    degrees (cosine below 0.98); on the static world a position, that of the nearest pixel, that is not the same. And
    every pixel that a bilinear read mixes (with at least one hundredth) has to be joined to the others.
    """
    nearest, corner, opposite = landing(motion), *(landing(motion + shift) for shift in (-0.49, 0.49))
    width = motion.shape[-1]
    apart = opposite - corner
    needed = (apart % width > 0).to(torch.int32) + 2 * (apart // width > 0).to(torch.int32)
    whole = (pick(past.joined, corner) >> needed[:, None]) & 1 > 0
    turned = warp(past.normal, motion)
    length = (squared(turned) * squared(now.normal)).sqrt()
    same_normal = ((turned * now.normal).sum(1, keepdim=True) >= 0.98 * length) | (length < 1e-6)
    limit = tolerance(now.depth, now.facing).square()
    same_position = squared(pick(past.position, nearest) - now.position) <= limit
    same = torch.where(now.object == 0, same_position, same_normal)
    return (pick(past.object, corner) == now.object) & whole & same & inside(motion)


def join(
    object: Int[Tensor, "b 1 h w"], position: Float[Tensor, "b 3 h w"], limit: Float[Tensor, "b 1 h w"]
) -> Int[Tensor, "b 1 h w"]:
    """Which pixels can be mixed with their neighbours: bit 0 always; bit 1 with the one to the right; bit 2 with the
    one below; bit 3 with both and the one between them. Beyond the border nothing is.

    Pixels are joined that show one object, and on the static world, where that is much, positions within `limit`: two
    `tolerance`s, for a surface that lies between them.
    """

    def like(dy: int, dx: int) -> Tensor:
        there, here = (..., slice(dy, None), slice(dx, None)), (..., slice(-dy or None), slice(-dx or None))
        near = squared(position[there] - position[here]) <= limit[here].square()
        same = (object[there] == object[here]) & (near | (object[here] != 0))
        return F.pad(same.to(torch.int32), (0, dx, 0, dy))  # compiled, a padded mask is code that no compiler takes

    right, below = like(0, 1), like(1, 0)
    return 1 + 2 * right + 4 * below + 8 * right * below * like(1, 1)


def squared(vectors: Float[Tensor, "b c h w"]) -> Float[Tensor, "b 1 h w"]:
    """Squared length, plane by plane: many times faster than `norm` over three channels."""
    first, *others = vectors.unbind(1)
    total = first * first
    for plane in others:
        total = total + plane * plane
    return total[:, None]


def tolerance(depth: Float[Tensor, "b 1 h w"], facing: Float[Tensor, "b 1 h w"]) -> Float[Tensor, "b 1 h w"]:
    """How far apart two positions of one static surface may lie, scene units.

    The published limit, 7.5 cm seen frontally to 45 cm seen edge-on and 0.5 cm for each metre, is in centimetres; here
    it is that limit at 10 m as a part of the depth, so that it does not depend on the unit of the scene.
    """
    return depth * (0.0075 * facing + 0.045 * (1 - facing) + 0.005)


def occluder_motion(depth: Float[Tensor, "b 1 h w"], motion: Float[Tensor, "b 2 h w"]) -> Float[Tensor, "b 2 h w"]:
    """Motion to the previous frame of what covered each pixel's surface there (Zeng et al. 2021, Eq. 6).

    The motion of this frame is splatted onto the previous one, the nearest surface wins; each pixel takes what lies
    where its own vector leads. Following it from a disoccluded pixel reads beside the occluder: its background. Where
    nothing landed, the pixel's own motion.
    """
    keys = pick(nearest_key(splat(depth, motion))[:, None], landing(motion))[:, 0]
    return torch.where((keys == EMPTY)[:, None], motion, pick(motion, key_index(keys)))


def filled(
    seen: Sequence[tuple[Tensor, Tensor]],
    fallback: Float[Tensor, "b 3 h w"],
    surfaces: Float[Tensor, "b c h w"],
) -> Float[Tensor, "b 3 h w"]:
    """Warped light with its holes filled: from an older frame that shows the surface, else from like surfaces around.

    Args:
        seen: warped light (b 3 h w) and where it is valid (b 1 h w, bool), the newest frame last.
        fallback: what counts, a little, besides the surfaces around, and alone where there is none.
        surfaces: `likeness` of the frame that the light is warped to.

    Around a hole 32 places up to 11 pixels away are read; each counts by 1 / distance^2 and, as a Gaussian of the
    difference in `likeness`, by how much it is like the hole's surface.
    """
    (image, known), *older = seen[::-1]
    for light_there, valid_there in older:
        image = torch.where(known, image, light_there)
        known = known | valid_there
    if image.device.type == "cpu":
        return fill_holes(image, known, surfaces, fallback)
    return _filled_at(torch.arange(known.numel(), device=image.device), image, known, surfaces, fallback)


def likeness(
    normal: Float[Tensor, "b 3 h w"], depth: Float[Tensor, "b 1 h w"], other: Float[Tensor, "b c h w"]
) -> Float[Tensor, "b d h w"]:
    """Surfaces as points: at a distance of 1 they count 1/e. `other`: roughness and metallic, or base colour."""
    return torch.cat((normal / TURNED, depth.clamp(max=SKY).log() / NEAR, other / ALIKE), 1)


@library.custom_op("framecast::fill_holes", mutates_args=())
def fill_holes(image: Tensor, known: Tensor, surfaces: Tensor, fallback: Tensor) -> Tensor:
    """`filled` at the holes alone: where cores are few, an eighth of the pixels takes an eighth of the time.

    A GPU would have to wait for their number, and fills every pixel. Compiled code calls this as it is.
    """
    return _filled_at((~known).flatten().nonzero()[:, 0], image, known, surfaces, fallback)


def _filled_at(
    holes: Int[Tensor, " n"],
    image: Float[Tensor, "b 3 h w"],
    known: Bool[Tensor, "b 1 h w"],
    surfaces: Float[Tensor, "b c h w"],
    fallback: Float[Tensor, "b 3 h w"],
) -> Float[Tensor, "b 3 h w"]:
    """The image filled at these of the batch's pixels that are not known."""
    height, width = image.shape[-2:]
    rows = as_rows(torch.cat((image, known.to(image.dtype), surfaces), 1))
    column, row = holes % width, holes // width % height
    own = rows[holes]
    total = as_rows(fallback)[holes] * DOUBT
    weights = torch.full_like(total[:, :1], DOUBT)
    for dx, dy in PLACES:
        x, y = column + dx, row + dy
        exists = (x >= 0) & (x < width) & (y >= 0) & (y < height)
        there = rows[torch.where(exists, holes + dy * width + dx, holes)]
        unlike = (there[:, 4:] - own[:, 4:]).square().sum(1, keepdim=True)
        weight = exists[:, None] * there[:, 3:4] * torch.exp(-unlike.clamp(max=30)) / (dx * dx + dy * dy)
        total, weights = total + weight * there[:, :3], weights + weight
    found = torch.where(own[:, 3:4] > 0, own[:, :3], total / weights)
    return as_image(as_rows(image).index_copy(0, holes, found), image)


def as_rows(image: Shaped[Tensor, "b c h w"]) -> Shaped[Tensor, "n c"]:
    """Every pixel of the batch as a row: one read then fetches all of its channels."""
    return image.permute(0, 2, 3, 1).flatten(0, 2)


def as_image(rows: Shaped[Tensor, "n c"], like: Shaped[Tensor, "b _ h w"]) -> Shaped[Tensor, "b c h w"]:
    """Undoes `as_rows`."""
    return rows.view(like.shape[0], *like.shape[-2:], -1).permute(0, 3, 1, 2).contiguous()


@fill_holes.register_fake
def _(image: Tensor, known: Tensor, surfaces: Tensor, fallback: Tensor) -> Tensor:
    return torch.empty_like(image, memory_format=torch.contiguous_format)


def choose(fresh: Bool[Tensor, " b"], a: Geometry, b: Geometry) -> Geometry:
    """Per image of the batch, `a` where `fresh`, else `b`."""
    return Geometry(**{f.name: chosen(fresh, getattr(a, f.name), getattr(b, f.name)) for f in fields(Geometry)})


def chosen(fresh: Bool[Tensor, " b"], a: Tensor, b: Tensor) -> Tensor:
    """Per image of the batch, `a` where `fresh`, else `b`."""
    return torch.where(fresh.view(-1, *[1] * (a.ndim - 1)), a, b)
