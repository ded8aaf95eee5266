"""Image-based light: what the shaders need to know of a sky beforehand, computed once per scene in numpy."""

import functools
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from framecast.render import device
from framecast.render.scene import Sky

Array = np.ndarray

ROUGH = 6
"""Blurred skies, for roughness 1/6, 2/6 … 1. lighting.wgsl has the same number."""
TABLE = (32, 64)
"""Height and width of every layer of the environment texture."""


class Environment(NamedTuple):
    """Textures of a sky on the GPU."""

    sky: Any
    ambient: Any
    environment: Any
    """Layers: ROUGH blurred skies, irradiance / pi, and the split-sum table (columns n.v, rows roughness)."""


@functools.lru_cache(maxsize=4)
def environment(sky: Sky) -> Environment:
    """Uploads a sky and its blurred forms."""
    ambient = sky.radiance if sky.ambient is None else sky.ambient
    coarse = shrink(ambient.astype(np.float64), 48, 96)
    blurred = [blur(coarse, (k + 1) / ROUGH) for k in range(ROUGH)]
    layers = np.concatenate([*blurred, irradiance(coarse), split_sum()])
    sky_texture = device.upload([_rgba(sky.radiance)], "rgba16float")
    ambient_texture = sky_texture if sky.ambient is None else device.upload([_rgba(ambient)], "rgba16float")
    return Environment(sky_texture, ambient_texture, device.upload([_rgba(layers)], "rgba16float", layers=ROUGH + 2))


def _rgba(image: Array) -> Array:
    padded = np.ones((*image.shape[:2], 4), np.float32)
    padded[..., : image.shape[2]] = image
    return padded.clip(-6e4, 6e4)


def shrink(image: Float[Array, "h w c"], height: int, width: int) -> Float[Array, "h2 w2 c"]:
    """Mean over boxes, of any size ratio: weights are the overlaps of old and new pixels."""
    rows, columns = _overlap(image.shape[0], height), _overlap(image.shape[1], width)
    return np.einsum("ij,jkc,lk->ilc", rows, image, columns, optimize=True)


def _overlap(old: int, new: int) -> Array:
    edges_old, edges_new = np.arange(old + 1) / old, np.arange(new + 1) / new
    low = np.maximum(edges_new[:-1, None], edges_old[None, :-1])
    high = np.minimum(edges_new[1:, None], edges_old[None, 1:])
    return np.maximum(high - low, 0) * new


def directions(height: int, width: int) -> Float[Array, "n 3"]:
    """Unit directions of the pixel centres of an equirectangular image, row by row."""
    polar = (np.arange(height)[:, None] + 0.5) / height * np.pi
    azimuth = ((np.arange(width)[None, :] + 0.5) / width - 0.5) * 2 * np.pi
    x, z = np.sin(polar) * np.sin(azimuth), -np.sin(polar) * np.cos(azimuth)
    return np.stack([x, np.broadcast_to(np.cos(polar), x.shape), z], -1).reshape(-1, 3)


def _solid_angles(height: int, width: int) -> Float[Array, " n"]:
    edges = np.cos(np.arange(height + 1) / height * np.pi)
    return np.repeat((edges[:-1] - edges[1:]) * 2 * np.pi / width, width)


@functools.lru_cache(maxsize=1)
def _cosines(height: int, width: int) -> tuple[Array, Array]:
    """Cosines between the directions of a layer and those of an image, and the solid angles of the latter, float32."""
    cosine = directions(*TABLE).astype(np.float32) @ directions(height, width).astype(np.float32).T
    return cosine, _solid_angles(height, width).astype(np.float32)


def _weighted(image: Float[Array, "h w 3"], weight: Float[Array, "n m"]) -> Float[Array, "32 64 3"]:
    mean = weight @ image.reshape(-1, 3).astype(np.float32) / weight.sum(1, keepdims=True)
    return mean.reshape(*TABLE, 3)


def blur(image: Float[Array, "h w 3"], roughness: float) -> Float[Array, "32 64 3"]:
    """The image as a rough reflector sees it that is looked at from straight above (the split-sum approximation).

    Every light direction weighs D(h) n.l, D the GGX distribution for alpha = roughness^2.
    """
    cosine, solid = _cosines(*image.shape[:2])
    spread = 1 - (1 - np.float32(roughness**4)) * (1 + cosine) / 2
    return _weighted(image, np.maximum(cosine, 0) / (spread * spread) * solid)


def irradiance(image: Float[Array, "h w 3"]) -> Float[Array, "32 64 3"]:
    """Irradiance / pi of surfaces facing each direction: a uniform sky gives its own radiance."""
    cosine, solid = _cosines(*image.shape[:2])
    return _weighted(image, np.maximum(cosine, 0) * solid)


@functools.cache
def split_sum() -> Float[Array, "32 64 3"]:
    """Scale and offset of f0 for the light that GGX reflects of a uniform sky; columns n.v in 0..1, rows roughness in
    0..1.

    1024 half vectors a cell, drawn in proportion to D(h) n.h from a Hammersley set; height-correlated Smith masking.
    """
    count = 1024
    u = (np.arange(count) + 0.5) / count
    bits = np.array([int(f"{k:010b}"[::-1], 2) for k in range(count)]) / count
    rough, nv = np.meshgrid(np.linspace(0, 1, TABLE[0]), np.linspace(0, 1, TABLE[1]), indexing="ij")
    alpha2, nv = np.maximum(rough, 0.02)[..., None] ** 4, np.maximum(nv, 1e-3)[..., None]
    cos2 = (1 - u) / (1 + (alpha2 - 1) * u)
    nh, sin_h = np.sqrt(cos2), np.sqrt(1 - cos2)
    vh = nv * nh + np.sqrt(1 - nv**2) * sin_h * np.cos(2 * np.pi * bits)
    nl = 2 * vh * nh - nv
    mask_l = nv * np.sqrt(np.maximum(nl, 0) ** 2 * (1 - alpha2) + alpha2)
    mask_v = np.maximum(nl, 0) * np.sqrt(nv**2 * (1 - alpha2) + alpha2)
    visibility = 2 * np.maximum(nl, 0) * np.maximum(vh, 0) / (nh * (mask_l + mask_v) + 1e-12)
    visibility = np.where((nl > 0) & (vh > 0), visibility, 0)
    fresnel = (1 - np.clip(vh, 0, 1)) ** 5
    table = np.stack([(visibility * (1 - fresnel)).mean(-1), (visibility * fresnel).mean(-1), np.zeros(TABLE)], -1)
    return (table / np.maximum(table.sum(-1, keepdims=True), 1)).astype(np.float32)
