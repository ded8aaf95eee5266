"""Array maths on triangle meshes: shading normals, placing, joining. Makes no shape of its own.

Every scene uses these functions, training and held-out alike; what a thing looks like is decided elsewhere.
Positions are metres, right-handed, y up. Matrices are column-vector matrices, `p' = M @ p`.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from framecast.render.scene import Instance, Material, Mesh


def shaded(
    positions: Float[ndarray, "n 3"], uvs: Float[ndarray, "n 2"], triangles: Int[ndarray, "t 3"], crease: float = 40.0
) -> Mesh:
    """The mesh with normals that are smooth across edges flatter than `crease` degrees and sharp across the others.

    Corners at the same position share a normal where their faces agree, whatever their texture coordinates, so that
    seams do not show. Faces without area are dropped.
    """
    face = np.cross(
        positions[triangles[:, 1]] - positions[triangles[:, 0]], positions[triangles[:, 2]] - positions[triangles[:, 0]]
    )
    size = np.linalg.norm(face, axis=1)
    extent = float(np.ptp(positions, axis=0).max()) if len(positions) else 1.0
    keep = size > 1e-12 * extent * extent
    triangles, face, size = triangles[keep], face[keep], size[keep]
    corner = triangles.reshape(-1)
    weld = unique_rows(np.round(positions / (extent * 1e-6)).astype(np.int64))[1][corner]
    weighted = (face[:, None] * corner_angles(positions[triangles])[..., None]).reshape(-1, 3)
    normals = crease_normals(weld, weighted, np.repeat(face / size[:, None], 3, axis=0), crease)
    key = np.column_stack([corner, np.round(normals * 1000)]).astype(np.int64)
    first, inverse = unique_rows(key)
    return Mesh(
        positions=positions[corner[first]].astype(np.float32),
        normals=normals[first].astype(np.float32),
        uvs=uvs[corner[first]].astype(np.float32),
        indices=inverse.astype(np.uint32),
    )


def corner_angles(corners: Float[ndarray, "t 3 3"]) -> Float[ndarray, "t 3"]:
    """Angle of each triangle at each of its corners, radians.

    As weights, with the area, they make normals independent of which way quads are cut in two.
    """
    ahead, behind = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
    cosine = np.einsum("tkc,tkc->tk", ahead, behind)
    length = np.linalg.norm(ahead, axis=2) * np.linalg.norm(behind, axis=2)
    return np.arccos(np.clip(cosine / np.maximum(length, 1e-30), -1, 1))


def unique_rows(rows: Int[ndarray, "n k"]) -> tuple[Int[ndarray, " u"], Int[ndarray, " n"]]:
    """(a row's index for each distinct row, the distinct row of each row)."""
    order = np.lexsort(rows.T)
    new = np.ones(len(rows), bool)
    new[1:] = (rows[order[1:]] != rows[order[:-1]]).any(axis=1)
    inverse = np.empty(len(rows), np.int64)
    inverse[order] = np.cumsum(new) - 1
    return order[new], inverse


def crease_normals(
    weld: Int[ndarray, " n"], weighted: Float[ndarray, "n 3"], unit: Float[ndarray, "n 3"], crease: float
) -> Float[ndarray, "n 3"]:
    """Unit normal per corner: the sum of `weighted` over corners of the same `weld` whose faces meet within
    `crease`.
    """
    order = np.argsort(weld, kind="stable")
    starts = np.flatnonzero(np.diff(weld[order], prepend=-1))
    counts = np.diff(np.append(starts, len(order)))
    start, count = np.repeat(starts, counts), np.repeat(counts, counts)
    flat, area = unit[order], weighted[order]
    total = np.zeros_like(area)
    limit = np.cos(np.radians(crease)) - 1e-6
    for k in range(int(counts.max(initial=0))):
        mine = np.flatnonzero(count > k)
        other = start[mine] + k
        agree = np.einsum("nc,nc->n", flat[mine], flat[other]) >= limit
        total[mine[agree]] += area[other[agree]]
    result = np.empty_like(total)
    result[order] = total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-30)
    return result


def grid_triangles(rows: int, columns: int) -> Int[ndarray, "t 3"]:
    """Two triangles for every cell of a `rows` x `columns` lattice of points, row-major;
    (rows down) x (columns) faces.
    """
    a = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)[None]).reshape(-1)
    quad = np.stack([a, a + columns, a + columns + 1, a, a + columns + 1, a + 1], axis=1)
    return quad.reshape(-1, 3).astype(np.int64)


def from_grid(points: Float[ndarray, "r c 3"], uvs: Float[ndarray, "r c 2"], crease: float = 40.0) -> Mesh:
    """Mesh over a lattice of points; it faces (down the rows) x (along the columns)."""
    rows, columns = points.shape[:2]
    return shaded(points.reshape(-1, 3), uvs.reshape(-1, 2), grid_triangles(rows, columns), crease)


def join(meshes: Sequence[Mesh]) -> Mesh:
    """One mesh out of several; skins and shape keys are not carried."""
    counts = np.cumsum([0] + [len(mesh.positions) for mesh in meshes[:-1]])
    return Mesh(
        positions=np.concatenate([mesh.positions for mesh in meshes]),
        normals=np.concatenate([mesh.normals for mesh in meshes]),
        uvs=np.concatenate([mesh.uvs for mesh in meshes]),
        indices=np.concatenate([mesh.indices + np.uint32(n) for mesh, n in zip(meshes, counts, strict=True)]),
    )


def placed(mesh: Mesh, *matrices: Float[ndarray, "4 4"]) -> Mesh:
    """The mesh moved by the product of the matrices;
    a mirroring product turns the triangles so that they still face out.
    """
    matrix = np.linalg.multi_dot([np.eye(4), np.eye(4), *matrices])
    linear = matrix[:3, :3]
    normals = mesh.normals @ np.linalg.inv(linear)
    normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    indices = mesh.indices
    if np.linalg.det(linear) < 0:
        indices = indices.reshape(-1, 3)[:, ::-1].reshape(-1)
    return replace(
        mesh,
        positions=(mesh.positions @ linear.T + matrix[:3, 3]).astype(np.float32),
        normals=normals.astype(np.float32),
        indices=indices,
    )


def scattered(mesh: Mesh, matrices: Sequence[Float[ndarray, "4 4"]]) -> Mesh:
    """One mesh holding a copy of `mesh` at each matrix."""
    return join([placed(mesh, matrix) for matrix in matrices])


def box_uvs(mesh: Mesh, size: float) -> Mesh:
    """Texture coordinates by the dominant axis of the normal: one repeat of the texture covers `size` metres."""
    axis = np.abs(mesh.normals).argmax(axis=1)
    p = mesh.positions
    options = np.stack([p[:, [2, 1]], p[:, [0, 2]], p[:, [0, 1]]])
    return replace(mesh, uvs=(options[axis, np.arange(len(p))] / size).astype(np.float32))


def standing(parts: Sequence[tuple[Mesh, Material]]) -> list[Instance]:
    """The static world: one instance per material, holding all parts made of it."""
    groups: dict[int, tuple[Material, list[Mesh]]] = {}
    for mesh, material in parts:
        groups.setdefault(id(material), (material, []))[1].append(mesh)
    return [Instance(join(meshes), material) for material, meshes in groups.values()]
