"""Where lights look: the matrices of shadow maps. Suns have cascades, lamps one map or the six faces of a cube."""

import itertools
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from framecast.render.scene import Light, LightPose
from framecast.render.view import View

Array = np.ndarray

CASCADES = 3
SUN_SIZE = 2048
LAMP_SIZE = 1024
"""Texels along a side of one map."""


class ShadowMap(NamedTuple):
    """One shadow map; the fields of `ShadowMap` in lighting.wgsl."""

    matrix: Array
    """World to clip, 4x4, depth reversed."""
    texel: float
    range: float
    layer: int
    far: float


def sun_maps(
    light: Light, pose: LightPose, view: View, reach: float, ball: tuple[Array, float], first: int
) -> list[ShadowMap]:
    """Cascades that cover the view up to `reach`, nearest first, stored from layer `first` on.

    Each covers a ball around its slice of the view frustum, so its size does not change as the camera turns, and it
    moves in whole texels only: still shadows stand still. `ball` holds the whole scene.
    """
    axes = _axes(pose.direction)
    splits = _splits(view.near, reach)
    maps = []
    for k, (near, far) in enumerate(itertools.pairwise(splits)):
        centre, radius = _slice_ball(view, near, far)
        texel = 2 * radius / (SUN_SIZE - 2)
        local = axes @ centre
        local[:2] = np.round(local[:2] / texel) * texel
        top = float((axes @ ball[0])[2]) + ball[1]
        bottom = top - 2 * ball[1]
        half = SUN_SIZE * texel / 2
        matrix = np.eye(4)
        matrix[0, :3], matrix[0, 3] = axes[0] / half, -local[0] / half
        matrix[1, :3], matrix[1, 3] = axes[1] / half, -local[1] / half
        matrix[2, :3], matrix[2, 3] = axes[2] / (top - bottom), -bottom / (top - bottom)
        maps.append(ShadowMap(matrix, texel, top - bottom, first + k, far))
    return maps


def _splits(near: float, reach: float) -> Array:
    """Distances between cascades: halfway between equal steps and equal ratios."""
    part = np.arange(CASCADES + 1) / CASCADES
    start = max(near, reach / 200)
    distances = 0.35 * (start + (reach - start) * part) + 0.65 * start * (reach / start) ** part
    distances[0] = near
    return distances


def _slice_ball(view: View, near: float, far: float) -> tuple[Array, float]:
    """Smallest ball around a slice of the frustum whose centre is on the axis."""
    p = view.projection
    spread = 1 / p[0, 0] ** 2 + 1 / p[1, 1] ** 2
    depth = min((near + far) * (1 + spread) / 2, far)
    radius = float(np.sqrt((far - depth) ** 2 + far**2 * spread))
    return view.camera[:3, 3] - view.camera[:3, 2] * depth, np.ceil(radius * 64) / 64


def _axes(direction: Array) -> Float[Array, "3 3"]:
    """Rows: right, up and the direction towards the sun."""
    z = -np.asarray(direction, np.float64) / np.linalg.norm(direction)
    helper = np.array([1.0, 0, 0]) if abs(z[0]) < 0.8 else np.array([0, 0, 1.0])
    x = np.cross(helper, z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z])


def lamp_maps(light: Light, pose: LightPose, first: int) -> list[ShadowMap]:
    """One map for a spot, six (+x -x +y -y +z -z) for a point light."""
    near = max(light.radius, 0.02)
    if light.kind == "spot":
        faces, tangent = [_axes(pose.direction)], np.tan(min(light.outer_cone * 1.15, 1.4))
    else:
        signed = [sign * axis for axis in np.eye(3) for sign in (1, -1)]
        faces, tangent = [_axes(direction) for direction in signed], 1.13  # a margin for the taps of soft shadows
    maps = []
    for k, axes in enumerate(faces):
        view = np.eye(4)
        view[:3, :3], view[:3, 3] = axes, -axes @ pose.position
        lens = np.array([[1 / tangent, 0, 0, 0], [0, 1 / tangent, 0, 0], [0, 0, 0, near], [0, 0, -1, 0]])
        maps.append(ShadowMap(lens @ view, 2 * tangent / LAMP_SIZE, near, first + k, 0.0))
    return maps
