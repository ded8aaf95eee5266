"""A clip in the layouts that others train on: `framecast export-clip CLIP --to extranet -o OUT`.

What each layout is, is told where it is written; `docs/importers.md` has the table. Nothing is resampled but what a
layout asks for, and what it cannot hold is said.
"""

import shutil
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from framecast.clip import Clip, ClipError
from framecast.export_clip import layouts, noisebase, warped
from framecast.frame import Frame
from framecast.importers import open_any

__all__ = ["TARGETS", "Target", "command", "export"]

Progress = Callable[[Sequence[int]], Iterable[int]]
Name = Literal["extranet", "extranet-npz", "stssnet", "mobfgsr", "arm-nss", "noisebase"]


@dataclass(frozen=True)
class Target:
    """One layout."""

    write: Callable[[Clip, Path, Progress], str]
    """Writes all files into a folder and says what a user should know."""
    needs: tuple[str, ...]
    """Fields of `Frame` that it cannot do without."""
    scale: float | None = None
    """Size of the references over the size of the frames that it asks for; 0: any; None: no references."""


CAMERA = ("view", "projection")
BUFFERS = ("color", "depth", "motion", "albedo", "normal", "roughness", "metallic", "object")

TARGETS: dict[str, Target] = {
    "extranet": Target(layouts.extranet, (*BUFFERS, *CAMERA)),
    "extranet-npz": Target(warped.extranet, (*BUFFERS, *CAMERA)),
    "stssnet": Target(warped.stssnet, (*BUFFERS, *CAMERA), scale=2),
    "mobfgsr": Target(layouts.mobfgsr, ("color", "depth", "motion")),
    "arm-nss": Target(layouts.arm, ("color", "depth", "motion", *CAMERA), scale=0),
    "noisebase": Target(noisebase.noisebase, ("color", "depth", "motion", "albedo", "normal", *CAMERA)),
}


def export(clip: Clip, out: Path | str, to: str, *, progress: Progress = iter) -> str:
    """Write a clip in another layout; `out` appears when it is complete. Returns what a user should know of it.

    Raises:
        ClipError: `out` exists, the clip lacks what the layout needs, or a frame cannot be used.
    """
    if to not in TARGETS:
        raise ClipError(f"{to} is not known; export to {', '.join(TARGETS)}")
    target, out = TARGETS[to], Path(out)
    if out.exists() and not (out.is_dir() and not any(out.iterdir())):
        raise ClipError(f"{out} exists already; give another name, or remove it to export again")
    _refuse(clip, to, target, clip[0])
    part = out.resolve().with_name(f".{out.resolve().name}.part")
    shutil.rmtree(part, ignore_errors=True)
    try:
        part.mkdir(parents=True)
        said = target.write(clip, part, progress)
        if out.exists():
            out.rmdir()
        part.rename(out.resolve())
    except OSError as error:
        raise ClipError(f"cannot write {out}: {error.strerror or error}; choose another folder") from error
    finally:
        shutil.rmtree(part, ignore_errors=True)
    return said


def _refuse(clip: Clip, to: str, target: Target, frame: Frame) -> None:
    if lack := [name for name in target.needs if getattr(frame, name) is None]:
        raise ClipError(
            f"{clip.path} has no {', '.join(lack)}; {to} needs {', '.join(target.needs)}: render or import those too"
        )
    if target.scale is not None and clip.scale is None:
        raise ClipError(f"{clip.path} has no reference images; {to} needs them: render with --scale and references")
    if target.scale and clip.scale != target.scale:
        raise ClipError(
            f"{clip.path} has references of {clip.scale:g} times the size; {to} needs {target.scale:g} times"
        )


def command(
    clip: Positional[Path], to: Annotated[Name, arg()], out: Annotated[Path, arg(aliases=["-o"])], repair: bool = False
) -> None:
    """Write a clip in the layout that another project trains on.

    Args:
        clip: a clip, or a folder that can be imported.
        to: whose layout.
        out: folder; it appears when it is complete.
        repair: replace NaN and infinite pixels.
    """
    opened = open_any(clip, repair=repair)
    said = export(opened, out, to)
    print(f"{out}: {len(opened)} frames in the layout of {to}; {said}")
