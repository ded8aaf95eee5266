"""A small world that is known on paper: a floor, a wall and a card that slides, seen by a walking, jittered camera."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from framecast.clip import Layers, Record, finish, write_frame
from framecast.frame import SKY, perspective
from framecast.importers.decode import radical_inverse

SIZE = (90, 160)
FOV = 0.9
Frames = list[tuple[Record, Layers]]


def camera(t: float, step: float) -> np.ndarray:
    """Camera to world: walks to the right and forward, and turns a little."""
    angle = 0.012 * step * t
    pose = np.eye(4)
    pose[:3, :3] = [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
    pose[:3, 3] = 0.16 * step * t, 1.5 + 0.05 * step * t, -0.1 * step * t
    return pose


def noise(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """A smooth texture without a period, 0..1."""
    waves = [(3.1, 1.7, 0.3), (1.3, 4.3, 1.9), (5.9, 3.7, 0.7), (7.3, 6.1, 2.3), (2.3, 8.9, 1.1)]
    return 0.5 + 0.1 * sum(np.sin(a * u + b * v + c + np.sin(b * u)) for a, b, c in waves)


def places(world: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Pixel positions of world points `3 h w`."""
    height, width = SIZE
    local = np.einsum("ij,jhw->ihw", np.linalg.inv(pose), np.concatenate([world, np.ones_like(world[:1])]))
    focal = height / 2 / np.tan(FOV / 2)
    return np.stack([width / 2 - focal * local[0] / local[2], height / 2 + focal * local[1] / local[2]])


def frame(t: int, jitter: tuple[float, float], step: float = 1.0, speed: float = 0.12) -> Layers:
    """Every buffer of one time, in the conventions of `Frame`."""
    height, width = SIZE
    pose, slide = camera(t, step), speed * t
    y, x = np.mgrid[0:height, 0:width] + 0.5
    here = np.stack([x + jitter[0], y + jitter[1]])
    tangent = np.tan(FOV / 2)
    ray = np.stack([(2 * here[0] / width - 1) * tangent * width / height, (1 - 2 * here[1] / height) * tangent])
    ray = np.einsum("ij,jhw->ihw", pose[:3, :3], np.concatenate([ray, -np.ones_like(ray[:1])]))
    eye = pose[:3, 3][:, None, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        hits = [np.where(ray[1] < 0, -eye[1] / ray[1], np.inf)]
        hits += [np.where(ray[2] < 0, (z - eye[2]) / ray[2], np.inf) for z in (-9.0, -5.0)]
    points = [eye + ray * np.where(np.isfinite(s), s, 0) for s in hits]
    hits[1] = np.where(points[1][1] < 4.5, hits[1], np.inf)
    card = (np.abs(points[2][0] - slide - 0.4) < 0.9) & (np.abs(points[2][1] - 1.3) < 0.8)
    hits[2] = np.where(card, hits[2], np.inf)
    nearest = np.argmin(hits, 0)
    depth = np.min(hits, 0)
    sky = ~np.isfinite(depth)
    world = eye + ray * np.where(sky, 1000.0, depth)
    uv = [(world[0], world[2]), (world[0], world[1]), (world[0] - slide + 3, world[1])]
    pattern = np.choose(nearest, [noise(2 * u, 2 * v) for u, v in uv])
    albedo = np.stack([0.15 + 0.7 * pattern, 0.2 + 0.5 * np.round(pattern * 3) / 3, 0.5 - 0.2 * pattern])
    light = 0.4 + 2.4 * np.exp(-((world[0] - 1) ** 2 + (world[2] + 6) ** 2) / 8)
    shade = 0.7 + 0.2 * np.sin(6 * ray[0]) * np.cos(7 * ray[1])
    before = world - np.where((nearest == 2) & ~sky, speed, 0) * np.array([1.0, 0, 0])[:, None, None]
    normals = np.array([[0.0, 1, 0], [0, 0, 1], [0, 0, 1]]).T[:, nearest]
    return {
        "color": np.where(sky, shade, albedo * light).astype(np.float32),
        "depth": np.where(sky, SKY, depth)[None].astype(np.float32),
        "motion": (places(before, camera(t - 1, step)) - here).astype(np.float32),
        "normal": np.where(sky, 0, normals).astype(np.float32),
        "albedo": np.where(sky, 0, albedo).astype(np.float32),
    }


def frames(count: int = 8, *, jittered: bool = True, step: float = 1.0, speed: float = 0.12) -> Frames:
    """Records and buffers of frames 1, 2, 3 ..."""
    projection = tuple(map(tuple, perspective(FOV, SIZE[1] / SIZE[0]).tolist()))
    out = []
    for t in range(count):
        jitter = (radical_inverse(t + 1, 2) - 0.5, radical_inverse(t + 1, 3) - 0.5) if jittered else (0.0, 0.0)
        view = tuple(map(tuple, np.linalg.inv(camera(t, step)).tolist()))
        record = Record(number=t + 1, time=float(t), jitter=jitter, view=view, projection=projection)
        out.append((record, frame(t, jitter, step, speed)))
    return out


def write(folder: Path, scene: Frames) -> Path:
    """The frames as a clip on disk."""
    for record, layers in scene:
        write_frame(folder, record, layers, half=frozenset({"color"}))
    finish(folder, fps=24, span=1.0)
    return folder


def changed(scene: Frames, name: str, change: Callable[..., np.ndarray]) -> Frames:
    """The frames with one buffer stored differently."""
    return [(r, {**a, name: change(a[name]).astype(np.float32)}) for r, a in scene]
