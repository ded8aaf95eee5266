"""A folder of Blender's multilayer EXRs as a clip: `open_shot`.

Files are numbered (`0007.exr`, `shot_0007.exr`), one a frame, from Blender 2.8 to 5.x, Cycles or EEVEE: one part or one
part per pass, half or float, any compression, with or without the view layer's name before the pass. What each pass
becomes is told at `_layers`; `docs/blender.md` says which passes to switch on and why. At opening only headers and two
or three frames are read, the rest when asked for.
"""

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from framecast import exr
from framecast.clip import Clip, Layers, Record, repaired
from framecast.exr import ClipError, Header
from framecast.frame import SKY
from framecast.importers.blender_camera import Shot, background_motion, read_shot
from framecast.importers.blender_vectors import check_vectors

FPS = 24.0
"""Blender's own default, taken where nothing tells the frame rate."""

PASSES: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "color": (("combined", "image", ""), ("RGB",)),
    "depth": (("depth", "z"), ("Z", "V", "X", "R")),
    "vector": (("vector", "speed"), ("XYZW", "RGBA", "XY", "RG")),
    "albedo": (("albedo", "basecolor", "diffusecolor", "diffcol", "denoisingalbedo"), ("RGB", "XYZ")),
    "normal": (("normal",), ("XYZ", "RGB")),
    "roughness": (("roughness",), ("X", "V", "Z", "R")),
    "metallic": (("metallic", "metalness"), ("X", "V", "Z", "R")),
    "object": (("objectindex", "indexob"), ("X", "V", "Z", "R")),
}
"""Per buffer: names of the pass, best first (lower case, no blanks), and the channels that may hold it."""

NO_VECTOR = (
    "switch on Vector (View Layer properties > Passes > Data), switch Motion Blur off (Render properties), "
    "and render again"
)


@dataclass(frozen=True)
class Plan:
    """Where each buffer lies in the files of one shot: view layer, and channel names per buffer."""

    layer: str
    channels: Mapping[str, tuple[str, ...]]
    others: tuple[str, ...]
    """Other view layers, which are left alone."""


def open_shot(folder: Path | str, *, fps: float | None = None, repair: bool = False) -> Clip:
    """The shot in a folder of Blender EXRs, lazily read.

    Args:
        fps: frames a second at frame step 1; None: as `shot.json` or the headers tell, else 24.
        repair: replace NaN and infinite pixels in place of refusing them.

    Raises:
        FileNotFoundError: no such folder. ClipError: no EXR in it, a frame missing, damaged or of another size, no
            Combined or Vector pass, vectors that Blender left empty (motion blur) or got wrong.
    """
    folder = Path(folder)
    files = _numbered(folder)
    headers = {number: exr.header(path) for number, path in files.items()}
    first = next(iter(headers.values()))
    size = _one_size(folder, headers)
    plan = _plan(folder, first.names)
    _same_passes(files, headers, plan)
    shot = read_shot(folder, size)
    rate, rate_from = _frame_rate(fps, shot, headers)
    cuts = _cuts(headers, shot)

    def read(record: Record) -> Layers:
        channels = exr.read(files[record.number]).channels
        return _layers({k: np.stack([channels[name] for name in names]) for k, names in plan.channels.items()})

    def load(record: Record) -> Layers:
        layers = _with_background(read(record), record.number, shot, cuts)
        return repaired(layers)[0] if repair else layers

    records = _records(list(files), shot, cuts)
    probe = read(records[0])
    check_vectors(folder, records, read, probe)
    return Clip(
        path=folder,
        fps=rate,
        size=size,
        records=records,
        load=load,
        layers=tuple(probe),
        span=1.0,
        provenance={
            "source": "Blender",
            "software": first.attributes.get("Software", ""),
            "view_layer": plan.layer,
            "notes": [rate_from, *_notes(plan, shot, probe, headers)],
        },
    )


# Files.


def _numbered(folder: Path) -> dict[int, Path]:
    """Files of the one sequence in the folder by frame number, in order, without a gap."""
    if not folder.is_dir():
        what = "a file" if folder.is_file() else "not there"
        raise FileNotFoundError(f"{folder} is {what}; give the folder that holds the rendered EXR files")
    found = [p for p in sorted(folder.iterdir()) if p.suffix.lower() == ".exr" and not p.name.startswith(".")]
    named = [(m[1], int(m[2]), p) for p in found if (m := re.fullmatch(r"(.*?)(\d+)", p.stem))]
    if not named:
        what = f"{len(found)} EXR files without a frame number" if found else "no EXR file"
        raise ClipError(f"{folder} holds {what}; render the animation as OpenEXR MultiLayer, one numbered file a frame")
    stems = sorted({stem for stem, _, _ in named})
    if len(stems) > 1:
        each = " and ".join(f"{s or 'plain'} {ranges(n for t, n, _ in named if t == s)}" for s in stems)
        raise ClipError(f"{folder} holds {len(stems)} sequences ({each}); put each into a folder of its own")
    numbers = Counter(number for _, number, _ in named)
    if double := [n for n, count in numbers.items() if count > 1]:
        raise ClipError(f"{folder} holds two files of frame {double[0]}; keep one of them")
    _refuse_gaps(folder, sorted(numbers))
    return {number: path for _, number, path in sorted(named, key=lambda entry: entry[1])}


def _refuse_gaps(folder: Path, numbers: Sequence[int]) -> None:
    if lack := absent(numbers):
        raise ClipError(
            f"{folder}: {lack} missing in the middle (found {ranges(numbers)}); render again what is missing"
        )


def ranges(numbers: Iterable[int]) -> str:
    """Frame numbers in short: 1-4, 6-9; with one constant step 1-9 step 2."""
    values = sorted(numbers)
    held = set(values)
    steps = {b - a for a, b in pairwise(values)}
    if len(values) > 2 and len(steps) == 1 and steps != {1}:
        return f"{values[0]}-{values[-1]} step {steps.pop()}"
    starts = [v for v in values if v - 1 not in held]
    ends = [v for v in values if v + 1 not in held]
    return ", ".join(f"{a}-{b}" if a < b else f"{a}" for a, b in zip(starts, ends, strict=True))


def absent(numbers: Sequence[int]) -> str:
    """What lacks between ordered numbers at their smallest step: "frame 5 is", "frames 5, 8-9 are", or nothing."""
    step = min((b - a for a, b in pairwise(numbers)), default=1)
    holes = [range(a + step, b, step) for a, b in pairwise(numbers) if b - a > step]
    long = "" if step == 1 else f" step {step}"  # a stray number may leave a hole of millions
    said = ", ".join(f"{hole[0]}-{hole[-1]}{long}" if len(hole) > 2 else ranges(hole) for hole in holes)
    if [len(hole) for hole in holes] == [1]:
        return f"frame {said} is"
    return f"frames {said} are" if holes else ""


def _one_size(folder: Path, headers: Mapping[int, Header]) -> tuple[int, int]:
    first, *_ = headers.items()
    for number, header in headers.items():
        if header.size != first[1].size:
            (h, w), (height, width) = header.size, first[1].size
            raise ClipError(
                f"{folder}: frame {number} is {w}x{h} but frame {first[0]} is {width}x{height}; "
                f"a shot needs one size, render again or put the shots into separate folders"
            )
    return first[1].size


def _same_passes(files: Mapping[int, Path], headers: Mapping[int, Header], plan: Plan) -> None:
    for number, header in headers.items():
        if lost := {name for names in plan.channels.values() for name in names} - set(header.names):
            raise ClipError(
                f"{files[number]} lacks {', '.join(sorted(lost))}, which the first frame has; "
                f"render it again with the same passes"
            )


# Passes.


def _plan(folder: Path, names: Sequence[str]) -> Plan:
    """Which channels hold which buffer, in the first layer with Combined and Vector (Composite has no Vector)."""
    layers: dict[str, dict[str, dict[str, str]]] = {}
    for name in names:
        prefix, _, channel = name.rpartition(".")
        layer, _, label = prefix.rpartition(".")
        key = re.sub(r"[\s_-]", "", label.lower())
        layers.setdefault(layer, {}).setdefault(key, {})[channel.upper()] = name
    complete = {layer: found for layer, passes in layers.items() if "color" in (found := _buffers(passes))}
    if not complete:
        held = sorted({name.rpartition(".")[0] or name for name in names})
        raise ClipError(
            f"{folder} has no Combined pass (it has {', '.join(held)}); "
            f"switch on Combined (View Layer properties > Passes > Data) and render again"
        )
    chosen = next((layer for layer, found in complete.items() if "vector" in found), None)
    if chosen is None:
        held = sorted({name.rpartition(".")[0] for name in names})
        raise ClipError(f"{folder} has no Vector pass (it has {', '.join(held)}); {NO_VECTOR}")
    return Plan(chosen, complete[chosen], tuple(layer for layer in complete if layer != chosen))


def _buffers(passes: Mapping[str, Mapping[str, str]]) -> dict[str, tuple[str, ...]]:
    """Channel names of every buffer that the passes of one view layer hold."""
    found = {}
    for buffer, (labels, spellings) in PASSES.items():
        options = [
            tuple(passes[label][c] for c in spelling)
            for label in labels
            for spelling in spellings
            if label in passes and all(c in passes[label] for c in spelling)
        ]
        if options:
            found[buffer] = options[0]
    return found


@np.errstate(invalid="ignore", over="ignore")
def _layers(passes: Mapping[str, np.ndarray]) -> Layers:
    """Blender's passes in our convention; NaN and infinite pixels stay what they are, except in the background.

    Combined: view transforms are not baked into EXRs; what a denoiser or filter left below 0 becomes 0.
    Depth: along the view axis (panoramas: Euclidean); background (1e10), what lies outside a render border (1e11) and
    anything beyond SKY become SKY.
    Vector: pixels, y up. X Y point to the previous frame, Z W come from the next, hence (X, -Y) and (-Z, W). Without W
    there is no motion_next. Blender evaluates the scene before the first and after the last frame, so both are kept.
    Normal: world space, averaged over the pixel; made unit again, 0 in the background.
    Object Index: 0 where no pass index was set.
    """
    out: Layers = {"color": _at_least_0(passes["color"])}
    if "depth" in passes:
        depth = passes["depth"].astype(np.float32)
        out["depth"] = np.where(depth <= 0, np.float32(SKY), np.minimum(depth, np.float32(SKY)))
    vector = passes["vector"].astype(np.float32)
    out["motion"] = np.stack((vector[0], -vector[1]))
    if len(vector) == 4:
        out["motion_next"] = np.stack((-vector[2], vector[3]))
    if "albedo" in passes:
        out["albedo"] = _at_least_0(passes["albedo"])
    if "normal" in passes:
        normal = passes["normal"].astype(np.float32)
        out["normal"] = normal / np.maximum(np.sqrt((normal * normal).sum(0)), 1e-3)
    out |= {name: passes[name] for name in ("roughness", "metallic") if name in passes}
    if "object" in passes:
        index = np.rint(np.maximum(passes["object"], 0))
        out["object"] = index.astype(np.uint32) if np.isfinite(index).all() else index
    return out


def _at_least_0(pixels: np.ndarray) -> np.ndarray:
    return np.where(np.isneginf(pixels), pixels, np.maximum(pixels, 0))


def _with_background(layers: Layers, number: int, shot: Shot, cuts: frozenset[int]) -> Layers:
    """Blender leaves the background's vectors 0 even when the camera turns: filled in where the cameras are known."""
    here = shot.cameras.get(number)
    if here is None or "depth" not in layers or not (sky := layers["depth"][0] >= SKY).any():
        return layers
    height, width = sky.shape
    moved: Layers = {}
    for name, other, cut in (("motion", number - 1, number), ("motion_next", number + 1, number + 1)):
        there = shot.cameras.get(other)
        if there is not None and cut not in cuts and name in layers:
            motion = background_motion(here, there, (height, width))
            moved |= {} if motion is None else {name: np.where(sky, motion, layers[name])}
    return layers | moved


# What the files tell besides pixels.


def _records(numbers: Sequence[int], shot: Shot, cuts: frozenset[int]) -> tuple[Record, ...]:
    """Times count the frames of the full rate; a cut in a frame that was left out is one of the next frame."""
    out = []
    for previous, number in zip((numbers[0], *numbers), numbers, strict=False):
        camera = shot.cameras.get(number)
        out.append(
            Record(
                number=number,
                time=float(number - numbers[0]),
                jitter=camera.jitter if camera else (0.0, 0.0),
                view=camera.view if camera else None,
                projection=camera.projection if camera else None,
                cut=not cuts.isdisjoint(range(previous + 1, number + 1)),
            )
        )
    return tuple(out)


def _cuts(headers: Mapping[int, Header], shot: Shot) -> frozenset[int]:
    """Frames that start a new camera: said by shot.json, or seen by the camera's name in the header."""
    names = {number: header.attributes.get("Camera") for number, header in headers.items()}
    changed = {b for a, b in pairwise(names) if names[a] and names[b] and names[a] != names[b]}
    return frozenset(changed | {number for number, camera in shot.cameras.items() if camera.cut})


def _frame_rate(asked: float | None, shot: Shot, headers: Mapping[int, Header]) -> tuple[float, str]:
    """Frames a second, and where that is from."""
    if asked is not None:
        if not asked > 0:
            raise ValueError(f"{asked} frames a second were asked for; give a number above 0")
        return float(asked), f"{asked:g} frames a second, as asked"
    if shot.fps is not None:
        return shot.fps, f"{shot.fps:g} frames a second, from shot.json"
    if (rate := _timecode_rate(headers)) is not None:
        return rate, f"{rate:g} frames a second, from the timecodes in the headers"
    return FPS, f"{FPS:g} frames a second, assumed: nothing tells (say it with --fps)"


def _timecode_rate(headers: Mapping[int, Header]) -> float | None:
    """Rate by the last frame's number and its timecode hours:minutes:seconds:frame, once a second has passed."""
    text = list(headers.values())[-1].attributes
    match = re.fullmatch(r"(\d+):(\d+):(\d+):(\d+)", text.get("Time", ""))
    if not match or not text.get("Frame", "").isdigit():
        return None
    hours, minutes, seconds, rest = (int(part) for part in match.groups())
    passed = 3600 * hours + 60 * minutes + seconds
    return float(round((int(text["Frame"]) - rest) / passed)) or None if passed else None


def _notes(plan: Plan, shot: Shot, probe: Layers, headers: Mapping[int, Header]) -> list[str]:
    """What a user should know of this shot, one sentence each."""
    numbers = list(headers)
    space = headers[numbers[0]].attributes.get("colorInteropID", "")
    background = bool((probe.get("depth", np.zeros(1)) >= SKY).any())
    between = {n for number in numbers for n in (number - 1, number + 1) if numbers[0] <= n <= numbers[-1]}
    notes = {
        f"view layer {plan.layer} was taken; {', '.join(plan.others)} left alone": bool(plan.others),
        "no motion_next: Vector has no fourth channel (a File Output node drops it)": "motion_next" not in probe,
        "panorama: depth is the distance from the camera, and there is no projection": shot.panorama,
        f"colour is {space}, kept as it is; import expects linear Rec.709": space.startswith("lin_")
        and space != "lin_rec709_scene",
        "no cameras: write shot.json with examples/blender/export_camera.py": not shot.cameras,
        "the background's vectors are 0, as Blender leaves them, where shot.json lacks the camera one frame before or "
        "after; harmless while the camera does not turn": background and not between <= set(shot.cameras),
    }
    return [note for note, holds in notes.items() if holds]
