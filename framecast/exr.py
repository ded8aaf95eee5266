"""OpenEXR files as plain arrays: read any kind, write whole files only.

Channel names are the file's own. Everything that can be wrong with a file is found here and said in one sentence.
"""

import contextlib
import io
import os
import threading
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
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

LARGEST = 2**28
"""Pixels of the largest window that is read (16384 x 16384): a header may claim anything."""

MOST = 2**33
"""Bytes that the channels of one file may take in memory."""

EXPANSION = 5000
"""What a large file may grow by when it is unpacked; deflate cannot do more than 1032."""


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
    reduced: dict[str, tuple[int, int]]
    """Height and width of channels of a lower resolution, see `read`."""


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


def _described(path: Path) -> tuple[list[Any], list[list[str]]]:
    """Headers of the parts and the names of their channels, checked before anything is made room for.

    Raises:
        ClipError: no image in it, or one that is deep or too large.
    """
    parts = _parts(_open(path, header_only=True))
    if not parts:
        raise ClipError(f"{path} holds no image; render it again")
    held = 0
    for part in parts:
        if part.header.get("type") in (OpenEXR.deepscanline, OpenEXR.deeptile):
            raise ClipError(f"{path} is a deep image; flatten it to one sample per pixel (scanline or tiled) first")
        sizes = [_window(part.header[window]) for window in ("dataWindow", "displayWindow")]
        for height, width in sizes:
            if min(height, width) < 1 or height * width > LARGEST:
                raise ClipError(f"{path} claims to have {width}x{height} pixels, which cannot be; copy it again")
        held += 4 * len(part.header["channels"]) * max(height * width for height, width in sizes)
    if held > MOST or (held > 2**28 and held > EXPANSION * path.stat().st_size):
        raise ClipError(f"{path} would take {held / 2**30:.1f} GiB in memory; it is damaged, or has too many layers")
    try:
        return parts, _names(parts)
    except UnicodeDecodeError as error:
        raise ClipError(f"{path} has channel names that are no text (damaged); copy it again") from error


def _window(corners: Any) -> tuple[int, int]:
    """Height and width of a window given by its corners, both inside."""
    (left, top), (right, bottom) = corners
    return int(bottom) - int(top) + 1, int(right) - int(left) + 1


def _names(parts: Sequence[Any]) -> list[list[str]]:
    """Channel names of each part, in file order; where two parts share one, those parts' names stand before theirs."""
    plain = [[channel.name for channel in part.header["channels"]] for part in parts]
    count = Counter(name for names in plain for name in names)
    shared = [any(count[name] > 1 for name in names) for names in plain]
    return [
        [f"{part.name()}.{name}" if twice and part.name() else name for name in names]
        for part, names, twice in zip(parts, plain, shared, strict=True)
    ]


def header(path: Path) -> Header:
    """Size, channel names and text attributes, without reading pixels.

    Raises:
        FileNotFoundError: no such file. ClipError: not an EXR file, deep, or of an impossible size.
    """
    parts, parted = _described(path)
    names = tuple(name for part in parted for name in part)
    text = {k: v for part in parts for k, v in part.header.items() if isinstance(v, str)}
    reduced = {
        name: _window(part.header["dataWindow"])
        for part, plain in zip(parts, parted, strict=True)
        if _is_reduced(part, parts)
        for name in plain
    }
    return Header(_window(parts[0].header["displayWindow"]), names, text, reduced)


def size(path: Path) -> tuple[int, int]:
    """Height and width of the display window, from the header alone; raises as `header` does."""
    return header(path).size


def attributes(path: Path) -> dict[str, str]:
    """Text attributes of every part, from the header alone; raises as `header` does."""
    return header(path).attributes


def _is_reduced(part: Any, parts: Sequence[Any]) -> bool:
    """Whether a part holds the picture of another one at a lower resolution.

    All parts of a file share one display window, so that such a part can be told by its data window alone: from the
    same corner, smaller by the same factor both ways, beside a part that fills the window.
    """
    (left, top), _ = part.header["displayWindow"]
    if tuple(part.header["dataWindow"][0]) != (left, top):
        return False
    (h, w), (height, width) = (_window(part.header[window]) for window in ("dataWindow", "displayWindow"))
    alike = abs(h * width - w * height) <= max(height, width) and h < 0.9 * height
    return alike and any(_window(other.header["dataWindow"]) == (height, width) for other in parts)


def read(path: Path, *, mixed: bool = False) -> Exr:
    """Every channel of every part, on the display window (pixels outside the data window are 0).

    Where two parts share a channel name, the names of those parts stand before all of theirs. Deep images are refused.

    Args:
        mixed: parts of a lower resolution (the same corner, the same shape, another part full) keep their own size.

    Raises:
        FileNotFoundError: no such file. ClipError: truncated, damaged, deep or subsampled.
    """
    expected, parted = _described(path)
    parts = _parts(_open(path, header_only=False))
    channels: dict[str, np.ndarray] = {}
    for part, names in zip(parts, parted, strict=False) if len(parts) == len(expected) else ():
        for name, channel in zip(names, part.channels.values(), strict=False):
            if channel.pixels is None:
                raise ClipError(f"{path} has no pixels in {name} (truncated or damaged); render or copy it again")
            own = mixed and _is_reduced(part, parts)
            channels[name] = channel.pixels if own else _on_display_window(path, part.header, name, channel)
    if not channels:
        raise ClipError(f"{path} is truncated or damaged; render or copy it again")
    if not mixed and len({pixels.shape for pixels in channels.values()}) > 1:
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
