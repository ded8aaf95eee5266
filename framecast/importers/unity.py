"""Unity: the AOV Recorder of HDRP, one multi-part EXR a frame or one sequence an AOV.

Motion is a fraction of the output size, depth is white at the near plane, smoothness is 1 - roughness. The manual does
not say where vectors point, so the reading that fits the pictures is taken.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from typing import Any

from framecast.importers.folder import Found, Listing
from framecast.importers.passes import Pass, find, passes
from framecast.importers.settings import NAME, Color, Depth, Motion, Normal, Scalar, Settings

LOOKS = "AOVs named Beauty and MotionVectors (also Depth, Normal, Albedo, Smoothness, Metal)"

PLANES = (0.3, 1000.0)
"""Near and far plane of a new Unity camera."""


def recognise(listing: Listing) -> Found | None:
    """What the folder holds if Unity's recorder wrote it, else None."""
    held = passes(listing)
    color = find(held, ("beauty",), ("RGB",))
    motion = find(held, ("motionvectors", "motionvector", "motion"), ("RG", "XY"))
    if color is None or motion is None:
        return None
    readings = _readings(*motion)
    settings = Settings(
        source="unity",
        axes="unity",
        color=Color(**color[0].layer("RGB")),
        motion=readings[0],
        **_depth(held),
        **_materials(held),
        notes=(
            f"depth was read as reversed, with the planes of a new camera, {PLANES[0]:g} and {PLANES[1]:g}; "
            f"write those of yours into a {NAME}",
        )
        if _depth(held)
        else (),
    )
    return Found(settings, readings=readings[1:])


def _readings(motion: Pass, letters: str) -> list[Motion]:
    """Current minus previous as in the engine's own texture, y up or down, and the other way round."""
    first = Motion(**motion.layer(letters), units="uv", direction="previous->current", sign=(1.0, -1.0))
    others = [(x, y) for x, y in product((1.0, -1.0), repeat=2) if (x, y) != first.sign]
    return [first, *(replace(first, sign=sign) for sign in others)]


def _depth(held: Sequence[Pass]) -> dict[str, Any]:
    depth = find(held, ("depth",), ("R", "Z", "Y"))
    if depth is None:
        return {}
    return {"depth": Depth(**depth[0].layer(depth[1]), kind="reversed", near=PLANES[0], far=PLANES[1])}


def _materials(held: Sequence[Pass]) -> dict[str, Any]:
    out: dict[str, Any] = {}
    if albedo := find(held, ("albedo",), ("RGB",)):
        out["albedo"] = Color(**albedo[0].layer("RGB"))
    if normal := find(held, ("normals", "normal"), ("RGB", "XYZ")):
        out["normal"] = Normal(**normal[0].layer(normal[1]))
    if smooth := find(held, ("smoothness",), ("R", "Y")):
        out["roughness"] = Scalar(**smooth[0].layer(smooth[1]), bias=1.0, scale=-1.0)
    if metal := find(held, ("metal", "metallic"), ("R", "Y")):
        out["metallic"] = Scalar(**metal[0].layer(metal[1]))
    return out
