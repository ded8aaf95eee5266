"""The fields of `Frame` as another convention stores them: the inverse of `decode.py`, function by function.

Used to export clips and to test importers. What a convention cannot hold (exposure, vectors where nothing was written)
is not brought back.
"""

from collections.abc import Mapping

import numpy as np
import torch
from jaxtyping import Float, Num

from framecast.clip import Layers, Record
from framecast.color import encode_srgb
from framecast.exr import ClipError
from framecast.frame import SKY
from framecast.importers.decode import AXES, jitter_shift, ray_length
from framecast.importers.settings import Color, Depth, Jitter, Motion, Normal, Scalar, Settings, layers


def encode(
    fields: Mapping[str, Num[np.ndarray, "_ _ _"]],
    settings: Settings,
    here: Record,
    previous: Record | None = None,
    following: Record | None = None,
) -> Layers:
    """One frame as stored: channels in the order of the settings, rows as they say, for each buffer that both have.

    Raises:
        ClipError: a conversion that needs a camera and has none.
    """
    out: Layers = {}
    for name in ("color", "albedo"):
        if (color := getattr(settings, name)) and name in fields:
            out[name] = encode_color(fields[name], color)
    if settings.depth and "depth" in fields:
        out["depth"] = encode_depth(fields["depth"], settings.depth, here.projection)
    for name, motion, other in (
        ("motion", settings.motion, previous),
        ("motion_next", settings.motion_next, following),
    ):
        if motion and name in fields:
            out[name] = encode_motion(fields[name], motion, jitter_shift(here, other))
    if settings.normal and "normal" in fields:
        out["normal"] = encode_normal(fields["normal"], settings.normal, settings.axes, here.view)
    for name in ("roughness", "metallic", "object"):
        if (scalar := getattr(settings, name)) and name in fields:
            out[name] = encode_scalar(fields[name], scalar)
    return {name: pixels[:, ::-1] if settings.bottom_up else pixels for name, pixels in out.items()}


def pack(values: Float[np.ndarray, "count h w"], channels: int, packing: str) -> Float[np.ndarray, "n h w"]:
    """Inverse of `decode.unpack` for numbers in 0..1: `channels` numbers of 8 bits (as 0..1) for each."""
    if packing not in ("base255", "base256"):
        return values.astype(np.float32)
    base = 255 if packing == "base255" else 256
    top = base**channels
    whole = np.rint(np.clip(values.astype(np.float64), 0, 1) * top).astype(np.int64)
    whole = np.minimum(whole, top - 1 if packing == "base256" else top)
    digits = []
    for place in range(channels - 1, -1, -1):
        digit = np.minimum(whole // base**place, 255)
        digits.append(digit)
        whole = whole - digit * base**place
    return np.stack(digits, 1).reshape(-1, *values.shape[1:]).astype(np.float32) / 255


def encode_color(linear: Float[np.ndarray, "3 h w"], color: Color) -> Float[np.ndarray, "3 h w"]:
    """Colour in the encoding of the files."""
    pixels = linear.astype(np.float32)
    return encode_srgb(torch.from_numpy(pixels)).numpy() if color.encoding == "srgb" else pixels


def encode_depth(
    z: Float[np.ndarray, "1 h w"], depth: Depth, projection: tuple[tuple[float, ...], ...] | None = None
) -> Float[np.ndarray, "n h w"]:
    """Depth as stored; at the sky what stands for `far`, or for infinity."""
    near, far = depth.near, depth.far
    sky = z >= SKY
    d = np.where(sky, far or np.inf, z.astype(np.float64))
    match depth.kind:
        case "device" | "reversed":
            left = near / d if far is None else near * (far - d) / (d * (far - near))
            v = 1 - left if depth.kind == "device" else left
        case "inverse":
            v = 1 / d
        case "unit":
            assert far is not None  # checked with the settings
            v = (d - near) / (far - near)
        case "euclidean":
            v = np.where(sky, 0, (d - near) * ray_length(z.shape[1:], projection))
        case _:
            v = np.minimum(d, SKY)
    stored = v / depth.scale + depth.bias
    return pack(stored, _digits(depth), depth.packing)


def _digits(layer: Depth | Motion) -> int:
    return len(layer.files) * len(layer.channels) // (2 if isinstance(layer, Motion) else 1)


def encode_motion(
    motion: Float[np.ndarray, "2 h w"], kind: Motion, shift: tuple[float, float] = (0.0, 0.0)
) -> Float[np.ndarray, "n h w"]:
    """Vectors as stored, on files of this size.

    Args:
        shift: jitter of the other frame minus that of this one, for vectors that hold jitter.

    Raises:
        ClipError: vectors without the camera's part, which cannot be told apart here.
    """
    if not kind.camera:
        raise ClipError("vectors without the camera's part cannot be written")
    h, w = motion.shape[1:]
    width, height = kind.size or (w, h)
    unit = {"pixels": (w / width, h / height), "uv": (w, h), "ndc": (w / 2, h / 2)}[kind.units]
    turned = -1.0 if kind.direction in ("previous->current", "next->current") else 1.0
    v = motion.astype(np.float64) - (_column(shift) if kind.jittered else 0)
    v = v / _column(unit) * _column(kind.sign) * turned
    if kind.packing == "unreal_sqrt":
        v = np.sign(v) * np.sqrt(2 * np.abs(v))
    return pack(v / _column(kind.scale) + _column(kind.bias), _digits(kind), kind.packing)


def _column(pair: tuple[float, float]) -> np.ndarray:
    return np.array(pair)[:, None, None]


def encode_normal(
    normal: Float[np.ndarray, "3 h w"],
    kind: Normal,
    axes: str = "opengl",
    view: tuple[tuple[float, ...], ...] | None = None,
) -> Float[np.ndarray, "3 h w"]:
    """Normals as stored; where there is none, 0 before the encoding."""
    if kind.space == "view" and view is None:
        raise ClipError("normals in view space need the camera")
    turn = np.asarray(view)[:3, :3] if kind.space == "view" else AXES[axes].T
    n = np.einsum("ij,jhw->ihw", turn.astype(np.float32), normal.astype(np.float32))
    n = n * np.array(kind.sign, np.float32)[:, None, None]
    return n / 2 + 0.5 if kind.encoded else n


def encode_scalar(values: Num[np.ndarray, "1 h w"], scalar: Scalar) -> Float[np.ndarray, "1 h w"]:
    """values / scale + bias."""
    return (values.astype(np.float64) / scalar.scale + scalar.bias).astype(np.float32)


def encode_jitter(pixels: tuple[float, float], jitter: Jitter, size: tuple[int, int]) -> tuple[float, float]:
    """Sample position minus pixel centre in pixels as the pair that settings name; inverse of `jitter_pixels`."""
    x, y = {"pixels": (1.0, 1.0), "uv": (size[1], size[0]), "ndc": (size[1] / 2, size[0] / 2)}[jitter.units]
    return pixels[0] / jitter.sign[0] / x, pixels[1] / jitter.sign[1] / y


def files(stored: Mapping[str, np.ndarray], settings: Settings, number: int) -> dict[str, dict[str, np.ndarray]]:
    """Channels of the files of one frame, by file name: what `encode` made, laid out as the settings say.

    Frame numbers have four digits. Patterns must not hold `*`.
    """
    out: dict[str, dict[str, np.ndarray]] = {}
    for name, pixels in stored.items():
        layer = layers(settings)[name]
        planes = iter(pixels)
        for pattern in layer.files:
            file = out.setdefault(pattern.replace("{frame}", f"{number - layer.offset:04d}"), {})
            file.update({channel: next(planes) for channel in layer.channels})
    return out
