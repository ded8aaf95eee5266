"""The cameras of a Blender shot, from the `shot.json` that `examples/blender/export_camera.py` writes beside its EXRs.

    {"fps": 24, "camera": "PERSP", "clip_start": 0.1, "clip_end": 100,
     "frames": [{"frame": 1, "camera_to_world": [[...] x 4], "lens_mm": 35, "sensor_mm": 36}, ...]}

A frame may also carry camera (PERSP, ORTHO, PANO), ortho_scale, sensor_fit (AUTO, HORIZONTAL, VERTICAL),
sensor_height_mm, shift [x, y], pixel_aspect [x, y], clip_start, clip_end, jitter and cut; what is the same for all
frames may stand beside `frames`. Frames that were not rendered may be listed too: the one before the first, the one
after the last and those that a frame step leaves out tell how the background moves.
"""

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from framecast.exr import ClipError
from framecast.frame import pixel_grid, project, world_position

Matrix = tuple[tuple[float, ...], ...]

DEFAULTS: dict[str, Any] = {
    "camera": "PERSP",
    "clip_start": 0.1,
    "clip_end": 1000.0,
    "jitter": (0.0, 0.0),
    "pixel_aspect": (1.0, 1.0),
    "sensor_fit": "AUTO",
    "sensor_height_mm": 24.0,
    "sensor_mm": 36.0,
    "shift": (0.0, 0.0),
}


@dataclass(frozen=True)
class Camera:
    """Camera of one frame in our convention; no projection for a panorama."""

    view: Matrix
    projection: Matrix | None
    jitter: tuple[float, float]
    cut: bool


@dataclass(frozen=True)
class Shot:
    """What `shot.json` tells: cameras by frame number. Empty where there is no such file."""

    fps: float | None = None
    panorama: bool = False
    cameras: dict[int, Camera] = field(default_factory=dict)


def read_shot(folder: Path, size: tuple[int, int]) -> Shot:
    """Cameras of the shot in `folder` for images of `size` (height, width).

    Raises:
        ClipError: shot.json is not JSON, or lacks a value.
    """
    path = folder / "shot.json"
    if not path.is_file():
        return Shot()
    try:
        about = json.loads(path.read_text())
        shared = {**DEFAULTS, **{k: v for k, v in about.items() if k != "frames"}}
        rows = [{**shared, **row} for row in about["frames"]]
        cameras = {int(row["frame"]): _camera(row, size) for row in rows}
        fps = None if about.get("fps") is None else float(about["fps"])
    except KeyError as error:
        raise ClipError(f"{path} lacks {error}; write it again with examples/blender/export_camera.py") from error
    except (OSError, ValueError, TypeError, AttributeError, IndexError, np.linalg.LinAlgError) as error:
        raise ClipError(
            f"{path} cannot be read ({type(error).__name__}: {error}); "
            f"write it again with examples/blender/export_camera.py, or delete it to go without cameras"
        ) from error
    return Shot(fps, any(row["camera"] == "PANO" for row in rows), cameras)


def _camera(row: dict[str, Any], size: tuple[int, int]) -> Camera:
    to_world = np.asarray(row["camera_to_world"], np.float64).reshape(4, 4).copy()
    to_world[:3, :3] /= np.linalg.norm(to_world[:3, :3], axis=0)  # Blender ignores the scale of a camera
    jx, jy = row["jitter"]
    return Camera(
        view=_matrix(np.linalg.inv(to_world)),
        projection=None if row["camera"] == "PANO" else _matrix(_projection(row, size)),
        jitter=(float(jx), float(jy)),
        cut=bool(row.get("cut", False)),
    )


def _matrix(values: np.ndarray) -> Matrix:
    return tuple(tuple(float(v) for v in row) for row in values)


def _projection(row: dict[str, Any], size: tuple[int, int]) -> np.ndarray:
    """Camera to clip space, 4 x 4, clip z in 0..1 (clip_start..clip_end).

    The sensor spans the wider side of the image when the fit is AUTO; lens shift is in units of that side.
    """
    ax, ay = row["pixel_aspect"]
    width, height = size[1] * ax, size[0] * ay
    fit = row["sensor_fit"]
    across = fit == "HORIZONTAL" or (fit == "AUTO" and width >= height)
    side = width if across else height
    sensor = row["sensor_height_mm"] if fit == "VERTICAL" else row["sensor_mm"]
    near, far = row["clip_start"], row["clip_end"]
    reach = 2 / row["ortho_scale"] if row["camera"] == "ORTHO" else 2 * row["lens_mm"] / sensor
    scale = np.array([reach * side / width, reach * side / height])
    shift = 2 * np.asarray(row["shift"], np.float64) * side / np.array([width, height])
    out = np.zeros((4, 4))
    out[0, 0], out[1, 1] = scale
    if row["camera"] == "ORTHO":
        out[:2, 3] = -shift
        out[2, 2:] = 1 / (near - far), near / (near - far)
        out[3, 3] = 1
    else:
        out[:2, 2] = shift
        out[2, 2:] = far / (near - far), near * far / (near - far)
        out[3, 2] = -1
    return out


def background_motion(here: Camera, there: Camera, size: tuple[int, int]) -> Float[np.ndarray, "2 h w"] | None:
    """Motion in pixels (x right, y down) of what is infinitely far, from one camera to another.

    Only the rotation and the lens count. None unless both are perspectives; 0 where it gets behind the other camera.
    """
    if here.projection is None or there.projection is None or here.projection[3][3] or there.projection[3][3]:
        return None
    far = torch.ones(1, 1, *size)
    position = world_position(far, _rotation(here), _tensor(here.projection))
    found, depth = project(position, _rotation(there), _tensor(there.projection))
    return torch.where(depth > 0, found - pixel_grid(*size), 0)[0].numpy()


def _tensor(matrix: Matrix) -> Float[Tensor, "1 4 4"]:
    return torch.tensor([matrix], dtype=torch.float32)


def _rotation(camera: Camera) -> Float[Tensor, "1 4 4"]:
    view = _tensor(camera.view)
    view[:, :3, 3] = 0
    return view
