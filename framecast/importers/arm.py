"""Arm's Neural Super Sampling data: `0000.json` and `x2/{color,depth,motion}/0000/0000.exr`, one sequence.

Vectors are current to previous in parts of the image, y down. Jitter, exposure, planes and field of view are in the
JSON file; the frame's number is called `Frame` in its specification and `FrameNumber` by its plug-in.
"""

import json
import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from framecast.exr import ClipError
from framecast.importers import images
from framecast.importers.cameras import Pose, pose
from framecast.importers.folder import Found, Listing
from framecast.importers.settings import Color, Depth, Motion, Settings

LOOKS = "0000.json beside x2/color/0000/0000.exr (Arm's neural super sampling data)"

MARK = re.compile(r"(x[\d_.]+/)?color/(\w+/)?\{frame\}\.exr")


def recognise(listing: Listing) -> Found | None:
    """What the folder holds if it is laid out like Arm's data, else None."""
    found = sorted(pattern for pattern in listing.patterns() if MARK.fullmatch(pattern))
    abouts = {pattern: listing.folder / f"{Path(pattern).parent.name}.json" for pattern in found}
    told = {pattern: path for pattern, path in abouts.items() if path.is_file()}
    if not told:
        return None
    if len(told) > 1:
        each = " and ".join(str(Path(pattern).parent) for pattern in told)
        raise ClipError(f"{listing.folder} holds {len(told)} sequences ({each}); put each into a folder of its own")
    ((color, path),) = told.items()
    about = _read(path)
    size = images.about(listing.folder / listing.patterns()[color]).size
    poses = {number: _pose(path, row, size) for number, row in _rows(path, about).items()}
    first = next(iter(_rows(path, about).values()))
    far = float(first.get("CameraFarPlane", -1))
    held = listing.patterns()
    depth, motion = (color.replace("color/", f"{name}/", 1) for name in ("depth", "motion"))
    settings = Settings(
        source="arm-nss",
        fps=float(about["EmulatedFramerate"]) if about.get("EmulatedFramerate") else None,
        color=Color(files=(color,), channels=("R", "G", "B")),
        depth=Depth(
            files=(depth,),
            channels=("R",),
            kind="reversed" if about.get("ReverseZ") else "device",
            near=float(first["CameraNearPlane"]),
            far=far if far > 0 else None,
        )
        if depth in held and "CameraNearPlane" in first
        else None,
        motion=Motion(files=(motion,), channels=("R", "G"), units="uv") if motion in held else None,
        notes=("Jitter was read as sample position minus pixel centre, y down; the format does not say",),
    )
    return Found(settings, poses)


def _read(path: Path) -> dict[str, Any]:
    try:
        about = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(about, dict) or not isinstance(about.get("Frames"), list) or not about["Frames"]:
            raise ValueError("it has no Frames")
        return about
    except (OSError, ValueError, RecursionError) as error:
        raise ClipError(f"{path} cannot be read ({error}); export it again") from error


def _rows(path: Path, about: Mapping[str, Any]) -> dict[int, Mapping[str, Any]]:
    try:
        return {int(row["Frame"] if "Frame" in row else row["FrameNumber"]): row for row in about["Frames"]}
    except (KeyError, TypeError, ValueError) as error:
        raise ClipError(f"{path} has a frame without a number ({error}); export it again") from error


def _pose(path: Path, row: Mapping[str, Any], size: tuple[int, int]) -> Pose:
    """Lens, jitter, cut and exposure. The axes of its matrices are not told, so that there is no view."""
    try:
        jitter = row.get("Jitter")
        return pose(
            {
                "fov": math.degrees(float(row["FovY"])) if "FovY" in row else None,
                "jitter": None if jitter is None else (jitter["X"], jitter["Y"]),
                "cut": bool(row.get("CameraCut", False)),
                "exposure": row.get("Exposure"),
            },
            "opengl",
            size,
        )
    except (KeyError, TypeError, ValueError) as error:
        raise ClipError(f"{path} has a frame that cannot be read ({error}); export it again") from error
