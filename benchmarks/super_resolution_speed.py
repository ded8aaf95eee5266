"""How fast frames are made larger, beside OpenCV's resize: a part of `super_resolution.py`.

The moving scene that all timing uses, jittered. All methods take turns within one process, so that their ratios hold on
a busy machine.
"""

import statistics
import time as clock
from collections.abc import Callable, Sequence
from typing import Any

import cv2
import numpy as np
import torch

from framecast.bench import peak_memory, reset_peak_memory
from framecast.fit import method_named
from framecast.frame import Frame
from framecast.provenance import machine
from framecast.resample import sharp_warp, size_at
from framecast.runtime import OPTIONS, compiled, inference, placed
from framecast.sample import scene
from framecast.table import resample, shipped_table
from framecast.warp import warp

WARM = 4
"""Frames that run before anything is timed."""


def frames(size: tuple[int, int]) -> list[Frame]:
    """The first moments of the scene."""
    return [scene(float(t), *size, span=1.0) for t in range(WARM + 1)]


def prepared(name: str, clip: list[Frame], scale: float, fast: bool) -> tuple[Callable[[], object], float]:
    """A call that makes one more image, from the state after the frames before; and the memory of those frames, MB.

    As `runtime.stream` calls it: networks in bfloat16 where that is faster.
    """
    method = placed(method_named(name, scale), "cpu")
    call: Any = compiled(method) if fast else method
    state = call.start(clip[0])
    reset_peak_memory("cpu")
    with inference(method, "cpu"):
        for frame in clip[:-1]:
            _, state = call(frame, state)

    def once() -> object:
        with inference(method, "cpu"):
            return call(clip[-1], state)

    return once, peak_memory("cpu")


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


def compared(sizes: str, methods: Sequence[str], repeats: int, threads: int, fast: bool) -> list[str]:
    """Markdown: a table of each size, and how time grows with the pixels where several sizes have one scale.

    Args:
        sizes: width x height * scale, separated by commas, such as 640x360*2.
        fast: compiled methods, too.
    """
    torch.set_num_threads(threads)
    cv2.setNumThreads(threads)
    lines = [", ".join(f"{key} {value}" for key, value in machine().items())]
    growth: dict[str, dict[int, float]] = {}
    for entry in sizes.split(","):
        size, _, factor = entry.partition("*")
        width, height = (int(side) for side in size.split("x"))
        times, memory = timed((height, width), float(factor), methods, repeats, fast)
        lines += ["", f"### {width}x{height} made {float(factor):g} times as large", "", *rows(times, memory)]
        for name, values in times.items():
            growth.setdefault(name, {})[width * height] = statistics.median(values)
    if len(sizes.split(",")) > 1:
        lines += ["", "### Nanoseconds for each shaded pixel, at each of these sizes", "", *linear(growth)]
    return lines


def reads(size: tuple[int, int], repeats: int) -> list[str]:
    """Markdown: one compiled read of an image along motion: bilinear, by Catmull-Rom, and through the learned table.

    Ratios are of neighbours in time: the median of each call's time by that of the Catmull-Rom call in its turn.
    """
    height, width = size
    image, motion = torch.rand(1, 3, height, width), torch.randn(1, 2, height, width) * 0.3 + 3.3
    table = shipped_table()
    ways: dict[str, Callable[[], object]] = {
        "bilinear": lambda: warp(image, motion),
        "Catmull-Rom": lambda: sharp_warp(image, motion, bounded=False),
        "learned table": lambda: resample(image, motion, table),
        "Catmull-Rom, bounded": lambda: sharp_warp(image, motion),
        "learned table, bounded": lambda: resample(image, motion, table, bounded=True),
    }
    calls: dict[str, Callable[[], object]] = {}
    seconds: dict[str, float] = {}
    for name, way in ways.items():
        calls[name] = torch.compile(way, dynamic=False, options=OPTIONS)
        started = clock.perf_counter()
        made, expected = calls[name](), way()
        seconds[name] = clock.perf_counter() - started
        torch.testing.assert_close(made, expected, atol=5e-3, rtol=0)
    measured(calls, 2)
    times = measured(calls, repeats)
    lines = ["| read by | median ms | of Catmull-Rom | seconds to compile |", "|---" + "|---:" * 3 + "|"]
    for name, values in times.items():
        ratio = statistics.median(a / b for a, b in zip(values, times["Catmull-Rom"], strict=True))
        lines.append(f"| {name} | {statistics.median(values):.2f} | {ratio:.2f} | {seconds[name]:.1f} |")
    return lines


def timed(
    size: tuple[int, int], scale: float, methods: Sequence[str], repeats: int, fast: bool
) -> tuple[dict[str, list[float]], dict[str, float]]:
    """Milliseconds of every call, all of them in turn, and most memory in use while each was made ready, MB."""
    clip = frames(size)
    calls = {
        "cv2.resize, cubic": resized(clip, scale, cv2.INTER_CUBIC),
        "cv2.resize, lanczos4": resized(clip, scale, cv2.INTER_LANCZOS4),
    }
    memory: dict[str, float] = {}
    for name in methods:
        for compile in (False, True) if fast else (False,):
            label = f"{name}, compiled" if compile else name
            calls[label], memory[label] = prepared(name, clip, scale, compile)
            print(f"{label} at {size[1]}x{size[0]} is ready", flush=True)
    measured(calls, 2)
    return measured(calls, repeats), memory


def rows(times: dict[str, list[float]], memory: dict[str, float]) -> list[str]:
    """The table of one size."""
    base = statistics.median(times["cv2.resize, cubic"])
    lines = ["| method | median ms | quartiles | of cv2 cubic | peak MB |", "|---" + "|---:" * 4 + "|"]
    for label, values in times.items():
        low, middle, high = statistics.quantiles(values, n=4, method="inclusive")
        peak = f"{memory[label]:.0f}" if label in memory else ""
        lines.append(f"| {label} | {middle:.2f} | {low:.2f} - {high:.2f} | {middle / base:.1f} | {peak} |")
    return lines


def linear(growth: dict[str, dict[int, float]]) -> list[str]:
    """Time by pixels: the same number in each column is time in proportion to them."""
    pixels = sorted({count for times in growth.values() for count in times})
    lines = [f"| method | {' | '.join(f'{count} pixels' for count in pixels)} |", "|---" + "|---:" * len(pixels) + "|"]
    for name, times in growth.items():
        cells = [f"{times[count] * 1e6 / count:.0f}" if count in times else "" for count in pixels]
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return lines
