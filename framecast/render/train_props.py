"""Things that training scenes are furnished with: vehicles, lamps, benches, shelves, each as (mesh, material) parts."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from numpy.random import Generator

from framecast.render.finish import plain, rgb
from framecast.render.mesh import join, placed, standing
from framecast.render.motion import move, turn
from framecast.render.scene import Instance, Material, Mesh, Pose
from framecast.render.train_shapes import ball, box, cylinder, lathe, tube, wheel

Parts = list[tuple[Mesh, Material]]
Drive = Callable[[float], tuple[Float[ndarray, "4 4"], float]]
"""Where a vehicle is at a time, and the metres it has driven."""


def at(place: Float[ndarray, "4 4"], parts: Parts) -> Parts:
    """The parts moved to the place."""
    return [(placed(mesh, place), material) for mesh, material in parts]


def car(rng: Generator) -> Parts:
    """A small car without wheels, 3.9 long along x, standing on y = 0, its nose towards +x."""
    paint = plain(rgb(str(rng.choice(["b3262b", "e8e4da", "27476b", "d8a520", "2e3136", "4f7f72"]))), 0.22, 0.1)
    glass, trim, chrome = plain(rgb("10161b"), 0.06), plain(rgb("17181a"), 0.6), plain(rgb("d5d5d0"), 0.15, 1.0)
    parts: Parts = [
        (placed(box(3.9, 0.56, 1.62, 0.16), move(0, 0.58, 0)), paint),
        (placed(box(3.7, 0.2, 1.5, 0.06), move(0, 0.30, 0)), trim),
    ]
    parts.append((placed(tapered(2.15, 0.58, 1.42, 0.42), move(-0.2, 0.82, 0)), glass))
    parts.append((placed(box(1.42, 0.06, 1.16, 0.03), move(-0.2, 1.40, 0)), paint))
    for z in (-0.63, 0.63):
        pillars = ((-0.25, 0.0, 0.60), (0.66, 0.62, 0.72), (-1.06, -0.62, 0.72))
        parts += [
            (placed(box(0.09, tall, 0.05, 0.01), move(x, 1.11, z * 1.045), turn("z", lean)), paint)
            for x, lean, tall in pillars
        ]
        parts += [
            (placed(cylinder(0.42, 0.04, 28), move(x, 0.36, z * 1.26), turn("x", np.pi / 2 * np.sign(z))), trim)
            for x in (-1.22, 1.22)
        ]
        parts.append((placed(ball(0.11, 14), move(1.9, 0.66, z * 0.88)), plain(rgb("fff4dc"), 0.1, 0.0, 3.0)))
        parts.append(
            (placed(box(0.05, 0.12, 0.3, 0.02), move(-1.94, 0.70, z * 0.9)), plain(rgb("d01818"), 0.2, 0.0, 2.0))
        )
    parts += [(placed(box(0.1, 0.13, 1.66, 0.04), move(x, 0.36, 0)), chrome) for x in (-1.96, 1.96)]
    return parts


def tapered(x: float, y: float, z: float, inset: float) -> Mesh:
    """A bevelled box standing on the origin whose top is narrower, by `inset` along x and 0.3 of it along z,
    at both ends.
    """
    mesh = placed(box(x, y, z, 0.05), move(0, y / 2, 0))
    shrink = mesh.positions[:, 1:2] / y * inset * np.array([[2.0 / x, 0.0, 0.6 / z]])
    points = (mesh.positions * (1 - shrink)).astype(np.float32)
    return Mesh(points, mesh.normals, mesh.uvs, mesh.indices)


def rolling(
    parts: Parts, number: int, path: Drive, radius: float, axles: tuple[float, ...], track: float
) -> list[Instance]:
    """A vehicle on turning wheels as instances of one object; `path(time)` gives its place and the metres driven."""
    bodies = [Instance(i.mesh, i.material, number, lambda time: Pose(path(time)[0])) for i in standing(parts)]
    one = placed(wheel(radius, 0.2, 10), turn("y", np.pi / 2))
    both = join([placed(one, move(0, 0, -track - 0.03)), placed(one, move(0, 0, track + 0.03))])
    rubber = plain(rgb("3a3b3d"), 0.45, 0.3)

    def spin(axle: float) -> Callable[[float], Pose]:
        return lambda time: Pose(path(time)[0] @ move(axle, radius, 0) @ turn("z", -path(time)[1] / radius))

    return bodies + [Instance(both, rubber, number, spin(axle)) for axle in axles]


def tram(rng: Generator) -> Parts:
    """A tram without wheels, 13 m long along x, standing on y = 0:
    windows with posts, doors, roof boxes, a pantograph.
    """
    paint = plain(rgb(str(rng.choice(["a8262c", "1f5c4a", "c98a1b", "24508c"]))), 0.25)
    cream, glass = plain(rgb("eee6d0"), 0.35), plain(rgb("131c22"), 0.05)
    dark, steel = plain(rgb("2a2b2d"), 0.5), plain(rgb("b8b8b4"), 0.3, 1.0)
    parts: Parts = [
        (placed(box(13, 1.05, 2.3, 0.14), move(0, 1.12, 0)), paint),
        (placed(box(12.8, 0.4, 2.1, 0.05), move(0, 0.45, 0)), dark),
    ]
    parts += [
        (placed(box(12.8, 1.15, 2.16, 0.1), move(0, 2.15, 0)), glass),
        (placed(box(13, 0.42, 2.3, 0.14), move(0, 2.86, 0)), cream),
    ]
    for z in (-1.1, 1.1):
        parts += [(placed(box(0.13, 1.3, 0.1, 0.02), move(x, 2.15, z)), cream) for x in np.linspace(-6.3, 6.3, 12)]
        parts.append((placed(box(13.02, 0.06, 0.06, 0.01), move(0, 1.42, z * 1.045)), steel))
    parts += [(placed(box(2.2, 0.3, 1.5, 0.06), move(x, 3.2, 0)), dark) for x in (-4, 0.5)]
    for z in (-0.5, 0.5):
        parts.append((tube([(3.2, 3.1, z), (4.3, 3.75, z * 0.8), (3.4, 4.62, z * 0.7)], 0.03, 6), dark))
    parts.append((tube([(3.4, 4.62, -0.8), (3.4, 4.64, 0.8)], 0.035, 6), steel))
    parts += [(placed(ball(0.14, 14), move(6.45, 1.1, z)), plain(rgb("fff1d0"), 0.1, 0.0, 6.0)) for z in (-0.75, 0.75)]
    return parts


def lamp_post(glow: float) -> Parts:
    """A street lamp 5 m high with a glass globe on a curved arm towards +x."""
    iron, light = plain(rgb("1d2226"), 0.4, 0.7), plain(rgb("ffd9a0"), 0.3, 0.0, glow)
    pole = lathe([(0, 0), (0.2, 0), (0.2, 0.12), (0.1, 0.3), (0.09, 1.0), (0.06, 1.1), (0.05, 4.4), (0, 4.45)], 16)
    t = np.linspace(0, np.pi, 12)
    arm = tube(np.stack([0.45 - 0.45 * np.cos(t), 4.4 + 0.45 * np.sin(t), 0 * t], axis=1), 0.035, 8)
    hood = placed(lathe([(0.26, 0), (0.22, 0.1), (0.1, 0.2), (0.04, 0.3), (0, 0.3)], 20), move(0.9, 4.15, 0))
    return [(join([pole, arm, hood]), iron), (placed(ball(0.17, 18), move(0.9, 4.08, 0)), light)]


def bench(wood: Material) -> Parts:
    """A slatted bench, 1.8 m along x, facing +z."""
    iron = plain(rgb("22262a"), 0.5, 0.6)
    slats = [placed(box(1.8, 0.035, 0.09, 0.01), move(0, 0.45, z)) for z in (-0.2, -0.09, 0.02, 0.13)]
    slats += [
        placed(box(1.8, 0.09, 0.03, 0.01), move(0, y, -0.27 - 0.1 * (y - 0.5)), turn("x", -0.15))
        for y in (0.58, 0.70, 0.82)
    ]
    legs = [tube([(x, 0, 0.15), (x, 0.42, 0.13), (x, 0.42, -0.22), (x, 0.9, -0.33)], 0.02, 6) for x in (-0.8, 0, 0.8)]
    legs += [tube([(x, 0, -0.3), (x, 0.42, -0.2)], 0.02, 6) for x in (-0.8, 0, 0.8)]
    return [(join(slats), wood), (join(legs), iron)]


def bottles(rng: Generator, length: float, count: int) -> Parts:
    """Jars, tins and bottles in a row along x from the origin."""
    parts: Parts = []
    for k in range(count):
        r, h = rng.uniform(0.035, 0.075), rng.uniform(0.12, 0.28)
        where = move((k + 0.5 + rng.uniform(-0.2, 0.2)) * length / count, 0, rng.uniform(-0.05, 0.05))
        if rng.random() < 0.5:
            shape = lathe([(0, 0), (r, 0), (r, h * 0.6), (r * 0.4, h * 0.8), (r * 0.4, h), (0, h)], 16, crease=50)
            tone = plain(rgb(str(rng.choice(["2f5a3a", "6a3a1c", "27476b", "d9e0dc"]))), 0.08)
        else:
            shape = join([cylinder(r, h, 18), placed(cylinder(r * 1.06, 0.02, 18), move(0, h, 0))])
            tone = plain(
                rgb(str(rng.choice(["c23b2a", "d8a83a", "e6e2d4", "3a6f8f", "8a8a86"]))),
                0.35,
                float(rng.random() < 0.4),
            )
        parts.append((placed(shape, where), tone))
    return parts
