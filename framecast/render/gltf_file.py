"""What a glTF file holds, as numpy arrays: buffers, accessors, images. Errors are one sentence that says what to do.

The JSON is read as it is, because the loaders at hand either build an object per entry (pygltflib: half a minute for a
character of 76 animations, against a tenth of a second) or leave out skins and shape keys (trimesh).
"""

import base64
import io
import json
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from jaxtyping import Num, UInt8
from numpy import ndarray
from PIL import Image, UnidentifiedImageError

READ = {
    "KHR_lights_punctual",
    "KHR_materials_emissive_strength",
    "KHR_materials_pbrSpecularGlossiness",
    "KHR_materials_unlit",
    "KHR_mesh_quantization",
    "KHR_texture_transform",
}
"""Extensions that are understood; a file that requires any other is refused."""

TYPES = {5120: np.int8, 5121: np.uint8, 5122: np.int16, 5123: np.uint16, 5125: np.uint32, 5126: np.float32}
SHAPES: dict[str, tuple[int, ...]] = {
    "SCALAR": (), "VEC2": (2,), "VEC3": (3,), "VEC4": (4,), "MAT2": (2, 2), "MAT3": (3, 3), "MAT4": (4, 4)
}  # fmt: skip


class Entry(dict[str, Any]):
    """A JSON object whose properties are attributes too; None stands for what the file leaves out."""

    def __getattr__(self, name: str) -> Any:
        return self.get(name)


@dataclass(frozen=True, eq=False)
class File:
    """An opened glTF file."""

    path: Path
    document: Entry
    buffers: list[bytes]


def read(path: Path) -> File:
    """Opens a .gltf or .glb file with all its buffers. Raises FileNotFoundError or ValueError."""
    if not path.is_file():
        raise FileNotFoundError(f"there is no file {path}; give the path of a .glb or .gltf file")
    data = path.read_bytes()
    try:
        text, blob = _chunks(data) if data[:4] == b"glTF" else (data, b"")
        document = json.loads(text.decode("utf-8-sig"), object_hook=Entry)
        version = str(document["asset"]["version"])
    except (ValueError, KeyError, TypeError, struct.error):
        raise ValueError(f"{path} is not a glTF file; give a .glb or .gltf file of version 2.0") from None
    if not version.startswith("2"):
        raise ValueError(f"{path} is glTF {version}; framecast reads 2.0. Export it again as glTF 2.0")
    missing = sorted(set(document.extensionsRequired or ()) - READ)
    if missing:
        raise ValueError(
            f"{path} needs {', '.join(missing)}, which framecast does not read. Save the file without it "
            "(Draco and meshopt: export without compression; KTX2 textures: export PNG or JPEG)"
        )
    buffers = [_buffer(path, buffer, blob) for buffer in document.buffers or ()]
    return File(path, document, buffers)


def _chunks(data: bytes) -> tuple[bytes, bytes]:
    """The JSON and the binary chunk of a .glb file."""
    chunks, start = {}, 12
    while start + 8 <= len(data):
        length, kind = struct.unpack_from("<I4s", data, start)
        chunks[kind] = data[start + 8 : start + 8 + length]
        start += 8 + length
    return chunks[b"JSON"], chunks.get(b"BIN\0", b"")


def _buffer(path: Path, buffer: Entry, blob: bytes) -> bytes:
    data = blob if buffer.uri is None else _fetch(path, buffer.uri)
    if len(data) < buffer.byteLength:
        raise ValueError(
            f"{path} is cut short: a buffer has {len(data)} of {buffer.byteLength} bytes. Export the file again"
        )
    return data


def _fetch(path: Path, uri: str) -> bytes:
    """Bytes of a data URI or of a file beside the glTF file."""
    if uri.startswith("data:"):
        return base64.b64decode(uri.partition(",")[2])
    beside = path.parent / unquote(uri)
    if not beside.is_file():
        raise FileNotFoundError(f"{path} refers to {uri}, which is not beside it; copy that file to {beside}")
    return beside.read_bytes()


def accessor(file: File, index: int) -> Num[ndarray, "n ..."]:
    """Values of an accessor: floats, or integers as stored. Normalised integers become floats in -1..1 or 0..1.

    Matrices are transposed from the file's column order, so that `matrix @ column` is meant.
    """
    a = file.document.accessors[index]
    shape, kind = SHAPES[a.type], np.dtype(TYPES[a.componentType]).newbyteorder("<")
    values = np.zeros((a.count, *shape), kind)
    if a.bufferView is not None:
        values = _strided(file, a.bufferView, a.byteOffset or 0, a.count, shape, kind)
    if a.sparse is not None:
        which, given = a.sparse.indices, a.sparse["values"]  # the attribute is the dict's own method
        kind_index = np.dtype(TYPES[which.componentType]).newbyteorder("<")
        where = _strided(file, which.bufferView, which.byteOffset or 0, a.sparse.count, (), kind_index)
        values = values.copy()
        values[where] = _strided(file, given.bufferView, given.byteOffset or 0, a.sparse.count, shape, kind)
    if a.normalized and kind.kind != "f":
        top = 2 ** (8 * kind.itemsize - (kind.kind == "i")) - 1
        values = np.maximum(values / np.float32(top), -1.0)
    values = values.swapaxes(-1, -2) if a.type.startswith("MAT") else values
    return values.astype(np.float32) if values.dtype.kind == "f" else values.astype(values.dtype.newbyteorder("="))


def _strided(file: File, view_index: int, offset: int, count: int, shape: tuple[int, ...], kind: np.dtype) -> ndarray:
    """Elements of a buffer view, whose columns of byte-sized matrices start on multiples of four bytes."""
    view = file.document.bufferViews[view_index]
    start = (view.byteOffset or 0) + offset
    inner: tuple[int, ...] = (kind.itemsize,)
    if len(shape) == 2:
        inner = (-(-shape[1] * kind.itemsize // 4) * 4, kind.itemsize)
    size = shape[0] * inner[0] if shape else kind.itemsize
    stride = view.byteStride or size
    if count and start + stride * (count - 1) + size > len(file.buffers[view.buffer]):
        raise ValueError(f"{file.path} is damaged: an accessor reads past the end of its buffer. Export the file again")
    array = np.ndarray((count, *shape), kind, file.buffers[view.buffer], start, (stride, *inner[: len(shape)]))
    return np.array(array)


def image(file: File, index: int) -> UInt8[ndarray, "h w 4"]:
    """Pixels of an image: embedded, in a data URI or a file beside; PNG, JPEG or what else Pillow reads."""
    source = file.document.images[index]
    if source.bufferView is not None:
        view = file.document.bufferViews[source.bufferView]
        start = view.byteOffset or 0
        data = file.buffers[view.buffer][start : start + view.byteLength]
    elif source.uri is not None:
        data = _fetch(file.path, source.uri)
    else:
        raise ValueError(f"{file.path}: image {index} has neither data nor a file name. Export the file again")
    try:
        with Image.open(io.BytesIO(data)) as picture:
            return np.array(picture.convert("RGBA"))
    except UnidentifiedImageError:
        name = source.name or source.uri or index
        raise ValueError(
            f"{file.path}: image {name} is in no format that Pillow reads. Export it as PNG or JPEG"
        ) from None
