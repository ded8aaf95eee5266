"""What stored numbers mean: raw layers and `Settings` in, the fields of `Frame` out. Pure functions on arrays `c h w`.

`decode` is all of them for one frame; `encode.py` undoes each. NaN stays NaN, so that a clip can name it.
"""

from collections.abc import Mapping

import numpy as np
import torch
from jaxtyping import Float, Num
from torch import Tensor

from framecast.clip import Layers, Record
from framecast.color import decode_srgb
from framecast.exr import ClipError
from framecast.frame import SKY, Frame, camera_motion, world_position
from framecast.importers.settings import Color, Depth, Jitter, Motion, Normal, Scalar, Settings

AXES: dict[str, np.ndarray] = {
    "opengl": np.eye(3),
    "unreal": np.array([[0.0, 1, 0], [0, 0, 1], [-1, 0, 0]]),
    "unity": np.diag([1.0, 1, -1]),
    "directx": np.diag([1.0, 1, -1]),
}
"""Matrix from the world axes of a source to ours; those of left-handed worlds mirror."""

MARKER = 1.5
"""Length from which on a normal is no normal but the mark of a background, such as (-1, -1, -1)."""


def decode(
    stored: Mapping[str, Num[np.ndarray, "_ _ _"]],
    settings: Settings,
    here: Record,
    previous: Record | None = None,
    following: Record | None = None,
) -> Layers:
    """One frame: numbers as stored, by field name, to the fields of `Frame`.

    Layers of another size than colour (than the first one where there is none) take the nearest pixel of it, with
    vectors scaled accordingly. View-space normals are left out where the record has no camera.

    Args:
        stored: `c h w` for each buffer, rows and channels as the settings say, 8 and 16-bit pixels as 0..1.
        here, previous, following: jitter and cameras of the frame and its neighbours; None: beyond the end.
            `here.exposure` is what colour shall hold, `here.extra["exposure"]` what it holds in the file.

    Raises:
        ClipError: sizes of different shape, or a conversion that needs cameras or a field of view and has none.
    """
    raw = {name: _picture(pixels, settings) for name, pixels in stored.items()}
    if not raw:
        return {}
    sizes = {name: (pixels.shape[1], pixels.shape[2]) for name, pixels in raw.items()}
    size = sizes.get("color", next(iter(sizes.values())))
    out: Layers = {}
    if settings.color and "color" in raw:
        even = here.exposure / here.extra.get("exposure", here.exposure)
        out["color"] = decode_color(_fit(raw["color"], size), settings.color, even)
    if settings.albedo and "albedo" in raw:
        out["albedo"] = decode_color(_fit(raw["albedo"], size), settings.albedo)
    if settings.depth and "depth" in raw:
        out["depth"] = decode_depth(_fit(raw["depth"], size), settings.depth, here.projection)
    for name, vectors, other in (
        ("motion", settings.motion, previous),
        ("motion_next", settings.motion_next, following),
    ):
        if vectors and name in raw:
            own = (raw[name].shape[1], raw[name].shape[2])
            partial = vectors.unwritten is not None or not vectors.camera
            there = _camera_part(out.get("depth"), here, other) if partial else None
            out[name] = decode_motion(_fit(raw[name], size), vectors, own, jitter_shift(here, other), there)
    if "motion" not in out and settings.cameras and settings.cameras.motion:
        still = _camera_part(out.get("depth"), here, previous)
        out |= {} if still is None else {"motion": still.astype(np.float32)}
    if settings.normal and "normal" in raw:
        normal = decode_normal(_fit(raw["normal"], size), settings.normal, settings.axes, here.view)
        if normal is not None:
            out["normal"] = np.where(out["depth"] < SKY, normal, 0) if "depth" in out else normal
    for name in ("roughness", "metallic", "object"):
        scalar = getattr(settings, name)
        if scalar and name in raw:
            values = decode_scalar(_fit(raw[name], size), scalar)
            out[name] = ids(values) if name == "object" else values
    return out


def picture_size(sizes: Mapping[str, tuple[int, int]], settings: Settings) -> tuple[int, int]:
    """Height and width of the frames that files of these sizes make: of colour, else of the first, after cropping."""
    height, width = sizes.get("color", next(iter(sizes.values())))
    columns, rows = settings.crop or (width, height)
    return min(height, rows), min(width, columns)


def _picture(pixels: np.ndarray, settings: Settings) -> np.ndarray:
    """Rows from the top, without padding."""
    pixels = pixels[:, ::-1] if settings.bottom_up else pixels
    width, height = settings.crop or (pixels.shape[2], pixels.shape[1])
    return pixels[:, :height, :width]


def _fit(pixels: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """The nearest pixel for each of an image of `size`; the shape may differ by rounding only."""
    h, w = pixels.shape[1:]
    if (h, w) == size:
        return pixels
    if abs(h * size[1] - w * size[0]) > max(h, w, *size):
        raise ClipError(
            f"layers of {w}x{h} and of {size[1]}x{size[0]} pixels do not show the same picture; "
            f"say which part of larger files is the picture (crop), or export one size"
        )
    rows = ((np.arange(size[0]) + 0.5) * h / size[0]).astype(int)
    columns = ((np.arange(size[1]) + 0.5) * w / size[1]).astype(int)
    return pixels[:, rows][:, :, columns]


def unpack(stored: Num[np.ndarray, "n h w"], count: int, packing: str) -> Float[np.ndarray, "count h w"]:
    """`count` numbers a pixel out of n channels, of which n / count make one number, most significant first.

    base255: the sum of byte_k / 255^(k + 1); base256 likewise; bytes are given as 0..1. Otherwise as they are.
    """
    if packing not in ("base255", "base256"):
        return stored.astype(np.float32)
    bytes_ = np.rint(stored.astype(np.float64) * 255).reshape(count, -1, *stored.shape[1:])
    base = 255.0 if packing == "base255" else 256.0
    weights = base ** -np.arange(1.0, bytes_.shape[1] + 1)
    packed: np.ndarray = np.einsum("ckhw,k->chw", bytes_, weights)
    return packed


def decode_color(stored: Num[np.ndarray, "3 h w"], color: Color, even: float = 1.0) -> Float[np.ndarray, "3 h w"]:
    """Linear colour, at least 0, times `even`."""
    pixels = stored.astype(np.float32)
    if color.encoding == "srgb":
        pixels = decode_srgb(torch.from_numpy(np.ascontiguousarray(pixels))).numpy()
    return np.where(np.isneginf(pixels), pixels, np.maximum(pixels, 0) * np.float32(even))


def decode_depth(
    stored: Num[np.ndarray, "n h w"],
    depth: Depth,
    projection: tuple[tuple[float, ...], ...] | None = None,
) -> Float[np.ndarray, "1 h w"]:
    """Distance along the view axis; SKY where nothing was hit: at `far`, at infinity, and at 0 or less.

    Raises:
        ClipError: euclidean depth without a projection.
    """
    v = (unpack(stored, 1, depth.packing).astype(np.float64) - depth.bias) * depth.scale
    near, far = depth.near, depth.far
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        match depth.kind:
            case "device" | "reversed":
                left = 1 - v if depth.kind == "device" else v
                z = near / left if far is None else near * far / (near + left * (far - near))
                z = np.where(left < 0, np.inf, z)
            case "inverse":
                z = np.where(v > 0, 1 / v, np.inf)
            case "unit":
                assert far is not None  # checked with the settings
                z = near + v * (far - near)
            case "euclidean":
                z = np.where(v > 0, v / ray_length(v.shape[1:], projection) + near, np.inf)
            case _:
                z = v
    beyond = (z <= 0) | (z >= (np.inf if far is None else far * (1 - 1e-6)))
    out: np.ndarray = np.where(np.isnan(z), z, np.where(beyond, SKY, np.minimum(z, SKY))).astype(np.float32)
    return out


def ray_length(size: tuple[int, ...], projection: tuple[tuple[float, ...], ...] | None) -> Float[np.ndarray, "1 h w"]:
    """Length of the ray through each pixel centre that advances by 1 along the view axis; 1 where rays are parallel.

    Raises:
        ClipError: no projection.
    """
    if projection is None:
        raise ClipError(
            "depth along the ray can be turned into depth along the view axis only with the field of view; "
            'give cameras a fov in the settings ({"cameras": {"fov": 50}}, vertical, degrees) or a file'
        )
    matrix = torch.tensor([projection], dtype=torch.float32)
    if projection[3][3] != 0:
        return np.ones((1, *size))
    position = world_position(torch.ones(1, 1, *size), torch.eye(4)[None], matrix)
    return position.double().norm(dim=1).numpy()


def decode_motion(
    stored: Num[np.ndarray, "n h w"],
    motion: Motion,
    own: tuple[int, int],
    shift: tuple[float, float] = (0.0, 0.0),
    camera: Float[np.ndarray, "2 h w"] | None = None,
) -> Float[np.ndarray, "2 h w"]:
    """Vectors from the current pixel to the other frame, in pixels of this resolution, x right, y down, no jitter.

    Args:
        own: height and width of the file that held them, before they were brought to this size.
        shift: jitter of the other frame minus that of this one (`jitter_shift`), for vectors that hold jitter.
        camera: motion in pixels that the cameras alone cause; taken where nothing was written (0 without it).

    Raises:
        ClipError: vectors without the camera's part, and no cameras.
    """
    h, w = stored.shape[1:]
    v = unpack(stored, 2, motion.packing).astype(np.float64)
    v = (v - _column(motion.bias)) * _column(motion.scale)
    if motion.packing == "unreal_sqrt":
        v = v * np.abs(v) / 2
    width, height = motion.size or (own[1], own[0])
    unit = {"pixels": (w / width, h / height), "uv": (w, h), "ndc": (w / 2, h / 2)}[motion.units]
    turned = -1.0 if motion.direction in ("previous->current", "next->current") else 1.0
    out = v * _column(unit) * _column(motion.sign) * turned
    if motion.jittered:
        out = out + _column(shift)
    if not motion.camera:
        if camera is None:
            raise ClipError("the vectors lack the camera's part, which needs depth and cameras; export those too")
        out = out + camera
    if motion.unwritten is not None:
        empty = (stored == np.asarray(motion.unwritten, stored.dtype)).all(0)
        out = np.where(empty, 0 if camera is None else camera, out)
    return out.astype(np.float32)


def _column(pair: tuple[float, float]) -> np.ndarray:
    return np.array(pair)[:, None, None]


def jitter_shift(here: Record, other: Record | None) -> tuple[float, float]:
    """Jitter of another frame minus that of this one; 0 beyond the ends."""
    there = here if other is None else other
    return there.jitter[0] - here.jitter[0], there.jitter[1] - here.jitter[1]


def _camera_part(depth: np.ndarray | None, here: Record, other: Record | None) -> np.ndarray | None:
    """Motion by the cameras alone, or None where depth or a camera is not known; 0 beyond the ends."""
    if depth is None or here.view is None or here.projection is None:
        return None
    if other is None:
        return np.zeros((2, *depth.shape[1:]))
    if other.view is None or other.projection is None:
        return None
    return camera_motion(_bare(here, depth), _bare(other, depth))[0].numpy()


def _bare(record: Record, depth: np.ndarray) -> Frame:
    def matrix(rows: tuple[tuple[float, ...], ...] | None) -> Tensor:
        return torch.tensor([rows], dtype=torch.float32)

    return Frame(
        depth=torch.from_numpy(np.ascontiguousarray(depth))[None],
        view=matrix(record.view),
        projection=matrix(record.projection),
        jitter=torch.zeros(1, 2),
        time=torch.zeros(1),
        reset=torch.zeros(1, dtype=torch.bool),
        span=torch.ones(1),
    )


def decode_normal(
    stored: Num[np.ndarray, "3 h w"],
    normal: Normal,
    axes: str = "opengl",
    view: tuple[tuple[float, ...], ...] | None = None,
) -> Float[np.ndarray, "3 h w"] | None:
    """World-space unit normals in our axes, 0 where there is none; None: in view space, and no camera is known."""
    n = stored.astype(np.float32)
    n = (2 * n - 1 if normal.encoded else n) * np.array(normal.sign, np.float32)[:, None, None]
    if normal.space == "view":
        if view is None:
            return None
        turn = np.asarray(view)[:3, :3].T
    else:
        turn = AXES[axes]
    n = np.einsum("ij,jhw->ihw", turn.astype(np.float32), n)
    length = np.sqrt((n * n).sum(0))
    return np.where((length > 0.1) & (length < MARKER) | np.isnan(length), n / np.maximum(length, 1e-3), 0)


def decode_scalar(stored: Num[np.ndarray, "1 h w"], scalar: Scalar) -> Float[np.ndarray, "1 h w"]:
    """(stored - bias) * scale."""
    return ((stored.astype(np.float64) - scalar.bias) * scalar.scale).astype(np.float32)


def ids(values: Float[np.ndarray, "1 h w"]) -> Num[np.ndarray, "1 h w"]:
    """Whole numbers from 0; left as they are where one is NaN or infinite, so that it can be named."""
    index = np.rint(np.clip(values, 0, 2**31 - 128))
    return index.astype(np.uint32) if np.isfinite(values).all() else values


def decode_jitter(jitter: Jitter, index: int, size: tuple[int, int]) -> tuple[float, float]:
    """Sample position minus pixel centre in pixels (x right, y down) of the frame at `index` of the folder.

    Args:
        size: height and width of the frame.
    """
    if jitter.values:
        pair = jitter.values[(index + jitter.start) % len(jitter.values)]
    elif jitter.halton:
        phase = (index + jitter.start) % jitter.halton + 1
        pair = (radical_inverse(phase, 2) - 0.5, radical_inverse(phase, 3) - 0.5)
    else:
        return 0.0, 0.0
    return jitter_pixels(pair, jitter, size)


def jitter_pixels(pair: tuple[float, float], jitter: Jitter, size: tuple[int, int]) -> tuple[float, float]:
    """A pair in the units and signs that the settings name, as sample position minus pixel centre in pixels."""
    x, y = {"pixels": (1.0, 1.0), "uv": (size[1], size[0]), "ndc": (size[1] / 2, size[0] / 2)}[jitter.units]
    return pair[0] * jitter.sign[0] * x, pair[1] * jitter.sign[1] * y


def radical_inverse(index: int, base: int) -> float:
    """Digits of `index` mirrored at the point: the Halton sequence of one dimension, in [0, 1)."""
    value, place = 0.0, 1.0 / base
    while index:
        index, digit = divmod(index, base)
        value += digit * place
        place /= base
    return value
