"""Shapes of the training scenes: bevelled boxes, turned profiles, tubes, terrain, arches, roofs, wheels.

All sizes in metres; texture coordinates are metres too, divided by `tile`, the size of one repeat. The held-out scenes
have their own file and share none of these functions.
"""

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from framecast.render.mesh import box_uvs, from_grid, join, placed, shaded
from framecast.render.motion import Numbers, frame_along, move, turn
from framecast.render.scene import Mesh


@lru_cache(maxsize=4096)
def box(x: float, y: float, z: float, bevel: float = 0.01, tile: float = 1.0) -> Mesh:
    """A box of the given size around the origin whose edges are cut by `bevel`, so that they catch light."""
    half = np.array([x, y, z]) / 2
    bevel = min(bevel, 0.45 * 2 * float(half.min()))
    signs = np.array([(a, b, c) for a in (-1, 1) for b in (-1, 1) for c in (-1, 1)])
    points = np.concatenate([signs * (half - bevel * (np.arange(3) != axis)) for axis in range(3)])
    number = {(tuple(s), axis): axis * 8 + k for axis in range(3) for k, s in enumerate(signs.tolist())}
    polygons = [[number[tuple(s), axis] for axis in range(3)] for s in signs.tolist()]
    for axis in range(3):
        b, c = (axis + 1) % 3, (axis + 2) % 3
        for side in (-1, 1):
            ring = []
            for sb, sc in ((-1, -1), (1, -1), (1, 1), (-1, 1)):
                s = [0, 0, 0]
                s[axis], s[b], s[c] = side, sb, sc
                ring.append(number[tuple(s), axis])
            polygons.append(ring)
            for other in (-1, 1):
                ends = []
                for along in (-1, 1):
                    s = [0, 0, 0]
                    s[axis], s[b], s[c] = along, side, other
                    ends.append((number[tuple(s), b], number[tuple(s), c]))
                polygons.append([ends[0][0], ends[1][0], ends[1][1], ends[0][1]])
    return box_uvs(convex(points, polygons), tile)


def convex(points: Float[ndarray, "n 3"], polygons: list[list[int]], crease: float = 50.0) -> Mesh:
    """Faces of a convex solid around the origin, each turned to look outwards."""
    triangles = np.array([(ring[0], ring[k], ring[k + 1]) for ring in polygons for k in range(1, len(ring) - 1)])
    a, b, c = points[triangles].swapaxes(0, 1)
    inwards = np.einsum("nc,nc->n", np.cross(b - a, c - a), a + b + c) < 0
    triangles[inwards] = triangles[inwards, ::-1]
    return shaded(points, np.zeros((len(points), 2)), triangles, crease)


def lathe(profile: Numbers, segments: int = 32, tile: float = 1.0, crease: float = 40.0) -> Mesh:
    """Surface of revolution about y of the (radius, y) points (k 2), listed from the bottom to the top."""
    points = np.asarray(profile, np.float64)
    angle = np.linspace(0, 2 * np.pi, segments + 1)
    ring = np.stack([np.cos(angle), np.zeros_like(angle), np.sin(angle)], axis=-1)
    ring[-1] = ring[0]
    grid = points[:, :1, None] * ring[None] + points[:, 1:, None] * np.array([0.0, 1.0, 0.0])
    length = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    around = angle * max(float(points[:, 0].max()), 1e-3)
    uvs = np.stack(np.broadcast_arrays(around[None] / tile, -length[:, None] / tile), axis=-1)
    return from_grid(grid, uvs, crease)


def ball(radius: float, segments: int = 32, tile: float = 1.0) -> Mesh:
    """A sphere around the origin."""
    angle = np.linspace(-np.pi / 2, np.pi / 2, segments // 2 + 1)
    return lathe(np.stack([np.cos(angle), np.sin(angle)], axis=1) * radius, segments, tile)


def cylinder(radius: float, height: float, segments: int = 24, bevel: float = 0.005, tile: float = 1.0) -> Mesh:
    """A closed cylinder standing on the origin, its rims bevelled."""
    r, b = radius, min(bevel, radius * 0.4, height * 0.4)
    return lathe([(0, 0), (r - b, 0), (r, b), (r, height - b), (r - b, height), (0, height)], segments, tile, 50)


def tube(path: Numbers, radius: float | Numbers, sides: int = 8, tile: float = 1.0, closed: bool = False) -> Mesh:
    """A round bar along the polyline (k 3), of one radius or one per point;
    its ends are capped unless the path is closed.
    """
    line = np.asarray(path, np.float64)
    frames = frame_along(line)
    if closed:
        frames[-1] = frames[0]
    radii = np.broadcast_to(np.asarray(radius, np.float64), (len(line),))
    angle = np.linspace(0, 2 * np.pi, sides + 1)
    angle[-1] = 0
    circle = np.cos(angle)[None, :, None] * frames[:, None, 0] + np.sin(angle)[None, :, None] * frames[:, None, 1]
    grid = line[:, None] + radii[:, None, None] * circle
    length = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    if not closed:
        grid = np.concatenate([np.repeat(line[:1, None], sides + 1, 1), grid, np.repeat(line[-1:, None], sides + 1, 1)])
        length = np.concatenate([length[:1], length, length[-1:]])
    around = np.linspace(0, 2 * np.pi * max(float(radii.max()), 1e-3), sides + 1)
    uvs = np.stack(np.broadcast_arrays(around[None] / tile, -length[:, None] / tile), axis=-1)
    return from_grid(grid[::-1], uvs[::-1], 60)


def terrain(
    x: tuple[float, float],
    z: tuple[float, float],
    cells: tuple[int, int],
    height: Callable[..., ndarray],
    tile: float = 1.0,
) -> Mesh:
    """Ground over the rectangle: `height(x, z)` of arrays, `cells` along x and z; it faces up."""
    grid_z, grid_x = np.meshgrid(np.linspace(*z, cells[1] + 1), np.linspace(*x, cells[0] + 1), indexing="ij")
    points = np.stack([grid_x, np.broadcast_to(height(grid_x, grid_z), grid_x.shape), grid_z], axis=-1)
    return from_grid(points, points[..., [0, 2]] / tile, 80)


def level(x: float, z: float, tile: float = 1.0) -> Mesh:
    """A flat floor of the given size around the origin, facing up."""
    return terrain((-x / 2, x / 2), (-z / 2, z / 2), (1, 1), lambda a, b: 0 * a, tile)


def arch(span: float, spring: float, top: float, thick: float, tile: float = 1.0, pier: float = 0.4) -> Mesh:
    """A wall in the xy plane from y = 0 to `top` with a round-arched opening `span` wide that springs at height
    `spring`.
    """
    angle = np.linspace(np.pi, 0, 17)
    r, outer = span / 2, span / 2 + pier
    bend = np.stack([r * np.cos(angle), spring + r * np.sin(angle)], axis=1)
    inner = np.concatenate([[(-r, 0)], bend, [(r, 0)]])
    edge = np.column_stack([np.clip(bend[:, 0] * outer / r * 1.25, -outer, outer), np.full(len(bend), top)])
    outside = np.concatenate([[(-outer, 0)], edge, [(outer, 0)]])
    outside[1], outside[-2] = (-outer, top), (outer, top)
    front = np.stack([inner, outside])
    depth = thick / 2
    face = np.concatenate([front, np.full((*front.shape[:2], 1), depth)], axis=-1)
    back = face * (1, 1, -1)
    soffit = np.stack([back[0], face[0]])
    parts = [face[::-1], back, soffit[::-1]]
    return box_uvs(join([from_grid(grid, grid[..., :2] * 0, 30) for grid in parts]), tile)


def gable(x: float, z: float, rise: float, over: float = 0.3, tile: float = 1.0) -> Mesh:
    """A pitched roof over a rectangle, ridge along x, eaves at y = 0; one sheet 0.12 thick on each side."""
    slope = float(np.hypot(z / 2 + over, rise * (1 + 2 * over / z)))
    lean = float(np.arctan2(rise, z / 2))
    parts = []
    for side in (0, np.pi):
        sheet = level(x + 2 * over, slope, tile)
        sheet = join([placed(box(x + 2 * over, 0.12, slope, 0.01), move(0, -0.065, 0)), sheet])
        parts.append(placed(sheet, turn("y", side), move(0, rise, 0), turn("x", lean), move(0, 0, slope / 2)))
    return join(parts)


def wheel(radius: float, width: float, spokes: int = 8) -> Mesh:
    """A wheel about the x axis: tyre, hub and spokes."""
    w, r = width / 2, radius
    outline = [
        (0.66, -0.7),
        (0.70, -1),
        (0.95, -1),
        (1, -0.6),
        (1, 0.6),
        (0.95, 1),
        (0.70, 1),
        (0.66, 0.7),
        (0.64, 0),
        (0.66, -0.7),
    ]
    rim = lathe([(r * a, w * b) for a, b in outline], 36, 1.0, 30)
    hub = placed(cylinder(radius * 0.2, width * 1.15, 18), move(0, -width * 0.57, 0))
    spoke = placed(box(radius * 0.6, width * 0.5, radius * 0.16, 0.01), move(radius * 0.4, 0, 0))
    parts = [rim, hub] + [placed(spoke, turn("y", 2 * np.pi * k / spokes)) for k in range(spokes)]
    return placed(join(parts), turn("z", np.pi / 2))


def fan_blades(radius: float, count: int, chord: float, pitch: float) -> Mesh:
    """Twisted blades about the y axis, with a hub."""
    reach = np.linspace(0.12, 1, 12) * radius
    blade = np.zeros((12, 7, 3))
    for row, r in enumerate(reach):
        twist = pitch * (1.6 - 0.9 * r / radius)
        wide = chord * (0.55 + 0.6 * np.sin(np.pi * min(r / radius * 0.85 + 0.1, 1)))
        across = np.linspace(-0.5, 0.5, 7) * wide
        sag = 0.08 * wide * (1 - (2 * across / wide) ** 2)
        blade[row] = np.stack([np.full(7, r), -across * np.sin(twist) + sag, across * np.cos(twist)], axis=1)
    under = blade - (0, 0.008, 0)
    uvs = np.zeros((12, 7, 2))
    one = join([from_grid(blade[:, ::-1], uvs, 60), from_grid(under, uvs, 60)])
    hub = lathe(
        [
            (0, -0.06),
            (0.1 * radius, -0.06),
            (0.15 * radius, -0.03),
            (0.15 * radius, 0.03),
            (0.05 * radius, 0.07),
            (0, 0.08),
        ],
        20,
    )
    return join([hub] + [placed(one, turn("y", 2 * np.pi * k / count)) for k in range(count)])


def knot(p: int, q: int, size: float, thick: float, steps: int = 260, sides: int = 20) -> Mesh:
    """A torus knot winding `p` times around and `q` times through, for sculptures."""
    t = np.linspace(0, 2 * np.pi, steps + 1)
    r = size * (1 + 0.42 * np.cos(q * t))
    path = np.stack([r * np.cos(p * t), size * 0.55 * np.sin(q * t), r * np.sin(p * t)], axis=1)
    path[-1] = path[0]
    return closed_tube(path, thick, sides)


def closed_tube(path: Float[ndarray, "k 3"], thick: float, sides: int) -> Mesh:
    """A tube whose last point is its first, its twist spread so that the seam meets."""
    forward = np.roll(path[:-1], -1, axis=0) - np.roll(path[:-1], 1, axis=0)
    forward /= np.linalg.norm(forward, axis=1, keepdims=True)
    side = np.cross(forward, path[:-1] * (1, 0.2, 1))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    up = np.cross(forward, side)
    angle = np.linspace(0, 2 * np.pi, sides + 1)
    angle[-1] = 0
    ring = path[:-1, None] + thick * (np.cos(angle)[:, None] * side[:, None] + np.sin(angle)[:, None] * up[:, None])
    grid = np.concatenate([ring, ring[:1]])
    uvs = np.stack(np.meshgrid(np.linspace(0, 40 * thick, sides + 1), np.linspace(0, 20, len(grid))), axis=-1)
    return from_grid(grid[::-1], uvs[::-1], 70)


def wire(a: Numbers, b: Numbers, sag: float, radius: float = 0.008, steps: int = 16) -> Mesh:
    """A cable hanging from `a` to `b`, `sag` metres below the straight line in its middle."""
    t = np.linspace(0, 1, steps + 1)[:, None]
    path = np.asarray(a) * (1 - t) + np.asarray(b) * t - np.array([0, 4 * sag, 0]) * t * (1 - t)
    return tube(path, radius, 5)


def railing(length: float, height: float = 1.05, gap: float = 0.13, thick: float = 0.009) -> Mesh:
    """A railing along x from the origin: thin uprights between two bars, and posts."""
    uprights = [placed(cylinder(thick, height - 0.1, 6), move(x, 0.06, 0)) for x in np.arange(gap / 2, length, gap)]
    bars = [placed(box(length, 0.035, 0.045, 0.008), move(length / 2, y, 0)) for y in (0.08, height)]
    posts = [
        placed(box(0.05, height + 0.05, 0.05, 0.008), move(x, height / 2, 0))
        for x in np.linspace(0, length, max(2, round(length / 2) + 1))
    ]
    return join(uprights + bars + posts)
