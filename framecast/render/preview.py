"""A contact sheet: every buffer of a frame, made visible, on one picture."""

import math
from collections.abc import Mapping

import numpy as np
import torch
from jaxtyping import Float, UInt8
from PIL import Image, ImageDraw

from framecast import color
from framecast.frame import SKY

Array = np.ndarray


def shown(name: str, pixels: Float[Array, "c h w"]) -> UInt8[Array, "h w 3"]:
    """One layer as a picture: colours as displayed, depth inverted, motion as hue and strength, ids as hues."""
    if name in ("color", "reference", "albedo"):
        picture = color.to_display(torch.from_numpy(np.ascontiguousarray(pixels, np.float32))).numpy()
    elif name.startswith("depth"):
        inverse = np.where(pixels < SKY, 1 / np.maximum(pixels, 1e-6), 0)
        picture = np.repeat(np.sqrt(inverse / max(float(np.quantile(inverse, 0.98)), 1e-6)), 3, 0)
    elif name.startswith("motion"):
        picture = _hues(np.arctan2(pixels[1], pixels[0]) / (2 * np.pi) % 1, _lengths(pixels))
    elif name == "object":
        picture = _hues(pixels[0] * 0.618034 % 1, (pixels[0] > 0) * 0.8)
    elif "normal" in name and len(pixels) == 3:
        picture = pixels / 2 + 0.5
    else:
        picture = np.repeat(pixels[:1], 3, 0)
    return (np.clip(picture, 0, 1) * 255 + 0.5).astype(np.uint8).transpose(1, 2, 0)


def _lengths(motion: Array) -> Array:
    length = np.hypot(motion[0], motion[1])
    return np.clip(length / max(float(np.quantile(length, 0.98)), 1.0), 0, 1) ** 0.6


def _hues(turn: Array, strength: Array) -> Array:
    """Hue in turns, on grey where strength is 0."""
    wheel = np.stack([0.5 + 0.5 * np.cos(2 * np.pi * (turn - shift / 3)) for shift in range(3)])
    return 0.12 * (1 - strength) + wheel * strength


def sheet(layers: Mapping[str, Array], title: str, columns: int = 4) -> Image.Image:
    """All layers (`c h w`, of any sizes) side by side, each scaled to the size of the first, with names."""
    height, width = next(iter(layers.values())).shape[-2:]
    bar = 18
    rows = math.ceil(len(layers) / columns)
    page = Image.new("RGB", (columns * width, rows * (height + bar) + bar), (24, 24, 27))
    pen = ImageDraw.Draw(page)
    pen.text((6, 3), title, fill=(235, 235, 235))
    for k, (name, pixels) in enumerate(layers.items()):
        x, y = k % columns * width, bar + k // columns * (height + bar)
        picture = Image.fromarray(shown(name, np.asarray(pixels, np.float32)))
        page.paste(picture.resize((width, height), Image.Resampling.BOX), (x, y + bar))
        pen.text((x + 6, y + 3), name, fill=(200, 200, 205))
    return page
