"""Mob-FGSR: 8-bit PNGs in folders `view`, `depth`, `motion_vectors_x`, `motion_vectors_y`, numbers packed in base 255.

Vectors are (v + 1) / 2 in parts of the image, current minus previous, y up. Depth is 0..1 without a unit. With both
sizes in one folder the larger one, `HR_Inputs`, is read. Its successor mob-ss stores `540p_color` and
`540p_motion_vector`, two digits an axis, and depth in 8 bits, which is left out.
"""

from framecast.importers.folder import Found, Listing
from framecast.importers.settings import Color, Depth, Motion, Settings

LOOKS = "PNGs in folders named view, depth, motion_vectors_x and motion_vectors_y"

RGBA = ("R", "G", "B", "A")
RGB = ("R", "G", "B")


def settings_of(root: str = "") -> Settings:
    """Settings of Mob-FGSR's files in the folder `root` (empty, or with a slash at the end)."""
    vectors = tuple(f"{root}motion_vectors_{axis}/{{frame}}.png" for axis in "xy")
    return Settings(
        source="mobfgsr",
        color=Color(files=(f"{root}view/{{frame}}.png",), channels=RGB, encoding="srgb"),
        depth=Depth(files=(f"{root}depth/{{frame}}.png",), channels=RGBA, packing="base255", far=1.0),
        motion=Motion(
            files=vectors,
            channels=RGBA,
            packing="base255",
            units="uv",
            bias=(0.5, 0.5),
            scale=(2.0, 2.0),
            direction="previous->current",
            sign=(1.0, -1.0),
        ),
        notes=("colour has 8 bits; depth is 0..1 without a unit",),
    )


def _successor(root: str) -> Settings:
    return Settings(
        source="mobfgsr",
        color=Color(files=(f"{root}540p_color/{{frame}}.png",), channels=RGB, encoding="srgb"),
        motion=Motion(
            files=(f"{root}540p_motion_vector/{{frame}}.png",),
            channels=RGBA,
            packing="base255",
            units="ndc",
            bias=(0.5, 0.5),
            scale=(4.0, 4.0),
            direction="previous->current",
            sign=(1.0, -1.0),
        ),
        notes=("depth has 8 bits, too coarse to use, and was left out",),
    )


def recognise(listing: Listing) -> Found | None:
    """What the folder holds if it is laid out like Mob-FGSR's data, else None."""
    held = listing.patterns()
    for mark, settings in (
        ("motion_vectors_x/{frame}.png", settings_of),
        ("540p_motion_vector/{frame}.png", _successor),
    ):
        roots = sorted(pattern.removesuffix(mark) for pattern in held if pattern.endswith(mark))
        if roots:
            return Found(settings(next((root for root in roots if root.endswith("HR_Inputs/")), roots[0])))
    return None
