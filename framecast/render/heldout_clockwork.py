"""Held-out scene: a clockwork seen close. See docs/scenes.md."""

from dataclasses import replace

import numpy as np
from numpy import ndarray
from numpy.random import Generator

from framecast.render.finish import plain, rgb
from framecast.render.heldout_shapes import (
    bar,
    block,
    disc_outline,
    gear,
    pillar,
    prism,
)
from framecast.render.heldout_textures import (
    dial,
    figured_wood,
    panels,
    spun_metal,
)
from framecast.render.mesh import join, placed, standing
from framecast.render.motion import aim, move, turn, unit
from framecast.render.scene import Camera, Instance, Light, LightPose, Material, Mesh, Pose, Scene, Sky
from framecast.render.skies import room

Parts = list[tuple[Mesh, Material]]


def clockwork(seed: int) -> Scene:
    """Meshing wheels, a pendulum and a dial seen close, lit by a lamp that moves; two cuts."""
    rng = np.random.default_rng([seed, 13])
    brass, copper, steel = (spun_metal(rng, rgb(c)) for c in ("e0b458", "d08a5a", "c9ccd0"))
    wood = figured_wood(rng, rgb(["7a4a2c", "5d3a28", "8a5c34"][seed % 3]))
    plate = panels(rng, rgb("8d7a55"))
    parts: Parts = [(placed(block(2.4, 1.5, 0.04, 0.01, 0.9), move(0, 0, -0.16)), plate)]
    parts += [(placed(block(2.6, 0.09, 0.7, 0.02, 1.3), move(0, s * 0.78, 0.1)), wood) for s in (-1, 1)] + [
        (placed(block(0.09, 1.6, 0.7, 0.02, 1.3), move(s * 1.25, 0, 0.1)), wood) for s in (-1, 1)
    ]
    parts += [
        (
            placed(
                pillar([(0, 0.028), (0.02, 0.018), (0.34, 0.018), (0.36, 0.028)], 16),
                move(x, y, -0.14),
                turn("x", np.pi / 2),
            ),
            steel,
        )
        for x, y in ((-1.05, 0.6), (1.05, 0.6), (-1.05, -0.6), (1.05, -0.6), (0.1, 0.62))
    ]
    parts += [
        (placed(prism(disc_outline(0.022, 6), 0.02, 0.003), move(x, y, 0.2)), plain(rgb("3f64a8"), 0.2, 1.0))
        for x, y in ((-1.05, 0.6), (1.05, 0.6), (-1.05, -0.6), (1.05, -0.6))
    ]
    disc = prism(disc_outline(0.285, 64), 0.004)
    disc = replace(disc, uvs=(disc.positions[:, :2] / (0.57, -0.57) + 0.5).astype(np.float32))
    face = Instance(placed(disc, move(0.72, 0.28, 0.2)), dial(rng, rgb("f3ecda"), rgb("1c1a2e")))
    ring = prism(disc_outline(0.30, 64), 0.03, 0.008)
    parts.append((placed(ring, move(0.72, 0.28, 0.172)), brass))
    instances = [*standing(parts), face, *train(rng, (brass, copper, steel)), *hands(rng), *pendulum(rng, brass, wood)]
    drift = rng.choice([-1.0, 1.0])

    def lamp(time: float) -> LightPose:
        where = np.array([0.9 * np.sin(0.045 * time + 1.0) * drift, 0.75, 1.25])
        return LightPose(where, unit(np.array([-0.1, 0, 0]) - where))

    def camera(time: float) -> ndarray:
        if 24 <= time < 44:
            return aim((0.72 + 0.004 * (time - 24) * drift, 0.18, 1.0), (0.70, 0.22, 0))
        angle = drift * (0.30 - 0.006 * time)
        return aim((1.75 * np.sin(angle) - 0.1, 0.12 + 0.001 * time, 1.75 * np.cos(angle)), (-0.08, 0.0, 0))

    light = room(
        (0.5, 0.42, 0.34),
        (0.16, 0.14, 0.13),
        (0.06, 0.05, 0.05),
        (((0.6, 0.8, 1.0), 0.97, 7.0), ((-1.0, 0.3, 0.5), 0.985, 10.0), ((0.1, -0.2, 1.0), 0.995, 5.0)),
    )
    return Scene(
        name="clockwork",
        instances=tuple(instances),
        lights=(
            Light("spot", (1.0, 0.84, 0.62), 7.0, lamp, radius=0.03, inner_cone=0.5, outer_cone=0.9, reach=6.0),
            Light(
                "point",
                (0.5, 0.65, 1.0),
                0.8,
                lambda time: LightPose(np.array([-1.0, 0.4, 1.1]), np.array([0.0, -1, 0])),
                casts_shadow=False,
                reach=5.0,
            ),
        ),
        camera=Camera(camera, np.radians(40), near=0.02),
        sky=Sky(light, sun_disc=False),
        cuts=frozenset({24, 44}),
        occlusion_radius=0.06,
        split="test",
    )


def train(rng: Generator, metals: tuple[Material, ...]) -> list[Instance]:
    """Meshing gears: neighbours turn against each other at the ratio of their teeth, in three layers."""
    instances = []
    x, y, depth, angle, rate, before = -0.86, 0.18, 0.0, 0.0, rng.uniform(0.03, 0.05), None
    turns = (0.0, -0.55, 0.75, -0.9, 0.35, -0.5, 1.9, 2.6)
    for k, teeth in enumerate((44, 20, 36, 16, 30, 24, 40, 18)):
        radius = teeth * 0.0062
        if before is not None:
            far = radius + before[0] * 0.0062
            way = turns[k] + rng.uniform(-0.08, 0.08)
            x, y = x + far * np.cos(way), y + far * np.sin(way)
            rate = -rate * before[0] / teeth
            angle = way + np.pi - (angle - way) * -before[0] / teeth * -1 + np.pi / teeth
            depth = 0.05 * (k % 2) - 0.05
        place = move(x, y, depth)
        spin, begin = rate, angle

        def pose(time: float, place: ndarray = place, spin: float = spin, begin: float = begin) -> Pose:
            return Pose(place @ turn("z", begin + spin * time))

        instances.append(Instance(gear(teeth, radius, 0.045, 4 + k % 3), metals[k % 3], 10 + k, pose))
        before = (teeth, radius)
    return instances


def hands(rng: Generator) -> list[Instance]:
    """Hour, minute and a fast second hand over the dial."""
    blue, red = plain(rgb("2a3f86"), 0.2, 1.0), plain(rgb("b0281e"), 0.35)
    start = rng.uniform(0, 6, 3)
    instances = []
    for k, (long, wide, rate, look) in enumerate(
        ((0.14, 0.022, 0.001, blue), (0.21, 0.015, 0.006, blue), (0.25, 0.006, 0.105, red))
    ):
        shape = prism(
            np.array(
                [(-wide * 0.4, -0.05), (wide * 0.4, -0.05), (wide / 2, long * 0.6), (0, long), (-wide / 2, long * 0.6)]
            ),
            0.006,
            0.001,
        )
        place = move(0.72, 0.28, 0.212 + 0.009 * k)

        def pose(time: float, place: ndarray = place, rate: float = rate, begin: float = float(start[k])) -> Pose:
            return Pose(place @ turn("z", -begin - rate * time))

        instances.append(Instance(shape, look, 30 + k, pose))
    return instances


def pendulum(rng: Generator, metal: Material, wood: Material) -> list[Instance]:
    """A pendulum swinging before the wheels, hiding and showing them."""
    bob = placed(join([prism(disc_outline(0.13, 48), 0.05, 0.012)]), move(0, -0.92, 0))
    bob = Mesh(bob.positions, bob.normals, (bob.positions[:, :2] * 3.4 + (0.5, 3.628)).astype(np.float32), bob.indices)
    rod = bar([(0, 0, 0.02), (0, -0.45, 0.02), (0, -0.9, 0.02)], 0.03, 0.012)
    phase, swing = rng.uniform(0, 6), rng.uniform(0.26, 0.36)

    def pose(time: float) -> Pose:
        return Pose(move(-0.12, 0.66, 0.26) @ turn("z", swing * np.sin(0.13 * time + phase)))

    return [Instance(bob, metal, 40, pose), Instance(rod, wood, 40, pose)]
