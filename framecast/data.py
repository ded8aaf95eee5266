"""Training samples: crops in space and time, read from a cache that is mapped into memory.

    cache/street-1a2b3c4d/color.npy ...   one array n c h w for each layer of the clip, n its frames
    cache/street-1a2b3c4d/cache.json      fingerprint of the clip; written last
    cache/street-1a2b3c4d/labels2.npy     true classes n 2 H W at display size (`labels.py`), where asked for

The cache may be deleted at any time and is made again when the clip changes. A crop is a `Clip` of its own whose
frames read nothing else, so the half-rate view, cuts and bridged motion are those of `clip.py`. What a sample is
follows from the seed and its number alone, whichever process makes it.
"""

import hashlib
import json
import os
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import IO, Literal

import numpy as np
import torch
from jaxtyping import Float
from rich.progress import track
from torch import Tensor
from torch.utils.data import DataLoader, Dataset

from framecast import labels as rules
from framecast.clip import HALF, Clip, ClipError, Layers, MotionView, Record
from framecast.exr import whole
from framecast.frame import BUFFERS, Frame, concatenate, unshaded
from framecast.recipe import Recipe

VERSION = 1

SMALLEST = 8
"""Least height and width of a sample, pixels: losses compare windows of seven."""

Flip = Literal["horizontal", "vertical", "transpose"]


@dataclass(frozen=True)
class Footage:
    """A clip whose pixels can be read in parts."""

    clip: Clip
    arrays: Mapping[str, np.ndarray]
    """Layers of all frames, n c h w, under the names of `Frame`, `motion2`, `reference` and `labels`."""


@dataclass(frozen=True)
class Batch:
    """Samples of equal size: frames in arrival order, and what the last ones should become."""

    frames: tuple[Frame, ...]
    """Shaded ones and ones to generate, as `Recipe.mode` says."""
    targets: Float[Tensor, "b n c H W"]
    """What the last n frames should become: colour, and classes where `Recipe.labels` asks for them."""
    names: tuple[str, ...]
    """Where each sample was taken from, for people."""


# The cache.


def cache_folder() -> Path:
    """Where caches lie unless told otherwise: the user's cache folder."""
    return Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "framecast" / "clips"


def footage(clip: Clip, folder: Path | None = None, *, labels: bool = False) -> Footage:
    """The clip with its pixels in the cache under `folder`, made now where it is not there or the clip has changed.

    Args:
        labels: with the true classes of its pixels.

    Raises:
        ClipError: a frame cannot be read, the clip has no sample ranges for labels, or the cache cannot be written.
    """
    where = clip.path.resolve()
    digest = hashlib.sha256(str(where).encode()).hexdigest()[:8]
    home = (folder or cache_folder()) / f"{where.name}-{digest}"
    mark = fingerprint(clip)
    arrays = _opened(home, mark)
    if arrays is None:
        _write(clip, home, mark)
        arrays = _opened(home, mark)
    if arrays is None:
        raise ClipError(f"{home} changed while it was read; delete it and run the same command again")
    return Footage(clip, {**arrays, "labels": _labels(clip, home)} if labels else arrays)


def _labels(clip: Clip, home: Path) -> np.ndarray:
    """The true classes of all frames, n 2 H W, mapped from the cache of the clip, and made where they are not there."""
    path = home / f"labels{rules.RULES}.npy"
    if not path.is_file():
        each = [rules.labels(clip, i) for i in track(range(len(clip)), f"label {home.name}", transient=True)]
        with whole(path) as temporary:
            np.save(temporary, torch.cat([torch.cat((f.ghosting, f.aliasing), 1) for f in each]).numpy())
    mapped: np.ndarray = np.load(path, mmap_mode="c")
    return mapped


def fingerprint(clip: Clip) -> str:
    """Changes whenever a file of the clip, its records or the form of the cache changes."""
    files = sorted(path for path in clip.path.rglob("*") if path.is_file())
    stats = [(str(p.relative_to(clip.path)), p.stat().st_size, p.stat().st_mtime_ns) for p in files]
    text = json.dumps([VERSION, stats, clip.layers, [asdict(r) for r in clip.shown]], default=str)
    return hashlib.sha256(text.encode()).hexdigest()


def _opened(home: Path, mark: str) -> dict[str, np.ndarray] | None:
    """The mapped arrays, or None where there are none, or others, or damaged ones."""
    try:
        about = json.loads((home / "cache.json").read_text())
        if about["fingerprint"] != mark:
            return None
        return {name: np.load(home / f"{name}.npy", mmap_mode="c") for name in about["layers"]}
    except (OSError, ValueError, KeyError):
        return None


def _write(clip: Clip, home: Path, mark: str) -> None:
    """Files are written in order, not mapped: a full disk is then an error and not a crash."""
    part = home.with_name(f".{home.name}.{os.getpid()}.part")
    names: list[str] = []
    try:
        part.mkdir(parents=True, exist_ok=True)
        with ExitStack() as stack:
            files: dict[str, IO[bytes]] = {}
            for index, record in enumerate(track(clip.shown, f"cache {home.name}", transient=True)):
                stored = _stored(clip, index, record)
                if index and stored.keys() != files.keys():
                    other = ", ".join(sorted(stored.keys() ^ files.keys()))
                    raise ClipError(
                        f"frames {clip.shown[0].number} and {record.number} of {clip.path} differ in {other}, and "
                        f"training needs all frames whole, those to generate with their colour too; render it again"
                    )
                for name, pixels in stored.items():
                    if index == 0:
                        files[name] = stack.enter_context((part / f"{name}.npy").open("wb"))
                        about = {"descr": pixels.dtype.str, "fortran_order": False, "shape": (len(clip), *pixels.shape)}
                        np.lib.format.write_array_header_1_0(files[name], about)
                    files[name].write(pixels.tobytes())
            names = list(files)
        (part / "cache.json").write_text(json.dumps({"fingerprint": mark, "layers": names, "clip": str(clip.path)}))
        shutil.rmtree(home, ignore_errors=True)
        part.rename(home)
    except OSError as error:
        raise ClipError(
            f"cannot write the training cache {home}: {error.strerror}; free some space or choose another folder with "
            f"--cache, then run the same command again"
        ) from error
    finally:
        shutil.rmtree(part, ignore_errors=True)


def _stored(clip: Clip, index: int, record: Record) -> Layers:
    """Layers of one frame as the cache keeps them: half floats where the file has no more, ids as they are."""
    layers = dict(clip.checked(record))
    if clip.scale is not None and (image := clip.reference(index)) is not None:
        layers["reference"] = image[0].numpy()
    kinds: dict[str, type[np.generic]] = {
        name: np.float16 if name in {*HALF, "reference"} else np.float32 for name in layers
    }
    if "object" in layers:
        kinds["object"] = np.int32
    limited = {n: np.clip(v, -65504, 65504) if kinds[n] is np.float16 else v for n, v in layers.items()}
    return {name: np.ascontiguousarray(pixels, dtype=kinds[name]) for name, pixels in limited.items()}


# Crops.


def window(source: Footage, corner: tuple[int, int], size: tuple[int, int], names: Sequence[str] = ()) -> Clip:
    """The part of the clip below and to the right of `corner` (row, column), with cameras that see just that part.

    Args:
        names: the layers to read; empty: all of them.
    """
    (top, left), (height, width) = corner, size
    at = {record.number: index for index, record in enumerate(source.clip.shown)}
    kept = tuple(n for n in source.arrays if n not in ("reference", "labels") and (not names or n in names))

    def load(record: Record) -> Layers:
        index = at[record.number]
        return {n: _floats(source.arrays[n][index, :, top : top + height, left : left + width]) for n in kept}

    whole = source.clip.size
    records = tuple(_narrowed(record, corner, size, whole) for record in source.clip.shown)
    return replace(source.clip, size=size, records=records, load=load, layers=kept, scale=None, kept=None)


def _floats(pixels: np.ndarray) -> np.ndarray:
    """A copy; half floats become floats, which torch does several times faster than numpy."""
    if pixels.dtype != np.float16:
        return np.ascontiguousarray(pixels)
    floats: np.ndarray = torch.from_numpy(pixels).to(torch.float32, memory_format=torch.contiguous_format).numpy()
    return floats


def _narrowed(record: Record, corner: tuple[int, int], size: tuple[int, int], whole: tuple[int, int]) -> Record:
    """The record with the projection onto a part of the image."""
    if record.projection is None:
        return record
    p = np.array(record.projection)
    wide, high = whole[1] / size[1], whole[0] / size[0]
    p[0] = p[0] * wide + p[3] * (wide - 1 - 2 * corner[1] / size[1])
    p[1] = p[1] * high - p[3] * (high - 1 - 2 * corner[0] / size[0])
    return replace(record, projection=tuple(tuple(row) for row in p.tolist()))


# Augmentation.

MIRRORS: dict[Flip, tuple[tuple[float, ...], ...]] = {
    "horizontal": ((-1, 0, 0), (0, 1, 0), (0, 0, 1)),
    "vertical": ((1, 0, 0), (0, -1, 0), (0, 0, 1)),
    "transpose": ((0, -1, 0), (-1, 0, 0), (0, 0, 1)),
}
"""What each flip does to camera space (x right, y up), and to the world, which is mirrored with it."""


def flipped(frame: Frame, *flips: Flip) -> Frame:
    """The frame of the world mirrored once or several times, a transposition first: pixels, vectors, normals, jitter
    and cameras turn together."""
    mirror = torch.eye(3)
    for flip in flips:
        mirror = torch.tensor(MIRRORS[flip], dtype=torch.float32) @ mirror
    whole = torch.block_diag(mirror, torch.ones(1, 1))
    changes = {n: flipped_image(image, *flips) for n in BUFFERS if (image := getattr(frame, n)) is not None}
    across = torch.tensor([[1.0, -1.0], [-1.0, 1.0]]) * mirror[:2, :2]  # image y points down
    for name, turn in (("motion", across), ("motion_next", across), ("normal", mirror)):
        if name in changes:
            source, sign = turn.abs().argmax(1), turn.sum(1)  # each row has one entry, 1 or -1
            changes[name] = changes[name][:, source] * sign[:, None, None]
    changes["jitter"] = frame.jitter @ across.T
    if frame.view is not None:
        changes["view"] = whole @ frame.view @ whole.T
    if frame.projection is not None:
        changes["projection"] = whole @ frame.projection @ whole.T
    return replace(frame, **changes)


def flipped_image(image: Tensor, *flips: Flip) -> Tensor:
    """Pixels alone, any number of leading dimensions; a transposition comes first."""
    turned = image.transpose(-1, -2) if "transpose" in flips else image
    axes = [axis for flip, axis in (("horizontal", -1), ("vertical", -2)) if flip in flips]
    return turned.flip(axes).contiguous()


def recoloured(frame: Frame, channels: Sequence[int]) -> Frame:
    """The frame with the channels of its colours, and of the surfaces that they light, in another order."""
    colours = {name: getattr(frame, name) for name in ("color", "albedo")}
    return replace(frame, **{name: image[:, list(channels)] for name, image in colours.items() if image is not None})


def turned(frame: Frame, world: Float[Tensor, "3 3"]) -> Frame:
    """The same picture of a world turned (and mirrored, where the matrix does) about its origin.

    Where light comes from is then no longer told by the axes of a scene, which a network could learn by heart.
    """
    normal = None if frame.normal is None else torch.einsum("ij,bjhw->bihw", world, frame.normal)
    whole = torch.block_diag(world, torch.ones(1, 1))
    return replace(frame, normal=normal, view=None if frame.view is None else frame.view @ whole.T)


# Samples.


class Samples(Dataset[Batch]):
    """Every sample by its number; the same one for the same seed, on any machine and in any process."""

    def __init__(
        self,
        sources: Sequence[Footage],
        recipe: Recipe,
        *,
        fields: Sequence[str],
        seed: int,
        scale: float = 1,
        motion: MotionView = "gap",
    ):
        """`fields`: the buffers to read. `scale`: of the target; above 1 targets are crops of the references. `motion`:
        of shaded frames with others between them, see `Clip.every`. Where a clip is smaller than the recipe's crop, all
        samples are as small: those of one step are of one size.

        Raises:
            ClipError: a clip lacks references that are needed, or is too small, or none is long enough.
        """
        self.sources, self.recipe, self.seed, self.scale, self.motion = sources, recipe, seed, scale, motion
        self.fields = (*fields, "color", "motion2")
        self.starts = [_starts(source.clip, recipe) for source in sources]
        if not any(self.starts):
            raise ClipError(
                f"none of the {len(sources)} clips holds {max(_places(recipe)) + 1} frames of one shot, which a "
                f"sample needs; give longer clips"
            )
        for source in sources:
            if (scale > 1 or recipe.labels) and source.clip.scale != scale:
                raise ClipError(f"{source.clip.path} has no references {scale:g} times its size; render it with them")
            if min(source.clip.size) < SMALLEST:
                height, width = source.clip.size
                raise ClipError(
                    f"{source.clip.path} has {width}x{height} pixels, and samples need at least {SMALLEST} either way; "
                    f"render it larger, or leave it out"
                )
        if min(recipe.crop) < SMALLEST:
            raise ClipError(f"crops of {min(recipe.crop)} pixels are too small to learn from; use {SMALLEST} or more")
        sides = zip(recipe.crop, *(source.clip.size for source in sources), strict=True)
        self.crop = tuple(map(min, sides))

    def __getitem__(self, number: int) -> Batch:
        """One sample, as a batch of one."""
        rng = np.random.default_rng((self.seed, number))
        sizes = [source.clip.size[0] * source.clip.size[1] for source in self.sources]
        weights = np.array([len(starts) * size for starts, size in zip(self.starts, sizes, strict=True)], float)
        which = int(rng.choice(len(self.sources), p=weights / weights.sum()))
        source, start = self.sources[which], int(rng.choice(self.starts[which]))
        grid = Fraction(self.scale).limit_denominator(16).denominator  # corners that display pixels share
        size = tuple(side // grid * grid for side in self.crop)
        corner = tuple(
            grid * int(rng.integers((b - a) // grid + 1)) for a, b in zip(size, source.clip.size, strict=True)
        )
        frames, targets = self.cut(source, start, (corner[0], corner[1]), (size[0], size[1]))
        square: tuple[Flip, ...] = ("transpose",) if size[0] == size[1] else ()
        flips = [flip for flip in (*square, "horizontal", "vertical") if rng.random() < 0.5]
        frames, targets = [flipped(frame, *flips) for frame in frames], flipped_image(targets, *flips)
        if self.recipe.recolour:
            channels, world = rng.permutation(3), torch.linalg.qr(torch.from_numpy(rng.normal(size=(3, 3)))).Q.float()
            frames = [turned(recoloured(frame, channels.tolist()), world) for frame in frames]
            targets = targets[:, :, [*channels.tolist(), *range(3, targets.shape[2])]]
        exposure, tint = rng.uniform(-self.recipe.stops, self.recipe.stops), rng.uniform(-0.5, 0.5, 3)
        gain = torch.from_numpy(2.0 ** (exposure + self.recipe.recolour * tint)).float()[:, None, None]
        bright = tuple(f if f.color is None else replace(f, color=f.color * gain) for f in frames)
        name = f"{source.clip.path.name}, frame {source.clip.shown[start].number}, row {corner[0]}, column {corner[1]}"
        targets = torch.cat((targets[:, :, :3] * gain, targets[:, :, 3:]), 2)
        return Batch(bright, targets, (name,))

    def cut(
        self, source: Footage, start: int, corner: tuple[int, int], size: tuple[int, int]
    ) -> tuple[list[Frame], Tensor]:
        """Frames in arrival order from one place of a clip, and the truth of the last ones."""
        part = window(source, corner, size, self.fields)
        view = part if self.recipe.mode == "pass" else part.every(2, start=start, motion=self.motion)
        frames, targets = [], []
        for place in _places(self.recipe):
            if self.recipe.mode == "pass":
                frames.append(view[start + place])
            else:
                frames.append(unshaded(part[start + place]) if place % 2 else view[place // 2])
        for place in _places(self.recipe)[-self.recipe.truths :]:
            targets.append(self.truth(source, start + place, corner, size))
        bare = [f if "view" in self.fields else replace(f, view=None, projection=None) for f in frames]
        return bare, torch.stack(targets, 1)  # cameras that nobody asks for are not in every clip

    def truth(
        self, source: Footage, index: int, corner: tuple[int, int], size: tuple[int, int]
    ) -> Float[Tensor, "1 c H W"]:
        """What a frame of a clip should become there: its colour, or above scale 1 its reference; and its classes."""
        names = ("reference" if self.scale > 1 else "color", *["labels"] * self.recipe.labels)
        (top, left), (height, width) = (tuple(round(self.scale * v) for v in pair) for pair in (corner, size))
        planes = [source.arrays[name][index, :, top : top + height, left : left + width] for name in names]
        return torch.from_numpy(np.concatenate(planes, dtype=np.float32))[None]


def _places(recipe: Recipe) -> list[int]:
    """Frames of a sample in arrival order, from its first, 0; odd ones are to be generated unless all are shaded."""
    if recipe.mode == "pass":
        return list(range(recipe.shaded))
    if recipe.mode == "alternate":
        return list(range(2 * recipe.shaded))
    last = 2 * recipe.shaded - 1
    return [*range(0, last, 2), last if recipe.mode == "extrapolate" else last - 2]


def _starts(clip: Clip, recipe: Recipe) -> list[int]:
    """Where samples may start: no cut inside, every frame shaded."""
    last = max(_places(recipe))
    inside = range(len(clip) - last)
    return [s for s in inside if not any(clip.is_cut(i) for i in range(s + 1, s + last + 1))]


def joined(samples: Sequence[Batch]) -> Batch:
    """Samples as one batch."""
    columns = zip(*(sample.frames for sample in samples), strict=True)
    return Batch(
        tuple(concatenate(column) for column in columns),
        torch.cat([sample.targets for sample in samples]),
        tuple(name for sample in samples for name in sample.names),
    )


def batches(
    samples: Samples, start: int, *, rank: int = 0, world: int = 1, workers: int = 0, pin: bool = False
) -> Iterator[Batch]:
    """The batches of this process, from step `start` to the recipe's last; processes share out the samples of a step.

    Raises:
        ValueError: the batch cannot be shared out equally.
    """
    size = samples.recipe.batch
    if size % world:
        raise ValueError(f"a batch of {size} cannot be shared by {world} processes; use a multiple of {world}")
    share = size // world
    numbers = [[step * size + rank * share + k for k in range(share)] for step in range(start, samples.recipe.steps)]
    return iter(DataLoader(samples, batch_sampler=numbers, collate_fn=joined, num_workers=workers, pin_memory=pin))
