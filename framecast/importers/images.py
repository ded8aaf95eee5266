"""Image files of any kind as named channels: EXR, PNG, JPEG, npy and npz.

EXR channels keep their names and numbers; 8 and 16-bit pixels become 0..1; the last axis of an array holds its
channels, named 0, 1, 2 ..., after the array's own name where an npz file holds several: depth.0, motion.0, motion.1.
"""

import warnings
import zipfile
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
from pathlib import Path

import av
import numpy as np
from jaxtyping import Num
from PIL import Image

from framecast import exr
from framecast.exr import ClipError

LARGEST = 2**31
"""Bytes that one array file may hold."""

EXTENSIONS = (".exr", ".png", ".jpg", ".jpeg", ".npy", ".npz")


@dataclass(frozen=True)
class About:
    """What an image file says of itself."""

    size: tuple[int, int]
    """Height and width in pixels."""
    names: tuple[str, ...]
    bits: int
    """Bits of a channel: 8 and 16 for PNG and JPEG, 32 for everything that is stored as it is."""
    text: dict[str, str]
    """Text attributes of an EXR file."""
    sizes: dict[str, tuple[int, int]] = field(default_factory=dict)
    """Height and width of channels that differ from `size`."""

    def size_of(self, channel: str) -> tuple[int, int]:
        """Height and width of a channel, its name in any case."""
        return self.sizes.get(matching(self.names, channel) or channel, self.size)


def about(path: Path) -> About:
    """Size, channel names and depth of a file, of EXR, PNG and npy files without reading pixels.

    Raises:
        FileNotFoundError: no such file. ClipError: not an image that can be read.
    """
    if path.suffix.lower() == ".exr":
        header = exr.header(path)
        return About(header.size, header.names, 32, header.attributes, header.reduced)
    if path.suffix.lower() in (".npy", ".npz"):
        sizes = {name: (plane.shape[0], plane.shape[1]) for name, plane in _arrays(path).items()}
        largest = max(sizes.values())
        return About(largest, tuple(sizes), 32, {}, {name: size for name, size in sizes.items() if size != largest})
    with _opened(path) as image:
        bits = 16 if _is_16_bit(path, image) else 8
        return About((image.height, image.width), tuple(_letters(image)), bits, {})


def channels(path: Path) -> dict[str, Num[np.ndarray, "h w"]]:
    """Every channel of a file by name.

    Raises:
        FileNotFoundError: no such file. ClipError: it cannot be read.
    """
    if path.suffix.lower() == ".exr":
        return exr.read(path, mixed=True).channels
    if path.suffix.lower() in (".npy", ".npz"):
        return _arrays(path)
    pixels, names = _pixels(path)
    return {name: pixels[:, :, place] for place, name in enumerate(names)}


def read(path: Path, names: Sequence[str]) -> Num[np.ndarray, "n h w"]:
    """These channels of a file; a name may differ in case where it is not ambiguous.

    Raises:
        FileNotFoundError: no such file. ClipError: it cannot be read, or lacks a channel.
    """
    held = channels(path)
    return stacked(path, names, [held[found(path, name, held)] for name in names])


def stacked(path: Path, names: Sequence[str], planes: Sequence[np.ndarray]) -> Num[np.ndarray, "n h w"]:
    """Channels of one buffer in one array; raises ClipError where they differ in size."""
    if len({plane.shape for plane in planes}) > 1:
        sizes = ", ".join(
            f"{name} {plane.shape[1]}x{plane.shape[0]}" for name, plane in zip(names, planes, strict=True)
        )
        raise ClipError(f"{path}: channels of one buffer differ in size ({sizes}); export them alike")
    return np.stack(planes)


def found(path: Path, name: str, held: Collection[str]) -> str:
    """The channel of that name among those that a file holds, in any case; raises ClipError without one."""
    if (match := matching(held, name)) is not None:
        return match
    near = get_close_matches(name, held, 1)
    meant = f"did you mean {near[0]}?" if near else f"it has {short(list(held))}"
    raise ClipError(f"{path} has no channel {name}; {meant}")


def matching(names: Collection[str], wanted: str) -> str | None:
    """The one name that equals `wanted` in any case, or None."""
    same = [name for name in names if name.casefold() == wanted.casefold()]
    return wanted if wanted in names else same[0] if len(same) == 1 else None


def short(names: Sequence[str]) -> str:
    """Names in a sentence, the first twelve."""
    return ", ".join(names[:12]) + (f" and {len(names) - 12} more" if len(names) > 12 else "")


def _refused(path: Path, error: Exception) -> ClipError:
    why = " ".join(str(error).split())
    return ClipError(f"{path} cannot be read ({type(error).__name__}: {why}); export or copy it again")


def _opened(path: Path) -> Image.Image:
    if not path.is_file():
        raise FileNotFoundError(f"{path} does not exist")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            return Image.open(path)
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError, Image.DecompressionBombWarning) as error:
        raise _refused(path, error) from error


def _letters(image: Image.Image) -> str:
    return {"RGB": "RGB", "RGBA": "RGBA", "LA": "YA", "P": "RGB", "CMYK": "RGB"}.get(image.mode, "Y")


def _is_16_bit(path: Path, image: Image.Image) -> bool:
    """PNG says so in byte 24; the library reads 16-bit colour as 8 bits and keeps silent."""
    with path.open("rb") as file:
        return image.format == "PNG" and file.read(25)[24:] == b"\x10"


def _pixels(path: Path) -> tuple[np.ndarray, list[str]]:
    """Pixels `h w c` as 0..1, and the letters of the channels."""
    with _opened(path) as image:
        letters = _letters(image)
        try:
            if _is_16_bit(path, image):
                return _deep(path, letters)
            mode = {"YA": "LA", "Y": "L"}.get(letters, letters)
            values = np.asarray(image if image.mode == mode else image.convert(mode), np.float32) / 255
        except (OSError, ValueError, SyntaxError, EOFError) as error:
            raise _refused(path, error) from error
    return values.reshape(*values.shape[:2], -1), list(letters)


def _deep(path: Path, letters: str) -> tuple[np.ndarray, list[str]]:
    layout = {"Y": "gray16le", "RGB": "rgb48le", "RGBA": "rgba64le"}.get(letters, "rgba64le")
    try:
        with av.open(str(path)) as file:
            values = next(file.decode(video=0)).to_ndarray(format=layout)
    except (av.FFmpegError, StopIteration, ValueError) as error:
        raise _refused(path, error) from error
    pixels = values.reshape(*values.shape[:2], -1).astype(np.float32) / 65535
    return pixels, list(letters) if len(letters) == pixels.shape[2] else list("RGBA")


def _arrays(path: Path) -> dict[str, np.ndarray]:
    """Planes `h w` of every array of a file; nothing but numbers is ever unpickled."""
    if not path.is_file():
        raise FileNotFoundError(f"{path} does not exist")
    load: Callable[[Path], dict[str, np.ndarray]] = _archived if path.suffix.lower() == ".npz" else _mapped
    try:
        held = load(path)
    except Exception as error:  # a damaged header meets NumPy's and Python's own parsers, which raise what they like
        raise _refused(path, error) from error
    pictures = {name: a for name, a in held.items() if a.dtype.kind in "fiub" and a.ndim in (2, 3) and a.size}
    if not pictures:
        found = "; ".join(f"{name or 'it'} is {a.dtype} of shape {a.shape}" for name, a in list(held.items())[:4])
        raise ClipError(f"{path} holds no picture ({found}); it needs numbers, height x width x channels")
    alone = len(pictures) == 1
    planes = {}
    for name, values in pictures.items():
        values = values.reshape(*values.shape[:2], -1)
        for place in range(values.shape[2]):
            planes[str(place) if alone else f"{name}.{place}"] = values[:, :, place]
    return planes


def _mapped(path: Path) -> dict[str, np.ndarray]:
    return {"": np.asarray(np.load(path, mmap_mode="r", allow_pickle=False))}


def _archived(path: Path) -> dict[str, np.ndarray]:
    with zipfile.ZipFile(path) as archive:
        held = sum(entry.file_size for entry in archive.infolist())
    if held > LARGEST:
        raise ValueError(f"{held} bytes when unpacked")
    with np.load(path, allow_pickle=False) as arrays:
        return {name: np.asarray(arrays[name]) for name in arrays.files}


def write(path: Path, channels: Mapping[str, np.ndarray]) -> None:
    """One image file, whole or not at all: EXR as the arrays are, PNG as 8 bits of 0..1, npy and npz as half floats.

    Args:
        channels: arrays `h w` by channel name; for npy and npz the names are places, and places in between are 0.

    Raises:
        ClipError: it cannot be written (no space, no permission).
    """
    kind = path.suffix.lower()
    if kind == ".exr":
        return exr.write(path, channels)
    with exr.whole(path) as temporary:
        if kind == ".png":
            order = "".join(sorted(channels, key="RGBA".find))
            pixels = np.stack([channels[name] for name in order], -1)
            image = Image.fromarray(np.rint(np.clip(pixels, 0, 1) * 255).astype(np.uint8).squeeze())
            image.save(temporary)
            return None
        planes = np.zeros((*next(iter(channels.values())).shape, max(map(int, channels)) + 1), np.float16)
        for name, plane in channels.items():
            planes[..., int(name)] = plane
        if kind == ".npz":
            np.savez_compressed(temporary, i=planes)
        else:
            np.save(temporary, planes)
    return None
