"""Held-out scene: boats at a quay at sunset, waves, rigging, a turning beam. See docs/scenes.md."""

from dataclasses import replace

import numpy as np
from numpy import ndarray
from numpy.random import Generator

from framecast.render.finish import plain, rgb
from framecast.render.heldout_shapes import (
    bar,
    block,
    boat_hull,
    cord,
    hanging,
    pillar,
    pillow,
    sheet,
    stone,
)
from framecast.render.heldout_textures import cloth, concrete, decking, flagstones, painted_hull, veiled, water
from framecast.render.mesh import from_grid, join, placed, standing
from framecast.render.motion import aim, move, scale, turn, unit
from framecast.render.scene import Camera, Instance, Light, LightPose, Material, Mesh, Pose, Scene, Sky
from framecast.render.skies import dome, sun_travel

Parts = list[tuple[Mesh, Material]]


def harbor(seed: int) -> Scene:
    """Boats rock on a deforming sea at sunset: thin cordage, gulls cross fast, a lighthouse turns, an orbit."""
    rng = np.random.default_rng([seed, 11])
    paving, wall = flagstones(rng, rgb("a89c88")), concrete(rng, rgb("8f8b84"))
    planks = decking(rng, rgb("8a6a4a"))
    parts: Parts = [
        (placed(sheet(40, 12, 1, None, 2.4), move(0, 1.2, 12.0)), paving),
        (placed(block(40, 3, 0.5, 0.05, 3.0), move(0, -0.35, 5.9)), wall),
    ]
    parts += pier(planks, wall)
    parts += [
        (
            placed(
                stone(rng, rng.uniform(0.7, 1.7)),
                move(-19 + 1.25 * k + rng.uniform(-0.4, 0.4), rng.uniform(-0.3, 0.3), -25 + rng.uniform(-1.4, 1.4)),
                turn("y", k),
            ),
            wall,
        )
        for k in range(30)
    ]
    parts += lighthouse(rng, wall)
    instances = standing(parts)
    instances += sea(rng, 10)
    spots = (
        (-5.6, 0.9, 1.3, 7.5),
        (4.6, -0.6, 1.75, 8.5),
        (-1.4, -9.5, 0.7, 9.5),
        (11.0, -12.0, 2.4, 8.0),
        (-13.0, -8.0, 0.3, 8.0),
    )
    for k, (x, z, heading, long) in enumerate(spots):
        instances += boat(rng, x, z, heading + rng.uniform(-0.2, 0.2), long, 20 + k, planks)
    instances += gulls(rng, 40)
    low, west, side = rng.uniform(0.16, 0.3), rng.uniform(-0.7, 0.7), rng.choice([-1, 1])

    def sun(time: float) -> LightPose:
        return LightPose(np.zeros(3), sun_travel(low - 0.0006 * time, west + 0.001 * time))

    turning = rng.uniform(0.05, 0.08)

    def beam(time: float) -> LightPose:
        angle = turning * time + 1.0
        return LightPose(np.array([-8.0, 10.0, -25.0]), unit((np.sin(angle), -0.18, np.cos(angle))))

    def camera(time: float) -> ndarray:
        angle = side * (0.34 - 0.006 * time)
        return aim((12.0 * np.sin(angle), 3.0, -1 + 11.0 * np.cos(angle)), (-0.4, 1.9, -3.5))

    sky = dome(rgb("3f6cb4"), rgb("f0b98c"), rgb("8a7268"), -sun_travel(low, west), (3.8, 2.0, 0.9))
    return Scene(
        name="harbor",
        instances=tuple(instances),
        lights=(
            Light("sun", (1.0, 0.66, 0.38), 5.5, sun, radius=0.01),
            Light("spot", (1.0, 0.95, 0.8), 900.0, beam, radius=0.2, inner_cone=0.10, outer_cone=0.2, reach=60.0),
        ),
        camera=Camera(camera, np.radians(52)),
        sky=Sky(veiled(rng, sky, (0.85, 0.56, 0.46), 0.2)),
        exposure=lambda time: 0.85,
        haze=0.003,
        shadow_distance=45.0,
        split="test",
    )


def sea(rng: Generator, number: int) -> list[Instance]:
    """Water with travelling waves: each wave is a pair of shape keys, a sine and a cosine."""
    mesh = sheet(90, 90, 96, None, 5.0)
    mesh = placed(mesh, move(0, 0, -38.6), scale(1, 1, 1))
    p = mesh.positions.astype(np.float64)
    keys, slopes, rates = [], [], []
    for _ in range(3):
        way, length = rng.uniform(-0.8, 0.8), rng.uniform(2.6, 7.0)
        wave = 2 * np.pi / length * np.array([np.sin(way), np.cos(way)])
        phase = p[:, [0, 2]] @ wave
        tall = 0.016 * length
        for f, d in ((np.sin, np.cos), (np.cos, lambda a: -np.sin(a))):
            keys.append(np.column_stack([0 * phase, tall * f(phase), 0 * phase]))
            slopes.append(np.column_stack([-tall * wave[0] * d(phase), 0 * phase, -tall * wave[1] * d(phase)]))
        rates.append(np.sqrt(9.81 * 2 * np.pi / length) / 30)
    moving = replace(mesh, morphs=np.array(keys, np.float32), morph_normals=np.array(slopes, np.float32))

    def pose(time: float) -> Pose:
        return Pose(np.eye(4), morph_weights=np.array([f(rate * time) for rate in rates for f in (np.cos, np.sin)]))

    look = water(rng, rgb("16323a"))
    far = placed(sheet(900, 300, 1, None, 5.0), move(0, -0.02, -233))
    return [Instance(moving, look, number, pose, casts_shadow=False), Instance(far, look, casts_shadow=False)]


def pier(planks: Material, wall: Material) -> Parts:
    """A wooden jetty on piles with mooring posts and ropes."""
    parts: Parts = [(placed(block(2.4, 0.14, 9, 0.02, 1.6), move(0.4, 0.95, 1.6)), planks)]
    parts += [
        (placed(pillar([(-2, 0.15), (0.9, 0.14), (1.75, 0.13), (1.8, 0.09)], 14, 0.8), move(x, 0, z)), planks)
        for x in (-0.85, 1.65)
        for z in (-2.6, 0.4, 3.4)
    ]
    rope = plain(rgb("cdbb93"), 0.9)
    for x in (-0.85, 1.65):
        parts += [
            (hanging((x, 1.6, a), (x, 1.6, b), 0.28, 0.022), rope) for a, b in ((-2.6, 0.4), (0.4, 3.4), (3.4, 6.0))
        ]
    crate = plain(rgb("a8824f"), 0.8)
    for x, z, s in ((-4.4, 7.2, 0.8), (-5.2, 7.5, 0.6), (-4.4, 7.2, 0.55)):
        y = 1.2 + s / 2 + (0.8 if s == 0.55 else 0)
        parts += [
            (placed(block(s, 0.14 * s, s, 0.01), move(x, y + (j - 2) * 0.19 * s, z), turn("y", s)), crate)
            for j in range(5)
        ]
    parts += [
        (
            placed(pillar([(0, 0.16), (0.3, 0.13), (0.34, 0.2), (0.42, 0.2), (0.46, 0.1)], 18), move(x, 1.2, 6.5)),
            plain(rgb("2a2c2e"), 0.5, 0.6),
        )
        for x in (-6, -2.4, 4.0, 8.0)
    ]
    return parts


def lighthouse(rng: Generator, rock: Material) -> Parts:
    """A striped tower on the breakwater, lantern on top."""
    white, red = plain(rgb("ece7db"), 0.6), plain(rgb(str(rng.choice(["b03028", "27506e", "2c2c2e"]))), 0.5)
    place = move(-8, 0.6, -25)
    parts: Parts = [(placed(pillar([(-1.5, 3.2), (0.3, 2.7), (0.5, 1.9)], 24, 2.0), place), rock)]
    for k in range(5):
        low, high = 0.4 + 1.7 * k, 0.4 + 1.7 * (k + 1)
        parts.append(
            (
                placed(pillar([(low, 1.35 - 0.075 * low), (high, 1.35 - 0.075 * high)], 32), place),
                red if k % 2 else white,
            )
        )
    parts.append(
        (placed(pillar([(8.9, 0.7), (8.95, 1.15), (9.1, 1.15), (9.1, 0.6)], 32), place), plain(rgb("33363a"), 0.5, 0.5))
    )
    parts.append((placed(pillar([(9.1, 0.5), (10.0, 0.5)], 20), place), plain(rgb("fff0c8"), 0.2, 0.0, 7.0)))
    parts.append((placed(pillar([(10.0, 0.62), (10.4, 0.42), (10.7, 0.08), (11.2, 0.03)], 20), place), red))
    rail = np.array([(1.1 * np.cos(a), 9.5, 1.1 * np.sin(a)) for a in np.linspace(0, 2 * np.pi, 29)])
    parts.append(
        (
            placed(
                join(
                    [cord(rail, 0.02)]
                    + [cord(np.array([p - (0, 0.42, 0), p - (0, 0.2, 0), p]), 0.012, 4) for p in rail[:-1:2]]
                ),
                place,
            ),
            plain(rgb("33363a"), 0.5, 0.5),
        )
    )
    return parts


def boat(
    rng: Generator, x: float, z: float, heading: float, long: float, number: int, planks: Material
) -> list[Instance]:
    """A sailing boat with cabin, mast, boom, shrouds and a pennant that flutters (shape keys); all of it one object."""
    wide, tall = long * 0.31, long * rng.uniform(1.15, 1.35)
    paint = painted_hull(rng, rgb(str(rng.choice(["2d5a7a", "a33a2c", "e3ddcf", "2f6a56", "d0a038"]))))
    trim, canvas = (
        plain(rgb("e9e2d2"), 0.5),
        cloth(rng, rgb("e8dcc2"), rgb(str(rng.choice(["b5502f", "38597a", "e8dcc2"]))), 3),
    )
    metal, wood = plain(rgb("c9ccce"), 0.3, 1.0), plain(rgb("9a6b3c"), 0.4)
    top = 0.35 * long * 0.3
    deck = placed(sheet(long * 0.72, wide * 0.72, 1, None, 1.2), move(-0.06 * long, 0.28 * top, 0))
    cabin = [
        placed(pillow(long * 0.15, 0.42, wide * 0.26, 0.35), move(0.02 * long, top * 0.5, 0)),
        placed(block(long * 0.34, 0.06, wide * 0.6, 0.02), move(0.02 * long, top * 0.5 + 0.44, 0)),
    ]
    glass = [placed(pillow(long * 0.10, 0.16, wide * 0.265, 0.3, 16), move(0.02 * long, top * 0.5 + 0.2, 0))]
    mast = pillar([(0.2, 0.075), (tall * 0.6, 0.06), (tall, 0.035)], 10)
    spars = [
        placed(mast, move(0.14 * long, 0, 0)),
        bar([(0.14 * long, 1.5, 0), (-0.1 * long, 1.53, 0), (-0.34 * long, 1.56, 0)], 0.09, 0.09),
    ]
    peak = np.array([0.14 * long, tall * 0.97, 0])
    ends = [
        (0.5 * long, top, 0),
        (-0.47 * long, top * 0.9, 0),
        (0.1 * long, top * 0.8, wide * 0.46),
        (0.1 * long, top * 0.8, -wide * 0.46),
    ]
    lines = [cord(np.array([peak, (peak + e) / 2, e]), 0.012, 4) for e in ends]
    lines += [
        cord(
            np.array(
                [
                    (0.14 * long, tall * 0.6, 0),
                    (0.12 * long, tall * 0.35, s * wide * 0.24),
                    (0.1 * long, top * 0.8, s * wide * 0.46),
                ]
            ),
            0.010,
            4,
        )
        for s in (-1, 1)
    ]
    rails = [
        cord(
            np.array(
                [
                    (t * long, top + 0.42 + 0.3 * t * t, s * wide * 0.47 * np.cos(2.2 * t))
                    for t in np.linspace(-0.42, 0.38, 9)
                ]
            ),
            0.011,
            4,
        )
        for s in (-1, 1)
    ]
    posts = [
        cord(
            np.array(
                [(t * long, y, s * wide * 0.47 * np.cos(2.2 * t)) for y in (0.5 * top, top, top + 0.42 + 0.3 * t * t)]
            ),
            0.012,
            4,
        )
        for s in (-1, 1)
        for t in np.linspace(-0.42, 0.38, 7)
    ]
    furled = placed(pillow(long * 0.22, 0.13, 0.13, 0.9), move(-0.1 * long, 1.70, 0))
    phase, sway, bob = rng.uniform(0, 6, 3), rng.uniform(0.03, 0.055), rng.uniform(0.05, 0.1)

    def place(time: float) -> ndarray:
        heave = bob * np.sin(0.07 * time + phase[0])
        return (
            move(x, heave, z)
            @ turn("y", heading)
            @ turn("x", sway * np.sin(0.083 * time + phase[1]))
            @ turn("z", 0.5 * sway * np.sin(0.061 * time + phase[2]))
        )

    pieces: Parts = [
        (boat_hull(long, wide, top * 1.9), paint),
        (deck, planks),
        (join(cabin), trim),
        (join(glass), plain(rgb("10181c"), 0.06)),
        (join(spars), wood),
        (join(lines + rails + posts), metal),
        (furled, canvas),
    ]
    instances = [Instance(mesh, material, number, lambda time: Pose(place(time))) for mesh, material in pieces]
    flag = pennant(1.3, 0.4)
    shift = move(*peak)

    def flutter(time: float) -> Pose:
        return Pose(
            place(time) @ shift, morph_weights=np.array([np.sin(0.5 * time + phase[0]), np.cos(0.5 * time + phase[0])])
        )

    return [*instances, Instance(flag, canvas, number, flutter)]


def pennant(long: float, tall: float) -> Mesh:
    """A tapering flag from the origin along -x with two shape keys of a running wave."""
    u, v = np.meshgrid(np.linspace(0, 1, 22), np.linspace(-0.5, 0.5, 5))
    mesh = from_grid(
        np.stack([-u * long, v * tall * (1 - 0.8 * u), 0 * u], axis=-1)[:, ::-1],
        np.stack([u, v + 0.5], axis=-1)[:, ::-1],
        80,
    )
    s = mesh.uvs[:, :1]
    keys = [np.concatenate([0 * s, 0.05 * s * f(6 * s), 0.22 * s * f(9 * s)], axis=1) for f in (np.cos, np.sin)]
    return replace(mesh, morphs=np.array(keys, np.float32))


def gulls(rng: Generator, number: int) -> list[Instance]:
    """Gulls that beat their wings (shape keys) and cross the view fast."""
    body = pillow(0.22, 0.06, 0.06, 1.0, 14)
    u, v = np.meshgrid(np.linspace(-1, 1, 17), np.linspace(0, 1, 5))
    wing = from_grid(
        np.stack([0.1 - 0.2 * v - 0.16 * np.abs(u) ** 1.5 + 0.05 * v * np.abs(u), 0.02 + 0 * u, u * 0.62], axis=-1),
        np.stack([u, v], axis=-1),
        80,
    )
    mesh = join(
        [body, wing, replace(wing, indices=wing.indices.reshape(-1, 3)[:, ::-1].reshape(-1), normals=-wing.normals)]
    )
    z = np.abs(mesh.positions[:, 2:]).astype(np.float64)
    keys = np.stack(
        [np.concatenate([0 * z, 0.75 * z, -0.1 * z], axis=1), np.concatenate([0 * z, 0.9 * z**2, 0 * z], axis=1)]
    )
    moving = replace(mesh, morphs=keys.astype(np.float32))
    instances = []
    for k in range(6):
        start, way, beat = rng.uniform((-14, 2.6, -14), (14, 6.5, 3)), rng.uniform(0, 2 * np.pi), rng.uniform(0.55, 0.8)
        speed = rng.uniform(0.14, 0.26)

        def pose(
            time: float, start: ndarray = start, way: float = way, beat: float = beat, speed: float = speed
        ) -> Pose:
            gone = ((speed * time + 14) % 40) - 20
            place = (
                move(*start)
                @ turn("y", way)
                @ move(gone, 0.25 * np.sin(beat * time), 0)
                @ turn("x", 0.2 * np.sin(0.1 * time + way))
            )
            return Pose(place, morph_weights=np.array([np.sin(beat * time), 0.5 * np.sin(beat * time - 0.9)]))

        instances.append(Instance(moving, plain(rgb("e9e8e4"), 0.8), number + k, pose))
    return instances
