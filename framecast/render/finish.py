"""Materials out of arrays: 8-bit textures, normal maps from height. Makes no pattern of its own.

Every scene uses these functions, training and held-out alike; the patterns are decided elsewhere. Colours are given in
sRGB, 0..1, the way a palette is picked; `Material` holds linear factors, and textures are stored as sRGB bytes.
"""

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from framecast.render.motion import Numbers
from framecast.render.scene import Material, Texture


def linear(colour: Numbers) -> Float[ndarray, "..."]:
    """Linear light of sRGB values in 0..1 (IEC 61966-2-1)."""
    c = np.asarray(colour, np.float64)
    return np.where(c <= 0.04045, c / 12.92, ((np.maximum(c, 0.0) + 0.055) / 1.055) ** 2.4)


def rgb(code: str) -> Float[ndarray, "3"]:
    """sRGB colour, 0..1, of six hexadecimal digits."""
    return np.array([int(code[k : k + 2], 16) / 255 for k in (0, 2, 4)])


def image(values: Float[ndarray, "h w c"], srgb: bool, repeat: bool = True) -> Texture:
    """8-bit texture of values in 0..1 with 1 to 4 channels; alpha is 1 where not given."""
    height, width, channels = values.shape
    pixels = np.full((height, width, 4), 255, np.uint8)
    pixels[..., :channels] = np.round(np.clip(values, 0, 1) * 255)
    return Texture(pixels=pixels, srgb=srgb, repeat=repeat)


def relief(height: Float[ndarray, "h w"], strength: float) -> Float[ndarray, "h w 3"]:
    """Tangent-space normals, coded to 0..1, of a height that tiles; green points up the image.

    `height` in 0..1 times `strength` is in texels: 1.0 over one texel is a slope of 45 degrees.
    """
    h = height * strength
    across = (np.roll(h, -1, 1) - np.roll(h, 1, 1)) / 2
    down = (np.roll(h, -1, 0) - np.roll(h, 1, 0)) / 2
    normal = np.stack([-across, down, np.ones_like(h)], axis=-1)
    return normal / np.linalg.norm(normal, axis=-1, keepdims=True) * 0.5 + 0.5


def textured(
    colour: Float[ndarray, "h w c"],
    height: Float[ndarray, "h w"] | None = None,
    strength: float = 4.0,
    roughness: float | Float[ndarray, "h w"] = 0.8,
    metallic: float | Float[ndarray, "h w"] = 0.0,
    emission: Float[ndarray, "h w 3"] | None = None,
    glow: float = 1.0,
    mask: bool = False,
) -> Material:
    """Material of tiling arrays: sRGB `colour` (4 channels with `mask`: alpha-tested at 0.5, seen from both sides),
    `height` for the normal map, roughness and metallic as numbers or maps, sRGB `emission` times `glow`.
    """
    maps = isinstance(roughness, ndarray) or isinstance(metallic, ndarray)
    shape = colour.shape[:2]
    surface = None
    if maps:
        layers = [np.zeros(shape), np.broadcast_to(roughness, shape), np.broadcast_to(metallic, shape)]
        surface = image(np.stack(layers, axis=-1), srgb=False)
    return Material(
        base_texture=image(colour, srgb=True),
        normal_texture=None if height is None else image(relief(height, strength), srgb=False),
        roughness=1.0 if maps else float(roughness),
        metallic=1.0 if maps else float(metallic),
        roughness_metallic_texture=surface,
        emissive=(glow, glow, glow) if emission is not None else (0.0, 0.0, 0.0),
        emissive_texture=None if emission is None else image(emission, srgb=True),
        alpha_mode="mask" if mask else "opaque",
        double_sided=mask,
    )


def plain(
    colour: Numbers, roughness: float = 0.5, metallic: float = 0.0, glow: float = 0.0, both: bool = False
) -> Material:
    """Material of one sRGB colour; with `glow` it also emits that colour times `glow`."""
    r, g, b = (float(c) for c in linear(colour))
    return Material(
        base_color=(r, g, b, 1.0),
        roughness=roughness,
        metallic=metallic,
        emissive=(r * glow, g * glow, b * glow),
        double_sided=both,
    )


def mix(a: Numbers, b: Numbers, t: Float[ndarray, "h w"]) -> Float[ndarray, "h w c"]:
    """Colours from `a` (t = 0) to `b` (t = 1), per pixel."""
    t = np.clip(t, 0, 1)[..., None]
    return np.asarray(a) * (1 - t) + np.asarray(b) * t


def step(values: Float[ndarray, "h w"], low: float, high: float) -> Float[ndarray, "h w"]:
    """Smooth 0..1 between the two thresholds, which may run backwards."""
    t = np.clip((values - low) / (high - low), 0, 1)
    return t * t * (3 - 2 * t)


def pixel_grid(size: int) -> tuple[Float[ndarray, "h w"], Float[ndarray, "h w"]]:
    """(x, y) of the pixel centres of a square image, each 0..1, y down."""
    axis = (np.arange(size) + 0.5) / size
    x, y = np.meshgrid(axis, axis)
    return x, y
