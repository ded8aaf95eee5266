"""The reading of the vectors that explains the picture best, by how much, and how the picture shakes besides."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from framecast.doctor.jitter import SHAKE, Match, compare, halton, sequence_of, signs
from framecast.doctor.motion import (
    Direction,
    Reading,
    Scene,
    Shifts,
    Trial,
    at_points,
    glance,
    margin,
    readings,
    trial,
    vectors_of,
)
from framecast.doctor.probe import fit_shift
from framecast.doctor.take import Take
from framecast.importers.settings import Motion

SURE = 2.5
"""Votes (standard deviations) that make a difference count."""

RATIO = 1.05
"""Ratio of errors that makes a difference count."""

PLAIN = 1.25
"""Ratio of errors, without vectors and with them, that a reading needs to be taken in place of the claimed one."""

EVEN = 1.15
"""Ratio of errors, the largest left out, that makes the next frame count in place of the previous one with the sign
turned around: while everything moves evenly both say the same, and what is hidden in one of them must not decide."""

FINALISTS = 6
"""Readings that are compared again once the shaking of the picture is known."""


@dataclass(frozen=True)
class Shake:
    """How the picture moves as a whole by more than the vectors say, `n 2` for the pairs, in pixels."""

    frames: tuple[int, ...]
    measured: np.ndarray
    recorded: Match | None
    """Agreement with the recorded jitter; None where none is recorded."""
    sequence: tuple[int, int, Match] | None
    """Length and start of a Halton sequence that explains it."""

    @property
    def size(self) -> float:
        """Root mean square, pixels an axis."""
        return float(np.sqrt((self.measured**2).mean())) if len(self.measured) else 0.0

    @property
    def usual(self) -> float:
        """The same without the quarter of the pairs that move most: jitter moves all, a broken frame one."""
        lengths = np.sort((self.measured**2).mean(1))
        return float(np.sqrt(lengths[: -(len(lengths) // 4) or None].mean())) if len(lengths) else 0.0

    @property
    def certain(self) -> bool:
        """Whether the recorded jitter explains it so well that it needs no other witness."""
        return self.recorded is not None and fits(self.recorded) and self.recorded.explained > 0.95

    @property
    def follows_record(self) -> bool:
        """Whether the recorded jitter explains it, with any sign."""
        return self.recorded is not None and fits(self.recorded)


@dataclass(frozen=True)
class Answer:
    """What the vectors mean."""

    best: Trial
    claim: Trial
    still: Trial
    """All vectors 0."""
    shake: Shake
    shifts: Shifts | None
    unsure: tuple[str, ...]
    """Of direction, y, time, length: what cannot be told from this picture."""
    scene: Scene

    @property
    def decided(self) -> bool:
        """Whether the vectors explain anything at all; a reading that hardly does overturns no claim."""
        ours, theirs, sure = margin(self.best, self.still, self.scene)
        as_claimed = self.best.reading.motion == self.claim.reading.motion
        return sure >= SURE and theirs > (RATIO if as_claimed else PLAIN) * ours


def fits(match: Match) -> bool:
    """Whether a sequence explains measured shifts, with any sign of its axes."""
    return match.explained > 0.8 and all(0.35 < abs(s) < 1.3 for s in match.slope)


def search(take: Take, scene: Scene, claim: Motion, name: str = "motion") -> Answer:
    """All readings compete; the claimed one stands unless another is better beyond doubt."""
    sampled = np.concatenate(
        [
            at_points(take.stored[p.here][name], points, take.size)
            for p, points in zip(scene.pairs, scene.points, strict=True)
        ],
        1,
    )
    rivals = [Reading(m) for m in readings(claim, sampled)]
    rivals.sort(key=lambda r: glance(take, scene, r, name))
    still = Reading(replace(claim, scale=(1e-12, 1e-12)))
    ours = Reading(claim)
    finalists = [*rivals[:FINALISTS], ours]
    fixed = min((trial(take, scene, r, {}, name) for r in finalists), key=lambda t: t.mean)
    leader = min((trial(take, scene, r, None, name) for r in finalists), key=lambda t: t.mean)
    if fixed.mean < 1.05 * leader.mean:
        leader = fixed
    shake = truest(*(measure_shake(take, scene, r, name) for r in dict.fromkeys((leader.reading, ours))))
    shifts = shifts_of(take, shake)
    final = [trial(take, scene, r, shifts, name) for r in finalists]
    claimed, zero = final[-1], trial(take, scene, still, shifts, name)
    best = simplest(final, claimed, scene)
    return Answer(best, claimed, zero, shake, shifts, doubts(take, scene, best, shifts, name), scene)


def simplest(trials: Sequence[Trial], claim: Trial, scene: Scene) -> Trial:
    """The trial of the least error, or one that differs less from the claim and is not worse beyond doubt."""
    leader = min(trials, key=lambda t: t.mean)
    for rival in sorted(trials, key=lambda t: deviations(t.reading, claim.reading)):
        ours, theirs, sure = margin(leader, rival, scene)
        even = OTHER_TIME[leader.reading.motion.direction] == rival.reading.motion.direction
        if sure < SURE or theirs < RATIO * ours or (even and rival.core < EVEN * leader.core):
            return rival
    return leader


def deviations(reading: Reading, claim: Reading) -> float:
    """In how many ways a reading differs from the claimed one; another frame counts more than another sign."""
    a, b = reading.motion, claim.motion
    count = (
        (a.sign != b.sign) + (a.packing != b.packing) + (a.bias != b.bias) + (a.units != b.units or a.scale != b.scale)
    )
    towards = (a.direction in ("previous->current", "next->current")) != (
        b.direction in ("previous->current", "next->current")
    )
    return count + towards + 1.5 * (("next" in a.direction) != ("next" in b.direction)) + abs(reading.offset)


def truest(shake: Shake, *others: Shake) -> Shake:
    """Of shifts measured along several readings those that the recorded jitter explains best; the first without any."""
    return max((shake, *others), key=lambda s: s.recorded.explained if s.recorded else 0.0)


def measure_shake(take: Take, scene: Scene, reading: Reading, name: str) -> Shake:
    """The shift of the whole picture in every pair of the scene, under a reading."""
    backward = "next" not in reading.motion.direction
    frames, shifts = [], []
    for k, (before, after) in enumerate(zip(scene.pairs, scene.after, strict=True)):
        pair = before if backward else after
        if pair is None:
            continue
        v = vectors_of(take, scene, k, replace(reading, offset=0), name)
        assert v is not None
        shift = fit_shift(pair, v[0], v[1], steps=6)
        frames.append(max(pair.here, pair.there))
        shifts.append(shift if backward else (-shift[0], -shift[1]))
    measured = np.array(shifts)
    expected = recorded_shifts(take, frames)
    known = compare(measured, expected) if "jitter" in take.recorded else None
    shaking = np.sqrt((measured**2).mean()) > SHAKE
    return Shake(tuple(frames), measured, known, sequence_of(frames, measured) if shaking else None)


def recorded_shifts(take: Take, frames: Sequence[int]) -> np.ndarray:
    """Difference of the recorded jitters of frames and the ones before, `n 2`."""
    jitter = np.array([r.jitter for r in take.records])
    return np.array([jitter[t] - jitter[t - 1] for t in frames])


def shifts_of(take: Take, shake: Shake) -> Shifts | None:
    """The picture's shift between neighbours both ways, from the sequence behind it; None: to be fitted."""
    if shake.size < SHAKE:
        return {}
    count = len(take.numbers)
    if shake.follows_record and shake.recorded is not None:
        positions = np.array([r.jitter for r in take.records]) * signs(shake.recorded)
    elif shake.sequence is not None:
        length, start, match = shake.sequence
        positions = halton(start, length, count) * signs(match)
    else:
        return None
    shifts = {}
    for t in range(1, count):
        dx, dy = (float(d) for d in positions[t] - positions[t - 1])
        shifts[(t, t - 1)], shifts[(t - 1, t)] = (dx, dy), (-dx, -dy)
    return shifts


TURNED: dict[Direction, Direction] = {
    "current->previous": "previous->current",
    "previous->current": "current->previous",
    "current->next": "next->current",
    "next->current": "current->next",
}
OTHER_TIME: dict[Direction, Direction] = {
    "current->previous": "next->current",
    "previous->current": "current->next",
    "current->next": "previous->current",
    "next->current": "current->previous",
}
"""The direction that says the same where everything moves evenly."""


def doubts(take: Take, scene: Scene, best: Trial, shifts: Shifts | None, name: str) -> tuple[str, ...]:
    """What another reading could say as well without being worse beyond doubt."""
    m = best.reading.motion
    other = TURNED[m.direction]
    rivals = {
        "direction": replace(m, direction=other, sign=(m.sign[0], -m.sign[1])),
        "y": replace(m, sign=(m.sign[0], -m.sign[1])),
        "time": replace(m, direction=OTHER_TIME[m.direction]),
        "length": replace(m, scale=(m.scale[0] / 2, m.scale[1] / 2)),
    }
    unsure = []
    for what, rival in rivals.items():
        ours, theirs, sure = margin(best, trial(take, scene, replace(best.reading, motion=rival), shifts, name), scene)
        if sure < SURE or theirs < RATIO * ours:
            unsure.append(what)
    return tuple(unsure)
