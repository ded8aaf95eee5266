"""Training scene: things of every kind at random, another world for every seed. See docs/scenes.md."""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from numpy.random import Generator

from framecast.render import train_textures as textures
from framecast.render.finish import linear, plain
from framecast.render.mesh import box_uvs, join, placed
from framecast.render.motion import aim, along, handheld, move, turn, unit
from framecast.render.scene import Camera, Instance, Light, LightPose, Material, Mesh, Mirror, Pose, Scene, Sky
from framecast.render.skies import dome, room, sun_travel
from framecast.render.train_shapes import ball, box, cylinder, fan_blades, knot, lathe, level, railing, tube, wire

Way = Callable[[float], Float[ndarray, "4 4"]]
"""Where a thing is at a time."""

SPREAD = 5.0
"""Half the width of the stage, metres."""


def medley(seed: int) -> Scene:
    """Things, materials, lights, ways and a camera drawn at random: another world for every seed."""
    rng = np.random.default_rng([seed, 7])
    indoors, mirrored = rng.random() < 0.4, rng.random() < 0.3
    materials = [patterned(rng) for _ in range(5)] + [simple(rng) for _ in range(9)]
    floor = Instance(placed(level(40, 40, rng.uniform(1, 4)), turn("y", rng.uniform(0, 6))), materials[0])
    if mirrored:
        floor = Instance(floor.mesh, gloss(rng), mirror=0)
    instances = [floor, *(walls(rng) if indoors else [])]
    for number in range(1, int(rng.integers(34, 60))):
        material = materials[int(rng.integers(len(materials)))]
        instances.append(thing(rng, material, number if rng.random() < 0.45 else 0))
    instances += bars(rng, materials)
    tint = linear(0.5 * shade(rng, 0.3) + 0.3)
    lamps = [lamp(rng, indoors) for _ in range(rng.integers(2, 4) if indoors else rng.integers(0, 3))]
    lights, sky = tuple(lamps), Sky(night(rng), room(tint * 0.8, tint * 0.55, tint * 0.35), sun_disc=False)
    if not indoors:
        light, sky = day(rng)
        lights = (light, *lights)
    brighter = rng.uniform(-0.004, 0.004) if rng.random() < 0.3 else 0.0
    return Scene(
        name="medley",
        instances=tuple(instances),
        lights=lights,
        camera=Camera(viewer(rng, seed), np.radians(rng.uniform(42, 72))),
        sky=sky,
        exposure=lambda time: 1.1 * np.exp(brighter * time),
        mirrors=(Mirror(np.zeros(3), np.array([0.0, 1.0, 0.0])),) if mirrored else (),
        haze=float(rng.choice([0.0, 0.0, 0.01, 0.03])),
        shadow_distance=30.0,
    )


# Surfaces.


def shade(rng: Generator, least: float = 0.0) -> Float[ndarray, "3"]:
    """A colour, sRGB: any hue, often pale, its brightest channel at least `least`."""
    pure = rng.random(3)
    colour = pure + (pure.mean() - pure) * rng.uniform(0, 1) ** 0.5
    return np.clip(colour / colour.max() * rng.uniform(max(least, 0.12), 1.0), 0, 1)


def simple(rng: Generator) -> Material:
    """One colour: matt, glossy or metal of any roughness; one in ten glows."""
    metallic = float(rng.choice([0.0, 1.0, rng.random()], p=[0.55, 0.35, 0.1]))
    glow = float(rng.uniform(1, 6)) if rng.random() < 0.1 else 0.0
    return plain(shade(rng, 0.4 if metallic else 0.0), float(rng.uniform(0.04, 1.0)), metallic, glow)


def gloss(rng: Generator) -> Material:
    """A polished floor."""
    return plain(shade(rng), float(rng.uniform(0.04, 0.3)), float(rng.random() < 0.3))


def patterned(rng: Generator) -> Material:
    """One of the textures, in any colour."""
    make: Sequence[Callable[[], Material]] = (
        lambda: textures.plaster(rng, shade(rng), rng.random()),
        lambda: textures.bricks(rng, shade(rng)),
        lambda: textures.cobbles(rng, shade(rng)),
        lambda: textures.boards(rng, shade(rng), int(rng.integers(3, 12)), rng.uniform(0.1, 0.8)),
        lambda: textures.asphalt(rng, rng.random()),
        lambda: textures.marble_checks(rng, shade(rng, 0.7), shade(rng)),
        lambda: textures.scratched_paint(rng, shade(rng)),
        lambda: textures.brushed_steel(rng, shade(rng, 0.5)),
        lambda: textures.roof_tiles(rng, shade(rng)),
        lambda: textures.canvas_painting(rng, np.stack([shade(rng) for _ in range(5)])),
    )
    return make[int(rng.integers(len(make)))]()


# Things.


def thing(rng: Generator, material: Material, number: int) -> Instance:
    """A solid somewhere on the stage; with a number it moves."""
    size = float(np.exp(rng.uniform(np.log(0.2), np.log(2.2))))
    tilt = turn("y", rng.uniform(0, 6.3)) @ turn("x", rng.uniform(-0.5, 0.5) * (rng.random() < 0.5))
    mesh = placed(solid(rng, size), tilt)
    place = np.array([rng.uniform(-1, 1) * SPREAD, rng.uniform(0, 2.8) ** 1.3 * 0.6 + size * 0.4, rng.uniform(-7, 1.5)])
    if number == 0:
        mesh = placed(mesh, move(*place))
        return Instance(mesh, material)
    path = way(rng, place)
    return Instance(mesh, material, number, lambda time: Pose(path(time)))


def solid(rng: Generator, size: float) -> Mesh:
    """A shape of about the size, metres, around the origin."""
    a, b, c = size * rng.uniform(0.3, 1.2, 3)
    heights = np.linspace(-0.5, 0.5, 7) * size * 1.4
    profile = [(0.0, heights[0]), *zip(size * rng.uniform(0.08, 0.55, 7), heights, strict=True), (0.0, heights[-1])]
    turns = np.linspace(0, rng.uniform(6, 20), 60)
    coil = np.stack([0.4 * size * np.cos(turns), np.linspace(-0.6, 0.6, 60) * size, 0.4 * size * np.sin(turns)], 1)
    make: Sequence[Callable[[], Mesh]] = (
        lambda: box(a, b, c, 0.03 * size, 0.7),
        lambda: box(a * 1.5, b * 1.5, 0.02, 0.002, 0.7),
        lambda: ball(size * 0.5, 28, 0.7),
        lambda: placed(cylinder(a * 0.5, b * 1.5, 28, 0.02, 0.7), move(0, -b * 0.75, 0)),
        lambda: lathe(profile, 28, 0.7, 35),
        lambda: knot(int(rng.integers(1, 4)), int(rng.choice([2, 3, 5])), size * 0.45, size * 0.08, 180, 12),
        lambda: tube(coil, size * rng.uniform(0.02, 0.07), 8),
        lambda: fan_blades(size * 0.7, int(rng.integers(2, 7)), size * 0.3, 0.5),
        lambda: comb(rng, size),
        lambda: ladder(rng, size),
    )
    return make[int(rng.integers(len(make)))]()


def comb(rng: Generator, size: float) -> Mesh:
    """Thin teeth on a rim, like a gear or a brush."""
    count, long = int(rng.integers(9, 30)), size * rng.uniform(0.1, 0.4)
    tooth = placed(box(long, size * 0.16, size * rng.uniform(0.02, 0.06), 0.003), move(size * 0.45 + long / 2, 0, 0))
    rim = placed(cylinder(size * 0.46, size * 0.16, 28), move(0, -size * 0.08, 0))
    whole = join([rim] + [placed(tooth, turn("y", 2 * np.pi * k / count)) for k in range(count)])
    return placed(whole, turn("x", float(rng.choice([0.0, np.pi / 2]))))


def ladder(rng: Generator, size: float) -> Mesh:
    """A grid of thin bars."""
    count, thick = int(rng.integers(4, 12)), size * rng.uniform(0.008, 0.03)
    steps = np.linspace(-0.6, 0.6, count) * size
    across = [placed(box(1.25 * size, thick, thick, thick / 9), move(0, y, 0)) for y in steps]
    upright = [placed(box(thick, 1.25 * size, thick, thick / 9), move(x, 0, 0)) for x in steps[:: rng.integers(1, 4)]]
    return join(across + upright)


def bars(rng: Generator, materials: Sequence[Material]) -> list[Instance]:
    """Railings and cables across the view, some about a pixel wide."""
    found = []
    for _ in range(rng.integers(1, 4)):
        place = move(rng.uniform(-4, 1), 0, rng.uniform(-5, 1)) @ turn("y", rng.uniform(-0.7, 0.7))
        fence = railing(rng.uniform(1.5, 4), rng.uniform(0.6, 1.8), rng.uniform(0.08, 0.25), rng.uniform(0.004, 0.02))
        found.append(Instance(placed(fence, place), materials[int(rng.integers(len(materials)))]))
    for _ in range(rng.integers(2, 6)):
        left, right = rng.uniform((-8, 0.5, -9), (-3, 4, 0)), rng.uniform((3, 0.5, -9), (8, 4, 0))
        cable = wire(left, right, rng.uniform(0, 0.8), rng.uniform(0.004, 0.015))
        found.append(Instance(cable, materials[int(rng.integers(len(materials)))]))
    return found


def walls(rng: Generator) -> list[Instance]:
    """A room around the stage, open behind the camera."""
    material, tile = patterned(rng), float(rng.uniform(1, 4))
    pieces = [
        placed(box_uvs(box(15, 6, 0.3, 0.01), tile), move(0, 3, -9)),
        placed(box_uvs(box(0.3, 6, 16, 0.01), tile), move(-7.2, 3, -2)),
        placed(box_uvs(box(0.3, 6, 16, 0.01), tile), move(7.2, 3, -2)),
    ]
    ceiling = placed(box_uvs(box(15, 0.3, 16, 0.01), tile), move(0, 6, -2))
    return [Instance(join(pieces), material), Instance(ceiling, simple(rng))]


# Ways.


def way(rng: Generator, place: Float[ndarray, "3"]) -> Way:
    """Spinning in place, swinging, flying straight, circling, or curving through the stage."""
    axis, spin = unit(rng.normal(size=3) + np.array([0, 0.5, 0])), rng.uniform(-0.2, 0.2)
    pace = rng.normal(size=3) * (0.045, 0.012, 0.045)
    reach, rate, phase = rng.uniform(0.1, 0.9), rng.uniform(0.05, 0.3), rng.uniform(0, 6.3)
    side = unit(rng.normal(size=3) * (1, 0.4, 1))
    stops = place + rng.normal(size=(5, 3)) * (1.4, 0.35, 1.4)
    still = move(*place)
    kinds: Sequence[Way] = (
        lambda time: still @ turn(axis, spin * time),
        lambda time: move(*(place + side * reach * np.sin(rate * time + phase))) @ turn(axis, 0.3 * spin * time),
        lambda time: move(*(place + pace * (time - 16))),
        lambda time: turn("y", 0.12 * spin * (time - 16)) @ still @ turn(axis, spin * time),
        lambda time: move(*along(stops, (time + 20) / 120)) @ turn(axis, 0.5 * spin * time),
    )
    return kinds[int(rng.integers(len(kinds)))]


def viewer(rng: Generator, seed: int) -> Way:
    """A camera before the stage: still, drifting, circling or panning, by hand or on rails."""
    start = rng.uniform((-3, 0.7, 2.4), (3, 2.8, 4.6))
    goal = rng.uniform((-1.2, 0.6, -4), (1.2, 1.6, -1))
    travel = rng.normal(size=3) * (0.03, 0.006, 0.03) * float(rng.random() < 0.8)
    pan = rng.normal(size=3) * (0.03, 0.008, 0.0) * float(rng.random() < 0.6)
    shake = 0.006 * float(rng.random() < 0.5)
    return lambda time: handheld(aim(start + travel * time, goal + pan * time), seed, time, shake, shake)


# Light.


def lamp(rng: Generator, indoors: bool) -> Light:
    """A point or a spot light, still or moving."""
    place, aim_at = rng.uniform((-4, 2.2, -6), (4, 5, 3)), rng.uniform((-2, 0, -5), (2, 1, 0))
    colour = linear(0.5 + 0.5 * shade(rng, 0.6))
    colour = colour / colour.max()
    moved = rng.random() < 0.6
    side, rate, phase = unit(rng.normal(size=3)), rng.uniform(0.03, 0.2), rng.uniform(0, 6.3)
    reach = rng.uniform(0.3, 1.5) * moved

    def at(time: float) -> LightPose:
        here = place + side * reach * np.sin(rate * time + phase)
        return LightPose(here, unit(aim_at - here))

    kind, cone = ("spot", rng.uniform(0.4, 1.0)) if rng.random() < 0.7 else ("point", 0.8)
    power = rng.uniform(40, 130) * (1.0 if indoors else 0.5)
    return Light(
        "spot" if kind == "spot" else "point",
        (float(colour[0]), float(colour[1]), float(colour[2])),
        float(power),
        at,
        radius=float(rng.uniform(0.02, 0.3)),
        inner_cone=float(cone * 0.6),
        outer_cone=float(cone),
        reach=25.0,
    )


def day(rng: Generator) -> tuple[Light, Sky]:
    """A sun that may travel, and the sky around it, often with clouds."""
    height, around, pace = rng.uniform(0.25, 1.2), rng.uniform(0, 6.3), rng.normal() * 0.006

    def sun(time: float) -> LightPose:
        return LightPose(np.zeros(3), sun_travel(height, around + pace * time))

    glow = linear(shade(rng, 0.8)) * 1.5
    heavens = dome(shade(rng, 0.4), shade(rng, 0.6), shade(rng, 0.3), -sun_travel(height, around), glow)
    if rng.random() < 0.5:
        heavens = textures.clouds_over(rng, heavens, rng.random())
    warm = rng.uniform(0.6, 1.0, 2)
    light = Light("sun", (1.0, float(warm.max()), float(warm.min())), float(rng.uniform(2.5, 6.5)), sun, radius=0.008)
    return light, Sky(heavens)


def night(rng: Generator) -> Float[ndarray, "h w 3"]:
    """What is seen where a room is open."""
    return dome(shade(rng) * 0.4, shade(rng) * 0.5, shade(rng) * 0.3, (0, 1, 0), (0.1, 0.1, 0.1), 160)
