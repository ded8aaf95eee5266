"""Training crops packed small enough to travel to a machine that cannot render: under 60 MB for some dozens.

    python benchmarks/gpu/crops.py 'clips/train/*' crops/

One file for each crop of six frames; of these the three shaded ones and the one to generate are kept, with vectors in
128ths of a pixel, half-float colour and depth, and 8 bits for the rest.
"""

import argparse
import glob
import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from framecast.clip import Clip, ClipError, Layers, Record
from framecast.data import Footage, footage, window
from framecast.exr import whole
from framecast.importers import open_any

LIMIT = 60e6
"""Bytes of all crops together."""

SHADED, HIDDEN = (0, 2, 4), 5

CODES: dict[str, tuple[type[np.generic], float]] = {
    "color": (np.float16, 1),
    "depth": (np.float16, 1),
    "motion": (np.int16, 128),
    "motion2": (np.int16, 128),
    "albedo": (np.uint8, 255),
    "normal": (np.int8, 127),
    "roughness": (np.uint8, 255),
    "metallic": (np.uint8, 255),
    "object": (np.uint16, 1),
}
"""How each layer is stored: the type, and what a value is multiplied by."""


def pack(sources: Sequence[Footage], folder: Path, *, size: int = 160, limit: float = LIMIT, seed: int = 0) -> int:
    """Writes crops at random places until their files hold `limit` bytes; how many there are."""
    rng, total, count = np.random.default_rng(seed), 0, 0
    while total < limit:
        source = sources[int(rng.integers(len(sources)))]
        start = int(rng.integers(len(source.clip) - HIDDEN))
        if any(source.clip.is_cut(i) for i in range(start + 1, start + HIDDEN + 1)):
            continue
        area = (min(size, source.clip.size[0]), min(size, source.clip.size[1]))
        corner = tuple(int(rng.integers(b - a + 1)) for a, b in zip(area, source.clip.size, strict=True))
        part = window(source, (corner[0], corner[1]), area, tuple(CODES))
        path = folder / f"{count:04d}.npz"
        _write(part, start, path)
        total, count = total + path.stat().st_size, count + 1
    return count


def _write(part: Clip, start: int, path: Path) -> None:
    records = part.records[start : start + HIDDEN + 1]
    stacks: dict[str, list[np.ndarray]] = {name: [] for name in CODES}
    for k, record in enumerate(records):
        layers = part.load(record)
        for name, (kind, factor) in CODES.items():
            wanted = (k in SHADED and name != "motion") or (k == HIDDEN and name != "motion2")
            pixels = layers[name].astype(np.float32) * factor if wanted else np.zeros_like(layers[name], np.float32)
            low, high = (np.iinfo(kind).min, np.iinfo(kind).max) if np.issubdtype(kind, np.integer) else (-65504, 65504)
            rounded = np.rint(pixels) if np.issubdtype(kind, np.integer) else pixels
            stacks[name].append(np.clip(rounded, low, high).astype(kind))
    about = {"name": part.path.name, "fps": part.fps, "records": [asdict(record) for record in records]}
    with whole(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, about=json.dumps(about), **{n: np.stack(s) for n, s in stacks.items()})


def unpack(folder: Path) -> Iterator[Footage]:
    """The crops of a folder, decoded.

    Raises:
        ClipError: there are none.
    """
    paths = sorted(folder.glob("*.npz"))
    if not paths:
        raise ClipError(f"{folder} holds no crops; pack some first: python benchmarks/gpu/crops.py 'clips/*' {folder}")
    for path in paths:
        with np.load(path) as file:
            about = json.loads(str(file["about"]))
            arrays = {name: _decoded(name, file[name]) for name in CODES}
        records = tuple(Record(**{k: _tuples(v) for k, v in r.items()}) for r in about["records"])

        def load(record: Record, arrays: Layers = arrays, records: tuple[Record, ...] = records) -> Layers:
            return {name: array[records.index(record)] for name, array in arrays.items()}

        height, width = arrays["color"].shape[-2:]
        clip = Clip(Path(about["name"]), about["fps"], (height, width), records, load, tuple(arrays), span=1.0)
        yield Footage(clip, arrays)


def _tuples(value: Any) -> Any:
    """JSON arrays as tuples."""
    return tuple(map(_tuples, value)) if isinstance(value, list) else value


def _decoded(name: str, stored: np.ndarray) -> np.ndarray:
    if name == "object":
        return stored.astype(np.int32)
    return stored.astype(np.float32) / np.float32(CODES[name][1])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("clips", help="pattern of clips, in quotes")
    parser.add_argument("out", type=Path, help="folder for the crops")
    arguments = parser.parse_args()
    made = pack([footage(open_any(path)) for path in sorted(glob.glob(arguments.clips))], arguments.out)
    print(f"{made} crops -> {arguments.out}")
