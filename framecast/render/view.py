"""Cameras as matrices: projections, jitter, the views behind mirrors, and how each is packed for the shaders."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from framecast.render.scene import Camera, Mirror

Array = np.ndarray


class View(NamedTuple):
    """A camera at one time. Everything double precision, column vectors."""

    camera: Array
    """4x4 camera to world; behind a mirror it is left-handed."""
    projection: Array
    """4x4 camera to clip, unjittered, depth reversed (1 at the near plane, 0 infinitely far); clip w = view depth."""
    plane: Array | None = None
    """Behind a mirror: (normal, -distance); what lies below it is not drawn."""

    @property
    def clip(self) -> Array:
        """World to clip, 4x4."""
        return self.projection @ np.linalg.inv(self.camera)

    @property
    def near(self) -> float:
        """Near distance."""
        return float(self.projection[2, 3])


def projection(vertical_fov: float, aspect: float, near: float) -> Float[Array, "4 4"]:
    """Camera to clip with infinite far plane and reversed depth: z_clip / w_clip = near / depth."""
    f = 1 / np.tan(vertical_fov / 2)
    return np.array([[f / aspect, 0, 0, 0], [0, f, 0, 0], [0, 0, 0, near], [0, 0, -1, 0]], np.float64)


def view_of(camera: Camera, time: float, aspect: float) -> View:
    """The camera at `time`, for pictures `aspect` times as wide as high."""
    return View(np.asarray(camera.at(time), np.float64), projection(camera.vertical_fov, aspect, camera.near))


def mirrored(view: View, mirror: Mirror) -> View:
    """The view from behind a mirror: its picture, looked up at the same pixel, is what the mirror shows there."""
    normal = np.asarray(mirror.normal, np.float64) / np.linalg.norm(mirror.normal)
    distance = float(normal @ np.asarray(mirror.point, np.float64))
    reflect = np.eye(4)
    reflect[:3, :3] -= 2 * np.outer(normal, normal)
    reflect[:3, 3] = 2 * distance * normal
    return View(reflect @ view.camera, view.projection, np.append(normal, -distance))


def jitter_clip(jitter: tuple[float, float], size: tuple[int, int]) -> tuple[float, float]:
    """Clip-space offset (times w) that puts the sample at pixel centre + jitter.

    The picture moves by -jitter pixels, so that what stood at centre + jitter arrives at the centre. Size is (height,
    width).
    """
    return -2 * jitter[0] / size[1], 2 * jitter[1] / size[0]


def pack(
    view: View, jitter: tuple[float, float], size: tuple[int, int], lod_bias: float, sharpen: float
) -> Float[Array, "12"]:
    """The `View` struct of geometry.wgsl."""
    plane = np.zeros(4) if view.plane is None else view.plane
    head = (*jitter_clip(jitter, size), lod_bias, sharpen)
    return np.concatenate([head, np.append(view.camera[:3, 3], 1.0), plane]).astype(np.float32)


def rays(view: View) -> Float[Array, "3 4"]:
    """Rows right, up, forward: world position = eye + depth * (forward + ndc_x * right + ndc_y * up)."""
    p, axes = view.projection, view.camera[:3, :3]
    rows = np.zeros((3, 4))
    rows[:, :3] = axes[:, 0] / p[0, 0], axes[:, 1] / p[1, 1], -axes[:, 2]
    return rows


def sky_turn(
    views: tuple[View, View, View, View], jitter: tuple[float, float], size: tuple[int, int]
) -> Float[Array, "84"]:
    """The `Turn` struct of sky_motion.wgsl, from the views at time, time - 1, time - 2 and time + 1."""
    to_world = np.zeros((4, 4))
    to_world[:3, :3] = rays(views[0])[:, :3].T
    forward = [v.projection @ _rotation(v) for v in views]
    matrices = [to_world, *forward]
    head = np.array([size[1], size[0], *jitter])
    return np.concatenate([head, *(m.T.ravel() for m in matrices)]).astype(np.float32)


def _rotation(view: View) -> Array:
    matrix = np.eye(4)
    matrix[:3, :3] = np.linalg.inv(view.camera[:3, :3])
    return matrix


def in_sight(clip: Float[Array, "4 4"], centres: Float[Array, "n 3"], radii: Float[Array, " n"]) -> Bool[Array, " n"]:
    """Which balls may touch the picture that a world-to-clip matrix makes; nothing is cut by distance."""
    planes = np.stack([clip[3] + clip[0], clip[3] - clip[0], clip[3] + clip[1], clip[3] - clip[1]])
    planes /= np.linalg.norm(planes[:, :3], axis=1, keepdims=True)
    return (centres @ planes[:, :3].T + planes[:, 3] >= -radii[:, None]).all(1)
