"""OpenEXR files as plain arrays: read any kind, write whole files only.

Channel names are the file's own. Everything that can be wrong with a file is found here and said in one sentence.
"""

import contextlib
import io
import os
import threading
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR

_READING = threading.Lock()

COMPRESSIONS = {
    "none": OpenEXR.NO_COMPRESSION,
    "zip": OpenEXR.ZIP_COMPRESSION,
    "piz": OpenEXR.PIZ_COMPRESSION,
    "dwaa": OpenEXR.DWAA_COMPRESSION,
}


class ClipError(ValueError):
    """A clip, shot or image file that cannot be used; the message says what was given, needed and what to do."""


@dataclass(frozen=True)
class Exr:
    """One file: channels by name (float16, float32 or uint32 arrays, rows from the top) and text attributes."""

    channels: dict[str, np.ndarray]
    attributes: dict[str, str]

    @property
    def size(self) -> tuple[int, int]:
        """Height and width in pixels."""
        height, width = next(iter(self.channels.values())).shape
        return height, width


@dataclass(frozen=True)
class Header:
    """What a file says of itself: size of the display window, channel names in file order, text attributes."""

    size: tuple[int, int]
    names: tuple[str, ...]
    attributes: dict[str, str]


@contextlib.contextmanager
def silenced() -> Iterator[None]:
    """Standard error of the process, native libraries included, goes nowhere inside the block."""
    saved, null = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 2)
    try:
        yield
    finally:
        os.dup2(saved, 2)
        os.close(saved)
        os.close(null)


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """The library reports damage on both standard streams; its findings are reported as errors here instead."""
    with _READING, contextlib.redirect_stdout(io.StringIO()), silenced():
        yield


def _open(path: Path, header_only: bool) -> OpenEXR.File:
    if not path.is_file():
        raise FileNotFoundError(f"{path} does not exist")
    try:
        with _quiet():
            return OpenEXR.File(str(path), separate_channels=True, header_only=header_only)
    except (RuntimeError, ValueError, TypeError, OSError, MemoryError) as error:
        raise ClipError(f"{path} is not a readable EXR file (truncated or damaged); render or copy it again") from error


def _parts(file: OpenEXR.File) -> list[Any]:
    return [part for part in file.parts if part.header]


def header(path: Path) -> Header:
    """Size, channel names and text attributes, without reading pixels.

    Raises:
        FileNotFoundError: no such file. ClipError: not an EXR file.
    """
    parts = _parts(_open(path, header_only=True))
    if not parts:
        raise ClipError(f"{path} holds no image; render it again")
    low, high = parts[0].header["displayWindow"]
    names = tuple(channel.name for part in parts for channel in part.header["channels"])
    text = {k: v for part in parts for k, v in part.header.items() if isinstance(v, str)}
    return Header((int(high[1] - low[1]) + 1, int(high[0] - low[0]) + 1), names, text)


def size(path: Path) -> tuple[int, int]:
    """Height and width of the display window, from the header alone; raises as `header` does."""
    return header(path).size


def attributes(path: Path) -> dict[str, str]:
    """Text attributes of every part, from the header alone; raises as `header` does."""
    return header(path).attributes


def read(path: Path) -> Exr:
    """Every channel of every part, on the display window (pixels outside the data window are 0).

    A channel name that two parts share is prefixed by its part's name. Deep images are refused.

    Raises:
        FileNotFoundError: no such file. ClipError: truncated, damaged, deep or subsampled.
    """
    expected = len(_parts(_open(path, header_only=True)))
    parts = _parts(_open(path, header_only=False))
    whole = len(parts) == expected and expected > 0
    channels: dict[str, np.ndarray] = {}
    for part in parts if whole else ():
        if part.header.get("type") in (OpenEXR.deepscanline, OpenEXR.deeptile):
            raise ClipError(f"{path} is a deep image; flatten it to one sample per pixel (scanline or tiled) first")
        for name, channel in part.channels.items():
            if channel.pixels is None:
                raise ClipError(f"{path} has no pixels in {name} (truncated or damaged); render or copy it again")
            key = f"{part.name()}.{name}" if name in channels else name
            channels[key] = _on_display_window(path, part.header, name, channel)
    if not channels:
        raise ClipError(f"{path} is truncated or damaged; render or copy it again")
    if len({pixels.shape for pixels in channels.values()}) > 1:
        raise ClipError(f"{path} holds parts of different sizes; write them to separate files")
    text = {k: v for part in parts for k, v in part.header.items() if isinstance(v, str)}
    return Exr(channels, text)


def _on_display_window(path: Path, header: Mapping[str, Any], name: str, channel: Any) -> np.ndarray:
    if channel.xSampling != 1 or channel.ySampling != 1:
        raise ClipError(f"{path}: {name} is subsampled; write it at full resolution")
    (x0, y0), (x1, y1) = header["dataWindow"]
    (left, top), (right, bottom) = header["displayWindow"]
    pixels: np.ndarray = channel.pixels
    if (x0, y0, x1, y1) == (left, top, right, bottom):
        return pixels
    out = np.zeros((bottom - top + 1, right - left + 1), pixels.dtype)
    rows = slice(max(y0, top), min(y1, bottom) + 1)
    columns = slice(max(x0, left), min(x1, right) + 1)
    if rows.start < rows.stop and columns.start < columns.stop:
        inside = pixels[rows.start - y0 : rows.stop - y0, columns.start - x0 : columns.stop - x0]
        out[rows.start - top : rows.stop - top, columns.start - left : columns.stop - left] = inside
    return out


def write(
    path: Path,
    channels: Mapping[str, np.ndarray],
    *,
    attributes: Mapping[str, str] | None = None,
    compression: str = "zip",
) -> None:
    """A scanline file with these channels (float16, float32 or uint32, all the same size).

    Written under a temporary name and renamed when complete; on failure nothing is left behind.

    Raises:
        ClipError: it cannot be written (no space, no permission); the message says why.
    """
    header = {"compression": COMPRESSIONS[compression], "type": OpenEXR.scanlineimage, **(attributes or {})}
    arrays = {name: np.ascontiguousarray(pixels) for name, pixels in channels.items()}
    with whole(path) as temporary:
        OpenEXR.File(header, arrays).write(str(temporary))


@contextlib.contextmanager
def whole(path: Path) -> Iterator[Path]:
    """A temporary path beside `path` that is renamed to it when the block succeeds and removed when it fails.

    Raises:
        ClipError: the file system refused (no space, no permission).
    """
    temporary = path.with_name(f".{path.stem}.{os.getpid()}.part{path.suffix}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        temporary.replace(path)
    except (OSError, RuntimeError) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error).strip().rstrip(".")
        raise ClipError(
            f"cannot write {path}: {reason}; free some space or choose another folder, then run the same command again"
        ) from error
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)
