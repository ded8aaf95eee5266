"""What the experiments look at: some frames of a folder, their layers as stored, and images that can be compared."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from framecast.clip import Record
from framecast.doctor.probe import comparable
from framecast.doctor.source import Source
from framecast.exr import ClipError
from framecast.importers.decode import decode_color
from framecast.importers.settings import layers

PIXELS = 30_000_000
"""Pixels that are looked at in all, and so memory and time: 32 frames of 1280x720, 4 of 3840x2160."""

MOST, LEAST = 32, 4
"""Frames that are looked at."""

RUN = 8
"""Neighbouring frames that are looked at together where there are more frames than that."""

ALWAYS = ("color", "depth", "motion")
"""Buffers that are kept of every frame; colour as a comparable image."""

SOMETIMES = ("motion_next", "normal", "albedo", "object")
"""Buffers that are kept of a few frames."""


@dataclass(frozen=True)
class Take:
    """Frames in order, every list one entry a frame."""

    numbers: tuple[int, ...]
    stored: Sequence[Mapping[str, np.ndarray]]
    """Layers as stored, `c h w`, by the names of `Frame`: colour and `SOMETIMES` only in a few frames."""
    images: Sequence[np.ndarray]
    """Colour made comparable, `3 h w`."""
    records: Sequence[Record]
    recorded: frozenset[str]
    """What the records really know: jitter, cameras, lens."""
    joined: tuple[bool, ...]
    """Whether a frame is said to follow the one before it: False for the first, after a hole, and at recorded cuts."""
    stretch: float = 1.0
    """Distance in time of neighbouring frames, divided by the time that vectors are said to reach."""
    level: float = 1.0
    """Median of the first frame's linear colour."""
    blemishes: Mapping[str, int] = field(default_factory=dict)
    """NaN and infinite numbers by buffer."""

    @property
    def size(self) -> tuple[int, int]:
        """Height and width of the images."""
        height, width = self.images[0].shape[1:]
        return height, width

    @property
    def pairs(self) -> list[int]:
        """Frames that follow the one before."""
        return [t for t in range(len(self.numbers)) if self.joined[t]]

    def without(self, apart: Collection[int]) -> "Take":
        """The same where these frames do not follow the ones before."""
        return replace(self, joined=tuple(j and t not in apart for t, j in enumerate(self.joined)))

    def full(self, *names: str) -> list[int]:
        """Frames of which all these buffers were kept."""
        return [t for t, stored in enumerate(self.stored) if all(name in stored for name in names)]


def chosen(numbers: Sequence[int], pixels: int) -> list[int]:
    """Positions of the frames to look at: all, or runs of neighbours spread over the sequence."""
    most = int(np.clip(PIXELS // max(pixels, 1), LEAST, MOST))
    count = len(numbers)
    if count <= most:
        return list(range(count))
    runs = max(1, most // RUN)
    length = most // runs
    starts = [round(i * (count - length) / max(runs - 1, 1)) for i in range(runs)]
    return sorted({s + k for s in starts for k in range(length)})


def load(source: Source) -> Take:
    """The frames to look at.

    Raises:
        ClipError: a file is damaged, frames differ in size, or there is only one.
    """
    if len(source.numbers) < 2:
        raise ClipError(
            f"{source.path} holds one frame; what vectors mean shows only between frames, give at "
            "least two, better eight"
        )
    first = source.read(source.numbers[0], ("color",))["color"]
    size = first.shape[1:]
    positions = chosen(source.numbers, size[0] * size[1])
    keep = set(positions[:: max(1, len(positions) // 4)][:5])
    level = 0.0
    stored, kept, blemishes = [], [], dict[str, int]()
    sizes: dict[str, tuple[int, ...]] = {}
    for position, planes in zip(positions, _read_ahead(source, positions, keep), strict=True):
        number = source.numbers[position]
        for name, pixels in planes.items():
            if sizes.setdefault(name, pixels.shape[1:]) != pixels.shape[1:]:
                raise ClipError(_other_size(source, name, number, pixels.shape[1:], sizes[name]))
            bad = int(pixels.size - np.count_nonzero(np.isfinite(pixels))) if pixels.dtype.kind == "f" else 0
            if bad:
                blemishes[name] = blemishes.get(name, 0) + bad
        if "color" not in planes:
            continue
        color = linear(source, planes["color"])
        level = level or max(float(np.median(np.nan_to_num(color, posinf=0, neginf=0))), 1e-4)
        kept.append(comparable(color, level))
        if position not in keep:
            planes.pop("color")
        stored.append(planes)
    numbers = [source.numbers[p] for p in positions]
    records = [source.records[p] for p in positions]
    step = min(b - a for a, b in pairwise(source.numbers))
    joined = (
        False,
        *(b - a == step and not there.cut for (a, b), there in zip(pairwise(numbers), records[1:], strict=True)),
    )
    gap = abs(source.records[1].time - source.records[0].time) or 1.0
    return Take(
        tuple(numbers), stored, kept, records, source.recorded, joined, gap / source.span if source.span else 1.0,
        level, blemishes,
    )  # fmt: skip


def _read_ahead(source: Source, positions: Sequence[int], keep: Collection[int]) -> Iterator[dict[str, np.ndarray]]:
    """Buffers as stored, those of the next frame read while the ones before are looked at."""

    def read(position: int) -> dict[str, np.ndarray]:
        return source.read(source.numbers[position], (*ALWAYS, *SOMETIMES) if position in keep else ALWAYS)

    with ThreadPoolExecutor(1) as reader:
        coming = reader.submit(read, positions[0])
        for position in positions[1:]:
            planes, coming = coming.result(), reader.submit(read, position)
            yield planes
        yield coming.result()


def linear(source: Source, color: np.ndarray) -> np.ndarray:
    """Colour decoded as claimed."""
    claim = source.claim.color
    return decode_color(color, claim) if claim else color.astype(np.float32)


def _other_size(source: Source, name: str, number: int, got: Sequence[int], want: Sequence[int]) -> str:
    return (
        f"{source.path}: {name} of frame {number} is {got[1]}x{got[0]} but the first one is {want[1]}x{want[0]}; "
        f"these are two shots, put each into a folder of its own"
    )


__all__ = ["Take", "chosen", "layers", "linear", "load"]
