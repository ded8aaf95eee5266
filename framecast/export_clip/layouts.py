"""Layouts that hold a frame's own buffers: ExtraNet's raw EXRs, Mob-FGSR's PNGs, Arm's neural super sampling data."""

import json
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from framecast import exr
from framecast.clip import Clip, Layers, Record
from framecast.frame import BUFFERS, SKY, Frame, facing, world_position
from framecast.importers import extranet as extranet_files
from framecast.importers import images
from framecast.importers import mobfgsr as mobfgsr_files
from framecast.importers.decode import AXES
from framecast.importers.encode import encode, files
from framecast.importers.settings import Color, Depth, Motion, Settings
from framecast.warp import scale_motion

Progress = Callable[[Sequence[int]], Iterable[int]]

SCENE = "Scene"
"""What stands before the names of ExtraNet's buffers."""

HALF = frozenset({"color", "albedo", "normal", "roughness", "metallic"})


def fields_of(frame: Frame) -> Layers:
    """The buffers of a frame as arrays `c h w`."""
    found = {name: getattr(frame, name) for name in BUFFERS}
    return {name: value[0].numpy() for name, value in found.items() if value is not None}


def neighbours(clip: Clip, index: int) -> tuple[Record, Record | None, Record | None]:
    """The record of a frame of the view, and those before and after it."""
    shown = clip.shown
    return (
        shown[index],
        shown[index - 1] if index else None,
        shown[index + 1] if index + 1 < len(shown) else None,
    )


def write_stored(out: Path, stored: Layers, settings: Settings, number: int, half: frozenset[str] = HALF) -> None:
    """The files of one frame as settings lay them out, the buffers named in `half` as half floats."""
    kinds = {name: np.float16 if name in half else np.float32 for name in stored}
    cast = {name: np.clip(p, -65504, 65504).astype(kinds[name]) for name, p in stored.items()}
    for file, channels in files(cast, settings, number).items():
        images.write(out / file, channels)


def extranet(clip: Clip, out: Path, progress: Progress) -> str:
    """ExtraNet's raw data: one EXR a buffer, with n·v and world positions (in centimetres, its unit) besides.

    Scene units are taken for metres. Its preprocessing makes warped and demodulated images of these.
    """
    settings = extranet_files.settings_of(SCENE, set(extranet_files.BUFFERS))
    turn = torch.tensor(AXES["unreal"].T, dtype=torch.float32)
    for index in progress(range(len(clip))):
        frame, (here, before, after) = clip[index], neighbours(clip, index)
        write_stored(out, encode(fields_of(frame), settings, here, before, after), settings, here.number)
        assert frame.depth is not None
        assert frame.view is not None
        assert frame.projection is not None
        position = torch.einsum("ij,jhw->ihw", turn, world_position(frame.depth, frame.view, frame.projection)[0]) * 100
        name = f"{here.number:04d}.exr"
        images.write(out / f"{SCENE}WorldPosition.{name}", dict(zip("RGB", position.numpy(), strict=True)))
        nov = facing(frame)[0].numpy().astype(np.float16)
        images.write(out / f"{SCENE}NoV.{name}", dict(zip("RGB", np.repeat(nov, 3, 0), strict=True)))
    return "scene units were taken for metres; run its own preprocessing, or export to extranet-npz"


def mobfgsr(clip: Clip, out: Path, progress: Progress) -> str:
    """Mob-FGSR's inputs at the clip's size: 8-bit colour, depth and vectors packed in base 255.

    Depth is divided by the largest one of the clip; the sky is 1.
    """
    farthest = 0.0
    for index in range(len(clip)):
        depth = clip[index].depth
        assert depth is not None
        farthest = max(farthest, float(depth[depth < SKY].max())) if bool((depth < SKY).any()) else farthest
    far = farthest * 1.001 or 1.0
    settings = mobfgsr_files.settings_of("HR_Inputs/")
    assert settings.depth is not None
    settings = replace(settings, depth=replace(settings.depth, scale=far, far=far))
    for index in progress(range(len(clip))):
        here, before, after = neighbours(clip, index)
        stored = encode(fields_of(clip[index]), settings, here, before, after)
        write_stored(out, stored, settings, here.number, half=frozenset())
    return f"depth 1 is {far:.4g} scene units; colour is clipped at 1"


def arm(clip: Clip, out: Path, progress: Progress) -> str:
    """Arm's data: one sequence 0000 at the ratio of its references, motion at both sizes, and the JSON beside.

    Forward depth from the projection's near plane, infinite far plane. `ViewProjection` acts on row vectors; raw data
    column by column.
    """
    ratio = clip.scale or 1.0
    name = f"x{ratio:g}".replace(".", "_")
    settings = arm_settings(clip, f"{name}/{{}}/0000/{{{{frame}}}}.exr")
    rows = []
    for index in progress(range(len(clip))):
        frame, (here, before, after) = clip[index], neighbours(clip, index)
        fields = fields_of(frame)
        number = index  # frames of a sequence count from 0
        moved = {key: fields[key] for key in ("color", "depth", "motion")}
        write_stored(
            out, encode(moved, settings, here, before, after), settings, number, frozenset({"color", "motion"})
        )
        rows.append(_arm_frame(clip, frame, here, number))
        reference = clip.reference(index)
        assert frame.motion is not None
        assert reference is not None
        large = scale_motion(frame.motion, ratio)[0].numpy()
        uv = large / np.array([large.shape[2], large.shape[1]])[:, None, None]
        _exr(out / "motion_gt" / "0000" / f"{number:04d}.exr", "RG", uv)
        _exr(out / "ground_truth" / "0000" / f"{number:04d}.exr", "RGB", reference[0].numpy())
    with exr.whole(out / "0000.json") as temporary:
        temporary.write_text(json.dumps(_arm_sequence(clip, ratio, name, rows), indent=1))
    return f"ratio {ratio:g}; motion_gt is the small one enlarged"


def _exr(path: Path, names: str, pixels: np.ndarray) -> None:
    images.write(path, dict(zip(names, np.clip(pixels, -65504, 65504).astype(np.float16), strict=True)))


def arm_settings(clip: Clip, place: str) -> Settings:
    """Settings of Arm's files.

    Args:
        place: file pattern with one {} for the buffer.
    """

    def at(buffer: str) -> tuple[str, ...]:
        return (place.format(buffer),)

    return Settings(
        source="arm-nss",
        fps=clip.fps,
        color=Color(files=at("color"), channels=("R", "G", "B")),
        depth=Depth(files=at("depth"), channels=("R",), kind="device", near=near_plane(clip.shown[0])),
        motion=Motion(files=at("motion"), channels=("R", "G"), units="uv"),
    )


def near_plane(record: Record) -> float:
    """Distance of the plane that goes to clip z = 0, or to z = w where depth is reversed; 0.1 if there is none."""
    p = np.asarray(record.projection)
    a, b = float(p[2, 2]), float(p[2, 3])
    near = b if a == 0 else b / a if a < -0.5 else b / (1 + a)
    return near if near > 0 and math.isfinite(near) else 0.1


def _arm_frame(clip: Clip, frame: Frame, record: Record, number: int) -> dict[str, Any]:
    p, v = np.asarray(record.projection), np.asarray(record.view)
    (h, w), (jx, jy) = clip.size, record.jitter
    return {
        "Frame": number,
        "FovX": 2 * math.atan(1 / p[0, 0]),
        "FovY": 2 * math.atan(1 / p[1, 1]),
        "CameraNearPlane": near_plane(clip.shown[0]),
        "CameraFarPlane": -1.0,
        "ViewProjection": [float(x) for x in (p @ v).T.flatten("F")],
        "Jitter": {"X": jx, "Y": jy},
        "NormalizedPerRatioJitter": [{"X": jx / w, "Y": jy / h}],
        "Exposure": record.exposure,
        "CameraCut": bool(frame.reset[0]),
    }


def _arm_sequence(clip: Clip, ratio: float, name: str, rows: list[dict[str, Any]]) -> dict[str, Any]:
    h, w = clip.size
    return {
        "Version": "1",
        "EmulatedFramerate": round(clip.fps),
        "TargetResolution": {"X": round(w * ratio), "Y": round(h * ratio)},
        "Samples": {"Sequence": "Halton", "Count": len({record.jitter for record in clip.shown}), "Quantized": False},
        "ReverseZ": False,
        "UpscalingRatiosIndices": {f"{name}_index": 0},
        "MotionVectorsDilated": False,
        "Frames": rows,
    }
