"""Commands that put several parts of the package together: upsample, import, check."""

import sys
import warnings
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from tyro.conf import Positional, arg

from framecast.clip import Clip, check, mended
from framecast.fit import method_named
from framecast.importers import describe, open_any, repairs, save
from framecast.methods import METHODS
from framecast.methods.larger import Unjittered
from framecast.runtime import Mode
from framecast.upsample import Debug, Format, Job
from framecast.upsample import upsample as run_upsample

Out = Annotated[Path, arg(aliases=["-o"])]


def progress(title: str) -> Progress:
    """A bar with count, rate and time left, gone when done."""
    rate = TextColumn("{task.fields[rate]}")
    columns = (TextColumn(title), BarColumn(), MofNCompleteColumn(), rate, TimeElapsedColumn(), TimeRemainingColumn())
    return Progress(*columns, console=Console(stderr=True), transient=True, disable=not sys.stderr.isatty())


def bar(title: str) -> Callable[[Iterable[int], int], Iterable[int]]:
    """Wraps indices so that going through them moves a progress bar."""

    def through(indices: Iterable[int], total: int) -> Iterable[int]:
        with progress(title) as shown:
            task = shown.add_task(title, total=total, rate="")
            for index in indices:
                yield index
                speed = shown.tasks[0].speed
                shown.update(task, advance=1, rate=f"{speed:.1f} images/s" if speed else "")

    return through


def upsample(
    clip: Positional[Path],
    out: Out,
    method: str = "mobfgsr",
    scale: float | None = None,
    fps: int | None = None,
    mode: Mode | None = None,
    format: Format | None = None,
    jitter: Literal["zero"] | None = None,
    repair: bool = False,
    overwrite: bool = False,
    device: str = "cpu",
    compile: bool = False,
    debug: Debug | None = None,
) -> None:
    """Raise the size and the frame rate of a clip or of a folder of rendered EXR files.

    Interrupted and started again, it goes on where it was. The last line says what was made.

    Args:
        clip: a clip, or a Blender shot (see `framecast import`).
        out: folder for the images, or a name that ends in .mp4 for a film.
        method: how images are made; `framecast evaluate` compares them.
        scale: size of the images divided by that of the frames; by default 1, or 2 with methods that only enlarge.
        fps: images out for each frame in; by default 2, or 1 with methods that make no frames.
        mode: interpolate waits for the next frame; extrapolate does not; mixed does half of each; pass makes no frames.
        format: exr (linear, half float), png (8 bits, as displayed) or mp4; by default exr, or mp4 by the name.
        jitter: zero takes all frames as sampled at the centres of their pixels, whatever the clip says, and is content.
        repair: replace NaN and infinite pixels of the input, and say how many.
        overwrite: remove what is at OUT first.
        device: cpu, cuda, mps.
        compile: compile the method: some minutes, at worst, once for each size; then it is up to five times as fast.
        debug: labels writes beside each image, as a picture, how the method classified its pixels.
    """
    mode = mode or first_mode(method, fps)
    rate = 1 if mode == "pass" else 2 if fps is None else fps
    job = Job(method, rate, mode, format or ("mp4" if out.suffix == ".mp4" else "exr"), scale)
    opened, replaced = mended(open_any(clip)) if repair else (open_any(clip), {})
    if jitter == "zero":
        opened = replace(opened, records=tuple(replace(record, jitter=(0.0, 0.0)) for record in opened.records))
        warnings.simplefilter("ignore", Unjittered)
    made = run_upsample(
        opened,
        out,
        job,
        device=device,
        compile=compile,
        overwrite=overwrite,
        debug=debug,
        progress=bar(f"upsample ({method})"),
    )
    height, width = made.size
    again = f", {made.skipped} of them were there" if made.skipped else ""
    bad = f"; {sum(replaced.values())} NaN or infinite values of the input replaced" if repair else ""
    speed = f"; {made.milliseconds:.0f} ms for a generated image" if made.milliseconds else ""
    print(
        f"{made.out}: {made.frames} images ({made.shaded} shaded, {made.frames - made.shaded} generated{again}), "
        f"{width}x{height}, {made.fps:g} frames a second; {method}, {mode}, "
        f"adds {made.latency_ms:.1f} ms of latency{speed}{bad}"
    )


def first_mode(method: str, fps: int | None) -> Mode:
    """How frames are made where nobody says: none at one image for each frame, else interpolated where possible.

    Raises:
        ValueError: more images are asked for, and the method makes none.
    """
    modes: tuple[Mode, ...] = method_named(method).modes
    if fps is not None and fps > 1 and modes == ("pass",):
        raise ValueError(
            f"{method} makes no frames, and --fps {fps} asks for {fps} images for each; leave --fps out, or use "
            f"--method {method}+mobfgsr"
        )
    return "pass" if fps == 1 else modes[0]


def import_shot(
    shot: Positional[Path],
    out: Out,
    source: Annotated[str | None, arg(name="from")] = None,
    settings: Path | None = None,
    fps: float | None = None,
    repair: bool = False,
    full: bool = False,
) -> None:
    """Turn a folder of rendered files into a clip, and say what it allows.

    Args:
        shot: folder of one shot, of a source that is known (docs/importers.md) or with a settings file.
        out: folder of the clip; it appears when it is complete.
        source: blender, unreal, unity, extranet, stssnet, mobfgsr, mitsuba, arm-nss or generic; found out by default.
        settings: what the files mean, as framecast doctor writes it; by default framecast-import.json in SHOT.
        fps: frames a second, where the files do not tell.
        repair: replace NaN and infinite pixels, and say how many.
        full: keep 32 bits of colour, albedo and normal in place of half floats.
    """
    clip = open_any(shot, fps=fps, source=source, settings=settings)
    print(describe(clip, {name: wanted(name) for name in METHODS}))
    saved = save(clip, out, repair=repair, full=full, progress=lambda indices: bar("import")(indices, len(indices)))
    mended = f", {repairs(saved)} NaN or infinite values replaced" if repair else ""
    print(f"{out}: {len(saved)} frames written{mended}")


def wanted(name: str) -> tuple[str, ...]:
    """Every field that a method reads, of shaded frames and of those that it makes."""
    method = method_named(name)
    return tuple(dict.fromkeys((*method.needs, *method.needs_generated)))


def check_clip(clip: Positional[Path]) -> None:
    """Read every frame of a clip and say what is wrong with it.

    Args:
        clip: a clip, or a Blender shot.
    """
    opened: Clip = open_any(clip)
    complaints = check(opened)
    if complaints:
        raise ValueError("\n".join(complaints))
    print(f"{clip}: {len(opened)} frames, nothing wrong")
