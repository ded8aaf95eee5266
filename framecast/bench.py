"""Time and memory of methods: every role and its stages, eager and compiled, in one process, on the scene of `sample`.

The calls are those of `runtime.stream`. All variants are run in turn, over and over, so that what else the machine
does meets all of them alike; a ratio between two of them is worth more than their milliseconds.
"""

import ctypes
import gc
import json as json_format
import os
import re
import statistics
import subprocess
import sys
import tempfile
import time as clock
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import torch
from rich.console import Console
from rich.table import Table
from torch._dynamo.utils import counters
from tyro.conf import Positional

from framecast import cost, exr
from framecast.fit import Method, method_named
from framecast.frame import Frame, moment, unshaded
from framecast.methods import METHODS
from framecast.provenance import machine
from framecast.runtime import can_compile, compiled, inference, placed, require_device
from framecast.sample import GAP, scene
from framecast.stages import Stopwatch, staged, wait

VERSION = 2
"""Of the results file."""

Role = Literal["shaded", "interpolate", "extrapolate"]

SHADED = 5
"""Shaded frames of the clip that runs before anything is timed."""

# Measuring.


@dataclass(frozen=True)
class Settings:
    """What is measured, and where."""

    height: int = 720
    width: int = 1280
    repeats: int = 20
    """Times that every role of every variant is timed."""
    device: str = "cpu"
    compile: bool = True
    """Compiled variants too."""
    scale: float | None = None
    """Size of the images divided by that of the frames; None: each method's own."""


@dataclass(frozen=True)
class Row:
    """One role of one method."""

    method: str
    role: Role
    compiled: bool
    median: float
    """Milliseconds for one frame."""
    lower: float
    """First quartile."""
    upper: float
    """Third quartile."""
    ratio: float | None
    """Median divided by that of the eager baseline in the same role; None where it has not that role."""
    stages: dict[str, float]
    """Milliseconds (median) in each stage, what it calls of other stages not counted; "rest" is outside of all."""
    memory: float
    """Most memory that the method added while a clip ran: to the process on the CPU (resident), to tensors on a GPU;
    MB, frames not counted."""
    peak_memory: float
    """Most memory in use while a clip ran, of the same; MB."""
    compile_cold: float | None
    """Seconds of the first call in a new process with an empty cache."""
    compile_warm: float | None
    """Seconds of the first call in a new process with what the cold one left in the cache."""
    recompilations: int
    """Graphs compiled while a clip ran, after the first frame of each role."""


@dataclass
class Variant:
    """A method, eager or compiled, with the state in which it is timed."""

    name: str
    compiled: bool
    call: Method
    roles: tuple[Role, ...]
    state: Any = None
    recompilations: int = 0
    memory: float = 0.0
    peak_memory: float = 0.0


def bench(
    methods: Sequence[str], baseline: str, settings: Settings = Settings(), trace: Path | None = None
) -> list[Row]:
    """Rows of every method, by name; the baseline is measured too, and `profile` writes to `trace`.

    Raises:
        ValueError: an unknown method or device, or a method that needs what cannot be compiled here.
    """
    require_device(settings.device)
    names = tuple(dict.fromkeys((baseline, *methods)))
    made = {name: method_named(name, settings.scale) for name in names}
    both = settings.compile and can_compile()
    with tempfile.TemporaryDirectory(prefix="framecast-bench-", ignore_cleanup_errors=True) as cache:
        cold = {name: first_calls_elsewhere(name, settings, cache) for name in made if both}
        warm = {name: first_calls_elsewhere(name, settings, cache) for name in made if both}
        frames = [scene(GAP * i, settings.height, settings.width).to(settings.device) for i in range(SHADED)]
        variants = [
            run_clip(variant(name, method, fast, settings), frames, settings)
            for name, method in made.items()
            for fast in ((False, True) if both else (False,))
        ]
        times = timed(variants, frames, settings)
        stages = staged_times(variants, frames, settings)
        if trace is not None:
            profile(variants, frames, settings, trace)
    medians = {key: statistics.median(values) for key, values in times.items()}
    return [
        Row(
            method=v.name,
            role=role,
            compiled=v.compiled,
            median=medians[i, role],
            lower=_quartiles(times[i, role])[0],
            upper=_quartiles(times[i, role])[2],
            ratio=medians[i, role] / medians[0, role] if (0, role) in medians else None,
            stages=stages[i, role],
            memory=v.memory,
            peak_memory=v.peak_memory,
            compile_cold=cold[v.name][role] if v.compiled else None,
            compile_warm=warm[v.name][role] if v.compiled else None,
            recompilations=v.recompilations,
        )
        for i, v in enumerate(variants)
        for role in v.roles
    ]


def variant(name: str, method: Method, fast: bool, settings: Settings) -> Variant:
    """A method ready to run, nothing compiled yet."""
    method = placed(method, settings.device)
    roles: tuple[Role, ...] = ("shaded", *(role for role in ("interpolate", "extrapolate") if role in method.modes))
    return Variant(name, fast, compiled(method) if fast else method, roles)


def request(role: Role, newest: Frame, method: Method) -> Frame:
    """The frame to generate in a role, after the shaded frame `newest`; empty where the method needs no more."""
    time = float(newest.time[0]) + (GAP / 2 if role == "extrapolate" else -GAP / 2)
    assert newest.depth is not None
    if not method.needs_generated:
        return moment(time, device=newest.depth.device)
    return unshaded(scene(time, *newest.depth.shape[-2:]).to(newest.depth.device))


def run_clip(v: Variant, frames: Sequence[Frame], settings: Settings) -> Variant:
    """The variant after the whole clip, each role run after every shaded frame but the first: compiled, warm.

    The clip runs twice, and memory is looked at in the second run, which compiles nothing.
    """
    given = [
        (role, frame if role == "shaded" else request(role, frame, v.call))
        for i, frame in enumerate(frames)
        for role in (v.roles if i else v.roles[:1])
    ]
    seen: set[Role] = set()
    for _ in range(2):
        v.state = None
        before = reset_peak_memory(settings.device)
        v.state = v.call.start(frames[0])
        for role, frame in given:
            known = graphs()
            with inference(v.call, settings.device):
                image, state = v.call(frame, v.state)
            v.state = state
            v.recompilations += graphs() - known if role in seen else 0
            seen.add(role)
            del image, state
    v.peak_memory = peak_memory(settings.device)
    v.memory = v.peak_memory - before
    return v


def graphs() -> int:
    """How many graphs were compiled in this process so far."""
    return counters["stats"]["unique_graphs"]


def timed(
    variants: Sequence[Variant], frames: Sequence[Frame], settings: Settings
) -> dict[tuple[int, Role], list[float]]:
    """Milliseconds of every role of every variant (by its position), all of them in turn, from their states."""
    given = inputs(variants, frames, settings)
    found: dict[tuple[int, Role], list[float]] = {key: [] for key in given}
    for _ in range(settings.repeats):
        for (i, role), frame in given.items():
            found[i, role].append(_milliseconds(variants[i].call, frame, variants[i].state))
    return found


def inputs(variants: Sequence[Variant], frames: Sequence[Frame], settings: Settings) -> dict[tuple[int, Role], Frame]:
    """The frame that follows the clip in every role of every variant (by its position)."""
    after = scene(GAP * SHADED, settings.height, settings.width).to(settings.device)
    return {
        (i, role): after if role == "shaded" else request(role, frames[-1], v.call)
        for i, v in enumerate(variants)
        for role in v.roles
    }


def _milliseconds(call: Method, frame: Frame, state: Any) -> float:
    wait(frame.time.device)
    started = clock.perf_counter()
    with inference(call, frame.time.device):
        call(frame, state)
    wait(frame.time.device)
    return (clock.perf_counter() - started) * 1e3


# Stages.


def staged_times(
    variants: Sequence[Variant], frames: Sequence[Frame], settings: Settings
) -> dict[tuple[int, Role], dict[str, float]]:
    """Median milliseconds of every stage of every role of every variant."""
    found: dict[tuple[int, Role], list[dict[str, float]]] = {}
    for _ in range(settings.repeats):
        for (i, role), frame in inputs(variants, frames, settings).items():
            watch = Stopwatch(settings.device)
            with watch.stage("rest"), inference(variants[i].call, settings.device):
                staged(variants[i].call, variants[i].compiled, watch)(frame, variants[i].state)
            found.setdefault((i, role), []).append(watch.spent)
    return {
        key: {name: statistics.median(one.get(name, 0.0) for one in spent) for name in spent[0]}
        for key, spent in found.items()
    }


def profile(variants: Sequence[Variant], frames: Sequence[Frame], settings: Settings, path: Path) -> None:
    """One call of every role of every variant with its stages and operators, as a trace that Perfetto opens."""
    given = inputs(variants, frames, settings)
    with torch.profiler.profile() as profiler:
        for (i, role), frame in given.items():
            v, watch = variants[i], Stopwatch(settings.device)
            title = f"{v.name} {role} {'compiled' if v.compiled else 'eager'}"
            with watch.stage(title), inference(v.call, settings.device):
                staged(v.call, v.compiled, watch)(frame, v.state)
    with exr.whole(path) as temporary:
        profiler.export_chrome_trace(str(temporary))


def _quartiles(values: Sequence[float]) -> list[float]:
    return statistics.quantiles(values, n=4, method="inclusive") if len(values) > 1 else [values[0]] * 3


def reset_peak_memory(device: str) -> float:
    """`peak_memory` starts anew, and is returned; where the system cannot do that it counts from the process's start.

    What was freed goes back to the system first, so that using it again counts.
    """
    if device.startswith("cuda"):
        torch.cuda.empty_cache()
        torch.cuda.reset_peak_memory_stats(device)
    elif Path("/proc/self/clear_refs").exists():
        gc.collect()
        with suppress(AttributeError, OSError):  # not every C library can
            ctypes.CDLL(None).malloc_trim(0)
        Path("/proc/self/clear_refs").write_text("5")  # see proc(5): resets VmHWM
    return peak_memory(device)


def peak_memory(device: str) -> float:
    """Most memory in use since `reset_peak_memory`, MB (10^6 bytes): of tensors on a GPU, else of this process."""
    if device.startswith("cuda"):
        return torch.cuda.max_memory_allocated(device) / 1e6
    status = Path("/proc/self/status")
    if status.exists():
        line = next(line for line in status.read_text().splitlines() if line.startswith("VmHWM"))
        return int(line.split()[1]) * 1024 / 1e6
    import resource  # not on Windows

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1e6 if sys.platform == "darwin" else 1e3)


# Compile times, in processes of their own.


def first_calls(name: str, settings: Settings) -> dict[Role, float]:
    """Seconds of the first call of each compiled role in this process."""
    v = variant(name, method_named(name, settings.scale), True, settings)
    frames = [scene(GAP * i, settings.height, settings.width).to(settings.device) for i in range(2)]
    state: Any = v.call.start(frames[0])
    seconds: dict[Role, float] = {}
    for role in v.roles:
        frame = frames[0] if role == "shaded" else request(role, frames[1], v.call)
        started = clock.perf_counter()
        with inference(v.call, settings.device):
            state = v.call(frame, state)[1]
            if role == "shaded":
                seconds[role] = clock.perf_counter() - started
                state = v.call(frames[1], state)[1]
        wait(frame.time.device)
        seconds.setdefault(role, clock.perf_counter() - started)
    return seconds


def first_calls_elsewhere(name: str, settings: Settings, cache: str) -> dict[Role, float]:
    """`first_calls` in a new process that keeps compiled code in the folder `cache`.

    Raises:
        ValueError: the process failed; says why.
    """
    code = (
        "import json, sys, framecast.bench as b\n"
        "name, settings = json.loads(sys.argv[1])\n"
        "print(json.dumps(b.first_calls(name, b.Settings(**settings))))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, json_format.dumps([name, asdict(settings)])],
        env={**os.environ, "TORCHINDUCTOR_CACHE_DIR": cache, "OMP_NUM_THREADS": str(torch.get_num_threads())},
        capture_output=True,
        text=True,
    )
    if done.returncode:
        raise ValueError(f"{name} cannot be compiled here: {reason(done.stderr)}")
    return json_format.loads(done.stdout.splitlines()[-1])


def reason(printed: str) -> str:
    """The line of a traceback that names the error: torch adds advice to it, and a C++ compiler its warnings."""
    lines = [line.strip() for line in printed.splitlines() if line.strip()] or ["it said nothing"]
    named = [line for line in lines if re.match(r"[\w.]+(Error|Exception|Unsupported)\b", line)]
    return (named or lines)[-1]


# The command.


def stage_lines(rows: Sequence[Row]) -> list[str]:
    """What each row's milliseconds consist of, a line a row: its stages, each with its own time."""
    return [
        f"{row.method} {row.role} {'compiled' if row.compiled else 'eager'}: "
        + ", ".join(f"{name} {spent:.1f}" for name, spent in row.stages.items() if name != "rest")
        for row in rows
        if len(row.stages) > 1
    ]


def table(rows: Sequence[Row], baseline: str) -> Table:
    """The rows to print."""
    made = Table(caption=f"milliseconds; ratio to eager {baseline}; MB that it adds; compile seconds cold / warm")
    for column in ("method", "role", "", "median", "quartiles", "ratio", "MB", "compile", "recompiled"):
        made.add_column(column, justify="left" if column in ("method", "role", "") else "right", overflow="fold")
    for row in rows:
        built = "" if row.compile_cold is None else f"{row.compile_cold:.1f} / {row.compile_warm:.1f}"
        made.add_row(
            row.method,
            row.role,
            "compiled" if row.compiled else "eager",
            f"{row.median:.2f}",
            f"{row.lower:.2f} - {row.upper:.2f}",
            "" if row.ratio is None else f"{row.ratio:.2f}",
            f"{row.memory:.0f}",
            built,
            str(row.recompilations) if row.compiled else "",
        )
    return made


def command(
    methods: Positional[tuple[str, ...]],
    size: str = "1280x720",
    scale: float | None = None,
    baseline: str | None = None,
    repeats: int = 20,
    threads: int | None = None,
    device: str = "cpu",
    compile: bool = True,
    model: bool = False,
    json: Path | None = None,
    profile: Path | None = None,
) -> None:
    """Measure time and memory of methods, per role and stage, eager and compiled; or count what their networks compute.

    Args:
        methods: names of methods.
        size: width x height of the frames, in pixels.
        scale: size of the images divided by that of the frames; by default each method's own.
        baseline: method that the others are compared with; by default blend, or bilinear with a scale above 1.
        repeats: times that every role is timed.
        threads: CPU threads; by default as many as PyTorch takes.
        device: cpu, cuda, mps.
        compile: measure compiled methods too, and how long compilation takes.
        model: print parameters and multiply-accumulates instead, also of networks that are only trained.
        json: file for the rows.
        profile: file for a trace of one call of everything measured, which ui.perfetto.dev opens.
    """
    width, height = _size(size)
    baseline = baseline or ("blend" if scale in (None, 1.0) else "bilinear")
    if not methods:
        raise ValueError(f"name at least one method to measure: {', '.join(METHODS)}")
    if repeats < 1:
        raise ValueError(f"--repeats is {repeats}; it has to be a whole number, at least 1")
    if threads is not None:
        torch.set_num_threads(threads)
    if model:
        Console().print(cost.table([cost.cost(name) for name in methods], width, height))
        return
    rows = bench(methods, baseline, Settings(height, width, repeats, device, compile, scale), profile)
    described = machine(device)
    console = Console()
    console.print(", ".join(f"{k} {v}" for k, v in described.items()), f"{width}x{height}", highlight=False)
    console.print(table(rows, baseline))
    for line in stage_lines(rows):
        console.print(line, highlight=False)
    if profile:
        console.print(f"{profile}: a trace of one call of each; open it at ui.perfetto.dev", highlight=False)
    if json:
        with exr.whole(json) as temporary:
            found = [
                {**asdict(row), "width": width, "height": height, "scale": scale, "device": device} for row in rows
            ]
            content = {"version": VERSION, "machine": described, "baseline": baseline, "rows": found}
            temporary.write_text(json_format.dumps(content, indent=1) + "\n")
        console.print(f"{', '.join(methods)} -> {json} ({len(rows)} rows)", highlight=False, soft_wrap=True)


def _size(text: str) -> tuple[int, int]:
    parts = text.lower().split("x")
    if len(parts) != 2 or not all(part.isdigit() and int(part) > 0 for part in parts):
        raise ValueError(f"--size is {text!r}; give width x height in pixels, such as 1280x720")
    return int(parts[0]), int(parts[1])
