"""Foreign folders as clips: one file per source, and what all of them share.

clip = open_any("shot")          our own format, or the source that the folder looks like
print(describe(clip, needs))     what was found, what is lacking, and which methods that allows
save(clip, "clip")               into our own format
"""

import json
import math
import shutil
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, replace
from hashlib import sha256
from pathlib import Path
from types import ModuleType

from framecast import exr
from framecast.clip import HALF, Clip, ClipError, Layers, Record, finish, open_clip, repaired, write_frame
from framecast.frame import BUFFERS
from framecast.importers import arm, blender, extranet, images, mitsuba, mobfgsr, stssnet, unity, unreal
from framecast.importers.folder import Listing, open_folder
from framecast.importers.readings import fitting
from framecast.importers.settings import NAME, Settings, read_settings

__all__ = ["SOURCES", "describe", "open_any", "repairs", "save"]

SOURCES: dict[str, ModuleType] = {
    "unreal": unreal,
    "unity": unity,
    "extranet": extranet,
    "stssnet": stssnet,
    "mobfgsr": mobfgsr,
    "mitsuba": mitsuba,
    "arm-nss": arm,
}
"""Sources that a folder may look like. Each module has `recognise` and, in words, what it LOOKS like."""


def open_any(
    folder: Path | str,
    *,
    fps: float | None = None,
    repair: bool = False,
    source: str | None = None,
    settings: Path | str | None = None,
) -> Clip:
    """The clip in a folder: our own where there is a clip.json; else as settings say; else as what it looks like.

    Args:
        fps: frames a second of a shot that does not tell, or tells wrongly; None: as found.
        repair: replace NaN and infinite pixels in place of refusing them.
        source: blender, generic (settings), or a name of `SOURCES`; None: found out.
        settings: a settings file; None: `framecast-import.json` of the folder, if there is one.

    Raises:
        FileNotFoundError: no such folder. ClipError: nothing in it that can be used; the message says why.
        ValueError: `fps` is not above 0.
    """
    folder = Path(folder)
    if fps is not None and not 0 < fps < math.inf:
        raise ValueError(f"{fps:g} frames a second were asked for; give a number above 0")
    if source is None and settings is None and (folder / "clip.json").is_file():
        clip = open_clip(folder, repair=repair)
        return clip if fps is None else replace(clip, fps=fps)
    if source not in (None, "blender", "generic", *SOURCES):
        raise ClipError(f"{source} is not known; import from blender, generic, {', '.join(SOURCES)}")
    if settings is not None and source not in (None, "generic"):
        raise ClipError(f"a settings file tells everything; leave --from {source} out, or the settings")
    if settings is not None or source == "generic" or (source is None and (folder / NAME).is_file()):
        told = read_settings(folder) if settings is None else _beside(read_settings(settings), Path(settings))
        return open_folder(folder, told, fps=fps, repair=repair)
    if source == "blender" or (source is None and _is_blenders(folder)):
        return blender.open_shot(folder, fps=fps, repair=repair)
    listing = Listing(folder)
    if source is None and not listing.names:
        return blender.open_shot(folder)  # says what is needed
    for name in SOURCES if source is None else (source,):
        if found := SOURCES[name].recognise(listing):
            fitted = fitting(folder, found)
            return open_folder(folder, fitted.settings, fitted.poses, fps=fps, repair=repair)
    raise ClipError(_unrecognised(listing, source))


def _beside(settings: Settings, path: Path) -> Settings:
    """With the file of cameras that lies beside a settings file, if there is one, in place of one in the folder."""
    cameras = settings.cameras
    if cameras is None or cameras.file is None:
        return settings
    near = (path if path.is_dir() else path.parent) / cameras.file
    return replace(settings, cameras=replace(cameras, file=str(near.resolve()))) if near.is_file() else settings


def _is_blenders(folder: Path) -> bool:
    """Whether a numbered EXR file of the folder has passes that only Blender names so, or none is of another kind."""
    if (folder / "shot.json").is_file():
        return True
    files = [path for path in sorted(folder.glob("*.exr")) if not path.name.startswith(".")] if folder.is_dir() else []
    for path in files[:1]:
        header = exr.header(path)
        named = {name.rpartition(".")[0].rpartition(".")[2].lower() for name in header.names}
        return bool(
            named & {"combined", "vector", "denoising albedo", "indexob"}
        ) or "Blender" in header.attributes.get("Software", "")
    return False


def _unrecognised(listing: Listing, source: str | None) -> str:
    """What was looked for, what there is, and what to do."""
    sought = SOURCES[source].LOOKS if source else f"what Blender, {', '.join(SOURCES)} write (docs/importers.md)"
    patterns = listing.patterns()
    what = f"{len(listing.names)} image file{'s' * (len(listing.names) > 1)}"
    such = ""
    if patterns:
        pattern, name = next(iter(patterns.items()))
        such = f", such as {pattern} with the channels {images.short(images.about(listing.folder / name).names)}"
    return (
        f"{listing.folder} is not recognised: it holds {what}{such}; looked for {sought}; "
        f"let framecast doctor {listing.folder} find out what the files mean, or write a {NAME} by hand"
    )


def describe(clip: Clip, methods: Mapping[str, Sequence[str]]) -> str:
    """What a clip holds, what it lacks and which methods it serves, a few lines of text.

    Args:
        methods: per method the fields of `Frame` that it needs.
    """
    height, width = clip.size
    numbers = blender.ranges(record.number for record in clip.shown)
    found = [*clip.layers, *_cameras(clip)]
    always = {"jitter", "time", "reset", "span"}
    short = {m: [n for n in needs if n not in {*found, *always}] for m, needs in methods.items()}
    lines = {
        "shot": f"{clip.path}: {len(clip)} frames ({numbers}), {width}x{height}, {clip.fps:g} frames a second",
        "found": ", ".join(found),
        "lacks": ", ".join(n for n in (*BUFFERS, "view", "projection") if n not in found),
        "allows": ", ".join(method for method, lack in short.items() if not lack),
        "not": "; ".join(f"{method} (needs {', '.join(lack)})" for method, lack in short.items() if lack),
    }
    notes = [("note", note) for note in clip.provenance.get("notes", ())]
    return "\n".join(f"{name:<7} {text}" for name, text in [*lines.items(), *notes] if text)


def _cameras(clip: Clip) -> list[str]:
    """Those of view and projection that every frame has."""
    return [n for n in ("view", "projection") if all(getattr(record, n) is not None for record in clip.records)]


def save(
    clip: Clip,
    out: Path | str,
    *,
    repair: bool = False,
    full: bool = False,
    progress: Callable[[Sequence[int]], Iterable[int]] = iter,
) -> Clip:
    """Write any clip in our own format, frame by frame; `out` appears when it is complete.

    Until then the frames lie in a hidden folder beside it. When the run is interrupted they stay and the same call
    goes on from there; when a frame cannot be read or written they are removed.

    Args:
        clip: a whole clip, not a half-rate view.
        repair: replace NaN and infinite pixels; `repairs` tells how many.
        full: keep 32 bits where a clip otherwise holds half floats (colour, albedo, normal).
        progress: wraps the indices of the frames, for a progress bar.

    Raises:
        ClipError: `out` exists, a frame cannot be used (see `Clip`), or the file system refuses.
    """
    if clip.kept is not None:
        raise ValueError("a view of a clip was given; save the clip itself")
    out = Path(out)
    if out.exists() and not (out.is_dir() and not any(out.iterdir())):
        raise ClipError(f"{out} exists already; give another name, or remove it to import again")
    place = out.resolve()
    part = place.with_name(f".{place.name}.part")
    try:
        _begin(part, _identity(clip, repair, full))
        for index in progress(range(len(clip))):
            _write(clip, index, part, repair, frozenset() if full else HALF)
        finish(part, fps=clip.fps, span=clip.span, scale=clip.scale, provenance=clip.provenance)
    except (ClipError, OSError):
        shutil.rmtree(part, ignore_errors=True)
        raise
    (part / "source").unlink()
    if out.exists():
        out.rmdir()
    part.rename(place)
    return open_clip(out)


def repairs(clip: Clip) -> int:
    """How many NaN or infinite values `save` replaced when it wrote this clip."""
    return sum(record.extra.get("repaired", 0) for record in clip.records)


def _begin(part: Path, identity: str) -> None:
    """Go on with what an interrupted run left, if it was the same import; else start from nothing."""
    mark = part / "source"
    if not mark.is_file() or mark.read_text() != identity:
        shutil.rmtree(part, ignore_errors=True)
        with exr.whole(mark) as temporary:
            temporary.write_text(identity)


def _identity(clip: Clip, repair: bool, full: bool) -> str:
    """Changes when the source's files, what they are taken to mean, or the options do."""
    files = [path for depth in ("*.*", "*/*.*", "*/*/*.*") for path in clip.path.glob(depth)]
    files = [p for p in files if p.is_file() and not any(n.startswith(".") for n in p.relative_to(clip.path).parts)]
    stats = sorted((str(p), p.stat().st_size, p.stat().st_mtime_ns) for p in files)  # without what is being written
    records = [asdict(record) for record in clip.records]
    about = [str(clip.path.resolve()), clip.fps, clip.span, clip.provenance, repair, full, stats, records]
    return sha256(json.dumps(about).encode()).hexdigest()


def _write(clip: Clip, index: int, part: Path, repair: bool, half: frozenset[str]) -> None:
    """One frame, unless it is there."""
    record = clip.records[index]
    if _readable(part / "frames" / f"{record.number:04d}.exr"):
        return
    count = 0

    def load(record: Record) -> Layers:
        nonlocal count
        layers, count = repaired(clip.load(record))
        return layers

    layers = (replace(clip, load=load) if repair else clip).checked(record)
    reference = clip.reference(index)
    if count:
        record = replace(record, extra={**record.extra, "repaired": count})
    write_frame(part, record, layers, reference=None if reference is None else reference[0].numpy(), half=half)


def _readable(path: Path) -> bool:
    try:
        exr.read(path)
    except (ClipError, FileNotFoundError):
        return False
    return True
