"""Light from far away: a clear dome of three colours with the glow around a sun, and even light for rooms.

Shared by every scene; clouds, hills and skylines are textures and belong to the training or the held-out scenes. Images
are equirectangular, linear radiance: the top row looks to +y, the middle column to -z, columns run towards +x.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from framecast.render.finish import linear
from framecast.render.motion import Numbers, unit


def directions(height: int) -> Float[ndarray, "h w 3"]:
    """Unit vectors that the pixels of a dome image of `height` x 2 `height` look along."""
    down = (np.arange(height) + 0.5) / height * np.pi
    around = ((np.arange(2 * height) + 0.5) / (2 * height) - 0.5) * 2 * np.pi
    down, around = np.meshgrid(down, around, indexing="ij")
    return np.stack([np.sin(down) * np.sin(around), np.cos(down), -np.sin(down) * np.cos(around)], axis=-1)


def dome(
    zenith: Numbers, horizon: Numbers, ground: Numbers, sun: Numbers, glow: Numbers, height: int = 320
) -> Float[ndarray, "h w 3"]:
    """Sky over ground of the sRGB colours given,
    with the light `glow` (linear) scattered around the direction `sun`.
    """
    look = directions(height)
    up = look[..., 1:2]
    sky = linear(horizon) + (linear(zenith) - linear(horizon)) * np.clip(up, 0, 1) ** 0.5
    near_sun = np.clip(look @ unit(sun), 0, 1)[..., None]
    scattered = np.asarray(glow) * (0.25 * near_sun**4 + 0.75 * near_sun**40) * np.exp(-3 * np.clip(up, 0, 1))
    blend = np.clip(up * 25 + 0.5, 0, 1)
    return (linear(ground) * (1 - blend) + (sky + scattered) * blend).astype(np.float32)


def room(
    ceiling: Numbers,
    walls: Numbers,
    floor: Numbers,
    lamps: Sequence[tuple[Numbers, float, float]] = (),
    height: int = 48,
) -> Float[ndarray, "h w 3"]:
    """Even light of a closed room (linear radiance from above, the sides, below), as the ambient image of a sky.

    `lamps` are bright discs that polished things reflect: (direction, cosine of the half angle, radiance).
    """
    look = directions(height)
    up = look[..., 1:2]
    top, low = np.clip(up, 0, 1) ** 0.7, np.clip(-up, 0, 1) ** 0.7
    light = np.asarray(ceiling) * top + np.asarray(floor) * low + np.asarray(walls) * (1 - top - low)
    for where, cosine, radiance in lamps:
        light = light + radiance * np.clip((look @ unit(where) - cosine) / (1 - cosine) * 2, 0, 1)[..., None]
    return np.maximum(light, 0.0).astype(np.float32)


def sun_travel(elevation: float, azimuth: float) -> Float[ndarray, "3"]:
    """Direction in which light travels from a sun at `elevation` and `azimuth` (0 = -z, towards +x), radians."""
    return -np.array([np.cos(elevation) * np.sin(azimuth), np.sin(elevation), -np.cos(elevation) * np.cos(azimuth)])
