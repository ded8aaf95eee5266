"""Every frame along the vectors as found: how alike, how much brighter, and how far the picture really moves."""

from dataclasses import dataclass

import numpy as np

from framecast.doctor.camera import camera_motion
from framecast.doctor.motion import at_points, displacement, restless
from framecast.doctor.probe import Pair, fit_shift, misfit, pair_of, pick_points, sample
from framecast.doctor.say_motion import Told
from framecast.doctor.take import Take

BRIGHT = -0.7
"""Value of a comparable image from which on a factor on the light is a step of nearly its logarithm."""

FACTORS = tuple(2.0 ** (k / 3) for k in range(-3, 6))
"""What the vectors may have to be taken times to lead to where the picture went."""

POINTS = 1000
"""Points of the whole picture, and of what the vectors move."""

CLEARLY = 1.1
"""Ratio of the errors in points that both frames show, along the vectors as they are and taken times another factor,
from which on the picture moves by that."""

ENOUGH = 100
"""Points that vectors have to move by half a pixel for a verdict on how far the picture goes."""


@dataclass(frozen=True)
class Step:
    """One frame against the one before."""

    frame: int
    source: int
    """The frame whose vectors lead from one to the other."""
    likeness: float
    """Correlation of the two pictures along the vectors."""
    standing: float
    """Correlation of the two pictures as they are."""
    gain: float
    """Natural logarithm of the factor on the brightness."""
    unevenness: float
    """How much that differs between parts of the picture (median deviation)."""
    change: float
    """Mean difference of the two pictures as they are; 0: the same picture twice."""
    factor: float | None
    """What the vectors have to be taken times that both frames agree best; None where they hardly move anything."""
    turned: float
    """Error along the vectors turned around over the error along the vectors."""


def steps_of(take: Take, told: Told) -> list[Step]:
    """Every frame that is said to follow another one; empty where nothing is known of the vectors."""
    if told.answer is None:
        return []
    next_ = "next" in told.answer.best.reading.motion.direction
    sides = [(t - 1, t) if next_ else (t, t - 1) for t in take.pairs]
    return [step for here, there in sides if (step := step_of(take, told, here, there)) is not None]


def step_of(take: Take, told: Told, here: int, there: int) -> Step | None:
    """Two neighbours, the first of which holds the vectors; None without texture."""
    image, other = take.images[here], take.images[there]
    points = pick_points(image, np.ones(take.size, bool), POINTS, here)
    if "motion" in take.stored[here]:
        points = np.union1d(points, pick_points(image, restless(take.stored[here]["motion"], take.size), POINTS, here))
    if len(points) < 50:
        return None
    pair = pair_of(take.images, here, there, points)
    own, rest = parts(take, told, here, there, points, pair)
    x, y = own + rest
    along, still = sample(pair.other, pair.x + x, pair.y + y), sample(pair.other, pair.x, pair.y)
    gain, unevenness = _gain(pair, along)
    factor, turned = _reach(pair, own, rest)
    return Step(
        max(here, there), here, _likeness(pair.value, along), _likeness(pair.value, still),
        gain if here > there else -gain, unevenness, float(np.abs(image - other).mean()), factor, turned,
    )  # fmt: skip


def parts(
    take: Take, told: Told, here: int, there: int, points: np.ndarray, pair: Pair
) -> tuple[np.ndarray, np.ndarray]:
    """Displacements `2 n` at linear indices: those of the vectors, and what moves the picture besides, the camera's
    part where vectors lack it and the shaking."""
    own = rest = np.zeros((2, len(points)), np.float32)
    answer = told.answer
    assert answer is not None
    source = here - answer.best.reading.offset
    if 0 <= source < len(take.stored) and "motion" in take.stored[source]:
        stored = take.stored[source]["motion"]
        held = at_points(stored, points, take.size)
        size = (stored.shape[1], stored.shape[2])
        own = displacement(held, answer.best.reading.motion, take.size, size) * np.float32(take.stretch)
        if told.lacks and told.blanks is not None:
            empty = (held == told.blanks.code[:, None]).all(0)
            camera = camera_motion(take, pair.at(empty) if empty.sum() > 200 else pair, points, told.blanks.depth)
            rest = camera if told.lacks == "camera" else np.where(empty, camera, 0)
            own = np.where(empty, 0, own)
    shifts = answer.shifts
    shift = fit_shift(pair, *(own + rest), steps=3) if shifts is None else shifts.get((here, there), (0.0, 0.0))
    return own, (rest + np.array(shift)[:, None]).astype(np.float32)


def _gain(pair: Pair, along: np.ndarray) -> tuple[float, float]:
    """Median difference in lit points, and how far parts of the picture are from it."""
    ratio, lit = (pair.value - along).mean(0), pair.value.mean(0) > BRIGHT
    gain = float(np.median(ratio[lit])) if lit.sum() > 50 else 0.0
    blocks = [ratio[lit & (pair.block == b)] for b in np.unique(pair.block[lit])]
    medians = np.array([np.median(block) for block in blocks if len(block) > 15])
    return gain, float(np.median(np.abs(medians - gain))) if len(medians) > 3 else np.inf


def _reach(pair: Pair, own: np.ndarray, rest: np.ndarray) -> tuple[float | None, float]:
    """The best of `FACTORS` in points that the vectors move, and how much worse vectors do that are turned around."""
    moving = np.abs(own).max(0) > 0.5
    if moving.sum() < ENOUGH:
        return None, np.inf
    some, own, rest = pair.at(moving), own[:, moving], rest[:, moving]

    errors = {factor: np.sort(misfit(some, *(factor * own + rest))) for factor in (*FACTORS, -1.0)}
    seen = {factor: float(e[: len(e) // 2].mean()) for factor, e in errors.items()}  # the rest may be hidden
    best = min(FACTORS, key=seen.__getitem__)
    turned = float(errors[-1.0].mean() / max(errors[1.0].mean(), 1e-6))
    return best if seen[1.0] > CLEARLY * seen[best] else 1.0, turned


def _likeness(a: np.ndarray, b: np.ndarray) -> float:
    """Correlation over points and channels."""
    a, b = a - a.mean(), b - b.mean()
    return float((a * b).mean() / max(np.sqrt((a * a).mean() * (b * b).mean()), 1e-9))
