"""Held-out scene: a hangar with a walking robot, seen by a still camera. See docs/scenes.md."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from numpy.random import Generator

from framecast.render.finish import plain, rgb
from framecast.render.heldout_shapes import (
    bar,
    block,
    cord,
    disc_outline,
    hanging,
    loft,
    picture,
    pillar,
    pillow,
    prism,
    propeller,
    sheet,
)
from framecast.render.heldout_textures import (
    concrete,
    hangar_floor,
    panels,
    screen,
    weave,
)
from framecast.render.mesh import join, placed, standing
from framecast.render.motion import aim, move, scale, turn, unit
from framecast.render.scene import Camera, Instance, Light, LightPose, Material, Mesh, Mirror, Pose, Scene, Sky
from framecast.render.skies import room

Parts = list[tuple[Mesh, Material]]


def hangar(seed: int) -> Scene:
    """A still camera: a four-legged robot, a propeller, a drone, a mirroring floor, a sweeping light."""
    rng = np.random.default_rng([seed, 12])
    floor = Instance(
        placed(sheet(26, 20, 1, None, 6.5), move(0, 0, -4)),
        hangar_floor(rng, rgb(["8b9096", "7d8a84", "9a948a"][seed % 3])),
        mirror=0,
    )
    steel, grey = panels(rng, rgb("a9afb5")), concrete(rng, rgb("9fa19f"))
    parts: Parts = [
        (placed(block(26, 8, 0.3, 0.0, 3.0), move(0, 4, -14)), steel),
        (placed(block(0.3, 8, 20, 0.0, 3.0), move(-13, 4, -4)), grey),
        (placed(block(0.3, 8, 20, 0.0, 3.0), move(13, 4, -4)), grey),
    ]
    parts += trusses()
    lamp = plain(rgb("f4f8ff"), 0.4, 0.0, 14.0)
    parts += [(placed(block(2.6, 0.06, 0.22, 0.01), move(x, 6.6, z)), lamp) for x in (-6, 0, 6) for z in (-9, -3)]
    parts += consoles(rng)
    hazard = plain(rgb("d9a514"), 0.5)
    parts += [
        (
            placed(pillar([(0, 0.22), (0.03, 0.22), (0.05, 0.13), (0.5, 0.03)], 20), move(x, 0, z)),
            plain(rgb("e2571e"), 0.5),
        )
        for x, z in ((-3.6, -1.0), (3.2, -0.6), (4.4, -3.2))
    ]
    parts += [(placed(block(0.12, 1.0, 0.12, 0.01), move(x, 0.5, -5.2)), hazard) for x in np.linspace(-9, -4, 5)]
    parts.append((hanging((-9, 0.95, -5.2), (-4, 0.95, -5.2), 0.0, 0.015), hazard))
    instances = [*standing(parts), floor, *aeroplane(rng, 10), *robot(rng, 30), *drone(rng, 40)]
    phase, speed = rng.uniform(0, 6), rng.uniform(0.035, 0.06)

    def sweep(time: float) -> LightPose:
        a = phase + speed * time
        return LightPose(np.array([-4.0, 6.8, 1.0]), unit((0.55 + 0.75 * np.sin(a), -1.0, -0.65 + 0.3 * np.cos(a))))

    lights = (
        Light("spot", (1.0, 0.9, 0.72), 420.0, sweep, radius=0.12, inner_cone=0.22, outer_cone=0.48, reach=30.0),
        Light(
            "spot",
            (0.80, 0.90, 1.0),
            170.0,
            lambda time: LightPose(np.array([5.0, 7.0, -3.0]), unit((-0.35, -1.0, -0.2))),
            radius=0.25,
            inner_cone=0.6,
            outer_cone=1.1,
            reach=22.0,
        ),
    )
    eye = aim((rng.uniform(-0.6, 0.6), 1.5, 4.1), (rng.uniform(-0.4, 0.4), 1.5, -4.5))
    light = room(
        (0.42, 0.45, 0.50),
        (0.20, 0.21, 0.23),
        (0.15, 0.15, 0.15),
        tuple(((x, 1.4, z), 0.99, 9.0) for x in (-1, 0, 1) for z in (-0.8, 0.1)),
    )
    return Scene(
        name="hangar",
        instances=tuple(instances),
        lights=lights,
        camera=Camera(lambda time: eye, np.radians(54)),
        sky=Sky(light, sun_disc=False),
        mirrors=(Mirror(np.zeros(3), np.array([0.0, 1.0, 0.0])),),
        split="test",
    )


def trusses() -> Parts:
    """Roof trusses of thin struts, and the roof."""
    paint = plain(rgb("5d666c"), 0.5, 0.3)
    parts: Parts = [(placed(block(26, 0.2, 20, 0.0), move(0, 8.4, -4)), plain(rgb("3d4245"), 0.8))]
    for z in np.arange(-13, 5, 3.0):
        low, high = [(x, 7.0, z) for x in np.linspace(-13, 13, 15)], [(x, 8.1, z) for x in np.linspace(-12, 12, 14)]
        bars = [bar(low, 0.12, 0.12), bar(high, 0.12, 0.12)]
        bars += [bar([low[k], high[k]], 0.06, 0.06) for k in range(14)] + [
            bar([high[k], low[k + 1]], 0.06, 0.06) for k in range(14)
        ]
        parts.append((join(bars), paint))
    parts += [(placed(block(0.35, 7, 0.35, 0.02), move(x, 3.5, -13.7)), paint) for x in (-12, -6, 0, 6, 12)]
    return parts


def consoles(rng: Generator) -> Parts:
    """Racks with glowing screens along the back."""
    parts: Parts = []
    shell = plain(rgb("2b2f33"), 0.35, 0.4)
    tints = [rgb(c) for c in ("4fd8ff", "7dff9a", "ffb347")]
    for k, x in enumerate((-11.0, -9.2, 6.2, 8.0, 9.8)):
        parts.append((placed(block(1.6, 1.9, 0.7, 0.04), move(x, 0.95, -12.9)), shell))
        parts.append(
            (placed(picture(1.35, 0.85), move(x, 1.35, -12.53)), screen(rng, tints[(k + int(rng.integers(3))) % 3]))
        )
        parts += [
            (
                placed(block(0.06, 0.03, 0.03, 0.005), move(x - 0.5 + 0.1 * j, 0.72, -12.53)),
                plain(tints[j % 3], 0.3, 0.0, 5.0),
            )
            for j in range(10)
            if rng.random() < 0.7
        ]
    return parts


def aeroplane(rng: Generator, number: int) -> list[Instance]:
    """A small propeller plane, nose to the camera's right; the propeller turns too fast for one frame to the next."""
    place = move(1.8, 1.75, -7.0) @ turn("y", -0.9 + rng.uniform(-0.2, 0.2))
    colour = rgb(str(rng.choice(["d8dadc", "c23a2a", "2f5f8a", "e0b23a"])))
    skin, dark = plain(colour, 0.25, 0.3), plain(rgb("17191b"), 0.5)
    stations = (
        (-4.0, 0.10, 0.18, 0.35),
        (-2.6, 0.26, 0.36, 0.2),
        (-0.8, 0.52, 0.62, 0.05),
        (0.6, 0.58, 0.70, 0.0),
        (1.7, 0.52, 0.6, -0.05),
        (2.3, 0.36, 0.42, -0.08),
    )
    flat = disc_outline(1.0, 26)
    rings = np.stack([np.column_stack([np.full(26, x), flat[:, 1] * b + y, flat[:, 0] * a]) for x, a, b, y in stations])
    body = [
        loft(rings[:, ::-1], crease=60),
        placed(wing(9.5, 1.45), move(0.7, 0.62, 0)),
        placed(wing(3.0, 0.8), move(-3.6, 0.4, 0)),
        placed(wing(2.4, 0.95), move(-3.65, 0.45, 0), turn("x", np.pi / 2), move(0, 0, 0.55), scale(1, 1, 0.6)),
    ]
    glass = placed(pillow(0.85, 0.46, 0.50, 0.8), move(0.35, 0.62, 0))
    legs = [bar([(0.9, -0.5, 0), (1.0, -1.0, s * 0.9), (1.0, -1.42, s * 1.0)], 0.08, 0.08) for s in (-1, 1)]
    tyres = [placed(prism(disc_outline(0.3, 24), 0.16, 0.05), move(1.0, -1.45, s * 1.0 - 0.08)) for s in (-1, 1)]
    struts = [cord(np.array([(0.7, -0.35, s * 0.5), (0.8, 0.1, s * 1.5), (0.8, 0.55, s * 2.5)]), 0.03) for s in (-1, 1)]
    still: Parts = [
        (placed(join(body), place), skin),
        (placed(glass, place), plain(rgb("0f1418"), 0.04)),
        (placed(join(legs + tyres + struts), place), dark),
    ]
    speed = rng.uniform(0.7, 1.6)
    hub = place @ move(2.42, -0.08, 0) @ turn("y", np.pi / 2)
    blades = Instance(
        propeller(1.05, 3, 0.2),
        plain(rgb("3a3d40"), 0.3, 0.8),
        number,
        lambda time: Pose(hub @ turn("z", speed * time)),
    )
    return [*standing(still), blades]


def wing(span: float, chord: float) -> Mesh:
    """A tapered wing along z, its nose towards +x."""
    section = np.array([(0.5, 0), (0.3, 0.07), (-0.1, 0.08), (-0.5, 0), (-0.1, -0.03), (0.3, -0.045)])
    rings = []
    for t in np.linspace(-1, 1, 11):
        wide = chord * (1 - 0.35 * abs(t)) * (1 if abs(t) < 1 else 0.7)
        rings.append(
            np.column_stack(
                [section[:, 0] * wide, section[:, 1] * wide + 0.09 * abs(t) * span / 8, np.full(6, t * span / 2)]
            )
        )
    return loft(np.stack(rings), crease=50)


LEGS = ((0.55, 0.32), (0.55, -0.32), (-0.55, 0.32), (-0.55, -0.32))
"""Hips of the robot (x forward, z), front pair first."""
UPPER, LOWER, HIP = 0.42, 0.44, 0.78


def robot_joints(distance: float) -> Float[ndarray, "j 4 4"]:
    """Joint matrices (pose @ inverse rest) after trotting `distance` metres along +x: the body, then each leg.

    Two joints a leg, upper and lower.

    Diagonal legs move together; a standing foot keeps its place on the ground.
    """
    stride, joints = (
        0.9,
        [
            move(0, -0.04 + 0.015 * np.cos(8 * np.pi * distance / 0.9), 0)
            @ turn("z", 0.02 * np.sin(4 * np.pi * distance / 0.9))
        ],
    )
    for k, (x, z) in enumerate(LEGS):
        phase = (distance / stride + (0.0 if k in (0, 3) else 0.5)) % 1.0
        if phase < 0.55:
            reach, lift = stride * (0.275 - phase), 0.0
        else:
            t = (phase - 0.55) / 0.45
            reach, lift = stride * 0.275 * (2 * t * t * (3 - 2 * t) - 1), 0.16 * np.sin(np.pi * t)
        body = joints[0]
        hip = (body @ (x, HIP, z, 1))[:3]
        dx, dy = x + reach - hip[0], hip[1] - lift - 0.03
        far = min(float(np.hypot(dx, dy)), UPPER + LOWER - 1e-4)
        bend = np.pi - np.arccos((UPPER**2 + LOWER**2 - far**2) / (2 * UPPER * LOWER))
        inner = np.arccos((UPPER**2 + far**2 - LOWER**2) / (2 * UPPER * far))
        upper = np.arctan2(dx, dy) - inner
        thigh = move(*hip) @ turn("z", upper) @ move(-x, -HIP, -z)
        shin = thigh @ move(x, HIP - UPPER, z) @ turn("z", bend) @ move(-x, UPPER - HIP, -z)
        joints += [thigh, shin]
    return np.stack(joints)


def robot(rng: Generator, number: int) -> list[Instance]:
    """A four-legged robot, its parts bound to nine joints, walking along x through the middle of the view."""
    shell, black, fibre = (
        plain(rgb(str(rng.choice(["e8c02e", "e5e6e4", "d2502c"]))), 0.3),
        plain(rgb("202225"), 0.45, 0.3),
        weave(rng, rgb("3c3f44")),
    )
    hull = join(
        [
            placed(pillow(0.66, 0.15, 0.23, 0.4), move(0, 0.84, 0)),
            placed(pillow(0.16, 0.10, 0.16, 0.5), move(0.72, 0.90, 0)),
        ]
    )
    trim = join(
        [
            placed(block(0.9, 0.05, 0.3, 0.02), move(-0.05, 1.0, 0)),
            placed(pillar([(0, 0.09), (0.08, 0.09), (0.12, 0.05)], 20), move(-0.3, 1.02, 0)),
            cord(np.array([(0.3, 1.0, 0.1), (0.31, 1.2, 0.1), (0.29, 1.42, 0.1)]), 0.006),
        ]
    )
    eyes = join([placed(pillow(0.02, 0.03, 0.03, 1.0, 12), move(0.87, 0.92, s * 0.08)) for s in (-1, 1)])
    upper, lower, pads = [], [], []
    for k, (x, z) in enumerate(LEGS):
        out = 0.06 * np.sign(z)
        upper.append(
            bound(
                join(
                    [
                        placed(prism(disc_outline(0.10, 24), 0.12, 0.015), move(x, HIP, z - 0.06 + out)),
                        placed(pillow(0.075, 0.24, 0.055, 0.6), move(x, HIP - 0.2, z + out)),
                    ]
                ),
                1 + 2 * k,
            )
        )
        lower.append(
            bound(
                join(
                    [
                        placed(prism(disc_outline(0.06, 20), 0.10, 0.01), move(x, HIP - UPPER, z - 0.05 + out)),
                        bar(
                            [(x, HIP - UPPER, z + out), (x, HIP - UPPER - 0.2, z + out), (x, 0.0, z + out)], 0.05, 0.045
                        ),
                    ]
                ),
                2 + 2 * k,
            )
        )
        pads.append(
            bound(placed(pillow(0.05, 0.045, 0.045, 0.9, 14), move(x, HIP - UPPER - LOWER + 0.03, z + out)), 2 + 2 * k)
        )
    speed, begin, lane = 1.1 / 30, rng.uniform(-2.6, -1.6), rng.uniform(0.2, 0.9)

    def pose(time: float) -> Pose:
        return Pose(np.eye(4), joints=move(begin + speed * time, 0, lane) @ robot_joints(speed * time))

    pieces = [
        (bound(hull, 0), shell),
        (bound(trim, 0), black),
        (bound(eyes, 0), plain(rgb("6fe0ff"), 0.2, 0.0, 20.0)),
        (skins(upper), fibre),
        (skins(lower), black),
        (skins(pads), plain(rgb("b0402a"), 0.8)),
    ]
    return [Instance(mesh, material, number, pose) for mesh, material in pieces]


def bound(mesh: Mesh, joint: int) -> Mesh:
    """The mesh bound to one joint."""
    joints, weights = np.zeros((len(mesh.positions), 4), np.uint16), np.zeros((len(mesh.positions), 4), np.float32)
    joints[:, 0], weights[:, 0] = joint, 1.0
    return replace(mesh, joints=joints, weights=weights)


def skins(meshes: list[Mesh]) -> Mesh:
    """Bound meshes joined, skins kept."""
    joints = np.concatenate([mesh.joints for mesh in meshes if mesh.joints is not None])
    weights = np.concatenate([mesh.weights for mesh in meshes if mesh.weights is not None])
    return replace(join(meshes), joints=joints, weights=weights)


def drone(rng: Generator, number: int) -> list[Instance]:
    """A quadcopter that hovers and darts across, four spinning rotors."""
    body = join(
        [placed(pillow(0.16, 0.06, 0.12, 0.5), move(0, 0, 0))]
        + [
            bar([(0, 0.0, 0), (0.15 * a, 0.01, 0.15 * b), (0.3 * a, 0.02, 0.3 * b)], 0.035, 0.025)
            for a in (-1, 1)
            for b in (-1, 1)
        ]
    )
    rotor = placed(propeller(0.2, 2, 0.05), turn("x", -np.pi / 2))
    start, side = rng.uniform(0, 6), rng.choice([-1, 1])

    def place(time: float) -> ndarray:
        s = 0.055 * time + start
        return (
            move(side * 2.8 * np.sin(s), 2.75 + 0.35 * np.sin(1.7 * s), -3.4 + 0.9 * np.cos(1.3 * s))
            @ turn("z", -side * 0.3 * np.cos(s))
            @ turn("y", 0.7 * s)
        )

    def spinning(a: int, b: int) -> Instance:
        def pose(time: float) -> Pose:
            return Pose(place(time) @ move(0.3 * a, 0.06, 0.3 * b) @ turn("y", a * b * 1.3 * time))

        return Instance(rotor, dark, number, pose)

    dark = plain(rgb("4a4d50"), 0.4)
    rotors = [spinning(a, b) for a in (-1, 1) for b in (-1, 1)]
    light = placed(pillow(0.025, 0.025, 0.025, 1.0, 10), move(0.16, -0.02, 0))
    return [
        Instance(body, plain(rgb("26282b"), 0.35, 0.2), number, lambda time: Pose(place(time))),
        *rotors,
        Instance(light, plain(rgb("ff4030"), 0.3, 0.0, 25.0), number, lambda time: Pose(place(time))),
    ]
