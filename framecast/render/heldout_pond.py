"""Held-out scene: a garden with a mirroring pond. See docs/scenes.md."""

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from numpy.random import Generator

from framecast.render.finish import plain, rgb
from framecast.render.heldout_greenhouse import rustle
from framecast.render.heldout_shapes import (
    bar,
    block,
    cloud_crown,
    cord,
    disc_outline,
    loft,
    pillar,
    pillow,
    prism,
    propeller,
    sheet,
    stem,
    stone,
    swept_roof,
)
from framecast.render.heldout_textures import (
    concrete,
    decking,
    figured_wood,
    gravel,
    scales,
    star_leaves,
    veiled,
)
from framecast.render.mesh import join, placed, standing
from framecast.render.motion import aim, handheld, move, scale, turn
from framecast.render.scene import Camera, Instance, Light, LightPose, Material, Mesh, Mirror, Pose, Scene, Sky
from framecast.render.skies import dome, sun_travel

Parts = list[tuple[Mesh, Material]]


def pond(seed: int) -> Scene:
    """A garden round still water: a bridge, lanterns, star-leaved trees, carp streamers, a hand-held camera."""
    rng = np.random.default_rng([seed, 15])
    autumn = [("c8402a", "d8702c"), ("5d8a3c", "88a83c"), ("d89a2c", "b8502a")][seed % 3]
    edge = rng.uniform(0, 6, 3)

    def shore(angle: Any) -> Any:
        return (
            5.2
            + 0.7 * np.sin(2 * angle + edge[0])
            + 0.4 * np.sin(3 * angle + edge[1])
            + 0.2 * np.sin(5 * angle + edge[2])
        )

    def ground(x: Any, z: Any) -> Any:
        away = np.hypot(x, z + 3) - shore(np.arctan2(z + 3, x))
        return (
            np.clip(0.35 * np.tanh(away * 1.2), -0.5, 0.4)
            + 0.05 * np.clip(away - 4, 0, None) ** 1.4 * 0.6
            + 0.05 * np.sin(1.3 * x) * np.sin(1.1 * z)
        )

    moss = gravel(rng, rgb("647a3c"))
    water = Instance(placed(sheet(16, 16, 1), move(0, 0, -3)), plain(rgb("0f1c1a"), 0.04), mirror=0)
    parts: Parts = [(placed(sheet(60, 60, 110, lambda x, z: ground(x, z - 3), 0.7), move(0, 0, -3)), moss)]
    red = plain(rgb(str(rng.choice(["b5301f", "a83a24", "8a2a24"]))), 0.4)
    parts += footbridge(red, decking(rng, rgb("9a7a55"), 8))
    parts += pavilion(rng, red)
    rock = concrete(rng, rgb("8d8f8a"))
    for k in range(26):
        a = rng.uniform(0, 2 * np.pi)
        r = float(shore(a)) + rng.uniform(-0.25, 0.3)
        parts.append(
            (
                placed(stone(rng, rng.uniform(0.2, 0.6)), move(r * np.cos(a), 0.05, r * np.sin(a) - 3), turn("y", k)),
                rock,
            )
        )
    instances = [*standing(parts), water]
    instances += maples(rng, ground, autumn, 10)
    instances += lanterns(rng, 40)
    instances += streamers(rng, move(4.9, 0.3, -3.4), 50)
    instances += lilies(rng, 60)
    rise, west = rng.uniform(0.5, 0.75), rng.choice([-1, 1]) * rng.uniform(0.8, 1.3)
    travel = sun_travel(rise, west)
    sky = veiled(
        rng, dome(rgb("4f86cc"), rgb("d9e0e4"), rgb("50583c"), -travel, (1.8, 1.5, 1.1)), (1.0, 0.98, 0.95), 0.55
    )
    drift = rng.choice([-1.0, 1.0])

    def camera(time: float) -> ndarray:
        eye = np.array([drift * (1.6 - 0.030 * time), 1.55, 5.9])
        return handheld(aim(eye, (0.15 * eye[0], 1.15, -3.0)), seed, time, 0.006, 0.006)

    return Scene(
        name="pond",
        instances=tuple(instances),
        lights=(Light("sun", (1.0, 0.90, 0.74), 5.5, lambda time: LightPose(np.zeros(3), travel), radius=0.01),),
        camera=Camera(camera, np.radians(55)),
        sky=Sky(sky),
        mirrors=(Mirror(np.zeros(3), np.array([0.0, 1.0, 0.0])),),
        haze=0.006,
        shadow_distance=34.0,
        split="test",
    )


def footbridge(paint: Material, planks: Material) -> Parts:
    """An arched bridge across the pond along x, with railings."""
    t = np.linspace(-1, 1, 25)
    curve = np.stack([5.6 * t, 0.55 + 1.05 * (1 - t**2), np.full(25, -4.2)], axis=1)
    parts: Parts = []
    for s in (-0.75, 0.75):
        line = curve + np.array([0, 0, s])
        parts += [
            (bar(line - (0, 0.12, 0), 0.14, 0.22), paint),
            (bar(line + np.array([0, 0.85, 0]), 0.09, 0.08), paint),
            (bar(line + np.array([0, 0.5, 0]), 0.05, 0.05), paint),
        ]
        parts += [
            (bar([p - (0, 0.1, 0), p + np.array([0, 0.45, 0]), p + np.array([0, 0.98, 0])], 0.10, 0.10), paint)
            for p in line[::3]
        ]
    for a, b in pairwise(curve):
        lean = np.arctan2(b[1] - a[1], b[0] - a[0])
        parts.append((placed(block(0.45, 0.05, 1.5, 0.012, 0.8), move(*((a + b) / 2)), turn("z", lean)), planks))
    return parts


def pavilion(rng: Generator, paint: Material) -> Parts:
    """A small open house with two swept roofs behind the pond."""
    tiles, wall = decking(rng, rgb(str(rng.choice(["44525a", "3f5a50", "5a4a48"]))), 14), concrete(rng, rgb("e2d8c4"))
    place = move(-1.6, 0.7, -12.2) @ turn("y", 0.25)
    parts: Parts = [(block(6.0, 0.5, 5.0, 0.05, 1.5), wall)]
    parts += [
        (placed(pillar([(0.2, 0.17), (0.3, 0.13), (3.1, 0.12), (3.2, 0.16)], 18), move(x, 0, z)), paint)
        for x in (-2.4, -0.8, 0.8, 2.4)
        for z in (-1.9, 1.9)
    ]
    parts += [(placed(block(5.4, 0.2, 0.16, 0.02), move(0, y, z)), paint) for y in (3.1, 2.7) for z in (-1.9, 1.9)] + [
        (placed(block(0.16, 0.2, 4.2, 0.02), move(x, 3.1, 0)), paint) for x in (-2.4, 2.4)
    ]
    parts += [
        (placed(block(4.4, 2.4, 0.12, 0.01, 1.5), move(0, 1.5, -1.7)), wall),
        (placed(swept_roof(7.4, 6.2, 1.5, 0.55), move(0, 3.2, 0)), tiles),
    ]
    parts += [
        (placed(block(3.0, 0.9, 2.4, 0.02, 1.5), move(0, 4.7, 0)), wall),
        (placed(swept_roof(4.8, 4.0, 1.3, 0.45), move(0, 5.1, 0)), tiles),
    ]
    parts += [
        (
            placed(pillar([(0, 0.2), (0.1, 0.22), (0.3, 0.08), (0.5, 0.12), (0.8, 0.02)], 16), move(0, 6.3, 0)),
            plain(rgb("d8b04a"), 0.3, 1.0),
        )
    ]
    parts += [(placed(bar([(x, 0.85, -1.9), (x, 0.85, 0), (x, 0.85, 1.9)], 0.06, 0.06)), paint) for x in (-2.4, 2.4)]
    return [(placed(mesh, place), material) for mesh, material in parts]


def maples(rng: Generator, ground: Callable[[Any, Any], Any], colours: tuple[str, str], number: int) -> list[Instance]:
    """Trees of layered star-leaved clouds; the clouds rock, the trunks stand."""
    leaf = [star_leaves(rng, rgb(c)) for c in colours]
    clouds = [cloud_crown(rng, rng.normal(0, 1, (5, 3)) * (0.8, 0.3, 0.8), 0.75, 46, 0.30) for _ in range(3)]
    bark = figured_wood(rng, rgb("6a5a4a"), 0.85)
    trunks, instances = [], []
    spots = [
        (-6.6, -2.0),
        (6.4, -4.5),
        (-5.0, -8.6),
        (4.6, -9.5),
        (-8.5, -6.0),
        (9.0, -8.0),
        (1.5, -16.0),
        (-9.0, -13.0),
        (-13.0, -10.0),
        (12.5, -12.0),
        (-4.5, -18.0),
        (5.0, -19.0),
        (11.0, -19.0),
        (-12.0, -18.5),
        (0.0, -21.0),
        (7.0, -15.0),
        (-5.6, 2.0),
    ]
    for k, (x, z) in enumerate(spots):
        x, z = x + rng.uniform(-0.5, 0.5), z + rng.uniform(-0.5, 0.5)
        place = move(x, float(ground(x, z)) - 0.1, z)
        tall = rng.uniform(2.0, 3.2)
        trunk, top = stem(rng, tall, 0.16, rng.uniform(0.2, 0.7))
        trunks.append(placed(trunk, place))
        for j in range(3):
            offset = top + rng.normal(0, 1, 3) * (0.9, 0.3, 0.9) + (0, 0.25 * j, 0)
            trunks.append(
                placed(cord(np.array([top * 0.7, (top * 0.75 + offset) / 2 - (0, 0.1, 0), offset]), 0.045), place)
            )
            here, phase = place @ move(*offset) @ turn("y", rng.uniform(0, 6)), rng.uniform(0, 6)

            def pose(time: float, here: ndarray = here, phase: float = phase) -> Pose:
                return Pose(here @ rustle(time, phase, 0.025))

            instances.append(Instance(clouds[(k + j) % 3], leaf[k % 2], number + k, pose))
    return [Instance(join(trunks), bark), *instances]


def lanterns(rng: Generator, number: int) -> list[Instance]:
    """Paper lanterns glowing under the pavilion's eaves, swinging."""
    body = pillar([(-0.26, 0.10), (-0.22, 0.16), (-0.1, 0.20), (0.1, 0.20), (0.22, 0.16), (0.26, 0.10)], 20, crease=80)
    caps = join(
        [
            pillar([(0.26, 0.11), (0.30, 0.11)], 16),
            pillar([(-0.30, 0.11), (-0.26, 0.11)], 16),
            cord(np.array([(0, 0.3, 0), (0, 0.45, 0), (0, 0.6, 0)]), 0.01, 4),
            cord(np.array([(0, -0.3, 0), (0, -0.45, 0), (0, -0.55, 0)]), 0.02, 5),
        ]
    )
    paper, black = plain(rgb("ff7a3a"), 0.8, 0.0, 2.2), plain(rgb("1c1a18"), 0.6)
    base = move(-1.6, 0.7, -12.2) @ turn("y", 0.25)
    instances = []
    for k, x in enumerate((-3.0, -1.6, 0.0, 1.6, 3.0)):
        phase = rng.uniform(0, 6)

        def pose(time: float, x: float = x, phase: float = phase) -> Pose:
            return Pose(base @ move(x, 3.3, 2.6) @ rustle(time, phase, 0.12) @ move(0, -0.6, 0))

        instances += [Instance(body, paper, number + k, pose), Instance(caps, black, number + k, pose)]
    return instances


def streamers(rng: Generator, place: Float[ndarray, "4 4"], number: int) -> list[Instance]:
    """Carp streamers on a bamboo pole:
    hollow cloth fish, skinned to a chain of eight joints that writhes in the wind.
    """
    pole = pillar([(0, 0.06), (3.0, 0.045), (5.6, 0.03)], 10)
    wheel = placed(propeller(0.3, 6, 0.09), move(0, 5.6, 0.05))
    spin = rng.uniform(0.5, 0.9)
    instances = [
        Instance(placed(pole, place), plain(rgb("a89a5a"), 0.5)),
        Instance(
            wheel_at(wheel),
            plain(rgb("d8b04a"), 0.3, 0.8),
            number,
            lambda time: Pose(place @ move(0, 5.6, 0.05) @ turn("z", spin * time)),
        ),
    ]
    colours = ("2b2f3a", "c23a2a", "2f6a9a", "4a8a4a")
    for k in range(3):
        long = 2.3 - 0.35 * k
        fish = carp(long)
        look = scales(rng, rgb(colours[(k + int(rng.integers(2))) % 4]), rgb("f4ecd8"))
        phase, rate = rng.uniform(0, 6), rng.uniform(0.20, 0.28)

        def pose(time: float, k: int = k, long: float = long, phase: float = phase, rate: float = rate) -> Pose:
            root = place @ move(-0.1, 4.95 - 0.95 * k, 0) @ turn("y", np.pi + 0.25 * np.sin(0.05 * time + k))
            return Pose(np.eye(4), joints=root @ chain(time, long, phase, rate))

        instances.append(Instance(fish, look, number + 1 + k, pose))
    return instances


def wheel_at(mesh: Mesh) -> Mesh:
    """The pin wheel around its own axle."""
    return placed(mesh, move(0, -5.6, -0.05))


def carp(long: float) -> Mesh:
    """A hollow fish along +x from its mouth at the origin, bound to eight joints along it; seen from both sides."""
    t = np.linspace(0, 1, 26)
    wide = 0.16 * long * (0.55 + 0.9 * t) * (t < 0.12) + 0.16 * long * np.where(
        t >= 0.12, 0.42 + 0.4 * np.cos(2.2 * (t - 0.2)), 0
    )
    wide = np.where(t > 0.86, wide + 0.07 * long * (t - 0.86) / 0.14, wide)
    flat = disc_outline(1.0, 18)
    rings = np.stack(
        [
            np.column_stack(
                [
                    np.full(18, long * s),
                    flat[:, 1] * r * (1.0 if s < 0.86 else 1.5),
                    flat[:, 0] * r * (0.75 if s < 0.86 else 0.3),
                ]
            )
            for s, r in zip(t, wide, strict=True)
        ]
    )
    mesh = loft(rings[:, ::-1], crease=80, caps=False)
    s = np.clip(mesh.positions[:, 0] / long, 0, 1)
    around = np.arctan2(mesh.positions[:, 2], mesh.positions[:, 1]) / (2 * np.pi) + 0.5
    uvs = np.stack([around, s], axis=1).astype(np.float32)
    where = np.clip(s * 7, 0, 6.999)
    first = where.astype(np.int64)
    joints, weights = np.zeros((len(s), 4), np.uint16), np.zeros((len(s), 4), np.float32)
    joints[:, 0], joints[:, 1] = first, first + 1
    weights[:, 0], weights[:, 1] = 1 - (where - first), where - first
    return replace(mesh, uvs=uvs, joints=joints, weights=weights)


def chain(time: float, long: float, phase: float, rate: float) -> Float[ndarray, "8 4 4"]:
    """Joint matrices (pose @ inverse rest) of a chain along +x that waves sideways and droops,
    more towards the tail.
    """
    world, joints = np.eye(4), []
    for k in range(8):
        bend = 0.10 + 0.035 * k
        local = turn("y", bend * np.sin(rate * time - 0.8 * k + phase)) @ turn(
            "z", -0.05 + 0.05 * np.sin(0.6 * rate * time - 0.5 * k)
        )
        world = world @ (move(long / 7, 0, 0) if k else np.eye(4)) @ local
        joints.append(world @ move(-long * k / 7, 0, 0))
    return np.stack(joints)


def lilies(rng: Generator, number: int) -> list[Instance]:
    """Lily pads that drift a little on the water, some in flower."""
    angle = np.linspace(0.25, 2 * np.pi - 0.25, 20)
    pad = prism(np.concatenate([[(0.02, 0)], np.stack([np.cos(angle), np.sin(angle)], axis=1)]) * 0.24, 0.012, 0.004)
    pad = placed(pad, turn("x", -np.pi / 2))
    flower = join(
        [
            placed(pillow(0.025, 0.08, 0.012, 1.0, 10), turn("y", k * 0.79), move(0, 0.06, 0.04), turn("x", 0.7))
            for k in range(8)
        ]
    )
    green, pink = plain(rgb("4a7a3a"), 0.45), plain(rgb(str(rng.choice(["e8a0b8", "f2e6ee", "e8d070"]))), 0.6)
    instances = []
    for k in range(24):
        x, z, s, phase = rng.uniform((-3.8, -5.5, 0.7, 0), (3.8, 0.2, 1.35, 6))

        def pose(time: float, x: float = x, z: float = z, s: float = s, phase: float = phase) -> Pose:
            return Pose(
                move(x + 0.03 * np.sin(0.03 * time + phase), 0.012, z + 0.03 * np.cos(0.025 * time + phase))
                @ turn("y", phase + 0.05 * np.sin(0.04 * time))
                @ scale(s)
            )

        instances.append(Instance(pad, green, number + k, pose))
        if k % 5 == 0:
            instances.append(Instance(flower, pink, number + k, pose))
    return instances
