"""Time and memory of methods: every role, eager and compiled, in one process, on a scene made for the purpose.

The calls are those of `runtime.stream`. All variants are run in turn, over and over, so that what else the machine
does meets all of them alike; a ratio between two of them is worth more than their milliseconds.
"""

import json as json_format
import os
import platform
import statistics
import subprocess
import sys
import tempfile
import time as clock
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import torch
from jaxtyping import Float
from rich.console import Console
from rich.table import Table
from torch import Tensor
from torch._dynamo.utils import counters
from tyro.conf import Positional

from framecast import cost, exr
from framecast.fit import Method, method_named
from framecast.frame import Frame, moment, perspective, pixel_grid, unshaded
from framecast.runtime import can_compile, compiled, inference, placed

VERSION = 1
"""Of the results file."""

Role = Literal["shaded", "interpolate", "extrapolate"]

GAP = 2.0
"""Time between shaded frames: every second one of the clip is generated."""

SHADED = 5
"""Shaded frames of the clip that runs before anything is timed."""

# The scene.


@dataclass(frozen=True)
class Disc:
    """A disc that faces the camera and moves across with constant acceleration; lengths in scene units."""

    depth: float
    x: float = 0.0
    y: float = 0.0
    radius: float = float("inf")
    velocity: float = 0.0
    acceleration: float = 0.0

    def centre(self, time: float) -> tuple[float, float]:
        """Where it is at `time`; it sinks slowly."""
        return self.x + self.velocity * time + self.acceleration * time * time / 2, self.y + 0.3 * self.velocity * time


SCENE = (
    Disc(20.0),  # the wall
    Disc(3.0, -0.9, -0.3, 0.4, 0.10, 0.02),
    Disc(5.0, 1.2, 0.5, 0.7, -0.14, -0.03),
    Disc(8.0, 0.3, -1.4, 1.0, 0.12, 0.05),
    Disc(8.0, -3.0, 1.2, 0.9, 0.20, -0.04),
    Disc(12.0, 3.5, -1.0, 1.5, -0.20, 0.06),
)

FOCAL = 1.2
"""Distance of the image plane in image heights."""


def camera(time: float) -> tuple[float, float]:
    """How far the camera has moved to the right, accelerating, and forward."""
    return 0.06 * time + 0.003 * time * time, 0.04 * time


def scene(time: float, height: int, width: int, *, span: float = GAP) -> Frame:
    """The moment `time` of a moving scene: a textured wall and five discs in front of it, a camera that travels.

    Motion of every surface is exact and differs with depth and speed; silhouettes uncover the wall, and surfaces that
    come nearer spread out, so that warps and splats meet what they meet in rendered frames. Every buffer is there.
    """
    x, y = pixel_grid(height, width)
    focal, (aside, forward) = FOCAL * height, camera(time)
    shape = (1, 1, height, width)
    depth, object_id = torch.full(shape, torch.inf), torch.zeros(shape, dtype=torch.int32)
    color, motion, ahead = (
        torch.zeros(1, 3, height, width),
        torch.zeros(1, 2, height, width),
        torch.zeros(1, 2, height, width),
    )
    for i, disc in enumerate(SCENE):
        z, centre = disc.depth - forward, disc.centre(time)
        u = (x - width / 2) * z / focal + aside - centre[0]
        v = (y - height / 2) * z / focal - centre[1]
        hit = (u * u + v * v < disc.radius**2) & (z < depth)
        depth, object_id = torch.where(hit, z, depth), torch.where(hit, i, object_id)
        color = torch.where(hit, _texture(u / disc.depth, v / disc.depth, i), color)
        here = torch.stack((x, y))
        motion = torch.where(hit, _projected(disc, u, v, time - span, width) - here, motion)
        ahead = torch.where(hit, _projected(disc, u, v, time + span, width) - here, ahead)
    return Frame(
        color=color,
        depth=depth,
        motion=motion,
        motion_next=ahead,
        albedo=color.clamp(0.05, 1),
        normal=torch.tensor([0.0, 0.0, 1.0]).view(1, 3, 1, 1).expand(1, 3, height, width).contiguous(),
        roughness=(0.2 + 0.1 * object_id).clamp(max=1),
        metallic=(object_id == 2).float(),
        object=object_id,
        jitter=torch.zeros(1, 2),
        view=torch.tensor([[1.0, 0, 0, -aside], [0, 1, 0, 0], [0, 0, 1, forward], [0, 0, 0, 1]])[None],
        projection=perspective(2 * float(torch.tensor(0.5 / FOCAL).atan()), width / height)[None],
        time=torch.tensor([float(time)]),
        reset=torch.tensor([time == 0]),
        span=torch.tensor([float(span)]),
    )


def _projected(disc: Disc, u: Tensor, v: Tensor, time: float, width: int) -> Tensor:
    """Pixel position at `time` of points (u, v) of a disc."""
    height = u.shape[0]
    (aside, forward), centre = camera(time), disc.centre(time)
    scale = FOCAL * height / (disc.depth - forward)
    return torch.stack((width / 2 + (u + centre[0] - aside) * scale, height / 2 + (v + centre[1]) * scale))


def _texture(u: Tensor, v: Tensor, seed: int) -> Float[Tensor, "3 h w"]:
    """Waves, coarse ones of each colour and fine ones of all; 0.02 to 1.2."""
    coarse = torch.tensor([19.0, 27.0, 36.0])[:, None, None]
    waves = 0.25 * torch.sin(u * coarse + seed) * torch.cos(v * coarse) + 0.2 * torch.sin(120 * u) * torch.cos(93 * v)
    return (0.5 + waves) * (1.2 - 0.15 * seed)


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
    peak_memory: float
    """Most memory in use while a clip ran: of the whole process on the CPU (resident), of tensors on a GPU; MB."""
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
    peak_memory: float = 0.0


def bench(methods: Sequence[str], baseline: str, settings: Settings = Settings()) -> list[Row]:
    """Rows of every method, by name; the baseline is measured too.

    Raises:
        ValueError: an unknown method, or one that needs what cannot be compiled here.
    """
    names = tuple(dict.fromkeys((baseline, *methods)))
    made = {name: method_named(name) for name in names}
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
    seen: set[Role] = set()
    for _ in range(2):
        v.state = v.call.start(frames[0])
        reset_peak_memory(settings.device)
        for i, frame in enumerate(frames):
            for role in v.roles if i else v.roles[:1]:
                before = graphs()
                with inference(v.call, settings.device):
                    image, state = v.call(frame if role == "shaded" else request(role, frame, v.call), v.state)
                v.state = state
                v.recompilations += graphs() - before if role in seen else 0
                seen.add(role)
                del image, state
    v.peak_memory = peak_memory(settings.device)
    return v


def graphs() -> int:
    """How many graphs were compiled in this process so far."""
    return counters["stats"]["unique_graphs"]


def timed(
    variants: Sequence[Variant], frames: Sequence[Frame], settings: Settings
) -> dict[tuple[int, Role], list[float]]:
    """Milliseconds of every role of every variant (by its position), all of them in turn, from their states."""
    found: dict[tuple[int, Role], list[float]] = {(i, role): [] for i, v in enumerate(variants) for role in v.roles}
    after = scene(GAP * SHADED, settings.height, settings.width).to(settings.device)
    for _ in range(settings.repeats):
        for i, role in found:
            v = variants[i]
            frame = after if role == "shaded" else request(role, frames[-1], v.call)
            found[i, role].append(_milliseconds(v, frame))
    return found


def _milliseconds(v: Variant, frame: Frame) -> float:
    _wait(frame.time.device)
    started = clock.perf_counter()
    with inference(v.call, frame.time.device):
        v.call(frame, v.state)
    _wait(frame.time.device)
    return (clock.perf_counter() - started) * 1e3


def _wait(device: torch.device) -> None:
    if device.type != "cpu":
        getattr(torch, device.type).synchronize()


def _quartiles(values: Sequence[float]) -> list[float]:
    return statistics.quantiles(values, n=4, method="inclusive") if len(values) > 1 else [values[0]] * 3


def reset_peak_memory(device: str) -> None:
    """`peak_memory` starts anew; where the system cannot do that it counts from the start of the process."""
    if device.startswith("cuda"):
        torch.cuda.reset_peak_memory_stats(device)
    elif Path("/proc/self/clear_refs").exists():
        Path("/proc/self/clear_refs").write_text("5")  # see proc(5): resets VmHWM


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
    v = variant(name, method_named(name), True, settings)
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
        _wait(frame.time.device)
        seconds.setdefault(role, clock.perf_counter() - started)
    return seconds


def first_calls_elsewhere(name: str, settings: Settings, cache: str) -> dict[Role, float]:
    """`first_calls` in a new process that keeps compiled code in the folder `cache`.

    Raises:
        ValueError: the process failed; the last line of what it printed says why.
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
        raise ValueError(f"{name} cannot be compiled here: {done.stderr.strip().splitlines()[-1]}")
    return json_format.loads(done.stdout.splitlines()[-1])


# The command.


def machine(device: str = "cpu") -> dict[str, str | int | float]:
    """What the numbers depend on besides the code."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    described: dict[str, str | int | float] = {
        "cpu": names[0] if names else platform.processor() or platform.machine(),
        "cores": os.cpu_count() or 1,
        "threads": torch.get_num_threads(),
        "instructions": torch.backends.cpu.get_cpu_capability(),
        "torch": torch.__version__,
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.machine()}",
    }
    if hasattr(os, "getloadavg"):
        described["load"] = round(os.getloadavg()[0], 1)
    if device.startswith("cuda"):
        described["gpu"] = torch.cuda.get_device_name(device)
    return described


def table(rows: Sequence[Row], baseline: str) -> Table:
    """The rows to print."""
    made = Table(caption=f"milliseconds; ratio to eager {baseline}; compile seconds cold / warm")
    for column in ("method", "role", "", "median", "quartiles", "ratio", "MB", "compile", "recompiled"):
        made.add_column(column, justify="left" if column in ("method", "role", "") else "right")
    for row in rows:
        built = "" if row.compile_cold is None else f"{row.compile_cold:.1f} / {row.compile_warm:.1f}"
        made.add_row(
            row.method,
            row.role,
            "compiled" if row.compiled else "eager",
            f"{row.median:.2f}",
            f"{row.lower:.2f} - {row.upper:.2f}",
            "" if row.ratio is None else f"{row.ratio:.2f}",
            f"{row.peak_memory:.0f}",
            built,
            str(row.recompilations) if row.compiled else "",
        )
    return made


def command(
    methods: Positional[tuple[str, ...]],
    size: str = "1280x720",
    baseline: str = "blend",
    repeats: int = 20,
    threads: int | None = None,
    device: str = "cpu",
    compile: bool = True,
    model: bool = False,
    json: Path | None = None,
) -> None:
    """Measure time and memory of methods, per role, eager and compiled; or count what their networks compute.

    Args:
        methods: names of methods.
        size: width x height of the frames, in pixels.
        baseline: method that the others are compared with.
        repeats: times that every role is timed.
        threads: CPU threads; by default as many as PyTorch takes.
        device: cpu, cuda, mps.
        compile: measure compiled methods too, and how long compilation takes.
        model: print parameters and multiply-accumulates instead, also of networks that are only trained.
        json: file for the rows.
    """
    width, height = _size(size)
    if repeats < 1:
        raise ValueError(f"--repeats is {repeats}; it has to be a whole number, at least 1")
    if threads is not None:
        torch.set_num_threads(threads)
    if model:
        Console().print(cost.table([cost.cost(name) for name in methods], width, height))
        return
    rows = bench(methods, baseline, Settings(height, width, repeats, device, compile))
    described = machine(device)
    console = Console()
    console.print(", ".join(f"{k} {v}" for k, v in described.items()), f"{width}x{height}", highlight=False)
    console.print(table(rows, baseline))
    if json:
        with exr.whole(json) as temporary:
            found = [{**asdict(row), "width": width, "height": height, "device": device} for row in rows]
            content = {"version": VERSION, "machine": described, "baseline": baseline, "rows": found}
            temporary.write_text(json_format.dumps(content, indent=1) + "\n")
        console.print(f"{', '.join(methods)} -> {json} ({len(rows)} rows)", highlight=False, soft_wrap=True)


def _size(text: str) -> tuple[int, int]:
    parts = text.lower().split("x")
    if len(parts) != 2 or not all(part.isdigit() and int(part) > 0 for part in parts):
        raise ValueError(f"--size is {text!r}; give width x height in pixels, such as 1280x720")
    return int(parts[0]), int(parts[1])
