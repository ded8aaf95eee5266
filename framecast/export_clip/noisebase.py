"""Noisebase's sample training format, version 1: one Zarr `ZipStore` a sequence, one sample a pixel.

Arrays have the frame first and the samples last. Radiance is RGBE: 256 steps of exposure between the darkest and the
brightest channel of the frame in log space, and each channel as a part of its pixel's step. Positions, motion (change
of position since the last frame), normals and colours are in world space. Matrices act on row vectors.
"""

import json
import zipfile
import zlib
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, UInt8

from framecast import exr
from framecast.clip import Clip
from framecast.frame import Frame, world_position
from framecast.warp import fetch

Progress = Callable[[Sequence[int]], Iterable[int]]


def noisebase(clip: Clip, out: Path, progress: Progress) -> str:
    """The whole clip as `scene0000.zip`."""
    shapes: dict[str, tuple[tuple[int, ...], np.dtype]] = {}
    with exr.whole(out / "scene0000.zip") as temporary, zipfile.ZipFile(temporary, "w", zipfile.ZIP_STORED) as archive:
        archive.writestr(".zgroup", json.dumps({"zarr_format": 2}))
        before: Frame | None = None
        for index in progress(range(len(clip))):
            frame = clip[index]
            reference = clip.reference(index)
            arrays = _arrays(frame, before)
            if reference is not None:
                arrays["reference"] = reference[0].numpy()
            for name, values in arrays.items():
                shapes[name] = (values.shape, values.dtype)
                chunk = ".".join([str(index)] + ["0"] * values.ndim)
                archive.writestr(f"{name}/{chunk}", zlib.compress(np.ascontiguousarray(values).tobytes(), 6))
            before = frame
        for name, (shape, kind) in shapes.items():
            archive.writestr(f"{name}/.zarray", json.dumps(_description((len(clip), *shape), kind)))
    return "one sample a pixel; matrices act on row vectors"


def _description(shape: tuple[int, ...], kind: np.dtype) -> dict[str, object]:
    """The `.zarray` file: one chunk a frame, zlib."""
    return {
        "zarr_format": 2,
        "shape": shape,
        "chunks": (1, *shape[1:]),
        "dtype": kind.str,
        "compressor": {"id": "zlib", "level": 6},
        "fill_value": 0,
        "order": "C",
        "filters": None,
    }


def _arrays(frame: Frame, before: Frame | None) -> dict[str, np.ndarray]:
    """Everything of one frame, samples in the last axis."""
    assert frame.color is not None
    assert frame.normal is not None
    assert frame.albedo is not None
    assert frame.view is not None
    assert frame.projection is not None
    color, exposure = rgbe(frame.color[0].numpy())
    to_world = torch.linalg.inv(frame.view)[0]
    eye = to_world[:3, 3]
    whole = frame.projection[0] @ frame.view[0]
    samples = {
        "color": color,
        "position": _position(frame).numpy().astype(np.float32),
        "motion": world_motion(frame, before).astype(np.float32),
        "normal": frame.normal[0].numpy().astype(np.float16),
        "diffuse": frame.albedo[0].numpy().astype(np.float16),
    }
    return {
        **{name: values[..., None] for name, values in samples.items()},
        "exposure": exposure,
        "camera_position": eye.numpy(),
        "camera_target": (eye - to_world[:3, 2]).numpy(),
        "camera_up": to_world[:3, 1].numpy(),
        "view_proj_mat": whole.T.contiguous().numpy(),
        "proj_mat": frame.projection[0].T.contiguous().numpy(),
        "crop_offset": np.zeros(2, np.int32),
    }


def _position(frame: Frame) -> Float[torch.Tensor, "3 h w"]:
    assert frame.depth is not None
    assert frame.view is not None
    assert frame.projection is not None
    return world_position(frame.depth, frame.view, frame.projection)[0]


def world_motion(frame: Frame, before: Frame | None) -> Float[np.ndarray, "3 h w"]:
    """How far each surface moved since the last frame, world space: exactly 0 on the static world and at a reset.

    Where ids are not known, everything is taken for moving. The last position is that of the pixel that the vector
    leads to; a surface that was hidden there gets what hid it.
    """
    here = _position(frame)
    if before is None or bool(frame.reset[0]) or frame.motion is None:
        return np.zeros_like(here.numpy())
    moved = here - fetch(_position(before)[None], frame.motion)[0]
    if frame.object is not None:
        moved = torch.where(frame.object[0] == 0, 0, moved)
    return moved.numpy()


def rgbe(color: Float[np.ndarray, "3 h w"]) -> tuple[UInt8[np.ndarray, "4 h w"], Float[np.ndarray, " 2"]]:
    """Colour as three parts of 255 and a step of exposure, and the log of the least and greatest exposure.

    Step e of a pixel stands for exp((e + 1) / 256 * (high - low) + low), the lowest one that is not below its brightest
    channel. Parts are rounded to the nearest.
    """
    lit = color[color > 0]
    if not lit.size:
        return np.zeros((4, *color.shape[1:]), np.uint8), np.zeros(2, np.float32)
    low, high = np.log(lit.astype(np.float64)).min(), np.log(lit.astype(np.float64)).max()
    brightest = np.log(np.maximum(color.max(0), np.exp(low)).astype(np.float64))
    width = max(high - low, 1e-9)
    step = np.clip(np.ceil((brightest - low) / width * 256) - 1, 0, 255)
    parts = np.rint(np.clip(color / np.exp((step + 1) / 256 * width + low), 0, 1) * 255)
    return np.concatenate((parts, step[None])).astype(np.uint8), np.array([low, high], np.float32)
