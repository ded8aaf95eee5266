"""A wall that a perspective camera passes, turning: frames whose depth, vectors and cameras are known on paper."""

import math
from pathlib import Path

import numpy as np
import torch

from framecast.clip import Clip, Layers, Record, finish, write_frame
from framecast.frame import Frame, perspective, pixel_grid, project

H, W, FRAMES = 24, 40, 4
FOV = 0.9


def place(time: float) -> tuple[np.ndarray, float, float]:
    """Position in metres (y up, z towards the viewer), and turns to the right and up in radians."""
    return np.array([0.3 * time, 1.0 + 0.05 * time, 0.2 * time]), 0.1 + 0.05 * time, 0.02 * time


def view(time: float) -> np.ndarray:
    """World to camera, from where the camera looks, what is right of it and above it."""
    position, right, up = place(time)
    ahead = np.array([math.sin(right) * math.cos(up), math.sin(up), -math.cos(right) * math.cos(up)])
    side = np.array([math.cos(right), 0, math.sin(right)])
    rotation = np.stack((side, np.cross(side, ahead), -ahead))
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = rotation, -rotation @ position
    return out


def record(time: int) -> Record:
    lens = perspective(FOV, W / H)
    rows = [tuple(tuple(map(float, row)) for row in matrix) for matrix in (view(time), lens.tolist())]
    return Record(number=time + 10, time=float(time), view=rows[0], projection=rows[1], cut=time == 0)


def wall(time: int) -> Layers:
    """Buffers of the wall z = -6 with a pattern of a metre, vectors to the frame before."""
    grid = pixel_grid(H, W).double().numpy()
    tangent = math.tan(FOV / 2)
    x = (2 * grid[0] / W - 1) * tangent * W / H
    y = (1 - 2 * grid[1] / H) * tangent
    rays = np.einsum("ji,jhw->ihw", view(time)[:3, :3], np.stack((x, y, -np.ones_like(x))))
    position = place(time)[0]
    depth = (-6 - position[2]) / rays[2]  # rays advance by 1 along the view axis
    hit = position[:, None, None] + rays * depth
    matrices = (torch.from_numpy(view(max(time - 1, 0)))[None].float(), perspective(FOV, W / H)[None])
    there, _ = project(torch.from_numpy(hit)[None].float(), *matrices)
    pattern = 0.5 + 0.2 * np.sin(hit[0] * 3) + 0.2 * np.cos(hit[1] * 2.5)
    normal = np.zeros((3, H, W))
    normal[2] = 1
    layers = {
        "color": np.stack((pattern, pattern**2, np.sqrt(pattern))),
        "depth": depth[None],
        "motion": (there[0] - pixel_grid(H, W)).numpy(),
        "albedo": np.full((3, H, W), 0.25),
        "normal": normal,
        "roughness": np.full((1, H, W), 0.5),
        "metallic": np.full((1, H, W), 0.25),
        "object": (hit[:1] > 0.5) * 3,
    }
    return {name: pixels.astype(np.uint32 if name == "object" else np.float32) for name, pixels in layers.items()}


def write_wall(folder: Path, frames: int = FRAMES, *, references: bool = False) -> Clip:
    """The wall as a clip of our own; references are twice the size."""
    for time in range(frames):
        layers = wall(time)
        large = layers["color"].repeat(2, 1).repeat(2, 2) if references else None
        write_frame(folder, record(time), layers, reference=large, half=frozenset())
    return finish(folder, fps=30, scale=2.0 if references else None)


def buffers(frame: Frame) -> Layers:
    """The wall's buffers as they are in a frame."""
    found = {name: getattr(frame, name) for name in wall(0)}
    return {name: value[0].numpy() for name, value in found.items() if value is not None}
