"""Moving pixels: backward warps, depth-tested splats, the algebra of motion vectors, and what became visible.

Motion is in pixels of the image it belongs to, x right, y down, and points from a pixel to where its content is in
another frame: `there = here + motion`. Positions refer to pixel centres at +0.5 (see `frame.py`). Written per plane
and free of branches on data, so that `torch.compile` fuses each function into few kernels.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int, Shaped
from torch import Tensor, library

EMPTY = 0x7F800000 << 32
"""Key of a target pixel on which nothing landed: infinitely far, larger than the key of any source."""

FITS = 0.02
"""Depths that differ by less, relative to the smaller one, are of one surface, and no better one is looked for."""


def _position(motion: Float[Tensor, "b 2 h w"]) -> tuple[Tensor, Tensor]:
    """Column and row index (pixel centres on whole numbers) that each pixel points to."""
    height, width = motion.shape[-2:]
    x = torch.arange(width, dtype=torch.float32, device=motion.device) + motion[:, 0]
    y = torch.arange(height, dtype=torch.float32, device=motion.device)[:, None] + motion[:, 1]
    return x, y


def warp(image: Float[Tensor, "b c h w"], motion: Float[Tensor, "b 2 h w"]) -> Float[Tensor, "b c h w"]:
    """Content of another frame placed on this pixel grid: out(p) = image(p + motion(p)), bilinear.

    Positions outside take the nearest edge pixel; `inside` tells which they are. Bilinear in the values of `image`:
    encode HDR colour first, and use `fetch` for depth and ids, which must not be mixed. Exact at whole-pixel motion
    when compiled, within 2e-4 pixels eagerly (there `grid_sample` is the faster kernel, compiled it is the slower).
    """
    height, width = image.shape[-2:]
    x, y = _position(motion)
    if not torch.compiler.is_compiling() and min(height, width) > 1:
        grid = torch.stack((x * (2 / (width - 1)) - 1, y * (2 / (height - 1)) - 1), -1)
        return F.grid_sample(image, grid, padding_mode="border", align_corners=True)
    x, y = x.clamp(0, width - 1), y.clamp(0, height - 1)
    left, top = x.floor(), y.floor()
    fx, fy = x - left, y - top
    corner = _linear(top, left, height, width)
    # Past the right or lower edge the weight is 0, and any pixel that exists will do.
    corners = [(corner + step).clamp(max=height * width - 1) for step in (0, 1, width, width + 1)]
    planes = []
    for plane in image.unbind(1):
        a, b, c, d = (_at(plane, index) for index in corners)
        planes.append(_mix(_mix(a, b, fx), _mix(c, d, fx), fy))
    return torch.stack(planes, 1)


def _linear(row: Tensor, column: Tensor, height: int, width: int) -> Tensor:
    """Linear index of pixels; inside the image whatever is given, which spares compiled code its own checks."""
    return (row.to(torch.int32) * width + column.to(torch.int32)).clamp(0, height * width - 1)


def _mix(a: Tensor, b: Tensor, f: Tensor) -> Tensor:
    """a at f = 0, b at f = 1 (`torch.lerp` compiles to a slower form)."""
    return a + f * (b - a)


def _at(plane: Tensor, index: Tensor) -> Tensor:
    """Values of one plane (b h w) at linear indices (b h w) within each image of the batch."""
    return plane.flatten(1).gather(1, index.flatten(1).long()).view(index.shape)


def pick(image: Shaped[Tensor, "b c h w"], index: Int[Tensor, "b H W"]) -> Shaped[Tensor, "b c H W"]:
    """Pixels of `image` at linear indices row * w + column, which must be inside."""
    return torch.stack([_at(plane, index) for plane in image.unbind(1)], 1)


def landing(motion: Float[Tensor, "b 2 h w"]) -> Int[Tensor, "b h w"]:
    """Linear index of the pixel that contains each pixel's target, the nearest edge pixel for targets outside."""
    height, width = motion.shape[-2:]
    x, y = _position(motion)
    column, row = (x + 0.5).floor().clamp(0, width - 1), (y + 0.5).floor().clamp(0, height - 1)
    return _linear(row, column, height, width)


def fetch(image: Shaped[Tensor, "b c h w"], motion: Float[Tensor, "b 2 h w"]) -> Shaped[Tensor, "b c h w"]:
    """Like `warp`, but the one pixel that contains the position: values are never mixed."""
    return pick(image, landing(motion))


def inside(motion: Float[Tensor, "b 2 h w"]) -> Bool[Tensor, "b 1 h w"]:
    """Where pixel + motion lies on the image (its outer edge included)."""
    height, width = motion.shape[-2:]
    x, y = _position(motion)
    return ((x >= -0.5) & (x <= width - 0.5) & (y >= -0.5) & (y <= height - 0.5))[:, None]


def scale_motion(motion: Float[Tensor, "b 2 h w"], scale: float) -> Float[Tensor, "b 2 H W"]:
    """Motion for an image `scale` times as large: nearest vectors, their length multiplied.

    Each large pixel takes the vector of the small pixel that its centre lies in.
    """
    height, width = motion.shape[-2:]
    size = (round(height * scale), round(width * scale))
    x = ((torch.arange(size[1], device=motion.device) + 0.5) / scale).long().clamp(max=width - 1)
    y = ((torch.arange(size[0], device=motion.device) + 0.5) / scale).long().clamp(max=height - 1)
    return motion[:, :, y[:, None], x] * scale


def chain(
    motions: Sequence[Float[Tensor, "b 2 h w"]],
    depths: Sequence[Float[Tensor, "b 1 h w"]] | None = None,
    spans: Sequence[Float[Tensor, " b"]] | None = None,
) -> Float[Tensor, "b 2 h w"]:
    """Motion over several frames from the motion of each: acc(p) = m0(p) + m1(p + m0(p)) + ...

    `motions[0]` belongs to the current frame, `motions[1]` to the frame it points to, and so on; each vector is read at
    the accumulated position, in the pixel that contains it (fields jump at silhouettes, so they are not mixed).
    Positions outside read the nearest edge pixel.

    With `depths`, of the same frames, the vector read belongs to the same surface: the pixel of the 3 x 3 around the
    position whose depth is closest to the surface's own. Where even that one differs by more than a tenth, the surface
    was hidden in between, and keeps the velocity it had (`spans`: the times that the motions reach, by default
    equal).
    """
    total = motions[0]
    for k in range(1, len(motions)):
        step = fetch(motions[k], total)
        if depths is not None:
            index, misfit = _same_surface(depths[0], depths[k], total)
            velocity = total / (k if spans is None else _images(torch.stack(list(spans[:k])).sum(0).clamp(min=1e-6)))
            kept = velocity if spans is None else velocity * _images(spans[k])
            step = torch.where(misfit < 0.1, pick(motions[k], index), kept)
        total = total + step
    return total


def _images(values: Float[Tensor, " b"]) -> Float[Tensor, "b 1 1 1"]:
    return values[:, None, None, None]


def _same_surface(
    depth: Float[Tensor, "b 1 h w"], other: Float[Tensor, "b 1 h w"], motion: Float[Tensor, "b 2 h w"]
) -> tuple[Int[Tensor, "b h w"], Float[Tensor, "b 1 h w"]]:
    """Index of the pixel around each target whose depth fits best (the centre where it fits), and the misfit."""
    centre = landing(motion)
    misfit = _unlike(pick(other, centre), depth)
    if depth.device.type == "cpu":
        return search_around(centre, misfit, depth, other)
    return _searched_at(torch.arange(centre.numel(), device=depth.device), centre, misfit, depth, other)


@library.custom_op("framecast::search_around", mutates_args=())
def search_around(centre: Tensor, misfit: Tensor, depth: Tensor, other: Tensor) -> tuple[Tensor, Tensor]:
    """Neighbours searched where the centre does not fit: on few cores they are what takes the time.

    A GPU would have to wait for their number, and searches at every pixel. Compiled code calls this as it is.
    """
    return _searched_at((misfit >= FITS).flatten().nonzero()[:, 0], centre, misfit, depth, other)


@search_around.register_fake
def _(centre: Tensor, misfit: Tensor, depth: Tensor, other: Tensor) -> tuple[Tensor, Tensor]:
    return torch.empty_like(centre), torch.empty_like(misfit)


def _searched_at(
    pixels: Int[Tensor, " n"],
    centre: Int[Tensor, "b h w"],
    misfit: Float[Tensor, "b 1 h w"],
    depth: Float[Tensor, "b 1 h w"],
    other: Float[Tensor, "b 1 h w"],
) -> tuple[Int[Tensor, "b h w"], Float[Tensor, "b 1 h w"]]:
    """The best of the 3 x 3 around `centre` at these of the batch's pixels where `misfit` is not below `FITS`."""
    height, width = depth.shape[-2:]
    best, least = centre.flatten()[pixels], misfit.flatten()[pixels]
    least = torch.where(least < FITS, -1.0, least)
    row, column = best // width, best % width
    first, own, others = pixels // (height * width) * (height * width), depth.flatten()[pixels], other.flatten()
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            index = (row + dy).clamp(0, height - 1) * width + (column + dx).clamp(0, width - 1)
            found = _unlike(others[first + index], own)
            better = found < least
            best, least = torch.where(better, index, best), torch.where(better, found, least)
    least = torch.where(least < 0, misfit.flatten()[pixels], least)
    return (
        centre.flatten().index_copy(0, pixels, best).view(centre.shape),
        misfit.flatten().index_copy(0, pixels, least).view(misfit.shape),
    )


def _unlike(depth: Tensor, other: Tensor) -> Tensor:
    """By what part the larger depth exceeds the smaller one; a logarithm would cost more than the gather."""
    ratio = depth / other
    return torch.maximum(ratio, 1 / ratio) - 1


@dataclass(frozen=True)
class Trajectory:
    """Path of each pixel's content around its own frame: position(dt) = p + velocity dt + acceleration dt^2 / 2."""

    velocity: Float[Tensor, "b 2 h w"]
    acceleration: Float[Tensor, "b 2 h w"]

    def displacement(self, dt: Float[Tensor, " b"]) -> Float[Tensor, "b 2 h w"]:
        """Pixels travelled until `dt` frames later (earlier where negative)."""
        t = dt[:, None, None, None]
        return self.velocity * t + self.acceleration * (0.5 * t * t)


def trajectory(
    motion: Float[Tensor, "b 2 h w"], motion_next: Float[Tensor, "b 2 h w"] | None, span: Float[Tensor, " b"]
) -> Trajectory:
    """The path through the true positions `span` frames before and after; a straight line without `motion_next`."""
    s = span[:, None, None, None]
    if motion_next is None:
        return Trajectory(-motion / s, torch.zeros_like(motion))
    return Trajectory((motion_next - motion) / (2 * s), (motion_next + motion) / (s * s))


def splat(
    depth: Float[Tensor, "b 1 h w"], displacement: Float[Tensor, "b 2 h w"], border: int = 0
) -> Int[Tensor, "b H W"]:
    """Every source pixel sent to the pixel that contains its target; where several meet, the nearest stays.

    Returns packed keys, depth bits above the source's linear index, so that smaller keys are nearer; EMPTY where
    nothing landed. Equal depths keep the smaller index: exact and the same on every run. `depth` must be at least 0;
    targets outside the image are dropped. Read keys with `key_depth` and `key_index`. Around the image lie `border`
    EMPTY pixels on each side, for filters that follow.
    """
    batch, _, height, width = depth.shape
    tall, wide = height + 2 * border, width + 2 * border
    x, y = _position(displacement)
    column, row = (x + 0.5).floor(), (y + 0.5).floor()
    on_screen = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    cell = (row + border).long() * wide + (column + border).long()
    cell = torch.where(on_screen, cell, tall * wide)
    source = torch.arange(height * width, device=depth.device).view(height, width)
    keys = torch.full((batch, tall * wide + 1), EMPTY, dtype=torch.int64, device=depth.device)
    packed = depth_key(depth) | source
    keys = keys.scatter_reduce(1, cell.view(batch, -1), packed.view(batch, -1), "amin")
    return keys[:, :-1].reshape(batch, tall, wide)


def depth_key(depth: Float[Tensor, "b 1 h w"]) -> Int[Tensor, "b h w"]:
    """The smallest key of a depth; the bits of floats of at least 0 are ordered like the floats."""
    return depth[:, 0].contiguous().view(torch.int32).long() << 32


def key_depth(keys: Int[Tensor, "b h w"]) -> Float[Tensor, "b 1 h w"]:
    """Depth of the winning source; infinite where EMPTY."""
    return (keys >> 32).to(torch.int32).view(torch.float32)[:, None]


def key_index(keys: Int[Tensor, "b h w"]) -> Int[Tensor, "b h w"]:
    """Linear index of the winning source; 0 where EMPTY, so that it can always be read with `pick`."""
    return torch.where(keys == EMPTY, 0, keys & 0xFFFFFFFF).to(torch.int32)


def nearest_neighbour(depth: Float[Tensor, "b 1 h w"]) -> Int[Tensor, "b h w"]:
    """Linear index of the nearest surface in each pixel's 3 x 3 neighbourhood (nothing beyond the border)."""
    height, width = depth.shape[-2:]
    source = torch.arange(height * width, device=depth.device).view(height, width)
    keys = depth_key(depth) | source
    return (nearest_key(keys) & 0xFFFFFFFF).to(torch.int32)


def nearest_key(keys: Int[Tensor, "b h w"]) -> Int[Tensor, "b h w"]:
    """The smallest of the keys (see `splat`) in each pixel's 3 x 3 neighbourhood; beyond the border all are EMPTY."""
    keys = F.pad(keys, (1, 1, 1, 1), value=float(EMPTY))
    row = torch.minimum(torch.minimum(keys[:, :, :-2], keys[:, :, 1:-1]), keys[:, :, 2:])
    return torch.minimum(torch.minimum(row[:, :-2], row[:, 1:-1]), row[:, 2:])


def disoccluded(
    frame_depth: Float[Tensor, "b 1 h w"],
    other_depth: Float[Tensor, "b 1 h w"],
    motion: Float[Tensor, "b 2 h w"],
    tolerance: float = 0.05,
) -> Bool[Tensor, "b 1 h w"]:
    """Pixels whose surface the other frame does not show: off its screen, or hidden there by something nearer.

    `motion` leads from the frame to the other one. Hidden: the 3 x 3 pixels around the target are all nearer than this
    surface by more than `tolerance` of its depth; that much a surface may itself move towards the camera.
    """
    farthest = F.max_pool2d(other_depth, 3, stride=1, padding=1)
    return ~inside(motion) | (fetch(farthest, motion) < frame_depth * (1 - tolerance))
