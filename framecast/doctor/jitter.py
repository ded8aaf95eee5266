"""How the picture shakes: shifts that vectors leave unexplained, and the sequence of sample positions behind them.

Content at pixel p of frame t was sampled at p + j(t), so between frames the picture moves by j(t) - j(t-1) more than
vectors without jitter say. That is measured for every pair, and compared with what is recorded and with Halton (2, 3).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from framecast.importers.decode import radical_inverse

LENGTHS = (4, 8, 16, 18, 23, 24, 32, 37, 64, 72, 73, 128)
"""Phases that engines use, see the docs of FSR, XeSS, DLSS and Unreal; shorter ones are tried first."""

SHAKE = 0.06
"""Pixels (root mean square) from which on a picture is jittered."""


@dataclass(frozen=True)
class Match:
    """A sequence of sample positions that explains measured shifts."""

    slope: tuple[float, float]
    """Measured shift for each pixel of the sequence, x and y: 1 is agreement, -1 the opposite sign."""
    explained: float
    """Share of the variance of the shifts, with the sequence's own length (slope between 0.4 and 1.3)."""


def compare(measured: np.ndarray, expected: np.ndarray) -> Match:
    """Shifts `n 2` and what a sequence predicts, the sign and length of each axis fitted."""
    slope = (measured * expected).sum(0) / np.maximum((expected**2).sum(0), 1e-9)
    rest = ((measured - slope * expected) ** 2).sum()
    return Match((float(slope[0]), float(slope[1])), float(1 - rest / max((measured**2).sum(), 1e-12)))


def halton(start: int, length: int, count: int) -> np.ndarray:
    """Sample positions `count 2` in pixels: Halton (2, 3) from phase `start` on, minus one half."""
    phases = [(start + i) % length + 1 for i in range(count)]
    return np.array([[radical_inverse(p, 2) - 0.5, radical_inverse(p, 3) - 0.5] for p in phases])


def sequence_of(frames: Sequence[int], measured: np.ndarray) -> tuple[int, int, Match] | None:
    """Length and start of the Halton sequence behind shifts of frames against the ones before; None: no such."""
    later = np.array(frames)
    phases = halton(0, 1 << 30, max(LENGTHS))
    found = []
    for length in LENGTHS:
        for start in range(length):
            expected = phases[(start + later) % length] - phases[(start + later - 1) % length]
            match = compare(measured, expected)
            if all(0.35 < abs(s) < 1.3 for s in match.slope):
                found.append((match.explained - 0.0005 * length, length, start, match))
    if not found:
        return None
    _, length, start, match = max(found, key=lambda entry: entry[0])
    return (length, start, match) if match.explained > 0.85 else None


def signs(match: Match) -> tuple[float, float]:
    """Sign of each axis."""
    return float(np.sign(match.slope[0])), float(np.sign(match.slope[1]))


AXES = tuple(product((1.0, -1.0), repeat=2))
