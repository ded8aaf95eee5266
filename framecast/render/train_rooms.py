"""Training scenes indoors: a workshop under a swinging lamp, a gallery with a polished floor. See docs/scenes.md."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from numpy.random import Generator

from framecast.render.finish import plain, rgb
from framecast.render.mesh import box_uvs, join, placed, standing
from framecast.render.motion import aim, along, handheld, move, turn, unit
from framecast.render.scene import Camera, Instance, Light, LightPose, Material, Mesh, Mirror, Pose, Scene, Sky
from framecast.render.skies import room
from framecast.render.train_props import at, bench, bottles
from framecast.render.train_shapes import ball, box, cylinder, fan_blades, knot, lathe, level, tube, wire
from framecast.render.train_textures import (
    boards,
    bricks,
    brushed_steel,
    canvas_painting,
    marble_checks,
    plaster,
    scratched_paint,
)

Parts = list[tuple[Mesh, Material]]


def walls(x: float, z: float, height: float, tile: float, material: Material) -> Parts:
    """Four inner walls around the origin."""
    parts: Parts = []
    for k, (wide, away) in enumerate(((x, z), (z, x), (x, z), (z, x))):
        sheet = box_uvs(box(wide + 0.4, height, 0.2, 0.0), tile)
        parts.append((placed(sheet, turn("y", k * np.pi / 2), move(0, height / 2, -away / 2 - 0.1)), material))
    return parts


def workshop(seed: int) -> Scene:
    """A cluttered workshop: the only lamp swings, a fan and a bicycle wheel spin, the camera walks by hand."""
    rng = np.random.default_rng([seed, 2])
    wood, dark_wood = boards(rng, rgb("b98a57"), 7), boards(rng, rgb("6f4a2e"), 5, 0.6)
    brick = bricks(rng, rgb(["99604a", "8c6a58", "b0a294", "84594a"][seed % 4]))
    steel = brushed_steel(rng, rgb("b9bcc0"))
    parts: Parts = [(level(8, 7, 1.6), boards(rng, rgb("94795a"), 8, 0.32)), *walls(8, 7, 3.4, 1.05, brick)]
    parts += [(placed(level(8.2, 7.2, 2.0), move(0, 3.4, 0), turn("x", np.pi)), dark_wood)]
    parts += [(placed(box(0.2, 0.28, 7, 0.02, 1.5), move(x, 3.26, 0)), dark_wood) for x in (-2.6, 0, 2.6)]
    parts += workbench(rng, wood, dark_wood, steel)
    parts += shelves(rng, dark_wood)
    parts += pipes(rng)
    instances = standing(parts)
    instances += standing(at(move(-2.6, 0, 1.2) @ turn("y", 0.6), bench(wood)))
    instances += floor_fan(rng, move(2.3, 0, -1.4) @ turn("y", -0.5), 10)
    instances += bicycle_wheel(rng, 12)
    swing, phase, long = rng.uniform(0.30, 0.42), rng.uniform(0, 6), 1.25
    lamp, light = hanging_lamp(swing, phase, long, 14)
    path = [(2.3, 1.62, 1.9), (1.5, 1.6, 1.5), (0.6, 1.6, 1.5), (-0.4, 1.62, 1.2)]

    def camera(time: float) -> ndarray:
        eye = along(path, time / 90)
        look = along([(-1.0, 1.25, -3), (-0.4, 1.2, -3), (0.6, 1.2, -3)], time / 90)
        return handheld(aim(eye + np.array([0, 0.025 * np.sin(0.62 * time), 0]), look), seed, time, 0.008, 0.01)

    return Scene(
        name="workshop",
        instances=(*instances, *lamp),
        lights=(
            light,
            Light(
                "point",
                (0.45, 0.6, 1.0),
                3.0,
                lambda time: LightPose(np.array([3.6, 2.9, 3.0]), np.array([0, -1, 0])),
                casts_shadow=False,
            ),
        ),
        camera=Camera(camera, np.radians(58)),
        sky=Sky(room((0.12, 0.12, 0.14), (0.24, 0.20, 0.17), (0.18, 0.14, 0.10)), sun_disc=False),
        exposure=lambda time: 1.35,
    )


def workbench(rng: Generator, wood: Material, legs: Material, steel: Material) -> Parts:
    """A bench along the back wall with a vice, planks, tools on a board above it."""
    parts: Parts = [
        (placed(box(3.6, 0.09, 0.85, 0.015, 1.2), move(-0.8, 0.9, -2.95)), wood),
        (placed(box(3.4, 0.05, 0.7, 0.01, 1.2), move(-0.8, 0.25, -2.95)), legs),
    ]
    parts += [
        (placed(box(0.11, 0.86, 0.11, 0.012), move(x, 0.43, z)), legs) for x in (-2.5, -0.8, 0.9) for z in (-3.3, -2.6)
    ]
    vice = [
        placed(box(0.14, 0.2, 0.16, 0.02), move(0, 0.1, 0)),
        placed(box(0.14, 0.16, 0.05, 0.01), move(0, 0.17, 0.19)),
        tube([(0, 0.12, 0), (0, 0.12, 0.34)], 0.018, 8),
        tube([(-0.12, 0.12, 0.33), (0.12, 0.14, 0.33)], 0.009, 6),
    ]
    parts.append((placed(join(vice), move(0.4, 0.945, -2.72)), plain(rgb("2f5a78"), 0.4, 0.5)))
    parts += at(move(-2.3, 0.945, -3.15), bottles(rng, 1.2, 8))
    parts.append((placed(box(2.4, 1.0, 0.03, 0.005, 1.0), move(-0.9, 1.9, -3.47)), legs))
    for k in range(13):
        x, long = -1.95 + 0.175 * k, rng.uniform(0.22, 0.5)
        handle = placed(cylinder(0.016, long * 0.45, 8), move(x, 2.3 - long, -3.42))
        blade = placed(box(rng.uniform(0.02, 0.09), long * 0.55, 0.012, 0.003), move(x, 2.3 - long * 0.28, -3.42))
        parts += [(handle, plain(rgb(str(rng.choice(["b5382c", "c98f2f", "2f3b46"]))), 0.4)), (blade, steel)]
    for k in range(5):
        plank = box(rng.uniform(1.2, 2.4), 0.03, 0.16, 0.004, 1.0)
        parts.append(
            (
                placed(
                    plank,
                    move(-1.0 + rng.uniform(-0.3, 0.3), 0.31 + 0.034 * k, -2.95),
                    turn("y", rng.uniform(-0.08, 0.08)),
                ),
                wood,
            )
        )
    return parts


def shelves(rng: Generator, wood: Material) -> Parts:
    """Shelves on the left wall, full of tins and crates."""
    parts: Parts = [(placed(box(0.05, 2.3, 0.4, 0.008, 1.0), move(-3.8, 1.15, z)), wood) for z in (-2.0, 0.0)]
    for y in (0.35, 0.95, 1.5, 2.05):
        parts.append((placed(box(0.42, 0.035, 2.0, 0.006, 1.0), move(-3.78, y, -1.0)), wood))
        parts += at(move(-3.75, y + 0.018, -0.1) @ turn("y", np.pi / 2), bottles(rng, 1.8, 9))
    paint = scratched_paint(rng, rgb("58705a"))
    for k in range(3):
        parts.append(
            (
                placed(
                    box(0.5, 0.36, 0.5, 0.02, 0.6),
                    move(3.3 - 0.06 * k, 0.18 + 0.365 * (k % 2), -2.9 + 0.55 * (k // 2)),
                    turn("y", 0.1 * k),
                ),
                paint,
            )
        )
    return parts


def pipes(rng: Generator) -> Parts:
    """Copper and painted pipes along the walls, a cable from the ceiling."""
    copper, cable = plain(rgb("c98d66"), 0.28, 1.0), plain(rgb("191a1c"), 0.5)
    parts: Parts = []
    for k in range(3):
        y = 2.75 + 0.13 * k
        parts.append(
            (
                tube(
                    [
                        (-3.9, y, -3.38),
                        (1.9, y, -3.38),
                        (2.0 + 0.1 * k, y - 0.05, -3.38),
                        (2.05 + 0.1 * k, y - 0.2, -3.38),
                        (2.05 + 0.1 * k, 0, -3.38),
                    ],
                    0.028,
                    10,
                ),
                copper,
            )
        )
    parts += [
        (wire((-3.9, 3.3, z), (3.9, 3.25, z + 0.6), rng.uniform(0.15, 0.4), 0.007), cable) for z in (-1.8, -0.3, 1.2)
    ]
    parts.append((placed(box(0.62, 0.9, 0.16, 0.02), move(3.0, 1.6, -3.42)), plain(rgb("8d938f"), 0.4, 0.6)))
    return parts


def floor_fan(rng: Generator, place: Float[ndarray, "4 4"], number: int) -> list[Instance]:
    """A big fan on a stand, 5 to 9 turns a second, behind a wire guard."""
    grey, blade = plain(rgb("33383d"), 0.4, 0.7), plain(rgb(str(rng.choice(["d8b23a", "b8bcc0", "b5472f"]))), 0.3, 0.5)
    head = move(0, 1.25, 0) @ turn("x", np.pi / 2)
    angle = np.linspace(0, 2 * np.pi, 41)
    rings = [
        tube(np.stack([r * np.cos(angle), 0 * angle + h, r * np.sin(angle)], axis=1), 0.006, 5, closed=True)
        for r, h in ((0.5, 0.0), (0.49, 0.12), (0.34, 0.16), (0.2, 0.18), (0.49, -0.12))
    ]
    bars = [
        tube(
            [
                (0.06 * np.cos(a), 0.18, 0.06 * np.sin(a)),
                (0.35 * np.cos(a), 0.16, 0.35 * np.sin(a)),
                (0.5 * np.cos(a), 0.06, 0.5 * np.sin(a)),
                (0.5 * np.cos(a), -0.12, 0.5 * np.sin(a)),
            ],
            0.004,
            4,
        )
        for a in np.linspace(0, 2 * np.pi, 33)[:-1]
    ]
    stand = [
        cylinder(0.3, 0.05, 32),
        cylinder(0.03, 1.2, 12),
        placed(cylinder(0.1, 0.3, 20), move(0, 1.25, -0.02), turn("x", -np.pi / 2)),
    ]
    still = join([placed(join(rings + bars), head), *stand])
    speed = rng.uniform(1.0, 1.9) * rng.choice([-1, 1])
    return [
        Instance(still, grey, 0, lambda time: Pose(place)),
        Instance(
            fan_blades(0.45, 5, 0.2, 0.5), blade, number, lambda time: Pose(place @ head @ turn("y", speed * time))
        ),
    ]


def bicycle_wheel(rng: Generator, number: int) -> list[Instance]:
    """A wheel with wire spokes turning on the wall."""
    rim = lathe(
        [(0.30, -0.012), (0.33, -0.018), (0.345, 0), (0.33, 0.018), (0.30, 0.012), (0.30, -0.012)], 56, crease=60
    )
    spokes = [
        tube([(0.02, 0.03 * (-1) ** k, 0), (0.30 * np.cos(0.25), 0, 0.30 * np.sin(0.25) * (-1) ** k)], 0.0022, 4)
        for k in range(2)
    ]
    mesh = join(
        [rim, placed(cylinder(0.025, 0.08, 12), move(0, -0.04, 0))]
        + [placed(spokes[k % 2], turn("y", 2 * np.pi * k / 28)) for k in range(28)]
    )
    place, speed = move(1.6, 2.0, -3.3) @ turn("x", np.pi / 2), rng.uniform(0.12, 0.3)
    return [Instance(mesh, plain(rgb("c9ccd0"), 0.2, 1.0), number, lambda time: Pose(place @ turn("y", speed * time)))]


def hanging_lamp(swing: float, phase: float, long: float, number: int) -> tuple[list[Instance], Light]:
    """A shaded lamp on a cord, swinging like a pendulum, and the light in it."""
    shade = lathe([(0.24, -0.02), (0.22, 0.06), (0.12, 0.16), (0.05, 0.2), (0.03, 0.26)], 32)
    inside = lathe([(0.03, 0.255), (0.045, 0.195), (0.115, 0.155), (0.215, 0.055), (0.235, -0.02)], 32)
    cord = placed(cylinder(0.006, long, 6), move(0, 0.25, 0))
    enamel, white, glow = plain(rgb("2b4a3c"), 0.25), plain(rgb("f4efe2"), 0.4), plain(rgb("ffd9a8"), 0.3, 0.0, 60.0)

    def place(time: float) -> Float[ndarray, "4 4"]:
        t = 0.115 * time + phase
        return (
            move(-0.3, 3.4, -1.0)
            @ turn("z", swing * np.sin(t))
            @ turn("x", 0.4 * swing * np.sin(1.03 * t + 1))
            @ move(0, -long - 0.25, 0)
        )

    def pose(time: float) -> Pose:
        return Pose(place(time))

    def light(time: float) -> LightPose:
        matrix = place(time)
        return LightPose((matrix @ (0, 0.0, 0, 1))[:3], -unit(matrix[:3, 1]))

    parts = [
        (shade, enamel, True),
        (cord, enamel, True),
        (inside, white, True),
        (placed(ball(0.05, 16), move(0, 0.03, 0)), glow, False),
    ]
    instances = [Instance(mesh, material, number, pose, casts_shadow=casts) for mesh, material, casts in parts]
    return instances, Light(
        "spot", (1.0, 0.78, 0.52), 40.0, light, radius=0.04, inner_cone=1.05, outer_cone=1.35, reach=14.0
    )


def gallery(seed: int) -> Scene:
    """A gallery: polished chequered floor, paintings, metal sculptures that turn, a cut to a close view half way."""
    rng = np.random.default_rng([seed, 3])
    palette = np.stack(
        [
            rgb(c)
            for c in (
                ["f2ead8", "d94f30", "20364f", "e8b23a", "5f8f86", "111111"],
                ["efe6da", "2e5d9f", "e2795b", "1d1d24", "f4c95d", "9fb8ad"],
            )[seed % 2]
        ]
    )
    white = plaster(rng, rgb(["e9e4da", "c9cfd2", "dccfc0"][seed % 3]), 0.1)
    floor = Instance(level(16, 9, 4.0), marble_checks(rng, rgb("e6e0d4"), rgb("2c2b2e")), mirror=0)
    parts = walls(16, 9, 4.6, 3.0, white)
    parts += [(placed(level(16.2, 9.2, 3.0), move(0, 4.6, 0), turn("x", np.pi)), white)]
    strip = plain(rgb("fff6e8"), 0.5, 0.0, 9.0)
    parts += [(placed(box(14, 0.05, 0.16, 0.01), move(0, 4.55, z)), strip) for z in (-2.2, 2.2)]
    frame = brushed_steel(rng, rgb("c9a227"))
    lights: list[Light] = []
    for k, x in enumerate(np.linspace(-5.6, 5.6, 5)):
        parts += painting(rng, palette, frame, x)
        lights += [picture_light(x)] if k in (1, 3) else []
    parts += at(move(0, 0, 3.2), bench(boards(rng, rgb("a0764a"), 8)))
    parts += [(placed(box(16, 0.16, 0.05, 0.01), move(0, 0.08, -4.47)), plain(rgb("2a2a2c"), 0.4))]
    instances = standing(parts)
    turns = rng.uniform(0.02, 0.06, 3) * rng.choice([-1, 1], 3)
    looks = (
        plain(rgb("f0c560"), 0.16, 1.0),
        plain(rgb("e6e8ea"), 0.06, 1.0),
        plain(rgb(str(rng.choice(["b5302a", "1f5f7a", "2d6a4a"]))), 0.12),
    )
    for k, (x, z) in enumerate(((-3.4, -1.6), (0.3, -2.2), (3.8, -1.5))):
        instances += sculpture(rng, move(x, 0, z), float(turns[k]), looks[k], white, 20 + k)
    lights += [
        Light(
            "spot",
            (1.0, 0.95, 0.88),
            60.0,
            aimed((0.3, 4.4, 1.4), (0.3, 1.0, -2.2)),
            radius=0.08,
            inner_cone=0.35,
            outer_cone=0.65,
            reach=14,
        )
    ]
    drift = rng.choice([-1.0, 1.0])

    def camera(time: float) -> ndarray:
        if time < 30:
            x = drift * (-3.2 + 0.055 * time)
            return aim((x, 1.62, 3.6), (0.5 * x, 1.35, -3))
        x = drift * (0.9 - 0.014 * (time - 30))
        return aim((0.3 + x, 1.5, -0.4), (0.3, 1.36, -2.2))

    return Scene(
        name="gallery",
        instances=(*instances, floor),
        lights=tuple(lights),
        camera=Camera(camera, np.radians(56)),
        sky=Sky(
            room(
                (0.55, 0.53, 0.5),
                (0.42, 0.40, 0.37),
                (0.26, 0.25, 0.23),
                tuple(((x, 1.0, z), 0.985, 6.0) for x in (-1, 0, 1) for z in (-0.7, 0.7)),
            ),
            sun_disc=False,
        ),
        exposure=lambda time: 1.0,
        cuts=frozenset({30}),
        mirrors=(Mirror(np.zeros(3), np.array([0.0, 1.0, 0.0])),),
    )


def aimed(position: tuple[float, float, float], target: tuple[float, float, float]) -> Callable[[float], LightPose]:
    """A light that stands still and points at the target."""
    pose = LightPose(np.array(position), unit(np.array(target) - position))
    return lambda time: pose


def picture_light(x: float) -> Light:
    """A warm spot on the painting at x."""
    return Light(
        "spot",
        (1.0, 0.88, 0.7),
        45.0,
        aimed((x, 4.4, -1.6), (x, 1.7, -4.5)),
        radius=0.06,
        inner_cone=0.3,
        outer_cone=0.55,
        reach=12,
    )


def painting(rng: Generator, palette: Float[ndarray, "k 3"], frame: Material, x: float) -> Parts:
    """A framed painting on the back wall."""
    wide, tall = rng.uniform(1.3, 2.1), rng.uniform(1.2, 1.7)
    canvas = box(wide, tall, 0.03, 0.0)
    front = canvas.normals[:, 2] > 0.5
    uvs = np.where(front[:, None], canvas.positions[:, :2] / (wide, -tall) + 0.5, 0.0).astype(np.float32)
    parts: Parts = [
        (
            placed(Mesh(canvas.positions, canvas.normals, uvs, canvas.indices), move(x, 1.75, -4.46)),
            canvas_painting(rng, palette),
        )
    ]
    for side in (-1, 1):
        parts.append(
            (placed(box(0.06, tall + 0.12, 0.07, 0.015), move(x + side * (wide / 2 + 0.03), 1.75, -4.45)), frame)
        )
        parts.append((placed(box(wide, 0.06, 0.07, 0.015), move(x, 1.75 + side * (tall / 2 + 0.03), -4.45)), frame))
    return parts


def sculpture(
    rng: Generator, place: Float[ndarray, "4 4"], speed: float, metal: Material, stone: Material, number: int
) -> list[Instance]:
    """A knot turning on a pedestal; it hides and shows its own loops."""
    p, q = ((2, 3), (3, 2), (2, 5), (3, 4))[rng.integers(4)]
    shape = knot(p, q, 0.27, 0.065)
    lean = rng.uniform(-0.5, 0.5)
    return [
        Instance(box(0.6, 0.95, 0.6, 0.015, 1.2), stone, 0, lambda time: Pose(place @ move(0, 0.475, 0))),
        Instance(
            shape,
            metal,
            number,
            lambda time: Pose(place @ move(0, 1.38, 0) @ turn("y", speed * time) @ turn("x", np.pi / 2 + lean)),
        ),
    ]
