"""3D warp: reference images re-projected to the camera of the wanted moment, as if nothing but the camera moved.

Paper:   Mark, McMillan, Bishop, "Post-Rendering 3D Warping", Symposium on Interactive 3D Graphics 1997,
         https://doi.org/10.1145/253284.253292
Follows: every reference pixel is a point in space, its colour, depth and camera known; it is projected to the target
         camera. Two references are composited, because each sees what the other one hides. Surfaces are reconstructed
         either from points (`Config.mesh` False) or as the paper does: the depth image is a mesh of two triangles per
         four pixels, and the triangles that span a jump in depth, `skins`, lose against connected surfaces wherever
         either reference sees these, and show as rubber sheets where nothing else is seen.
Differs: the paper renders references at poses predicted around the viewer; here they are the two shaded frames, and the
         target pose lies between them, or beyond (position linear, rotation slerp, projection linear). Beyond, the last
         frame alone is warped: the one before it filled holes worse than their surroundings do (0.03 and 0.14 dB less
         on two real shots with moving figures). Colour is read back from the reference by bilinear interpolation at the
         place that the visible point implies, in place of painting whole pixels. Where both references show the same
         surface they are mixed by time; where they disagree something moved, against the assumption, and the reference
         nearer in time wins (taking the nearer surface, which is right only if nothing moves: 0.2 and 0.7 dB less).
         Mixing there too would score higher (1.1 and 1.5 dB) by showing double images. Holes fill from the far side by
         push-pull.
Needs:   color, depth, view, projection; frames without jitter; cameras that turn less than 180 degrees between frames
Modes:   interpolate, extrapolate
State:   the last two shaded frames
"""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor, nn

from framecast.color import decode_log, encode_log
from framecast.frame import Frame, pixel_grid
from framecast.methods.mesh import rasterize
from framecast.methods.pair import Pair, advance, begin
from framecast.warp import EMPTY, key_index, pick, splat, warp

REACH = (-0.25, 0.25)
"""A point is sent to the pixels that contain its position moved by these, across and down."""


@dataclass(frozen=True)
class Config:
    """Settings of `Warp3D`."""

    mesh: bool = False
    """Surfaces from the paper's triangle mesh with rubber sheets, several times slower, in place of points."""
    skin: float = 0.05
    """Relative jump in depth within a triangle from which on it is a skin, and between references from which on they
    show different surfaces."""


@dataclass(frozen=True)
class View:
    """A reference as the target camera sees it."""

    color: Float[Tensor, "b 3 h w"]
    """Encoded by `encode_log`; meaningless where nothing is seen."""
    depth: Float[Tensor, "b 1 h w"]
    """From the target camera."""
    rank: Float[Tensor, "b 1 h w"]
    """0 a connected surface, 1 a skin, 2 nothing."""


class Warp3D(nn.Module):
    """See the top of this file."""

    needs: tuple[str, ...] = ("color", "depth", "view", "projection")
    needs_generated: tuple[str, ...] = ()
    modes: tuple[str, ...] = ("interpolate", "extrapolate")
    scales: tuple[float, ...] = (1.0,)
    history: int | None = 2
    step_motion: bool = False

    def __init__(self, config: Config = Config()) -> None:
        super().__init__()
        self.config = config

    def start(self, frame: Frame) -> Pair:
        """The state before the first frame, which is `frame`."""
        return begin(frame, self.needs)

    def forward(self, frame: Frame, state: Pair) -> tuple[Float[Tensor, "b 3 h w"], Pair]:
        """The frame's own image where it was shaded, else both references warped to the camera of its time."""
        if frame.color is not None:
            return frame.color, advance(frame, state, self.needs)
        at = state.position(frame.time)
        view, projection = camera(state, at)
        seen = self.see(state.current, view, projection)
        if not bool((at > 1).all()):
            seen = composite(self.see(state.prev, view, projection), seen, at, self.config.skin)
        return decode_log(fill(seen.color, seen.depth, seen.rank < 2)), state

    def see(self, reference: Frame, view: Float[Tensor, "b 4 4"], projection: Float[Tensor, "b 4 4"]) -> View:
        """The reference from the target camera."""
        assert reference.color is not None
        assert reference.depth is not None
        displacement, depth = reproject(reference, view, projection)
        if self.config.mesh:
            motion, z, rank = rasterize(displacement, depth, reference.depth, self.config.skin)
        else:
            motion, z, rank = points(displacement, depth)
        return View(warp(encode_log(reference.color), motion), z, rank)


def camera(state: Pair, at: Float[Tensor, "b 1 1 1"]) -> tuple[Float[Tensor, "b 4 4"], Float[Tensor, "b 4 4"]]:
    """View and projection at a moment between (0..1) or beyond (> 1) the two frames.

    The camera's position and the projection move linearly, the rotation about one axis at constant speed (slerp). In
    full precision, also where a network that follows is rounded: eight bits of a position are metres.
    """
    prev, current = state.prev, state.current
    assert prev.view is not None
    assert prev.projection is not None
    assert current.view is not None
    assert current.projection is not None
    with torch.autocast(at.device.type, enabled=False):
        s = at[:, :, :, 0]
        first, last = prev.view[:, :3, :3], current.view[:, :3, :3]
        centres = [-(v[:, :3, :3].mT @ v[:, :3, 3:]) for v in (prev.view, current.view)]
        rotation = turned(last @ first.mT, s) @ first
        centre = centres[0] + (centres[1] - centres[0]) * s
        view = torch.cat((torch.cat((rotation, -(rotation @ centre)), 2), current.view[:, 3:]), 1)
    return view, prev.projection + (current.projection - prev.projection) * s


def turned(rotation: Float[Tensor, "b 3 3"], amount: Float[Tensor, "b 1 1"]) -> Float[Tensor, "b 3 3"]:
    """The rotation about the same axis by `amount` times the angle; defined below 180 degrees."""
    cross = (rotation - rotation.mT) / 2  # sin(angle) times the cross-product matrix of the axis
    sine = torch.linalg.matrix_norm(cross)[:, None, None] / 2**0.5
    cosine = (rotation.diagonal(dim1=1, dim2=2).sum(1)[:, None, None] - 1) / 2
    angle = torch.atan2(sine, cosine) * amount
    axis = cross / sine.clamp(min=1e-12)
    eye = torch.eye(3, device=rotation.device, dtype=rotation.dtype)
    return eye + torch.sin(angle) * axis + (1 - torch.cos(angle)) * (axis @ axis)  # Rodrigues


def reproject(
    reference: Frame, view: Float[Tensor, "b 4 4"], projection: Float[Tensor, "b 4 4"]
) -> tuple[Float[Tensor, "b 2 h w"], Float[Tensor, "b 1 h w"]]:
    """Pixels by which each reference pixel moves on the target's image, and its depth there.

    Points behind the target camera go off its image. The paper's warping equation: one 4 x 4 matrix for the whole
    image applied to (x w, y w, depth, 1). It is made in double precision, so that a still camera moves nothing.
    """
    assert reference.depth is not None
    assert reference.view is not None
    assert reference.projection is not None
    height, width = reference.depth.shape[-2:]
    old, new = screen(reference.projection), screen(projection)
    m = (new @ view.double() @ torch.linalg.inv(old @ reference.view.double())).float()[..., None, None]
    x, y = pixel_grid(height, width, device=view.device)
    x, y, depth = 2 * x / width - 1, 1 - 2 * y / height, reference.depth[:, 0]
    w = clip_w(depth, reference.projection)
    there = [m[:, k, 0] * (x * w) + m[:, k, 1] * (y * w) + m[:, k, 2] * depth + m[:, k, 3] for k in range(3)]
    w = clip_w(there[2], projection)
    ahead = (w > 1e-6) & (there[2] > 0)
    w = torch.where(ahead, w, 1)
    dx, dy = (there[0] / w - x) * (width / 2), (y - there[1] / w) * (height / 2)
    away = 2.0 * (width + height)
    return torch.where(ahead[:, None], torch.stack((dx, dy), 1), away), there[2].clamp(min=0)[:, None]


def screen(projection: Float[Tensor, "b 4 4"]) -> Float[Tensor, "b 4 4"]:
    """Camera space to (clip x, clip y, depth, 1), double precision."""
    rest = projection.new_tensor([[0, 0, -1, 0], [0, 0, 0, 1]], dtype=torch.float64)
    return torch.cat((projection[:, :2].double(), rest.expand(len(projection), 2, 4)), 1)


def clip_w(depth: Float[Tensor, "b h w"], projection: Float[Tensor, "b 4 4"]) -> Float[Tensor, "b h w"]:
    """Clip-space w at a depth."""
    return projection[:, 3, 3, None, None] - projection[:, 3, 2, None, None] * depth


def points(
    displacement: Float[Tensor, "b 2 h w"], depth: Float[Tensor, "b 1 h w"]
) -> tuple[Float[Tensor, "b 2 h w"], Float[Tensor, "b 1 h w"], Float[Tensor, "b 1 h w"]]:
    """What points show at each target pixel: the motion back to the place in the reference, its depth, its rank.

    Every point covers the target pixels whose centres are within 3/4 of a pixel, the nearest one winning: in each
    direction a coverage of a quarter or more. Surfaces stretch by half their size without cracks.
    """
    batch = len(depth)
    corners = [displacement + displacement.new_tensor((x, y))[:, None, None] for y in REACH for x in REACH]
    keys = splat(depth.repeat(4, 1, 1, 1), torch.cat(corners))
    keys = keys.view(4, batch, *keys.shape[1:]).amin(0)
    source = key_index(keys)
    return -pick(displacement, source), pick(depth, source), torch.where(keys == EMPTY, 2.0, 0.0)[:, None]


def composite(prev: View, current: View, at: Float[Tensor, "b 1 1 1"], tolerance: float) -> View:
    """Both references as one: the better rank, of the same surface the mix by time, else the nearer in time.

    Depths that differ by at most `tolerance` of the nearer one belong to the same surface.
    """
    equal = prev.rank == current.rank
    nearest = torch.minimum(prev.depth, current.depth)
    same = equal & ((prev.depth - current.depth).abs() <= tolerance * nearest)
    take = (current.rank < prev.rank) | (equal & (at >= 0.5))
    weight = torch.where(same, at.clamp(0, 1), take.float())
    return View(
        prev.color + (current.color - prev.color) * weight,
        torch.where(take, current.depth, prev.depth),
        torch.minimum(current.rank, prev.rank),
    )


def fill(
    color: Float[Tensor, "b 3 h w"], depth: Float[Tensor, "b 1 h w"], mask: Bool[Tensor, "b 1 h w"]
) -> Float[Tensor, "b 3 h w"]:
    """The image with the pixels outside `mask` replaced by the far side of what surrounds them, holes of any size.

    Push-pull: each coarser level is the mean, over 2 x 2, of the pixels that nothing in the 5 x 5 around lies behind by
    more than a tenth; holes take the next coarser level. An image without any unmasked pixel becomes black.
    """
    if max(color.shape[-2:]) == 1:
        return torch.where(mask, color, 0)
    height, width = color.shape[-2:]
    grow = (0, width % 2, 0, height % 2)
    far = torch.where(mask, depth, 0)
    kept = mask & (far >= 0.9 * F.max_pool2d(far, 5, stride=1, padding=2))
    weight = F.avg_pool2d(F.pad(kept.float(), grow), 2)
    mean = F.avg_pool2d(F.pad(color * kept, grow), 2) / weight.clamp(min=1e-6)
    coarse = fill(mean, F.max_pool2d(F.pad(far * kept, grow), 2), weight > 0)
    smooth = F.interpolate(coarse, scale_factor=2.0, mode="bilinear")[:, :, :height, :width]
    return torch.where(mask, color, smooth)
