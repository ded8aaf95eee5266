"""glTF 2.0 files as scenes: meshes, materials, skins, shape keys, animation, cameras and KHR_lights_punctual.

`load` is the entry. What a bare model lacks is added: without a camera it stands on a grey floor and the camera
circles it; without lights there is a sun and a sky. Not read: vertex colours, second texture coordinates of single
textures, clear coat, transmission and other layers, orthographic cameras, points and lines.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from framecast.render import geometry
from framecast.render.gltf_file import File, accessor, read
from framecast.render.gltf_materials import Look, looks, moved_uvs
from framecast.render.gltf_nodes import Tree, tree
from framecast.render.motion import aim, bounds
from framecast.render.scene import Camera, Instance, Light, LightPose, Material, Mesh, Pose, Scene, Sky
from framecast.render.skies import dome, sun_travel

ORBIT = 12.0
"""Seconds that the added camera takes to go round once."""


def load(path: Path, frames: int | None = None, fps: float = 30.0, animation: str | int | None = None) -> Scene:
    """The file's default scene, playing one of its animations (name or number; the first if None) at `fps`.

    `frames` defaults to the animation's length, or 60. An animation that ends as it begins repeats; any other holds its
    ends. Object 0 is what stands still; whatever moves by itself, with all that hangs on it, is an object of its own.
    Raises FileNotFoundError or ValueError with one sentence.
    """
    path = Path(path)
    file = read(path)
    nodes = tree(file, animation)
    instances = _instances(file, nodes, fps)
    if not instances:
        raise ValueError(f"{path} has no triangles to draw; export the meshes too")
    box = _extent(instances)
    camera = _camera(file, nodes, fps)
    lights = _lights(file, nodes, fps, box)
    if camera is None:
        camera = _orbit(box, fps)
        instances.append(_floor(box))
    gain = _exposure(lights, (box[0] + box[1]) / 2)
    if not lights:
        lights = [_sun()]
    length = round(nodes.duration * fps) if nodes.duration > 0 else 60
    return Scene(
        name=path.stem,
        instances=tuple(instances),
        lights=tuple(lights),
        camera=camera,
        sky=_sky(lights, 0.4 / gain if gain != 1.0 else 1.0),
        exposure=lambda time: gain,
        frames=frames if frames is not None else max(length, 2),
        fps=fps,
        shadow_distance=float(4 * np.linalg.norm(box[1] - box[0])),
    )


# Meshes ---------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Part:
    """A primitive of a mesh and what it looks like."""

    mesh: Mesh
    material: Material


def _instances(file: File, nodes: Tree, fps: float) -> list[Instance]:
    table = looks(file)
    numbers: dict[int, int] = {}
    parts: dict[int, list[Part]] = {}
    instances = []
    for node in nodes.order:
        index = file.document.nodes[node].mesh
        if index is None:
            continue
        if index not in parts:
            primitives = file.document.meshes[index].primitives
            parts[index] = [part for p in primitives if (part := _part(file, p, table)) is not None]
        leader = _leader(file, nodes, node)
        number = 0 if leader is None else numbers.setdefault(leader, len(numbers) + 1)
        for part in parts[index]:
            mesh, pose = _posed(file, nodes, node, part.mesh, fps)
            instances.append(Instance(mesh, part.material, number, pose))
    return instances


def _leader(file: File, nodes: Tree, node: int) -> int | None:
    """The moving thing that a mesh node belongs to: a node number, or None for the static world."""
    skin = file.document.nodes[node].skin
    if skin is not None:
        joints = [joint for joint in file.document.skins[skin].joints if joint in nodes.moved]
        if joints:
            return nodes.leader(joints[0])
    elif node in nodes.moved:
        return nodes.leader(node)
    weighs = any(curve.node == node and curve.path == "weights" for curve in nodes.curves)
    return node if weighs else None


def _posed(file: File, nodes: Tree, node: int, mesh: Mesh, fps: float) -> tuple[Mesh, Callable[[float], Pose]]:
    """The mesh as this node uses it, and its pose over time (frames)."""
    skin = file.document.nodes[node].skin
    keys = 0 if mesh.morphs is None else len(mesh.morphs)
    if skin is None or mesh.joints is None:
        rigid = replace(mesh, joints=None, weights=None)

        def pose(time: float) -> Pose:
            return Pose(nodes.world(time / fps)[node], None, nodes.weights(node, keys, time / fps) if keys else None)

        return rigid if mesh.joints is not None else mesh, pose
    joints = file.document.skins[skin].joints
    inverse = file.document.skins[skin].inverseBindMatrices
    bind = np.tile(np.eye(4), (len(joints), 1, 1)) if inverse is None else accessor(file, inverse).astype(np.float64)

    def skinned(time: float) -> Pose:
        world = nodes.world(time / fps)
        here = np.stack([world[joint] for joint in joints]) @ bind
        return Pose(np.eye(4), here, nodes.weights(node, keys, time / fps) if keys else None)

    return mesh, skinned


def _part(file: File, primitive: Any, table: list[Look]) -> Part | None:
    """A primitive's mesh and material; None for points, lines and empty primitives."""
    mode = 4 if primitive.mode is None else primitive.mode
    where = primitive.attributes.get("POSITION")
    if mode < 4 or where is None:
        return None
    positions = accessor(file, where).astype(np.float32)
    indices = (
        np.arange(len(positions)) if primitive.indices is None else accessor(file, primitive.indices).astype(np.int64)
    )
    triangles = _triangles(indices, mode)
    if not len(triangles):
        return None
    look = table[len(table) - 1 if primitive.material is None else primitive.material]
    streams = _streams(file, primitive, look, len(positions))
    keys = _keys(file, primitive, len(positions))
    if "normals" not in streams:
        # The specification asks for flat normals, so no two triangles may share a vertex.
        corner = triangles.reshape(-1)
        positions, keys = positions[corner], {name: values[:, corner] for name, values in keys.items()}
        streams = {name: values[corner] for name, values in streams.items()}
        triangles = np.arange(len(corner)).reshape(-1, 3)
        streams["normals"] = geometry.smooth_normals(positions, triangles.reshape(-1)).astype(np.float32)
        keys.pop("morph_normals", None)
    return Part(
        Mesh(positions=positions, indices=triangles.reshape(-1).astype(np.uint32), **streams, **keys), look.material
    )


def _triangles(indices: Int[ndarray, " m"], mode: int) -> Int[ndarray, "t 3"]:
    """Triangles of a list (4), a strip (5) or a fan (6)."""
    if mode == 4:
        return indices[: len(indices) // 3 * 3].reshape(-1, 3)
    a, b, c = indices[:-2], indices[1:-1], indices[2:]
    if mode == 6:
        return np.stack([np.broadcast_to(indices[:1], b.shape), b, c], axis=1)
    odd = np.arange(len(a)) % 2 == 1
    return np.stack([a, np.where(odd, c, b), np.where(odd, b, c)], axis=1)


def _streams(file: File, primitive: Any, look: Look, count: int) -> dict[str, ndarray]:
    """Normals and tangents where given, texture coordinates, and the four strongest joints of each vertex."""
    streams: dict[str, ndarray] = {}
    for name, field in (("NORMAL", "normals"), ("TANGENT", "tangents")):
        index = primitive.attributes.get(name)
        if index is not None:
            streams[field] = accessor(file, index).astype(np.float32)
    index = primitive.attributes.get(f"TEXCOORD_{look.uv_set}")
    uvs = np.zeros((count, 2), np.float32) if index is None else accessor(file, index).astype(np.float32)
    streams["uvs"] = moved_uvs(uvs, look)
    joints, weights = [], []
    for k in range(8):
        j, w = primitive.attributes.get(f"JOINTS_{k}"), primitive.attributes.get(f"WEIGHTS_{k}")
        if j is None or w is None:
            break
        joints.append(accessor(file, j).astype(np.int64))
        weights.append(accessor(file, w).astype(np.float64))
    if joints:
        streams["joints"], streams["weights"] = _strongest(
            np.concatenate(joints, axis=1), np.concatenate(weights, axis=1)
        )
    return streams


def _strongest(
    joints: Int[ndarray, "n k"], weights: Float[ndarray, "n k"]
) -> tuple[Int[ndarray, "n 4"], Float[ndarray, "n 4"]]:
    """The four largest weights of each vertex, made to sum to one."""
    best = np.argsort(-weights, axis=1, kind="stable")[:, :4]
    kept = np.take_along_axis(weights, best, axis=1)
    total = kept.sum(axis=1, keepdims=True)
    kept = np.where(total > 0, kept / np.where(total > 0, total, 1), [[1.0, 0.0, 0.0, 0.0]])
    return np.take_along_axis(joints, best, axis=1), kept.astype(np.float32)


def _keys(file: File, primitive: Any, count: int) -> dict[str, ndarray]:
    """Shape keys as offsets of positions and, where every key has them, of normals."""
    targets = primitive.targets or []
    if not targets:
        return {}
    keys: dict[str, ndarray] = {}
    for name, field in (("POSITION", "morphs"), ("NORMAL", "morph_normals")):
        found = [target.get(name) for target in targets]
        if name == "POSITION" or all(index is not None for index in found):
            none = np.zeros((count, 3), np.float32)
            keys[field] = np.stack(
                [none if index is None else accessor(file, index).astype(np.float32) for index in found]
            )
    return keys


# Camera, lights, surroundings -----------------------------------------------------------------------------------------


def _extent(instances: list[Instance]) -> tuple[Float[ndarray, "3"], Float[ndarray, "3"]]:
    """(lowest, highest) corner of everything at time 0."""
    points = []
    for one in instances:
        pose = one.pose(0.0)
        placed = geometry.shape(one.mesh, pose).positions if geometry.is_deforming(one.mesh) else one.mesh.positions
        points.append(placed.astype(np.float64) @ pose.matrix[:3, :3].T + pose.matrix[:3, 3])
    return bounds(points)


def _camera(file: File, nodes: Tree, fps: float) -> Camera | None:
    """The first perspective camera of the scene, moving as its node does."""
    for node in nodes.order:
        index = file.document.nodes[node].camera
        lens = None if index is None else file.document.cameras[index].perspective
        if lens is not None:
            return Camera(_followed(nodes, node, fps), float(lens.yfov), float(lens.znear))
    return None


def _followed(nodes: Tree, node: int, fps: float) -> Callable[[float], Float[ndarray, "4 4"]]:
    """World matrix of a node over time in frames, without scaling."""
    return lambda time: rigid(nodes.world(time / fps)[node])


def rigid(matrix: Float[ndarray, "4 4"]) -> Float[ndarray, "4 4"]:
    """The matrix without scaling, as cameras and lights ask for."""
    result = np.eye(4)
    result[:3, :3] = matrix[:3, :3] / np.linalg.norm(matrix[:3, :3], axis=0)
    result[:3, 3] = matrix[:3, 3]
    return result


def _orbit(box: tuple[ndarray, ndarray], fps: float) -> Camera:
    """A camera that circles the box, just far enough away that pictures of 4:3 and wider always hold all of it."""
    middle, slope, lift = (box[0] + box[1]) / 2, np.tan(np.radians(20.0)), np.radians(14.0)
    corners = np.array([[box[i][0], box[j][1], box[k][2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)]) - middle

    def out(angle: float) -> Float[ndarray, "3"]:
        return np.array([np.sin(angle) * np.cos(lift), np.sin(lift), np.cos(angle) * np.cos(lift)])

    away = 0.0
    for angle in np.linspace(0, 2 * np.pi, 48):
        seen = corners @ aim(out(angle), np.zeros(3))[:3, :3]
        reach = np.maximum(np.abs(seen[:, 1]), np.abs(seen[:, 0]) * 0.75) / slope
        away = max(away, 1.05 * float((reach + seen[:, 2]).max()))

    def at(time: float) -> Float[ndarray, "4 4"]:
        return aim(middle + away * out(np.radians(30.0) + 2 * np.pi * time / (ORBIT * fps)), middle)

    return Camera(at, 2 * float(np.arctan(slope)), near=away * 0.01)


def _floor(box: tuple[ndarray, ndarray]) -> Instance:
    """A wide grey floor under the box."""
    middle, reach = (box[0] + box[1]) / 2, 30 * float(np.linalg.norm(box[1] - box[0]))
    low = float(box[0][1]) - 3e-5 * reach
    corners = np.array([(-reach, 0, -reach), (-reach, 0, reach), (reach, 0, reach), (reach, 0, -reach)])
    points = (corners + np.array([middle[0], low, middle[2]])).astype(np.float32)
    up = np.tile(np.array([[0, 1, 0]], np.float32), (4, 1))
    mesh = Mesh(points, up, np.zeros((4, 2), np.float32), np.array([0, 1, 2, 0, 2, 3], np.uint32))
    return Instance(mesh, Material(base_color=(0.32, 0.31, 0.30, 1.0), roughness=0.85))


def _lights(file: File, nodes: Tree, fps: float, box: tuple[ndarray, ndarray]) -> list[Light]:
    """KHR_lights_punctual; lux and candela are kept, and `_exposure` brings them to a picture."""
    table = ((file.document.extensions or {}).get("KHR_lights_punctual") or {}).get("lights", [])
    size, lights = float(np.linalg.norm(box[1] - box[0])), []
    for node in nodes.order:
        entry = (file.document.nodes[node].extensions or {}).get("KHR_lights_punctual")
        if entry is None:
            continue
        given = table[entry["light"]]
        kind = {"directional": "sun"}.get(given["type"], given["type"])
        spot = given.get("spot", {})
        red, green, blue = given.get("color", (1.0, 1.0, 1.0))

        def at(time: float, node: int = node) -> LightPose:
            matrix = rigid(nodes.world(time / fps)[node])
            return LightPose(matrix[:3, 3], -matrix[:3, 2])

        lights.append(
            Light(
                kind,
                (float(red), float(green), float(blue)),
                float(given.get("intensity", 1.0)),
                at,
                radius=0.005 if kind == "sun" else 0.01 * size,
                inner_cone=float(spot.get("innerConeAngle", 0.0)),
                outer_cone=float(spot.get("outerConeAngle", np.pi / 4)),
                reach=float(given.get("range", 20 * size)),
            )
        )
    return lights


def _exposure(lights: list[Light], middle: Float[ndarray, "3"]) -> float:
    """Gain that shows a white surface in the middle, facing the strongest light, at 1.5; 1 without lights."""
    strongest = 0.0
    for light in lights:
        away = 1.0 if light.kind == "sun" else float(np.linalg.norm(light.at(0.0).position - middle))
        strongest = max(strongest, light.intensity * max(light.color) / max(away, 1e-6) ** 2)
    return 1.5 * np.pi / strongest if strongest > 0 else 1.0


def _sun() -> Light:
    pose = LightPose(np.zeros(3), sun_travel(0.85, 0.9 + np.pi))
    return Light("sun", (1.0, 0.94, 0.84), 4.5, lambda time: pose, radius=0.008)


def _sky(lights: list[Light], gain: float) -> Sky:
    """A clear sky around the first sun; `gain` scales it to the lights of the file."""
    suns = [light for light in lights if light.kind == "sun"]
    towards = -suns[0].at(0.0).direction if suns else np.array([0.3, 0.8, 0.5])
    sky = dome((0.33, 0.52, 0.78), (0.80, 0.86, 0.91), (0.52, 0.50, 0.48), towards, (1.2, 1.0, 0.8))
    return Sky((sky * gain).astype(np.float32), sun_disc=bool(suns))
