"""Training scene: a courtyard with arcades under a fast sun. See docs/scenes.md."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from numpy.random import Generator

from framecast.render.finish import plain, rgb
from framecast.render.mesh import box_uvs, from_grid, placed, standing
from framecast.render.motion import aim, move, turn
from framecast.render.scene import Camera, Instance, Light, LightPose, Material, Mesh, Pose, Scene, Sky
from framecast.render.skies import dome, sun_travel
from framecast.render.train_character import walker
from framecast.render.train_plants import branches, leaf_cards, swaying, wind
from framecast.render.train_shapes import arch, box, cylinder, gable, lathe, level, railing, wire
from framecast.render.train_textures import (
    bark,
    boards,
    clouds_over,
    cobbles,
    leaf_cluster,
    plaster,
    roof_tiles,
    scratched_paint,
)

Parts = list[tuple[Mesh, Material]]


def courtyard(seed: int) -> Scene:
    """A walled court: arcades, a fountain, a tree in the wind, washing on a line, a walker, a moving sun, an orbit."""
    rng = np.random.default_rng([seed, 1])
    wall = plaster(rng, rgb(["d9b382", "d8946a", "d6b26a", "c9806a"][seed % 4]))
    stone = plaster(rng, rgb("cfc4ae"))
    parts: Parts = [(level(26, 26, 2.6), cobbles(rng, rgb("a39a8c")))]
    roof = roof_tiles(rng, rgb("b5613f"))
    for k in range(4):
        parts += side(rng, turn("y", k * np.pi / 2) @ move(0, 0, -9), wall, stone, roof, open_arcade=k != 2)
    parts += fountain(rng, stone)
    instances = standing(parts)
    instances += tree(rng, move(-4.2, 0.42, -3.4), 10)
    instances += [Instance(box(1.7, 0.5, 1.7, 0.04), stone, 0, lambda time: Pose(move(-4.2, 0.25, -3.4)))]
    instances += washing(rng, (-7.0, 3.5, 1.5), (3.5, 3.7, -7.2), 20)
    instances += stroller(rng, 30)
    start, height, pace = rng.uniform(0.5, 0.9), rng.uniform(1.7, 2.4), rng.choice([-1, 1]) * 0.0045
    morning, rise = rng.uniform(2.2, 3.0), rng.uniform(0.75, 0.95)

    def sun(time: float) -> LightPose:
        return LightPose(np.zeros(3), sun_travel(rise - 0.001 * time, morning + 0.007 * time))

    def camera(time: float) -> ndarray:
        angle = start + pace * time
        return aim((7.4 * np.sin(angle), height, 7.4 * np.cos(angle)), (-0.4, 1.9, -0.6))

    sky = clouds_over(
        rng, dome(rgb("3f74b8"), rgb("b9d0e6"), rgb("8d8271"), -sun_travel(rise, morning), (1.4, 1.2, 0.9))
    )
    return Scene(
        name="courtyard",
        instances=tuple(instances),
        lights=(Light("sun", (1.0, 0.92, 0.78), 5.5, sun, radius=0.008),),
        camera=Camera(camera, np.radians(54)),
        sky=Sky(sky),
        exposure=lambda time: 1.0,
        shadow_distance=32.0,
    )


def side(
    rng: Generator, place: Float[ndarray, "4 4"], wall: Material, stone: Material, roof: Material, open_arcade: bool
) -> Parts:
    """One side of the court, facing +z: arcade or plain ground floor, an upper floor with shuttered windows, a roof."""
    parts: Parts = []
    dark = plain(rgb("1c222a"), 0.08)
    shutter = scratched_paint(rng, rgb(str(rng.choice(["4f7a6a", "3f6486", "7a4a3a", "6f7d4a"]))))
    bay, bays = 3.0, 6
    for k in range(bays):
        x = (k - (bays - 1) / 2) * bay
        if open_arcade:
            parts.append((placed(arch(2.2, 2.0, 3.5, 0.5, 2.0, pier=0.4), place, move(x, 0, 0)), stone))
            parts.append((placed(box(0.62, 0.16, 0.66, 0.03), place, move(x - bay / 2, 2.0, 0)), stone))
            parts.append((placed(box(0.7, 0.3, 0.72, 0.03), place, move(x - bay / 2, 0.15, 0)), stone))
        else:
            parts.append((placed(box_uvs(box(bay, 3.5, 0.5, 0.0), 2.0), place, move(x, 1.75, 0)), wall))
        for piece, material in window(stone, dark, shutter, rng.uniform(0.0, 2.4)):
            parts.append((placed(piece, place, move(x, 5.1, 0.25)), material))
    parts.append((placed(box(18, 3.4, 0.5, 0.0, 3.0), place, move(0, 5.3, 0)), wall))
    parts.append((placed(box(18.2, 0.22, 0.7, 0.03), place, move(0, 3.6, 0.05)), stone))
    parts.append((placed(box(18, 7.0, 0.4, 0.0, 3.0), place, move(0, 3.5, -3.2)), wall))
    parts.append((placed(level(18, 3.2, 2.0), place, move(0, 3.45, -1.7), turn("x", np.pi)), stone))
    parts.append((placed(gable(18, 4.0, 1.1, 0.5, 2.0), place, move(0, 7.0, -1.6)), roof))
    return parts


def window(frame: Material, glass: Material, shutter: Material, opened: float) -> Parts:
    """A window on a wall in the xy plane, centred on the origin,
    with two louvred shutters turned by `opened` radians.
    """
    parts: Parts = [(placed(box(1.0, 1.5, 0.04, 0.0), move(0, 0, 0.0)), glass)]
    parts += [(placed(box(0.12, 1.74, 0.16, 0.02), move(x, 0, 0.03)), frame) for x in (-0.56, 0.56)]
    parts += [
        (placed(box(1.5, 0.12, 0.26, 0.02), move(0, -0.82, 0.06)), frame),
        (placed(box(1.3, 0.14, 0.2, 0.02), move(0, 0.82, 0.04)), frame),
    ]
    parts += [
        (placed(box(0.05, 1.5, 0.06, 0.01), move(0, 0, 0.03)), shutter),
        (placed(box(1.0, 0.05, 0.06, 0.01), move(0, 0.25, 0.03)), shutter),
    ]
    for hand in (-1, 1):
        hinge = move(hand * 0.53, 0, 0.12) @ turn("y", hand * opened)
        rails = [box(0.06, 1.5, 0.05, 0.01), box(0.06, 1.5, 0.05, 0.01)]
        parts += [
            (placed(rail, hinge, move(-hand * x, 0, 0)), shutter) for rail, x in zip(rails, (0.03, 0.46), strict=True)
        ]
        parts += [
            (placed(box(0.42, 0.012, 0.07, 0.0), hinge, move(-hand * 0.245, y, 0), turn("x", 0.6)), shutter)
            for y in np.arange(-0.7, 0.75, 0.1)
        ]
    return parts


def fountain(rng: Generator, stone: Material) -> Parts:
    """A round basin with two bowls above it and still water."""
    water = plain(rgb("2d4a4c"), 0.05)
    basin = lathe(
        [
            (1.62, 0),
            (1.70, 0.1),
            (1.62, 0.16),
            (1.62, 0.5),
            (1.74, 0.56),
            (1.74, 0.64),
            (1.5, 0.64),
            (1.46, 0.4),
            (0.2, 0.38),
        ],
        56,
        1.5,
        35,
    )
    stem = lathe(
        [
            (0.34, 0.3),
            (0.30, 0.5),
            (0.16, 0.66),
            (0.13, 1.0),
            (0.20, 1.15),
            (0.75, 1.32),
            (0.86, 1.42),
            (0.82, 1.45),
            (0.2, 1.38),
        ],
        40,
        1.5,
        45,
    )
    cup = lathe(
        [
            (0.10, 1.35),
            (0.07, 1.7),
            (0.12, 1.85),
            (0.42, 1.95),
            (0.47, 2.02),
            (0.1, 1.98),
            (0.05, 2.1),
            (0.11, 2.2),
            (0.09, 2.3),
            (0, 2.36),
        ],
        32,
        1.5,
        45,
    )
    pool = placed(cylinder(1.5, 0.02, 48), move(0, 0.52, 0))
    bowl = placed(cylinder(0.8, 0.02, 32), move(0, 1.41, 0))
    parts: Parts = [(mesh, stone) for mesh in (basin, stem, cup)] + [(pool, water), (bowl, water)]
    pots = plain(rgb("a8573a"), 0.8)
    fence = plain(rgb("20242a"), 0.35, 0.8)
    for k in range(6):
        angle = 2 * np.pi * k / 6 + rng.uniform(-0.2, 0.2)
        pot = lathe(
            [(0, 0), (0.18, 0), (0.30, 0.42), (0.34, 0.44), (0.34, 0.52), (0.28, 0.52), (0.26, 0.44), (0, 0.44)],
            24,
            0.5,
            30,
        )
        parts.append((placed(pot, move(6.9 * np.cos(angle), 0, 6.9 * np.sin(angle))), pots))
    parts.append((placed(railing(5.0), move(2.0, 0, -6.5)), fence))
    return parts


def tree(rng: Generator, place: Float[ndarray, "4 4"], number: int) -> list[Instance]:
    """A tree whose crown sways; wood stands still."""
    wood, tips = branches(rng, 5.2, 0.9)
    crown = swaying(leaf_cards(rng, tips, 0.42, 6), 4.0, 0.12)
    leaf = leaf_cluster(rng, rgb(str(rng.choice(["5f7f38", "7b8f45", "4f7440"]))))
    phase = rng.uniform(0, 6)
    return [
        Instance(wood, bark(rng, rgb("8a7358")), 0, lambda time: Pose(place)),
        Instance(crown, leaf, number, lambda time: Pose(place, morph_weights=wind(time, phase))),
    ]


def washing(
    rng: Generator, a: tuple[float, float, float], b: tuple[float, float, float], number: int
) -> list[Instance]:
    """A sagging line from `a` to `b` with sheets that billow (shape keys)."""
    start, end = np.array(a), np.array(b)
    instances = [Instance(wire(a, b, 0.35, 0.012), plain(rgb("6a6459"), 0.8))]
    across = (end - start) / np.linalg.norm(end - start)
    face = np.cross(across, (0, 1, 0))
    for k, t in enumerate(np.linspace(0.18, 0.82, 6)):
        wide, tall = rng.uniform(0.7, 1.3), rng.uniform(0.8, 1.4)
        top = start + (end - start) * t - np.array([0, 4 * 0.35 * t * (1 - t), 0])
        u, v = np.meshgrid(np.linspace(-0.5, 0.5, 17), np.linspace(0, 1, 17))
        grid = top + across * (u * wide)[..., None] - np.array([0.0, 1.0, 0.0]) * (v * tall)[..., None]
        sheet = from_grid(grid, np.stack([u, v], axis=-1), 80)
        lift = np.clip((top[1] - sheet.positions[:, 1:2]) / tall, 0, 1)
        wave = [
            np.sin(5 * sheet.uvs[:, :1] + phase) + 0.6 * np.cos(7 * sheet.uvs[:, 1:] + 2 * phase)
            for phase in (0, np.pi / 2)
        ]
        keys = np.stack([0.2 * lift * w * face for w in wave]).astype(np.float32)
        cloth = plain(
            np.clip(rgb(str(rng.choice(["f2efe6", "d8e4ee", "c0493c", "e8c878", "5c7fa8"]))), 0, 1), 0.9, both=True
        )
        rate, shift = rng.uniform(0.13, 0.2), rng.uniform(0, 6)

        def pose(time: float, rate: float = rate, shift: float = shift) -> Pose:
            return Pose(np.eye(4), morph_weights=np.array([np.sin(rate * time + shift), np.cos(rate * time + shift)]))

        instances.append(Instance(replace(sheet, morphs=keys), cloth, number + k, pose))
    return instances


def stroller(rng: Generator, number: int) -> list[Instance]:
    """Someone walking round the fountain."""
    radius, begin = rng.uniform(3.0, 3.8), rng.uniform(0.2, 1.0)
    speed = 1.25 / 30

    def path(time: float) -> tuple[ndarray, float]:
        angle = begin - speed * time / radius
        return move(radius * np.sin(angle), 0, radius * np.cos(angle)) @ turn("y", angle - np.pi / 2), speed * time

    shirt = boards(rng, rgb(str(rng.choice(["b8452f", "3d6d8c", "d9a441"]))), 12, 0.9)
    return walker(rng, number, path, (shirt, plain(rgb("37415a"), 0.85), plain(rgb("3a2a20"), 0.5)))
