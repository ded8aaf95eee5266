"""Many evaluations: one after the other, in several processes, or on the machines of a Ray cluster.

Each clip and method is a task of its own that opens the clip by its path. Rows come in the order of the tasks, and are
the same to the last bit wherever the tasks ran, as every one of them computes with the same number of threads.
"""

import multiprocessing
import signal
import socket
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import torch
from rich.console import Console
from rich.progress import Progress, TimeElapsedColumn
from tyro.conf import Positional

from framecast import __version__
from framecast.clip import Clip
from framecast.evaluate import Settings, evaluate_clip, labels, left, refuse, scale_for, untruthful
from framecast.fit import fitting, method_named
from framecast.importers import open_any
from framecast.metrics import lpips_missing
from framecast.provenance import About, described, machine, source
from framecast.results import Mode, Row, read_provenance, read_results, tables, write_csv, write_results
from framecast.video import video_missing


@dataclass(frozen=True)
class Task:
    """One method on one clip."""

    clip: Path
    label: str
    """Name of the clip in rows."""
    method: str
    mode: Mode
    settings: Settings


def tasks(clips: Sequence[Clip], methods: Sequence[str], mode: Mode, settings: Settings) -> list[Task]:
    """Every method on every clip; raises what `evaluate` does, before anything runs."""
    refuse(clips, methods, mode, settings)
    return [
        Task(clip.path.resolve(), label, name, mode, settings)
        for label, clip in zip(labels(clips), clips, strict=True)
        for name in dict.fromkeys(methods)
    ]


def perform(task: Task) -> list[Row]:
    """The rows of a task, in this process."""
    if task.settings.threads is not None:
        torch.set_num_threads(task.settings.threads)
    return evaluate_clip(open_any(task.clip), task.label, task.method, task.mode, task.settings)


def spread(wanted: Sequence[Task], workers: int = 1, ray: str | None = None) -> Iterator[tuple[Task, list[Row]]]:
    """Tasks and their rows as they are done: here, in `workers` processes, or on the Ray cluster at an address.

    Raises:
        ValueError: Ray is not installed, or no cluster answers. Also what `evaluate` raises.
    """
    if ray is not None:
        yield from on_cluster(wanted, ray)
    elif workers > 1 and len(wanted) > 1:
        yield from in_processes(wanted, min(workers, len(wanted)))
    else:
        yield from ((task, perform(task)) for task in wanted)


def in_processes(wanted: Sequence[Task], workers: int) -> Iterator[tuple[Task, list[Row]]]:
    """Tasks in new processes of this machine."""
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(workers, context, initializer=_quietly_interrupted)
    try:
        running = {pool.submit(perform, task): task for task in wanted}
        for done in as_completed(running):
            yield running[done], done.result()
    except BrokenProcessPool as error:
        raise ValueError(
            f"one of the {workers} processes was ended from outside, perhaps for want of memory; run the same command "
            f"again with fewer --workers, and it goes on"
        ) from error
    finally:
        pool.shutdown(wait=False, cancel_futures=True)


def _quietly_interrupted() -> None:
    """An interrupted worker ends without a word: the process that started it says what there is to say."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def on_cluster(wanted: Sequence[Task], address: str) -> Iterator[tuple[Task, list[Row]]]:
    """Tasks on a Ray cluster, a core each; `local` starts one here. Every machine has to see the clips at one path."""
    try:
        import ray
    except ImportError as error:
        raise ValueError(
            "--ray needs Ray, which is not installed; install it: pip install 'framecast[cluster]'"
        ) from error
    try:
        joined(ray, address)
        remote = ray.remote(num_cpus=1)(perform)
        running = {remote.remote(task): task for task in wanted}
        while running:
            (done,), _ = ray.wait(list(running), num_returns=1)
            yield running.pop(done), ray.get(done)
    except ray.exceptions.RayTaskError as error:
        raise (error.cause or error) from None
    finally:
        ray.shutdown()


def joined(ray: Any, address: str) -> None:
    """Connects to a cluster, or starts one; raises ValueError where there is none."""
    try:
        require_answer(address)
        ray.init(address=address, include_dashboard=False if address == "local" else None, log_to_driver=False)
    except Exception as error:  # Ray says so in exceptions of no kind of their own
        if address == "local":
            raise ValueError(
                f"Ray could not start a cluster here: {str(error).strip().partition(chr(10))[0]}"
            ) from error
        raise ValueError(f"no Ray cluster answers at {address}; start one with: ray start --head") from error


def require_answer(address: str) -> None:
    """Raises OSError or ValueError where nothing listens at an address with a port: Ray itself would wait for long."""
    if ":" in address:
        host, _, port = address.rpartition("://")[2].rpartition(":")
        socket.create_connection((host, int(port)), timeout=5).close()


# The command.


def command(
    clips: Positional[tuple[Path, ...]],
    methods: str = "",
    mode: Mode = "interpolate",
    scale: float | None = None,
    json: Path | None = None,
    csv: Path | None = None,
    metrics: str = "psnr,ssim,flip,warped,flicker",
    device: str = "cpu",
    compile: bool = False,
    threads: int = 1,
    workers: int = 1,
    ray: str | None = None,
) -> None:
    """Hide every second frame of clips, generate it, and compare with what was hidden; or compare sizes.

    Interrupted and started again with the same --json, it goes on where it was.

    Args:
        clips: clips, or folders of rendered EXR files.
        methods: names separated by commas; by default every one that can run on all of the clips in this mode.
        mode: where generated frames come from; pass hides none and compares each with its reference.
        scale: size of the images divided by that of the frames; with --mode pass by default that of the references.
        json: file for the rows.
        csv: file for the rows as a table.
        metrics: names separated by commas: psnr, ssim, flip, flip-hdr, warped, flicker, lpips, cvvdp.
        device: cpu, cuda, mps.
        compile: compile the methods (their first frames take longer and are not timed).
        threads: CPU threads of each evaluation.
        workers: processes that share the work; times are then of a machine that does other things too.
        ray: address of a Ray cluster that shares the work, or local.
    """
    if min(threads, workers) < 1:
        raise ValueError(f"--threads is {threads} and --workers {workers}; both have to be at least 1")
    opened = [open_any(path) for path in clips]
    settings = Settings(_available(_names(metrics)), device, compile, scale, threads)
    names = _names(methods) or fitting(opened, mode, [scale_for(clip, mode, settings) for clip in opened])
    settings = _remaining(opened, names, mode, settings)
    wanted = tasks(opened, names, mode, settings)
    about = made_from(opened, names, mode, settings) if json else None
    part = json and unfinished(json)
    found = finished(wanted, part, about) if part and about else {}
    with Progress(*Progress.get_default_columns(), TimeElapsedColumn(), transient=True) as progress:
        shown = progress.add_task(f"evaluate ({mode})", total=len(wanted), completed=len(found))
        for task, rows in spread([task for task in wanted if task not in found], workers, ray):
            found[task] = rows
            progress.advance(shown)
            if part:
                write_results(part, ordered(wanted, found), about)
    rows = ordered(wanted, found)
    if json and part:
        write_results(json, rows, about)
        part.unlink(missing_ok=True)
    if csv:
        write_csv(csv, rows)
    console = Console()
    for title, table in tables(rows, console.width).items():
        console.print(f"\n{title}", table, highlight=False)
    made = f"{', '.join(names)} on {', '.join(labels(opened))}, {mode}"
    files = " and ".join(str(path) for path in (json, csv) if path)
    console.print(f"{made} -> {files} ({len(rows)} rows)" if files else made, highlight=False, soft_wrap=True)


def unfinished(json: Path) -> Path:
    """Where the rows are while not all of them are there; a run that goes on takes from it what is still the same."""
    return json.with_name(f".{json.stem}.part{json.suffix}")


def ordered(wanted: Sequence[Task], found: dict[Task, list[Row]]) -> list[Row]:
    """The rows in the order of the tasks."""
    return [row for task in wanted for row in found.get(task, ())]


def finished(wanted: Sequence[Task], part: Path, about: About) -> dict[Task, list[Row]]:
    """The rows of an earlier run that did not end, of tasks whose clip, method and metrics are still the same."""
    try:
        before = read_provenance(part) if part.is_file() else None
    except ValueError:  # cut off, or of another version: nothing in it counts
        before = None
    if before is None:
        return {}
    held: dict[tuple[str, str, Mode], list[Row]] = {}
    for row in read_results(part) if before.settings == about.settings else ():
        held.setdefault((row.method, row.clip, row.mode), []).append(row)
    return {
        task: held[key]
        for task in wanted
        if (key := (task.method, task.label, task.mode)) in held
        and before.clips.get(task.label) == about.clips[task.label]
        and before.methods.get(task.method) == about.methods[task.method]
    }


def made_from(clips: Sequence[Clip], names: Sequence[str], mode: Mode, settings: Settings) -> About:
    """What the rows of an evaluation are made from; reads every file of the clips once."""
    methods = {name: described(method_named(name, scale_for(clips[0], mode, settings))) for name in names}
    sources = {label: source(clip) for label, clip in zip(labels(clips), clips, strict=True)}
    held = {**asdict(settings), "metrics": list(settings.metrics)}
    here = machine(settings.device)
    threads = settings.threads or here["threads"]
    return About(sources, methods, held, {"framecast": __version__, **here, "threads": threads})


def _names(text: str) -> tuple[str, ...]:
    return tuple(dict.fromkeys(name.strip() for name in text.split(",") if name.strip()))


def _available(metrics: tuple[str, ...]) -> tuple[str, ...]:
    """The metrics without those that cannot run on this machine, which is said."""
    for name, sentence in (("lpips", lpips_missing()), ("cvvdp", video_missing())):
        if name in metrics and sentence and len(metrics) > 1:
            print(sentence, file=sys.stderr)
            metrics = tuple(other for other in metrics if other != name)
    return metrics


def _remaining(clips: Sequence[Clip], names: Sequence[str], mode: Mode, settings: Settings) -> Settings:
    """The settings with the metrics that every clip allows, where some remain; which are left out is said."""
    metrics = settings.metrics
    for clip in clips:
        for name in names:
            method = method_named(name, scale_for(clip, mode, settings))
            remaining = left(clip, method, mode, metrics)
            if remaining and remaining != metrics:
                print(f"framecast: {untruthful(clip, method, mode, metrics)}", file=sys.stderr)
                metrics = remaining
    return replace(settings, metrics=metrics)
