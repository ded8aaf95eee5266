"""Small scenes whose picture is known on paper, shared by the renderer's tests."""

import os
from collections.abc import Callable

import numpy as np
import pytest
import torch

from framecast.frame import Frame
from framecast.render import device
from framecast.render.scene import Camera, Instance, Light, LightPose, Material, Mesh, Pose, Scene, Sky, Texture
from framecast.render.view import view_of

try:
    device.open_device()
except FileNotFoundError as error:
    if os.environ.get("FRAMECAST_NEEDS_VULKAN"):
        raise
    pytest.skip(str(error), allow_module_level=True)

SIZE = (48, 64)
FOV = 0.9
UNIFORM = Sky(np.ones((8, 16, 3), np.float32), sun_disc=False)
DIM = Sky(np.full((8, 16, 3), 0.2, np.float32), sun_disc=False)
DARK = Sky(np.zeros((8, 16, 3), np.float32), sun_disc=False)


def moved(x: float, y: float, z: float) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, 3] = x, y, z
    return matrix


def turned(axis: tuple[float, float, float], angle: float) -> np.ndarray:
    a = np.asarray(axis, float) / np.linalg.norm(axis)
    k = np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])
    matrix = np.eye(4)
    matrix[:3, :3] = np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k
    return matrix


def card(width: float, height: float, uv: float = 1.0) -> Mesh:
    """A rectangle in the xy-plane facing +z."""
    positions = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * [width / 2, height / 2, 1]
    uvs = np.array([[0.0, 1], [1, 1], [1, 0], [0, 0]]) * uv
    return Mesh(positions, np.tile([0.0, 0, 1], (4, 1)), uvs, np.array([0, 1, 2, 0, 2, 3]))


def ball(radius: float = 1.0, rings: int = 48) -> Mesh:
    polar, azimuth = np.meshgrid(
        np.linspace(0, np.pi, rings + 1), np.linspace(0, 2 * np.pi, 2 * rings + 1), indexing="ij"
    )
    points = np.stack([np.sin(polar) * np.sin(azimuth), np.cos(polar), np.sin(polar) * np.cos(azimuth)], -1).reshape(
        -1, 3
    )
    uvs = np.stack([azimuth / (2 * np.pi), polar / np.pi], -1).reshape(-1, 2)
    row = 2 * rings + 1
    first = (np.arange(rings)[:, None] * row + np.arange(2 * rings)).reshape(-1)
    corners = [first, first + row, first + row + 1, first, first + row + 1, first + 1]
    return Mesh(points * radius, points, uvs, np.stack(corners, 1).reshape(-1))


def world(*instances: Instance, camera: Callable[[float], np.ndarray], sky: Sky = UNIFORM, **parts) -> Scene:
    return Scene("test", instances, parts.pop("lights", ()), Camera(camera, FOV), sky, **parts)


def roaming(time: float) -> np.ndarray:
    """Walks, pans and rolls, accelerating."""
    position = moved(0.1 * time + 0.02 * time**2, 1.5 + 0.03 * time, 0.05 * time)
    return position @ turned((0, 1, 0), 0.03 * time) @ turned((1, 0, 0), -0.5) @ turned((0, 0, 1), 0.3 + 0.05 * time)


def floor_of(half: float = 40.0) -> Instance:
    return Instance(card(2 * half, 2 * half), Material(), pose=lambda time: Pose(turned((1, 0, 0), -np.pi / 2)))


def rays(camera: np.ndarray, jitter: tuple[float, float], fov: float = FOV) -> tuple[np.ndarray, np.ndarray]:
    """World directions, of length 1 along the camera's axis, through all samples; and the samples in pixels."""
    height, width = SIZE
    y, x = np.mgrid[0:height, 0:width] + 0.5
    x, y = x + jitter[0], y + jitter[1]
    tangent = np.tan(fov / 2)
    local = np.stack(
        [(2 * x / width - 1) * tangent * width / height, (1 - 2 * y / height) * tangent, -np.ones_like(x)], -1
    )
    return local @ camera[:3, :3].T, np.stack([x, y])


def seen_at(points: np.ndarray, camera: np.ndarray, fov: float = FOV) -> tuple[np.ndarray, np.ndarray]:
    """Pixel positions and depths of world points."""
    height, width = SIZE
    local = (points - camera[:3, 3]) @ camera[:3, :3]
    focal = height / 2 / np.tan(fov / 2)
    place = np.stack(
        [width / 2 - focal * local[..., 0] / local[..., 2], height / 2 + focal * local[..., 1] / local[..., 2]]
    )
    return place, -local[..., 2]


def framed(layers: dict, scene: Scene, time: float) -> Frame:
    view = view_of(scene.camera, time, SIZE[1] / SIZE[0])
    tensor = lambda m: torch.from_numpy(np.asarray(m, np.float32))[None]  # noqa: E731
    return Frame(
        depth=tensor(layers["depth"]), jitter=torch.zeros(1, 2), view=tensor(np.linalg.inv(view.camera)),
        projection=tensor(view.projection), time=torch.tensor([time]), reset=torch.tensor([False]), span=torch.ones(1),
    )  # fmt: skip


def sun(direction: tuple[float, float, float], **parts) -> Light:
    unit = np.asarray(direction, float) / np.linalg.norm(direction)
    return Light("sun", (1, 1, 1), np.pi, lambda time: LightPose(np.zeros(3), unit), **parts)


def looking_down(time: float) -> np.ndarray:
    return moved(0, 6, 0) @ turned((1, 0, 0), -np.pi / 2)


def busy(time_of_day: Callable[[float], tuple] = lambda time: (0.4, -1, -0.3)) -> Scene:
    """Something of everything, small."""
    leaf = np.full((8, 8, 4), 255, np.uint8)
    leaf[::2, :, 3] = 0
    stripes = np.full((16, 16, 4), 255, np.uint8)
    stripes[:, ::4, :3] = 40
    light = Light("sun", (1, 0.9, 0.8), 3, lambda t: LightPose(np.zeros(3), np.asarray(time_of_day(t), float)), 0.02)
    ground = Material(base_texture=Texture(stripes, True))
    leaves = Material(base_texture=Texture(leaf, True), alpha_mode="mask", double_sided=True)
    parts = (
        Instance(card(12, 12, 6), ground, pose=lambda t: Pose(turned((1, 0, 0), -np.pi / 2))),
        Instance(
            ball(0.7, 24), Material((0.8, 0.3, 0.2, 1), roughness=0.9), 1, lambda t: Pose(moved(0.1 * t, 0.7, -3))
        ),
        Instance(card(1, 1), leaves, 2, lambda t: Pose(moved(1.5, 0.6, -2.5) @ turned((0, 1, 0), 0.2 * t))),
    )
    return world(*parts, sky=DIM, lights=(light,),
                 camera=lambda t: moved(0.05 * t, 1.2, 1) @ turned((1, 0, 0), -0.25))  # fmt: skip
