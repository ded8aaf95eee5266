"""A folder of unknown origin: which files belong together, what they claim to be, and their frames as stored."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from framecast import exr
from framecast.clip import ON_DISK, Record, open_clip
from framecast.doctor.names import SPELLINGS, WORDS, Held, by_content, by_name, named
from framecast.exr import ClipError
from framecast.importers import SOURCES, images
from framecast.importers.blender import absent, open_shot, ranges
from framecast.importers.decode import decode_jitter
from framecast.importers.folder import Found, Listing, open_folder
from framecast.importers.passes import Pass, passes, plain
from framecast.importers.readings import fitting
from framecast.importers.settings import (
    NAME,
    Color,
    Depth,
    Layer,
    Motion,
    Normal,
    Scalar,
    Settings,
    layers,
    read_settings,
)

KINDS: dict[str, type[Layer]] = {
    "color": Color, "albedo": Color, "depth": Depth, "motion": Motion, "motion_next": Motion, "normal": Normal,
    "roughness": Scalar, "metallic": Scalar, "object": Scalar,
}  # fmt: skip

LOOKED_AT = ("color", "depth", "motion", "motion_next", "normal", "albedo", "object")
"""Buffers that experiments read."""


@dataclass(frozen=True)
class Source:
    """What a folder holds, and what it claims."""

    path: Path
    kind: str
    """clip, settings, blender, a name of `importers.SOURCES`, or unknown."""
    claim: Settings
    files: Mapping[str, Mapping[int, tuple[str, ...]]]
    """File names by buffer and frame number."""
    bits: Mapping[str, int]
    numbers: tuple[int, ...]
    records: tuple[Record, ...]
    recorded: frozenset[str]
    """What the records really know: jitter, cameras, exposure."""
    remarks: tuple[str, ...] = ()
    """What is wrong with the files themselves, one sentence each."""
    span: float | None = None
    asides: tuple[str, ...] = field(default=())
    """What is worth knowing and not wrong."""

    def read(self, number: int, names: Sequence[str]) -> dict[str, np.ndarray]:
        """Buffers of a frame as stored, `c h w`; those that lack a file are left out. Each file is read once.

        Raises:
            ClipError: a file is damaged.
        """
        told, out = layers(self.claim), {}
        opened: dict[str, dict[str, np.ndarray]] = {}
        for name in names:
            if name not in told or number not in self.files[name]:
                continue
            parts = []
            for file in self.files[name][number]:
                path = self.path / file
                if path.suffix.lower() in (".exr", ".npz"):
                    if file not in opened:
                        opened[file] = images.channels(path)
                    channels = opened[file]
                    if lack := [c for c in told[name].channels if images.matching(list(channels), c) is None]:
                        raise ClipError(f"{path} lacks {', '.join(lack)}, which other files have; export it again")
                    parts += [channels[str(images.matching(list(channels), c))] for c in told[name].channels]
                else:
                    parts += list(images.read(path, told[name].channels))
            out[name] = images.stacked(path, told[name].channels, parts)
            if self.claim.bottom_up:
                out[name] = out[name][:, ::-1]
            if self.claim.crop:
                out[name] = out[name][:, : self.claim.crop[1], : self.claim.crop[0]]
        return out


def open_source(folder: Path | str) -> Source:
    """What is in a folder; headers are read, and pixels of two frames where no name tells what a layer is.

    Raises:
        FileNotFoundError: no such folder. ClipError: nothing in it that can be examined; the message says why.
    """
    listing = Listing(Path(folder))
    if not listing.names:
        raise ClipError(f"{folder} holds no image file ({', '.join(images.EXTENSIONS)}); give the folder of one shot")
    if (listing.folder / "clip.json").is_file():
        return _of_clip(listing)
    if (listing.folder / NAME).is_file():
        return _of_settings(listing, "settings", Found(read_settings(listing.folder)))
    held = passes(listing)
    if not held:
        raise ClipError(f"{folder} holds no numbered image file; name the files with their frame number, shot.0001.exr")
    if _is_blenders(listing, held):
        return _of_blender(listing, held)
    for name, module in SOURCES.items():
        if found := module.recognise(listing):
            if name in ("unity", "unreal"):  # they look for the ends of names, data sets for whole ones
                _refuse_two_shots(listing, held)
            return _of_settings(listing, name, found)
    return _unknown(listing, held)


def _of_clip(listing: Listing) -> Source:
    clip = open_clip(listing.folder)
    told: dict[str, Any] = {}
    for name in clip.layers:
        if name in KINDS:
            told[name] = KINDS[name](files=("frames/{frame}.exr",), channels=ON_DISK[name])
    if "motion_next" in told:
        told["motion_next"] = replace(told["motion_next"], direction="current->next")
    files = {record.number: listing.folder / "frames" / f"{record.number:04d}.exr" for record in clip.records}
    if unshaded := [number for number, path in files.items() if "R" not in exr.header(path).names]:
        raise ClipError(
            f"{listing.folder} has no colour in frame {ranges(unshaded)}; the doctor compares neighbours, give a clip "
            f"that is shaded in every frame"
        )
    return _source(
        listing, "clip", Settings(source="generic", fps=clip.fps, span=clip.span, **told), clip.records,
        remarks=(), span=clip.span,
    )  # fmt: skip


def _is_blenders(listing: Listing, held: Sequence[Pass]) -> bool:
    labels = {p.label.partition("/")[2] for p in held}
    return (listing.folder / "shot.json").is_file() or any(
        label.endswith(word) for label in labels for word in ("combined", "indexob", "denoisingalbedo")
    )


def _of_blender(listing: Listing, held: Sequence[Pass]) -> Source:
    found = by_name([p for p in held if not p.label.endswith("noisyimage")])
    claim = _claimed(found)
    if claim.motion:
        claim = replace(claim, motion=replace(claim.motion, sign=(1.0, -1.0)))
    if claim.motion_next:
        claim = replace(claim, motion_next=replace(claim.motion_next, sign=(1.0, -1.0), direction="next->current"))
    records: tuple[Record, ...] = ()
    remark: tuple[str, ...] = ()
    try:
        records = open_shot(listing.folder).records
    except ClipError as error:
        remark = (str(error),)
    return _source(listing, "blender", replace(claim, source="blender"), records, remarks=remark, span=1.0)


def _of_settings(listing: Listing, kind: str, found: Found) -> Source:
    records: tuple[Record, ...] = ()
    remark: tuple[str, ...] = ()
    try:
        found = fitting(listing.folder, found)
        records = open_folder(listing.folder, found.settings, found.poses).records
    except ClipError as error:
        remark = (str(error),)
    return _source(listing, kind, found.settings, records, remarks=remark, span=found.settings.span)


def _unknown(listing: Listing, held: Sequence[Pass]) -> Source:
    _refuse_two_shots(listing, held)
    found = by_name(held)
    found |= _by_content(listing, held, found)
    if "color" not in found:
        what = images.short(sorted({p.label.strip("/") or "RGB" for p in held}))
        raise ClipError(
            f"{listing.folder} has no colour that can be told from its other layers (it has "
            f"{what}); export the beauty pass"
        )
    return _source(listing, "unknown", _claimed(found), ())


def _claimed(found: Mapping[str, Held]) -> Settings:
    """Buffers as `Frame` has them."""
    told: dict[str, Any] = {n: KINDS[n](files=(h.pattern,), channels=h.channels) for n, h in found.items()}
    if "motion" in found and len(found["motion"].channels) == 4:
        told["motion"] = replace(told["motion"], packing="base255", bias=(0.5, 0.5), units="uv")
    if "motion_next" in told:
        told["motion_next"] = replace(told["motion_next"], direction="current->next")
    if "color" in found and found["color"].bits == 8:
        told["color"] = replace(told["color"], encoding="srgb")
    if "normal" in found and found["normal"].bits < 32:
        told["normal"] = replace(told["normal"], encoded=True)
    return Settings(source="generic", **told)


def _refuse_two_shots(listing: Listing, held: Sequence[Pass]) -> None:
    """Two shots in one folder: colour and vectors in the same files or in files called alike, more than once."""
    roles: dict[str, set[str]] = {}
    names: dict[str, str] = {}
    told = [(p, role) for p in held if (role := named(p)) in ("color", "motion")]
    for p, role in told:
        alone = all(other == role for q, other in told if q.pattern == p.pattern)
        rest = _without_word(p, str(role)) if alone else p.pattern
        roles.setdefault(rest, set()).add(str(role))
        names.setdefault(rest, p.pattern)
    whole = [names[rest] for rest, found in roles.items() if found == {"color", "motion"}]
    if len(whole) > 1:
        each = " and ".join(f"{p} {ranges(listing.numbered(p))}" for p in whole[:3])
        raise ClipError(f"{listing.folder} holds {len(whole)} shots ({each}); put each into a folder of its own")


def _without_word(held: Pass, role: str) -> str:
    """A pattern without the word that names its buffer, so that one shot's files are alike."""
    pattern = held.pattern.lower()
    word = next((word for word in WORDS[role] if word in plain(pattern)), "")
    return plain(pattern).replace(word, "", 1)


def _by_content(listing: Listing, held: Sequence[Pass], found: Mapping[str, Held]) -> dict[str, Held]:
    """Layers that no name explains, told by their numbers."""
    lacking = [name for name in ("color", "motion", "depth", "normal", "albedo") if name not in found]
    unnamed = [p for p in held if named(p) is None]
    if not unnamed or not ({"color", "motion", "depth"} & set(lacking)):
        return {}
    planes = {}
    for k, p in enumerate(unnamed[:24]):
        order = sorted(p.letters, key=lambda c: ("RGBAXYZWUV0123".find(c[0]) % 99, c))[:4]
        here = Held(p.pattern, tuple(p.letters[c] for c in order), p.about.bits, p.about.size)
        numbered = listing.numbered(p.pattern)
        number = sorted(numbered)[len(numbered) // 2]
        pixels = images.read(listing.folder / numbered[number], here.channels)
        planes[f"{k}"] = (here, pixels, pixels)
    out = {}
    for role, label in by_content(planes, lacking).items():
        here = planes[label][0]
        count = {"color": 3, "normal": 3, "albedo": 3, "depth": 1, "motion": 4 if _packed(here) else 2}[role]
        out[role] = replace(here, channels=here.channels[:count])
    return out


def _packed(held: Held) -> bool:
    return held.bits == 8 and len(held.channels) == 4


def _source(
    listing: Listing,
    kind: str,
    claim: Settings,
    records: Sequence[Record],
    *,
    remarks: Sequence[str] = (),
    span: float | None = None,
) -> Source:
    """Files by buffer and frame; what is missing becomes a remark."""
    told = layers(claim)
    files: dict[str, dict[int, tuple[str, ...]]] = {}
    bits = {}
    for name, layer in told.items():
        numbered = [listing.numbered(pattern) for pattern in layer.files]
        common = set(numbered[0]).intersection(*numbered)
        files[name] = {n + layer.offset: tuple(of[n] for of in numbered) for n in sorted(common)}
        if not common:
            raise ClipError(f"{listing.folder} has no file {layer.files[0]} for {name}; name the files that are there")
        bits[name] = images.about(listing.folder / numbered[0][min(common)]).bits
    if "color" not in files:
        raise ClipError(f"{listing.folder} has no colour; the doctor compares pictures, export the beauty pass")
    numbers = tuple(sorted(files["color"]))
    holes = _holes(files, numbers)
    again = (*holes, "stored in 8 bits")  # what importers refuse, and what is found here anyway
    remarks = [*(remark for remark in remarks if not any(text in remark for text in again)), *holes]
    by_number = {r.number: r for r in records}
    made = tuple(by_number.get(n) or _plain_record(n, i, numbers, claim, listing) for i, n in enumerate(numbers))
    return Source(
        listing.folder,
        kind,
        claim,
        files,
        bits,
        numbers,
        made,
        _known(made, claim),
        tuple(dict.fromkeys(remarks)),
        span,
    )


def _plain_record(number: int, index: int, numbers: Sequence[int], claim: Settings, listing: Listing) -> Record:
    jitter = (0.0, 0.0)
    if claim.jitter.values or claim.jitter.halton:
        size = images.about(
            listing.folder / next(iter(listing.numbered(layers(claim)["color"].files[0]).values()))
        ).size
        jitter = decode_jitter(claim.jitter, index, size)
    return Record(number=number, time=float(number - numbers[0]), jitter=jitter)


def _known(records: Sequence[Record], claim: Settings) -> frozenset[str]:
    known = set()
    if any(max(map(abs, r.jitter)) > 1e-6 for r in records):
        known.add("jitter")
    if all(r.view is not None and r.projection is not None for r in records):
        known.add("cameras")
    if all(r.projection is not None for r in records):
        known.add("lens")
    return frozenset(known)


def _holes(files: Mapping[str, Mapping[int, Any]], numbers: Sequence[int]) -> list[str]:
    """Missing frames, a sentence each."""
    said = []
    if away := absent(numbers):
        said.append(f"{away} missing in the middle (found {ranges(numbers)}); export what is missing")
    for name, found in files.items():
        if name != "color" and (lack := sorted(set(numbers) - set(found))):
            said.append(f"{name} lacks frame {ranges(lack)}, which colour has; export it again")
    return said


def jitter_of(source: Source) -> dict[str, Any]:
    """Recorded jitter, for a settings file."""
    return json.loads(json.dumps([list(r.jitter) for r in source.records]))


__all__ = ["KINDS", "LOOKED_AT", "SPELLINGS", "Source", "open_source"]
