"""The node tree of a glTF file in motion: local transforms, animation curves, world matrices at any time."""

import functools
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from framecast.render.gltf_file import File, accessor
from framecast.render.motion import Numbers


@dataclass(frozen=True, eq=False)
class Curve:
    """One animated property of a node."""

    node: int
    path: str
    """'translation', 'rotation' (quaternion x y z w), 'scale' or 'weights'."""
    times: Float[ndarray, " k"]
    """Seconds, growing."""
    values: Float[ndarray, "k c"]
    tangents: Float[ndarray, "2 k c"] | None
    """Cubic splines: in-tangents and out-tangents, per second."""
    step: bool

    def at(self, seconds: float) -> Float[ndarray, " c"]:
        """Value at a time, held before the first and after the last key."""
        if len(self.times) == 1 or seconds <= self.times[0]:
            return self.values[0]
        if seconds >= self.times[-1]:
            return self.values[-1]
        k = int(np.searchsorted(self.times, seconds, side="right")) - 1
        span = float(self.times[k + 1] - self.times[k])
        t = (seconds - float(self.times[k])) / span
        if self.step:
            return self.values[k]
        if self.tangents is not None:
            value = hermite(
                self.values[k], self.tangents[1, k] * span, self.values[k + 1], self.tangents[0, k + 1] * span, t
            )
            return value / np.linalg.norm(value) if self.path == "rotation" else value
        if self.path == "rotation":
            return slerp(self.values[k], self.values[k + 1], t)
        return self.values[k] * (1 - t) + self.values[k + 1] * t


def hermite(a: ndarray, slope_a: ndarray, b: ndarray, slope_b: ndarray, t: float) -> ndarray:
    """Cubic from `a` to `b` with the given slopes at t = 0 and 1."""
    return (
        (2 * t**3 - 3 * t**2 + 1) * a
        + (t**3 - 2 * t**2 + t) * slope_a
        + (3 * t**2 - 2 * t**3) * b
        + (t**3 - t**2) * slope_b
    )


def slerp(a: Float[ndarray, "4"], b: Float[ndarray, "4"], t: float) -> Float[ndarray, "4"]:
    """Shortest constant-speed rotation between unit quaternions."""
    cosine = float(a @ b)
    b, cosine = (-b, -cosine) if cosine < 0 else (b, cosine)
    if cosine > 0.9995:
        mixed = a + (b - a) * t
        return mixed / np.linalg.norm(mixed)
    angle = np.arccos(cosine)
    return (np.sin((1 - t) * angle) * a + np.sin(t * angle) * b) / np.sin(angle)


def rotation(quaternion: Numbers) -> Float[ndarray, "3 3"]:
    """Matrix of a quaternion x y z w of any length."""
    x, y, z, w = np.asarray(quaternion, np.float64) / np.linalg.norm(quaternion)
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip


@dataclass(frozen=True, eq=False)
class Tree:
    """All nodes and the chosen animation."""

    file: File
    parents: list[int]
    """-1 for roots and for nodes outside the scene that is shown."""
    order: list[int]
    """Nodes of the shown scene, parents first."""
    curves: list[Curve]
    duration: float
    """Seconds of the animation; 0 without one."""
    loops: bool
    """The animation ends as it begins, so it is repeated; else its first and last pose are held."""
    poses: dict[float, dict[int, ndarray]] = field(default_factory=dict)

    @functools.cached_property
    def moved(self) -> set[int]:
        """Nodes that an animation moves, themselves or through a node above."""
        direct = {curve.node for curve in self.curves if curve.path != "weights"}
        found: set[int] = set()
        for node in self.order:
            if node in direct or self.parents[node] in found:
                found.add(node)
        return found

    def leader(self, node: int) -> int:
        """The topmost moving node above (or the node itself): what moves together belongs to one object."""
        while self.parents[node] in self.moved:
            node = self.parents[node]
        return node

    def wrapped(self, seconds: float) -> float:
        """Time within the animation."""
        if self.loops and self.duration > 0:
            return seconds % self.duration
        return min(max(seconds, 0.0), self.duration)

    def world(self, seconds: float) -> dict[int, Float[ndarray, "4 4"]]:
        """World matrix of every node of the scene."""
        seconds = self.wrapped(seconds)
        if seconds not in self.poses:
            if len(self.poses) >= 8:
                self.poses.pop(next(iter(self.poses)))
            self.poses[seconds] = self._world(seconds)
        return self.poses[seconds]

    def _world(self, seconds: float) -> dict[int, ndarray]:
        animated: dict[int, dict[str, ndarray]] = {}
        for curve in self.curves:
            animated.setdefault(curve.node, {})[curve.path] = curve.at(seconds)
        world: dict[int, ndarray] = {}
        for node in self.order:
            local = local_matrix(self.file.document.nodes[node], animated.get(node, {}))
            world[node] = world[self.parents[node]] @ local if self.parents[node] >= 0 else local
        return world

    def weights(self, node: int, count: int, seconds: float) -> Float[ndarray, " k"]:
        """Shape-key weights of a node's mesh."""
        for curve in self.curves:
            if curve.node == node and curve.path == "weights":
                return curve.at(self.wrapped(seconds)).astype(np.float64)
        mesh = self.file.document.meshes[self.file.document.nodes[node].mesh]
        still = self.file.document.nodes[node].weights or mesh.weights or [0.0] * count
        return np.asarray(still, np.float64)


def local_matrix(node: Any, animated: dict[str, ndarray]) -> Float[ndarray, "4 4"]:
    """Node to parent: its matrix, or translation · rotation · scale with the animated parts in place."""
    if node.matrix is not None and not set(animated) & {"translation", "rotation", "scale"}:
        return np.asarray(node.matrix, np.float64).reshape(4, 4).T
    matrix = np.eye(4)
    quaternion = animated.get("rotation", node.rotation if node.rotation is not None else (0, 0, 0, 1))
    sizes = animated.get("scale", node.scale if node.scale is not None else (1, 1, 1))
    matrix[:3, :3] = rotation(quaternion) * np.asarray(sizes, np.float64)
    matrix[:3, 3] = animated.get("translation", node.translation if node.translation is not None else (0, 0, 0))
    return matrix


def tree(file: File, animation: str | int | None) -> Tree:
    """The nodes of the file's default scene with one of its animations: by name or number, or the first."""
    document = file.document
    parents, order = [-1] * len(document.nodes), []
    scenes = document.scenes or []
    roots = scenes[document.scene or 0].nodes if scenes else None
    children = {child for node in document.nodes for child in node.children or ()}
    waiting = list(roots if roots is not None else [k for k in range(len(document.nodes)) if k not in children])
    while waiting:
        node = waiting.pop(0)
        order.append(node)
        for child in document.nodes[node].children or ():
            parents[child] = node
            waiting.append(child)
    curves = _curves(file, animation)
    duration = max((float(curve.times[-1]) for curve in curves), default=0.0)
    return Tree(file, parents, order, curves, duration, _loops(curves))


def _curves(file: File, animation: str | int | None) -> list[Curve]:
    animations = file.document.animations or []
    if not animations and animation is None:
        return []
    names = [a.name or str(k) for k, a in enumerate(animations)]
    choice = 0 if animation is None else names.index(animation) if animation in names else animation
    if not isinstance(choice, int) or not 0 <= choice < len(animations):
        raise ValueError(f"{file.path} has no animation {animation!r}; it has {', '.join(names) or 'none'}")
    curves = []
    for channel in animations[choice].channels:
        if channel.target.node is None or channel.target.path not in ("translation", "rotation", "scale", "weights"):
            continue
        sampler = animations[choice].samplers[channel.sampler]
        times = accessor(file, sampler.input).astype(np.float64)
        values = accessor(file, sampler.output).astype(np.float64)
        cubic = sampler.interpolation == "CUBICSPLINE"
        values = values.reshape(len(times), 3, -1) if cubic else values.reshape(len(times), -1)
        tangents = np.stack([values[:, 0], values[:, 2]]) if cubic else None
        points = values[:, 1] if cubic else values
        curves.append(
            Curve(channel.target.node, channel.target.path, times, points, tangents, sampler.interpolation == "STEP")
        )
    return curves


def _loops(curves: list[Curve]) -> bool:
    """Whether every curve ends where it begins (rotations: up to sign)."""
    for curve in curves:
        first, last = curve.values[0], curve.values[-1]
        if curve.path == "rotation" and first @ last < 0:
            last = -last
        if np.abs(first - last).max() > 1e-3 * max(1.0, float(np.abs(curve.values).max())):
            return False
    return bool(curves)
