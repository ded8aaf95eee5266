"""A moving scene on paper with every buffer, exact: what methods are timed and counted on, at any size.

A textured wall and five discs in front of it, seen by a camera that travels. Silhouettes uncover the wall, and surfaces
that come nearer spread out, so that warps and splats meet what they meet in rendered frames.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from framecast.frame import Frame, perspective, pixel_grid
from framecast.resample import jitter

GAP = 2.0
"""Time between shaded frames: every second one of the clip is generated."""

PHASES = 16
"""Frames after which jitter repeats."""


@dataclass(frozen=True)
class Disc:
    """A disc that faces the camera and moves across with constant acceleration; lengths in scene units."""

    depth: float
    x: float = 0.0
    y: float = 0.0
    radius: float = float("inf")
    velocity: float = 0.0
    acceleration: float = 0.0

    def centre(self, time: float) -> tuple[float, float]:
        """Where it is at `time`; it sinks slowly."""
        return self.x + self.velocity * time + self.acceleration * time * time / 2, self.y + 0.3 * self.velocity * time


SCENE = (
    Disc(20.0),  # the wall
    Disc(3.0, -0.9, -0.3, 0.4, 0.10, 0.02),
    Disc(5.0, 1.2, 0.5, 0.7, -0.14, -0.03),
    Disc(8.0, 0.3, -1.4, 1.0, 0.12, 0.05),
    Disc(8.0, -3.0, 1.2, 0.9, 0.20, -0.04),
    Disc(12.0, 3.5, -1.0, 1.5, -0.20, 0.06),
)

FOCAL = 1.2
"""Distance of the image plane in image heights."""


def camera(time: float) -> tuple[float, float]:
    """How far the camera has moved to the right, accelerating, and forward."""
    return 0.06 * time + 0.003 * time * time, 0.04 * time


def scene(time: float, height: int, width: int, *, span: float = GAP, jittered: bool = True) -> Frame:
    """The moment `time`; motion reaches over `span`, is exact, and differs with depth and speed.

    Args:
        jittered: pixels are sampled where `resample.jitter` puts the frame's samples, else at their centres.
    """
    offset = jitter(round(time / span), PHASES) if jittered else (0.0, 0.0)
    x, y = (grid + move for grid, move in zip(pixel_grid(height, width), offset, strict=True))
    focal, (aside, forward) = FOCAL * height, camera(time)
    shape = (1, 1, height, width)
    depth, object_id = torch.full(shape, torch.inf), torch.zeros(shape, dtype=torch.int32)
    color, motion, ahead = (
        torch.zeros(1, 3, height, width),
        torch.zeros(1, 2, height, width),
        torch.zeros(1, 2, height, width),
    )
    for i, disc in enumerate(SCENE):
        z, centre = disc.depth - forward, disc.centre(time)
        u = (x - width / 2) * z / focal + aside - centre[0]
        v = (y - height / 2) * z / focal - centre[1]
        hit = (u * u + v * v < disc.radius**2) & (z < depth)
        depth, object_id = torch.where(hit, z, depth), torch.where(hit, i, object_id)
        color = torch.where(hit, _texture(u / disc.depth, v / disc.depth, i), color)
        here = torch.stack((x, y))
        motion = torch.where(hit, _projected(disc, u, v, time - span, width) - here, motion)
        ahead = torch.where(hit, _projected(disc, u, v, time + span, width) - here, ahead)
    return Frame(
        color=color,
        depth=depth,
        motion=motion,
        motion_next=ahead,
        albedo=color.clamp(0.05, 1),
        normal=torch.tensor([0.0, 0.0, 1.0]).view(1, 3, 1, 1).expand(1, 3, height, width).contiguous(),
        roughness=(0.2 + 0.1 * object_id).clamp(max=1),
        metallic=(object_id == 2).float(),
        object=object_id,
        jitter=torch.tensor([offset]),
        view=torch.tensor([[1.0, 0, 0, -aside], [0, 1, 0, 0], [0, 0, 1, forward], [0, 0, 0, 1]])[None],
        projection=perspective(2 * float(torch.tensor(0.5 / FOCAL).atan()), width / height)[None],
        time=torch.tensor([float(time)]),
        reset=torch.tensor([time == 0]),
        span=torch.tensor([float(span)]),
    )


def _projected(disc: Disc, u: Tensor, v: Tensor, time: float, width: int) -> Tensor:
    """Pixel position at `time` of points (u, v) of a disc."""
    height = u.shape[0]
    (aside, forward), centre = camera(time), disc.centre(time)
    scale = FOCAL * height / (disc.depth - forward)
    return torch.stack((width / 2 + (u + centre[0] - aside) * scale, height / 2 + (v + centre[1]) * scale))


def _texture(u: Tensor, v: Tensor, seed: int) -> Float[Tensor, "3 h w"]:
    """Waves, coarse ones of each colour and fine ones of all; 0.02 to 1.2."""
    coarse = torch.tensor([19.0, 27.0, 36.0])[:, None, None]
    waves = 0.25 * torch.sin(u * coarse + seed) * torch.cos(v * coarse) + 0.2 * torch.sin(120 * u) * torch.cos(93 * v)
    return (0.5 + waves) * (1.2 - 0.15 * seed)
