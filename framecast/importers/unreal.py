"""Unreal Engine: EXR files of the Movie Render Queue, and raw dumps of its render targets.

Movie Render Queue: passes `...MovieRenderQueue_MotionVectors` (codes, 0.5 stands still) and `..._WorldDepth` (linear,
in centimetres), in one file or one file a pass; position, rotation and field of view from the headers. Epic does not
write down sign and scale of the codes, and descriptions disagree: the reading that fits the pictures is taken.

Raw dumps: files named like the targets: SceneColor, SceneDepthZ, Velocity, GBufferA (normal), GBufferB (metallic in R,
roughness in B), GBufferC (base colour). Velocity is current minus previous, y up, stored as v * 0.2495 + 32767 / 65535,
of which newer versions store the square root; 0 means that nothing was written. Cameras, with positions in
centimetres, may lie beside them in `cameras.json`. Distances become metres.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

from framecast.importers import images
from framecast.importers.cameras import Pose, pose
from framecast.importers.folder import Found, Listing
from framecast.importers.passes import Pass, find, passes
from framecast.importers.settings import Cameras, Color, Depth, Motion, Normal, Scalar, Settings

LOOKS = "passes named MovieRenderQueue_MotionVectors or _WorldDepth, or files named SceneColor and Velocity"

SPAN = 0.2495
"""What one unit of velocity is worth in the codes of the velocity target."""

MIDDLE = 32767 / 65535
"""The code of no motion."""

METRES = 0.01
"""Unreal's unit. Distances become metres, since those from 655 metres on would not fit into a half float."""

NEAR = 0.1
"""Unreal's default near plane, 10 centimetres."""

CAMERAS = "cameras.json"

POSES = {
    "position": ("curPos/x", "curPos/y", "curPos/z"),
    "rotation": ("curRot/pitch", "curRot/yaw", "curRot/roll"),
}


def recognise(listing: Listing) -> Found | None:
    """What the folder holds if Unreal wrote it, else None."""
    held = passes(listing)
    return _movie(listing, held) or _targets(listing, held)


def _movie(listing: Listing, held: Sequence[Pass]) -> Found | None:
    ours = [p for p in held if "movierenderqueue" in p.label]
    motion = _containing(ours, "movierenderqueuemotionvectors", "RG")
    depth = _containing(ours, "movierenderqueueworlddepth", "R")
    if motion is None and depth is None:
        return None
    color = find([p for p in held if p not in ours], ("finalimage", "beauty", ""), ("RGB",))
    readings = [] if motion is None else _readings(motion)
    settings = Settings(
        source="unreal",
        axes="unreal",
        color=Color(**color[0].layer("RGB")) if color else None,
        depth=Depth(**depth.layer("R"), scale=METRES) if depth else None,
        motion=readings[0] if readings else None,
        **_materials(held),
    )
    size = (color[0] if color else held[0]).about.size
    return Found(settings, _header_poses(listing, (depth or motion or held[0]).pattern, size), readings[1:])


def _containing(held: Sequence[Pass], word: str, letters: str) -> Pass | None:
    """A camera's name may follow the name of the pass."""
    return next((p for p in held if word in p.label and set(letters) <= set(p.letters)), None)


def _readings(motion: Pass) -> list[Motion]:
    """Every sign and both scales; the one that compositors describe first."""
    first = Motion(
        **motion.layer("RG"),
        units="uv",
        direction="previous->current",
        bias=(0.5, 0.5),
        scale=(2.0, 2.0),
        sign=(-1.0, 1.0),
    )
    others = product((2.0, 1.0), ((-1.0, 1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, -1.0)))
    return [replace(first, scale=(scale, scale), sign=sign) for scale, sign in others]


def _materials(held: Sequence[Pass]) -> dict[str, Any]:
    """Passes that users add as post-process materials, by the names that they are commonly given."""
    out: dict[str, Any] = {}
    if albedo := find(held, ("basecolor", "diffusecolor", "albedo"), ("RGB",)):
        out["albedo"] = Color(**albedo[0].layer("RGB"))
    if normal := find(held, ("worldnormal",), ("RGB", "XYZ")):
        out["normal"] = Normal(**normal[0].layer(normal[1]))
    for name in ("roughness", "metallic"):
        if scalar := find(held, (name,), ("R", "Y")):
            out[name] = Scalar(**scalar[0].layer(scalar[1]))
    return out


def _header_poses(listing: Listing, pattern: str, size: tuple[int, int]) -> dict[int, Pose]:
    """Cameras that the queue writes into every header."""
    found = {}
    for number, name in listing.numbered(pattern).items():
        row = _row(images.about(listing.folder / Path(name)).text)
        if row is None:
            return {}
        found[number] = pose(row, "unreal", size, METRES)
    return found


def _row(text: Mapping[str, str]) -> dict[str, Any] | None:
    """Position, rotation and lens in the text attributes of one file, or None."""
    for root in ("unreal/camera", "unreal/layerData/rgba"):
        try:
            row: dict[str, Any] = {k: [float(text[f"{root}/{v}"]) for v in keys] for k, keys in POSES.items()}
        except (KeyError, ValueError):
            continue
        lens = next((v for k, v in text.items() if k.startswith(root) and k.endswith("/fov")), None)
        return {**row, "fov_x": float(lens)} if lens else row
    return None


def _targets(listing: Listing, held: Sequence[Pass]) -> Found | None:
    velocity = find(held, ("velocity",), ("RG",))
    color = find(held, ("scenecolor", "scenecolordeferred", "scenecolorhdr"), ("RGB",))
    if velocity is None or color is None:
        return None
    depth = find(held, ("scenedepthz", "scenedepth", "depthz"), ("R", "Z", "Y"))
    a, b, c = (find(held, (f"gbuffer{letter}",), ("RGB",)) for letter in "abc")
    plain = Motion(
        **velocity[0].layer("RG"),
        units="ndc",
        direction="previous->current",
        sign=(1.0, -1.0),
        bias=(MIDDLE, MIDDLE),
        scale=(1 / SPAN, 1 / SPAN),
        unwritten=0.0,
    )
    settings = Settings(
        source="unreal",
        axes="unreal",
        color=Color(**color[0].layer("RGB")),
        depth=Depth(**depth[0].layer(depth[1]), kind="reversed", near=NEAR) if depth else None,
        motion=plain,
        albedo=Color(**c[0].layer("RGB")) if c else None,
        normal=Normal(**a[0].layer("RGB"), encoded=True) if a else None,
        metallic=Scalar(**b[0].layer("R")) if b else None,
        roughness=Scalar(**b[0].layer("B")) if b else None,
        cameras=Cameras(file=CAMERAS, scale=METRES) if (listing.folder / CAMERAS).is_file() else None,
        notes=(
            "depth was read as reversed, with Unreal's default near plane of 10 cm",
            "where no velocity was written the camera's motion is taken; without cameras.json that is none",
        ),
    )
    return Found(settings, readings=[replace(plain, packing="unreal_sqrt", scale=(1 / SPAN, 1 / SPAN))])
