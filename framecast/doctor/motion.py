"""What stored vectors may mean, and how well one reading of them makes neighbouring frames agree.

Every reading is a `Motion` of the import settings; its error is how different the other frame looks where the vectors
point, in points that the vectors move. A jittered picture shakes by more than slow objects move, so the whole picture's
shift between two frames is either known (`Shifts`) or fitted anew for each pair.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import product
from typing import Literal

import numpy as np

from framecast.doctor.probe import (
    BLOCKS,
    POINTS,
    Pair,
    fit_shift,
    misfit,
    pair_of,
    pick_points,
    sample,
    thinned,
    votes,
)
from framecast.doctor.take import Take
from framecast.importers.decode import unpack
from framecast.importers.settings import Motion

PAIRS = 8
"""Pairs of frames on which readings compete."""

UNREAL_BIAS, UNREAL_SCALE = 32767 / 65535, 1 / 0.2495

EMPTY_SHARE = 0.02
"""Share of the picture that has to be without vectors for a verdict."""

FACTORS = (1.0, 0.5, 2.0, 0.25, 4.0)
"""Lengths of vectors in pixels that are tried: half and double are other resolutions, or the half that NDC loses."""


TELLING = 0.75
"""Share of the points that decide between two readings: those that one of them explains best."""

Direction = Literal["current->previous", "previous->current", "current->next", "next->current"]

DIRECTIONS: tuple[Direction, ...] = ("current->previous", "previous->current", "current->next", "next->current")


CODES: tuple[tuple[Literal["uv", "ndc"], float], ...] = (("uv", 1.0), ("uv", 2.0), ("ndc", 1.0))
"""What one unit of a code about one half is worth."""

PACKINGS: tuple[Literal["base255", "base256"], ...] = ("base255", "base256")


@dataclass(frozen=True)
class Reading:
    """One way to read the stored vectors, and how well it does."""

    motion: Motion
    offset: int = 0
    """Frames between the one that the file is named after and the one that its vectors belong to."""
    error: float = float("inf")


@dataclass(frozen=True)
class Scene:
    """Points of some pairs, and the stored vectors there."""

    pairs: tuple[Pair, ...]
    after: tuple[Pair | None, ...]
    """The same points against the next frame, where there is one."""
    moving: tuple[np.ndarray, ...]
    """Points that the vectors move, a mask a pair."""
    points: tuple[np.ndarray, ...]
    size: tuple[int, int]
    own: tuple[int, int]
    """Height and width of the vectors' own image."""
    base: tuple[tuple[np.ndarray, np.ndarray | None], ...] = ()
    """Displacements `2 n` a pair that are added to the vectors, to the frame before and to the next one: the camera's
    part, where they lack it."""


def displacement(stored: np.ndarray, motion: Motion, size: tuple[int, int], own: tuple[int, int]) -> np.ndarray:
    """Vectors `2 n` in pixels of an image of `size` from numbers `c n` as stored; what `decode_motion` makes of them.

    Where the vector leads (to the previous or the next frame) is the business of the caller.
    """
    v = unpack(stored[:, None], 2, motion.packing)[:, 0].astype(np.float64)
    v = (v - np.array(motion.bias)[:, None]) * np.array(motion.scale)[:, None]
    if motion.packing == "unreal_sqrt":
        v = v * np.abs(v) / 2
    (height, width), (w, h) = size, motion.size or (own[1], own[0])
    unit = {"pixels": (width / w, height / h), "uv": (width, height), "ndc": (width / 2, height / 2)}[motion.units]
    turned = -1.0 if motion.direction in ("previous->current", "next->current") else 1.0
    out = v * (np.array(unit) * np.array(motion.sign) * turned)[:, None]
    return np.nan_to_num(out, nan=0, posinf=1e5, neginf=-1e5).clip(-1e5, 1e5).astype(np.float32)


def readings(layer: Motion, stored: np.ndarray) -> Iterator[Motion]:
    """Everything that these numbers may mean, the plainest first. `stored`: a sample `c n` of them."""
    for plain, signs, direction in product(units(layer, stored), ((1.0, 1.0), (1.0, -1.0)), DIRECTIONS):
        yield replace(plain, sign=signs, direction=direction)


def units(layer: Motion, stored: np.ndarray) -> Iterator[Motion]:
    """Units, codes and packings that are possible for numbers of this range."""
    bare = Motion(files=layer.files, channels=layer.channels)
    coded = bool(stored.min() >= 0 and stored.max() <= 1.01)
    if len(stored) == 4:
        for packing in PACKINGS:
            for unit, factor in CODES:
                yield replace(bare, packing=packing, bias=(0.5, 0.5), scale=(factor, factor), units=unit)
        return
    if coded and np.ptp(stored) > 0:
        middle = resting(stored)
        for unit, factor in CODES:
            yield replace(bare, bias=middle, scale=(factor, factor), units=unit)
        unreal = replace(bare, bias=(UNREAL_BIAS,) * 2, scale=(UNREAL_SCALE,) * 2, units="ndc")
        yield unreal
        yield replace(unreal, packing="unreal_sqrt")
        if abs(float(np.median(stored)) - 0.5) < 0.25 and np.quantile(stored, 0.02) > 0.02:
            return
    for factor in FACTORS:
        yield replace(bare, scale=(factor, factor))
    yield replace(bare, units="uv")
    yield replace(bare, units="ndc")


def resting(stored: np.ndarray) -> tuple[float, float]:
    """The code near one half that stands for no motion: of those in use the one that most pixels hold, else 0.5."""
    usual = np.array([0.5, 127 / 255, 128 / 255, UNREAL_BIAS, 32768 / 65535])
    counts = [int((np.abs(stored - code) < 2e-6).sum()) for code in usual]
    best = float(usual[int(np.argmax(counts))]) if max(counts) > 0.01 * stored.size else 0.5
    return best, best


def scene_of(take: Take, name: str = "motion", *, written: bool = False) -> Scene | None:
    """Points of up to `PAIRS` pairs spread over the take: half where the vectors differ from the usual one, half
    anywhere with texture (`written`: all where vectors are written at all). None where no pair has texture."""
    spread = [t for t in take.pairs if name in take.stored[t]]
    if len(spread) > PAIRS:
        spread = [spread[round(i * (len(spread) - 1) / (PAIRS - 1))] for i in range(PAIRS)]
    pairs, after, moving, every = [], [], [], []
    own = (0, 0)
    for t in spread:
        stored = take.stored[t][name]
        own = (stored.shape[1], stored.shape[2])
        image = take.images[t]
        lively = ~resampled(blank(stored)[0], take.size) if written else restless(stored, take.size)
        anywhere = lively if written else np.ones_like(lively)
        points = np.union1d(
            pick_points(image, lively, POINTS // 2, t), pick_points(image, anywhere, POINTS // 2, t + 1)
        )
        if len(points) < 50:
            continue
        pair = pair_of(take.images, t, t - 1, points)
        pairs.append(pair)
        follows = t + 1 < len(take.numbers) and take.joined[t + 1]
        after.append(replace(pair, there=t + 1, other=take.images[t + 1]) if follows else None)
        moving.append(lively.flat[points])
        every.append(points)
    return Scene(tuple(pairs), tuple(after), tuple(moving), tuple(every), take.size, own) if pairs else None


def blank(stored: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixels `h w` that hold exactly the most usual number of each channel, and those; none where they are rare, or
    where x and y differ, as in the vectors of a camera that moves along a wall, or sideways with parallel rays."""
    some = thinned(stored.shape[1])
    code = np.array([_usual(plane[some, some]) for plane in stored])
    same: np.ndarray = (stored == code[:, None, None]).all(0)
    one = len(code) != 2 or code[0] == code[1]
    return (same if one and same.mean() >= EMPTY_SHARE else np.zeros_like(same)), code


def _usual(plane: np.ndarray) -> float:
    values, counts = np.unique(plane, return_counts=True)
    return float(values[np.argmax(counts)])


def restless(stored: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Pixels of an image of `size` whose vector differs from the most usual one by a good part of the largest."""
    planes = stored[:2].astype(np.float32) if len(stored) < 4 else stored.astype(np.float32)
    planes = np.nan_to_num(planes, nan=0, posinf=0, neginf=0)
    distance = np.zeros(planes.shape[1:], np.float32)
    some = thinned(planes.shape[1])
    for plane in planes:
        distance = np.maximum(distance, np.abs(plane - np.median(plane[some, some])))
    top = np.quantile(distance[some, some], 0.995)
    return resampled((distance > 0.15 * top) & (distance > 0), size)


def resampled(plane: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """The nearest pixel of a plane for each pixel of an image of `size`."""
    if plane.shape == size:
        return plane
    rows = ((np.arange(size[0]) + 0.5) * plane.shape[0] / size[0]).astype(int)
    columns = ((np.arange(size[1]) + 0.5) * plane.shape[1] / size[1]).astype(int)
    return plane[rows][:, columns]


def at_points(stored: np.ndarray, points: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Values `c n` of the nearest stored pixel at linear indices of an image of `size`."""
    row, column = points // size[1], points % size[1]
    row = ((row + 0.5) * stored.shape[1] / size[0]).astype(int)
    column = ((column + 0.5) * stored.shape[2] / size[1]).astype(int)
    return stored[:, row, column]


@dataclass(frozen=True)
class Trial:
    """Errors of one reading in the points that the vectors move, and the vectors there, by index of the pair."""

    reading: Reading
    errors: Mapping[int, np.ndarray]
    vectors: Mapping[int, np.ndarray]

    @property
    def mean(self) -> float:
        """Mean error over all points of all pairs; infinite where the reading could not be tried."""
        return float(np.concatenate(list(self.errors.values())).mean()) if self.errors else float("inf")

    @property
    def core(self) -> float:
        """Mean of the smaller three quarters of the errors: without what is hidden in the other frame."""
        errors = np.sort(np.concatenate(list(self.errors.values()))) if self.errors else np.array([np.inf])
        return float(errors[: max(1, 3 * len(errors) // 4)].mean())


Shifts = Mapping[tuple[int, int], tuple[float, float]]
"""Displacement of the whole picture between two frames that is not in the vectors: the difference of the jitters."""


def glance(take: Take, scene: Scene, reading: Reading, name: str) -> float:
    """Error of a reading in a tenth of the points, without shifts: enough to say which readings deserve a look."""
    errors = []
    for k, (before, after, moving) in enumerate(zip(scene.pairs, scene.after, scene.moving, strict=True)):
        pair = after if "next" in reading.motion.direction else before
        if pair is None or (after is None and any(a is not None for a in scene.after)):
            continue
        some = np.flatnonzero(moving)[:: max(1, int(moving.sum()) // 400)]
        stored = at_points(take.stored[before.here][name], scene.points[k][some], take.size)
        v = displacement(stored, reading.motion, scene.size, scene.own) * np.float32(take.stretch)
        v = v + _base(scene, k, reading)[:, some] if scene.base else v
        there = sample(pair.other, pair.x[some] + v[0], pair.y[some] + v[1])
        errors.append(np.minimum(np.abs(pair.value[:, some] - there).mean(0), 1))
    return float(np.concatenate(errors).mean()) if errors else float("inf")


def trial(take: Take, scene: Scene, reading: Reading, shifts: Shifts | None = None, name: str = "motion") -> Trial:
    """How well a reading explains the pairs; `shifts` None: one free shift a pair is fitted."""
    errors, vectors = {}, {}
    for k, (before, after, moving) in enumerate(zip(scene.pairs, scene.after, scene.moving, strict=True)):
        pair = after if "next" in reading.motion.direction else before
        lone = after is None and any(a is not None for a in scene.after)
        v = vectors_of(take, scene, k, reading, name)
        if pair is None or lone or v is None or not moving.any():
            continue
        dx, dy = fit_shift(pair, *v, steps=3) if shifts is None else shifts.get((pair.here, pair.there), (0.0, 0.0))
        errors[k] = misfit(pair, v[0] + dx, v[1] + dy)[moving]
        vectors[k] = v[:, moving]
    return Trial(reading, errors, vectors)


def vectors_of(take: Take, scene: Scene, k: int, reading: Reading, name: str) -> np.ndarray | None:
    """Displacements `2 n` in all points of a pair under a reading; None where the file would lie outside the take."""
    source = scene.pairs[k].here - reading.offset
    if not 0 <= source < len(take.stored) or name not in take.stored[source]:
        return None
    stored = at_points(take.stored[source][name], scene.points[k], take.size)
    v = displacement(stored, reading.motion, scene.size, scene.own) * np.float32(take.stretch)
    return v + _base(scene, k, reading) if scene.base else v


def _base(scene: Scene, k: int, reading: Reading) -> np.ndarray:
    """What is added to the vectors of a pair so read."""
    before, after = scene.base[k]
    return after if after is not None and "next" in reading.motion.direction else before


def margin(best: Trial, other: Trial, scene: Scene) -> tuple[float, float, float]:
    """Errors of two readings where they differ by more than a quarter pixel, and the votes for the first.

    The points that both explain worst are left out: what is hidden in the other frame, reflections, foam.
    """
    turned = ("next" in best.reading.motion.direction) != ("next" in other.reading.motion.direction)
    ours, theirs, blocks = [], [], []
    for k in best.errors.keys() & other.errors.keys():
        apart = (np.abs(best.vectors[k] - other.vectors[k]).max(0) > 0.25) | turned
        ours.append(best.errors[k][apart])
        theirs.append(other.errors[k][apart])
        blocks.append(scene.pairs[k].block[scene.moving[k]][apart] + k * BLOCKS * BLOCKS)
    if sum(map(len, ours)) < 40:
        return 0.0, 0.0, 0.0
    a, b = np.concatenate(ours), np.concatenate(theirs)
    lesser = np.minimum(a, b)
    told = lesser <= np.quantile(lesser, TELLING)
    a, b = a[told], b[told]
    return float(a.mean()), float(b.mean()), float(votes(a, b, np.concatenate(blocks)[told]))
