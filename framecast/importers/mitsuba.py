"""Mitsuba 3: EXR files of the `aov` integrator, told by the channel T of its depth.

Depth runs along the ray from the near plane on, 0 where nothing was hit, so that it needs the field of view. There are
no vectors: with cameras in `cameras.json` those of the camera are computed, which is right where nothing moves by
itself.
"""

import re
from collections.abc import Sequence

from framecast.importers.folder import Found, Listing
from framecast.importers.passes import Pass, passes
from framecast.importers.settings import Cameras, Color, Depth, Normal, Settings

LOOKS = "EXR files with the channel T of Mitsuba's depth AOV"

NEAR = 0.01
"""Mitsuba's default near_clip."""

FILE = "cameras.json"


def recognise(listing: Listing) -> Found | None:
    """What the folder holds if Mitsuba wrote it, else None."""
    held = passes(listing)
    depth = next((p for p in held if "T" in p.letters), None)
    if depth is None:
        return None
    beside = [p for p in held if p.pattern == depth.pattern]
    color = next((p for p in beside if {"R", "G", "B"} <= set(p.letters) and not _named(p, "albedo")), None)
    normal = _first(beside, r"normal|nn|sh_?n|geo_?n")
    albedo = _first(beside, "albedo")
    has_cameras = (listing.folder / FILE).is_file()
    settings = Settings(
        source="mitsuba",
        color=Color(**color.layer("RGB")) if color else None,
        depth=Depth(**depth.layer("T"), kind="euclidean", near=NEAR) if has_cameras else None,
        normal=Normal(**normal.layer("XYZ")) if normal and "X" in normal.letters else None,
        albedo=Color(**albedo.layer("RGB")) if albedo and "R" in albedo.letters else None,
        cameras=Cameras(file=FILE, motion=True) if has_cameras else None,
        notes=("vectors hold the camera's motion alone",)
        if has_cameras
        else (f"no depth and no motion: they need the cameras; write {FILE} (see docs/importers.md)",),
    )
    return Found(settings)


def _named(held: Pass, pattern: str) -> bool:
    return re.search(pattern, held.label.partition("/")[2]) is not None


def _first(held: Sequence[Pass], pattern: str) -> Pass | None:
    return next((p for p in held if _named(p, pattern)), None)
