"""The still world of `demo_scene.py`: square, houses, canal, trees, railing, wires. Metres; the camera looks to +y."""

import math
import random

import bpy
from mathutils import Matrix, Vector
from shapes import (
    Shape,
    add,
    at,
    ball,
    box,
    cloth,
    join,
    lathe,
    masonry,
    moved,
    paint,
    plaster,
    prism,
    ring,
    sagging,
    tube,
    turned,
    water,
)

Materials = dict[str, bpy.types.Material]
QUAY_Y, WATER_Z, STREET_Y, FACADE_Y = -2.2, -0.5, 1.7, 4.2
HOUSES = (
    (-8.6, (2.6, 4.0), "mint", "slate", "navy"),
    (-6.1, (2.3, 3.3), "brick", "slate", "teal"),
    (-3.75, (2.3, 4.3), "cream", "roof", "teal"),
    (-1.2, (2.7, 3.6), "pink", "slate", "navy"),
    (1.35, (2.3, 4.1), "planks", "roof", "yellow"),
    (9.6, (2.8, 3.4), "cream", "roof", "red"),
    (12.2, (2.4, 4.2), "brick", "slate", "teal"),
)


def palette(frames: int) -> Materials:
    """Every material, by name."""
    return {
        "slabs": masonry(
            "slabs", ((0.5, 0.43, 0.36), (0.37, 0.32, 0.28), (0.13, 0.11, 0.1)), (0.62, 0.4), roughness=0.4
        ),
        "quay": masonry("quay", ((0.3, 0.27, 0.24), (0.2, 0.19, 0.18), (0.07, 0.07, 0.07)), (0.55, 0.22), gap=0.02),
        "brick": masonry("brick", ((0.42, 0.13, 0.07), (0.3, 0.09, 0.05), (0.42, 0.37, 0.32)), (0.3, 0.115)),
        "planks": masonry(
            "planks", ((0.1, 0.22, 0.26), (0.08, 0.17, 0.21), (0.02, 0.03, 0.04)), (3.0, 0.2), grain=(1, 9, 1)
        ),
        "wood": masonry(
            "wood", ((0.3, 0.15, 0.07), (0.22, 0.1, 0.045), (0.05, 0.03, 0.02)), (1.1, 0.12), grain=(1, 9, 1)
        ),
        "roof": masonry("roof", ((0.36, 0.1, 0.055), (0.24, 0.07, 0.045), (0.07, 0.025, 0.02)), (0.22, 0.2), gap=0.02),
        "slate": masonry("slate", ((0.1, 0.12, 0.16), (0.065, 0.08, 0.11), (0.02, 0.02, 0.03)), (0.22, 0.2), gap=0.02),
        "cream": plaster("cream", (0.72, 0.56, 0.36)),
        "pink": plaster("pink", (0.66, 0.27, 0.2)),
        "mint": plaster("mint", (0.3, 0.5, 0.4)),
        "white": plaster("white", (0.72, 0.68, 0.6)),
        "trim": paint("trim", (0.75, 0.72, 0.64)),
        "iron": paint("iron", (0.025, 0.035, 0.04), 0.35, 0.6),
        "steel": paint("steel", (0.6, 0.6, 0.6), 0.25, 1.0),
        "glass": paint("glass", (0.03, 0.05, 0.07), 0.05),
        "lit": paint("lit", (1.0, 0.5, 0.16), 0.15, 0.0, 0.75),
        "lamp": paint("lamp", (1.0, 0.62, 0.25), 0.4, 0.0, 9.0),
        "red": paint("red", (0.62, 0.045, 0.03), 0.22),
        "teal": paint("teal", (0.03, 0.3, 0.32), 0.25),
        "yellow": paint("yellow", (0.85, 0.48, 0.06), 0.3),
        "navy": paint("navy", (0.03, 0.07, 0.2), 0.3),
        "ivory": paint("ivory", (0.8, 0.74, 0.6), 0.4),
        "leaf": paint("leaf", (0.09, 0.22, 0.04), 0.6),
        "leaf2": paint("leaf2", (0.17, 0.28, 0.05), 0.6),
        "bark": paint("bark", (0.13, 0.08, 0.05), 0.9),
        "hill": plaster("hill", (0.14, 0.23, 0.12)),
        "cloud": paint("cloud", (0.9, 0.86, 0.82), 1.0, 0.0, 0.12),
        "flag red": cloth("flag red", (0.75, 0.05, 0.03)),
        "flag yellow": cloth("flag yellow", (0.9, 0.55, 0.08)),
        "flag teal": cloth("flag teal", (0.04, 0.42, 0.42)),
        "flag ivory": cloth("flag ivory", (0.85, 0.8, 0.66)),
        "flag navy": cloth("flag navy", (0.06, 0.13, 0.36)),
        "water": water("water", (0.015, 0.06, 0.07), frames),
    }


def window(x: float, z: float, y: float, m: Materials, shutters: str, lit: bool) -> None:
    """A window with frame, bars, sill and shutters on a facade that faces the camera at y."""
    add("pane", box((x, y - 0.005, z), (0.5, 0.05, 0.72)), m["lit" if lit else "glass"])
    bars = [box((x + dx, y - 0.04, z), (w, 0.07, 0.78)) for dx, w in ((-0.27, 0.06), (0.27, 0.06), (0, 0.035))]
    bars += [box((x, y - 0.04, z + dz), (0.6, 0.07, h)) for dz, h in ((-0.38, 0.06), (0.38, 0.06), (0.1, 0.035))]
    add("frame", join(*bars, box((x, y - 0.08, z - 0.44), (0.74, 0.2, 0.06))), m["trim"])
    slats = [box((x + s * 0.45, y - 0.05, z - 0.33 + 0.11 * k), (0.26, 0.03, 0.085)) for s in (-1, 1) for k in range(7)]
    add("shutters", join(*slats), m[shutters])


def house(
    x: float, size: tuple[float, float], m: Materials, wall: str, roof: str, shutters: str, rng: random.Random
) -> None:
    """A narrow gabled house, its front at FACADE_Y; size is width and height of the wall."""
    w, h = size
    depth, rise = 3.0, 0.55 * w
    outline = [(-w / 2, 0), (w / 2, 0), (w / 2, h), (0, h + rise), (-w / 2, h)]
    add("wall", prism(outline, (x, FACADE_Y + depth / 2, 0), (1, depth, 1)), m[wall])
    length = math.hypot(w / 2, rise) + 0.25
    for side in (-1, 1):
        slab = at(box((0, 0, 0), (length, depth + 0.3, 0.1)), side * (length / 2 - 0.06), 0, 0.07)
        slab = turned(slab, side * math.degrees(math.atan2(rise, w / 2)), "Y")
        add("roof", at(slab, x, FACADE_Y + depth / 2 - 0.1, h + rise), m[roof], bevel=0.02)
    add("chimney", box((x + 0.3 * w, FACADE_Y + 1.3, h + 0.75 * rise), (0.36, 0.36, 1.2)), m["brick"], bevel=0.02)
    floors = max(int((h - 0.6) / 1.25), 1)
    columns = 2 if w < 2.5 else 3
    for floor in range(1, floors + 1):
        for k in range(columns):
            wx = x + (k - (columns - 1) / 2) * w / (columns + 0.15)
            window(wx, 0.85 + 1.25 * floor, FACADE_Y, m, shutters, rng.random() < 0.3)
    add(
        "attic",
        at(
            turned(lathe([(0.001, 0), (0.26, 0), (0.26, 0.08), (0.001, 0.08)]), 90, "X"),
            x,
            FACADE_Y + 0.03,
            h + 0.35 * rise,
        ),
        m["glass"],
    )
    add("attic ring", at(ring(0.27, 0.04), x, FACADE_Y - 0.03, h + 0.35 * rise), m["trim"])
    add("cornice", box((x, FACADE_Y - 0.04, 1.42), (w, 0.16, 0.1)), m["trim"], bevel=0.02)
    add("door", box((x - 0.27 * w, FACADE_Y - 0.01, 0.55), (0.62, 0.08, 1.1)), m["wood"])
    add(
        "shop",
        box((x + 0.2 * w, FACADE_Y - 0.01, 0.66), (0.46 * w, 0.06, 0.85)),
        m["lit" if rng.random() < 0.6 else "glass"],
    )
    mullions = [box((x + 0.2 * w + s * 0.115 * w, FACADE_Y - 0.05, 0.66), (0.045, 0.06, 0.9)) for s in (-2, 0, 2)]
    sill = box((x + 0.2 * w, FACADE_Y - 0.1, 0.2), (0.52 * w, 0.26, 0.1))
    add(
        "shop frame",
        join(*mullions, sill, box((x + 0.2 * w, FACADE_Y - 0.05, 0.42), (0.46 * w, 0.06, 0.04))),
        m["trim"],
    )
    awning(x + 0.2 * w, 0.52 * w, m, shutters)


def awning(x: float, width: float, m: Materials, color: str) -> None:
    """A striped awning over a shop window."""
    stripes = max(int(width / 0.16), 3)
    for k in range(stripes):
        slat = turned(box((0, -0.35, 0), (width / stripes, 0.72, 0.03)), 24, "X")
        add(
            "awning",
            at(slat, x + (k + 0.5 - stripes / 2) * width / stripes, FACADE_Y, 1.36),
            m[color if k % 2 else "ivory"],
        )


def ground(m: Materials) -> None:
    """Square, quay wall, canal, tram rails, hills and clouds."""
    add("square", box((0, 11.9 + QUAY_Y, -0.5), (60, 24, 1.0)), m["slabs"])
    add("wall", box((0, QUAY_Y - 0.03, -0.6), (60, 0.1, 1.16)), m["quay"])
    add(
        "coping",
        join(*[box((k * 0.9, QUAY_Y + 0.08, 0.03), (0.88, 0.42, 0.1)) for k in range(-22, 23)]),
        m["trim"],
        bevel=0.02,
    )
    add("water", box((0, QUAY_Y - 15, WATER_Z - 0.5), (80, 30, 1.0)), m["water"])
    add("rails", join(*[box((0, STREET_Y + s * 0.42, 0.012), (60, 0.06, 0.03)) for s in (-1, 1)]), m["steel"])
    for x, y, r in ((-26, 46, 15), (6, 52, 18), (32, 44, 14), (-55, 50, 20), (58, 52, 18)):
        add("hill", at(ball(r, 48), x, y, -0.62 * r), m["hill"], smooth=True)
    rng = random.Random(5)
    for x, z in ((-24, 12.5), (-7.5, 15.0), (12, 11.8), (27, 14.2), (40, 12)):
        puffs = []
        for _ in range(16):
            dx = rng.uniform(-1, 1)
            radius = (1.25 - abs(dx)) * rng.uniform(0.9, 1.5)
            puffs.append(at(ball(radius, 20), 3.8 * dx, rng.uniform(-1, 1), 0.75 * radius + rng.uniform(0, 0.25)))
        squeeze = Matrix.Diagonal((0.95, 1.0, 0.85, 1.0))
        add("cloud", at(moved(join(*puffs), squeeze), x, 58, z), m["cloud"], smooth=True)


def railing(m: Materials) -> None:
    """Iron railing along the quay: rails, posts with knobs, thin bars."""
    y, parts = QUAY_Y + 0.12, []
    for x in (k * 1.8 for k in range(-7, 8)):
        parts += [tube([(x, y, 0.05), (x, y, 0.86)], 0.035), at(ball(0.06, 12), x, y, 0.9)]
        parts += [tube([(x + 0.15 * k, y, 0.15), (x + 0.15 * k, y, 0.76)], 0.011, 6) for k in range(1, 12)]
    parts += [tube([(-13, y, z), (13, y, z)], r) for z, r in ((0.15, 0.018), (0.76, 0.026))]
    add("railing", join(*parts), m["iron"], smooth=True)


def bicycle(x: float, y: float, m: Materials) -> None:
    """A bicycle that leans on the railing."""
    spokes = [
        tube([(0, 0, 0), (0.33 * math.cos(a), 0, 0.33 * math.sin(a))], 0.006, 4)
        for a in (2 * math.pi * k / 18 for k in range(18))
    ]
    lean = [(0.0, 0.35), (1.02, 0.35)]
    tyres = [at(ring(0.34, 0.022), wx, 0, wz) for wx, wz in lean]
    wheels = [at(join(*spokes), wx, 0, wz) for wx, wz in lean]
    bars = [
        ((0, 0.35), (0.38, 0.35)),
        ((0.38, 0.35), (0.26, 0.86)),
        ((0, 0.35), (0.29, 0.76)),
        ((0.29, 0.76), (0.86, 0.8)),
        ((0.38, 0.35), (0.88, 0.72)),
        ((1.02, 0.35), (0.84, 0.98)),
    ]
    frame = [tube([(a[0], 0, a[1]), (b[0], 0, b[1])], 0.022) for a, b in bars]
    handles = tube([(0.7, -0.2, 1.0), (0.84, -0.16, 0.99), (0.86, 0, 0.98), (0.84, 0.16, 0.99), (0.7, 0.2, 1.0)], 0.018)
    tilt = lambda shape: at(turned(shape, -9, "X"), x, y, 0.06)  # noqa: E731
    add("tyres", tilt(join(*tyres, handles, box((0.25, 0, 0.9), (0.26, 0.12, 0.05)))), m["iron"], smooth=True)
    add("spokes", tilt(join(*wheels)), m["steel"])
    add("frame", tilt(join(*frame)), m["yellow"], smooth=True)


def tree(x: float, y: float, height: float, m: Materials, rng: random.Random) -> None:
    """Trunk, branches and some thousand separate leaves."""
    trunk = [tube([(x, y, 0), (x + 0.05, y, height * 0.5), (x, y, height * 0.75)], 0.07)]
    leaves: list[Shape] = []
    for _ in range(9):
        c = Vector((rng.gauss(0, 0.36), rng.gauss(0, 0.3), rng.uniform(-0.45, 0.75))) * (height / 2.6)
        c += Vector((x, y, height * 0.78))
        trunk.append(tube([(x, y, height * 0.5), tuple(c)], 0.02, 5))
        for _ in range(150):
            d = (
                Vector((rng.gauss(0, 1), rng.gauss(0, 1), rng.gauss(0, 1))).normalized()
                * rng.uniform(0.2, 0.42)
                * height
                / 2.6
            )
            side = Vector((rng.gauss(0, 1), rng.gauss(0, 1), rng.gauss(0, 1))).normalized() * 0.075
            up = d.cross(side).normalized() * 0.055
            p = c + d
            leaves.append(([p - side, p - up, p + side, p + up], [[0, 1, 2, 3]]))
    add("trunk", join(*trunk), m["bark"], smooth=True)
    add("leaves", join(*leaves), [m["leaf"], m["leaf2"]], pick=lambda _: rng.randrange(2))


def pot(x: float, y: float, m: Materials, color: str, rng: random.Random) -> None:
    """A flower pot with bent stems."""
    add(
        "pot",
        at(lathe([(0.001, 0), (0.13, 0), (0.19, 0.26), (0.21, 0.3), (0.17, 0.3), (0.001, 0.27)]), x, y, 0),
        m["roof"],
        smooth=True,
    )
    stems, heads = [], []
    for _ in range(14):
        dx, dy, h = rng.gauss(0, 0.2), rng.gauss(0, 0.15), rng.uniform(0.45, 0.85)
        stems.append(
            tube(
                [
                    (x + 0.3 * dx, y + 0.3 * dy, 0.28),
                    (x + 0.5 * dx, y + 0.5 * dy, 0.28 + 0.5 * h),
                    (x + dx, y + dy, 0.28 + 0.8 * h),
                ],
                0.009,
                5,
            )
        )
        heads.append(at(ball(0.05, 10), x + dx, y + dy, 0.28 + 0.82 * h))
    add("stems", join(*stems), m["leaf"])
    add("flowers", join(*heads), m[color], smooth=True)


def reeds(m: Materials, rng: random.Random) -> None:
    """Reeds in the water near the camera, at the left."""
    blades, tops = [], []
    for _ in range(34):
        x, y, h, lean = rng.uniform(-4.7, -3.1), rng.uniform(-6.6, -5.2), rng.uniform(0.7, 1.6), rng.gauss(0.1, 0.22)
        path = [(x + lean * s * s, y, WATER_Z + h * s) for s in (0, 0.35, 0.7, 1)]
        blades.append(tube(path, 0.012, 5))
        if h > 1.3:
            tops.append(tube([path[2], path[3]], 0.03, 8))
    add("reeds", join(*blades), [m["leaf"], m["leaf2"]], pick=lambda c: int(c.x * 40) % 2)
    add("cattails", join(*tops), m["bark"], smooth=True)


def street_wires(m: Materials) -> None:
    """Masts and the tram's overhead wires."""
    wires = []
    for x in (-9.0, -1.6, 6.0):
        add(
            "mast",
            join(
                tube([(x, STREET_Y + 1.1, 0), (x, STREET_Y + 1.1, 3.5)], 0.05),
                tube([(x, STREET_Y + 1.1, 3.3), (x, STREET_Y - 0.2, 3.15)], 0.02),
            ),
            m["iron"],
            smooth=True,
        )
        wires.append(tube(sagging((x, STREET_Y, 3.15), (x + 7.5, STREET_Y, 3.15), 0.12), 0.009, 5))
    add("wires", join(*wires, tube([(-16, STREET_Y, 2.96), (16, STREET_Y, 2.96)], 0.011, 5)), m["iron"])
