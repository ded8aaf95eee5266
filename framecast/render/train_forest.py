"""Training scene: a walk through a sunlit wood, everything alpha-tested and moving. See docs/scenes.md."""

from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from numpy.random import Generator

from framecast.render.finish import plain, rgb
from framecast.render.mesh import join, placed
from framecast.render.motion import aim, handheld, move, scale, turn
from framecast.render.scene import Camera, Instance, Light, LightPose, Mesh, Pose, Scene, Sky
from framecast.render.skies import dome, sun_travel
from framecast.render.train_plants import branches, fern, grass, leaf_cards, swaying, wind
from framecast.render.train_shapes import ball, terrain, tube
from framecast.render.train_textures import bark, clouds_over, frond, leaf_cluster, leaf_litter, plaster

Ground = Callable[[Any, Any], Any]
"""Height of the ground at x, z: numbers or arrays."""
Path = Callable[[Any], Any]
"""The x of the path's middle at z."""


def forest(seed: int) -> Scene:
    """A path through a wood: swaying crowns, ferns, grass, falling leaves, light through leaves, a hand-held walk."""
    rng = np.random.default_rng([seed, 6])
    ridges = rng.uniform(0, 6, 4)
    season = rgb([("5d7f33"), ("b5762a"), ("7f9440"), ("4f7a3c")][seed % 4])

    def height(x: Any, z: Any) -> Any:
        bumps = (
            0.35 * np.sin(0.35 * x + ridges[0])
            + 0.3 * np.sin(0.31 * z + 0.2 * x + ridges[1])
            + 0.07 * np.sin(1.7 * x + ridges[2]) * np.sin(1.3 * z + ridges[3])
        )
        away = np.clip((np.abs(x - bend(z)) - 0.9) / 2.5, 0, 1)
        far = np.clip(np.abs(x) - 7, 0, None) ** 2 * 0.03 + np.clip(-z - 22, 0, None) ** 2 * 0.02
        return bumps * away + 0.9 * away**2 - 0.05 + far

    def bend(z: Any) -> Any:
        return 0.9 * np.sin(0.22 * z + ridges[2]) - 0.9 * np.sin(ridges[2])

    floor = terrain((-24, 24), (-42, 8), (80, 90), height, 2.2)
    instances = [Instance(floor, leaf_litter(rng, season * 0.8))]
    instances += trees(rng, height, bend, season)
    instances += undergrowth(rng, height, bend, season)
    instances += falling_leaves(rng, season)
    log = tube([(-0.6, 0, 0), (1.2, 0.04, 0.1), (3.2, 0, 0)], [0.26, 0.24, 0.2], 16, 0.7)
    instances.append(
        Instance(placed(log, move(float(bend(-7.0)) + 1.5, 0.28, -7.2), turn("y", 0.5)), bark(rng, rgb("6f6250")))
    )
    stones = [
        placed(
            ball(1.0, 20, 0.5),
            move(x, float(height(x, z)), z),
            turn("y", x),
            scale(r, 0.6 * r, 0.8 * r),
        )
        for x, z, r in zip(rng.uniform(-5, 5, 14), rng.uniform(-20, 1, 14), rng.uniform(0.15, 0.5, 14), strict=True)
    ]
    instances.append(Instance(join(stones), plaster(rng, rgb("8f8f86"), 1.0)))
    travel = sun_travel(rng.uniform(0.55, 0.8), rng.choice([-1, 1]) * rng.uniform(0.5, 0.9))
    sky = clouds_over(rng, dome(rgb("7fa6cf"), rgb("dfe6dc"), rgb("4a4c38"), -travel, (2.0, 1.7, 1.2)), 0.4)

    def camera(time: float) -> ndarray:
        z = 4.0 - 0.037 * time
        eye = np.array([float(bend(z)), 1.62 + 0.03 * np.sin(0.42 * time), z])
        ahead = np.array([float(bend(z - 5)), 1.55, z - 5])
        return handheld(aim(eye, ahead), seed, time, 0.014, 0.015)

    return Scene(
        name="forest",
        instances=tuple(instances),
        lights=(Light("sun", (1.0, 0.88, 0.66), 7.0, lambda time: LightPose(np.zeros(3), travel), radius=0.012),),
        camera=Camera(camera, np.radians(58)),
        sky=Sky(sky),
        exposure=lambda time: 1.15,
        haze=0.012,
        shadow_distance=36.0,
    )


def trees(rng: Generator, height: Ground, bend: Path, season: Float[ndarray, "3"]) -> list[Instance]:
    """Three kinds of tree repeated along the path, each at its own size, turn and wind.

    The crowns of the six nearest bend (shape keys); those behind rock on their trunks, which costs nothing.
    """
    kinds = []
    for k in range(6):
        wood, tips = branches(rng, 9.5, 0.8, 2 if k < 3 else 1)
        tips = np.repeat(tips, 3 if k < 3 else 9, axis=0)
        tips[:, 0] += rng.normal(0, 0.35, tips[:, 0].shape)
        kinds.append((wood, leaf_cards(rng, tips, 0.62, 2)))
    bending = [swaying(crown, 7.0, 0.16) for _, crown in kinds[:3]]
    trunk = bark(rng, rgb("7d6a52"))
    leaves = [leaf_cluster(rng, np.clip(season * f, 0, 1)) for f in (0.9, 1.1, 1.3)]
    instances, wood_parts = [], []
    for k in range(44):
        z = 3.5 - 42 * (k / 44) ** 1.1 + rng.uniform(-0.6, 0.6)
        x = float(bend(z)) + (1 if k % 2 else -1) * (rng.uniform(1.9, 4.0) + 9 * rng.random() ** 1.5 * (k > 5))
        place = move(x, float(height(x, z)) - 0.1, z) @ turn("y", rng.uniform(0, 6)) @ scale(rng.uniform(0.8, 1.25))
        wood, crown = kinds[k % 3 + (3 if k > 14 else 0)]
        wood_parts.append(placed(wood, place))
        phase = rng.uniform(0, 6)

        def bend_pose(time: float, place: ndarray = place, phase: float = phase) -> Pose:
            return Pose(place, morph_weights=wind(time, phase, 1.2))

        def rock_pose(time: float, place: ndarray = place, phase: float = phase) -> Pose:
            a, b = 0.008 * wind(time, phase, 1.2)
            return Pose(place @ turn("z", a) @ turn("x", b))

        near = 3 <= k < 9
        crown = bending[k % 3] if near else crown
        instances.append(Instance(crown, leaves[k % 3], 10 + k, bend_pose if near else rock_pose))
    return [Instance(join(wood_parts), trunk), *instances]


def undergrowth(rng: Generator, height: Ground, bend: Path, season: Float[ndarray, "3"]) -> list[Instance]:
    """Ferns and grass beside the path, swaying; blades are single triangles."""

    def spots(count: int, near: float, far: float) -> Float[ndarray, "k 3"]:
        z = rng.uniform(-22, 3.2, count)
        x = bend(z) + rng.choice([-1, 1], count) * rng.uniform(near, far, count)
        return np.stack([x, height(x, z), z], axis=1)

    plants = [fern(rng, size) for size in (0.7, 0.9, 0.6)]
    ferns = join(
        [
            placed(plants[k % 3], move(*p), turn("y", k), scale(rng.uniform(0.7, 1.3)))
            for k, p in enumerate(spots(75, 0.9, 5.0))
        ]
    )
    blades = grass(rng, spots(8000, 0.65, 4.2), 0.24)
    green = frond(rng, np.clip(rgb("6f9a3c") * 0.6 + season * 0.5, 0, 1))
    sway = [lifted(ferns, height, 0.07), lifted(blades, height, 0.06)]
    looks = [green, plain(np.clip(rgb("8fa846") * 0.55 + season * 0.45, 0, 1), 0.95, both=True)]

    def pose(time: float) -> Pose:
        return Pose(np.eye(4), morph_weights=wind(time, 1.0, 1.7))

    return [Instance(mesh, look, 60 + k, pose) for k, (mesh, look) in enumerate(zip(sway, looks, strict=True))]


def lifted(mesh: Mesh, height: Ground, amount: float) -> Mesh:
    """Sway keys that grow with the height above the ground, so that the feet of plants stay."""
    p = mesh.positions.astype(np.float64)
    above = np.clip(p[:, 1] - height(p[:, 0], p[:, 2]), 0, None)
    bent = swaying(
        Mesh(np.column_stack([p[:, 0], above, p[:, 2]]).astype(np.float32), mesh.normals, mesh.uvs, mesh.indices),
        0.4,
        amount,
    )
    return Mesh(
        mesh.positions, mesh.normals, mesh.uvs, mesh.indices, morphs=bent.morphs, morph_normals=bent.morph_normals
    )


def falling_leaves(rng: Generator, season: Float[ndarray, "3"]) -> list[Instance]:
    """Single leaves that spin and drift down; each falls again and again from the height of the crowns."""
    t = np.linspace(0, 1, 7)
    outline = np.stack([0.35 * np.sin(np.pi * t**0.8), 0 * t, t - 0.5], axis=1)
    points = np.concatenate([outline, outline * (-1, 1, 1)]) * 0.09
    faces = [(k, k + 7, k + 1) for k in range(6)] + [(k + 1, k + 7, k + 8) for k in range(6)]
    mesh = Mesh(
        points.astype(np.float32),
        np.tile(np.array([[0, 1, 0]], np.float32), (14, 1)),
        np.zeros((14, 2), np.float32),
        np.array(faces, np.uint32).reshape(-1),
    )
    instances = []
    for k in range(18):
        start, drift, axis = rng.uniform((-2.5, 0, -6), (2.5, 6, 2)), rng.uniform(-0.012, 0.012, 2), rng.normal(0, 1, 3)
        fall, spin = rng.uniform(0.022, 0.04), rng.uniform(0.12, 0.4)

        def pose(
            time: float,
            start: ndarray = start,
            drift: ndarray = drift,
            axis: ndarray = axis,
            fall: float = fall,
            spin: float = spin,
        ) -> Pose:
            y = (start[1] - fall * time) % 6.0
            flutter = 0.2 * np.sin(0.15 * time + 6 * start[0])
            return Pose(
                move(start[0] + drift[0] * time + flutter, y, start[2] + drift[1] * time) @ turn(axis, spin * time)
            )

        tone = np.clip(season * rng.uniform(0.8, 1.5) * (1.2, 1.0, 0.8), 0, 1)
        instances.append(Instance(mesh, plain(tone, 0.6, both=True), 70 + k, pose))
    return instances
