"""Held-out scene: a glasshouse under a moving sun. See docs/scenes.md."""

from itertools import pairwise

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from numpy.random import Generator

from framecast.render.finish import plain, rgb
from framecast.render.heldout_shapes import (
    bar,
    block,
    cloud_crown,
    cord,
    fronds,
    pillar,
    sheet,
    stem,
)
from framecast.render.heldout_textures import (
    broad_leaf,
    concrete,
    figured_wood,
    gravel,
    mosaic,
    palm_leaf,
    star_leaves,
    veiled,
)
from framecast.render.mesh import join, placed, standing
from framecast.render.motion import aim, along, handheld, move, scale, turn
from framecast.render.scene import Camera, Instance, Light, LightPose, Material, Mesh, Pose, Scene, Sky
from framecast.render.skies import dome, sun_travel

Parts = list[tuple[Mesh, Material]]


def rustle(time: float, phase: float, size: float) -> Float[ndarray, "4 4"]:
    """A small rocking about the root of a plant."""
    t = 0.1 * time + phase
    return turn("z", size * (np.sin(t) + 0.4 * np.sin(2.7 * t))) @ turn("x", size * np.sin(1.3 * t + 1))


def greenhouse(seed: int) -> Scene:
    """An iron glasshouse: bar shadows travel over palms and a mosaic floor, ceiling fans turn, the camera walks."""
    rng = np.random.default_rng([seed, 14])
    palette = np.stack(
        [
            rgb(c)
            for c in (
                ["2f6f73", "e8dcc2", "c8623a", "1f3a4a"],
                ["6a2f3a", "ead9b8", "39607a", "c9a23a"],
                ["33503a", "efe6cf", "a8442f", "d8b04a"],
            )[seed % 3]
        ]
    )
    iron = plain(rgb(str(rng.choice(["e6e8e2", "2f4a3f", "40484c"]))), 0.45, 0.2)
    wall, soil = concrete(rng, rgb("b5a998")), gravel(rng, rgb("5d4a38"))
    parts: Parts = [
        (placed(sheet(3.0, 22, 1, None, 3.0), move(0, 0.02, -6)), mosaic(rng, palette)),
        (placed(sheet(16, 24, 1, None, 1.5), move(0, 0.0, -6)), soil),
    ]
    parts += [(placed(block(0.25, 0.5, 22, 0.03, 1.0), move(s * 1.65, 0.25, -6)), wall) for s in (-1, 1)]
    parts += [(placed(block(0.3, 0.9, 24, 0.03, 1.5), move(s * 6.2, 0.45, -6)), wall) for s in (-1, 1)]
    frame, panes = glasshouse(iron)
    parts += frame
    instances = standing(parts)
    instances.append(
        Instance(
            panes,
            Material(base_color=(0.75, 0.9, 0.88, 0.10), roughness=0.05, alpha_mode="blend", double_sided=True),
            casts_shadow=False,
        )
    )
    instances.append(grove(rng))
    instances += palms(rng, 10)
    instances += beds(rng, 40)
    for k, z in enumerate((-2.5, -8.5)):
        instances += ceiling_fan(rng, move(0, 3.9, z), 80 + k)
    start, rise = rng.uniform(0.9, 1.4) * rng.choice([-1, 1]), rng.uniform(0.8, 1.05)

    def sun(time: float) -> LightPose:
        return LightPose(np.zeros(3), sun_travel(rise, start + 0.006 * time))

    def camera(time: float) -> ndarray:
        eye = along([(0.5, 1.65, 3.4), (-0.2, 1.6, 2.0), (0.3, 1.62, 0.6), (0.0, 1.65, -0.8)], time / 90)
        return handheld(aim(eye, (-0.25 + 0.006 * time, 1.9, -8)), seed, time, 0.010, 0.012)

    sky = veiled(
        rng,
        dome(rgb("5f93cf"), rgb("dbe6ea"), rgb("6f7a5a"), -sun_travel(rise, start), (1.6, 1.4, 1.1)),
        (1.0, 1.0, 1.0),
        0.5,
    )
    return Scene(
        name="greenhouse",
        instances=tuple(instances),
        lights=(Light("sun", (1.0, 0.93, 0.80), 6.0, sun, radius=0.01),),
        camera=Camera(camera, np.radians(60)),
        sky=Sky(sky, ambient=(0.55 * sky).astype(np.float32)),
        exposure=lambda time: 1.2,
        shadow_distance=26.0,
        split="test",
    )


def glasshouse(iron: Material) -> tuple[Parts, Mesh]:
    """(iron frame with round ribs and thin glazing bars, glass)."""
    bars, glass = [], []
    angle = np.linspace(0, np.pi, 17)
    arc = np.stack([6.2 * np.cos(angle), 2.6 + 3.4 * np.sin(angle), 0 * angle], axis=1)
    for z in np.arange(-17, 5.5, 3.0):
        bars += [bar(arc + np.array([0, 0, z]), 0.10, 0.14)] + [
            bar([(s * 6.2, 0.9, z), (s * 6.2, 1.8, z), (s * 6.2, 2.6, z)], 0.10, 0.14) for s in (-1, 1)
        ]
    for z in np.arange(-17, 5.0, 0.75):
        bars.append(bar(arc[1:-1:2] * (0.995, 0.995, 1) + (0, 0, z), 0.025, 0.03))
    for p in arc[1:-1:2]:
        bars.append(bar([p + np.array([0, 0, -17]), p + np.array([0, 0, -6]), p + np.array([0, 0, 5])], 0.04, 0.04))
    for s in (-1, 1):
        bars += [bar([(s * 6.2, y, -17), (s * 6.2, y, -6), (s * 6.2, y, 5)], 0.04, 0.04) for y in (1.75, 2.6)]
        bars += [bar([(s * 6.2, 0.9, z), (s * 6.2, 2.6, z)], 0.025, 0.03) for z in np.arange(-17, 5.0, 0.75)]
    ends = [
        bar([(x, 0, -17), (x, 2.6 + 3.4 * np.sqrt(max(0, 1 - (x / 6.2) ** 2)), -17)], 0.06, 0.06)
        for x in np.linspace(-5.6, 5.6, 15)
    ]
    ends += [bar([(-6.2, y, -17), (0, y, -17), (6.2, y, -17)], 0.04, 0.04) for y in (0.9, 1.75, 2.6, 3.6)]
    for a, b in pairwise(arc):
        middle, lean = (a + b) / 2, np.arctan2(b[1] - a[1], b[0] - a[0])
        glass.append(
            placed(sheet(float(np.linalg.norm(b - a)), 22, 1), move(middle[0], middle[1], -6), turn("z", lean))
        )
    return [(join(bars + ends), iron)], join(glass)


def grove(rng: Generator) -> Instance:
    """Bushes and small trees that stand outside, behind the glass."""
    clouds = [cloud_crown(rng, rng.normal(0, 1, (5, 3)) * (0.9, 0.7, 0.9), 0.8, 30, 0.42) for _ in range(3)]
    spots = [(s * rng.uniform(8, 12), -z) for s in (-1, 1) for z in range(-6, 22, 3)] + [
        (x, -22) for x in range(-10, 11, 3)
    ]
    crowns = [
        placed(clouds[k % 3], move(x, rng.uniform(0.8, 2.2), z), turn("y", k), scale(rng.uniform(1.0, 1.9)))
        for k, (x, z) in enumerate(spots)
    ]
    return Instance(join(crowns), star_leaves(rng, rgb(str(rng.choice(["5a7a3c", "6f8a4a", "8a7a3c"])))))


def palms(rng: Generator, number: int) -> list[Instance]:
    """Palms left and right, their crowns rocking in the draught; old trunks ringed."""
    leaf = palm_leaf(rng, rgb(str(rng.choice(["4f8a3c", "6a8f3a", "3f7a4a"]))))
    bark = figured_wood(rng, rgb("8a7355"), 0.8)
    crowns = [fronds(rng, 15, 1.9, 0.62, 0.55), fronds(rng, 19, 1.5, 0.5, 0.7)]
    trunks, instances = [], []
    for k in range(12):
        s = 1 if k % 2 else -1
        place = move(s * rng.uniform(2.6, 4.6), 0, 2.2 - 1.45 * k + rng.uniform(-0.4, 0.4))
        trunk, top = stem(rng, rng.uniform(1.4, 3.0), 0.11, rng.uniform(0.0, 0.4))
        trunks.append(placed(trunk, place))
        here, phase = place @ move(*top) @ turn("y", rng.uniform(0, 6)), rng.uniform(0, 6)

        def pose(time: float, here: ndarray = here, phase: float = phase) -> Pose:
            return Pose(here @ rustle(time, phase, 0.02))

        instances.append(Instance(crowns[k % 2], leaf, number + k, pose))
    return [Instance(join(trunks), bark), *instances]


def beds(rng: Generator, number: int) -> list[Instance]:
    """Broad-leaved plants and pots beside the path, hanging baskets above it."""
    leaves = [
        broad_leaf(rng, rgb(c), rgb(v)) for c, v in (("3f7d3a", "b8d48a"), ("7a2f4a", "d86a8a"), ("2f6a4a", "9ac89a"))
    ]
    kinds = [fronds(rng, 14, 0.85, 0.42, 0.6), fronds(rng, 18, 0.6, 0.26, 0.35), fronds(rng, 11, 1.1, 0.55, 0.75)]
    pots, instances = [], []
    for k in range(22):
        s = 1 if k % 2 else -1
        place = (
            move(s * rng.uniform(1.95, 2.5), 0.25, 3.2 - 0.85 * k + rng.uniform(-0.2, 0.2))
            @ turn("y", rng.uniform(0, 6))
            @ scale(rng.uniform(0.8, 1.3))
        )
        phase = rng.uniform(0, 6)

        def pose(time: float, place: ndarray = place, phase: float = phase) -> Pose:
            return Pose(place @ rustle(time, phase, 0.03))

        instances.append(Instance(kinds[k % 3], leaves[int(rng.integers(3))], number + k, pose))
    bowl = pillar([(-0.02, 0.05), (0.0, 0.16), (0.12, 0.22), (0.16, 0.24), (0.17, 0.20)], 20)
    for k in range(6):
        x, z = (1 if k % 2 else -1) * 1.1, 1.2 - 2.4 * k
        cords = [
            cord(
                np.array(
                    [(0.22 * np.cos(a), 0.16, 0.22 * np.sin(a)), (0.1 * np.cos(a), 0.9, 0.1 * np.sin(a)), (0, 1.9, 0)]
                ),
                0.006,
                4,
            )
            for a in (0, 2.1, 4.2)
        ]
        pots.append(placed(join([bowl, *cords]), move(x, 2.9, z)))
        here, phase = move(x, 3.05, z), rng.uniform(0, 6)

        def swing(time: float, here: ndarray = here, phase: float = phase) -> Pose:
            return Pose(here @ rustle(time, phase, 0.05))

        instances.append(Instance(kinds[1], leaves[k % 3], number + 24 + k, swing))
    return [Instance(join(pots), plain(rgb("8a5a3c"), 0.8)), *instances]


def ceiling_fan(rng: Generator, place: Float[ndarray, "4 4"], number: int) -> list[Instance]:
    """A slow fan on a rod."""
    blade = placed(block(0.95, 0.015, 0.17, 0.005), move(0.62, 0, 0), turn("x", 0.2))
    rotor = join(
        [placed(blade, turn("y", k * np.pi / 2)) for k in range(4)]
        + [pillar([(-0.1, 0.05), (-0.06, 0.14), (0.08, 0.14), (0.12, 0.05)], 20)]
    )
    rod = pillar([(0.1, 0.02), (2.0, 0.02)], 10)
    speed = rng.uniform(0.25, 0.5)
    wood = figured_wood(rng, rgb("6a452c"))
    return [
        Instance(rod, plain(rgb("b58a4a"), 0.3, 1.0), 0, lambda time: Pose(place)),
        Instance(rotor, wood, number, lambda time: Pose(place @ turn("y", speed * time))),
    ]
