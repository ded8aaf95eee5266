"""A folder of image files and its `Settings` as a clip: what every importer shares.

`open_folder` reads headers now and pixels when a frame is asked for. `Found` is what a source file of this package
makes of a folder that it recognises.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from framecast.clip import Clip, Layers, Record, repaired
from framecast.exr import ClipError
from framecast.importers import images
from framecast.importers.blender import FPS, absent, ranges
from framecast.importers.cameras import Pose, pose, read_poses
from framecast.importers.decode import decode, decode_jitter, jitter_pixels, picture_size
from framecast.importers.listing import Listing
from framecast.importers.settings import Depth, Layer, Motion, Settings, layers, plain


@dataclass(frozen=True)
class Found:
    """What an importer makes of a folder that it recognises."""

    settings: Settings
    poses: Mapping[int, Pose] = field(default_factory=dict)
    """Cameras by frame number, where the files themselves tell."""
    readings: Sequence[Motion] = ()
    """Other readings of `settings.motion`, where the format leaves it open: the one that fits the pictures is taken."""


@dataclass(frozen=True)
class Dump:
    """Files of a shot, looked through but not read."""

    folder: Path
    settings: Settings
    files: Mapping[str, Mapping[int, tuple[str, ...]]]
    """File names of each buffer by frame number."""
    records: tuple[Record, ...]
    size: tuple[int, int]
    """Height and width of the frames."""

    def stored(self, record: Record) -> Layers:
        """Channels of a frame as its files hold them, each file read once; without vectors that have no file."""
        opened: dict[str, Mapping[str, np.ndarray]] = {}
        out: Layers = {}
        for name, layer in layers(self.settings).items():
            parts = []
            for file in self.files[name].get(record.number, ()):
                path = self.folder / file
                if file not in opened:
                    opened[file] = images.channels(path)
                parts += [opened[file][images.found(path, channel, opened[file])] for channel in layer.channels]
            out |= {name: images.stacked(path, layer.channels, parts)} if parts else {}
        return out

    def decoded(self, stored: Layers, record: Record, settings: Settings | None = None) -> Layers:
        """The fields of a frame by its stored channels, with these settings in place of the own ones.

        Raises:
            ClipError: what `decode` refuses.
        """
        index = self.records.index(record)
        before = self.records[index - 1] if index else None
        after = self.records[index + 1] if index + 1 < len(self.records) else None
        try:
            out = decode(stored, settings or self.settings, record, before, after)
        except ClipError as error:
            raise ClipError(f"frame {record.number} of {self.folder}: {error}") from error
        missing = layers(self.settings).keys() - stored.keys()  # vectors at an end, which reach beyond the files
        return out | {name: np.zeros((2, *self.size), np.float32) for name in missing}


def scan(folder: Path | str, settings: Settings, poses: Mapping[int, Pose] | None = None) -> Dump:
    """Look through a folder; arguments and errors as `open_folder`."""
    listing = Listing(Path(folder))
    told = layers(settings)
    files = {name: _files(listing, name, layer) for name, layer in told.items()}
    numbers = _numbers(listing.folder, told, files)
    seen: dict[str, images.About] = {}
    sizes = {name: _checked(listing.folder, name, told[name], files[name], numbers, seen) for name in told}
    size = picture_size(sizes, settings)
    records = _records(numbers, settings, poses or _poses(listing.folder, settings, size), size)
    return Dump(listing.folder, settings, files, records, size)


def open_folder(
    folder: Path | str,
    settings: Settings,
    poses: Mapping[int, Pose] | None = None,
    *,
    fps: float | None = None,
    repair: bool = False,
) -> Clip:
    """The frames that settings describe, lazily read.

    Args:
        poses: cameras by frame number; without them from the file that the settings name, if any.
        fps: frames a second, above what the settings say.
        repair: replace NaN and infinite pixels in place of refusing them.

    Raises:
        FileNotFoundError: no such folder. ClipError: no file, a frame missing, only one, sizes or channels that differ,
            8 bits of depth or motion; and, when read, what `decode` refuses.
    """
    dump = scan(folder, settings, poses)

    def load(record: Record) -> Layers:
        out = dump.decoded(dump.stored(record), record)
        return repaired(out)[0] if repair else out

    return Clip(
        path=dump.folder,
        fps=_rate(fps, settings),
        size=dump.size,
        records=dump.records,
        load=load,
        layers=tuple(load(dump.records[1])),
        span=settings.span,
        provenance={
            "source": settings.source,
            "notes": _notes(fps, settings, dump.records[0].view is not None),
            "settings": plain(settings),
        },
    )


def _files(listing: Listing, name: str, layer: Layer) -> dict[int, tuple[str, ...]]:
    """File names of a buffer by the number of the frame that they belong to.

    Raises:
        ClipError: a pattern matches nothing, or one of several lacks a frame that another has.
    """
    found = []
    for pattern in layer.files:
        numbered = listing.numbered(pattern)
        if not numbered:
            held = f"{len(listing.names)} image files, such as {listing.names[0]}" if listing.names else "no image file"
            raise ClipError(f"{listing.folder} has no file {pattern} for {name}; it holds {held}")
        found.append(numbered)
    if lack := sorted(set().union(*found) - set(found[0]).intersection(*found)):
        raise ClipError(f"{listing.folder}: not all files of frame {lack[0]} for {name} are there; export it again")
    return {number + layer.offset: tuple(numbered[number] for numbered in found) for number in found[0]}


def _numbers(folder: Path, told: Mapping[str, Layer], files: Mapping[str, Mapping[int, tuple[str, ...]]]) -> list[int]:
    """Numbers of the frames that are complete: every buffer is there; vectors may lack where they reach beyond an end.

    Raises:
        ClipError: a hole, a buffer that lacks a frame, or fewer than two frames.
    """
    solid = {name: set(found) for name, found in files.items() if not isinstance(told[name], Motion)} or {
        name: set(found) for name, found in files.items()
    }
    frames = set[int]().union(*solid.values())
    if away := absent(sorted(frames)):
        raise ClipError(f"{folder}: {away} missing in the middle (found {ranges(frames)}); export what is missing")
    for name, found in files.items():
        lack = frames - set(found)
        if isinstance(told[name], Motion):
            lack -= {min(frames), max(frames)}
        elif told[name].offset:
            lack = set()
        if lack:
            raise ClipError(f"{folder}: {name} lacks frame {ranges(lack)}, which other buffers have; export it again")
    complete = sorted(frames.intersection(*solid.values()))
    if len(complete) < 2:
        raise ClipError(f"{folder} holds {len(complete)} frame of a sequence; give at least two, numbered in order")
    return complete


def _checked(
    folder: Path,
    name: str,
    layer: Layer,
    files: Mapping[int, tuple[str, ...]],
    numbers: Sequence[int],
    seen: dict[str, images.About],
) -> tuple[int, int]:
    """Height and width of a buffer's files.

    Args:
        seen: what is known of files by now; each is looked into once.

    Raises:
        ClipError: they differ, lack a channel, or hold depth or motion in 8 bits.
    """
    first: images.About | None = None
    for number in numbers:
        for file in files.get(number, ()):
            if file not in seen:
                seen[file] = images.about(folder / file)
            about = seen[file]
            first = first or about
            if about.size_of(layer.channels[0]) != first.size_of(layer.channels[0]):
                (h, w), (height, width) = about.size_of(layer.channels[0]), first.size_of(layer.channels[0])
                raise ClipError(
                    f"{folder}: {file} is {w}x{h} but the first one is {width}x{height}; "
                    f"all frames of a shot need one size, put the shots into separate folders"
                )
            if lack := [c for c in layer.channels if images.matching(about.names, c) is None]:
                raise ClipError(
                    f"{folder}: {file} lacks {', '.join(lack)} for {name} (it has {images.short(about.names)})"
                )
    assert first is not None  # every pattern matched a file
    if first.bits == 8 and isinstance(layer, Depth | Motion) and layer.packing == "none":
        raise ClipError(
            f"{folder}: {name} is stored in 8 bits, whose 256 steps are too coarse; export 16 or 32 bits (EXR), "
            f"or leave {name} out of the settings"
        )
    return first.size_of(layer.channels[0])


def _poses(folder: Path, settings: Settings, size: tuple[int, int]) -> dict[int, Pose]:
    cameras = settings.cameras
    if cameras is None or cameras.file is None:
        return {}
    return read_poses(folder / cameras.file, settings.axes, size, fov=cameras.fov, scale=cameras.scale)


def _records(
    numbers: Sequence[int], settings: Settings, poses: Mapping[int, Pose], size: tuple[int, int]
) -> tuple[Record, ...]:
    """Times count the numbers in the file names; a cut in a frame that was left out is one of the next frame."""
    out = []
    lens = _lens(settings, size)
    exposures = settings.color.exposure if settings.color else (1.0,)
    cuts = {number for number, there in poses.items() if there.cut}
    for index, (before, number) in enumerate(zip((numbers[0], *numbers), numbers, strict=False)):
        here = poses.get(number, Pose())
        held = here.exposure or exposures[index % len(exposures)]
        first = poses.get(numbers[0], Pose()).exposure or exposures[0]
        jitter = (
            decode_jitter(settings.jitter, index, size)
            if here.jitter is None
            else jitter_pixels(here.jitter, settings.jitter, size)
        )
        out.append(
            Record(
                number=number,
                time=float(number - numbers[0]),
                jitter=jitter,
                view=here.view,
                projection=here.projection or lens.projection,
                cut=not cuts.isdisjoint(range(before + 1, number + 1)),
                exposure=first,
                extra={} if held == first else {"exposure": held},
            )
        )
    return tuple(out)


def _lens(settings: Settings, size: tuple[int, int]) -> Pose:
    fov = settings.cameras.fov if settings.cameras else None
    return pose({"fov": fov}, settings.axes, size)


def _rate(asked: float | None, settings: Settings) -> float:
    if asked is not None and not asked > 0:
        raise ValueError(f"{asked} frames a second were asked for; give a number above 0")
    return asked or settings.fps or FPS


def _notes(asked: float | None, settings: Settings, has_cameras: bool) -> list[str]:
    """What a user should know of this folder, one sentence each."""
    rate = f"{_rate(asked, settings):g} frames a second"
    view_normals = settings.normal is not None and settings.normal.space == "view" and not has_cameras
    notes = {
        f"{rate}, as asked": asked is not None,
        f"{rate}, from the settings": asked is None and settings.fps is not None,
        f"{rate}, assumed: nothing tells (say it with --fps)": asked is None and settings.fps is None,
        "no normal: it is stored in view space, and no camera is known": view_normals,
        "no cameras: methods that need them are not available": not has_cameras,
    }
    return [*(note for note, holds in notes.items() if holds), *settings.notes]
