"""Training scene: a tram and cars cross a street by day. See docs/scenes.md."""

from itertools import pairwise

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from numpy.random import Generator

from framecast.render.finish import plain, rgb
from framecast.render.mesh import box_uvs, join, placed, standing
from framecast.render.motion import aim, ease, handheld, move, turn
from framecast.render.scene import Camera, Instance, Light, LightPose, Material, Mesh, Pose, Scene, Sky
from framecast.render.skies import dome, sun_travel
from framecast.render.train_character import walker
from framecast.render.train_plants import branches, leaf_cards, swaying, wind
from framecast.render.train_props import Drive, at, bench, car, rolling, tram
from framecast.render.train_shapes import box, cylinder, gable, level, railing, tube, wire
from framecast.render.train_textures import (
    asphalt,
    bark,
    boards,
    bricks,
    clouds_over,
    cobbles,
    leaf_cluster,
    plaster,
    roof_tiles,
)

Parts = list[tuple[Mesh, Material]]


def straight(x: float, z: float, speed: float, start: float) -> Drive:
    """A drive along x at the given z, `speed` metres per frame (negative: towards -x), passing `x` at frame `start`."""
    facing = turn("y", 0.0 if speed > 0 else np.pi)

    def place(time: float) -> tuple[ndarray, float]:
        gone = speed * (time - start)
        return move(x + gone, 0, z) @ facing, abs(speed) * (time - start)

    return place


def tramway(seed: int) -> Scene:
    """A tram and cars cross close and fast behind a railing; overhead wires, shop fronts, low sun, the camera pans."""
    rng = np.random.default_rng([seed, 4])
    parts: Parts = [
        (level(90, 14, 4.0), asphalt(rng)),
        (placed(level(90, 6, 1.8), move(0, 0.14, -10)), cobbles(rng, rgb("a59f96"))),
        (placed(level(90, 8, 1.8), move(0, 0.14, 8.2)), cobbles(rng, rgb("9b968c"))),
    ]
    kerb = plaster(rng, rgb("b5b2aa"), 0.5)
    parts += [(placed(box(90, 0.16, 0.2, 0.02, 1.0), move(0, 0.07, z)), kerb) for z in (-7.0, 4.2)]
    rail = plain(rgb("a5a6a8"), 0.25, 1.0)
    parts += [(placed(box(90, 0.05, 0.07, 0.01), move(0, 0.012, z)), rail) for z in (-5.5, -4.1)]
    line = plain(rgb("d9d7cf"), 0.7)
    parts += [(placed(level(1.8, 0.13), move(x, 0.006, 0.2)), line) for x in np.arange(-42, 42, 4.0)]
    parts += shop_fronts(rng)
    parts += overhead(rng)
    iron = plain(rgb("23413a"), 0.35, 0.5)
    parts += [
        (placed(railing(2.6, 1.0, 0.14, 0.011), move(x, 0.14, 4.7)), iron) for x in (-9.4, -6.8, -4.2, 1.6, 4.2, 6.8)
    ]
    parts += at(move(3.6, 0.14, -8.4), bench(boards(rng, rgb("8f6b42"), 8)))
    instances = standing(parts)
    for k, x in enumerate((-9.5, 6.8)):
        instances += street_tree(rng, move(x, 0.14, -8.6), 10 + k)
    goes = int(rng.choice([-1, 1]))
    axles = (-4.4, -2.8, 2.8, 4.4)
    instances += rolling(tram(rng), 20, straight(-2.0, -4.8, goes * rng.uniform(0.26, 0.36), 34), 0.36, axles, 0.75)
    instances += rolling(
        car(rng), 21, straight(-1.0, -1.6, -goes * rng.uniform(0.38, 0.5), 14), 0.33, (-1.22, 1.22), 0.72
    )
    instances += rolling(car(rng), 22, straight(0.5, 2.0, goes * rng.uniform(0.42, 0.6), 46), 0.33, (-1.22, 1.22), 0.72)
    speed, begin = 1.3 / 30, rng.uniform(-4, 0)

    def stroll(time: float) -> tuple[ndarray, float]:
        return move(begin + speed * time, 0.14, -7.9) @ turn("y", np.pi / 2), speed * time

    coat = plain(rgb(str(rng.choice(["c9b28a", "7a2f2f", "2f4f5f"]))), 0.9)
    instances += walker(rng, 23, stroll, (coat, plain(rgb("2b2d33"), 0.8), plain(rgb("1c1a18"), 0.4)))
    travel = sun_travel(rng.uniform(0.45, 0.65), goes * rng.uniform(2.2, 2.6))
    sky = clouds_over(rng, dome(rgb("4d82c2"), rgb("d3d9dc"), rgb("7e7a72"), -travel, (2.0, 1.5, 1.0)), 0.6)

    def camera(time: float) -> ndarray:
        swing = goes * 0.42 * (0.5 - ease(time, -5, 65))
        return handheld(
            aim((0.4, 1.72, 7.2), (0.4 + 10 * np.sin(swing), 2.0, 7.2 - 10 * np.cos(swing))), seed, time, 0.0025
        )

    return Scene(
        name="tramway",
        instances=tuple(instances),
        lights=(Light("sun", (1.0, 0.86, 0.68), 5.5, lambda time: LightPose(np.zeros(3), travel), radius=0.008),),
        camera=Camera(camera, np.radians(60)),
        sky=Sky(sky),
        haze=0.004,
        shadow_distance=40.0,
    )


def shop_fronts(rng: Generator) -> Parts:
    """A row of houses of different width, height and finish behind the far pavement."""
    parts: Parts = []
    x = -34.0
    dark, stone = plain(rgb("161c22"), 0.06), plaster(rng, rgb("d8d0c0"), 0.4)
    roof = roof_tiles(rng, rgb("7a4f42"))
    faces = [
        bricks(rng, rgb("92614d")),
        plaster(rng, rgb("d9c9a0"), 0.5),
        bricks(rng, rgb("b79f83")),
        plaster(rng, rgb("a9b7b5"), 0.5),
    ]
    k = int(rng.integers(4))
    while x < 34:
        bays, floors = int(rng.integers(3, 5)), int(rng.integers(2, 5))
        wide, high = bays * 2.3 + 0.6, 3.6 + 3.1 * floors
        middle, wall = x + wide / 2, faces[k % 4]
        parts.append(
            (
                placed(
                    box_uvs(box(wide - 0.02, high, 8, 0.0), 1.3 if k % 2 == 0 else 3.0), move(middle, high / 2, -17)
                ),
                wall,
            )
        )
        parts.append((placed(box(wide, 0.35, 0.5, 0.05, 2.0), move(middle, 3.75, -12.95)), stone))
        parts.append((placed(box(wide + 0.1, 0.4, 0.6, 0.06, 2.0), move(middle, high, -12.95)), stone))
        parts.append((placed(gable(wide, 8.0, 2.4, 0.3, 2.2), move(middle, high, -17)), roof))
        awning = plain(rgb(str(rng.choice(["a8332c", "2e5b4a", "d8c9a8", "284a6f"]))), 0.8, both=True)
        for bay in range(bays):
            here = x + 0.3 + 2.3 * (bay + 0.5)
            parts += at(
                move(here, 1.75, -12.98),
                [(box(1.7, 2.7, 0.05, 0.0), dark), (placed(box(0.08, 2.7, 0.12, 0.01), move(0.2, 0, 0.02)), stone)],
            )
            for floor in range(floors):
                parts += at(move(here, 5.3 + 3.1 * floor, -13.0), front_window(stone, dark))
        parts.append((placed(box(wide - 0.8, 0.04, 1.5, 0.01), move(middle, 3.05, -12.4), turn("x", 0.45)), awning))
        x, k = x + wide, k + 1
    return parts


def front_window(stone: Material, glass: Material) -> Parts:
    """A sash window on a wall in the xy plane."""
    bars = join(
        [placed(box(0.05, 1.6, 0.08, 0.01), move(0, 0, 0.04)), placed(box(1.1, 0.06, 0.08, 0.01), move(0, 0.1, 0.04))]
    )
    sides = [placed(box(0.14, 1.8, 0.16, 0.02), move(s * 0.6, 0, 0.04)) for s in (-1, 1)]
    ledges = [
        placed(box(1.5, 0.14, 0.28, 0.02), move(0, -0.92, 0.08)),
        placed(box(1.4, 0.2, 0.2, 0.02), move(0, 0.95, 0.05)),
    ]
    return [(box(1.1, 1.6, 0.05, 0.0), glass), (join([bars, *sides, *ledges]), stone)]


def overhead(rng: Generator) -> Parts:
    """Tram wires on poles with cross spans: single-pixel lines against the sky."""
    black, pole = plain(rgb("111214"), 0.4, 0.5), plain(rgb("2c4a42"), 0.4, 0.6)
    parts: Parts = []
    xs = np.arange(-40, 41, 16.0) + rng.uniform(-3, 3)
    for a, b in pairwise(xs):
        parts += [
            (wire((a, 4.75, -4.8), (b, 4.75, -4.8), 0.05, 0.012), black),
            (wire((a, 5.4, -4.8), (b, 5.4, -4.8), 0.35, 0.01), black),
        ]
        parts += [(tube([(x, 4.75, -4.8), (x, 5.12, -4.8)], 0.006, 4), black) for x in np.linspace(a, b, 7)[1:-1]]
        parts += [(wire((a, 6.6, z), (b, 6.5, z), 0.5, 0.009), black) for z in (-7.4, 3.9)]
    for x in xs:
        parts += [(placed(cylinder(0.09, 7.0, 12), move(x, 0, z)), pole) for z in (-7.4, 4.45)]
        parts += [
            (wire((x, 6.3, -7.4), (x, 6.3, 4.45), 0.5, 0.01), black),
            (tube([(x, 5.9, -7.4), (x, 5.4, -4.8)], 0.03, 6), pole),
        ]
    return parts


def street_tree(rng: Generator, place: Float[ndarray, "4 4"], number: int) -> list[Instance]:
    """A plane tree in a square of earth."""
    wood, tips = branches(rng, 6.5, 0.75)
    crown = swaying(leaf_cards(rng, tips, 0.5, 3), 5.0, 0.10)
    phase = rng.uniform(0, 6)
    leaf = leaf_cluster(rng, rgb(str(rng.choice(["6d8a3c", "8a9140", "567a3a"]))))
    return [
        Instance(wood, bark(rng, rgb("9a8a6f")), 0, lambda time: Pose(place)),
        Instance(crown, leaf, number, lambda time: Pose(place, morph_weights=wind(time, phase, 1.3))),
    ]
