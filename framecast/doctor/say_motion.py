"""Verdicts about vectors: what differs from the claim, each with the error before and after."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from framecast.doctor.camera import Blanks, blanks_of, camera_fields
from framecast.doctor.motion import Reading, Scene, displacement, margin, resampled, scene_of, trial
from framecast.doctor.probe import BLOCKS, fit_shift, misfit
from framecast.doctor.report import Finding
from framecast.doctor.search import OTHER_TIME, RATIO, SURE, Answer, search
from framecast.doctor.take import Take
from framecast.importers.settings import Motion

RECORD = "record a camera that moves past textured things, eight frames or more"


@dataclass(frozen=True)
class Told:
    """What is known of the vectors."""

    findings: tuple[Finding, ...]
    motion: Motion | None
    """The settings with which to read them; None: they cannot be told."""
    answer: Answer | None = None
    blanks: Blanks | None = None
    lacks: str = ""
    """camera: all vectors lack the camera's part; written: only some were written."""


def tell_motion(take: Take, claim: Motion) -> Told:
    """Everything about `motion`."""
    if empty := nothing_stored(take):
        return empty_vectors(take, claim, empty)
    scene = scene_of(take)
    if scene is None:
        return _unknown("the pictures have no texture, so that no reading of the vectors looks better than another")
    blanks = blanks_of(take, scene)
    missing, marked = blanks is not None and blanks.found, unwritten_code(take)
    if missing or marked:
        scene = scene_of(take, written=True) or scene
    answer, lacks = search(take, scene, claim), "written" if marked else ""
    if missing and blanks is not None and not marked:
        lacks = "written"
        other = search(take, replace(scene, base=camera_fields(take, scene, blanks.depth)), claim)
        if better(other, answer):
            answer, lacks = other, "camera"
    findings = list(_differences(take, answer, claim))
    if missing and blanks is not None:
        findings.append(_blank_finding(blanks, lacks, claim))
    elif marked:
        findings.append(
            Finding(
                "motion.unwritten",
                "fix",
                "0 marks pixels without vectors, among codes about one half; they have to be left out, "
                "or filled in from depth and cameras",
            )
        )
    if not answer.decided and not missing:
        return Told((_still(take, answer),), None, answer, blanks)
    if not any(f.state == "fix" for f in findings):
        findings.append(_fine(answer))
    findings += _doubts(answer)
    motion = answer.best.reading.motion
    if lacks == "camera":
        motion = replace(motion, camera=False)
    elif lacks == "written":
        motion = replace(motion, unwritten=0.0 if marked or blanks is None else float(blanks.code[0]))
    return Told(tuple(findings), motion, answer, blanks, lacks)


def better(other: Answer, answer: Answer) -> bool:
    """Whether another set of answers explains the pictures better beyond doubt, on the same points."""
    ours, theirs, sure = margin(other.best, answer.best, answer.scene)
    return sure >= SURE and theirs > RATIO * ours


def unwritten_code(take: Take) -> bool:
    """Whether 0 cannot be a vector: a good part of the picture holds 0, everything else codes about one half."""
    for t in take.pairs[:3]:
        stored = take.stored[t].get("motion")
        if stored is None or stored.min() < 0 or stored.max() > 1.01:
            return False
        empty = (stored[:2] == 0).all(0)
        rest = stored[:2][:, ~empty]
        if (
            empty.mean() < 0.02
            or rest.size < 100
            or abs(float(np.median(rest)) - 0.5) > 0.2
            or np.quantile(rest, 0.01) < 0.02
        ):
            return False
    return bool(take.pairs)


def nothing_stored(take: Take) -> str:
    """What all vectors hold, where that is one and the same number in all frames; else nothing."""
    found = set()
    for t in take.pairs:
        stored = take.stored[t].get("motion")
        if stored is None:
            continue
        values = np.nan_to_num(stored[:2].astype(np.float32))
        if np.ptp(values.reshape(len(values), -1), axis=1).max() > 1e-9:
            return ""
        found.add(tuple(float(np.round(v, 6)) + 0.0 for v in values[:, 0, 0]))
    return "0" if all(v == (0.0, 0.0) for v in found) else " ".join(f"{v:g}" for v in sorted(found)[0]) if found else ""


def empty_vectors(take: Take, claim: Motion, number: str) -> Told:
    """Vectors that say nothing: wrong where the picture moves, else undecidable."""
    scene = scene_of(take)
    blanks = blanks_of(take, scene) if scene else None
    if blanks is not None and blanks.found:
        says = (
            f"every vector is {number} although the picture moves (error falls from {blanks.still:.3f} to "
            f"{blanks.moved:.3f} when a camera moves it); switch the vector pass on, and motion blur off"
        )
        return Told(
            (Finding("motion.empty", "fix", says, blanks.still, blanks.moved, blanks.votes),), None, None, blanks
        )
    if scene is not None and (parts := moving_parts(scene)):
        says = (
            f"every vector is {number} although {parts} of {BLOCKS * BLOCKS} parts of the picture "
            "move; switch the vector pass on"
        )
        return Told((Finding("motion.empty", "fix", says),), None, None, blanks)
    return _unknown(f"every vector is {number} and nothing seems to move")


def moving_parts(scene: Scene) -> int:
    """Blocks of the picture that agree clearly better when they are shifted by half a pixel or more, in most pairs."""
    moved: dict[int, list[bool]] = {}
    for pair in scene.pairs:
        zero = np.zeros_like(pair.x)
        whole = fit_shift(pair, zero, zero)
        for block in np.unique(pair.block):
            use = pair.block == block
            if use.sum() < 60:
                continue
            part, z = pair.at(use), zero[use]
            dx, dy = fit_shift(part, z + whole[0], z + whole[1], limit=4, steps=8)
            before = misfit(part, z + whole[0], z + whole[1]).mean()
            after = misfit(part, z + whole[0] + dx, z + whole[1] + dy).mean()
            moved.setdefault(int(block), []).append(bool(np.hypot(dx, dy) > 0.5 and after < 0.7 * before))
    return sum(float(np.mean(seen)) > 0.6 for seen in moved.values())


def _unknown(why: str) -> Told:
    return Told((Finding("motion", "unknown", f"vectors cannot be judged: {why}; {RECORD}"),), None)


def _still(take: Take, answer: Answer) -> Finding:
    moved = (
        float(np.mean([np.abs(v).max(0).mean() for v in answer.claim.vectors.values()]))
        if answer.claim.vectors
        else 0.0
    )
    if moved < 0.5 or answer.still.mean < 0.03:
        why = "hardly anything moves"
    else:
        why = "the pictures agree no better along the vectors than as they stand, under any reading"
    return Finding(
        "motion", "unknown", f"vectors cannot be judged: {why} (error {answer.still.mean:.3f} without and "
        f"{answer.claim.mean:.3f} with them); {RECORD}", answer.still.mean, answer.claim.mean,
    )  # fmt: skip


def _fine(answer: Answer) -> Finding:
    _, _, sure = margin(answer.best, answer.still, answer.scene)
    return Finding(
        "motion", "fine",
        f"vectors: {worded(answer.best.reading.motion)}, as claimed; along them neighbouring frames differ by "
        f"{answer.best.mean:.3f}, without them by {answer.still.mean:.3f}", answer.still.mean, answer.best.mean, sure,
    )  # fmt: skip


def worded(motion: Motion) -> str:
    """A reading in a few words."""
    down, right = motion.sign[1] > 0, motion.sign[0] > 0
    factor = "" if motion.scale == (1.0, 1.0) else f" times {motion.scale[0]:.5g}"
    code = f", {motion.bias[0]:.4g} for none" if motion.bias != (0.0, 0.0) else ""
    packed = {"none": "", "unreal_sqrt": ", square roots"}.get(motion.packing, f", {motion.packing}")
    return (
        f"{motion.units}{factor}, {motion.direction}, x {'right' if right else 'left'}, y "
        f"{'down' if down else 'up'}{code}{packed}"
    )


def effective(motion: Motion) -> tuple[float, float]:
    """Signs of the vectors that lead from this frame to the other one, right and down."""
    turned = -1.0 if motion.direction in ("previous->current", "next->current") else 1.0
    return motion.sign[0] * turned, motion.sign[1] * turned


def _differences(take: Take, answer: Answer, claim: Motion) -> list[Finding]:
    """One finding for each way in which the best reading differs from the claim."""
    best = answer.best.reading.motion
    a, b = effective(best), effective(claim)
    x, y = a[0] != b[0], a[1] != b[1]
    out = []

    def add(code: str, words: str, without: Motion) -> None:
        rival = trial(take, answer.scene, replace(answer.best.reading, motion=without), answer.shifts)
        ours, theirs, sure = margin(answer.best, rival, answer.scene)
        said = f"{words}: error falls from {theirs:.3f} to {ours:.3f}"
        out.append(Finding(code, "fix", said, theirs, ours, sure))

    flip = lambda m, sx, sy: replace(m, sign=(m.sign[0] * sx, m.sign[1] * sy))  # noqa: E731
    if ("next" in best.direction) != ("next" in claim.direction):
        other = "next" if "next" in best.direction else "previous"
        without = replace(best, direction=OTHER_TIME[best.direction])
        add(
            "motion.time",
            f"vectors belong to the {other} frame, not to the {'next' if other == 'previous' else 'previous'} one",
            without,
        )
    if x and y:
        add("motion.sign", "vectors point the wrong way; both components have to be negated", flip(best, -1, -1))
    elif y:
        add("motion.y", "vertical motion is upside down; y has to be negated", flip(best, 1, -1))
    elif x:
        add(
            "motion.x",
            "horizontal motion is negated (as where vectors run from the previous frame to this "
            "one with y up); x has to be negated",
            flip(best, -1, 1),
        )
    if best.bias != claim.bias or best.packing != claim.packing:
        code = (
            f"vectors are codes, {best.bias[0]:.4g} stands for no motion"
            if best.packing == "none"
            else f"vectors are packed ({best.packing})"
        )
        add("motion.code", f"{code}; read as {worded(best)}", replace(claim, sign=best.sign, direction=best.direction))
    elif best.units != claim.units or best.scale != claim.scale or best.size != claim.size:
        out.append(_length(take, answer, claim))
    return out


def _length(take: Take, answer: Answer, claim: Motion) -> Finding:
    best = answer.best.reading.motion
    without = replace(best, units=claim.units, scale=claim.scale, size=claim.size)
    rival = trial(take, answer.scene, replace(answer.best.reading, motion=without), answer.shifts)
    ours, theirs, sure = margin(answer.best, rival, answer.scene)
    if best.units != claim.units:
        names = {"uv": "UV (1 is the whole image)", "ndc": "NDC (2 is the whole image)", "pixels": "pixels"}
        words = f"vectors are in {names[best.units]}, not in {names[claim.units].split(' ')[0]}"
        code = "motion.unit"
    else:
        factor = best.scale[0] / claim.scale[0]
        words = (
            f"vectors are {'shorter' if factor > 1 else 'longer'} than the picture moves, they have "
            f"to be taken times {factor:.3g}"
        )
        why = {
            2.0: " (NDC taken for UV, half the resolution, or frames left out)",
            0.5: " (UV taken for NDC, or twice the resolution)",
        }
        words, code = words + why.get(factor, ""), "motion.length"
    return Finding(code, "fix", f"{words}: error falls from {theirs:.3f} to {ours:.3f}", theirs, ours, sure)


def _blank_finding(blanks: Blanks, lacks: str, claim: Motion) -> Finding:
    errors = f"error there falls from {blanks.still:.3f} to {blanks.moved:.3f} when a camera moves them"
    if blanks.surfaces < 0.02:
        says = (
            f"the background has no vectors ({blanks.share:.0%} of the picture) although the camera "
            f"turns: {errors}; it needs the cameras"
        )
        return Finding("motion.background", "note", says, blanks.still, blanks.moved, blanks.votes)
    if lacks == "camera":
        says = f"vectors lack the camera's part: {blanks.share:.0%} of the picture is said to stand still, and {errors}"
        return Finding("motion.camera", "fix", says, blanks.still, blanks.moved, blanks.votes)
    says = (
        f"vectors were not written where nothing moves by itself ({blanks.share:.0%} of the "
        f"picture holds {blanks.code[0]:g}): {errors}"
    )
    if claim.unwritten is not None and blanks.code[0] == claim.unwritten:
        says = f"{says}, as claimed; importing fills them in from the cameras"
        return Finding("motion.unwritten", "note", says, blanks.still, blanks.moved, blanks.votes)
    return Finding("motion.unwritten", "fix", says, blanks.still, blanks.moved, blanks.votes)


def _doubts(answer: Answer) -> list[Finding]:
    words = {
        "direction": "whether they point to the previous frame or away from it",
        "y": "whether y points up or down (nothing moves vertically)",
        "length": "how long they are (motion is too slow)",
    }
    open_ = [words[u] for u in answer.unsure if u in words]
    return (
        [Finding("motion.open", "unknown", f"of the vectors cannot be told {', nor '.join(open_)}; {RECORD}")]
        if open_
        else []
    )


def fields_of(take: Take, told: Told, frames: Sequence[int], every: int = 1) -> dict[int, np.ndarray]:
    """Vectors `2 h w` in pixels towards the previous frame, as found, offsets applied; at the size of the pictures, or
    of `every` so many rows and columns of the stored ones."""
    if told.answer is None or told.motion is None:
        return {}
    reading = told.answer.best.reading
    out = {}
    for t in frames:
        source = t - reading.offset
        if not 0 <= source < len(take.stored) or "motion" not in take.stored[source]:
            continue
        stored = take.stored[source]["motion"]
        own, some = (stored.shape[1], stored.shape[2]), stored[:, ::every, ::every]
        flat = displacement(some.reshape(len(some), -1), reading.motion, take.size, own) * np.float32(take.stretch)
        planes = flat.reshape(2, *some.shape[1:]) * (-1 if "next" in reading.motion.direction else 1)
        out[t] = np.stack([resampled(plane, take.size) for plane in planes]) if every == 1 else planes
    return out


__all__ = ["Reading", "Told", "fields_of", "tell_motion"]
