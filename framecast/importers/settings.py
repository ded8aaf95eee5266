"""How the buffers of a folder are to be read: `Settings`, kept in a file beside them.

    {"fps": 30,
     "color":  {"files": "shot.{frame}.exr", "channels": ["R", "G", "B"]},
     "depth":  {"files": "shot.{frame}.exr", "channels": ["depth.R"], "kind": "reversed", "near": 0.1},
     "motion": {"files": "vectors/{frame}.exr", "channels": ["R", "G"], "units": "uv", "sign": [1, -1],
                "direction": "previous->current"}}

`framecast doctor` writes such a file, `framecast import` reads it, every importer makes one in memory. What is not said
has the value that `Frame` itself has, so that a field with only files and channels is taken as it is. `decode.py` holds
what the values mean, one pure function a field; `encode.py` is its inverse.
"""

import json
import math
import types
import typing
from dataclasses import dataclass, field, fields, is_dataclass
from difflib import get_close_matches
from pathlib import Path, PurePosixPath
from typing import Any, Literal

from framecast import exr
from framecast.exr import ClipError

NAME = "framecast-import.json"
"""The settings file of a folder."""

Pair = tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class Layer:
    """Where the numbers of one buffer lie.

    A file pattern is relative to the folder and holds `{frame}` once, which stands for the digits of the frame number;
    `*` stands for anything within a name. With several patterns the channels are read from each file in turn.
    """

    files: tuple[str, ...]
    channels: tuple[str, ...]
    """Names as in the EXR file; R G B A or Y of a PNG; 0, 1, ... of an array (npy, npz; last axis)."""
    offset: int = 0
    """The file numbered n holds what belongs to frame n + offset."""


@dataclass(frozen=True, kw_only=True)
class Color(Layer):
    """Colour or albedo, three channels."""

    encoding: Literal["linear", "srgb"] = "linear"
    exposure: tuple[float, ...] = (1.0,)
    """Factor already in the numbers: one for all, or one a frame in order, which are evened out to the first."""


@dataclass(frozen=True, kw_only=True)
class Depth(Layer):
    """Depth. v = (stored - bias) * scale, where several channels are packed into one number first."""

    kind: Literal["planar", "euclidean", "device", "reversed", "inverse", "unit"] = "planar"
    """planar: v along the view axis. euclidean: v along the ray, from where the ray passes `near` (0: the camera).
    device: 0 at near, 1 at far, hyperbolic. reversed: 1 at near, 0 at far. inverse: 1 / distance along the view axis.
    unit: 0 at near, 1 at far, linear."""
    near: float = 0.0
    far: float | None = None
    """Distance from which on nothing was hit; None: infinite."""
    scale: float = 1.0
    bias: float = 0.0
    packing: Literal["none", "base255", "base256"] = "none"


@dataclass(frozen=True, kw_only=True)
class Motion(Layer):
    """Vectors, on the pixels of the frame that they belong to. v = (stored - bias) * scale, after unpacking."""

    units: Literal["pixels", "uv", "ndc"] = "pixels"
    """uv: 1 is the whole image; ndc: 2 is."""
    size: tuple[int, int] | None = None
    """Width and height of the image whose pixels are meant; None: of these vectors' own image."""
    sign: Pair = (1.0, 1.0)
    """1 where positive means right, and down; -1 where it means left, or up."""
    direction: Literal["current->previous", "previous->current", "current->next", "next->current"] = "current->previous"
    """From where to where the vector points; always on the grid of the current frame."""
    scale: Pair = (1.0, 1.0)
    bias: Pair = (0.0, 0.0)
    packing: Literal["none", "base255", "base256", "unreal_sqrt"] = "none"
    """base255, base256: 8-bit channels, most significant first, those of x before those of y. unreal_sqrt: w * |w| / 2
    of (stored - bias) * scale = w."""
    unwritten: float | None = None
    """Stored number that in all channels means: nothing was written here, the surface does not move by itself."""
    jittered: bool = False
    """The difference of the jitters is in the vectors."""
    camera: bool = True
    """The camera's part is in the vectors; else it is added, which needs depth and cameras."""


@dataclass(frozen=True, kw_only=True)
class Normal(Layer):
    """Normals, three channels."""

    space: Literal["world", "view"] = "world"
    """view: x right, y up, z towards the camera."""
    encoded: bool = False
    """Stored as n / 2 + 1/2."""
    sign: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """-1 for an axis that is turned around."""


@dataclass(frozen=True, kw_only=True)
class Scalar(Layer):
    """One number a pixel, (stored - bias) * scale; ids of objects are rounded."""

    scale: float = 1.0
    bias: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Jitter:
    """Where each frame was sampled."""

    values: tuple[Pair, ...] = ()
    """x and y, one pair a frame in order, from the start again when they end; empty: none, or `halton`."""
    halton: int = 0
    """Phases of the sequence Halton(2, 3)(i + 1) - 1/2 pixels; 0: none."""
    start: int = 0
    """Phase of the first frame."""
    units: Literal["pixels", "uv", "ndc"] = "pixels"
    sign: Pair = (1.0, 1.0)
    """(1, 1): sample position minus pixel centre, x right, y down. (-1, -1): by how much the picture is moved."""


@dataclass(frozen=True, kw_only=True)
class Cameras:
    """A file with one camera a frame (see `cameras.py`), or only the field of view."""

    file: str | None = None
    fov: float | None = None
    """Vertical field of view in degrees, where the file does not tell."""
    scale: float = 1.0
    """What positions in the file are multiplied by to have the unit of depth; 0.01 from centimetres to metres."""
    motion: bool = False
    """Where no vectors are stored, compute those of the camera's motion; right where nothing moves by itself."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Everything that an importer needs to know of a folder."""

    version: int = 1
    source: str = "generic"
    fps: float | None = None
    span: float | None = None
    """Time in frames that vectors reach; None: to the neighbouring frame of the folder."""
    crop: tuple[int, int] | None = None
    """Width and height of the picture, at the top left of larger files; None: all of it."""
    bottom_up: bool = False
    """The first row of the files is the bottom of the image."""
    color: Color | None = None
    depth: Depth | None = None
    motion: Motion | None = None
    motion_next: Motion | None = None
    albedo: Color | None = None
    normal: Normal | None = None
    roughness: Scalar | None = None
    metallic: Scalar | None = None
    object: Scalar | None = None
    jitter: Jitter = field(default_factory=Jitter)
    cameras: Cameras | None = None
    axes: Literal["opengl", "unreal", "unity", "directx"] = "opengl"
    """Axes of the world, for normals and cameras. opengl: right-handed, +y up, a camera looks down -z. unreal:
    left-handed, x ahead, y right, z up. unity: left-handed, +y up, z ahead; its worldToCameraMatrix is as in opengl.
    directx: left-handed, +y up, cameras too look down +z."""
    notes: tuple[str, ...] = ()
    """What a user should know, one sentence each; shown when the folder is imported."""


COUNTS: dict[str, int] = {"color": 3, "depth": 1, "motion": 2, "motion_next": 2, "albedo": 3, "normal": 3}
"""Numbers a pixel; one for everything else."""


def layers(settings: Settings) -> dict[str, Layer]:
    """The buffers that settings tell of, by the names of `Frame`."""
    found = {f.name: getattr(settings, f.name) for f in fields(settings)}
    return {name: value for name, value in found.items() if isinstance(value, Layer)}


def read_settings(path: Path | str) -> Settings:
    """Settings from a file, or from the `framecast-import.json` of a folder.

    Raises:
        FileNotFoundError: no such file. ClipError: not JSON, or the first wrong key or value, in one sentence.
    """
    path = Path(path)
    path = path / NAME if path.is_dir() else path
    if not path.is_file():
        raise FileNotFoundError(f"{path} does not exist; let framecast doctor write it, or write it by hand")
    try:
        about = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise ClipError(f"{path} is not JSON ({error}); write it again with framecast doctor") from error
    try:
        return parsed(about)
    except ClipError as error:
        raise ClipError(f"{path}: {error}") from error


def write_settings(settings: Settings, path: Path | str) -> Path:
    """Settings to a file (or into a folder, under the usual name), a line a buffer, without defaults; returns the file.

    Raises:
        ClipError: the settings contradict themselves, or the file system refuses.
    """
    path = Path(path)
    path = path / NAME if path.is_dir() else path
    check_settings(settings)
    with exr.whole(path) as temporary:
        lines = [f" {json.dumps(key)}: {json.dumps(value)}" for key, value in plain(settings).items()]
        temporary.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")
    return path


def plain(settings: Settings) -> dict[str, Any]:
    """Settings as JSON values, without what has its default (version and source stay)."""
    about = {"version": settings.version, "source": settings.source, **_said(settings)}
    values: dict[str, Any] = json.loads(json.dumps(about))  # lists in place of tuples
    return values


def _said(value: Any) -> Any:
    """Fields of a dataclass that are not at their default."""
    defaults = {f.name: f.default_factory() if callable(f.default_factory) else f.default for f in fields(value)}
    out = {}
    for name, default in defaults.items():
        item = getattr(value, name)
        if item != default:
            out[name] = _said(item) if is_dataclass(item) else item
    return out


def parsed(about: Any) -> Settings:
    """Settings from JSON values.

    Raises:
        ClipError: the first key or value that is wrong, in one sentence.
    """
    settings: Settings = _dataclass(Settings, about, "")
    check_settings(settings)
    return settings


def _dataclass(kind: Any, about: Any, where: str) -> Any:
    if not isinstance(about, dict):
        raise ClipError(f"{where or 'the file'} is {_short(about)}; it has to be an object, {{...}}")
    known = {f.name: f for f in fields(kind)}
    for name in about:
        if name not in known:
            near = get_close_matches(name, known, 1)
            meant = f"did you mean {near[0]}?" if near else f"known are {', '.join(known)}"
            raise ClipError(f"{_at(where, name)} is not known; {meant}")
    hints = typing.get_type_hints(kind)
    values = {name: _value(hints[name], value, _at(where, name)) for name, value in about.items()}
    if lack := [n for n in ("files", "channels") if n in known and n not in values]:
        raise ClipError(f"{where} lacks {' and '.join(lack)}; say where the numbers lie")
    return kind(**values)


def _at(where: str, name: str) -> str:
    return f"{where}.{name}" if where else name


def _short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) < 40 else f"{text[:36]} ..."


def _value(kind: Any, value: Any, where: str) -> Any:
    """A JSON value as the type that a field has."""
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if origin in (typing.Union, types.UnionType):
        return None if value is None else _value(arguments[0], value, where)
    if is_dataclass(kind):
        return _dataclass(kind, value, where)
    if origin is Literal:
        if value in arguments:
            return value
        raise ClipError(f"{where} is {_short(value)}; it may be {', '.join(arguments)}")
    if origin is tuple:
        return _tuple(arguments, value, where)
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if kind is float and number and math.isfinite(value) and abs(value) < 1e30:
        return float(value)
    if kind is int and number and abs(value) < 2**31 and value == int(value):
        return int(value)
    if kind in (bool, str) and isinstance(value, kind):
        return value
    wanted = {float: "a number", int: "a whole number", bool: "true or false", str: "a text"}[kind]
    raise ClipError(f"{where} is {_short(value)}; it has to be {wanted}")


def _tuple(arguments: tuple[Any, ...], value: Any, where: str) -> Any:
    """A list; where any length will do, also a single value without brackets."""
    free = len(arguments) == 2 and arguments[1] is Ellipsis
    if free and not isinstance(value, list | tuple):
        value = [value]
    if not isinstance(value, list | tuple) or not (free or len(value) == len(arguments)):
        raise ClipError(f"{where} is {_short(value)}; it has to be a list of {len(arguments)} values")
    kinds = [arguments[0]] * len(value) if free else arguments
    return tuple(_value(kind, item, f"{where}[{i}]") for i, (kind, item) in enumerate(zip(kinds, value, strict=True)))


def check_settings(settings: Settings) -> None:
    """Refuse settings that contradict themselves.

    Raises:
        ClipError: the first contradiction, in one sentence.
    """
    if settings.version != 1:
        raise ClipError(f"version is {settings.version}; this framecast reads version 1")
    for name, number in (("fps", settings.fps), ("span", settings.span)):
        if number is not None and not number > 0:
            raise ClipError(f"{name} is {number:g}; it has to be above 0")
    for name, layer in layers(settings).items():
        _check_layer(name, layer)
    if not layers(settings):
        raise ClipError("no buffer is told of; give at least color or motion its files and channels")
    jitter = settings.jitter
    if jitter.halton < 0 or jitter.start < 0 or (jitter.halton and jitter.values):
        raise ClipError("jitter takes values, or a number of halton phases above 0, and a start of at least 0")
    _check_signs("jitter", jitter.sign)
    if settings.cameras is not None:
        _check_cameras(settings.cameras)


def _check_layer(name: str, layer: Layer) -> None:
    if not layer.files or not layer.channels:
        raise ClipError(f"{name} needs at least one file pattern and one channel")
    for pattern in layer.files:
        _inside(f"{name}.files", pattern)
        if pattern.count("{frame}") != 1:
            raise ClipError(f"{name}.files is {_short(pattern)}; it has to hold {{frame}} once, for the frame number")
    held, packing = len(layer.files) * len(layer.channels), getattr(layer, "packing", "none")
    count = COUNTS.get(name, 1)
    if held % count or (packing not in ("base255", "base256") and held != count) or held > 4 * count:
        raise ClipError(
            f"{name} has {held} channels; it needs {count}, or a multiple of it with packing base255 or base256"
        )
    if isinstance(layer, Depth):
        _check_depth(name, layer)
    if isinstance(layer, Motion):
        _check_motion(name, layer)
    if isinstance(layer, Normal):
        _check_signs(name, layer.sign)
    if isinstance(layer, Color) and not (layer.exposure and min(layer.exposure) > 0):
        raise ClipError(f"{name}.exposure has to be one number above 0, or one a frame")
    if isinstance(layer, Scalar) and layer.scale == 0:
        raise ClipError(f"{name}.scale is 0; every number would be lost")


def _check_depth(name: str, depth: Depth) -> None:
    if depth.scale == 0:
        raise ClipError(f"{name}.scale is 0; every number would be lost")
    if depth.near < 0 or (depth.far is not None and depth.far <= depth.near):
        raise ClipError(f"{name}: near has to be at least 0 and far above near")
    if depth.kind in ("device", "reversed") and depth.near == 0:
        raise ClipError(f"{name}.near is missing; {depth.kind} depth needs the distance of the near plane")
    if depth.kind == "unit" and depth.far is None:
        raise ClipError(f"{name}.far is missing; unit depth needs the distance that 1 stands for")


def _check_motion(name: str, motion: Motion) -> None:
    if 0 in motion.scale:
        raise ClipError(f"{name}.scale holds 0; every vector would be lost")
    if motion.size is not None and min(motion.size) < 1:
        raise ClipError(f"{name}.size has to be a width and a height of at least 1")
    if name == "motion_next" and motion.direction in ("current->previous", "previous->current"):
        raise ClipError(f"motion_next.direction is {motion.direction}; it has to be current->next or next->current")
    if name == "motion" and "next" in motion.direction:
        raise ClipError(f"motion.direction is {motion.direction}; put such vectors under motion_next")
    _check_signs(name, motion.sign)


def _check_signs(name: str, signs: tuple[float, ...]) -> None:
    if not set(signs) <= {1.0, -1.0}:
        raise ClipError(f"{name}.sign is {list(signs)}; each has to be 1 or -1")


def _check_cameras(cameras: Cameras) -> None:
    if cameras.file is None and cameras.fov is None:
        raise ClipError("cameras needs a file or a fov")
    if cameras.file is not None:
        _inside("cameras.file", cameras.file)
    if not cameras.scale > 0:
        raise ClipError(f"cameras.scale is {cameras.scale:g}; it has to be above 0")
    if cameras.fov is not None and not 0 < cameras.fov < 180:
        raise ClipError(f"cameras.fov is {cameras.fov:g}; it has to lie between 0 and 180 degrees")


def _inside(name: str, pattern: str) -> None:
    """Settings travel with data from elsewhere: they never reach outside of the folder."""
    path = PurePosixPath(pattern)
    if not pattern or path.is_absolute() or ".." in path.parts or "\\" in pattern or "\0" in pattern:
        raise ClipError(f"{name} is {_short(pattern)}; it has to be a path inside the folder, with / between its parts")
