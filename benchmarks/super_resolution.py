"""How fast frames are made larger, beside OpenCV's resize.

    python benchmarks/super_resolution.py [--repeats 20] [--methods bilinear,lanczos,taau,fsr2] [--sizes 320x180*3]

The moving scene of `framecast.bench`, jittered, from 640x360 to 1280x720 and to 1920x1080. All methods take turns
within one process, so that their ratios hold on a busy machine. Prints medians and quartiles in milliseconds, the
ratio to OpenCV's bicubic resize, and the most memory in use.
"""

import statistics
import time as clock
from collections.abc import Callable

import cv2
import numpy as np
import torch
import tyro
from rich.console import Console
from rich.table import Table

from framecast.bench import peak_memory, reset_peak_memory
from framecast.fit import method_named
from framecast.frame import Frame
from framecast.provenance import machine
from framecast.resample import size_at
from framecast.runtime import compiled
from framecast.sample import scene

WARM = 4
"""Frames that run before anything is timed."""


def frames(size: tuple[int, int]) -> list[Frame]:
    """The first moments of the scene."""
    return [scene(float(t), *size, span=1.0) for t in range(WARM + 1)]


def prepared(name: str, clip: list[Frame], scale: float, fast: bool) -> tuple[Callable[[], object], float]:
    """A call that makes one more image, from the state after the frames before; and the memory of those frames, MB."""
    method = method_named(name, scale).eval()
    call = compiled(method) if fast else method
    state = call.start(clip[0])
    reset_peak_memory("cpu")
    with torch.no_grad():
        for frame in clip[:-1]:
            _, state = call(frame, state)
    return (lambda: call(clip[-1], state)), peak_memory("cpu")


def resized(clip: list[Frame], scale: float, how: int) -> Callable[[], object]:
    """OpenCV's resize of the last frame."""
    assert clip[-1].color is not None
    image = np.ascontiguousarray(clip[-1].color[0].permute(1, 2, 0).numpy())
    height, width = size_at(image.shape[:2], scale)
    return lambda: cv2.resize(image, (width, height), interpolation=how)


def measured(calls: dict[str, Callable[[], object]], repeats: int) -> dict[str, list[float]]:
    """Milliseconds of each call, all of them in turn."""
    found: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(repeats):
        for name, call in calls.items():
            started = clock.perf_counter()
            with torch.no_grad():
                call()
            found[name].append((clock.perf_counter() - started) * 1e3)
    return found


def main(
    repeats: int = 20,
    methods: str = "bilinear,lanczos,taau,fsr2",
    sizes: str = "640x360*2,640x360*3",
    compiled: bool = True,
    threads: int | None = None,
) -> None:
    """Measure and print.

    Args:
        repeats: images that each method makes.
        methods: names separated by commas.
        sizes: width x height * scale, separated by commas.
        compiled: compiled methods, too.
        threads: CPU threads; by default as many as PyTorch takes.
    """
    if threads is not None:
        torch.set_num_threads(threads)
        cv2.setNumThreads(threads)
    console = Console()
    console.print(", ".join(f"{k} {v}" for k, v in machine().items()), highlight=False)
    for entry in sizes.split(","):
        size, _, factor = entry.partition("*")
        width, height = (int(side) for side in size.split("x"))
        console.print(table(entry, (height, width), float(factor), methods.split(","), compiled, repeats))


def table(title: str, size: tuple[int, int], scale: float, methods: list[str], compiled: bool, repeats: int) -> Table:
    """The results at one size."""
    clip = frames(size)
    calls = {
        "cv2 cubic": resized(clip, scale, cv2.INTER_CUBIC),
        "cv2 lanczos4": resized(clip, scale, cv2.INTER_LANCZOS4),
    }
    memory: dict[str, float] = {}
    for name in methods:
        for fast in (False, True) if compiled else (False,):
            label = f"{name} {'compiled' if fast else 'eager'}"
            calls[label], memory[label] = prepared(name, clip, scale, fast)
    measured(calls, 2)
    times = measured(calls, repeats)
    made = Table(title=title)
    for column in ("", "median ms", "quartiles", "of cv2 cubic", "peak MB"):
        made.add_column(column, justify="left" if not column else "right")
    base = statistics.median(times["cv2 cubic"])
    for label, values in times.items():
        low, middle, high = statistics.quantiles(values, n=4, method="inclusive")
        peak = f"{memory[label]:.0f}" if label in memory else ""
        made.add_row(label, f"{middle:.2f}", f"{low:.2f} - {high:.2f}", f"{middle / base:.1f}", peak)
    return made


if __name__ == "__main__":
    tyro.cli(main)
