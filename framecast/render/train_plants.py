"""Trees, bushes, ferns and grass of the training scenes, as trunks plus alpha-tested cards, and how they sway."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from numpy.random import Generator

from framecast.render.mesh import from_grid, join
from framecast.render.motion import unit
from framecast.render.scene import Mesh
from framecast.render.train_shapes import tube


def branches(rng: Generator, height: float, spread: float, levels: int = 3) -> tuple[Mesh, Float[ndarray, "k 2 3"]]:
    """(wood, twigs as (position, outward direction)) of a tree that stands on the origin."""
    wood: list[Mesh] = []
    tips: list[tuple[ndarray, ndarray]] = []

    def grow(start: ndarray, direction: ndarray, length: float, radius: float, level: int) -> None:
        steps = 5 if level == 0 else 4
        path = [start]
        for _ in range(steps):
            direction = unit(direction + rng.normal(0, 0.13, 3) + np.array([0, 0.10 * (level > 0), 0]))
            path.append(path[-1] + direction * length / steps)
        taper = np.linspace(radius, radius * 0.55, steps + 1)
        if level == 0:
            taper[0] *= 1.5
        wood.append(tube(path, taper, (9, 6, 4, 3)[level], 0.7))
        if level >= levels - 1:
            tips.extend((path[k], direction) for k in range(1, steps + 1))
        if level == levels:
            return
        count = (5, 4, 3)[min(level, 2)]
        for k in range(count):
            t = 1.0 if k == 0 else rng.uniform(0.45, 1.0)
            where = path[min(int(t * steps), steps)]
            angle = 2 * np.pi * (k / count + rng.uniform(-0.1, 0.1))
            out = np.array([np.cos(angle), rng.uniform(0.1, 0.7), np.sin(angle)]) * spread
            grow(where, unit(direction + out), length * rng.uniform(0.5, 0.68), radius * 0.5, level + 1)

    grow(np.zeros(3), np.array([0.0, 1.0, 0.0]), height * 0.42, height * 0.030, 0)
    return join(wood), np.array(tips)


def leaf_cards(rng: Generator, tips: Float[ndarray, "k 2 3"], size: float, each: int = 2) -> Mesh:
    """Bent cards at the twigs, `each` per twig;
    their normals point away from the crown's middle, which shades it softly.
    """
    middle = tips[:, 0].mean(axis=0) - (0, size, 0)
    points, uvs = [], []
    for place, direction in np.repeat(tips, each, axis=0):
        up = unit(direction + rng.normal(0, 0.55, 3))
        side = unit(np.cross(up, rng.normal(0, 1, 3)))
        bend = np.cross(side, up) * size * 0.15
        long, wide = size * rng.uniform(0.8, 1.2), size * 0.5 * rng.uniform(0.8, 1.2)
        foot, tip = place - up * long * 0.1, place + up * long
        points += [foot - side * wide, foot + side * wide, tip - side * wide + bend, tip + side * wide + bend]
        uvs += [(0, 1), (1, 1), (0, 0), (1, 0)]
    p = np.array(points, np.float32)
    first = 4 * np.arange(len(p) // 4)[:, None]
    indices = (first + np.array([0, 1, 3, 0, 3, 2])).reshape(-1)
    outward = p - middle
    normals = outward / np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-6)
    return Mesh(p, normals.astype(np.float32), np.array(uvs, np.float32), indices.astype(np.uint32))


def fern(rng: Generator, size: float, fronds: int = 9) -> Mesh:
    """A rosette of arching fronds, each a bent card."""
    parts = []
    for k in range(fronds):
        angle = 2 * np.pi * (k + rng.uniform(-0.3, 0.3)) / fronds
        out, side = np.array([np.cos(angle), 0, np.sin(angle)]), np.array([-np.sin(angle), 0, np.cos(angle)])
        long, rise = size * rng.uniform(0.75, 1.15), rng.uniform(0.55, 0.95)
        t = np.linspace(0, 1, 7)[:, None]
        spine = out * long * (0.15 * t + 0.85 * t**1.4) + np.array([0, 1, 0]) * long * rise * (1.5 * t - 1.15 * t**2)
        wide = side * long * 0.20
        fold = np.array([0, 0.05 * long, 0])
        grid = np.stack([spine - wide + fold, spine, spine + wide + fold], axis=1)
        uvs = np.stack(np.broadcast_arrays(np.array([[0, 0.5, 1]]), 1 - t), axis=-1)
        parts.append(from_grid(grid, uvs, 60))
    return join(parts)


def grass(rng: Generator, places: Float[ndarray, "k 3"], tall: float) -> Mesh:
    """Single blades at the places: thin triangles that lean and darken nowhere, with upward normals."""
    count = len(places)
    angle, lean = rng.uniform(0, 2 * np.pi, count), rng.uniform(0.1, 0.6, count)
    side = np.stack([np.cos(angle), 0 * angle, np.sin(angle)], axis=1) * tall * 0.045
    out = np.stack([-np.sin(angle), 0 * angle, np.cos(angle)], axis=1)
    high = tall * rng.uniform(0.5, 1.2, count)[:, None]
    middle = places + np.array([0, 0.55, 0]) * high + out * high * lean[:, None] * 0.3
    tip = places + np.array([0, 1.0, 0]) * high + out * high * lean[:, None]
    p = np.stack([places - side, places + side, middle - side * 0.8, middle + side * 0.8, tip], axis=1).reshape(-1, 3)
    indices = (5 * np.arange(count)[:, None] + np.array([0, 3, 1, 0, 2, 3, 2, 4, 3])).reshape(-1)
    normals = np.repeat(0.35 * out + np.array([0, 1, 0]), 5, axis=0)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    uvs = np.tile(np.array([[0, 1], [1, 1], [0.1, 0.5], [0.9, 0.5], [0.5, 0]]), (count, 1))
    return Mesh(p.astype(np.float32), normals.astype(np.float32), uvs.astype(np.float32), indices.astype(np.uint32))


def swaying(mesh: Mesh, height: float, amount: float) -> Mesh:
    """The mesh with two shape keys that bend it along x and along z, more the higher, with a flutter of each part.

    The normals stay: leaves are lit by the crown's shape.
    """
    p = mesh.positions.astype(np.float64)
    lift = np.clip(p[:, 1:2] / height, 0, 1.2) ** 1.5 * amount
    flutter = 1 + 0.5 * np.sin(p @ np.array([[3.1], [2.3], [4.7]]) * 2.0)
    keys = np.stack([lift * flutter * (1, -0.15, 0.2), lift * (2 - flutter) * (-0.2, 0.1, 1)])
    return replace(mesh, morphs=keys.astype(np.float32), morph_normals=np.zeros_like(keys, np.float32))


def wind(time: float, phase: float, speed: float = 1.0) -> Float[ndarray, "2"]:
    """Weights of the two sway keys at a time in frames: gusts over a steady lean."""
    t = 0.11 * speed * time + phase
    gust = 0.6 + 0.4 * np.sin(0.37 * t + phase)
    return np.array([0.4 + gust * np.sin(t), gust * 0.7 * np.sin(1.31 * t + 1.0)])
