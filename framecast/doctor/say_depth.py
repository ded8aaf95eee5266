"""Verdicts about depth: its kind by planarity and parallax, near or far, and the unit by the recorded cameras."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Literal

import numpy as np

from framecast.doctor.camera import caused, sky_of
from framecast.doctor.depth import VIEWS, Law, family, parallax, planarity
from framecast.doctor.motion import resampled
from framecast.doctor.report import Finding
from framecast.doctor.take import Take
from framecast.exr import ClipError
from framecast.frame import SKY
from framecast.importers.decode import decode_depth
from framecast.importers.settings import Depth

Seen = tuple[int, np.ndarray, np.ndarray, np.ndarray]


def tangents_of(take: Take) -> list[float]:
    """Tangent of half the vertical field of view where the lens is recorded, else some usual ones."""
    projection = take.records[0].projection
    if projection is not None and projection[1][1] != 0 and projection[3][3] == 0:
        return [1 / abs(projection[1][1])]
    return [float(np.tan(np.radians(view) / 2)) for view in VIEWS]


def tell_depth(
    take: Take, claim: Depth, fields: Mapping[int, np.ndarray], bits: int, times: float | None = None
) -> tuple[list[Finding], Depth | None]:
    """Findings, and how to read depth; None where that cannot be told.

    Args:
        times: what distances have to be taken times by another experiment, where vectors cannot tell.
    """
    frames = take.full("depth")
    values = np.concatenate([take.stored[t]["depth"][0].astype(np.float64).ravel()[::11] for t in frames[:4]])
    values = values[np.isfinite(values)]
    if len(values) == 0 or np.ptp(values) == 0:
        held = f"{values[0]:g} everywhere" if len(values) else "no number"
        return [Finding("depth.empty", "fix", f"depth holds {held}; switch the depth pass on")], None
    steps = even_steps(np.concatenate([take.stored[t]["depth"][0].ravel() for t in frames[:2]]))
    if bits == 8 or steps:
        says = (
            f"depth has {steps or 256} different values, evenly spaced as 8 bits are: too coarse to find what hides "
            f"what; export 16 or 32 bits (EXR)"
        )
        return [Finding("depth.bits", "fix", says)], None
    if (fit := camera_fit(take, claim, fields)) is not None and fit[0] < max(0.004, 0.01 * fit[1]):
        says = (
            f"depth: {worded(claim.kind)}, as claimed (with it the recorded cameras cause the vectors to within "
            f"{fit[0]:.4f} pixels, of {fit[1]:.2f} that depth decides)"
        )
        return [Finding("depth", "fine", says)], claim
    kind, law, name, value = kind_of(take, claim, fields)
    if kind is None:
        says = (
            "what depth means cannot be told: no plane is in sight and the camera does not move "
            "sideways; record a camera that walks"
        )
        return [Finding("depth.open", "unknown", says)], None
    found, scaled = parameters(take, claim, kind, fields, values, times)
    out = []
    claimed = claim.kind
    if found.kind in ("device", "reversed") and claim.near == 0 and "cameras" not in take.recorded:
        says = (
            f"the near plane of depth is not known, the settings say {found.near:g}; write yours (depth.near): "
            "all distances are multiples of it"
        )
        out.append(Finding("depth.near", "note", says))
    if scaled is None and found.kind in ("planar", "euclidean") and "cameras" in take.recorded:
        says = (
            "whether depth and cameras have the same unit cannot be told (the camera hardly walks); record one that "
            "does, or check that both are metres"
        )
        out.append(Finding("depth.open", "unknown", says))
    if found.kind != claimed and not _alike(found.kind, claimed, values):
        ours, theirs = law.misfits[value], law.misfits.get(_name(claimed, law), float("nan"))
        unit = "of the slope that planes bend" if name == "planarity" else "pixels that the camera's motion leaves over"
        says = f"depth is {worded(found.kind)}, not {worded(claimed)}: {unit} fall from {theirs:.4f} to {ours:.4f}"
        out.append(Finding("depth.kind", "fix", says, theirs, ours))
    elif scaled is not None and not 0.8 < scaled < 1.25:
        says = (
            f"depth and cameras have different units: depth times {scaled:.3g} is what the camera's motion asks for"
            f"{' (metres and centimetres?)' if 60 < max(scaled, 1 / scaled) < 160 else ''}"
        )
        out.append(Finding("depth.scale", "fix", says))
    else:
        out.append(
            Finding(
                "depth",
                "fine",
                f"depth: {worded(claimed)}, as claimed ({name}: misfit {law.misfits[value]:.4f}, next "
                f"kind {_next(law, value):.4f})",
            )
        )
    return out, found


def even_steps(numbers: np.ndarray) -> int:
    """How many different numbers there are, if they are at most 256 multiples of one step; else 0."""
    held = np.unique(numbers[np.isfinite(numbers)].astype(np.float64))
    held = held[np.abs(held) < SKY * 0.99]
    if not 8 <= len(held) <= 256:
        return 0
    places = (held - held[0]) / np.diff(held).min()
    return len(held) if np.abs(places - np.rint(places)).max() < 0.02 and places[-1] <= 256 else 0


def worded(kind: str) -> str:
    """A kind in words."""
    return {
        "planar": "distance along the view axis", "euclidean": "distance along the ray (from the camera's centre)",
        "device": "device depth, 0 near and 1 far", "reversed": "reversed device depth, 1 near and 0 far",
        "inverse": "inverse distance", "unit": "distance scaled to 0..1",
    }[kind]  # fmt: skip


def _alike(found: str, claimed: str, values: np.ndarray) -> bool:
    """Kinds between which no experiment can choose without knowing the unit."""
    return {found, claimed} <= {"reversed", "inverse"} and values.max() <= 1.0


def _name(kind: str, law: Law) -> str:
    """The candidate that stands for a kind in a law."""
    if kind == "euclidean":
        return min((k for k in law.misfits if k.startswith("euclidean")), key=law.misfits.__getitem__)
    return {"unit": "planar"}.get(kind, family(kind))


def _next(law: Law, value: str) -> float:
    group = value.split(" ")[0]
    return min((m for k, m in law.misfits.items() if k.split(" ")[0] != group), default=float("inf"))


def kind_of(take: Take, claim: Depth, fields: Mapping[int, np.ndarray]) -> tuple[str | None, Law, str, str]:
    """The candidate that obeys one of the laws clearly better than the others: parallax where the camera moves."""
    tangents = tangents_of(take)
    if fields:
        law, flat = parallax(take, fields, tangents)
        if law.misfits and flat > 0.01:
            best = _preferred(law, claim)
            if flat > 2.5 * law.misfits[best] and _next(law, best) > 1.6 * law.misfits[best]:
                return best.split(" ")[0], law, "parallax", best
    law = planarity(take, tangents)
    if law.weight >= 500:
        best = _preferred(law, claim)
        if law.misfits[best] < 0.01 and _next(law, best) > 2.5 * law.misfits[best] + 1e-4:
            return best.split(" ")[0], law, "planarity", best
    return None, law, "", ""


def _preferred(law: Law, claim: Depth) -> str:
    """The candidate of the least misfit, the claimed one where it is as good."""
    best = min(law.misfits, key=law.misfits.__getitem__)
    claimed = _name(claim.kind, law)
    return claimed if law.misfits[claimed] < 1.2 * law.misfits[best] + 1e-5 else best


def parameters(
    take: Take, claim: Depth, group: str, fields: Mapping[int, np.ndarray], values: np.ndarray, times: float | None
) -> tuple[Depth, float | None]:
    """Kind, near and far within a group, and what depth has to be taken times to fit the recorded cameras."""
    bare = replace(claim, kind="planar", near=0.0, far=None, scale=1.0, bias=0.0)
    near = _near(take)
    if group == "inverse":
        if float(values.max()) > 1.0001:
            scaled = fitted_scale(take, replace(bare, kind="inverse"), fields)
            return replace(bare, kind="inverse", scale=1 / (scaled or 1.0)), None
        kind: Literal["device", "reversed"] = "device" if float(np.median(values)) > 0.5 else "reversed"
        if claim.kind == kind:
            return claim, None
        found = replace(bare, kind=kind, near=near, far=_far(take) if kind == "device" else None)
        factor = fitted_scale(take, found, fields) or 1.0
        return replace(found, near=near * factor, far=found.far * factor if found.far else None), None
    if group == "euclidean":
        found = replace(bare, kind="euclidean")
        return found, fitted_scale(take, found, fields)
    found = claim if claim.kind in ("planar", "unit") else bare
    scaled = fitted_scale(take, found, fields) or times
    looks_unit = claim.kind == "planar" and values.max() <= 1.0 + 1e-6 and values.min() >= 0
    if looks_unit and (scaled is None or not 0.8 < scaled < 1.25):
        far = float(scaled) if scaled is not None else 1000.0
        return replace(bare, kind="unit", far=far), scaled
    if scaled is not None and not 0.8 < scaled < 1.25:
        return replace(found, scale=found.scale * scaled), scaled
    return found, scaled


def _near(take: Take) -> float:
    """Distance of the near plane by the recorded projection (clip z in 0..1), else a tenth."""
    p = take.records[0].projection
    if p is None:
        return 0.1
    near = p[2][3] if abs(p[2][2]) < 1e-3 else p[2][3] / p[2][2]
    return abs(near) if 1e-6 < abs(near) < 1e6 else 0.1


def _far(take: Take) -> float | None:
    p = take.records[0].projection
    if p is None or abs(p[2][2]) < 1e-3 or abs(p[2][2] + 1) < 1e-6:
        return None
    return abs(p[2][3] / (p[2][2] + 1))


def seen(
    take: Take, depth: Depth, fields: Mapping[int, np.ndarray]
) -> list[tuple[int, np.ndarray, np.ndarray, np.ndarray]]:
    """Of some frames: pixels that show a surface, its distance as decoded, and its vectors `2 n`. Empty without
    recorded cameras, or where the vectors span another time than the cameras."""
    out = []
    usable = "cameras" in take.recorded and take.stretch == 1.0
    for t, field in list(fields.items())[:4] if usable else ():
        if not take.joined[t]:
            continue
        try:
            z = decode_depth(take.stored[t]["depth"].astype(np.float32), depth, take.records[t].projection)[0]
        except ClipError:
            return []
        sky = resampled(sky_of(take.stored[t]["depth"][0]) | (z >= SKY), take.size)
        places = np.flatnonzero(~sky)
        if len(places) < 0.05 * sky.size:
            continue
        places = np.random.default_rng(t).choice(places, min(len(places), 500), replace=False)
        distance = resampled(z, take.size).ravel()[places].astype(np.float64)
        out.append((t, places, distance, field.reshape(2, -1)[:, places]))
    return out


def camera_fit(take: Take, depth: Depth, fields: Mapping[int, np.ndarray]) -> tuple[float, float] | None:
    """Pixels between the vectors and what the recorded cameras cause, with depth as decoded and infinitely far."""
    found = [
        (_camera_misfit(take, t, places, z, v), _camera_misfit(take, t, places, z * 1e4, v))
        for t, places, z, v in seen(take, depth, fields)
    ]
    if not found:
        return None
    near, far = np.median(found, 0)
    return (float(near), float(far)) if far > 0.02 else None


def fitted_scale(take: Take, depth: Depth, fields: Mapping[int, np.ndarray]) -> float | None:
    """The factor on depth with which the recorded cameras cause the vectors; None where they say nothing about it."""
    votes = []
    for t, places, z, v in seen(take, depth, fields):
        misfit = lambda s: _camera_misfit(take, t, places, z * s, v)  # noqa: B023, E731
        errors = {float(s): misfit(s) for s in np.geomspace(1e-4, 1e4, 49)}
        best = min(errors, key=errors.__getitem__)
        beyond = min(errors[s] for s in errors if s > 30 * best or s < best / 30)
        if beyond > 3 * errors[best] + 0.02:
            votes.append(float(min(best * np.geomspace(0.7, 1.43, 25), key=misfit)))
    return float(np.median(votes)) if len(votes) >= 2 or (votes and len(fields) < 3) else None


def _camera_misfit(take: Take, t: int, places: np.ndarray, z: np.ndarray, v: np.ndarray) -> float:
    """Median distance in pixels between vectors `2 n` and what the cameras cause at pixels of these distances."""
    return float(np.median(np.abs(caused(take, t, t - 1, places, z) - v).max(0)))
