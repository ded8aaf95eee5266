"""Shapes of the held-out scenes: lofted rings, extruded outlines, pillows, bars, strips; and things built from them.

All sizes in metres; texture coordinates in metres over `tile`, the size of one repeat, unless said otherwise. The
training scenes have their own file and share none of these functions.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from numpy.random import Generator

from framecast.render.mesh import box_uvs, from_grid, grid_triangles, join, placed, shaded
from framecast.render.motion import Numbers, frame_along, move, scale, turn, unit
from framecast.render.scene import Mesh


def loft(rings: Float[ndarray, "r k 3"], tile: float = 1.0, crease: float = 40.0, caps: bool = True) -> Mesh:
    """A skin over closed rings of k points each. Rings run counter-clockwise seen against the direction of the loft."""
    around = np.concatenate([rings, rings[:, :1]], axis=1)
    if caps:
        first, last = rings[0].mean(axis=0), rings[-1].mean(axis=0)
        ends = [np.broadcast_to(p, (1, around.shape[1], 3)) for p in (first, last)]
        around = np.concatenate([ends[0], around, ends[1]])
    u = np.concatenate(
        [np.zeros((len(around), 1)), np.cumsum(np.linalg.norm(np.diff(around, axis=1), axis=2), axis=1)], axis=1
    )
    v = np.concatenate(
        [np.zeros((1, around.shape[1])), np.cumsum(np.linalg.norm(np.diff(around, axis=0), axis=2), axis=0)]
    )
    wide = np.broadcast_to(u[np.argmax(u[:, -1])], u.shape)
    uvs = np.stack([wide, np.broadcast_to(v.mean(axis=1, keepdims=True), v.shape)], axis=-1) / tile
    count = around.shape[1]
    return shaded(around.reshape(-1, 3), uvs.reshape(-1, 2), grid_triangles(len(around), count)[:, ::-1], crease)


def outline_ring(outline: Float[ndarray, "k 2"], z: float, shrink: float = 1.0) -> Float[ndarray, "k 3"]:
    """The flat outline (x, y), counter-clockwise, at depth z."""
    return np.column_stack([outline * shrink, np.full(len(outline), z)])


def prism(outline: Numbers, depth: float, bevel: float = 0.0, tile: float = 1.0) -> Mesh:
    """An outline (k 2), counter-clockwise and seen whole from the origin, extruded from z = 0 to `depth`,
    edges bevelled.
    """
    flat = np.asarray(outline, np.float64)
    shrink = 1 - bevel / float(np.linalg.norm(flat, axis=1).max())
    rings = [
        outline_ring(flat, 0, shrink),
        outline_ring(flat, bevel),
        outline_ring(flat, depth - bevel),
        outline_ring(flat, depth, shrink),
    ]
    return box_uvs(loft(np.stack(rings), crease=32), tile)


def block(x: float, y: float, z: float, bevel: float = 0.01, tile: float = 1.0) -> Mesh:
    """A rectangular block around the origin."""
    outline = np.array([(-x, -y), (x, -y), (x, y), (-x, y)]) / 2
    return box_uvs(placed(prism(outline, z, min(bevel, x / 4, y / 4, z / 4)), move(0, 0, -z / 2)), tile)


def disc_outline(radius: float, count: int = 32) -> Float[ndarray, "k 2"]:
    """A regular polygon."""
    angle = np.linspace(0, 2 * np.pi, count, endpoint=False)
    return radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def pillar(stations: Numbers, sides: int = 24, tile: float = 1.0, crease: float = 40.0) -> Mesh:
    """A round body along y through (y, radius) stations (k 2), from the bottom up."""
    flat = disc_outline(1.0, sides)
    rings = [
        np.column_stack([flat[:, 0] * r, np.full(sides, y), -flat[:, 1] * r]) for y, r in np.asarray(stations, float)
    ]
    return loft(np.stack(rings), tile, crease)


def pillow(x: float, y: float, z: float, power: float = 0.5, steps: int = 24) -> Mesh:
    """A superellipsoid of the given half sizes: power 1 is an ellipsoid, towards 0 a box with round edges."""

    def bend(value: Any) -> Any:
        return np.sign(value) * np.abs(value) ** power

    latitude = np.linspace(-np.pi / 2, np.pi / 2, steps // 2 + 1)[1:-1]
    longitude = np.linspace(0, 2 * np.pi, steps, endpoint=False)
    rings = np.stack(
        [
            np.stack(
                [
                    x * bend(np.cos(a)) * bend(np.cos(longitude)),
                    np.full(steps, y * bend(np.sin(a))),
                    -z * bend(np.cos(a)) * bend(np.sin(longitude)),
                ],
                axis=1,
            )
            for a in latitude
        ]
    )
    return loft(rings, crease=50)


def bar(path: Numbers, wide: float, high: float, tile: float = 1.0) -> Mesh:
    """A square-edged bar along a polyline (k 3)."""
    line = np.asarray(path, np.float64)
    frames = frame_along(line)
    corners = np.array([(-wide, -high), (wide, -high), (wide, high), (-wide, high)]) / 2
    return loft(line[:, None] + np.einsum("kc,rcd->rkd", corners, frames[:, :2]), tile, 30)


def cord(path: Numbers, radius: float, sides: int = 6) -> Mesh:
    """A thin round line along a polyline (k 3)."""
    line = np.asarray(path, np.float64)
    return loft(
        line[:, None] + np.einsum("kc,rcd->rkd", disc_outline(radius, sides), frame_along(line)[:, :2]), 0.2, 80
    )


def hanging(a: Numbers, b: Numbers, sag: float, radius: float, steps: int = 14) -> Mesh:
    """A cord from `a` to `b` that hangs `sag` below the middle."""
    t = np.linspace(0, 1, steps)[:, None]
    return cord(
        np.asarray(a) + (np.asarray(b, float) - np.asarray(a)) * t - np.array([0, 4 * sag, 0]) * t * (1 - t), radius, 5
    )


def sheet(x: float, z: float, cells: int, height: Callable[..., ndarray] | None = None, tile: float = 1.0) -> Mesh:
    """A surface over the rectangle around the origin that faces up; flat, or `height(x, z)` of arrays."""
    gx, gz = np.meshgrid(np.linspace(-x / 2, x / 2, cells + 1), np.linspace(-z / 2, z / 2, cells + 1))
    high = np.zeros_like(gx) if height is None else height(gx, gz)
    return from_grid(np.stack([gx, high, gz], axis=-1), np.stack([gx, gz], axis=-1) / tile, 80)


def picture(wide: float, high: float) -> Mesh:
    """A rectangle in the xy plane facing +z that shows a texture once."""
    x, y = wide / 2, high / 2
    points = np.array([(-x, y, 0), (-x, -y, 0), (x, -y, 0), (x, y, 0)], np.float32)
    uvs = np.array([(0, 0), (0, 1), (1, 1), (1, 0)], np.float32)
    return Mesh(
        points, np.tile(np.array([[0, 0, 1]], np.float32), (4, 1)), uvs, np.array([0, 1, 2, 0, 2, 3], np.uint32)
    )


def gear_outline(teeth: int, radius: float, tall: float) -> Float[ndarray, "k 2"]:
    """Outline of a toothed wheel of pitch radius `radius`."""
    shape = np.array([(-0.27, -0.55), (-0.15, 0.45), (0.15, 0.45), (0.27, -0.55)])
    angle = (np.arange(teeth)[:, None] + shape[:, 0]) * 2 * np.pi / teeth
    r = np.broadcast_to(radius + tall * shape[:, 1], angle.shape)
    return np.stack([r * np.cos(angle), r * np.sin(angle)], axis=-1).reshape(-1, 2)


def gear(teeth: int, radius: float, depth: float, spokes: int = 5) -> Mesh:
    """A spoked gear about the z axis with a raised hub; its texture coordinates span 0..1 over the disc."""
    tall = 2.2 * radius / teeth * 1.6
    outer, count = gear_outline(teeth, radius, tall), teeth * 4
    inner = disc_outline(radius * 0.78, count)
    start = np.argmin(np.abs(np.arctan2(inner[:, 1], inner[:, 0]) - np.arctan2(outer[0, 1], outer[0, 0])))
    inner = np.roll(inner, -start, axis=0)
    rim = np.stack(
        [
            outline_ring(inner, 0),
            outline_ring(outer, 0),
            outline_ring(outer, depth),
            outline_ring(inner, depth),
            outline_ring(inner, 0),
        ]
    )
    parts = [loft(rim, crease=30, caps=False)]
    for k in range(spokes):
        blade = np.array(
            [
                (radius * 0.15, -0.07 * radius),
                (radius * 0.8, -0.05 * radius),
                (radius * 0.8, 0.05 * radius),
                (radius * 0.15, 0.07 * radius),
            ]
        )
        middle = blade.mean(axis=0)
        arm = placed(prism(blade - middle, depth * 0.6, 0.004 * radius), move(middle[0], middle[1], depth * 0.2))
        parts.append(placed(arm, turn("z", 2 * np.pi * k / spokes)))
    parts.append(placed(prism(disc_outline(radius * 0.22, 28), depth * 1.5, 0.02 * radius), move(0, 0, -depth * 0.25)))
    parts.append(placed(prism(disc_outline(radius * 0.07, 16), depth * 2.4, 0.01 * radius), move(0, 0, -depth * 0.7)))
    whole = join(parts)
    return Mesh(
        whole.positions,
        whole.normals,
        (whole.positions[:, :2] / (2.6 * radius) + 0.5).astype(np.float32),
        whole.indices,
    )


def propeller(radius: float, blades: int, chord: float) -> Mesh:
    """Twisted, tapering blades of lens-shaped section about the z axis."""
    parts = [placed(pillow(radius * 0.09, radius * 0.09, radius * 0.16, 0.9, 18), move(0, 0, 0))]
    section = np.array([(-0.5, 0), (-0.2, -0.05), (0.2, -0.05), (0.5, 0), (0.2, 0.07), (-0.2, 0.07)])
    for k in range(blades):
        rings = []
        for t in np.linspace(0.05, 1, 10):
            wide = chord * (0.6 + 0.9 * np.sin(np.pi * min(t * 0.9 + 0.05, 1.0)) - 0.5 * t)
            twist = 1.1 - 0.75 * t
            c, s = np.cos(twist), np.sin(twist)
            flat = section * wide
            rings.append(
                np.column_stack(
                    [flat[:, 0] * c - flat[:, 1] * s, np.full(6, t * radius), -(flat[:, 0] * s + flat[:, 1] * c)]
                )
            )
        parts.append(placed(loft(np.stack(rings), crease=70), turn("z", 2 * np.pi * k / blades)))
    return join(parts)


def boat_hull(long: float, wide: float, deep: float) -> Mesh:
    """An open hull, its bow towards +x, the waterline at y = 0; rounded outside, hollow inside."""
    stations = np.linspace(-0.5, 0.5, 22)
    girth = np.linspace(-1, 1, 19)
    outer = []
    for s in stations:
        fine = np.clip(1 - (2 * max(s, 0.0)) ** 2.2, 0.015, 1) * np.clip(1 - 0.35 * (2 * min(s, 0.0)) ** 4, 0, 1)
        sheer = deep * (0.55 + 0.5 * (2 * s) ** 2 * (0.45 + 0.55 * (s > 0)))
        rise = deep * 0.35 * (2 * max(s, 0.0)) ** 3
        y = sheer - (sheer + deep * 0.5 - rise) * np.cos(girth * np.pi / 2) ** 0.8
        outer.append(
            np.column_stack(
                [
                    np.full(19, s * long * (1 + 0.04 * (s > 0))),
                    y,
                    np.sign(girth) * np.abs(girth) ** 0.65 * wide / 2 * fine,
                ]
            )
        )
    skin = np.stack(outer)
    inside = skin * (0.985, 1, 0.93) + (0, 0.03 * deep, 0)
    uvs = np.stack(np.meshgrid(girth * wide, stations * long), axis=-1) / 2.0
    parts = [from_grid(skin, uvs, 50), from_grid(inside[:, ::-1], uvs[:, ::-1], 50)]
    rim = [bar(skin[:, k] + (0, 0.015, 0), 0.05 * wide, 0.04) for k in (0, -1)]
    stern = shaded(skin[0], uvs[0], np.array([(9, k, k + 1) for k in range(18) if k not in (8, 9)]), 30)
    stern_back = shaded(skin[0], uvs[0], np.array([(9, k + 1, k) for k in range(18) if k not in (8, 9)]), 30)
    return join([*parts, *rim, stern, stern_back])


def swept_roof(x: float, z: float, rise: float, flare: float) -> Mesh:
    """A hipped roof with upturned corners, eaves at y = 0, with a soffit below."""
    n = 25
    u, v = np.meshgrid(np.linspace(-1, 1, n), np.linspace(-1, 1, n))
    edge = np.maximum(np.abs(u), np.abs(v))
    corner = (np.abs(u) * np.abs(v)) ** 3
    y = rise * (1 - edge) ** 1.35 + flare * corner
    top = np.stack([u * x / 2 * (1 + 0.06 * corner), y, v * z / 2 * (1 + 0.06 * corner)], axis=-1)
    under = top * (1, 0.5, 1) - (0, 0.14, 0)
    uvs = top[..., [0, 2]] / 1.5
    rim = np.concatenate([top[0, :], top[:, -1], top[-1, ::-1], top[::-1, 0]])
    low = np.concatenate([under[0, :], under[:, -1], under[-1, ::-1], under[::-1, 0]])
    band = np.stack([rim, low])
    return join([from_grid(top, uvs, 35), from_grid(under[::-1], uvs, 35), from_grid(band, band[..., :2], 35)])


def fronds(rng: Generator, count: int, long: float, wide: float, droop: float) -> Mesh:
    """A crown of arching leaves from the origin;
    each leaf a bent strip that shows the texture once, its foot inside.
    """
    parts = []
    for k in range(count):
        angle, lift = 2 * np.pi * (k * 0.382 % 1), rng.uniform(0.2, 1.1)
        reach = long * rng.uniform(0.8, 1.15)
        t = np.linspace(0, 1, 8)[:, None]
        out, side = np.array([np.cos(angle), 0, np.sin(angle)]), np.array([-np.sin(angle), 0, np.cos(angle)])
        spine = out * reach * t * np.cos(lift * (1 - 0.3 * t)) + np.array([0, 1.0, 0]) * reach * (
            np.sin(lift) * t - droop * t**2
        )
        fold = np.array([0, -0.18, 0]) * wide
        strip = np.stack([spine + side * wide / 2 + fold, spine, spine - side * wide / 2 + fold], axis=1)
        uvs = np.stack(np.broadcast_arrays(np.array([[0.0, 0.5, 1.0]]), 1 - t), axis=-1)
        parts.append(from_grid(strip, uvs, 70))
    return join(parts)


def cloud_crown(rng: Generator, centres: Float[ndarray, "k 3"], radius: float, each: int, size: float) -> Mesh:
    """Layered foliage: `each` cards on every flattened ball, facing outwards, each showing the texture once."""
    parts = []
    for centre in centres:
        for _ in range(each):
            out = unit(rng.normal(0, 1, 3) * (1, 0.6, 1))
            look = unit(out + rng.normal(0, 0.35, 3))
            side = unit(np.cross((0.1, 1.0, 0.2), look))
            up = np.cross(look, side)
            middle = centre + out * (1, 0.45, 1) * radius * rng.uniform(0.5, 1.0)
            corners = [middle + size * (a * side + b * up) for a, b in ((-1, 1), (-1, -1), (1, -1), (1, 1))]
            normals = np.tile(unit(out + np.array([0, 0.5, 0])), (4, 1))
            parts.append(
                Mesh(
                    np.array(corners, np.float32),
                    normals.astype(np.float32),
                    np.array([(0, 0), (0, 1), (1, 1), (1, 0)], np.float32),
                    np.array([0, 1, 2, 0, 2, 3], np.uint32),
                )
            )
    return join(parts)


def stem(rng: Generator, height: float, radius: float, lean: float) -> tuple[Mesh, Float[ndarray, "3"]]:
    """(a leaning, slightly bent trunk, its upper end)."""
    t = np.linspace(0, 1, 9)[:, None]
    way = rng.uniform(0, 2 * np.pi)
    path = np.array([0, 1.0, 0]) * height * t + np.array([np.cos(way), 0, np.sin(way)]) * lean * t**2
    path += 0.04 * height * np.sin(6 * t + way) * (t * (1 - t)) * np.array([1, 0, 1])
    rings = (
        path[:, None]
        + np.einsum("kc,rcd->rkd", disc_outline(1.0, 9), frame_along(path)[:, :2])
        * (radius * (1.25 - 0.6 * t))[:, None]
    )
    return loft(rings, 0.6, 60), path[-1]


def stone(rng: Generator, size: float) -> Mesh:
    """A boulder: a pillow pushed in and out."""
    mesh = pillow(1.0, 0.7, 0.85, 0.8, 20)
    p = mesh.positions.astype(np.float64)
    waves = rng.normal(0, 2.2, (5, 3))
    bump = 1 + 0.07 * sum(np.sin(p @ w + k) for k, w in enumerate(waves))
    moved = shaded(p * bump[:, None] * size, mesh.uvs * size, mesh.indices.reshape(-1, 3).astype(np.int64), 60)
    return placed(box_uvs(moved, 1.0), scale(1.0))
