"""ExtraSS beyond what `framecast evaluate` and `framecast bench` measure, as markdown.

    python benchmarks/extrass.py input CLIP...     extrass beside taau that is given the same shaded frames, and all
    python benchmarks/extrass.py gaps CLIP...      one, two and three generated frames between shaded ones
    python benchmarks/extrass.py drift CLIP...     300 frames of each clip, forth and back, by parts of 60
    python benchmarks/extrass.py full CLIP...      the same truth for methods that are given frames of its size
    python benchmarks/extrass.py warp              guided warping, eager and compiled

Clips need references of twice the size, for `full` of their own (`framecast render --scale 1`).
`--method extrass=runs/x/weights.safetensors` measures other weights.
"""

import statistics
import time as clock
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import torch
import tyro
from torch import Tensor

from framecast.clip import Clip, open_clip
from framecast.color import to_display
from framecast.evaluate import Settings, evaluate_clip, index_at
from framecast.fit import method_named
from framecast.frame import BUFFERS, Frame, unshaded
from framecast.methods import guided
from framecast.methods.reproject import steps
from framecast.metrics import measure
from framecast.results import Row
from framecast.runtime import OPTIONS, Output, schedule, stream
from framecast.sample import scene

Clips = tyro.conf.Positional[tuple[Path, ...]]

METRICS = ("psnr", "ssim", "flip", "warped", "flicker")
REGIONS = ("all", "disoccluded", "shading")


def input(clips: Clips, method: str = "extrass") -> None:
    """Quality in both roles, of each clip run twice, one frame apart."""
    found: dict[str, list[Row]] = defaultdict(list)
    for clip in map(open_clip, clips):
        name, large = clip.path.name, Settings(METRICS, scale=2.0)
        for row in evaluate_clip(clip, name, method, "extrapolate", Settings(METRICS)):
            found[f"{method}, {row.role}"].append(row)
        for start in (0, 1):
            found["taau, the same frames"] += evaluate_clip(clip.every(2, start=start), name, "taau", "pass", large)
        found["taau, every frame"] += evaluate_clip(clip, name, "taau", "pass", large)
    print("| | " + " | ".join([*(f"{r}, PSNR" for r in REGIONS), *METRICS[1:]]) + " |")
    for name, rows in found.items():
        cells = [mean(rows, region, "psnr") for region in REGIONS] + [mean(rows, "all", m) for m in METRICS[1:]]
        print(f"| {name} | " + " | ".join(cells) + " |")
    print("\nPSNR by scene, all pixels")
    for name, rows in found.items():
        scenes = list(dict.fromkeys(row.clip for row in rows))
        each = [mean([row for row in rows if row.clip == scene], "all", "psnr") for scene in scenes]
        print(f"| {name} | " + " | ".join(f"{s} {v}" for s, v in zip(scenes, each, strict=True)) + " |")


def mean(rows: list[Row], region: str, metric: str) -> str:
    """The mean of values, to print; nothing where there are none."""
    values = [row.value for row in rows if (row.region, row.metric) == (region, metric)]
    if not values:
        return ""
    return f"{statistics.fmean(values):.{2 if metric == 'psnr' else 4}f}"


def gaps(clips: Clips, method: str = "extrass") -> None:
    """PSNR by how many frames lie between shaded ones, and by which of them it is."""
    print("| generated between | shaded | " + " | ".join(f"generated {k}" for k in (1, 2, 3)) + " |")
    for gap in (2, 3, 4):
        values: dict[int, list[float]] = defaultdict(list)
        for clip in map(open_clip, clips):
            for start in range(gap):
                first = float(clip[start].time[0])
                for output in played(clip, method, gap, start):
                    place = round(output.time - first)
                    if place >= gap:
                        values[place % gap].append(against(clip, index_at(clip, output.time), output))
        print(f"| {gap - 1} | " + " | ".join(f"{statistics.fmean(values[k]):.2f}" for k in range(gap)) + " |")


def played(clip: Clip, method: str, gap: int, start: int) -> Iterator[Output]:
    """The images of a clip of which every `gap`-th frame is shaded."""
    view = clip.every(gap, start=start, motion="step")
    frames = (view[i] for i in range(len(view)))
    requests = schedule(frames, gap, "extrapolate", lambda time: unshaded(clip[index_at(clip, time)]))
    return stream(method_named(method), requests)


def against(clip: Clip, index: int, output: Output) -> float:
    """PSNR of an image, which may be the upper left part of its frame."""
    reference = clip.reference(index)
    assert reference is not None
    reference = reference[..., : output.image.shape[-2], : output.image.shape[-1]]
    return measure(to_display(output.image), to_display(reference), ["psnr"], {"all": None})["all", "psnr"]


def full(clips: Clips, methods: str = "warp-occlusion,extranet,extrass-warp,taa+extranet,taa+extrass-warp") -> None:
    """PSNR of shaded and of generated frames against their anti-aliased references, by scene."""
    opened = [open_clip(clip) for clip in clips]
    print("| | " + " | ".join(clip.path.name for clip in opened) + " | mean |")
    for method in methods.split(","):
        means: dict[bool, list[float]] = defaultdict(list)
        for clip in opened:
            values: dict[bool, list[float]] = defaultdict(list)
            for start in (0, 1):
                for output in played(clip, method, 2, start):
                    index = index_at(clip, output.time)
                    if index > start + 1:
                        values[output.generated].append(against(clip, index, output))
            for generated, found in values.items():
                means[generated].append(statistics.fmean(found))
        for generated, found in means.items():
            cells = [f"{value:.2f}" for value in (*found, statistics.fmean(found))]
            print(f"| {method}, {'generated' if generated else 'shaded'} | " + " | ".join(cells) + " |", flush=True)


def drift(clips: Clips, method: str = "extrass", frames: int = 300, part: int = 60, height: int = 180) -> None:
    """PSNR by parts of a long run, which passes the same frames again and again, of their uppermost rows."""
    for clip in map(open_clip, clips):
        for name in (method, "taau"):
            values: dict[tuple[int, bool], list[float]] = defaultdict(list)
            every = 1 if name == "taau" else 2
            given = ([cropped(frame, height)] for frame in forth_and_back(clip, frames, every))
            for k, output in enumerate(stream(method_named(name, 2.0), given)):
                values[k // part, output.generated].append(against(clip, place(clip, k), output))
            for generated in (False, True):
                parts = [statistics.fmean(v) for (_, of), v in sorted(values.items()) if of == generated]
                role = "generated" if generated else "shaded"
                if parts:
                    print(f"| {clip.path.name} | {name}, {role} | " + " | ".join(f"{p:.2f}" for p in parts) + " |")


def cropped(frame: Frame, height: int) -> Frame:
    """The uppermost rows of a frame."""
    buffers = {name: getattr(frame, name) for name in BUFFERS}
    return replace(frame, **{name: image[..., :height, :] for name, image in buffers.items() if image is not None})


def place(clip: Clip, k: int) -> int:
    """Which frame of the clip is shown at step k, forth and back."""
    last = len(clip) - 1
    return last - abs(k % (2 * last) - last)


def forth_and_back(clip: Clip, frames: int, every: int) -> Iterator[Frame]:
    """The clip as one long shot; on the way back vectors to the next frame lead to the one before. Of `every` frames
    the first is shaded."""
    for k in range(frames):
        frame = clip[place(clip, k)]
        back = k > 0 and place(clip, k - 1) > place(clip, k)
        if back:
            frame = replace(frame, motion=frame.motion_next, motion_next=frame.motion)
        frame = replace(frame, time=torch.tensor([float(k)]), reset=torch.tensor([k == 0]))
        yield frame if k % every == 0 else unshaded(frame)


def warp(height: int = 720, width: int = 1280, threads: int = 1, repeats: int = 5) -> None:
    """Milliseconds of guided warping on the moving scene of `framecast bench`.

    What a GPU runs searches every pixel; eager against compiled is fair of that. On a CPU only pixels are searched that
    the straight read does not serve, eager or compiled alike, so that there is less to compile.
    """
    torch.set_num_threads(threads)
    past, now = guided.seen(scene(0.0, height, width)), scene(1.0, height, width, span=1.0)
    given = past, guided.guides(now), steps(now, past.time, past.jitter)
    some = guided.search_elsewhere

    def whole(kept: Tensor, *rest: object) -> Tensor:
        return guided._searched_everywhere(*rest)  # type: ignore[arg-type]

    print("| guided warping | ms |")
    for name, search, run in (
        ("every pixel, eager", whole, guided.guided_warp),
        ("every pixel, compiled", whole, torch.compile(guided.guided_warp, dynamic=False, options=OPTIONS)),
        ("where needed, eager", some, guided.guided_warp),
    ):
        guided.search_elsewhere = search
        spent = []
        with torch.no_grad():
            for _ in range(repeats + 1):
                began = clock.perf_counter()
                run(*given)
                spent.append((clock.perf_counter() - began) * 1e3)
        print(f"| {name} | {statistics.median(spent[1:]):.0f} |")


if __name__ == "__main__":
    tyro.extras.subcommand_cli_from_dict({"input": input, "gaps": gaps, "full": full, "drift": drift, "warp": warp})
