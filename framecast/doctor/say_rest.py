"""Verdicts about normals, colour, silhouettes, precision, and what happens from frame to frame."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from framecast.doctor.edges import Edges, Grain, alignment
from framecast.doctor.motion import Shifts
from framecast.doctor.probe import fit_shift, misfit, pair_of, pick_points, textured
from framecast.doctor.report import Finding, State
from framecast.doctor.surface import Normals, Tone
from framecast.doctor.take import Take
from framecast.doctor.timeline import Exposure, Step, cuts, padding, repeats, skips
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
    if claimed not in angles:  # world, without cameras
        return _without_cameras(normals, out, found, best)
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
    if angles[best] < angles[claimed] - 2 and angles[best] < 0.7 * angles[claimed]:
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
    elif not out:
        out.append(
            Finding(
                "normal",
                "fine",
                f"normals: {claim.space} space, as claimed ({angles[claimed]:.1f} degrees from the slopes of depth)",
            )
        )
    return out, found


def _without_cameras(
    normals: Normals, out: list[Finding], found: Normal, best: tuple[str, tuple[float, float, float]]
) -> tuple[list[Finding], Normal]:
    """World and view told apart by whether they agree with the view as they are; mirrored axes by any rotation."""
    angle = normals.angles[best]
    if angle < 15:
        turned = [axis for axis, s in zip("xyz", best[1], strict=True) if s < 0]
        flips = f", turned around in {' and '.join(turned)}" if turned else ""
        out.append(
            Finding(
                "normal.space",
                "fix",
                f"normals are in view space{flips} ({angle:.1f} degrees from the slopes of depth), not in world space",
            )
        )
        return out, replace(found, space="view", sign=best[1])
    if normals.free["mirrored"] > normals.free["proper"] + 0.03:
        says = (
            "one axis of the normals is turned around: no rotation of the world fits the slopes of "
            f"depth (cosine {normals.free['proper']:.2f}), "
            f"a mirrored one does ({normals.free['mirrored']:.2f}); usually it is y"
        )
        out.append(Finding("normal.sign", "fix", says))
        return out, replace(found, sign=(found.sign[0], -found.sign[1], found.sign[2]))
    if not out:
        out.append(
            Finding(
                "normal",
                "fine",
                "normals: world space (after a rotation they fit the slopes of depth, cosine "
                f"{normals.free['proper']:.2f})",
            )
        )
    return out, found


def tell_color(tone: Tone | None, claim: Color, bits: int) -> tuple[list[Finding], Color]:
    """Findings, and how to read colour."""
    if tone is None:
        return [], claim
    if claim.encoding == "srgb":
        return _claimed_display(tone, claim, bits)
    if tone.slope is not None and tone.slope < 0.53:
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


def tell_time(take: Take, steps: Sequence[Step], scales: Mapping[int, float]) -> list[Finding]:
    """Cuts, frames left out, frames repeated."""
    number = take.numbers
    out = []
    if found := cuts(steps):
        says = (
            f"the picture changes altogether at frame {ranges(number[t] for t in found)}: a cut, or "
            "another shot; split the folder there, or record the cut"
        )
        out.append(Finding("frames.cut", "fix", says))
    if found := repeats(steps):
        says = f"frame {ranges(number[t] for t in found)} is the frame before once more; export it again"
        out.append(Finding("frames.repeated", "fix", says))
    if found := [t for t in skips(scales) if t not in cuts(steps)]:
        most = max(scales[t] for t in found)
        says = (
            f"before frame {ranges(number[t] for t in found)} the picture moves {most:.1f} times as "
            "far as the vectors, elsewhere it does not: "
            f"a frame is missing there"
        )
        out.append(Finding("frames.skipped", "fix", says))
    return out


def tell_edges(edges: Edges, grain: Grain, blender: bool) -> list[Finding]:
    """Dilated, averaged and coarsely stored vectors."""
    out = []
    if edges.count >= 60 and edges.dilated > 0.5:
        says = (
            f"vectors are dilated: in {edges.dilated:.0%} of {edges.count} silhouettes the "
            "background's first pixel carries the vector of the object; "
            f"export them undilated"
        )
        out.append(Finding("motion.dilated", "fix", says))
    elif edges.count >= 60 and edges.mixed > 0.7:
        why = "by the pixel filter, as Blender does"
        says = (
            f"vectors are averaged: in {edges.mixed:.0%} of {edges.count} silhouettes there are vectors between "
            f"those of both sides ({why if blender else 'by multi-sampling or a filter; export one sample a pixel'})"
        )
        out.append(Finding("motion.averaged", "note" if blender else "fix", says))
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
    scores = {k: alignment(take, k) for k in (-1, 0, 1)}
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


def tell_odd(take: Take, fields: Mapping[int, np.ndarray], shifts: Shifts | None) -> list[Finding]:
    """Frames whose vectors are turned around, or missing, unlike those of the other frames."""
    turned, empty = [], []
    for t in sorted(fields):
        v = fields[t]
        if not take.joined[t] or np.abs(v).max() == 0:
            empty += [t] if take.joined[t] else []
            continue
        image = take.images[t].astype(np.float32)
        moving = np.abs(v).max(0) > 0.5
        points = pick_points(textured(image), moving, 1500, t)
        if len(points) < 100:
            continue
        pair = pair_of([image, take.images[t - 1].astype(np.float32)], 0, 1, points)
        d = v.reshape(2, -1)[:, points]
        errors = {}
        for sign in (1, -1):
            dx, dy = (
                fit_shift(pair, sign * d[0], sign * d[1], steps=3)
                if shifts is None
                else shifts.get((t, t - 1), (0.0, 0.0))
            )
            errors[sign] = float(misfit(pair, sign * d[0] + dx, sign * d[1] + dy).mean())
        if errors[-1] < 0.75 * errors[1]:
            turned.append(t)
    out = []
    usable = len(fields)
    if turned and len(turned) <= usable // 3:
        says = (
            f"vectors of frame {ranges(take.numbers[t] for t in turned)} are turned around, unlike "
            "those of the other frames (they point to the next frame?)"
        )
        out.append(Finding("motion.turned", "fix", says))
    if empty and len(empty) < usable:
        out.append(
            Finding(
                "motion.missing",
                "fix",
                f"vectors of frame {ranges(take.numbers[t] for t in empty)} are all 0, unlike those of "
                "the other frames; export them again",
            )
        )
    return out
