"""Training scene: a wet street full of neon at night. See docs/scenes.md."""

from collections.abc import Callable

import numpy as np
from numpy import ndarray
from numpy.random import Generator

from framecast.render.finish import plain, rgb
from framecast.render.mesh import box_uvs, join, placed, standing
from framecast.render.motion import aim, along, ease, handheld, move, turn, unit
from framecast.render.scene import Camera, Instance, Light, LightPose, Material, Mesh, Mirror, Pose, Scene, Sky
from framecast.render.skies import dome
from framecast.render.train_character import walker
from framecast.render.train_props import at, car, lamp_post, rolling
from framecast.render.train_shapes import box, level, tube, wire
from framecast.render.train_textures import (
    asphalt,
    cobbles,
    lit_windows,
    neon_sign,
    plaster,
    shop_window,
)

Parts = list[tuple[Mesh, Material]]


def neon(seed: int) -> Scene:
    """Night after rain: signs, lit windows and lamps mirrored in the road, headlights sweep, exposure adapts."""
    rng = np.random.default_rng([seed, 5])
    road = Instance(placed(level(9, 70, 4.0), move(0, 0, -25)), asphalt(rng, wet=1.0), mirror=0)
    pavement, kerb = cobbles(rng, rgb("6d6c70")), plaster(rng, rgb("77767a"), 0.6)
    parts: Parts = []
    for s in (-1, 1):
        parts += [
            (placed(level(5, 70, 1.6), move(s * 7, 0.14, -25)), pavement),
            (placed(box(0.24, 0.16, 70, 0.03, 1.0), move(s * 4.5, 0.07, -25)), kerb),
        ]
    lights: list[Light] = []
    colours = ["ff2e6a", "22d3ff", "ffb01f", "8b5cff", "35ff8f", "ff5a2a"]
    rng.shuffle(colours)
    parts += night_houses(rng, colours)
    for k, (s, z) in enumerate(((-1, -4.0), (1, -10.0), (-1, -17.0), (1, -24.0))):
        parts += at(move(s * 5.0, 0.14, z) @ turn("y", 0 if s < 0 else np.pi), lamp_post(25.0))
        if k < 3:
            lights.append(
                Light(
                    "spot",
                    (1.0, 0.72, 0.42),
                    130.0,
                    lamp_at(s * 4.1, 4.0, z),
                    radius=0.17,
                    inner_cone=0.5,
                    outer_cone=1.25,
                    reach=12.0,
                    casts_shadow=k < 2,
                )
            )
    parts += [
        (wire((-9.2, y, z), (9.2, y + 0.5, z - 1), 0.8, 0.012), plain(rgb("060708"), 0.5))
        for y, z in ((7.5, -6), (7.0, -13), (8.5, -19))
    ]
    instances = [*standing(parts), road]
    instances += turning_sign(rng, colours[5], 30)
    speed = rng.uniform(0.24, 0.34)

    def oncoming(time: float) -> tuple[ndarray, float]:
        return move(-1.9, 0, -34 + speed * time) @ turn("y", -np.pi / 2), speed * time

    instances += rolling(car(rng), 31, oncoming, 0.33, (-1.22, 1.22), 0.72)

    def headlight(time: float) -> LightPose:
        return LightPose(np.array([-1.9, 0.68, -31.9 + speed * time]), unit((0.02, -0.06, 1.0)))

    lights.append(
        Light("spot", (1.0, 0.95, 0.85), 260.0, headlight, radius=0.12, inner_cone=0.1, outer_cone=0.35, reach=26.0)
    )
    pace, begin = 1.35 / 30, rng.uniform(-9.0, -7.5)

    def stroll(time: float) -> tuple[ndarray, float]:
        return move(2.2, 0, begin + pace * time), pace * time

    coat = plain(rgb(str(rng.choice(["c9a227", "a83240", "3f5f8f"]))), 0.35)
    instances += walker(rng, 32, stroll, (coat, plain(rgb("1c1f26"), 0.7), plain(rgb("d8d8d8"), 0.4)))
    signs = ((-4.6, 4.2, -7.0, 0), (4.6, 3.6, -9.5, 1), (4.6, 5.0, -3.0, 2))
    for x, y, z, k in signs:
        tint = rgb(colours[k])
        lights.append(
            Light(
                "point",
                (float(tint[0]), float(tint[1]), float(tint[2])),
                42.0,
                lamp_at(x * 0.93, y, z),
                reach=11.0,
                casts_shadow=False,
            )
        )
    night = dome(rgb("161d38"), rgb("4a3a55"), rgb("16161a"), (0, 0.1, -1), (0.10, 0.06, 0.07))
    drift = rng.choice([-1.0, 1.0])

    def camera(time: float) -> ndarray:
        look = along([(-4.0 * drift, 2.3, -12), (0.0, 2.1, -12), (3.0 * drift, 2.4, -12)], time / 70)
        return handheld(aim((0.6 - 0.004 * drift * time, 1.6, 3.2 - 0.012 * time), look), seed, time, 0.003, 0.004)

    return Scene(
        name="neon",
        instances=tuple(instances),
        lights=tuple(lights),
        camera=Camera(camera, np.radians(58)),
        sky=Sky(night, sun_disc=False),
        exposure=lambda time: 1.15 - 0.35 * ease(time, 5, 50),
        mirrors=(Mirror(np.zeros(3), np.array([0.0, 1.0, 0.0])),),
        haze=0.008,
    )


def lamp_at(x: float, y: float, z: float) -> Callable[[float], LightPose]:
    """A lamp that hangs still and shines down."""
    pose = LightPose(np.array([x, y, z]), np.array([0.0, -1.0, 0.0]))
    return lambda time: pose


def night_houses(rng: Generator, colours: list[str]) -> Parts:
    """Houses on both sides with lit windows above, shops below and upright signs that stand out from the wall."""
    parts: Parts = []
    walls = [lit_windows(rng, rgb(tone)) for tone in ("8a8290", "7f7a70", "94806f")]
    board, shops = plain(rgb("4a4640"), 0.6), [shop_window(rng, rgb(tone)) for tone in ("ffd9a0", "ffe9cf", "bfe0ff")]
    signs = [neon_sign(rng, rgb(code)) for code in colours[:5]]
    n = 0
    for s in (-1, 1):
        z = 6.0
        while z > -55:
            deep, high = rng.uniform(6, 9), float(rng.choice([9.0, 12.0, 15.0, 18.0]))
            face = box(6, high, deep - 0.05, 0.02)
            face = box_uvs(face, 9.0)
            parts.append((placed(face, move(s * 12.5, 4.2 + high / 2, z - deep / 2)), walls[n % 3]))
            parts.append((placed(box(6, 4.2, deep - 0.05, 0.02), move(s * 12.5, 2.1, z - deep / 2)), board))
            display = placed(uv_panel(2.1, 2.3), turn("y", -s * np.pi / 2))
            parts += [
                (placed(display, move(s * 9.47, 1.55, z - 1.5 - 2.4 * k)), shops[(n + k) % 3])
                for k in range(int(deep / 2.5))
                if rng.random() < 0.75
            ]
            parts += [
                (placed(box(0.3, 4.0, 0.3, 0.04), move(s * 9.5, 2.0, z - 0.25 - 2.4 * k)), board)
                for k in range(int(deep / 2.4) + 1)
            ]
            panel = placed(uv_panel(1.5, 0.75), turn("z", np.pi / 2))
            for k, (out, high_at) in enumerate(((8.7, 4.6), (8.8, 7.2))):
                material = signs[(n * 2 + k) % 5]
                for face_turn in (0, np.pi):
                    parts.append(
                        (
                            placed(
                                panel,
                                move(s * out, high_at + rng.uniform(-0.4, 0.4), z - 1.2 - 2.4 * k),
                                turn("y", face_turn),
                                move(0, 0, 0.05),
                            ),
                            material,
                        )
                    )
            wide = placed(uv_panel(2.6, 0.8), turn("y", -s * np.pi / 2))
            parts.append((placed(wide, move(s * 9.42, 3.4, z - deep / 2)), signs[(n * 3 + 1) % 5]))
            z, n = z - deep, n + 1
    return parts


def uv_panel(wide: float, tall: float) -> Mesh:
    """A board in the xy plane facing +z that shows a texture once."""
    mesh = placed(level(wide, tall), turn("x", np.pi / 2))
    uvs = (mesh.positions[:, :2] / (wide, -tall) + 0.5).astype(np.float32)
    return Mesh(mesh.positions, mesh.normals, uvs, mesh.indices)


def turning_sign(rng: Generator, code: str, number: int) -> list[Instance]:
    """A glowing cube that turns on a bracket over the pavement."""
    sign = neon_sign(rng, rgb(code))
    cube = join([placed(uv_panel(1.0, 1.0), turn("y", k * np.pi / 2), move(0, 0, 0.5)) for k in range(4)])
    place, speed = move(5.6, 4.4, -3.6), rng.uniform(0.05, 0.1)
    bracket = tube([(9.4, 5.2, -3.6), (5.6, 5.2, -3.6), (5.6, 4.9, -3.6)], 0.03, 6)
    lid = [placed(box(1.04, 0.05, 1.04, 0.01), move(0, y, 0)) for y in (-0.51, 0.51)]
    dark = plain(rgb("15161a"), 0.4, 0.6)
    return [
        Instance(bracket, dark),
        *(
            Instance(mesh, material, number, lambda time: Pose(place @ turn("y", speed * time)))
            for mesh, material in ((cube, sign), (join(lid), dark))
        ),
    ]
