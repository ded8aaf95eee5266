"""Trains the trainable methods and times every method on whatever GPU is here; nothing is downloaded.

    python benchmarks/gpu/run.py --step all                     clips, train, time; again to go on
    python benchmarks/gpu/run.py --step train --method extranet --minutes 9

Every step stops in time (--minutes) and goes on when called again. Clips are rendered here where a Vulkan driver
works; else training reads packed crops (`crops.py`) from --crops. Everything lands in one folder with the card's name:

    out/nvidia-h200/machine.json, clips/, runs/extranet/ (weights, log, pictures), timings.jsonl
"""

import argparse
import json
import platform
import re
import statistics
import sys
import time as clock
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from torch import nn

sys.path.insert(0, str(Path(__file__).parent))
from crops import unpack

from framecast.clip import Clip
from framecast.data import Footage, footage
from framecast.exr import whole
from framecast.frame import Frame, moment, unshaded
from framecast.methods import METHODS, TRAINABLE
from framecast.render.scenes import TRAIN
from framecast.runtime import compiled
from framecast.sample import scene
from framecast.train import Settings, train, trainable

SIZES = ((540, 960), (720, 1280), (1080, 1920))
VARIANTS = ("eager", "half", "compiled", "graph")


@dataclass(frozen=True)
class Plan:
    """How much is done; `tiny` is the plan of the tests."""

    size: tuple[int, int] = (360, 640)
    """Of rendered clips."""
    frames: int = 32
    seeds: tuple[int, ...] = (0, 1)
    scenes: tuple[str, ...] = TRAIN
    steps: int = 12_000
    batch: int = 8
    crop: int = 256
    sizes: tuple[tuple[int, int], ...] = SIZES
    """Timed input sizes."""
    variants: tuple[str, ...] = VARIANTS
    repeats: int = 30


TINY = Plan((64, 64), 6, (0,), TRAIN[:1], 2, 2, 16, ((24, 40),), ("eager", "half"), 2)


def device() -> str:
    """cuda where there is a GPU."""
    return "cuda" if torch.cuda.is_available() else "cpu"


def card() -> str:
    """Name of the machine's accelerator as a folder name."""
    name = torch.cuda.get_device_name() if device() == "cuda" else f"cpu-{platform.machine()}"
    return re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-")


def write_machine(folder: Path) -> None:
    """What the numbers were measured on."""
    about = {"card": card(), "torch": torch.__version__, "cuda": torch.version.cuda, "system": platform.platform()}
    with whole(folder / "machine.json") as temporary:
        temporary.write_text(json.dumps(about, indent=1))


# Clips.


def render(folder: Path, plan: Plan, over: Callable[[], bool]) -> list[Clip]:
    """Training clips rendered here, those that time allows; none where there is no driver.

    Scene by scene with the first seed, then the next, so that a stop leaves a balanced set.
    """
    from framecast.render import device as vulkan
    from framecast.render.make import Settings as Render
    from framecast.render.make import render_clip

    try:
        vulkan.open_device()
    except FileNotFoundError as error:
        print(f"no clips are rendered here: {error}")
        return []
    clips = []
    for seed in plan.seeds:
        for name in plan.scenes:
            where = folder / f"{name}-{seed}"
            if over() and not (where / "clip.json").is_file():
                continue
            clips.append(render_clip(Render(name, plan.size, 1.0, seed, 0), where, frames=plan.frames))
    return clips


def sources(folder: Path, plan: Plan, crops: Path | None, over: Callable[[], bool]) -> list[Footage]:
    """What training reads: rendered clips, else packed crops."""
    clips = [] if crops is not None else render(folder / "clips", plan, over)
    if clips:
        return [footage(clip, folder / "cache") for clip in clips]
    return list(unpack(crops or Path(__file__).parent / "crops"))


# Timing.


def frame(time: float, height: int, width: int, where: str) -> Frame:
    """A frame with every buffer, of the scene that methods are timed on."""
    return scene(time, height, width).to(where)


def measure(method: Any, variant: str, size: tuple[int, int], repeats: int) -> dict[str, float]:
    """Median milliseconds of one generated frame, or of a shaded one where the method makes none, and the peak memory
    of making it in megabytes (CUDA)."""
    where = device()
    method = method.to(where).eval()
    call = compiled(method) if variant == "compiled" else method
    state = method.start(frame(0.0, *size, where))
    for time in (0.0, 2.0, 4.0):
        state = call(frame(time, *size, where), state)[1]
    at = 5.0 if "extrapolate" in method.modes else 3.0
    wanted = unshaded(frame(at, *size, where)) if method.needs_generated else moment(at, device=where)
    if method.modes == ("pass",):  # it makes no frames: the time is that of a shaded one
        wanted = frame(6.0, *size, where)

    def generate() -> None:
        with torch.no_grad(), torch.autocast(where, torch.bfloat16, enabled=variant == "half"):
            call(wanted, state)

    run = graphed(generate) if variant == "graph" else generate
    if where == "cuda":
        torch.cuda.reset_peak_memory_stats()
    times = [timed(run, where) for _ in range(repeats + 3)][3:]
    found = {"milliseconds": statistics.median(times)}
    return {**found, "peak_megabytes": torch.cuda.max_memory_allocated() / 1e6} if where == "cuda" else found


def timed(run: Callable[[], None], where: str) -> float:
    """Milliseconds of one call: between two CUDA events, or by the clock."""
    if where != "cuda":
        began = clock.perf_counter()
        run()
        return (clock.perf_counter() - began) * 1e3
    start, end = (torch.cuda.Event(enable_timing=True) for _ in range(2))
    start.record()
    run()
    end.record()
    torch.cuda.synchronize()
    return start.elapsed_time(end)


def graphed(run: Callable[[], None]) -> Callable[[], None]:
    """The call captured as a CUDA graph."""
    stream = torch.cuda.Stream()
    stream.wait_stream(torch.cuda.current_stream())
    with torch.cuda.stream(stream):
        for _ in range(3):
            run()
    torch.cuda.current_stream().wait_stream(stream)
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        run()
    return graph.replay


def makers() -> dict[str, Callable[[], nn.Module]]:
    """Every method, and the networks that are not shipped yet (weights do not change their speed)."""
    return {**METHODS, **{name: make for name, (make, _) in TRAINABLE.items() if name in ("extranet", "extranet-plus")}}


def time_all(path: Path, plan: Plan, over: Callable[[], bool]) -> bool:
    """Times what is not in the file yet, a line each; True when nothing is left."""
    lines = path.read_text().splitlines() if path.is_file() else []
    done = {(row["method"], row["variant"], row["height"]) for row in map(json.loads, lines)}
    for size in plan.sizes:
        for name, make in makers().items():
            for variant in plan.variants:
                if variant == "graph" and device() != "cuda":
                    continue
                method = make()
                if (name, variant, size[0]) in done or (variant == "half" and not list(method.parameters())):
                    continue
                if over():
                    return False
                row = {"method": name, "variant": variant, "height": size[0], "width": size[1]}
                try:
                    row |= measure(method, variant, size, plan.repeats)
                except RuntimeError as error:  # a method that looks at its data cannot be captured
                    row |= {"refused": str(error).splitlines()[0]}
                with path.open("a") as file:
                    file.write(json.dumps(row) + "\n")
                print(row, flush=True)
    return True


def main(arguments: Sequence[str] | None = None) -> None:
    """Runs the steps asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--step", choices=("clips", "train", "time", "all"), default="all")
    parser.add_argument("--method", default="extranet", help=f"what is trained: {', '.join(TRAINABLE)}")
    parser.add_argument("--minutes", type=float, default=9.0, help="stop after so long; the next call goes on")
    parser.add_argument("--steps", type=int, default=None, help="training steps, instead of the plan's")
    parser.add_argument("--crops", type=Path, default=None, help="train on these packed crops, do not render")
    parser.add_argument("--out", type=Path, default=Path("out"))
    parser.add_argument("--tiny", action="store_true", help="seconds of work, to see that everything runs")
    chosen = parser.parse_args(arguments)
    plan = TINY if chosen.tiny else Plan()
    folder, began = chosen.out / card(), clock.perf_counter()

    def left() -> float:
        return chosen.minutes - (clock.perf_counter() - began) / 60

    write_machine(folder)
    if chosen.step == "clips":
        render(folder / "clips", plan, lambda: left() <= 0)
    if chosen.step in ("train", "all"):
        make, recipe = trainable(chosen.method)
        recipe = replace(recipe, steps=chosen.steps or plan.steps, batch=plan.batch, crop=(plan.crop, plan.crop))
        found = sources(folder, plan, chosen.crops, lambda: left() <= chosen.minutes / 2)
        torch.manual_seed(0)
        settings = Settings(device=device(), workers=0 if chosen.tiny else 12, minutes=max(left(), 0.01), log=20)
        done = train(chosen.method, make(), recipe, found, folder / "runs" / chosen.method, settings)
        print(f"{chosen.method}: {'trained' if done else 'to be continued'}")
    if chosen.step in ("time", "all"):
        done = time_all(folder / "timings.jsonl", plan, lambda: left() <= 0)
        print(f"timings: {'complete' if done else 'to be continued'} -> {folder / 'timings.jsonl'}")


if __name__ == "__main__":
    main()
