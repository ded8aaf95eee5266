"""Meshes as they are at one time: morphing, skinning, normals, tangents. All in numpy.

Done on the CPU in double precision: characters are small, every frame needs one new pose only (the earlier ones are
kept), and the true earlier positions, not chained motion, are what makes `motion2` exact.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Integer

from framecast.render.scene import Mesh, Pose

Array = np.ndarray


class Shape(NamedTuple):
    """A mesh in the space that its pose's matrix takes to the world."""

    positions: Array
    """n 3 float32."""
    attributes: Array
    """n 9 float32: normal, tangent with sign, uv."""


def is_deforming(mesh: Mesh) -> bool:
    """Whether vertices move against each other."""
    return mesh.joints is not None or mesh.morphs is not None


def normalize(v: Float[Array, "*n c"]) -> Float[Array, "*n c"]:
    """Unit vectors; zero stays zero."""
    return v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-20)


def smooth_normals(positions: Float[Array, "n 3"], indices: Integer[Array, " m"]) -> Float[Array, "n 3"]:
    """Vertex normals as area-weighted means of the triangles around each vertex."""
    corners = positions[indices.reshape(-1, 3)]
    faces = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    total = np.stack([np.bincount(indices, np.repeat(faces[:, c], 3), len(positions)) for c in range(3)], 1)
    return normalize(total)


def tangents(mesh: Mesh, positions: Float[Array, "n 3"], normals: Float[Array, "n 3"]) -> Float[Array, "n 4"]:
    """Unit directions of growing u, at right angles to the normals, and the bitangent's sign.

    The bitangent `sign * cross(normal, tangent)` points to *decreasing* v, up in the image, as glTF's green-up normal
    maps expect. Where the uvs say nothing, any direction at right angles to the normal.
    """
    triangles = mesh.indices.reshape(-1, 3)
    p, uv = positions[triangles], mesh.uvs[triangles]
    e1, e2, d1, d2 = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0], uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    area = d1[:, 0] * d2[:, 1] - d2[:, 0] * d1[:, 1]
    scale = np.where(np.abs(area) > 1e-20, 1 / np.where(area == 0, 1, area), 0)[:, None]
    along_u = (e1 * d2[:, 1:] - e2 * d1[:, 1:]) * scale
    along_v = (e2 * d1[:, :1] - e1 * d2[:, :1]) * scale
    u, v = (
        np.stack([np.bincount(mesh.indices, np.repeat(a[:, c], 3), len(positions)) for c in range(3)], 1)
        for a in (along_u, along_v)
    )
    side = np.where(np.abs(normals[:, :1]) > 0.9, [[0.0, 1, 0]], [[1.0, 0, 0]])
    u = np.where(np.linalg.norm(u, axis=1, keepdims=True) > 1e-12, u, side)
    u = normalize(u - normals * np.sum(u * normals, 1, keepdims=True))
    sign = np.where(np.sum(np.cross(normals, u) * v, 1) > 0, -1.0, 1.0)
    return np.concatenate([u, sign[:, None]], 1)


def shape(mesh: Mesh, pose: Pose) -> Shape:
    """Morphs and skins a mesh. Raises ValueError where the pose does not fit the mesh."""
    positions, normals = mesh.positions.astype(np.float64), mesh.normals.astype(np.float64)
    if mesh.morphs is not None:
        positions, normals = _morphed(mesh, pose, positions, normals)
    tangent = mesh.tangents if mesh.tangents is not None else tangents(mesh, positions, normals)
    tangent = tangent.astype(np.float64)
    if mesh.joints is not None and mesh.weights is not None:
        if pose.joints is None:
            raise ValueError("a skinned mesh needs a pose with joints")
        blend = np.einsum("nk,nkij->nij", mesh.weights.astype(np.float64), pose.joints[mesh.joints][:, :, :3])
        positions = np.einsum("nij,nj->ni", blend[:, :, :3], positions) + blend[:, :, 3]
        normals = normalize(np.einsum("nij,nj->ni", _cofactors(blend[:, :, :3]), normals))
        turned = normalize(np.einsum("nij,nj->ni", blend[:, :, :3], tangent[:, :3]))
        tangent = np.concatenate([turned, tangent[:, 3:]], 1)
    attributes = np.concatenate([normals, tangent, mesh.uvs], 1)
    return Shape(positions.astype(np.float32), attributes.astype(np.float32))


def _morphed(mesh: Mesh, pose: Pose, positions: Array, normals: Array) -> tuple[Array, Array]:
    if pose.morph_weights is None or mesh.morphs is None:
        raise ValueError("a mesh with morph targets needs a pose with morph_weights")
    positions = positions + np.tensordot(pose.morph_weights, mesh.morphs, 1)
    if mesh.morph_normals is None:
        return positions, smooth_normals(positions, mesh.indices)
    return positions, normalize(normals + np.tensordot(pose.morph_weights, mesh.morph_normals, 1))


def _cofactors(m: Float[Array, "n 3 3"]) -> Float[Array, "n 3 3"]:
    """Inverse transposes up to a positive factor where the matrices do not mirror: they take normals along."""
    x, y, z = m[:, :, 0], m[:, :, 1], m[:, :, 2]
    return np.stack([np.cross(y, z), np.cross(z, x), np.cross(x, y)], 2)
