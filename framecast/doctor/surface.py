"""Normals against the shape that depth gives, and colour against albedo: what space, which signs, linear or not."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product

import numpy as np

from framecast.doctor.camera import sky_of
from framecast.doctor.probe import thinned
from framecast.doctor.take import Take
from framecast.importers.decode import AXES
from framecast.importers.settings import Normal

ENOUGH = 5_000
"""Pixels of a frame whose normals are compared with the slopes of depth."""

Signs = tuple[float, float, float]
Space = tuple[str, Signs]

SIGNS: tuple[Signs, ...] = tuple((x, y, z) for x, y, z in product((1.0, -1.0), repeat=3))


@dataclass(frozen=True)
class Normals:
    """How far stored normals are from the slopes of depth: mean angle in degrees by space and sign of the axes."""

    encoded: bool
    plain_share: float
    encoded_share: float
    """Share of the pixels that hold a unit vector as they are, and as n / 2 + 1/2."""
    angles: Mapping[tuple[str, Signs], float]
    flat: Mapping[tuple[str, Signs], tuple[float, float]]
    """The same, and that of the claimed reading, where the two readings differ most, on planes, whose slopes are exact
    (the third of those pixels with the least angles). Empty where the claimed reading cannot be tried."""
    free: Mapping[str, float]
    """The same after the best rotation of the world: `proper`, and `mirrored`, with one axis turned around."""
    facing: Mapping[Signs, float]
    """The same for normals of a world whose axes are those of the camera, by sign."""
    turning: float
    """Degrees by which the cameras are turned against the world: without it world and view are the same."""
    count: int


def normals_of(
    take: Take, depths: Mapping[int, np.ndarray], tangent: float, claim: Normal, axes: str = "opengl"
) -> Normals | None:
    """What the stored normals are; None where no frame has depth and normals with slopes.

    Args:
        depths: distance along the view axis `h w` by frame. tangent: of half the vertical field of view.
        axes: those of the world that stored normals are in, see `Settings.axes`.
    """
    pairs, shares = [], []
    for t, z in depths.items():
        stored = take.stored[t].get("normal")
        if stored is None or stored.shape[1:] != z.shape:
            continue
        v = np.nan_to_num(stored[:3].astype(np.float32))
        solid = ~sky_of(take.stored[t]["depth"][0])
        if solid.mean() < 0.02:
            continue
        shares.append([float((np.abs(np.sqrt((w * w).sum(0)[solid]) - 1) < 0.06).mean()) for w in (v, 2 * v - 1)])
        pairs.append((t, v, *facets(z, solid, tangent)))
    if not pairs:
        return None
    plain_share, encoded_share = np.mean(shares, 0)
    encoded = bool(encoded_share > plain_share)
    scores: dict[Space, list[float]] = {}
    flat: dict[Space, list[tuple[float, float]]] = {}
    free: dict[str, list[float]] = {"proper": [], "mirrored": []}
    facing: dict[Signs, list[float]] = {}
    turning, count = [], 0
    for t, v, slopes, where in pairs:
        n = (2 * v - 1 if encoded else v)[:, where].T.astype(np.float64)
        some = slice(None, None, max(1, len(n) // ENOUGH))
        n, slopes = n[some], slopes[some]
        n = n / np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-3)
        count += len(n)
        if len(n) < 300:
            continue
        view = take.records[t].view if "cameras" in take.recorded else None
        turn = np.asarray(view)[:3, :3] if view is not None else np.eye(3)
        seen: dict[Space, np.ndarray] = {}
        for sign in SIGNS:
            world = (n * sign) @ AXES[axes].T
            facing.setdefault(sign, []).append(least(between(world, slopes), 0.9))
            seen["view", sign] = n * sign
            if view is not None:
                seen["world", sign] = world @ turn.T  # rows: camera = view rotation times world
        off = {space: between(v, slopes) for space, v in seen.items()}
        for space, degrees in off.items():
            scores.setdefault(space, []).append(least(degrees, 0.9))
            if (claimed := (claim.space, claim.sign)) in seen and space != claimed:
                apart = between(seen[space], seen[claimed])
                tells = apart >= max(0.5 * float(np.quantile(apart, 0.99)), 0.2)
                if tells.sum() >= 50:
                    pair = least(degrees[tells], 1 / 3), least(off[claimed][tells], 1 / 3)
                    flat.setdefault(space, []).append(pair)
        if view is not None:
            turning.append(float(np.degrees(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1)))))
        for name, turn in zip(free, rotations(slopes, n @ AXES[axes].T), strict=True):
            free[name].append(least(between(n @ AXES[axes].T, slopes @ turn), 0.9))
    if not scores:
        return None
    planes = {k: (float(np.mean([a for a, _ in v])), float(np.mean([b for _, b in v]))) for k, v in flat.items()}
    return Normals(
        encoded, float(plain_share), float(encoded_share), {k: float(np.mean(v)) for k, v in scores.items()}, planes,
        {k: float(np.mean(v)) for k, v in free.items()}, {k: float(np.mean(v)) for k, v in facing.items()},
        float(np.mean(turning)) if turning else 0.0, count,
    )  # fmt: skip


def between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Angles in degrees between unit vectors `n 3`."""
    degrees: np.ndarray = np.degrees(np.arccos(np.clip((a * b).sum(1), -1, 1)))
    return degrees


def least(degrees: np.ndarray, share: float) -> float:
    """Mean of the smallest of them: a tenth is normal maps and edges."""
    return float(np.sort(degrees)[: max(1, int(share * len(degrees)))].mean())


def facets(z: np.ndarray, solid: np.ndarray, tangent: float) -> tuple[np.ndarray, np.ndarray]:
    """Normals `n 3` in view space of smooth places of a depth image, towards the camera, and where they are; of large
    images every so many rows."""
    height, width = z.shape
    y, x = np.mgrid[0:height, 0:width] + 0.5
    z = np.where(solid, z, 1).astype(np.float64)
    scale = 2 * tangent / height
    point = np.stack([(x - width / 2) * scale * z, (height / 2 - y) * scale * z, -z])
    step = thinned(height).step
    above, here, below = (slice(1 + k, height - 1 + k, step) for k in (-1, 0, 1))
    left, middle, right = (slice(1 + k, width - 1 + k) for k in (-1, 0, 1))
    sides = [(here, left), (here, right), (above, middle), (below, middle)]
    a, b, c, d = (point[:, *side] for side in sides)
    n = np.cross(b - a, d - c, axis=0)
    n = -n / np.maximum(np.linalg.norm(n, axis=0), 1e-12)
    n = np.where((n * point[:, here, middle]).sum(0) > 0, -n, n)
    own, (a, b, c, d) = z[here, middle], (z[side] for side in sides)
    bend = np.abs(a + b - 2 * own) + np.abs(c + d - 2 * own)
    rise = np.abs(b - a) + np.abs(d - c)
    inner = np.logical_and.reduce([solid[here, middle], *(solid[side] for side in sides)])
    smooth = inner & (bend < 0.1 * rise + 1e-4 * own) & (rise < 0.3 * own)
    where = np.zeros((height, width), bool)
    where[here, middle] = smooth
    return n[:, smooth].T, where


def rotations(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The rotation `a @ turn` that brings vectors `n 3` nearest to others, and the best one with a reflection."""
    u, _, v = np.linalg.svd(a.T @ b)
    straight = np.sign(np.linalg.det(u) * np.linalg.det(v))
    proper, mirrored = (u @ np.diag([1, 1, sign]) @ v for sign in (straight, -straight))
    return proper, mirrored


@dataclass(frozen=True)
class Tone:
    """Whether colour looks linear."""

    slope: float | None
    """Change of log colour over that of log albedo, across edges of albedo alone, upper quartile (highlights and haze
    lower it): about 1 for linear light, at most 1/2 for display values. None where such edges are lacking."""
    edges: int
    peak: float
    """Largest number."""
    clipped: float
    """Share of the pixels within 1/500 of the largest number, where that is about 1."""
    middle: float
    """Median."""


def tone_of(take: Take) -> Tone | None:
    """Colour as it is claimed; None where no frame with colour was kept."""
    frames = take.full("color")
    if not frames:
        return None
    values = np.concatenate([take.stored[t]["color"][:3].reshape(3, -1)[:, ::7] for t in frames], 1)
    values = np.nan_to_num(values.astype(np.float32), posinf=65504)
    peak = float(values.max())
    clipped = float((values.max(0) > peak * 0.998).mean()) if 0.9 < peak < 1.02 else 0.0
    ratios = [albedo_edges(take, t) for t in take.full("color", "albedo")]
    joined = np.concatenate(ratios) if ratios else np.zeros(0)
    slope = float(np.quantile(joined, 0.75)) if len(joined) >= 200 else None
    return Tone(slope, len(joined), peak, clipped, float(np.median(values)))


def albedo_edges(take: Take, t: int) -> np.ndarray:
    """Change of log colour over change of log albedo between neighbours where only the albedo jumps."""
    stored = take.stored[t]
    if stored["albedo"].shape[1:] != stored["color"].shape[1:]:
        return np.zeros(0)
    height, width = stored["color"].shape[1:]
    out = []
    for axis in (1, 2):
        some = (slice(3), slice(None), thinned(width)) if axis == 1 else (slice(3), thinned(height))
        albedo, color = (
            np.nan_to_num(stored[name][some].astype(np.float64)).clip(1e-6) for name in ("albedo", "color")
        )
        (a, b), (c, d) = apart(albedo, axis), apart(color, axis)
        jump, change, low = np.log(a / b), np.log(c / d), np.minimum(a, b)
        use = (np.abs(jump) > 0.35) & (low > 0.1)
        for name, most in (("depth", 0.02), ("normal", 0.05)):
            if name in stored and stored[name].shape[1:] == (height, width):
                a, b = apart(np.nan_to_num(stored[name][some].astype(np.float64), posinf=1e9), axis)
                size = 1.0 if name == "normal" else np.maximum(np.abs(b), 1e-9)
                use &= (np.abs(a - b) / size).max(0) < most
        out.append((change / np.where(use, jump, 1))[use])
    return np.concatenate(out)


def apart(plane: np.ndarray, axis: int, step: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """Values `step` pixels further along an axis, and the values here."""
    return (plane[:, step:], plane[:, :-step]) if axis == 1 else (plane[:, :, step:], plane[:, :, :-step])
