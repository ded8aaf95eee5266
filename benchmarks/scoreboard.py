"""The scoreboard from nothing: renders the held-out scenes, runs every shipped method in every mode, writes pages.

    python benchmarks/scoreboard.py --folder scoreboard --workers 2

Writes docs/results/README.md (the numbers), docs/results/claims.md (what papers claim, and what is measured here) and
the table between the markers in README.md. Everything that it measures is kept in the folder: interrupted and started
again it goes on, and what is there is not measured twice. Clips that are there already are taken: FOLDER/plain/SCENE
(no jitter, references of one sample) for generated frames, FOLDER/large/SCENE (jittered, references of twice the size)
for larger images. `docs/evaluation.md` says how the numbers are made.
"""

import json
import shutil
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import torch
import tyro

sys.path.insert(0, str(Path(__file__).parent))
import claims
import scoreboard_page as pages

from framecast import bench
from framecast.campaign import command as evaluate
from framecast.campaign import unfinished
from framecast.clip import Clip, open_clip
from framecast.exr import whole
from framecast.fit import fitting, method_named
from framecast.provenance import described, machine, source
from framecast.results import Mode, Row, read_provenance, read_results

ROOT = Path(__file__).parent.parent


@dataclass(frozen=True)
class Part:
    """One mode at one size: methods that have it are measured on clips of one kind."""

    name: str
    title: str
    clips: str
    """Folder of the clips."""
    mode: Mode
    scale: float


PARTS = (
    Part("interpolate", "Frames between frames", "plain", "interpolate", 1.0),
    Part("extrapolate", "Frames ahead of the last", "plain", "extrapolate", 1.0),
    Part("same-size", "Every frame improved, at its own size", "large", "pass", 1.0),
    Part("larger", "Every frame twice the size", "large", "pass", 2.0),
    Part("larger-interpolate", "Frames between frames, all twice the size", "large", "interpolate", 2.0),
    Part("larger-extrapolate", "Frames ahead of the last, all twice the size", "large", "extrapolate", 2.0),
)

RENDERED = {"plain": (1.0, 1, False, 11), "large": (2.0, 16, True, 16)}
"""Scale of the references, their samples, jitter, and frames of each kind of clip."""


def main(
    folder: Path = Path("scoreboard"),
    size: str = "320x180",
    scenes: str = "",
    metrics: str = "psnr,ssim,flip,flip-hdr,warped,flicker",
    workers: int = 1,
    repeats: int = 10,
    render: bool = True,
    out: Path = ROOT,
) -> None:
    """Measure what is not measured yet, and write the pages.

    Args:
        folder: clips, and everything measured.
        size: width x height of rendered frames.
        scenes: names separated by commas; by default all that no method is trained on.
        metrics: names separated by commas.
        workers: processes that evaluate; times are measured on their own, afterwards, in one.
        repeats: times that each role of each method is timed.
        render: make the clips that are not there; without it they are left out.
        out: folder whose README.md and docs/results are written.
    """
    rows: dict[str, list[Row]] = {}
    spent: dict[str, list[bench.Row]] = {}
    for part in PARTS:
        clips = opened(folder / part.clips, part.clips, size, _names(scenes), render)
        names = measurable(part, clips)
        if names:
            print(f"{part.title}: {', '.join(names)} on {len(clips)} clips", flush=True)
            rows[part.name] = evaluated(folder / f"{part.name}.json", part, clips, names, metrics, workers)
    for part in (part for part in PARTS if part.name in rows):
        names = list(dict.fromkeys(row.method for row in rows[part.name]))
        spent[part.name] = timed(folder / f"{part.name}-times.json", names, part.scale, size, repeats)
    about = {part.name: read_provenance(folder / f"{part.name}.json") for part in PARTS if part.name in rows}
    board = pages.Board({part.name: part.title for part in PARTS}, rows, spent, about)
    written(out / "docs/results/README.md", pages.scoreboard(board))
    written(out / "docs/results/claims.md", claims.page(rows, spent))
    readme = out / "README.md"
    written(readme, pages.replaced(readme.read_text(), pages.summary(board)))
    print(f"{out}: README.md, docs/results/README.md, docs/results/claims.md")


def opened(folder: Path, kind: str, size: str, scenes: Sequence[str], render: bool) -> list[Clip]:
    """The clips of a kind, those that are not there rendered."""
    from framecast.render.command import command as render_clip
    from framecast.render.scenes import TEST

    scale, samples, jitter, frames = RENDERED[kind]
    for scene in scenes or TEST:
        if render and not (folder / scene / "clip.json").is_file():
            render_clip(scene, folder / scene, size, scale, frames, samples=samples, jitter=jitter)
    return [open_clip(folder / s) for s in scenes or TEST if (folder / s / "clip.json").is_file()]


def measurable(part: Part, clips: Sequence[Clip]) -> tuple[str, ...]:
    """Every method that has the mode at the size, and runs on the clips."""
    return fitting(clips, part.mode, [part.scale]) if clips else ()


def evaluated(
    path: Path, part: Part, clips: Sequence[Clip], names: Sequence[str], metrics: str, workers: int
) -> list[Row]:
    """The rows of a part, from its file where that is about the same clips, methods and metrics."""
    if not is_current(path, clips, names, metrics):
        if path.is_file() and not unfinished(path).is_file():
            shutil.copyfile(path, unfinished(path))  # what is new or has changed is measured, the rest kept
        folders = tuple(clip.path for clip in clips)
        evaluate(folders, ",".join(names), part.mode, part.scale, path, metrics=metrics, workers=workers)
    return read_results(path)


def is_current(path: Path, clips: Sequence[Clip], names: Sequence[str], metrics: str) -> bool:
    """Whether a results file is about these clips, methods as they are now, and metrics."""
    about = read_provenance(path) if path.is_file() else None
    if about is None or not set(_names(metrics)) <= set(about.settings["metrics"]):
        return False
    scale = about.settings["scale"]
    return {clip.path.name: source(clip) for clip in clips} == dict(about.clips) and {
        name: described(method_named(name, scale)) for name in names
    } == dict(about.methods)


def timed(path: Path, names: Sequence[str], scale: float, size: str, repeats: int) -> list[bench.Row]:
    """Time and memory of methods at a size, eager, one thread; from the file where all of them are in it."""
    if path.is_file():
        held = json.loads(path.read_text())
        if {row["method"] for row in held["rows"]} >= set(names) and held["size"] == size:
            return [bench.Row(**row) for row in held["rows"]]
    torch.set_num_threads(1)
    width, height = (int(side) for side in size.split("x"))
    settings = bench.Settings(height, width, repeats, compile=False, scale=scale)
    rows = bench.bench(names, names[0], settings)
    written(path, json.dumps({"size": size, "rows": [asdict(row) for row in rows], "machine": machine()}, indent=1))
    return rows


def written(path: Path, text: str) -> None:
    """A file, whole or not at all."""
    with whole(path) as temporary:
        temporary.write_text(text)


def _names(text: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in text.split(",") if name.strip())


if __name__ == "__main__":
    tyro.cli(main)
