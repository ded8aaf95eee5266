"""Verdicts about normals, colour, silhouettes, precision, and what happens from frame to frame."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from framecast.doctor.edges import Edges, Grain, alignments
from framecast.doctor.follow import Step
from framecast.doctor.report import Finding, State
from framecast.doctor.surface import Normals, Tone
from framecast.doctor.take import Take
from framecast.doctor.timeline import Exposure, cuts, padding, repeats, reversals, skips
from framecast.importers.blender import ranges
from framecast.importers.settings import Color, Normal


def tell_normals(normals: Normals | None, claim: Normal) -> tuple[list[Finding], Normal | None]:
    """Findings, and how to read normals."""
    if normals is None or normals.count < 300:
        says = "what normals mean cannot be told without depth that shows slopes; export depth beside them"
        return [Finding("normal.open", "unknown", says)], None
    out, found = [], claim
    if max(normals.plain_share, normals.encoded_share) < 0.5:
        says = (
            f"normals are no unit vectors (in {normals.plain_share:.0%} of the pixels as they are, "
            f"in {normals.encoded_share:.0%} "
            f"as n / 2 + 1/2); export unit vectors"
        )
        return [Finding("normal.length", "fix", says)], None
    if normals.encoded != claim.encoded:
        says = (
            "normals are stored as n / 2 + 1/2"
            if normals.encoded
            else "normals are unit vectors as they are, not n / 2 + 1/2"
        )
        share = max(normals.plain_share, normals.encoded_share)
        out.append(
            Finding(
                "normal.encoded",
                "fix",
                f"{says}: {share:.0%} of the pixels are of length 1 so, "
                f"{min(normals.plain_share, normals.encoded_share):.0%} otherwise",
            )
        )
        found = replace(found, encoded=normals.encoded)
    angles = normals.angles
    best = min(angles, key=angles.__getitem__)
    claimed = (claim.space, claim.sign)
    rival = normals.flat.get(("view" if claim.space == "world" else "world", claim.sign), (0.0, 0.0))
    if claimed not in angles:  # world, without cameras
        return _without_cameras(normals, out, found)
    if angles[best] > 35:
        out.append(
            Finding(
                "normal.shape",
                "fix",
                f"normals do not fit the slopes of depth in any space ({angles[best]:.0f} degrees off); "
                "check both passes",
            )
        )
        return out, None
    clearly = angles[best] < angles[claimed] - 2 and angles[best] < 0.7 * angles[claimed]
    straight = [k for k in angles if straighter(*normals.flat.get(k, (0, 0))) and angles[k] < angles[claimed] + 1]
    if clearly or straight:
        best = best if clearly else min(straight, key=angles.__getitem__)
        space, sign = best
        turned = [axis for axis, s, c in zip("xyz", sign, claim.sign, strict=True) if s != c]
        where = f"in {space} space, not in {claim.space} space" if space != claim.space else ""
        flips = f"turned around in {' and '.join(turned)}" if turned else ""
        code = "normal.space" if where else "normal.sign"
        says = (
            f"normals are {' and '.join(filter(None, (where, flips)))}: angle to the slopes of "
            f"depth falls from {angles[claimed]:.0f} to {angles[best]:.1f} degrees"
        )
        out.append(Finding(code, "fix", says, angles[claimed], angles[best]))
        found = replace(found, space=space, sign=sign)  # type: ignore[arg-type]
    elif not straighter(*rival[::-1]) and not out:
        says = (
            f"normals fit the slopes of depth ({angles[claimed]:.1f} degrees off); whether they are in world or view "
            f"space cannot be told, the camera is turned by {normals.turning:.1f} degrees only; record one that turns"
        )
        out.append(Finding("normal.open", "unknown", says))
    elif not out:
        out.append(
            Finding(
                "normal",
                "fine",
                f"normals: {claim.space} space, as claimed ({angles[claimed]:.1f} degrees from the slopes of depth)",
            )
        )
    return out, found


def straighter(one: float, other: float) -> bool:
    """Whether one way to read normals fits planes and another one does not, however little they differ."""
    return other - one > 0.2 and one < 0.5 * other


def _without_cameras(normals: Normals, out: list[Finding], found: Normal) -> tuple[list[Finding], Normal]:
    """Any camera may have looked: world normals fit the slopes after some rotation, and as they are where that camera
    was not turned. So only a mirrored axis can be told from a right one, and view space from a turned camera's world.
    """
    free, mirrored = normals.free["proper"], normals.free["mirrored"]
    as_is = normals.angles["view", found.sign]
    if min(free, mirrored) > 35:
        says = f"normals do not fit the slopes of depth in any space ({free:.0f} degrees off); check both passes"
        out.append(Finding("normal.shape", "fix", says))
    elif mirrored < 0.7 * free - 1 and as_is > 1.4 * mirrored + 1:
        flips = [tuple(-s if k == axis else s for k, s in enumerate(found.sign)) for axis in range(3)]
        sign = min(flips, key=lambda s: normals.facing[s])  # type: ignore[index]
        sure = normals.facing[sign] < 15  # type: ignore[index]
        sign = sign if sure else flips[1]
        axis = "xyz"[flips.index(sign)]
        says = (
            f"one axis of the normals is turned around: the best rotation of the world leaves {free:.0f} degrees to "
            f"the slopes of depth, a mirrored one {mirrored:.0f}; {'it' if sure else 'usually it'} is {axis}"
        )
        out.append(Finding("normal.sign", "fix", says, free, mirrored))
        return out, replace(found, sign=sign)  # type: ignore[arg-type]
    elif as_is < 15 and as_is < 1.4 * free + 2:
        says = (
            f"normals fit the slopes of depth as they are ({as_is:.1f} degrees off): they are in view space, or in a "
            "world along whose axes the camera looks; which of the two, recorded cameras would tell"
        )
        out.append(Finding("normal.open", "unknown", says))
    elif not out:
        says = f"normals: world space (after a rotation they fit the slopes of depth to within {free:.1f} degrees)"
        out.append(Finding("normal", "fine", says))
    return out, found


def tell_color(tone: Tone | None, claim: Color, bits: int) -> tuple[list[Finding], Color]:
    """Findings, and how to read colour."""
    if tone is None:
        return [], claim
    if claim.encoding == "srgb":
        return _claimed_display(tone, claim, bits)
    if tone.slope is not None and tone.slope < (0.53 if tone.peak < 2 else 0.45):
        says = (
            "colour is encoded for a display, not linear: where only albedo jumps, colour changes "
            f"{tone.slope:.2f} times as much "
            f"in stops (linear light: nearly 1, sRGB: under 1/2); export scene-linear EXR without view transform"
        )
        return [Finding("color.encoding", "fix", says, tone.slope, 1.0)], replace(claim, encoding="srgb")
    if 0.9 < tone.peak < 1.002 and (tone.clipped > 2e-5 or bits < 32) and (tone.slope is None or tone.slope < 0.62):
        says = (
            f"colour ends at {tone.peak:.3f} ({tone.clipped:.2%} of the pixels are there): it is "
            "encoded for a display, or clipped; "
            f"export scene-linear EXR without view transform"
        )
        return [Finding("color.encoding", "fix", says)], replace(claim, encoding="srgb")
    if tone.slope is None and tone.peak < 1.002:
        says = (
            f"whether colour is linear cannot be told (nothing is brighter than {tone.peak:.2f}, "
            "and there is no albedo to compare with)"
        )
        return [Finding("color.open", "unknown", f"{says}; export albedo, or a bright lamp in sight")], claim
    why = (
        f"it changes {tone.slope:.2f} times as much as albedo where only albedo jumps"
        if tone.slope is not None
        else f"it reaches {tone.peak:.3g}"
    )
    return [Finding("color", "fine", f"colour: linear, as claimed ({why})")], claim


def _claimed_display(tone: Tone, claim: Color, bits: int) -> tuple[list[Finding], Color]:
    if tone.peak > 1.05 or (tone.slope is not None and tone.slope > 0.62):
        return [
            Finding("color.encoding", "fix", f"colour is linear, not encoded for a display: it reaches {tone.peak:.3g}")
        ], replace(claim, encoding="linear")
    note = "; its 256 steps and clipped highlights limit every method" if bits == 8 else ""
    return [Finding("color", "note", f"colour is encoded for a display and is decoded{note}")], claim


def tell_exposure(exposure: Exposure, frames: int) -> tuple[list[Finding], tuple[float, ...] | None]:
    """Findings, and the factors held by each frame where they can be told."""
    if exposure.even < 0.5:
        return [], None
    if exposure.unexplained > 0.02:
        told = (
            "although the recorded exposures say otherwise"
            if any(abs(e) > 1e-6 for e in exposure.expected.values())
            else "and nothing records it"
        )
        says = (
            f"exposure changes from frame to frame by {np.expm1(exposure.swing):.1%} all over the picture, {told}; "
            f"divide by the exposure of each frame, or fix the exposure"
        )
        factors = np.ones(frames)
        for t in range(1, frames):
            factors[t] = factors[t - 1] * np.exp(exposure.gains.get(t, 0.0))
        return [Finding("color.exposure", "fix", says, float(exposure.swing), 0.0)], tuple(float(f) for f in factors)
    if exposure.swing > 0.02:
        return [
            Finding(
                "color.exposure", "note", f"exposure changes by {np.expm1(exposure.swing):.1%} a frame, as recorded"
            )
        ], None
    return [], None


def tell_time(take: Take, steps: Sequence[Step], empty: Sequence[int]) -> tuple[list[Finding], set[int]]:
    """Cuts, frames left out or repeated, vectors turned around or missing, unlike those of the other frames; and which
    frames do not follow the one before as the others do.

    Args:
        empty: frames all of whose vectors are 0.
    """
    names = lambda found: ranges(take.numbers[t] for t in found)  # noqa: E731
    out, apart = [], set[int]()
    if cut := cuts(steps):
        says = (
            f"the picture changes altogether at frame {names(cut)}: a cut, or another shot; split the folder there, or "
            "record the cut"
        )
        out.append(Finding("frames.cut", "fix", says))
        apart |= {*cut}
    if again := repeats(steps):
        says = f"frame {names(again)} is the frame before once more; export it again"
        out.append(Finding("frames.repeated", "fix", says))
        apart |= {*again, *(t + 1 for t in again)}
    if found := {t: factor for t, factor in skips(steps).items() if t not in apart}:
        says = (
            f"before frame {names(found)} the picture moves {max(found.values()):.1f} times as far as the vectors, "
            "elsewhere it does not: a frame is missing there"
        )
        out.append(Finding("frames.skipped", "fix", says))
        apart |= {*found}
    if turned := {t: source for t, source in reversals(steps).items() if t not in apart}:
        says = (
            f"vectors of frame {names(turned.values())} are turned around, unlike those of the other frames (they "
            "point to the next frame?)"
        )
        out.append(Finding("motion.turned", "fix", says))
        apart |= {*turned}
    if empty and len(empty) < len(take.pairs):
        says = f"vectors of frame {names(empty)} are all 0, unlike those of the other frames; export them again"
        out.append(Finding("motion.missing", "fix", says))
        apart |= {*empty}
    return out, apart


def tell_edges(edges: Edges, blender: bool) -> list[Finding]:
    """Dilated and averaged vectors."""
    out = []
    if edges.count < 60:
        says = (
            "whether vectors are dilated or averaged at silhouettes cannot be told: there are hardly any across which "
            "they jump; record things that pass in front of others"
        )
        out.append(Finding("motion.edges", "unknown", says))
    elif edges.dilated > 0.5:
        says = (
            f"vectors are dilated: in {edges.dilated:.0%} of {edges.count} silhouettes the "
            "background's first pixel carries the vector of the object; "
            f"export them undilated"
        )
        out.append(Finding("motion.dilated", "fix", says))
    elif edges.mixed > 0.7:
        why = "by the pixel filter, as Blender does"
        says = (
            f"vectors are averaged: in {edges.mixed:.0%} of {edges.count} silhouettes there are vectors between "
            f"those of both sides ({why if blender else 'by multi-sampling or a filter; export one sample a pixel'})"
        )
        out.append(Finding("motion.averaged", "note" if blender else "fix", says))
    return out


def tell_grain(grain: Grain) -> list[Finding]:
    """Coarsely stored vectors."""
    out = []
    if grain.half or grain.bits < 32:
        kind = "half floats" if grain.half else f"{grain.bits}-bit numbers"
        harm: State = "fix" if grain.pixels > 0.1 else "note"
        after = "; export 32-bit vectors" if harm == "fix" else ", which does no harm"
        out.append(
            Finding(
                "motion.half" if grain.half else "motion.bits",
                harm,
                f"vectors are stored as {kind}, in steps of {grain.pixels:.2g} pixels{after}",
            )
        )
    return out


def tell_offset(take: Take, offset: int) -> tuple[list[Finding], int]:
    """Whether the vectors jump where another frame's depth does. `offset`: as claimed, 0 in `Take`."""
    scores = alignments(take, (-1, 0, 1))
    best = max(scores, key=lambda k: scores[k][0])
    if best == 0 or min(n for _, n in scores.values()) < 2:
        return [], 0
    if scores[best][0] > 0.15 and scores[best][0] > 1.25 * max(scores[0][0], 0.02):
        when = "previous" if best == -1 else "next"
        says = (
            f"the vectors of each file belong to the {when} frame: they jump where its depth jumps "
            f"(correlation {scores[best][0]:.2f}, with their own frame's {scores[0][0]:.2f})"
        )
        return [Finding("motion.offset", "fix", says, 1 - scores[0][0], 1 - scores[best][0])], best
    return [], 0


def tell_padding(take: Take) -> tuple[list[Finding], tuple[int, int] | None]:
    """Columns and rows without picture."""
    right, below = padding(take)
    if not right and not below:
        return [], None
    height, width = take.size
    says = (
        f"the last {right} columns and {below} rows hold no picture: buffers are padded, the "
        f"picture is {width - right}x{height - below}"
    )
    return [Finding("frames.padded", "fix", says)], (width - right, height - below)
