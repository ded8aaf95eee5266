"""Textures of the training scenes, each a Material from a random generator and a palette. All tile.

They are made of gradient noise on a lattice and of regular courses (bricks, boards, tiles). The held-out scenes have
their own file and share none of these functions.
"""

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray
from numpy.random import Generator

from framecast.render.finish import mix, pixel_grid, rgb, step, textured
from framecast.render.motion import Numbers
from framecast.render.scene import Material
from framecast.render.skies import directions


def lattice_noise(rng: Generator, size: int, cells: tuple[int, int]) -> Float[ndarray, "h w"]:
    """Gradient noise that tiles, about -0.7..0.7, with `cells` (down, across) lattice cells."""
    angle = rng.uniform(0, 2 * np.pi, cells).astype(np.float32)
    (y, row), (x, column) = ((p - p.astype(int), p.astype(int)) for p in (axis(size, count) for count in cells))
    tx, ty = (t * t * t * (t * (6 * t - 15) + 10) for t in (x, y[:, None]))
    # Along x first, for whole lattice rows: each row's own slope in x, and the slope in y that it brings along.
    left, right = angle[:, column], np.roll(angle, -1, 1)[:, column]
    own = np.cos(left) * x * (1 - tx) + np.cos(right) * (x - 1) * tx
    down = np.sin(left) * (1 - tx) + np.sin(right) * tx
    below = (row + 1) % cells[0]
    return (own[row] + down[row] * y[:, None]) * (1 - ty) + (own[below] + down[below] * (y[:, None] - 1)) * ty


def axis(size: int, cells: int) -> Float[ndarray, " n"]:
    """Pixel corners in lattice steps."""
    return (np.arange(size) / size * cells).astype(np.float32)


def clouds(rng: Generator, size: int, cells: int = 4, octaves: int = 5, stretch: int = 1) -> Float[ndarray, "h w"]:
    """Sum of octaves of gradient noise, 0..1 around 0.5;
    `stretch` > 1 draws it out along the rows' direction (down).
    """
    total = np.zeros((size, size), np.float32)
    for k in range(octaves):
        across = cells * 2**k * stretch
        total += lattice_noise(rng, size, (cells * 2**k, min(across, size // 2))) * 0.55**k
    return np.clip(0.5 + total * 0.6, 0, 1)


def courses(
    size: int, rows: int, columns: int, joint: float, aspect: float
) -> tuple[Float[ndarray, "h w"], Int[ndarray, "h w"]]:
    """(distance into the brick from its edge, 0 in the joint, up to 1; brick number) of a running bond that tiles."""
    x, y = pixel_grid(size)
    row = (y * rows).astype(int)
    along = x * columns + 0.5 * (row % 2)
    column = along.astype(int) % columns
    edge_x = np.minimum(along % 1, 1 - along % 1) * aspect
    edge_y = np.minimum((y * rows) % 1, 1 - (y * rows) % 1)
    return step(np.minimum(edge_x, edge_y), joint, joint + 0.12), row * columns + column


def vary(rng: Generator, number: Int[ndarray, "h w"]) -> Float[ndarray, "h w"]:
    """A random value in -1..1 for each brick number."""
    return rng.uniform(-1, 1, int(number.max()) + 1)[number]


def plaster(rng: Generator, colour: Numbers, age: float = 1.0, size: int = 512) -> Material:
    """Limewash: soft stains, trowel marks and, with `age` up to 1, worn patches that show the grey coat below."""
    broad, fine = clouds(rng, size, 2, 4), clouds(rng, size, 16, 4)
    worn = step(clouds(rng, size, 3, 6), 0.68, 0.80) * age
    base = (
        np.asarray(colour)[None, None]
        * (0.9 + (0.28 * (broad - 0.5) + 0.14 * (fine - 0.5)) * (0.2 + 0.8 * age))[..., None]
    )
    albedo = mix(base, rgb("b5ab9c"), worn * 0.5)
    return textured(albedo, fine * 0.5 + broad * 0.6 - 0.35 * worn, 2 + 8 * age, 0.85 + 0.1 * fine)


def bricks(rng: Generator, colour: Numbers, size: int = 512) -> Material:
    """A brick wall, 12 courses to the tile, with pale sunken mortar and burnt bricks."""
    inside, number = courses(size, 12, 4, 0.06, 3.0)
    grain = clouds(rng, size, 24, 3)
    tone = vary(rng, number)
    brick = np.asarray(colour) * (0.9 + 0.22 * tone + 0.4 * (grain - 0.5))[..., None]
    albedo = mix(rgb("b9b0a2") * (0.8 + 0.3 * grain)[..., None], brick, inside)
    return textured(albedo, inside * 0.8 + grain * 0.25, 7, 0.75 + 0.2 * grain)


def cobbles(rng: Generator, colour: Numbers, size: int = 512) -> Material:
    """Setts in wavy courses, polished on top, dark between."""
    inside, number = courses(size, 10, 8, 0.05, 1.2)
    grain, wear = clouds(rng, size, 20, 3), clouds(rng, size, 2, 3)
    dome = np.sqrt(inside)
    tone = 0.75 + 0.16 * vary(rng, number) + 0.35 * (grain - 0.5) + 0.4 * (wear - 0.5)
    albedo = mix(rgb("4a453d"), np.asarray(colour) * tone[..., None], dome)
    return textured(albedo, dome * 0.9 + grain * 0.2, 9, np.clip(0.85 - 0.35 * dome * wear - 0.1 * grain, 0.2, 1))


def boards(rng: Generator, colour: Numbers, count: int = 6, gloss: float = 0.45, size: int = 512) -> Material:
    """Long boards, running down the image, with wandering grain, a few knots and dark gaps."""
    x, _ = pixel_grid(size)
    board = (x * count).astype(int)
    gap = step(np.minimum((x * count) % 1, 1 - (x * count) % 1), 0.012, 0.035)
    warp = clouds(rng, size, 2, 3)
    rings = 0.5 + 0.5 * np.sin(2 * np.pi * (x * count * 7 + 5 * vary(rng, board) + 4 * warp))
    fibre = clouds(rng, size, 3, 4, stretch=16)
    tone = 0.82 + 0.16 * vary(rng, board) + 0.16 * rings * warp + 0.35 * (fibre - 0.5)
    albedo = np.asarray(colour) * (tone * (0.25 + 0.75 * gap))[..., None]
    return textured(albedo, gap * 0.9 + fibre * 0.25, 5, np.clip(gloss + 0.3 * (fibre - 0.5) + 0.2 * (1 - gap), 0.1, 1))


def asphalt(rng: Generator, wet: float = 0.0, size: int = 512) -> Material:
    """Tarmac with bright chips and hairline cracks; `wet` in 0..1 spreads mirror-smooth puddles."""
    chips, broad = rng.random((size, size)), clouds(rng, size, 3, 5)
    crack = step(np.abs(clouds(rng, size, 3, 6) - 0.5), 0.006, 0.0)
    puddle = (
        step(broad, 0.62 - 0.3 * wet, 0.5 - 0.3 * wet)
        if wet == 0
        else step(broad, 0.62 - 0.25 * wet, 0.72 - 0.25 * wet)
    )
    puddle = puddle * (wet > 0)
    tone = (0.34 + 0.12 * (broad - 0.5) + 0.1 * (chips - 0.5) - 0.09 * crack) * (1 - 0.5 * puddle)
    height = (chips * 0.35 + broad * 0.3 - 0.4 * crack) * (1 - puddle)
    return textured(
        tone[..., None] * np.array([1.0, 1.0, 1.03]), height, 4, 0.9 - 0.25 * wet - (0.6 - 0.2 * wet) * puddle
    )


def marble_checks(rng: Generator, light: Numbers, dark: Numbers, size: int = 1024) -> Material:
    """A polished chequered floor, 4 x 4 slabs to the tile, each with its own veins."""
    x, y = pixel_grid(size)
    column, row = (x * 4).astype(int), (y * 4).astype(int)
    odd = (column + row) % 2
    warp = clouds(rng, size, 4, 5)
    vein = step(np.abs(np.sin(9 * (x + y + 1.7 * warp + 0.4 * vary(rng, row * 4 + column)))), 0.12, 0.0)
    seam = step(
        np.minimum(np.minimum((x * 4) % 1, 1 - (x * 4) % 1), np.minimum((y * 4) % 1, 1 - (y * 4) % 1)), 0.0, 0.012
    )
    slab = np.where(odd[..., None], np.asarray(dark), np.asarray(light)) * (0.9 + 0.2 * (warp - 0.5))[..., None]
    albedo = mix(slab, np.where(odd[..., None], 0.75, 0.45) * np.ones(3), 0.35 * vein) * (0.5 + 0.5 * seam)[..., None]
    return textured(albedo, roughness=0.12 + 0.08 * warp + 0.3 * (1 - seam))


def scratched_paint(rng: Generator, colour: Numbers, size: int = 512) -> Material:
    """Enamel on steel: chipped edges of bare metal, fine scratches, grime."""
    chip = step(clouds(rng, size, 5, 6), 0.70, 0.73)
    scratch = step(lattice_noise(rng, size, (4, 200)), 0.52, 0.58) * 0.6
    bare = np.maximum(chip, scratch)
    grime = clouds(rng, size, 3, 4)
    paint = np.asarray(colour) * (0.8 + 0.4 * (grime - 0.2) * 0.6)[..., None]
    return textured(mix(paint, rgb("8d8a86"), bare), 1 - chip, 2, 0.35 + 0.3 * bare + 0.15 * grime, bare * 0.9)


def brushed_steel(rng: Generator, colour: Numbers, size: int = 512) -> Material:
    """Brushed metal, the strokes down the image."""
    stroke = clouds(rng, size, 2, 5, stretch=32)
    smear = clouds(rng, size, 2, 4)
    return textured(
        np.asarray(colour) * (0.85 + 0.25 * (stroke - 0.5))[..., None], stroke, 1.5, 0.25 + 0.2 * smear, 1.0
    )


def bark(rng: Generator, colour: Numbers, size: int = 512) -> Material:
    """Furrowed bark, ridges down the image."""
    warp = clouds(rng, size, 4, 3)
    x, _ = pixel_grid(size)
    ridge = np.abs(np.sin(np.pi * (x * 10 + 2.2 * warp))) ** 0.7
    grain = clouds(rng, size, 6, 4, stretch=6)
    moss = step(clouds(rng, size, 2, 4), 0.58, 0.75)
    albedo = mix(np.asarray(colour) * (0.35 + 0.6 * ridge + 0.3 * (grain - 0.5))[..., None], rgb("5d6a35"), 0.5 * moss)
    return textured(albedo, ridge * 0.7 + grain * 0.4, 6, 0.95)


def leaf_litter(rng: Generator, colour: Numbers, size: int = 512) -> Material:
    """Forest floor: soil, moss and fallen leaves."""
    soil, moss = clouds(rng, size, 6, 6), step(clouds(rng, size, 3, 5), 0.45, 0.62)
    speck = step(clouds(rng, size, 40, 2), 0.62, 0.72)
    albedo = mix(
        rgb("4d3b28") * (0.6 + 0.8 * (soil - 0.1))[..., None], np.asarray(colour) * (0.6 + 0.7 * soil)[..., None], moss
    )
    albedo = mix(albedo, rgb("9a7136"), speck * (1 - moss) * 0.8)
    return textured(albedo, soil * 0.8 + 0.2 * speck + 0.3 * moss, 12, 0.92)


def roof_tiles(rng: Generator, colour: Numbers, size: int = 512) -> Material:
    """Overlapping clay tiles, rows across the image, the lower lip of each row proud."""
    x, y = pixel_grid(size)
    row = (y * 8).astype(int)
    column = (x * 10).astype(int)
    round_ = np.sqrt(np.clip(1 - (2 * ((x * 10) % 1) - 1) ** 2, 0, 1))
    lip = (y * 8) % 1
    tone = 0.8 + 0.22 * vary(rng, row * 10 + column) + 0.4 * (clouds(rng, size, 8, 4) - 0.5)
    albedo = (
        np.asarray(colour)
        * (tone * (0.45 + 0.55 * step(round_, 0.0, 0.5)) * (0.6 + 0.4 * step(lip, 1.0, 0.93)))[..., None]
    )
    return textured(albedo, round_ * 0.7 + lip * 0.3, 14, 0.85)


def canvas_painting(rng: Generator, palette: Float[ndarray, "k 3"], size: int = 400) -> Material:
    """An abstract painting: flat shapes in a grid of brush strokes and hard fine lines, for high frequencies."""
    x, y = pixel_grid(size)
    albedo = np.ones((size, size, 3)) * palette[0]
    for _ in range(20):
        cx, cy, wide, tall, lean = rng.uniform((0, 0, 0.03, 0.03, -1.5), (1, 1, 0.35, 0.35, 1.5))
        u, v = (x - cx) * np.cos(lean) + (y - cy) * np.sin(lean), (y - cy) * np.cos(lean) - (x - cx) * np.sin(lean)
        kind = rng.integers(3)
        inside = np.maximum(np.abs(u) / wide, np.abs(v) / tall) if kind else np.hypot(u, v) / wide
        stripes = 0.5 + 0.5 * np.sign(np.sin(u * rng.uniform(60, 260))) if kind == 2 else 1.0
        albedo = mix(albedo, palette[rng.integers(len(palette))], step(inside, 1.0, 0.98) * stripes)
    weave = 0.5 + 0.25 * (np.sin(x * 2 * np.pi * 128) + np.sin(y * 2 * np.pi * 128))
    stroke = clouds(rng, size, 6, 3, stretch=4)
    return textured(albedo * (0.85 + 0.3 * (stroke - 0.5))[..., None], weave * 0.4 + stroke, 2, 0.6)


def leaf_cluster(rng: Generator, colour: Numbers, size: int = 256, leaves: int = 26) -> Material:
    """A twig of leaves on transparency, alpha-tested; the stem enters at the middle of the lower edge."""
    x, y = pixel_grid(size)
    albedo, cover = np.ones((size, size, 3)) * np.asarray(colour) * 0.6, np.zeros((size, size))
    for k in range(leaves):
        t = k / leaves
        foot = np.array([0.5 + 0.10 * np.sin(5 * t), 0.97 - 0.72 * t])
        lean = rng.uniform(0.5, 1.25) * (1 if k % 2 else -1) * (1 - 0.65 * t)
        long = rng.uniform(0.20, 0.30) * (1 - 0.25 * t)
        u = (x - foot[0]) * np.sin(lean) - (y - foot[1]) * np.cos(lean)
        v = (x - foot[0]) * np.cos(lean) + (y - foot[1]) * np.sin(lean)
        s = np.clip(u / long, 0, 1)
        width = 0.30 * long * np.sin(np.pi * s**0.75) * (u > 0) * (u < long)
        blade = (np.abs(v) < width) & (width > 0)
        tone = (0.75 + 0.35 * rng.random() + 0.25 * (v > 0)) * (1 - 0.35 * (np.abs(v) < 0.004))
        albedo = np.where(blade[..., None], np.asarray(colour) * tone[..., None], albedo)
        cover = np.maximum(cover, blade)
    cover = np.maximum(cover, (np.abs(x - 0.5 - 0.10 * np.sin(5 * (0.97 - y) / 0.72)) < 0.008) & (y > 0.25))
    return textured(np.concatenate([albedo, cover[..., None]], axis=-1), roughness=0.85, mask=True)


def frond(rng: Generator, colour: Numbers, size: int = 256) -> Material:
    """A fern frond on transparency, alpha-tested: the stem runs up the image, leaflets to both sides."""
    x, y = pixel_grid(size)
    up = 1 - y
    reach = 0.46 * np.sin(np.pi * np.clip(up * 0.93 + 0.07, 0, 1)) ** 0.6 * (1 - 0.5 * up)
    away = np.abs(x - 0.5)
    leaflet = (up - 0.35 * away) * 22
    saw = np.abs((leaflet % 1) - 0.5) * 2
    cover = ((away < reach) & (saw < 0.86 - 0.7 * away / np.maximum(reach, 0.01))) | (away < 0.010)
    tone = 0.6 + 0.5 * clouds(rng, size, 8, 3) + 0.2 * (0.5 - saw)
    albedo = np.asarray(colour) * tone[..., None]
    return textured(np.concatenate([albedo, cover[..., None]], axis=-1), roughness=0.85, mask=True)


def lit_windows(rng: Generator, wall: Numbers, glow: float = 4.0, size: int = 512) -> Material:
    """A facade at night, 8 x 6 windows to the tile, some lit in different colours, some blinds half down."""
    x, y = pixel_grid(size)
    column, row = (x * 8).astype(int), (y * 6).astype(int)
    u, v = (x * 8) % 1, (y * 6) % 1
    number = row * 8 + column
    pane = (np.abs(u - 0.5) < 0.30) & (np.abs(v - 0.5) < 0.34) & (np.abs(u - 0.5) > 0.02) & (np.abs(v - 0.42) > 0.015)
    blind = v < 0.2 + 0.5 * np.clip(vary(rng, number), 0, 1)
    lit = (vary(rng, number) > 0.4) & pane
    tint = np.stack([rgb("ffc98a"), rgb("ffe6c0"), rgb("bcd8ff"), rgb("ffb070")])[rng.integers(0, 4, 48)][number]
    light = (
        lit[..., None]
        * tint
        * np.where(blind, 0.35, 0.95)[..., None]
        * (0.7 + 0.3 * clouds(rng, size, 24, 2))[..., None]
    )
    tone = clouds(rng, size, 6, 5)
    albedo = np.where(pane[..., None], rgb("0d1218"), np.asarray(wall) * (0.75 + 0.4 * tone)[..., None])
    return textured(
        albedo, np.where(pane, 0.0, 0.6 + 0.4 * tone), 4, np.where(pane, 0.08, 0.8), emission=light, glow=glow
    )


def shop_window(rng: Generator, tint: Numbers, glow: float = 2.2, size: int = 256) -> Material:
    """A lit shop display seen once: shelves of goods in many colours before a bright wall, a dark frame."""
    x, y = pixel_grid(size)
    light = np.asarray(tint) * (0.55 + 0.45 * (1 - y))[..., None]
    goods = np.stack([rgb(c) for c in ("c8402f", "e7b53c", "2f6f8f", "4e8a4a", "efe6d6", "5a3a6a", "d97b4a")])
    for shelf in (0.34, 0.62, 0.93):
        at = 0.06
        while at < 0.92:
            wide, tall = rng.uniform(0.025, 0.09), rng.uniform(0.06, 0.22)
            inside = (
                (x > at)
                & (x < at + wide)
                & (y < shelf)
                & (y > shelf - tall * (1 - 3 * ((x - at) / wide - 0.5) ** 2 * rng.choice([0, 0.3])))
            )
            light = np.where(inside[..., None], goods[rng.integers(7)] * (0.5 + 0.4 * rng.random()), light)
            at += wide + rng.uniform(0.005, 0.05)
        light = np.where(((y > shelf) & (y < shelf + 0.012))[..., None], 0.12, light)
    frame = (np.minimum(np.minimum(x, 1 - x), np.minimum(y, 1 - y)) < 0.025) | (np.abs(x - 0.5) < 0.009)
    light = np.where(frame[..., None], 0.0, light)
    return textured(np.where(frame[..., None], 0.12, 0.05 * np.ones(3)), roughness=0.08, emission=light, glow=glow)


def neon_sign(rng: Generator, colour: Numbers, glow: float = 12.0, size: int = 256) -> Material:
    """A sign of glowing strokes, like letters of no alphabet, three rows of them on a dark board."""
    x, y = pixel_grid(size)
    light = np.zeros((size, size))
    rows, columns = 2, 4
    for cell in range(rows * columns):
        cx, cy = (cell % columns + 0.5) / columns, (cell // columns + 0.5) / rows
        knots = np.array([(sx, sy) for sx in (-0.32, 0.32) for sy in (-0.36, 0.0, 0.36)]) / (columns, rows)
        for _ in range(4):
            a, b = knots[rng.choice(6, 2, replace=False)]
            d, p = b - a, np.stack([x - cx, y - cy], axis=-1) - a
            t = np.clip((p @ d) / (d @ d), 0, 1)
            light = np.maximum(light, step(np.linalg.norm((p - t[..., None] * d) * (1, 0.5), axis=-1), 0.016, 0.008))
    albedo = mix(rgb("15161a"), np.asarray(colour), light)
    return textured(albedo, roughness=0.3, emission=light[..., None] * np.asarray(colour), glow=glow)


def clouds_over(rng: Generator, sky: Float[ndarray, "h w 3"], cover: float = 0.5) -> Float[ndarray, "h w 3"]:
    """The dome image with fair-weather clouds on a flat ceiling, thinning into the haze at the horizon."""
    look = directions(sky.shape[0])
    up = np.maximum(look[..., 1], 1e-3)
    pattern = clouds(rng, 512, 4, 6)
    place = (look[..., [0, 2]] / (up[..., None] + 0.12) * 90).astype(int) % 512
    density = step(pattern[place[..., 1], place[..., 0]], 0.75 - 0.4 * cover, 1.0 - 0.4 * cover) * step(up, 0.02, 0.25)
    bright = np.maximum(sky, 0.75 + 0.2 * pattern[place[..., 0], place[..., 1]][..., None])
    return (sky + (bright - sky) * 0.85 * density[..., None]).astype(np.float32)
