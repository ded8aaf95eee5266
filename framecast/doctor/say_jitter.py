"""Verdicts about jitter: does the picture shake as recorded, and do the vectors shake with it?"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from framecast.doctor.jitter import SHAKE, Match, compare, halton
from framecast.doctor.report import Finding
from framecast.doctor.search import Shake, fits
from framecast.doctor.take import Take
from framecast.importers.settings import Jitter

UNEXPLAINED = 0.15
"""Pixels (root mean square) from which on shifts that follow no sequence are jitter; positions anywhere in a pixel
give 0.4, vectors that are not exact a tenth."""


def tell_jitter(
    take: Take, shake: Shake, fields: Mapping[int, np.ndarray], claim: Jitter, *, ahead: int = 0, partial: bool = False
) -> tuple[list[Finding], Jitter, bool]:
    """Findings, how to read the jitter, and whether the vectors hold it.

    Args:
        fields: vectors `2 h w` in pixels towards the previous frame, of some pixels.
        ahead: 1 where they were made from vectors to the next frame.
        partial: vectors are missing in a good part of the picture, so that shifts are those of some objects.
    """
    recorded = "jitter" in take.recorded
    inside = inner_shake(take, fields, ahead)
    if inside is not None:
        said, match, sequence = inside
        known = "as recorded" if said == "recorded" else "by a Halton sequence"
        words = (
            f"the jitter is in the vectors: they shake {known} (slope {match.slope[0]:.2f} "
            f"{match.slope[1]:.2f}, {match.explained:.0%} explained), "
            f"the pictures along them do not ({shake.size:.3f} pixels); the difference of the "
            "jitters has to be taken out"
        )
        found = claim if said == "recorded" else replace(_sequence(sequence, match), units="pixels")
        return [Finding("motion.jittered", "fix", words)], found, True
    if shake.size < SHAKE:
        if recorded:
            words = (
                f"jitter is recorded ({recorded_size(take):.2f} pixels) but the picture does not shake "
                f"({shake.size:.3f} pixels); "
                f"render with the projection jittered, or record none"
            )
            return [Finding("jitter.absent", "fix", words)], Jitter(), False
        return (
            [Finding("jitter", "fine", f"jitter: none, the picture stands to within {shake.size:.3f} pixels")],
            claim,
            False,
        )
    if partial and shake.sequence is None and not shake.follows_record:
        words = "whether the picture shakes cannot be told while vectors are missing where only the camera moves"
        return [Finding("jitter.open", "unknown", words)], claim, False
    if recorded:
        return _against_record(take, shake, claim)
    if shake.sequence is not None:
        length, start, match = shake.sequence
        words = (
            f"the picture is jittered ({shake.size:.2f} pixels) and nothing says so: it follows "
            f"Halton (2, 3) with {length} phases "
            f"from phase {start} on{_signed(match)} ({match.explained:.0%} explained)"
        )
        return [Finding("jitter.unrecorded", "fix", words)], _sequence(shake.sequence, match), False
    if shake.usual < UNEXPLAINED:
        words = (
            f"jitter: none that can be told; the picture moves by {shake.usual:.2f} pixels more than the vectors say, "
            "which is less than jitter does"
        )
        return [Finding("jitter", "note", words)], claim, False
    words = (
        f"the picture shakes by {shake.size:.2f} pixels from frame to frame and nothing says "
        "so; record the jitter of each frame "
        f"(no Halton sequence explains it)"
    )
    return [Finding("jitter.unrecorded", "fix", words)], claim, False


def recorded_size(take: Take) -> float:
    """Root mean square of the recorded jitter, pixels."""
    return float(np.sqrt(np.mean(np.square([r.jitter for r in take.records]))))


def _sequence(sequence: tuple[int, int, Match] | None, match: Match) -> Jitter:
    if sequence is None:
        return Jitter()
    length, start, _ = sequence
    return Jitter(halton=length, start=start, sign=(float(np.sign(match.slope[0])), float(np.sign(match.slope[1]))))


def _signed(match: Match) -> str:
    turned = [axis for axis, slope in zip("xy", match.slope, strict=True) if slope < 0]
    return f", {' and '.join(turned)} negated" if turned else ""


def _against_record(take: Take, shake: Shake, claim: Jitter) -> tuple[list[Finding], Jitter, bool]:
    """The shifts of the picture and what the record, turned, swapped or shifted in time, predicts."""
    match = shake.recorded
    assert match is not None
    if fits(match) and min(match.slope) > 0:
        words = (
            f"jitter: as recorded (the picture moves by {match.slope[0]:.2f} and "
            f"{match.slope[1]:.2f} of it, {match.explained:.0%} explained)"
        )
        return [Finding("jitter", "fine", words)], claim, False
    sign = (float(np.sign(match.slope[0])), float(np.sign(match.slope[1])))
    found = replace(claim, sign=(claim.sign[0] * sign[0], claim.sign[1] * sign[1]))
    if fits(match):
        turned = [axis for axis, s in zip("xy", sign, strict=True) if s < 0]
        words = (
            f"jitter has the wrong sign in {' and '.join(turned)}: the picture moves by "
            f"{match.slope[0]:.2f} and {match.slope[1]:.2f} "
            f"of what is recorded ({match.explained:.0%} explained)"
        )
        return [Finding("jitter.sign", "fix", words)], found, False
    if match.explained > 0.8:
        words = (
            f"jitter is recorded in another unit: the picture moves by {match.slope[0]:.3g} and "
            f"{match.slope[1]:.3g} pixels for each unit "
            f"(UV: {take.size[1]} and {take.size[0]}; NDC: half of that)"
        )
        length = abs(match.slope[0]) / take.size[1]
        if length > 0.7:
            found = replace(found, units="uv")
        elif length > 0.2:
            found = replace(found, units="ndc")
        return [Finding("jitter.unit", "fix", words)], found, False
    for words, positions in altered(take):
        other = compare(shake.measured, np.array([positions[t] - positions[t - 1] for t in shake.frames]))
        if fits(other):
            says = (
                f"recorded jitter is {words}{_signed(other)}: so it explains {other.explained:.0%} of "
                f"the picture's shaking, as recorded {max(match.explained, 0):.0%}"
            )
            sign = (float(np.sign(other.slope[0])), float(np.sign(other.slope[1])))
            values = tuple((float(x), float(y)) for x, y in positions * sign)
            return [Finding("jitter.order", "fix", says)], Jitter(values=values), False
    words = (
        f"the picture does not shake as recorded: by {shake.size:.2f} pixels, of which the "
        f"record explains {max(match.explained, 0):.0%}; "
        f"record each frame's own jitter"
    )
    if shake.sequence is not None:
        length, start, right = shake.sequence
        words += f" (it follows Halton (2, 3), {length} phases from phase {start} on{_signed(right)})"
        return [Finding("jitter.other", "fix", words)], _sequence(shake.sequence, right), False
    return [Finding("jitter.other", "fix", words)], claim, False


def altered(take: Take) -> list[tuple[str, np.ndarray]]:
    """The recorded jitter with its axes swapped, or a frame late or early."""
    jitter = np.array([r.jitter for r in take.records])
    late, early = np.roll(jitter, 1, 0), np.roll(jitter, -1, 0)
    late[0], early[-1] = jitter[0], jitter[-1]
    return [
        ("that of the next frame", late),
        ("that of the frame before", early),
        ("swapped, x for y", jitter[:, ::-1]),
    ]


def inner_shake(
    take: Take, fields: Mapping[int, np.ndarray], ahead: int = 0
) -> tuple[str, Match, tuple[int, int, Match] | None] | None:
    """Whether the vectors themselves shake: their median over the picture, by its second differences in time.

    Returns what they follow (recorded, halton), or None where they do not shake.
    """
    frames = [t for t in sorted(fields) if t + ahead < len(take.numbers)]
    runs = [t for t in frames if t - 1 in fields and t - 2 in fields]
    if len(runs) < 3:
        return None
    middle = {t: np.array([np.median(plane) for plane in fields[t]]) for t in frames}
    bend = np.array([middle[t] - 2 * middle[t - 1] + middle[t - 2] for t in runs])
    if np.sqrt((bend**2).mean()) < 2 * SHAKE:
        return None

    def bends(positions: np.ndarray) -> np.ndarray:
        step = {t: positions[t + ahead] - positions[t + ahead - 1] for t in frames}
        return np.array([step[t] - 2 * step[t - 1] + step[t - 2] for t in runs])

    if "jitter" in take.recorded:
        match = compare(bend, bends(np.array([r.jitter for r in take.records])))
        return (
            ("recorded", match, None)
            if match.explained > 0.7 and all(0.5 < abs(s) < 1.5 for s in match.slope)
            else None
        )
    best: tuple[float, tuple[int, int, Match]] | None = None
    for length in (8, 16, 32, 64):
        for start in range(length):
            match = compare(bend, bends(halton(start, length, len(take.numbers))))
            if (
                match.explained > 0.9
                and all(0.7 < abs(s) < 1.3 for s in match.slope)
                and (best is None or match.explained > best[0])
            ):
                best = (match.explained, (length, start, match))
    return ("halton", best[1][2], best[1]) if best else None
