"""A recorded sequence: a folder with `clip.json` and one multi-channel EXR per frame.

    clip/clip.json            fps, size, span of the vectors, per frame: time, camera, jitter, cut, exposure
    clip/frames/0007.exr      channels named like the fields of `Frame`; without R G B the frame is not shaded
    clip/reference/0007.exr   what a method should have made, at display size (optional)

Frames are read when asked for, one at a time. The folder may be written by several processes: each frame file carries
its own record, and `finish` collects them. Every other source of frames (`importers/`) is a `Clip` with its own `load`.
"""

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from framecast import exr
from framecast.exr import ClipError
from framecast.frame import BUFFERS, LAYERS, SKY, Frame
from framecast.warp import chain, trajectory

__all__ = [
    "Clip",
    "ClipError",
    "Record",
    "check",
    "finish",
    "mended",
    "open_clip",
    "read_layers",
    "repaired",
    "write_frame",
]

VERSION = 1
Matrix = tuple[tuple[float, ...], ...]
Layers = dict[str, np.ndarray]
MotionView = Literal["gap", "step"]

ON_DISK = {**LAYERS, "motion2": ("motion2.X", "motion2.Y")}
"""Channel names in a frame file. `motion2`: exact motion to the frame before the previous one."""

ABOUT = ("fps", "width", "height", "layers", "motion_span", "reference_scale", "provenance")
"""What `clip.json` says besides its version and its frames."""

HALF = frozenset({"color", "albedo", "normal", "roughness", "metallic"})
"""Buffers stored as half floats; depth and motion keep 32 bits, object ids are 32-bit integers."""


@dataclass(frozen=True)
class Record:
    """What is known of one frame besides its pixels."""

    number: int
    """Number in the file name."""
    time: float
    """Moment in clip frames; a shot that holds every second frame has times 0, 2, 4."""
    jitter: tuple[float, float] = (0.0, 0.0)
    view: Matrix | None = None
    projection: Matrix | None = None
    cut: bool = False
    """True when history does not reach across the start of this frame."""
    exposure: float = 1.0
    """Factor already in `color`; divide by it for scene radiance."""
    extra: dict[str, Any] = field(default_factory=dict)
    """Anything the source wants to keep beside the frame."""


@dataclass(frozen=True)
class Clip:
    """Frames in time order, read lazily. `every(2)` is the half-rate view of the same files."""

    path: Path
    fps: float
    size: tuple[int, int]
    """Height and width of the frames."""
    records: tuple[Record, ...]
    load: Callable[[Record], Layers]
    """Pixels of one frame: arrays `c h w` under the names of `Frame` and `motion2`."""
    layers: tuple[str, ...]
    """What every frame carries, in the names of `Frame` and `motion2`."""
    span: float | None = None
    """Time that motion vectors reach; None: to the neighbouring frame of the clip."""
    scale: float | None = None
    """Size of the references divided by the size of the frames; None: no references."""
    provenance: dict[str, Any] = field(default_factory=dict)
    kept: range | None = None
    motion: MotionView = "gap"

    def __len__(self) -> int:
        return len(self._kept)

    @property
    def _kept(self) -> range:
        return range(len(self.records)) if self.kept is None else self.kept

    @property
    def shown(self) -> tuple[Record, ...]:
        """Records of the frames in this view."""
        return tuple(self.records[i] for i in self._kept)

    def every(self, step: int, *, start: int = 0, motion: MotionView = "gap") -> "Clip":
        """The view that holds every `step`-th frame from `start` on.

        With motion "gap" the vectors reach to the neighbouring frame of the view: `motion2` where recorded, else
        chained through the frames between. With "step" they stay as recorded and point at the frames left out, as
        a renderer writes them when it skips frames (Blender's frame step). A cut in a frame left out cuts the view.
        """
        return replace(self, kept=self._kept[start::step], motion=motion)

    def is_cut(self, index: int) -> bool:
        """Whether history is invalid at this frame of the view: the first one, or a cut since the one before."""
        here = self._kept[index]
        if index == 0:
            return True
        return any(record.cut for record in self.records[self._kept[index - 1] + 1 : here + 1])

    def __getitem__(self, index: int) -> Frame:
        """The frame, batch of one, float32 (object ids int32).

        Raises:
            ClipError: the file is truncated, of another size, lacks a layer or holds NaN or infinite pixels.
        """
        if not 0 <= index < len(self):
            raise IndexError(f"frame {index} of a clip of {len(self)}")
        record = self.records[self._kept[index]]
        layers = self.checked(record)
        span = self._span(index)
        if self.motion == "gap" and self._kept.step > 1:
            layers, span = self._bridged(index, layers, span)
        return _frame(record, layers, span=span, reset=self.is_cut(index))

    def reference(self, index: int) -> Float[Tensor, "1 3 H W"] | None:
        """The reference image of a frame of the view, linear, or None where the clip has none."""
        record = self.records[self._kept[index]]
        path = self.path / "reference" / f"{record.number:04d}.exr"
        if not path.is_file():
            return None
        return _tensor(read_layers(path, {"color": LAYERS["color"]})["color"])

    def checked(self, record: Record) -> Layers:
        """Pixels of one frame as they were loaded; raises as `__getitem__` does for a wrong size or NaN."""
        layers = self.load(record)
        for name, pixels in layers.items():
            if pixels.shape[-2:] != self.size:
                (height, width), some = pixels.shape[-2:], any(p.shape[-2:] == self.size for p in layers.values())
                if not some:
                    raise ClipError(_wrong_size(self.path, record.number, (height, width), self.size))
                raise ClipError(
                    f"{name} of frame {record.number} of {self.path} has {width}x{height} pixels and the frame "
                    f"{self.size[1]}x{self.size[0]}; write every layer at the size of the colour"
                )
            if not np.isfinite(pixels).all():
                bad = int(np.count_nonzero(~np.isfinite(pixels)))
                raise ClipError(
                    f"frame {record.number} of {self.path}: {bad} NaN or infinite pixels in {name}; "
                    f"render it again, or replace them: --repair of framecast upsample, or of framecast import"
                )
        return layers

    def _span(self, index: int) -> float:
        """Time that the recorded vectors of this frame reach."""
        if self.span is not None:
            return self.span
        here = self._kept[index]
        neighbour = here - 1 if here > 0 else min(1, len(self.records) - 1)
        return abs(self.records[here].time - self.records[neighbour].time) or 1.0

    def _bridged(self, index: int, layers: Layers, span: float) -> tuple[Layers, float]:
        """Vectors of a frame stretched to its neighbours in the view, and the time that they reach."""
        here, step = self._kept[index], self._kept.step
        gap = abs(
            self.records[here].time
            - self.records[here - step if here >= step else min(here + step, len(self.records) - 1)].time
        )
        out = {k: v for k, v in layers.items() if k != "motion2"}
        for name, sign in (("motion", -1), ("motion_next", 1)):
            if name not in layers:
                continue
            path = range(here + sign, here + sign * step, sign)
            if name == "motion" and step == 2 and "motion2" in layers:
                out[name] = layers["motion2"]
            elif span * step > gap * 1.001:
                raise ClipError(f"{self.path}: vectors reach {span:g} frames but frames are closer than that")
            elif span * step < gap * 0.999 or not all(0 <= i < len(self.records) for i in path):
                out[name] = _stretched(layers, span, sign * gap)
            else:
                fields = [layers, *(self.checked(self.records[i]) for i in path)]
                depths = [_tensor(f["depth"]) for f in fields] if "depth" in layers else None
                out[name] = chain([_tensor(f[name]) for f in fields], depths)[0].numpy()
        return out, gap or span


def _stretched(layers: Layers, span: float, dt: float) -> np.ndarray:
    """Vectors over `dt` from vectors over `span`, on the quadratic path that they define; straight with one of both."""
    forward = _tensor(layers["motion_next"]) if "motion_next" in layers else None
    back = layers["motion"] if "motion" in layers else -layers["motion_next"]
    return (
        trajectory(_tensor(back), forward, torch.tensor([float(span)]))
        .displacement(torch.tensor([float(dt)]))[0]
        .numpy()
    )


def _tensor(pixels: np.ndarray) -> Tensor:
    kind = np.int32 if pixels.dtype.kind in "ui" else np.float32
    return torch.from_numpy(np.ascontiguousarray(pixels, dtype=kind))[None]


def _frame(record: Record, layers: Layers, *, span: float, reset: bool) -> Frame:
    matrix = {k: None if v is None else torch.tensor([v], dtype=torch.float32) for k, v in _cameras(record).items()}
    buffers = {name: _tensor(layers[name]) for name in BUFFERS if name in layers}
    if "depth" in buffers:
        buffers["depth"] = buffers["depth"].clamp(max=SKY)
    return Frame(
        **buffers,
        **matrix,
        jitter=torch.tensor([record.jitter], dtype=torch.float32),
        time=torch.tensor([record.time], dtype=torch.float32),
        reset=torch.tensor([reset]),
        span=torch.tensor([span], dtype=torch.float32),
    )


def _cameras(record: Record) -> dict[str, Matrix | None]:
    return {"view": record.view, "projection": record.projection}


def _wrong_size(path: Path, number: int, got: tuple[int, ...], want: tuple[int, int]) -> str:
    return (
        f"{path}: frame {number} is {got[1]}x{got[0]} but the first one is {want[1]}x{want[0]}; "
        f"all frames of a clip need one size, put the shots into separate folders"
    )


def read_layers(path: Path, names: Mapping[str, tuple[str, ...]]) -> Layers:
    """Those of the named buffers that an EXR file holds completely, each `c h w`."""
    channels = exr.read(path, mixed=True).channels
    return {k: np.stack([channels[c] for c in names[k]]) for k in names if all(c in channels for c in names[k])}


def open_clip(folder: Path | str, *, repair: bool = False) -> Clip:
    """A clip on disk. Headers are checked now, pixels when a frame is read.

    Args:
        repair: replace NaN and infinite pixels in place of refusing them (see `repaired`).

    Raises:
        FileNotFoundError: no such folder. ClipError: no clip there, another version, missing or unequal frames.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise FileNotFoundError(f"{folder} is not a folder; give a clip or a folder of rendered EXR files")
    if not (folder / "clip.json").is_file():
        raise ClipError(f"{folder} is no clip (it has no clip.json); make one with: framecast import {folder} -o CLIP")
    about, records = _described(folder)
    height, width = about["height"], about["width"]
    for record in records:
        path = folder / "frames" / f"{record.number:04d}.exr"
        if not path.is_file():
            raise ClipError(f"{folder}: frame {record.number} is missing (no {path.name}); render or copy it again")
        if exr.size(path) != (height, width):
            raise ClipError(_wrong_size(folder, record.number, exr.size(path), (height, width)))

    def load(record: Record) -> Layers:
        layers = read_layers(folder / "frames" / f"{record.number:04d}.exr", ON_DISK)
        return repaired(layers)[0] if repair else layers

    return Clip(
        path=folder,
        fps=about["fps"],
        size=(height, width),
        records=records,
        load=load,
        layers=tuple(about["layers"]),
        span=about["motion_span"],
        scale=about["reference_scale"],
        provenance=about["provenance"],
    )


def _described(folder: Path) -> tuple[dict[str, Any], tuple[Record, ...]]:
    """The contents of clip.json, with everything that may be wrong with it said in a sentence."""
    path = folder / "clip.json"
    try:
        about = json.loads(path.read_text())
        if about["version"] != VERSION:
            raise ClipError(
                f"{path} has version {about['version']}; this framecast reads version {VERSION}: import it again"
            )
        records = tuple(Record(**{k: _tuples(v) for k, v in f.items()}) for f in about["frames"])
        about = {name: about[name] for name in ABOUT}
    except ClipError:
        raise
    except (OSError, json.JSONDecodeError, KeyError, TypeError, UnicodeDecodeError) as error:
        raise ClipError(
            f"{path} cannot be read ({type(error).__name__}: {error}); import or render the clip again"
        ) from error
    if not records:
        raise ClipError(f"{folder} holds no frames; render or import it again")
    return about, records


def check(clip: Clip) -> tuple[str, ...]:
    """Everything that is wrong with the frames of a view, one sentence each; reads every frame once."""
    complaints = []
    for index, record in enumerate(clip.shown):
        try:
            frame = clip[index]
        except ClipError as error:
            complaints.append(str(error))
            continue
        where = f"frame {record.number} of {clip.path}"
        lacking = [n for n in BUFFERS if n in clip.layers and n != "color" and getattr(frame, n) is None]
        if lacking:
            complaints.append(f"{where}: no {' and no '.join(lacking)}, which the first frame has; render it again")
        if frame.color is not None and bool((frame.color < 0).any()):
            complaints.append(f"{where}: color is below 0; a denoiser or a filter undershot, clamp it")
        if frame.depth is not None and bool((frame.depth <= 0).any()):
            complaints.append(f"{where}: depth is 0 or less; it has to be a distance in front of the camera")
        if frame.normal is not None and bool((frame.normal.norm(dim=1) > 1.05).any()):
            complaints.append(f"{where}: normals are longer than 1; export unit vectors in world space")
        if bool((frame.jitter.abs() > 0.5).any()):
            complaints.append(f"{where}: jitter is beyond half a pixel; give it in pixels of the render size")
    return tuple(complaints)


def _tuples(value: Any) -> Any:
    """JSON arrays as tuples, so that a record read equals the record written."""
    return tuple(map(_tuples, value)) if isinstance(value, list) else value


def repaired(layers: Layers) -> tuple[Layers, int]:
    """Layers with every NaN or infinite pixel replaced, and how many there were.

    Depth becomes SKY, motion 0, everything else the mean of the finite pixels in the 3 x 3 neighbourhood (else 0).
    """
    out, count = {}, 0
    for name, pixels in layers.items():
        bad = ~np.isfinite(pixels)
        count += int(bad.sum())
        if bad.any():
            fill = SKY if name == "depth" else 0 if name.startswith("motion") else _finite_mean(pixels, bad)
            pixels = np.where(bad, fill, pixels).astype(pixels.dtype)
        out[name] = pixels
    return out, count


def mended(clip: Clip) -> tuple[Clip, dict[int, int]]:
    """The clip with NaN and infinite pixels replaced (see `repaired`), and how many, by frame number, as it is read."""
    counts: dict[int, int] = {}

    def load(record: Record) -> Layers:
        layers, counts[record.number] = repaired(clip.load(record))
        return layers

    return replace(clip, load=load), counts


def _finite_mean(pixels: np.ndarray, bad: np.ndarray) -> np.ndarray:
    value = np.pad(np.where(bad, 0, pixels).astype(np.float32), ((0, 0), (1, 1), (1, 1)))
    weight = np.pad((~bad).astype(np.float32), ((0, 0), (1, 1), (1, 1)))
    h, w = pixels.shape[-2:]
    shifts = [(slice(None), slice(y, y + h), slice(x, x + w)) for y in range(3) for x in range(3)]
    return sum(value[s] for s in shifts) / np.maximum(sum(weight[s] for s in shifts), 1)


def write_frame(
    folder: Path, record: Record, layers: Layers, *, reference: np.ndarray | None = None, half: frozenset[str] = HALF
) -> None:
    """One frame of a clip, from any process, whole or not at all.

    Args:
        layers: arrays `c h w` under the names of `Frame` and `motion2`; without color the frame is not shaded.
        reference: linear `3 H W` at display size.
        half: buffers stored as half floats (values clamp at 65504).
    """
    channels: dict[str, np.ndarray] = {}
    for name, pixels in layers.items():
        kind = np.uint32 if name == "object" else np.float16 if name in half else np.float32
        limited = np.clip(pixels, -65504, 65504) if kind is np.float16 else pixels
        channels.update({c: limited[i].astype(kind) for i, c in enumerate(ON_DISK[name])})
    attributes = {"framecast": json.dumps(asdict(record))}
    if reference is not None:
        pixels = np.clip(reference, 0, 65504).astype(np.float16)
        exr.write(folder / "reference" / f"{record.number:04d}.exr", dict(zip("RGB", pixels, strict=True)))
    exr.write(folder / "frames" / f"{record.number:04d}.exr", channels, attributes=attributes)


def finish(
    folder: Path,
    *,
    fps: float,
    span: float | None = None,
    scale: float | None = None,
    provenance: Mapping[str, Any] | None = None,
) -> Clip:
    """Collect the frames that `write_frame` made into `clip.json`, and open the clip.

    Raises:
        ClipError: no frame was written, or they differ in size.
    """
    paths = sorted((folder / "frames").glob("[0-9]*.exr"))
    if not paths:
        raise ClipError(f"{folder} holds no frames yet; write some first")
    first = exr.read(paths[0])
    records = [json.loads(exr.attributes(path)["framecast"]) for path in paths]
    height, width = first.size
    about = {
        "format": "framecast clip",
        "version": VERSION,
        "fps": fps,
        "width": width,
        "height": height,
        "layers": [name for name, channels in ON_DISK.items() if all(c in first.channels for c in channels)],
        "motion_span": span,
        "reference_scale": scale,
        "provenance": dict(provenance or {}),
        "frames": sorted(records, key=lambda record: record["time"]),
    }
    with exr.whole(folder / "clip.json") as temporary:
        temporary.write_text(json.dumps(about, indent=1))
    return open_clip(folder)
