"""Where things are at a time: matrices, aimed cameras, smooth paths and hand shake. Shared by every scene.

Matrices are 4x4, column vectors, metres, right-handed, y up. A camera looks down its own -z. Angles are radians.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

Numbers = Sequence[Any] | ndarray
"""Numbers in nested sequences, or an array."""


def move(x: float, y: float, z: float) -> Float[ndarray, "4 4"]:
    """Translation."""
    matrix = np.eye(4)
    matrix[:3, 3] = x, y, z
    return matrix


def scale(x: float, y: float | None = None, z: float | None = None) -> Float[ndarray, "4 4"]:
    """Scaling along the axes; one number scales all three."""
    return np.diag([x, x if y is None else y, x if z is None else z, 1.0])


def turn(axis: str | Numbers, angle: float) -> Float[ndarray, "4 4"]:
    """Rotation by `angle` radians about 'x', 'y', 'z' or a vector through the origin,
    counter-clockwise seen from its tip.
    """
    named = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
    x, y, z = unit(named[axis] if isinstance(axis, str) else axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    matrix = np.eye(4)
    matrix[:3, :3] += np.sin(angle) * cross + (1 - np.cos(angle)) * (cross @ cross)
    return matrix


def unit(vector: Numbers) -> Float[ndarray, "3"]:
    """The vector at length one."""
    array = np.asarray(vector, np.float64)
    return array / np.linalg.norm(array)


def aim(position: Numbers, target: Numbers, roll: float = 0.0) -> Float[ndarray, "4 4"]:
    """Camera-to-world matrix at `position` whose -z points at `target`, level, then rolled about the view axis."""
    position = np.asarray(position, np.float64)
    back = unit(position - np.asarray(target, np.float64))
    right = unit(np.cross((0.0, 1.0, 0.0) if abs(back[1]) < 0.999 else (0.0, 0.0, -1.0), back))
    matrix = np.eye(4)
    matrix[:3, :4] = np.column_stack([right, np.cross(back, right), back, position])
    return matrix @ turn("z", roll)


def along(points: Numbers, time: float) -> Float[ndarray, "3"]:
    """Point at `time` in [0, 1] of the uniform Catmull-Rom curve through the points (k 3); clamped at both ends."""
    knots = np.asarray(points, np.float64)
    knots = np.concatenate([2 * knots[:1] - knots[1:2], knots, 2 * knots[-1:] - knots[-2:-1]])
    where = float(np.clip(time, 0, 1)) * (len(knots) - 3)
    k = min(int(where), len(knots) - 4)
    t = where - k
    a, b, c, d = knots[k : k + 4]
    return 0.5 * (2 * b + (c - a) * t + (2 * a - 5 * b + 4 * c - d) * t**2 + (3 * b - 3 * c + d - a) * t**3)


def ease(time: float, start: float, end: float) -> float:
    """0 before `start`, 1 after `end`, smooth in value and speed between."""
    t = float(np.clip((time - start) / (end - start), 0.0, 1.0))
    return t * t * (3 - 2 * t)


def shake(seed: int, time: float, speed: float = 1.0) -> Float[ndarray, "3"]:
    """Three smooth, aperiodic signals of about unit size, like a hand that holds a camera; `time` in frames."""
    phases = np.random.default_rng([seed, 77]).uniform(0, 2 * np.pi, (3, 4))
    rates = np.array([0.11, 0.23, 0.41, 0.83]) * speed
    sizes = np.array([0.6, 0.4, 0.25, 0.12])
    return (sizes * np.sin(rates * time + phases)).sum(axis=1)


def handheld(
    camera: Float[ndarray, "4 4"], seed: int, time: float, angle: float, shift: float = 0.0
) -> Float[ndarray, "4 4"]:
    """The camera with hand shake: about `angle` radians of pan, tilt and (half as much) roll,
    `shift` metres sideways.
    """
    pan, tilt, roll = angle * shake(seed, time)
    x, y, z = shift * shake(seed + 1, time)
    return camera @ move(x, y, z) @ turn("y", pan) @ turn("x", tilt) @ turn("z", roll / 2)


def frame_along(path: Float[ndarray, "k 3"]) -> Float[ndarray, "k 3 3"]:
    """Rows (side, up, forward) along a polyline, carried without twist from point to point."""
    forward = np.gradient(path, axis=0)
    forward /= np.maximum(np.linalg.norm(forward, axis=1, keepdims=True), 1e-12)
    up = np.array([0.0, 1.0, 0.0]) if abs(forward[0, 1]) < 0.9 else np.array([1.0, 0.0, 0.0])
    frames = []
    for direction in forward:
        up = unit(up - direction * (up @ direction))
        frames.append(np.stack([np.cross(up, direction), up, direction]))
    return np.stack(frames)


def bounds(points: Sequence[Float[ndarray, "_ 3"]]) -> tuple[Float[ndarray, "3"], Float[ndarray, "3"]]:
    """(lowest, highest) corner of the box around all points."""
    return np.min([p.min(axis=0) for p in points], axis=0), np.max([p.max(axis=0) for p in points], axis=0)
