"""Cameras of a shot from a file of poses, in the axes of their engine, to `view` and `projection` of `Frame`.

    {"fov": 50, "frames": [{"frame": 7, "position": [0, 150, -300], "rotation": [0, 90, 0], "cut": true}, ...]}

A frame gives its pose as `view` (world to camera), `camera_to_world`, or `position` with `rotation`: pitch, yaw, roll
in degrees for unreal, a quaternion x, y, z, w otherwise. It gives its lens as `projection` (unjittered), `fov`
(vertical, degrees) or `fov_x`; what is the same for all frames may stand beside `frames`. It may carry `jitter`, `cut`
and `exposure`. Matrices may act on columns or on rows; which one shows.
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from framecast.clip import Matrix, Record
from framecast.exr import ClipError
from framecast.frame import perspective
from framecast.importers.decode import AXES

FACING: dict[str, np.ndarray] = {
    "opengl": np.eye(3),
    "unreal": AXES["unreal"],
    "unity": np.eye(3),
    "directx": np.diag([1.0, 1, -1]),
}
"""Matrix from the camera axes of a source's matrices to ours. Unity's camera matrices look down -z, its objects +z."""

POSED = {**FACING, "unity": np.diag([1.0, 1, -1])}
"""The same for poses given as position and rotation."""


@dataclass(frozen=True)
class Pose:
    """Camera of one frame in our convention, and what else the file tells of the frame."""

    view: Matrix | None = None
    projection: Matrix | None = None
    jitter: tuple[float, float] | None = None
    cut: bool = False
    exposure: float | None = None


def read_poses(
    path: Path, axes: str, size: tuple[int, int], *, fov: float | None = None, scale: float = 1.0
) -> dict[int, Pose]:
    """Cameras by frame number.

    Args:
        axes: see `Settings.axes`. size: height and width of the images. fov: where the file does not tell.
        scale: what positions are multiplied by.

    Raises:
        FileNotFoundError: no such file. ClipError: not such a file, in one sentence.
    """
    if not path.is_file():
        raise FileNotFoundError(f"{path} does not exist; write it, or remove cameras.file from the settings")
    try:
        about = json.loads(path.read_text(encoding="utf-8"))
        shared = {"fov": fov, **{k: v for k, v in about.items() if k != "frames"}}
        return {int(row["frame"]): pose({**shared, **row}, axes, size, scale) for row in about["frames"]}
    except ClipError as error:
        raise ClipError(f"{path}: {error}") from error
    except (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError, np.linalg.LinAlgError) as error:
        raise ClipError(
            f"{path} cannot be read ({type(error).__name__}: {error}); it needs frames, each with frame and a pose"
        ) from error


def pose(row: Mapping[str, Any], axes: str, size: tuple[int, int], scale: float = 1.0) -> Pose:
    """One camera from what a file says of a frame.

    Raises:
        ClipError, ValueError, TypeError, KeyError: something is missing or no number.
    """
    jitter, exposure = row.get("jitter"), row.get("exposure")
    return Pose(
        view=_view(row, axes, scale),
        projection=_projection(row, size),
        jitter=None if jitter is None else (float(jitter[0]), float(jitter[1])),
        cut=bool(row.get("cut", False)),
        exposure=None if exposure is None else float(exposure),
    )


def _view(row: Mapping[str, Any], axes: str, scale: float) -> Matrix | None:
    if "view" in row:
        view, facing = _affine(row["view"], "view"), FACING[axes]
    elif "camera_to_world" in row:
        view, facing = np.linalg.inv(_affine(row["camera_to_world"], "camera_to_world")), FACING[axes]
    elif "position" in row and "rotation" in row:
        to_world = np.eye(4)
        turn = [float(v) for v in row["rotation"]]
        to_world[:3, :3] = rotator(*turn) if axes == "unreal" else quaternion(*turn)
        to_world[:3, 3] = [float(v) for v in row["position"]]
        view, facing = np.linalg.inv(to_world), POSED[axes]
    else:
        return None
    turned = np.eye(4)
    turned[:3, :3] = facing @ view[:3, :3] @ AXES[axes].T
    stretch = np.linalg.norm(turned[:3, :3], axis=1)
    turned[:3, :3] /= stretch[:, None]
    turned[:3, 3] = facing @ view[:3, 3] / stretch * scale
    return rows(turned)


def posed(records: Sequence[Record], axes: str) -> dict[str, Any]:
    """What a file says from which `read_poses` reads the cameras of these records again; all of them have one."""
    frames = []
    for record in records:
        view = np.asarray(record.view, np.float64)
        stored = np.eye(4)
        stored[:3, :3] = FACING[axes].T @ view[:3, :3] @ AXES[axes]
        stored[:3, 3] = FACING[axes].T @ view[:3, 3]
        row: dict[str, Any] = {"frame": record.number, "view": stored.tolist(), "projection": record.projection}
        frames.append(row | {"cut": True} if record.cut else row)
    return {"frames": frames}


def rows(matrix: Float[np.ndarray, "4 4"]) -> Matrix:
    """A matrix as the tuples that a record holds."""
    if not np.isfinite(matrix).all():
        raise ClipError("a camera matrix holds NaN or infinity")
    return tuple(tuple(float(v) for v in row) for row in matrix)


def _matrix(values: Any) -> np.ndarray:
    return np.asarray(values, np.float64).reshape(4, 4)


def _affine(values: Any, name: str) -> np.ndarray:
    """A pose that acts on columns, whichever way it was written."""
    matrix = _matrix(values)
    for candidate in (matrix, matrix.T):
        if np.allclose(candidate[3], (0, 0, 0, 1), atol=1e-6):
            return candidate
    raise ClipError(f"{name} is no pose: neither its last row nor its last column is 0 0 0 1")


def _on_columns(p: np.ndarray) -> np.ndarray:
    """A projection that acts on columns, whichever way it was written.

    What makes w of the distance is 1 or -1, in the last row or in the last column; opposite to it stands the near
    plane, in any unit. With parallel rays it is the shift that stands in one of the two, if there is any.
    """
    if p[3, 3] == 1:
        return p.T if np.abs(p[3, :2]).max() > np.abs(p[:2, 3]).max() else p
    return p.T if abs(abs(p[2, 3]) - 1) < abs(abs(p[3, 2]) - 1) else p


def _projection(row: Mapping[str, Any], size: tuple[int, int]) -> Matrix | None:
    """From a matrix of any convention, of which only lens and shift count, or from a field of view."""
    aspect = size[1] / size[0]
    if row.get("projection") is not None:
        p = _on_columns(_matrix(row["projection"]))
        out = np.zeros((4, 4))
        if p[3, 3] == 1:
            out[:2], out[2, 2], out[3, 3] = p[:2], -1e-4, 1
        else:
            out[0, 0], out[1, 1] = p[0, 0], p[1, 1]
            out[:2, 2] = p[:2, 2] * -np.sign(p[3, 2])  # the same shift where the camera looks down +z
            out[2, 3], out[3, 2] = 0.1, -1
        return rows(out)
    vertical = row.get("fov")
    if row.get("fov_x") is not None:
        vertical = math.degrees(2 * math.atan(math.tan(math.radians(float(row["fov_x"])) / 2) / aspect))
    if vertical is None:
        return None
    if not 0 < float(vertical) < 180:
        raise ClipError(f"a field of view of {vertical} degrees was given; it has to lie between 0 and 180")
    return rows(perspective(math.radians(float(vertical)), aspect).double().numpy())


def rotator(pitch: float, yaw: float, roll: float) -> Float[np.ndarray, "3 3"]:
    """Camera to world in Unreal's axes (x ahead, y right, z up), from degrees: yaw right, pitch up, roll clockwise."""
    p, y, r = (math.radians(v) for v in (pitch, yaw, roll))
    turn = np.array([[math.cos(y), -math.sin(y), 0], [math.sin(y), math.cos(y), 0], [0, 0, 1]])
    tilt = np.array([[math.cos(p), 0, -math.sin(p)], [0, 1, 0], [math.sin(p), 0, math.cos(p)]])
    bank = np.array([[1, 0, 0], [0, math.cos(r), math.sin(r)], [0, -math.sin(r), math.cos(r)]])
    turned: np.ndarray = turn @ tilt @ bank
    return turned


def quaternion(x: float, y: float, z: float, w: float) -> Float[np.ndarray, "3 3"]:
    """Rotation matrix of a quaternion, of any length but 0."""
    q: Sequence[float] = np.array((x, y, z, w)) / np.linalg.norm((x, y, z, w))
    x, y, z, w = (float(v) for v in q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
