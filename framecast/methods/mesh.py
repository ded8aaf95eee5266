"""Rasterising a depth image as a mesh of triangles that stretch: the surfaces and rubber sheets of the 3D warp."""

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

NOTHING = (1 << 63) - 1
"""Key of a pixel that no triangle covers. Keys: skin (bit 62), depth bits (31 to 61), triangle (0 to 30)."""

EDGE = 1e-4
"""Barycentric slack, so that pixel centres on an edge belong to the triangles on both sides."""


def rasterize(
    displacement: Float[Tensor, "b 2 h w"],
    depth: Float[Tensor, "b 1 h w"],
    source_depth: Float[Tensor, "b 1 h w"],
    skin: float,
) -> tuple[Float[Tensor, "b 2 h w"], Float[Tensor, "b 1 h w"], Float[Tensor, "b 1 h w"]]:
    """What the mesh shows at each target pixel: the motion back to its place in the source, its depth, its rank.

    The pixel centres of the source are vertices, moved by `displacement` to `depth`; each 2 x 2 of them makes two
    triangles. Rank 0: a connected surface; 1: a skin, whose vertices differ in `source_depth` by more than `skin` of
    the nearest, seen only where no connected surface is; 2: nothing. Triangles with a vertex of depth 0 (behind the
    camera) are dropped. How many fragments there are depends on the data, so this does not compile into one graph.
    """
    each = [_one(*parts, skin) for parts in zip(displacement, depth, source_depth, strict=True)]
    motion, z, rank = (torch.stack(parts) for parts in zip(*each, strict=True))
    return motion, z, rank


def _one(displacement: Tensor, depth: Tensor, source_depth: Tensor, skin: float) -> tuple[Tensor, Tensor, Tensor]:
    """`rasterize` for one image of the batch."""
    height, width = depth.shape[-2:]
    column = torch.arange(width, device=depth.device, dtype=torch.float32).expand(height, width)
    row = torch.arange(height, device=depth.device, dtype=torch.float32)[:, None].expand(height, width)
    source = torch.stack((column, row), -1).reshape(-1, 2)
    corners = _triangles(height, width, depth.device)
    vertices = (source + displacement.reshape(2, -1).T)[corners]
    inverse = 1 / depth.reshape(-1)[corners].clamp(min=1e-12)
    triangle, pixel = _fragments(vertices, (depth.reshape(-1)[corners] > 0).all(1), height, width)
    weight = _barycentric(vertices[triangle], source[pixel])
    z = 1 / (weight * inverse[triangle]).sum(1).clamp(min=1e-12)
    jump = source_depth.reshape(-1)[corners]
    is_skin = jump.amax(1) > jump.amin(1) * (1 + skin)
    keys = (is_skin[triangle].long() << 62) | (z.view(torch.int32).long() << 31) | triangle
    hit = (weight >= -EDGE).all(1)
    best = torch.full((height * width,), NOTHING, device=depth.device)
    best = best.scatter_reduce(0, pixel[hit], keys[hit], "amin")
    return _resolved(best, vertices, source[corners], source, height, width)


def _triangles(height: int, width: int, device: torch.device) -> Int[Tensor, "t 3"]:
    """Linear indices of the corners of each triangle."""
    first = torch.arange(height * width, device=device).view(height, width)
    a, b, c, d = first[:-1, :-1], first[:-1, 1:], first[1:, :-1], first[1:, 1:]
    return torch.cat((torch.stack((a, b, c), -1).view(-1, 3), torch.stack((d, c, b), -1).view(-1, 3)))


def _fragments(
    vertices: Float[Tensor, "t 3 2"], alive: Bool[Tensor, " t"], height: int, width: int
) -> tuple[Int[Tensor, " n"], Int[Tensor, " n"]]:
    """Triangle and linear pixel index of every pixel centre in every triangle's bounding box."""
    limit = vertices.new_tensor((width - 1, height - 1))
    low = (vertices.amin(1) - EDGE).ceil().clamp(min=0)
    high = torch.minimum((vertices.amax(1) + EDGE).floor(), limit)
    size = ((high - low + 1).clamp(min=0) * alive[:, None]).long()
    low, count = torch.where(size > 0, low, 0).long(), size.prod(1)
    triangle = torch.repeat_interleave(count)
    nth = torch.arange(len(triangle), device=count.device) - (count.cumsum(0) - count)[triangle]
    columns = size[triangle, 0]
    x, y = low[triangle, 0] + nth % columns, low[triangle, 1] + nth // columns
    return triangle, y * width + x


def _barycentric(corners: Float[Tensor, "n 3 2"], at: Float[Tensor, "n 2"]) -> Float[Tensor, "n 3"]:
    """Weights of the three corners at a position; all -1 for triangles without area."""
    a, b, c = corners.unbind(1)
    area = _cross(b - a, c - a)
    flat = area.abs() < 1e-9
    weights = torch.stack((_cross(c - b, at - b), _cross(a - c, at - c), _cross(b - a, at - a)), 1)
    return torch.where(flat[:, None], -1, weights / torch.where(flat, 1, area)[:, None])


def _cross(a: Float[Tensor, "n 2"], b: Float[Tensor, "n 2"]) -> Float[Tensor, " n"]:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


def _resolved(
    keys: Tensor, vertices: Tensor, places: Tensor, pixels: Tensor, height: int, width: int
) -> tuple[Tensor, Tensor, Tensor]:
    """Motion, depth and rank of the winning triangle at every pixel."""
    empty = keys == NOTHING
    triangle = torch.where(empty, 0, keys & 0x7FFFFFFF)
    weight = _barycentric(vertices[triangle], pixels)
    motion = (weight[:, :, None] * places[triangle]).sum(1) - pixels
    z = ((keys >> 31) & 0x7FFFFFFF).to(torch.int32).view(torch.float32)
    rank = torch.where(empty, 2.0, ((keys >> 62) & 1).float())
    motion, z = torch.where(empty[:, None], 0.0, motion), torch.where(empty, 0.0, z)
    return motion.T.reshape(2, height, width), z.view(1, height, width), rank.view(1, height, width)
