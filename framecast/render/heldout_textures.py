"""Textures of the held-out scenes, each a Material from a random generator and a palette. All tile unless noted.

They are made of noise shaped in the frequency domain and of cells around scattered points; the training scenes have
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


def spectral(rng: Generator, size: int, slope: float = 1.6, stretch: float = 1.0) -> Float[ndarray, "h w"]:
    """Gaussian noise with a power-law spectrum, 0..1 around 0.5; `stretch` > 1 draws it out down the image."""
    down, across = np.fft.fftfreq(size)[:, None] * size, np.fft.rfftfreq(size)[None] * size
    frequency = np.hypot(down * stretch, across)
    frequency[0, 0] = 1.0
    spectrum = np.fft.rfft2(rng.standard_normal((size, size))) / np.maximum(frequency, 1.0) ** slope
    spectrum[0, 0] = 0.0
    noise = np.fft.irfft2(spectrum, (size, size))
    return np.clip(0.5 + noise * (0.18 / noise.std()), 0, 1)


def cells(
    rng: Generator, size: int, count: int, jitter: float = 0.8
) -> tuple[Float[ndarray, "h w"], Float[ndarray, "h w"], Int[ndarray, "h w"]]:
    """(distance to the nearest point, the second nearest minus that, number of the nearest); points jittered on a
    `count` x `count` lattice, distances in lattice steps."""
    points = rng.uniform(0.5 - jitter / 2, 0.5 + jitter / 2, (count, count, 2))
    x, y = (axis * count for axis in pixel_grid(size))
    column, row = x.astype(int), y.astype(int)
    first, second = np.full((size, size), 9.0), np.full((size, size), 9.0)
    number = np.zeros((size, size), int)
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            r, c = (row + dy) % count, (column + dx) % count
            distance = np.hypot(column + dx + points[r, c, 0] - x, row + dy + points[r, c, 1] - y)
            nearer = distance < first
            second = np.where(nearer, first, np.minimum(second, distance))
            first, number = np.where(nearer, distance, first), np.where(nearer, r * count + c, number)
    return first, second - first, number


def per_cell(rng: Generator, number: Int[ndarray, "h w"]) -> Float[ndarray, "h w"]:
    """A random value in 0..1 for each cell."""
    return rng.random(int(number.max()) + 1)[number]


def concrete(rng: Generator, colour: Numbers, size: int = 512) -> Material:
    """Cast concrete: cloudy, pitted, with the lines of the formwork."""
    cloud, fine = spectral(rng, size, 1.8), spectral(rng, size, 0.9)
    _, y = pixel_grid(size)
    line = step(np.minimum((y * 4) % 1, 1 - (y * 4) % 1), 0.012, 0.0)
    pits = step(fine, 0.06, 0.01) * 0.6
    tone = 0.9 + 0.4 * (cloud - 0.5) + 0.2 * (fine - 0.5) - 0.2 * line - 0.25 * pits
    return textured(
        np.asarray(colour) * tone[..., None], 0.5 * fine + 0.3 * cloud - line - pits, 4, 0.75 + 0.3 * (cloud - 0.5)
    )


def flagstones(rng: Generator, colour: Numbers, count: int = 5, size: int = 512) -> Material:
    """Irregular paving stones with sandy joints."""
    _, edge, number = cells(rng, size, count)
    rough, fine = spectral(rng, size, 1.5), spectral(rng, size, 0.8)
    inside = step(edge, 0.03, 0.10)
    tone = 0.72 + 0.35 * per_cell(rng, number) + 0.5 * (rough - 0.5) + 0.15 * (fine - 0.5)
    albedo = mix(rgb("6b6252") * (0.8 + 0.4 * fine)[..., None], np.asarray(colour) * tone[..., None], inside)
    return textured(albedo, inside * 0.9 + rough * 0.5 + 0.1 * fine, 8, np.clip(0.9 - 0.25 * inside * rough, 0.2, 1))


def gravel(rng: Generator, colour: Numbers, size: int = 512) -> Material:
    """Rounded pebbles, thousands to the square metre: detail near the pixel size."""
    near, edge, number = cells(rng, size, 36)
    dome = np.clip(1 - near * 1.2, 0, 1)
    albedo = (
        np.asarray(colour) * ((0.45 + 0.7 * per_cell(rng, number)) * (0.4 + 0.6 * step(edge, 0.0, 0.25)))[..., None]
    )
    return textured(albedo, dome, 7, 0.85)


def mosaic(rng: Generator, palette: Float[ndarray, "k 3"], size: int = 1024) -> Material:
    """Small glazed stones set in rings, hard colours and bright grout."""
    x, y = pixel_grid(size)
    _, edge, number = cells(rng, size, 44, 0.45)
    ring = np.hypot(x - 0.5, y - 0.5) * 9 + 0.35 * np.sin(np.arctan2(y - 0.5, x - 0.5) * 8)
    which = (ring.astype(int) + (per_cell(rng, number) > 0.86)) % len(palette)
    inside = step(edge, 0.06, 0.14)
    albedo = mix(rgb("b9b2a4"), palette[which] * (0.75 + 0.4 * per_cell(rng, number))[..., None], inside)
    return textured(albedo, inside + 0.3 * per_cell(rng, number), 3, 0.75 - 0.5 * inside)


def water(rng: Generator, colour: Numbers, size: int = 512, strength: float = 18.0) -> Material:
    """Wind ripples on dark water."""
    ripple = 0.6 * spectral(rng, size, 1.7, 0.6) + 0.4 * spectral(rng, size, 1.2)
    return textured(np.broadcast_to(np.asarray(colour), (size, size, 3)), ripple, strength, 0.08)


def decking(rng: Generator, colour: Numbers, count: int = 10, size: int = 512) -> Material:
    """Narrow planks with dark caulking, across the image, sun-bleached unevenly."""
    _, y = pixel_grid(size)
    plank = (y * count).astype(int)
    gap = step(np.minimum((y * count) % 1, 1 - (y * count) % 1), 0.03, 0.07)
    fibre = spectral(rng, size, 1.1, 0.05)
    bleached = spectral(rng, size, 2.0)
    albedo = mix(np.asarray(colour), rgb("c9bfae"), step(bleached, 0.3, 0.9) * 0.6)
    tone = (0.8 + 0.25 * rng.random(count)[plank] + 0.5 * (fibre - 0.5)) * (0.15 + 0.85 * gap)
    return textured(albedo * tone[..., None], gap + 0.4 * fibre, 5, 0.75)


def painted_hull(rng: Generator, colour: Numbers, size: int = 512) -> Material:
    """Boat paint with rust runs and salt."""
    run, salt = spectral(rng, size, 1.3, 0.06).T, spectral(rng, size, 1.7)
    rust = step(run, 0.70, 0.82) * step(salt, 0.4, 0.6)
    albedo = mix(mix(np.asarray(colour), rgb("e8e4da"), step(salt, 0.62, 0.95) * 0.5), rgb("7a4325"), rust * 0.9)
    return textured(albedo, 0.4 * salt + 0.3 * rust, 2, 0.35 + 0.4 * rust + 0.2 * (salt - 0.5))


def cloth(rng: Generator, colour: Numbers, other: Numbers, stripes: int = 0, size: int = 256) -> Material:
    """Coarse weave, seen from both sides, in broad stripes where `stripes` > 0."""
    x, y = pixel_grid(size)
    weave = 0.5 + 0.25 * np.sin(2 * np.pi * 64 * x) + 0.25 * np.sin(2 * np.pi * 64 * y)
    which = ((x * stripes) % 1 < 0.5) if stripes else np.zeros((size, size), bool)
    tone = 0.85 + 0.3 * (spectral(rng, size, 1.6) - 0.5) + 0.12 * (weave - 0.5)
    albedo = np.where(which[..., None], np.asarray(other), np.asarray(colour)) * tone[..., None]
    solid = np.concatenate([albedo, np.ones((size, size, 1))], axis=-1)
    return textured(solid, weave, 1.5, 0.9, mask=True)


def panels(rng: Generator, colour: Numbers, size: int = 512) -> Material:
    """Riveted sheet metal, 4 x 4 panels of slightly different tone, oil stains."""
    x, y = (axis * 4 for axis in pixel_grid(size))
    seam = step(np.minimum(np.minimum(x % 1, 1 - x % 1), np.minimum(y % 1, 1 - y % 1)), 0.008, 0.02)
    rivet_x, rivet_y = np.abs((x * 8) % 1 - 0.5) / 8, np.abs((y * 8) % 1 - 0.5) / 8
    near_seam = np.minimum(np.abs(x % 1 - 0.5), np.abs(y % 1 - 0.5)) * 0 + np.maximum(
        np.abs(x % 1 - 0.5), np.abs(y % 1 - 0.5)
    )
    rivet = step(np.hypot(rivet_x, rivet_y), 0.022, 0.012) * (np.abs(near_seam - 0.44) < 0.035)
    stain = spectral(rng, size, 1.9, 0.5)
    tone = 0.85 + 0.18 * rng.random(16)[x.astype(int) + 4 * y.astype(int)] + 0.2 * (stain - 0.5)
    albedo = np.asarray(colour) * (tone * (0.55 + 0.45 * seam))[..., None]
    return textured(albedo, 0.5 * seam + 0.6 * rivet, 4, 0.45 + 0.3 * (stain - 0.5), 0.35)


def hangar_floor(rng: Generator, colour: Numbers, size: int = 1024) -> Material:
    """Sealed floor with a yellow guide line and a hazard band, tyre marks; glossy where it is clean."""
    x, y = pixel_grid(size)
    cloud, scuff = spectral(rng, size, 1.8), spectral(rng, size, 1.2, 0.05)
    albedo = np.asarray(colour) * (0.9 + 0.35 * (cloud - 0.5))[..., None]
    band = (np.abs(y - 0.12) < 0.03).astype(float)
    slant = (((x + y) * 16) % 1 < 0.5).astype(float)
    worn = step(spectral(rng, size, 1.4), 0.28, 0.40)
    albedo = mix(albedo, np.where(slant[..., None] > 0, rgb("e0b020"), rgb("1a1a1a")), band * worn)
    albedo = mix(albedo, rgb("e0b020"), (np.abs(x - 0.5) < 0.010) * worn)
    marks = step(scuff, 0.72, 0.85)
    albedo = mix(albedo, rgb("1c1c1e"), 0.6 * marks)
    return textured(albedo, roughness=np.clip(0.12 + 0.30 * step(cloud, 0.45, 0.8) + 0.3 * marks, 0.05, 1))


def weave(rng: Generator, colour: Numbers, size: int = 256) -> Material:
    """Twill of glossy fibres: a moire trap."""
    x, y = pixel_grid(size)
    u, v = (x * 32).astype(int), (y * 32).astype(int)
    over = ((u + v) % 4) < 2
    thread = np.where(over, np.abs((y * 32) % 1 - 0.5), np.abs((x * 32) % 1 - 0.5))
    tone = np.where(over, 1.0, 0.55) * (1.1 - thread) * (0.9 + 0.2 * spectral(rng, size))
    return textured(np.asarray(colour) * tone[..., None], np.where(over, 1.0, 0.6) - thread, 3, 0.28)


def screen(rng: Generator, colour: Numbers, glow: float = 6.0, size: int = 256) -> Material:
    """A control screen, seen once: graphs, bars and rows of marks that glow."""
    x, y = pixel_grid(size)
    light = 0.10 * (((x * 16) % 1 < 0.04) | ((y * 12) % 1 < 0.05)).astype(float)
    curve = 0.35 + 0.15 * np.sin(9 * x + rng.uniform(0, 6)) + 0.08 * np.sin(31 * x + rng.uniform(0, 6))
    light = np.maximum(light, step(np.abs(y - curve), 0.012, 0.005) * (x < 0.6))
    bars = rng.random(24)[(x * 24).astype(int)]
    light = np.maximum(light, 0.7 * ((y > 1 - 0.4 * bars) & ((x * 24) % 1 < 0.6) & (x < 0.6)))
    marks = rng.random((40, 40))[(y * 40).astype(int), (x * 40).astype(int)] > 0.45
    light = np.maximum(light, 0.8 * (marks & (x > 0.64) & ((y * 40) % 1 < 0.55) & ((y * 13).astype(int) % 3 != 2)))
    warm = (rng.random(6)[(y * 6).astype(int)] > 0.7) & (x > 0.64)
    tint = np.where(warm[..., None], rgb("ffb347"), np.asarray(colour))
    return textured(np.full((size, size, 3), 0.02), roughness=0.1, emission=light[..., None] * tint, glow=glow)


def spun_metal(rng: Generator, colour: Numbers, size: int = 512) -> Material:
    """Metal turned on a lathe, seen once on a disc: fine rings about the middle, a little tarnish."""
    x, y = pixel_grid(size)
    radius = np.hypot(x - 0.5, y - 0.5)
    rings = rng.random(160)[np.minimum((radius * 220).astype(int), 159)]
    tarnish = spectral(rng, size, 1.9)
    albedo = mix(np.asarray(colour) * (0.85 + 0.2 * rings)[..., None], rgb("5a3c22"), step(tarnish, 0.62, 1.0) * 0.7)
    return textured(albedo, rings, 0.3, 0.18 + 0.3 * step(tarnish, 0.4, 0.9) + 0.1 * rings, 1.0)


def dial(rng: Generator, paper: Numbers, ink: Numbers, size: int = 1024) -> Material:
    """A clock face, seen once: sixty ticks, finer ones between, twelve slanted numerals, guilloche in the middle."""
    x, y = pixel_grid(size)
    radius, angle = np.hypot(x - 0.5, y - 0.5), np.arctan2(x - 0.5, 0.5 - y) / (2 * np.pi) % 1
    dark = np.zeros((size, size), bool)
    for count, low, high, wide in ((60, 0.44, 0.475, 0.0022), (300, 0.46, 0.475, 0.0010), (12, 0.42, 0.475, 0.0045)):
        off = np.abs((angle * count + 0.5) % 1 - 0.5) / count * 2 * np.pi * radius
        dark |= (off < wide) & (radius > low) & (radius < high)
    hour = (angle * 12 + 0.5).astype(int) % 12
    local = (angle * 12 + 0.5) % 1 - 0.5
    strokes = np.array([3, 1, 2, 3, 3, 1, 2, 3, 4, 2, 1, 2])[hour]
    dark |= (
        (np.abs(local) < 0.055 * strokes)
        & (((local / 0.11 + strokes * 0.5) % 1) < 0.5)
        & (radius > 0.33)
        & (radius < 0.40)
    )
    dark |= (np.abs(radius - 0.485) < 0.003) | (np.abs(radius - 0.30) < 0.0015)
    wave = np.sin(angle * 2 * np.pi * 48 + 26 * radius) * np.sin(angle * 2 * np.pi * 48 - 26 * radius)
    tone = 0.94 + 0.1 * (spectral(rng, size, 1.8) - 0.5) + 0.05 * wave * (radius < 0.29)
    albedo = np.where(dark[..., None], np.asarray(ink), np.asarray(paper) * tone[..., None])
    return textured(albedo, wave * (radius < 0.29) * 0.5 - dark, 2, 0.35)


def figured_wood(rng: Generator, colour: Numbers, gloss: float = 0.25, size: int = 512) -> Material:
    """Walnut under varnish: growth rings bent by knots, chatoyant bands."""
    x, _ = pixel_grid(size)
    bend = spectral(rng, size, 2.2, 0.4)
    ring = 0.5 + 0.5 * np.sin(2 * np.pi * (4 * x + 5 * bend))
    pore = spectral(rng, size, 0.8, 0.08)
    albedo = mix(np.asarray(colour) * 0.55, np.asarray(colour) * 1.15, 0.7 * ring + 0.3 * pore)
    return textured(albedo, pore, 1.0, gloss + 0.15 * pore)


def palm_leaf(rng: Generator, colour: Numbers, size: int = 256) -> Material:
    """A feathered palm leaf on transparency, stem up the middle, alpha-tested."""
    x, y = pixel_grid(size)
    away = np.abs(x - 0.5) * 2
    slant = (1 - y) * 15 - away * 2.2
    k = np.floor(slant)
    within = np.abs(slant - k - 0.5) * 2
    reach = np.sin(np.pi * np.clip(1.04 * (1 - y) + 0.02, 0, 1)) ** 0.5
    cover = ((within < 0.80 * (1 - (away / np.maximum(reach, 0.05)) ** 3)) & (away < reach)) | (away < 0.025)
    tone = (
        0.65
        + 0.35 * (1 - within)
        + 0.3 * (spectral(rng, size, 1.4) - 0.5)
        + 0.15 * (rng.random(64)[k.astype(int) % 64] - 0.5)
    )
    return textured(
        np.concatenate([np.asarray(colour) * tone[..., None], cover[..., None]], axis=-1), roughness=0.75, mask=True
    )


def broad_leaf(rng: Generator, colour: Numbers, vein: Numbers, size: int = 256) -> Material:
    """One large veined leaf on transparency, its foot at the lower edge, alpha-tested."""
    x, y = pixel_grid(size)
    up, away = 1 - y, np.abs(x - 0.5)
    outline = 0.46 * np.sin(np.pi * np.clip(up, 0, 1) ** 0.62) ** 0.85
    cover = (away < outline) & (np.abs(((up - 0.6 * away) * 9) % 1 - 0.5) + 3.2 * (outline - away) > 0.16) | (
        away < 0.012
    )
    veins = step(np.abs(((up - 0.7 * away) * 9) % 1 - 0.5), 0.07, 0.02) * 0.7 + (away < 0.012)
    tone = 0.8 + 0.4 * (spectral(rng, size, 1.6) - 0.5)
    albedo = mix(np.asarray(colour) * tone[..., None], np.asarray(vein), np.clip(veins, 0, 1))
    return textured(np.concatenate([albedo, cover[..., None]], axis=-1), roughness=0.7, mask=True)


def star_leaves(rng: Generator, colour: Numbers, size: int = 256) -> Material:
    """A dozen five-pointed leaves scattered on transparency, alpha-tested."""
    x, y = pixel_grid(size)
    cover, albedo = np.zeros((size, size)), np.ones((size, size, 3)) * np.asarray(colour)
    for _ in range(22):
        cx, cy, turn, big = rng.uniform((0.12, 0.12, 0, 0.09), (0.88, 0.88, 6.28, 0.15))
        radius, angle = np.hypot(x - cx, y - cy), np.arctan2(y - cy, x - cx) + turn
        point = np.abs((angle / (2 * np.pi) * 5) % 1 - 0.5) * 2
        inside = radius < big * (0.28 + 0.72 * point**1.6)
        albedo = np.where(inside[..., None], np.asarray(colour) * rng.uniform(0.75, 1.25), albedo)
        cover = np.maximum(cover, inside)
    return textured(np.concatenate([albedo, cover[..., None]], axis=-1), roughness=0.85, mask=True)


def scales(rng: Generator, colour: Numbers, belly: Numbers, size: int = 512) -> Material:
    """Painted carp: rows of scales along the body (down the image), an eye band, a pale belly (image middle)."""
    x, y = pixel_grid(size)
    row = (y * 18).astype(int)
    u, v = (x * 14 + 0.5 * (row % 2)) % 1, (y * 18) % 1
    arc = np.hypot(u - 0.5, (v - 0.0) * 0.8)
    edge = step(np.abs(arc - 0.48), 0.10, 0.04)
    pale = step(np.abs(x - 0.5), 0.12, 0.06)
    body = mix(np.asarray(colour) * (0.75 + 0.35 * v)[..., None], rgb("f7f1e3"), edge * 0.7)
    albedo = mix(body, np.asarray(belly), pale)
    head = step(y, 0.14, 0.13)
    albedo = mix(albedo, rgb("f7f1e3"), head)
    for cx in (0.22, 0.78):
        ring = np.hypot((x - cx) * 1.0, (y - 0.07) * 1.6)
        albedo = mix(albedo, rgb("16161a"), step(ring, 0.055, 0.05) - step(ring, 0.035, 0.03) + step(ring, 0.02, 0.015))
    solid = np.concatenate(
        [albedo * (0.92 + 0.16 * (spectral(rng, size) - 0.5))[..., None], np.ones((size, size, 1))], axis=-1
    )
    return textured(solid, roughness=0.7, mask=True)


def veiled(rng: Generator, sky: Float[ndarray, "h w 3"], tint: Numbers, cover: float = 0.5) -> Float[ndarray, "h w 3"]:
    """The dome image under streaks of high cloud that take the colour `tint` (linear)."""
    look = directions(sky.shape[0])
    up = np.maximum(look[..., 1], 1e-3)
    pattern = spectral(rng, 512, 1.7, 2.2)
    place = (look[..., [0, 2]] / (up[..., None] + 0.2) * 120).astype(int) % 512
    density = step(pattern[place[..., 1], place[..., 0]], 0.8 - 0.5 * cover, 1.15 - 0.5 * cover) * step(up, 0.0, 0.2)
    return (sky + (np.asarray(tint) - sky) * 0.9 * density[..., None]).astype(np.float32)
