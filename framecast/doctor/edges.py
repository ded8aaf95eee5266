"""Vectors at silhouettes: of the same frame as depth, as wide as the object, crisp, and how finely stored."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from framecast.doctor.camera import sky_of
from framecast.doctor.motion import resampled
from framecast.doctor.probe import thinned
from framecast.doctor.take import Take

JUMP = 0.25
"""Pixels by which vectors have to differ across a silhouette that is looked at; at least `STEPS` times their grain."""

STEPS = 20


@dataclass(frozen=True)
class Edges:
    """What vectors do within two pixels of silhouettes."""

    count: int
    dilated: float
    """Share of the background's first pixels that carry the vector of the object."""
    mixed: float
    """Share of pixels at silhouettes whose vector lies between both sides' vectors."""


def edges_of(vectors: Mapping[int, np.ndarray], depths: Mapping[int, np.ndarray], grain: float = 0.0) -> Edges:
    """Silhouettes along rows and columns, four pixels on either side of which all is smooth.

    Args:
        vectors: by frame, `2 h w` pixels. depths: distance `h w`, or anything that grows with it.
        grain: steps in which vectors are stored, pixels.
    """
    least = max(JUMP, STEPS * grain)
    carried, between = [], []
    for t in vectors.keys() & depths.keys():
        for flip in (False, True):
            for turn in (False, True):
                z, v = depths[t], vectors[t]
                z, v = (z.T, v.transpose(0, 2, 1)) if turn else (z, v)
                z, v = (z[:, ::-1], v[:, :, ::-1]) if flip else (z, v)
                some = thinned(len(z))
                a, b = across(z[some], v[:, some], least)
                carried.append(a)
                between.append(b)
    a = np.concatenate(carried) if carried else np.zeros(0, bool)
    b = np.concatenate(between) if between else np.zeros(0, bool)
    return Edges(len(a), float(a.mean()) if len(a) else 0.0, float(b.mean()) if len(b) else 0.0)


def across(z: np.ndarray, v: np.ndarray, least: float) -> tuple[np.ndarray, np.ndarray]:
    """At places where near pixels are followed by far ones along a row, and vectors differ by `least` pixels: does the
    first far pixel carry the vector of the near side, and does the vector of one of the two at the edge lie between
    both sides?"""
    columns = {k: slice(4 + k, z.shape[1] - 5 + k) for k in range(-4, 6)}
    d = {k: z[:, s] for k, s in columns.items()}
    m = {k: v[:, :, s] for k, s in columns.items()}
    edge = (d[1] > 1.1 * d[0]) & (np.abs(d[0] - d[-3]) < 0.05 * d[0]) & (np.abs(d[4] - d[1]) < 0.05 * d[1])
    near, far = m[-3], m[4]
    jump = np.abs(near - far).max(0)
    calm = (np.abs(m[-3] - m[-4]).max(0) < 0.1 * jump) & (np.abs(m[5] - m[4]).max(0) < 0.1 * jump)
    use = edge & calm & (jump > least)
    if not use.any():
        return np.zeros(0, bool), np.zeros(0, bool)
    axis = (near - far)[:, use]
    length = (axis * axis).sum(0)
    share = {k: ((m[k][:, use] - far[:, use]) * axis).sum(0) / length for k in (-1, 0, 1, 2)}
    mixed = np.zeros(use.sum(), bool)
    for k in (0, 1):
        mixed |= (share[k] > 0.15) & (share[k] < 0.85)
    return share[1] > 0.85, mixed


def alignments(take: Take, offsets: Sequence[int]) -> dict[int, tuple[float, int]]:
    """Correlation between where depth jumps in a frame and where the vectors of the file `offset` frames before do, and
    in how many frames, by offset; depth as it is or widened as vectors may be, whichever fits best."""
    size = _reduced(take.size)
    depths = {
        t: [_jumps(plane[None]) for plane in widened(relative(resampled(take.stored[t]["depth"][0], size)))]
        for t in take.pairs
        if "depth" in take.stored[t]
    }
    vectors = {}
    for s in {t - offset for t in depths for offset in offsets}:
        if 1 <= s < len(take.stored) and "motion" in take.stored[s]:
            planes = take.stored[s]["motion"][:2].astype(np.float32)
            vectors[s] = _jumps(np.stack([resampled(plane, size) for plane in np.nan_to_num(planes)]))
    out = {}
    for offset in offsets:
        usable = [t for t in depths if t - offset in vectors and vectors[t - offset].std() > 0]
        usable = [t for t in usable if depths[t][0].std() > 0]
        scores = [
            [float(np.corrcoef(jumps.ravel(), vectors[t - offset].ravel())[0, 1]) for jumps in depths[t]]
            for t in usable
        ]
        out[offset] = (float(np.median(scores, 0).max()), len(scores)) if scores else (0.0, 0)
    return out


def widened(depth: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A depth image, and with what is small, or large, one pixel wider on every side."""
    around = [np.roll(depth, (j, i), (0, 1)) for j in (-1, 0, 1) for i in (-1, 0, 1)]
    return depth, np.minimum.reduce(around), np.maximum.reduce(around)


def _reduced(size: tuple[int, int]) -> tuple[int, int]:
    """A size of at most some hundred rows: silhouettes of large pictures move by more pixels."""
    times = max(1, round(size[0] / 240))
    return size[0] // times, size[1] // times


def relative(depth: np.ndarray) -> np.ndarray:
    """Rank of the numbers in 0..1: edges of it do not depend on what kind of depth it is."""
    flat = np.nan_to_num(depth.astype(np.float32), nan=0, posinf=3e38, neginf=0)
    order = np.sort(flat.ravel()[:: max(1, flat.size // 2000)])
    return (np.searchsorted(order, flat) / len(order)).astype(np.float32)


def _jumps(planes: np.ndarray) -> np.ndarray:
    """Where neighbours differ much more than usual, 0..1, `h w`."""
    step = np.zeros(planes.shape[1:], np.float32)
    step[:, 1:] += np.abs(np.diff(planes, axis=2)).max(0)
    step[1:] += np.abs(np.diff(planes, axis=1)).max(0)
    top = np.quantile(step, 0.99)
    return np.minimum(step / top, 1) if top > 0 else step


@dataclass(frozen=True)
class Grain:
    """How finely vectors are stored."""

    pixels: float
    """Median distance in pixels to the next number that could be stored, for the larger vectors."""
    half: bool
    """Every number is a half float, although the file may hold more."""
    bits: int


def grain_of(take: Take, scale: float, bits: int) -> Grain:
    """The grain of the stored numbers, times pixels a unit."""
    numbers = np.concatenate(
        [
            np.abs(take.stored[t]["motion"][:2].ravel()[::17].astype(np.float32))
            for t in take.pairs[:4]
            if "motion" in take.stored[t]
        ]
        or [np.zeros(0, np.float32)]
    )
    numbers = numbers[np.isfinite(numbers) & (numbers > 0)]
    if len(numbers) < 100:
        return Grain(0.0, False, bits)
    if bits < 32:
        return Grain(scale / (2**bits - 1), False, bits)
    half = bool((numbers.astype(np.float16).astype(np.float32) == numbers).all())
    large = numbers[numbers >= np.median(numbers)].astype(np.float16)
    return Grain(float(np.median(np.spacing(large).astype(np.float32))) * scale if half else 0.0, half, bits)


def solid_depths(take: Take, depths: Mapping[int, np.ndarray]) -> dict[int, np.ndarray]:
    """Depths with the sky very far."""
    return {t: np.where(sky_of(take.stored[t]["depth"][0]), 1e6, z) for t, z in depths.items()}
