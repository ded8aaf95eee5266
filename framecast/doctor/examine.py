"""All experiments on one folder, in the order in which each builds on the last."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from framecast.clip import Record
from framecast.doctor.camera import sky_of
from framecast.doctor.edges import Grain, edges_of, grain_of, solid_depths
from framecast.doctor.follow import Step, steps_of
from framecast.doctor.jitter import Match
from framecast.doctor.motion import displacement, resampled
from framecast.doctor.report import Finding, Report
from framecast.doctor.say_depth import tangents_of, tell_depth
from framecast.doctor.say_jitter import tell_jitter
from framecast.doctor.say_motion import RECORD, Told, fields_of, tell_motion
from framecast.doctor.say_rest import (
    tell_color,
    tell_edges,
    tell_exposure,
    tell_grain,
    tell_normals,
    tell_offset,
    tell_padding,
    tell_time,
)
from framecast.doctor.search import Shake
from framecast.doctor.source import Source, open_source
from framecast.doctor.surface import normals_of, tone_of
from framecast.doctor.take import Take, load
from framecast.doctor.timeline import exposure_of
from framecast.exr import ClipError
from framecast.importers.decode import decode_depth
from framecast.importers.settings import Depth, Jitter, Motion, Settings

OF_LENGTH = ("normal.encoded", "normal.length")
"""Findings about normals that need no depth."""

NO_SLOPES = Finding(
    "normal.open",
    "unknown",
    "in what space normals are cannot be told while depth is not understood, whose slopes they should fit",
)


@dataclass(frozen=True)
class Examined:
    """A report, and what its picture is made from."""

    report: Report
    take: Take
    told: Told
    claim: Settings
    cameras: Sequence[Record]
    """Records of all frames, where they hold cameras that the settings do not tell of."""


def examine(folder: Path | str) -> Examined:
    """Everything that can be found out about a folder.

    Raises:
        FileNotFoundError: no such folder. ClipError: it cannot be examined at all; the message says why.
    """
    source = open_source(folder)
    take = load(source)
    findings = [*_files(source, take)]
    padded, crop = tell_padding(take)
    findings += padded
    if crop is not None:
        source, take = _cropped(source, take, crop)
    settings = source.claim if crop is None else replace(source.claim, crop=crop)
    told, late, offset = _vectors(take, settings.motion)
    odd, apart, steps = _odd(take, told)
    if apart and len(apart) < len(take.pairs) / 2:  # what the others say is asked again without those
        told, late, offset = _vectors(take.without(apart), settings.motion)
        odd, apart, steps = _odd(take, told)
        take, steps = take.without(apart), [step for step in steps if step.frame not in apart]
    findings += [*told.findings, *late, *odd]
    fields = fields_of(take, told, _some(take))
    jittered, ahead = False, int(told.answer is not None and "next" in told.answer.best.reading.motion.direction)
    shake = told.answer.shake if told.answer else Shake((), np.zeros((0, 2)), None, None)
    if len(shake.measured) >= 2 and (told.motion is not None or shake.certain):
        every = fields_of(take, told, take.pairs, 3)
        said, jitter, jittered = tell_jitter(take, shake, every, settings.jitter, ahead=ahead, partial=bool(told.lacks))
        findings += said
        settings = replace(settings, jitter=jitter)
    if told.motion is not None and settings.motion is not None:
        settings = replace(
            settings, motion=replace(told.motion, offset=settings.motion.offset + offset, jittered=jittered)
        )
    if settings.cameras is None and "jitter" in take.recorded and not jitter_gone(findings):
        settings = replace(settings, jitter=_recorded(source, settings.jitter))
    fields = _unshaken(take, fields, ahead) if jittered else fields
    settings, said = _surfaces(source, take, settings, told, fields)
    findings += said
    settings, said = _light(source, take, settings, told, steps)
    findings += said
    report = Report(
        str(source.path), source.kind if source.kind != "unknown" else "a folder of unknown origin", take.numbers,
        len(source.numbers), (take.size[1], take.size[0]), tuple(findings), settings,
    )  # fmt: skip
    lacking = settings.cameras is None or (settings.cameras.file is None and not settings.cameras.motion)
    cameras = source.records if lacking and "cameras" in source.recorded else ()
    return Examined(report, take, told, source.claim, cameras)


def _recorded(source: Source, found: Jitter) -> Jitter:
    """The jitter that a clip records, for a settings file, read as found."""
    if found.values or found.halton:
        return found
    return replace(found, values=tuple((float(r.jitter[0]), float(r.jitter[1])) for r in source.records))


def jitter_gone(findings: Sequence[Finding]) -> bool:
    """Whether the picture does not shake although jitter is recorded."""
    return any(f.code == "jitter.absent" for f in findings)


def _files(source: Source, take: Take) -> list[Finding]:
    """What is wrong with the files themselves."""
    out = [Finding("frames.files", "fix", remark) for remark in source.remarks]
    for name, bad in take.blemishes.items():
        says = (
            f"{name} holds {bad} NaN or infinite numbers in the frames looked at; render those "
            "frames again, or import with --repair"
        )
        out.append(Finding(f"{name}.nan", "fix", says))
    return out


def _cropped(source: Source, take: Take, crop: tuple[int, int]) -> tuple[Source, Take]:
    """Everything without padding."""
    width, height = crop
    full = take.size
    cut = lambda a: a[:, :height, :width] if a.shape[1:] == full else a  # noqa: E731
    stored = [{name: cut(pixels) for name, pixels in planes.items()} for planes in take.stored]
    return source, replace(take, stored=stored, images=[cut(image) for image in take.images])


def _some(take: Take, most: int = 6) -> list[int]:
    pairs = take.pairs
    return pairs[:: max(1, len(pairs) // most)][:most]


def _vectors(take: Take, claim: Motion | None) -> tuple[Told, list[Finding], int]:
    """Vectors; where those of another frame are stored, they are moved first. Returns also by how many frames."""
    if claim is None or not any("motion" in take.stored[t] for t in take.pairs):
        says = (
            f"there are no vectors; switch the vector (motion) pass on, or name the layer motion. {RECORD.capitalize()}"
        )
        return Told((Finding("motion.absent", "fix", says),), None), [], 0
    found, offset = tell_offset(take, 0)
    if offset:
        empty: Mapping[str, np.ndarray] = {}
        moved = []
        for t, planes in enumerate(take.stored):
            other = take.stored[t - offset] if 0 <= t - offset < len(take.stored) else empty
            kept = {name: pixels for name, pixels in planes.items() if name != "motion"}
            moved.append(kept | ({"motion": other["motion"]} if "motion" in other else {}))
        joined = tuple(j and "motion" in m for j, m in zip(take.joined, moved, strict=True))
        told = tell_motion(replace(take, stored=moved, joined=joined), claim)
        answer = told.answer
        if answer is not None:
            best = replace(answer.best, reading=replace(answer.best.reading, offset=offset))
            told = replace(told, answer=replace(answer, best=best))
        return told, found, offset
    return tell_motion(take, claim), [], 0


def _odd(take: Take, told: Told) -> tuple[list[Finding], set[int], list[Step]]:
    """What is wrong between single frames, and which: those say nothing about what the vectors of the others mean; and
    all frames against the ones before."""
    steps = steps_of(take, told)
    vectors = {t: take.stored[t]["motion"] for t in take.pairs if "motion" in take.stored[t]}
    empty = [t for t, v in vectors.items() if np.ptp(v.reshape(len(v), -1), axis=1).max() == 0]
    return *tell_time(take, steps, empty if told.motion is not None and not told.lacks else ()), steps


def _unshaken(take: Take, fields: Mapping[int, np.ndarray], ahead: int) -> dict[int, np.ndarray]:
    """Vectors without the jitter that they hold (where it is recorded)."""
    jitter = np.array([record.jitter for record in take.records], np.float32)
    steps = {t: jitter[t + ahead] - jitter[t + ahead - 1] for t in fields if t + ahead < len(jitter)}
    return {t: fields[t] - step[:, None, None] for t, step in steps.items()}


def _surfaces(
    source: Source, take: Take, settings: Settings, told: Told, fields: Mapping[int, np.ndarray]
) -> tuple[Settings, list[Finding]]:
    """Depth, normals, silhouettes."""
    findings: list[Finding] = []
    claimed = settings.depth
    if claimed is None or not take.full("depth"):
        return settings, findings
    deep = {t: field for t, field in fields.items() if "depth" in take.stored[t]}
    times = None
    if told.lacks:  # such vectors tell nothing of the camera, the pictures were asked instead
        distance = told.blanks.depth if told.blanks else None
        deep, times = {}, distance.scale if distance and distance.kind == "planar" else None
    said, depth = tell_depth(take, claimed, deep, source.bits["depth"], times)
    findings += said
    if depth is not None:
        settings = replace(settings, depth=depth)
    distances = _distances(take, depth or claimed)
    if settings.normal is not None and distances:
        tangents = tangents_of(take)
        tangent = tangents[0] if len(tangents) == 1 else 0.45
        normals = normals_of(take, distances, tangent, settings.normal, settings.axes)
        said, normal = tell_normals(normals, settings.normal)
        findings += said if depth is not None else [*(f for f in said if f.code in OF_LENGTH), NO_SLOPES]
        settings = replace(settings, normal=normal or settings.normal)
    if settings.motion is None or "motion" not in source.bits:
        return settings, findings
    grain = _grain(source, take, settings.motion)
    if fields:
        near = {t: resampled(z, take.size) for t, z in solid_depths(take, distances).items()}
        blender = source.kind == "blender" or "Blender" in str(_provenance(source))
        edges = edges_of({t: f for t, f in fields.items() if t in near}, near, grain.pixels)
        findings += tell_edges(edges, blender)
    return settings, [*findings, *tell_grain(grain)]


def _grain(source: Source, take: Take, motion: Motion) -> Grain:
    """How finely the vectors are stored, in pixels as they are read."""
    own = next((take.stored[t]["motion"].shape[1:] for t in take.pairs if "motion" in take.stored[t]), take.size)
    packed = motion.packing in ("base255", "base256")
    pixels = 0.0
    if motion.packing == "none":
        one = np.ones((len(motion.channels), 1), np.float32)
        pixels = float(np.abs(displacement(one, replace(motion, bias=(0.0, 0.0)), take.size, own)).max())
    return grain_of(take, pixels, 32 if packed else source.bits["motion"])


def _provenance(source: Source) -> object:
    import json

    path = source.path / "clip.json"
    return json.loads(path.read_text()).get("provenance", {}) if path.is_file() else {}


def _distances(take: Take, depth: Depth) -> dict[int, np.ndarray]:
    """Distance along the view axis `h w` in some frames."""
    out = {}
    frames = sorted({*take.full("depth", "normal"), *_some(take)})
    for t in frames:
        if "depth" not in take.stored[t]:
            continue
        stored = take.stored[t]["depth"].astype(np.float32)
        try:
            z = decode_depth(stored, depth, take.records[t].projection)[0]
        except ClipError:
            z = stored[0]
        out[t] = np.where(sky_of(take.stored[t]["depth"][0]), z.max(), z)
    return out


def _light(
    source: Source, take: Take, settings: Settings, told: Told, steps: Sequence[Step]
) -> tuple[Settings, list[Finding]]:
    """Colour and exposure."""
    assert settings.color is not None
    said, color = tell_color(tone_of(take), settings.color, source.bits["color"])
    if told.answer is None:
        return replace(settings, color=color), said
    exposure = exposure_of(take, steps)
    more, factors = tell_exposure(exposure, len(take.numbers))
    if factors is not None and len(take.numbers) == len(source.numbers):
        color = replace(color, exposure=factors)
    return replace(settings, color=color), [*said, *more]


__all__ = ["Examined", "Match", "examine"]
