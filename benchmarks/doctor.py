"""How often the doctor is right: healthy clips, each corruption of their buffers alone, and random pairs of them.

    python benchmarks/doctor.py CLIP... --out doctor.jsonl [--turns 4] [--pairs 20] [--only NAME,...] [--again]

The first frames of each clip are copied with one buffer stored in another convention (or two) and examined as if
nothing were known.
*right*: every corruption is named and nothing else is. *undecidable*: the doctor says that this cannot be told.
*wrong*: anything else. Results are appended one line a run, with a fingerprint of the doctor's code; the same call goes
on where it was, with `--again` repeating rows of older code. Of each experiment the last row counts. `--table FILE`
prints the tables of docs/results/doctor.md.
"""

import argparse
import json
import random
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache
from hashlib import sha256
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F

from framecast import doctor, exr
from framecast.clip import ON_DISK, Clip, Layers, Matrix, Record, finish
from framecast.color import to_display
from framecast.doctor import examine
from framecast.exr import ClipError
from framecast.frame import SKY, camera_motion
from framecast.importers import open_any
from framecast.importers.encode import encode_depth
from framecast.importers.settings import Depth
from framecast.warp import nearest_neighbour, pick

Frames = list[tuple[Record, Layers]]


@dataclass(frozen=True)
class Corruption:
    """A change of all frames, and the codes of which one has to be among the findings."""

    topic: str
    codes: tuple[str, ...]
    change: Callable[[Frames], Frames]
    undecided: tuple[str, ...] = ()
    """Codes that say that this cannot be told."""
    also: tuple[str, ...] = ()
    """Codes that are right besides."""


NEIGHBOUR = {"motion": -1, "motion_next": 1}
"""Where vectors lead. Both are changed, since the next frame's may be taken for the previous one's afterwards."""


def vectors(change: Callable[[np.ndarray, int, Frames, str], np.ndarray]) -> Callable[[Frames], Frames]:
    """Only the vectors are changed."""
    return lambda frames: [
        (r, {**a, **{name: change(a[name].astype(np.float32), i, frames, name) for name in NEIGHBOUR if name in a}})
        for i, (r, a) in enumerate(frames)
    ]


def neighbour(frames: Frames, i: int, name: str) -> Record:
    """The frame to which vectors lead; at the ends the frame itself."""
    other = i + NEIGHBOUR[name]
    return frames[other if 0 <= other < len(frames) else i][0]


def column(*values: float) -> np.ndarray:
    return np.array(values, np.float32)[:, None, None]


def ndc(v: np.ndarray, y: float = 1.0) -> np.ndarray:
    return v / column(v.shape[2] / 2, y * v.shape[1] / 2)


def unreal(v: np.ndarray, root: bool) -> np.ndarray:
    n = -ndc(v, -1.0)
    n = np.sign(n) * np.sqrt(2 * np.abs(n)) if root else n
    return (n * 0.2495 + 32767 / 65535).astype(np.float32)


def camera_part(frames: Frames, i: int, name: str) -> np.ndarray:
    """What the cameras alone do between a frame and its neighbour; nothing where there is none."""
    from framecast.importers.decode import _bare

    (here, layers), there = frames[i], neighbour(frames, i, name)
    depth = layers["depth"].astype(np.float32)
    if there is here or here.view is None or there.view is None:
        return np.zeros_like(layers[name], np.float32)
    return camera_motion(_bare(here, depth), _bare(there, depth))[0].numpy()


def without_camera(v: np.ndarray, i: int, frames: Frames, name: str) -> np.ndarray:
    rest = v - camera_part(frames, i, name)
    return np.where(np.abs(rest).max(0) < 0.02, 0, rest).astype(np.float32)


def unwritten(v: np.ndarray, i: int, frames: Frames, name: str) -> np.ndarray:
    return np.where(np.abs(v - camera_part(frames, i, name)).max(0) < 0.02, 0, v).astype(np.float32)


def shaken(v: np.ndarray, i: int, frames: Frames, name: str) -> np.ndarray:
    return v + column(*np.subtract(frames[i][0].jitter, neighbour(frames, i, name).jitter))


def dilated(v: np.ndarray, i: int, frames: Frames, _: str) -> np.ndarray:
    depth = torch.from_numpy(frames[i][1]["depth"].astype(np.float32))[None]
    return pick(torch.from_numpy(v)[None], nearest_neighbour(depth))[0].numpy()


def averaged(v: np.ndarray, *_: object) -> np.ndarray:
    return F.avg_pool2d(torch.from_numpy(v)[None], 3, 1, 1, count_include_pad=False)[0].numpy()


def moved(steps: int) -> Callable[[Frames], Frames]:
    """Each file holds the vectors of the frame `steps` later."""
    return vectors(lambda v, i, frames, name: frames[min(max(i + steps, 0), len(frames) - 1)][1][name])


def depths(**kind: object) -> Callable[[Frames], Frames]:
    def change(frames: Frames) -> Frames:
        about = Depth(files=("x",), channels=("Z",), **kind)  # type: ignore[arg-type]
        return [
            (r, {**a, "depth": encode_depth(a["depth"], about, r.projection).astype(np.float32)}) for r, a in frames
        ]

    return change


def scaled_depth(a: np.ndarray) -> np.ndarray:
    return np.where(a >= SKY * 0.99, SKY, np.minimum(a * 100, SKY * 0.98)).astype(np.float32)


def eight_bits(a: np.ndarray) -> np.ndarray:
    top = float(np.quantile(a[a < SKY * 0.99], 0.99))
    return (np.rint(np.clip(a / top, 0, 1) * 255) / 255).astype(np.float32)


def only(name: str, change: Callable[[np.ndarray, Record, int], np.ndarray]) -> Callable[[Frames], Frames]:
    return lambda frames: [
        (r, {**a, name: change(a[name].astype(np.float32), r, i)} if name in a else a)
        for i, (r, a) in enumerate(frames)
    ]


def recorded(change: Callable[[tuple[float, float]], tuple[float, float]]) -> Callable[[Frames], Frames]:
    return lambda frames: [(replace(r, jitter=change(r.jitter)), a) for r, a in frames]


def in_view(n: np.ndarray, r: Record, _: int) -> np.ndarray:
    return np.einsum("ij,jhw->ihw", np.asarray(r.view)[:3, :3], n) if r.view is not None else n


def flicker(c: np.ndarray, _: Record, i: int) -> np.ndarray:
    return c * np.float32(1 + 0.15 * np.sin(2.1 * i))


def spliced(frames: Frames) -> Frames:
    """The second half shows another place: the picture turned by half a turn, its vectors and its camera with it."""
    half = len(frames) // 2
    return frames[:half] + [
        (replace(r, view=_rolled(r.view), jitter=(-r.jitter[0], -r.jitter[1])), _turned(a)) for r, a in frames[half:]
    ]


def _rolled(view: Matrix | None) -> Matrix | None:
    """A camera turned by half a turn around its axis."""
    return view and (*(tuple(-v for v in row) for row in view[:2]), *view[2:])


def _turned(a: Layers) -> Layers:
    return {k: np.ascontiguousarray(v[:, ::-1, ::-1] * (-1 if k.startswith("motion") else 1)) for k, v in a.items()}


def dropped(frames: Frames) -> Frames:
    """One frame in the middle is missing, and the rest renumbered."""
    gone = len(frames) // 2
    kept = [f for i, f in enumerate(frames) if i != gone]
    first = frames[0][0].number
    return [(replace(r, number=first + i, time=float(i)), a) for i, (r, a) in enumerate(kept)]


def repeated(frames: Frames) -> Frames:
    middle = len(frames) // 2
    return [(r, {**a, "color": frames[i - 1][1]["color"]} if i == middle else a) for i, (r, a) in enumerate(frames)]


def padded(frames: Frames) -> Frames:
    return [(r, {k: np.pad(v, ((0, 0), (0, 8), (0, 8))) for k, v in a.items()}) for r, a in frames]


def last_turned(v: np.ndarray, i: int, frames: Frames, name: str) -> np.ndarray:
    """Of vectors to the next frame the last two, since nothing follows the last."""
    return -v if i >= len(frames) + min(-NEIGHBOUR[name], 0) - 1 else v


def to_the_next(frames: Frames) -> Frames:
    return [(r, {**a, "motion": a.get("motion_next", a["motion"])}) for r, a in frames]


NO_MOTION, NO_DEPTH = ("motion", "motion.open"), ("depth.open",)

CORRUPTIONS: dict[str, Corruption] = {
    "sign": Corruption("motion", ("motion.sign", "motion.time"), vectors(lambda v, *_: -v), NO_MOTION),
    "y flip": Corruption("motion", ("motion.y",), vectors(lambda v, *_: v * column(1, -1)), NO_MOTION),
    "x flip": Corruption("motion", ("motion.x",), vectors(lambda v, *_: v * column(-1, 1)), NO_MOTION),
    "half length": Corruption("motion", ("motion.length",), vectors(lambda v, *_: v / 2), NO_MOTION),
    "double length": Corruption("motion", ("motion.length",), vectors(lambda v, *_: v * 2), NO_MOTION),
    "UV": Corruption("motion", ("motion.unit",), vectors(lambda v, *_: ndc(v) / 2), NO_MOTION),
    "NDC": Corruption("motion", ("motion.unit",), vectors(lambda v, *_: ndc(v)), NO_MOTION),
    "code 0.5": Corruption("motion", ("motion.code",), vectors(lambda v, *_: ndc(v) / 2 + 0.5), NO_MOTION),
    "Unreal code": Corruption(
        "motion", ("motion.code",), vectors(lambda v, *_: unreal(v, False)), NO_MOTION, ("motion.x",)
    ),
    "Unreal root": Corruption(
        "motion", ("motion.code",), vectors(lambda v, *_: unreal(v, True)), NO_MOTION, ("motion.x",)
    ),
    "no camera": Corruption("camera", ("motion.camera", "motion.empty"), vectors(without_camera), NO_MOTION),
    "unwritten": Corruption("camera", ("motion.unwritten", "motion.empty"), vectors(unwritten), NO_MOTION),
    "averaged": Corruption("edges", ("motion.averaged",), vectors(averaged), ("motion.edges",)),
    "dilated": Corruption("edges", ("motion.dilated",), vectors(dilated), ("motion.edges",)),
    "half floats": Corruption(
        "grain", ("motion.half",), vectors(lambda v, *_: v.astype(np.float16).astype(np.float32))
    ),
    "jitter inside": Corruption("jitter", ("motion.jittered",), vectors(shaken), ("motion.open",)),
    "to the next": Corruption("motion", ("motion.time", "motion.sign"), to_the_next, NO_MOTION),
    "last turned": Corruption("last", ("motion.turned",), vectors(last_turned), NO_MOTION),
    "a frame early": Corruption("offset", ("motion.offset",), moved(1), NO_MOTION),
    "a frame late": Corruption("offset", ("motion.offset",), moved(-1), NO_MOTION),
    "Euclidean": Corruption("depth", ("depth.kind",), depths(kind="euclidean"), NO_DEPTH),
    "device": Corruption("depth", ("depth.kind",), depths(kind="device", near=0.1, far=1000.0), NO_DEPTH),
    "reversed": Corruption("depth", ("depth.kind",), depths(kind="reversed", near=0.1), NO_DEPTH),
    "inverse": Corruption("depth", ("depth.kind",), depths(kind="inverse"), NO_DEPTH),
    "unit": Corruption("depth", ("depth.kind", "depth.scale"), depths(kind="unit", near=0.0, far=500.0), NO_DEPTH),
    "centimetres": Corruption("depth", ("depth.scale",), only("depth", lambda z, r, i: scaled_depth(z)), NO_DEPTH),
    "8-bit depth": Corruption("depth", ("depth.bits",), only("depth", lambda z, r, i: eight_bits(z))),
    "jitter sign": Corruption("jitter", ("jitter.sign",), recorded(lambda j: (-j[0], -j[1]))),
    "jitter y": Corruption("jitter", ("jitter.sign",), recorded(lambda j: (j[0], -j[1]))),
    "jitter lost": Corruption("jitter", ("jitter.unrecorded",), recorded(lambda j: (0.0, 0.0))),
    "view normals": Corruption("normal", ("normal.space",), only("normal", in_view), ("normal.open",)),
    "normals y": Corruption(
        "normal", ("normal.sign",), only("normal", lambda n, r, i: n * column(1, -1, 1)), ("normal.open",)
    ),
    "normals 0..1": Corruption("normal", ("normal.encoded",), only("normal", lambda n, r, i: n / 2 + 0.5)),
    "display colour": Corruption(
        "color",
        ("color.encoding",),
        only("color", lambda c, r, i: to_display(torch.from_numpy(c)).numpy()),
        ("color.open",),
    ),
    "exposure": Corruption("color", ("color.exposure",), only("color", flicker)),
    "cut": Corruption("frames", ("frames.cut",), spliced),
    "frame missing": Corruption("frames", ("frames.skipped",), dropped, NO_MOTION),
    "frame repeated": Corruption("frames", ("frames.repeated",), repeated),
    "padded": Corruption("size", ("frames.padded",), padded),
}


MOST = 12
"""Frames of a clip that are used."""


@cache
def frames_of(path: Path) -> Frames:
    clip = open_any(path)
    return [(record, clip.load(record)) for record in clip.records[:MOST]]


def write(folder: Path, frames: Frames, span: float | None, provenance: dict[str, object]) -> None:
    """The frames as a clip, without compression, which would take longer than the examination."""
    for record, layers in frames:
        channels: dict[str, np.ndarray] = {}
        for name in ("color", "depth", "motion", "albedo", "normal", "object"):
            kind = {"object": np.uint32, "color": np.float16}.get(name, np.float32)
            for plane, channel in zip(layers.get(name, ()), ON_DISK[name], strict=False):
                limited = np.clip(plane, -65504, 65504) if kind is np.float16 else plane
                channels[channel] = limited.astype(kind)
        about = {"framecast": json.dumps(asdict(record))}
        exr.write(folder / "frames" / f"{record.number:04d}.exr", channels, attributes=about, compression="none")
    finish(folder, fps=24, span=span, provenance=provenance)


def same(a: Frames, b: Frames) -> bool:
    """Whether a corruption changed nothing that matters (vectors by less than a tenth of a pixel)."""
    if len(a) != len(b):
        return False
    for (r, x), (s, y) in zip(a, b, strict=True):
        if r.jitter != s.jitter or x.keys() != y.keys():
            return False
        for name in x:
            if x[name].shape != y[name].shape:
                return False
            far = np.abs(x[name].astype(np.float32) - y[name].astype(np.float32)).max(0) > (
                1e-1 if name == "motion" else 0
            )
            if far.mean() > 0.01:
                return False
    return True


def judged(codes: Counter[str], unknown: set[str], applied: Sequence[Corruption]) -> str:
    """right, undecidable or wrong."""
    fixed = set(codes)
    named = [fixed & set(c.codes) for c in applied]
    extra = fixed - {code for c in applied for code in (*c.codes, *c.also)}
    if all(named) and not extra:
        return "right"
    open_ = all(n or unknown & set(c.undecided) for n, c in zip(named, applied, strict=True))
    return "undecidable" if open_ and not extra else "wrong"


def run(clip: Clip, names: Sequence[str]) -> dict[str, object] | None:
    """One folder, examined; None where the corruptions change nothing."""
    plain = frames_of(clip.path)
    frames = plain
    for name in names:
        changed = CORRUPTIONS[name].change(frames)
        if name != "half floats" and same(frames, changed):
            return None
        frames = changed
    source = str(clip.provenance.get("source", ""))
    blender = "Blender" if "Blender" in source or clip.provenance.get("software") else ""
    with tempfile.TemporaryDirectory() as folder:
        write(Path(folder) / "clip", frames, clip.span, {"source": blender})
        began = time.process_time()
        try:
            report = examine(Path(folder) / "clip").report
        except ClipError as error:
            return {
                "clip": clip.path.name,
                "names": list(names),
                "result": "wrong",
                "error": str(error),
                "code": fingerprint(),
            }
        seconds = time.process_time() - began
    codes = Counter(f.code for f in report.findings if f.state == "fix")
    noted = {f.code for f in report.findings if f.state == "note"}
    unknown = {f.code for f in report.findings if f.state == "unknown"}
    applied = [CORRUPTIONS[n] for n in names]
    codes.update({c for a in applied for c in a.codes if c in noted})  # a note that names it counts
    result = judged(codes, unknown, applied)
    return {
        "clip": clip.path.name, "names": list(names), "result": result, "fix": sorted(codes),
        "unknown": sorted(unknown), "verdict": report.verdict, "seconds": round(seconds, 1), "code": fingerprint(),
    }  # fmt: skip


@cache
def fingerprint() -> str:
    """Changes with the doctor's experiments and with the importers."""
    folder = Path(doctor.__file__).parent
    files = [*sorted(folder.glob("*.py")), *sorted((folder.parent / "importers").glob("*.py"))]
    told = [path for path in files if path.name not in ("command.py", "picture.py")]
    return sha256(b"".join(path.read_bytes() for path in told)).hexdigest()[:8]


def plan(clips: Sequence[Clip], turns: int, pairs: int) -> list[tuple[Clip, tuple[str, ...]]]:
    """Healthy, each alone on `turns` clips, and `pairs` random pairs of different topics a clip; clips in turn, the
    same every time."""
    todo: list[tuple[Clip, tuple[str, ...]]] = [(clip, ()) for clip in clips]
    able = {name: [clip for clip in clips if possible(clip, (name,))] for name in CORRUPTIONS}
    for turn in range(turns):
        for place, (name, held) in enumerate(able.items()):
            todo += [(held[(place + turn) % len(held)], (name,))] if turn < len(held) else []
    every = [(a, b) for a in CORRUPTIONS for b in CORRUPTIONS if a < b and CORRUPTIONS[a].topic != CORRUPTIONS[b].topic]
    chances = {clip.path.name: random.Random(clip.path.name) for clip in clips}
    for _ in range(pairs):
        for clip in clips:
            able = [pair for pair in every if possible(clip, pair)]
            todo.append((clip, tuple(sorted(chances[clip.path.name].choice(able), key=order))))
    return todo


ORDER = (
    "color", "camera", "edges", "jitter", "offset", "last", "motion", "grain", "frames", "normal", "depth", "size",
)  # fmt: skip
"""What needs depth as it is or changes the light comes first, then where vectors point, then how they are written."""


def order(name: str) -> int:
    return ORDER.index(CORRUPTIONS[name].topic)


def possible(clip: Clip, names: Sequence[str]) -> bool:
    """Whether the clip has what the corruptions change."""
    have = {*clip.layers}
    needs = {"normal": "normal", "depth": "depth", "edges": "depth", "offset": "depth"}
    if any(CORRUPTIONS[n].topic in needs and needs[CORRUPTIONS[n].topic] not in have for n in names):
        return False
    jittered = any(max(map(abs, r.jitter)) > 0 for r in clip.records)
    return jittered or all(CORRUPTIONS[n].topic != "jitter" for n in names)


def table(path: Path) -> str:
    """The results as Markdown: each corruption alone, the sums, and every pair that went wrong."""
    rows = [row for row in rows_of(path).values() if row.get("result")]
    count = lambda held: Counter(str(row["result"]) for row in held)  # noqa: E731
    by_length = [[row for row in rows if len(row["names"]) == n] for n in range(3)]  # type: ignore[arg-type]
    out = ["| | right | undecidable | wrong | right of all | of older code |", "|---|---|---|---|---|---|"]
    for label, held in zip(("healthy", "alone", "in pairs"), by_length, strict=True):
        c, old = count(held), sum(row.get("code") != fingerprint() for row in held)
        share = f"{c['right'] / max(len(held), 1):.1%}"
        out.append(f"| {label} | {c['right']} | {c['undecidable']} | {c['wrong']} | {share} | {old} |")
    out += ["", "| corruption | right | undecidable | wrong | not right on |", "|---|---|---|---|---|"]
    for name in CORRUPTIONS:
        held = [row for row in by_length[1] if row["names"] == [name]]
        c, bad = count(held), [f"{r['clip']} ({r['result']})" for r in held if r["result"] != "right"]
        out.append(f"| {name} | {c['right']} | {c['undecidable']} | {c['wrong']} | {', '.join(bad)} |")
    wrong = [row for row in by_length[2] if row["result"] == "wrong"]
    out += ["", "| pairs that went wrong | clip | to fix, as the doctor says |", "|---|---|---|"]
    out += [f"| {' + '.join(r['names'])} | {r['clip']} | {', '.join(r.get('fix', ()))} |" for r in wrong]  # type: ignore
    return "\n".join(out)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("clips", nargs="*", type=Path)
    parser.add_argument("--out", type=Path, default=Path("doctor.jsonl"))
    parser.add_argument("--turns", type=int, default=99, help="clips on which each corruption is tried alone")
    parser.add_argument("--pairs", type=int, default=20, help="for each clip")
    parser.add_argument("--only", default="", help="corruptions, with commas between")
    parser.add_argument("--again", action="store_true", help="repeat rows of older code")
    parser.add_argument("--table", type=Path)
    asked = parser.parse_args()
    if asked.table:
        print(table(asked.table))
        return
    torch.set_num_threads(1)
    done = {key for key, row in rows_of(asked.out).items() if not asked.again or row.get("code") == fingerprint()}
    wanted = set(filter(None, asked.only.split(",")))
    for clip, names in plan([open_any(path) for path in asked.clips], asked.turns, asked.pairs):
        if (clip.path.name, *names) in done or (wanted and not wanted & {*names, "+".join(names)}):
            continue
        changed_nothing = {"clip": clip.path.name, "names": list(names), "result": "", "code": fingerprint()}
        done.add((clip.path.name, *names))
        row = json.dumps(run(clip, names) or changed_nothing)
        with asked.out.open("a") as file:
            file.write(row + "\n")
        print(row, flush=True)


def rows_of(path: Path) -> dict[tuple[str, ...], dict[str, object]]:
    """The last row of each experiment by clip and corruptions."""
    rows = map(json.loads, path.read_text().splitlines()) if path.is_file() else ()
    return {(row["clip"], *row["names"]): row for row in rows}


if __name__ == "__main__":
    main()
