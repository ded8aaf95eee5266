"""The command `framecast doctor`."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from framecast.doctor import draw, examine
from framecast.exr import whole
from framecast.importers.cameras import posed
from framecast.importers.settings import NAME, Cameras, write_settings

CAMERAS = "cameras.json"
"""File of the recorded cameras, beside the settings that name it."""

GUESSED = "vectors were read as"
"""Beginning of what importers say when they took the reading that fits three pairs of frames."""

Out = Annotated[Path, arg(aliases=["-o"])]


def command(
    folder: Positional[Path], out: Out = Path("doctor-out"), json_: Annotated[bool, arg(name="json")] = False
) -> int:
    """Find out by experiment what the buffers of a folder mean, and what is wrong with them.

    Looks at any folder of numbered EXR, PNG or array files, clips and Blender shots among them. Says what it found,
    and ends with 0 (healthy), 1 (something to fix, or undecidable) or 2 (not readable).

    Args:
        folder: the folder to examine.
        out: folder for doctor.png (before and after) and framecast-import.json (how to import what was found, with
            cameras.json where cameras are recorded); those of an earlier run are replaced.
        json_: print what was found for machines.
    """
    examined = examine(folder)
    report = examined.report
    picture = draw(examined, out / "doctor.png")
    written = [str(picture)]
    if examined.cameras:
        with whole(out / CAMERAS) as temporary:
            temporary.write_text(json.dumps(posed(examined.cameras, report.settings.axes)), encoding="utf-8")
        written.append(str(out / CAMERAS))
        report = replace(report, settings=replace(report.settings, cameras=Cameras(file=CAMERAS)))
    notes = tuple(n for n in report.settings.notes if not n.startswith(GUESSED))  # they were looked into by now
    written.append(str(write_settings(replace(report.settings, notes=notes), out / NAME)))
    report = replace(report, written=tuple(written))
    print(json.dumps(report.json(), indent=1) if json_ else report.text())
    return int(report.verdict != "healthy")
