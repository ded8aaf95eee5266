"""One page that shows what an evaluation measured: numbers, curves, and the images themselves, to the pixel.

Rows come from a results file. The images are made again by running the methods over the clips, and the page says where
their PSNR is not that of the rows. `page` fills the page, `packing` writes the images into it.
"""

import hashlib
import math
import statistics
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import torch
import torch.nn.functional as F
from jaxtyping import Float, UInt16
from rich.progress import Progress, TimeElapsedColumn
from torch import Tensor
from tyro.conf import Positional, arg

from framecast import __version__, exr, packing
from framecast.clip import Clip, ClipError
from framecast.color import to_display
from framecast.evaluate import Footage, Made, Settings, judged, require_length
from framecast.evaluate import images as images_of
from framecast.flip import flip_map
from framecast.importers import open_any
from framecast.metrics import METRICS, lpips_missing
from framecast.page import Content, Run, Strip, page
from framecast.provenance import About, Source, fingerprint
from framecast.results import Mode, Role, Row, is_higher_better, read_provenance, read_results

SMALLEST = 240
"""Height in pixels down to which large images are cropped before frames are left out."""

COARSE = 270
"""Lines of the images in which the place where most changes is looked for."""

AGREE = 0.02
"""Difference in dB up to which images made again have the PSNR of the rows."""

MEGABYTES = 24.0
"""Size that a page keeps to."""

Out = Annotated[Path, arg(aliases=["-o"])]


@dataclass(frozen=True)
class Job:
    """Methods on one clip in one mode and size."""

    clip: str
    mode: Mode
    scale: float
    methods: tuple[str, ...]

    @property
    def role(self) -> Role:
        """Of the frames that the comparison is about."""
        return "shaded" if self.mode == "pass" else "generated"


@dataclass(frozen=True)
class Window:
    """The part of a clip whose images the page holds: frames, and pixels of the output."""

    frames: range
    left: int
    top: int
    width: int
    height: int

    def cut(self, image: Float[Tensor, "1 c H W"]) -> Float[Tensor, "c h w"]:
        """The pixels of an image that lie in the window."""
        return image[0, :, self.top : self.top + self.height, self.left : self.left + self.width]


@dataclass
class Images:
    """Packed images by content, so that what two methods share is held once."""

    held: dict[str, tuple[str, str]] = field(default_factory=dict)
    """Size ("width height planes") and text by id."""

    def add(self, codes: UInt16[Any, "c h w"]) -> str:
        """Id of an image."""
        planes, height, width = codes.shape
        name = f"i{hashlib.sha256(codes.tobytes() + str(codes.shape).encode()).hexdigest()[:16]}"
        if name not in self.held:
            self.held[name] = (f"{width} {height} {planes}", packing.pack(codes))
        return name

    def add_map(self, values: Float[Tensor, "1 h w"]) -> str:
        """Id of a map in 0..1."""
        return self.add((values * 255).round().cpu().numpy().astype("uint16"))


def report(
    rows: Sequence[Row],
    clips: Mapping[str, Clip],
    about: About | None = None,
    *,
    megabytes: float = MEGABYTES,
    device: str = "cpu",
    advance: Callable[[], object] = lambda: None,
) -> str:
    """The page of some rows.

    Args:
        clips: by the names that the rows use.
        megabytes: size that the page keeps to, by cropping large images and leaving out frames of long clips.
        advance: called after each method on each clip.

    Raises:
        ValueError: no rows, a method that is not here. ClipError: frames that cannot be read.
    """
    jobs = jobs_of(rows)
    images, runs, notes = Images(), [], []
    for job in jobs:
        clip = clips[job.clip]
        require_length(clip, job.mode)
        window = window_of(clip, job, (megabytes - 0.3) * 1e6 / len(jobs))
        made = {}
        for name in job.methods:
            made[name] = list(looks(clip, job, name, window, images, settings_of(rows, job, device)))
            advance()
        runs.append(run_of(clip, job, window, made, rows))
        notes += [*cropped(clip, job, window), *unjudged(job, made), *disagreements(rows, job, made)]
    bits = f"logarithmic, {packing.STEPS} steps for a factor of two: values are within 0.4 % of what they were"
    facts = {"Made by": f"framecast {__version__}", "Images": f"linear colour, {bits}"}
    return page(Content(runs, images.held, rows, about, facts, notes))


def jobs_of(rows: Sequence[Row]) -> list[Job]:
    """What the rows are about, in their order; raises ValueError where there are none."""
    found: dict[tuple[str, Mode, float], dict[str, None]] = {}
    for row in rows:
        found.setdefault((row.clip, row.mode, row.scale), {})[row.method] = None
    if not found:
        raise ValueError("there are no rows to report; make some with: framecast evaluate CLIP --json results.json")
    return [Job(*key, tuple(methods)) for key, methods in found.items()]


def settings_of(rows: Sequence[Row], job: Job, device: str) -> Settings:
    """How to measure again what the rows of a job measured, LPIPS only where its weights are here."""
    names = dict.fromkeys(row.metric for row in rows if row.metric in METRICS and row.clip == job.clip)
    metrics = tuple(name for name in names if name != "lpips" or lpips_missing() is None)
    return Settings(metrics=metrics, device=device, scale=job.scale)


# Which part of a clip the page holds.


def window_of(clip: Clip, job: Job, budget: float) -> Window:
    """The largest part of a clip whose images take about `budget` bytes.

    Large images are cropped, to the place where most changes between frames; of long clips the frames around the one
    that changes most are kept.
    """
    height, width = (round(side * job.scale) for side in clip.size)
    # Methods that generate frames leave the others alone, unless they enlarge them.
    changed = 1.0 if job.mode == "pass" or job.scale > 1 else 0.5
    each = bytes_per_pixel(clip) * (1 + 1.25 * changed * len(job.methods))  # a quarter more for the FLIP map
    room = budget / (each * len(clip))
    if height * width <= room:
        return Window(range(len(clip)), 0, 0, width, height)
    shrink = min(1.0, max(math.sqrt(room / (height * width)), SMALLEST / height))
    h, w = (max(1, int(side * shrink)) for side in (height, width))
    count = max(1, min(len(clip), int(budget / (each * h * w))))
    coarse = max(1, min(clip.size) // COARSE)
    changes = [F.avg_pool2d(change, coarse) for change in changes_of(clip)]
    busiest = max(range(len(clip)), key=lambda i: float(changes[i].mean()))
    first = min(max(0, busiest - count // 2), len(clip) - count)
    change = torch.stack(changes[first : first + count]).mean(0)
    factor = job.scale * coarse
    y, x = place(
        change, *(min(room, max(1, round(side / factor))) for side, room in zip((h, w), change.shape[-2:], strict=True))
    )
    top, left = min(round(y * factor), height - h), min(round(x * factor), width - w)
    return Window(range(first, first + count), left, top, w, h)


def bytes_per_pixel(clip: Clip) -> float:
    """What a pixel of the clip takes in a page, from the middle of its first shaded frame."""
    color = next((c for i in range(len(clip)) if (c := clip[i].color) is not None), None)
    if color is None:
        return 3.0
    height, width = color.shape[-2:]
    part = color[0, :, height // 4 : height // 4 + 540, width // 4 : width // 4 + 960]
    return len(packing.pack(packing.encode(part))) / (part.shape[-1] * part.shape[-2])


def changes_of(clip: Clip) -> Iterator[Float[Tensor, "1 1 h w"]]:
    """How much each frame differs from the one before, as displayed; 0 for the first and for unshaded ones."""
    before: Tensor | None = None
    for index in range(len(clip)):
        color = clip[index].color
        now = before if color is None else to_display(color)
        still = torch.zeros(1, 1, *clip.size)
        yield still if now is None or before is None else (now - before).abs().mean(1, keepdim=True)
        before = now


def place(change: Float[Tensor, "1 1 h w"], height: int, width: int) -> tuple[int, int]:
    """Top and left of the window of a size in which most changes."""
    sums = F.avg_pool2d(change, (height, width), stride=1)
    at = int(sums.argmax())
    return at // sums.shape[-1], at % sums.shape[-1]


# What the methods make.


@dataclass(frozen=True)
class Look:
    """One image of a method, and what there is to say of it."""

    index: int
    role: Role
    image: str | None
    """Id of the packed image, None outside of the window."""
    truth: str | None
    """The same of what it should have been; None also where the clip has no such image."""
    flip: str | None
    values: Mapping[tuple[str, str], float]
    """By (region, metric)."""


def looks(clip: Clip, job: Job, name: str, window: Window, images: Images, settings: Settings) -> Iterator[Look]:
    """The images of a method on a clip in display order, those of the window packed.

    Of a method that was run twice, started one frame apart, only the first run is shown; both have values.
    """
    footage = Footage(clip)
    rest = replace(settings, metrics=tuple(metric for metric in settings.metrics if metric != "flip"))
    for made in images_of(footage, name, job.mode, rest):
        values = judged(footage, made, job.mode, rest)
        for one in made:
            mine = {} if untouched(one) else {key[1:]: value for key, value in values.items() if key[0] == one.role}
            kept, heat = one.start == 0 and one.index in window.frames, None
            if kept and mine:
                heat, mean = heat_of(one, window, whole="flip" in settings.metrics)
                mine |= {} if mean is None else {("all", "flip"): mean}
            yield Look(
                one.index,
                one.role,
                images.add(packing.encode(window.cut(one.image))) if kept else None,
                images.add(packing.encode(window.cut(one.truth))) if kept and one.truth is not None else None,
                images.add_map(heat) if heat is not None else None,
                mine,
            )


def untouched(one: Made) -> bool:
    """Whether it is a shaded frame that the method gave back as it was, so that there is nothing to judge."""
    return one.role == "shaded" and one.truth is not None and torch.equal(one.image, one.truth)


def heat_of(now: Made, window: Window, whole: bool) -> tuple[Float[Tensor, "1 h w"] | None, float | None]:
    """FLIP map of the window, and its mean over all pixels.

    Made from the whole image where that is asked for, which takes longer; else from the window, and where that is but a
    part of the image the mean is not known.
    """
    if now.target is None:
        return None, None
    if whole:
        heat = flip_map(now.shown, now.target)
        return window.cut(heat), float(heat.mean())
    heat = flip_map(window.cut(now.shown)[None], window.cut(now.target)[None])
    return heat[0], float(heat.mean()) if heat.shape[-2:] == now.image.shape[-2:] else None


def run_of(clip: Clip, job: Job, window: Window, made: Mapping[str, Sequence[Look]], rows: Sequence[Row]) -> Run:
    """What the page needs of a job."""
    kept = {name: [look for look in looks if look.image is not None] for name, looks in made.items()}
    first = next(iter(kept.values()))
    times = [record.time for record in clip.shown]
    gap = (times[-1] - times[0]) / max(1, len(times) - 1) or 1.0
    return Run(
        title=f"{job.clip}, {job.mode}" + (f", {job.scale:g} times the size" if job.scale != 1 else ""),
        clip=job.clip,
        mode=job.mode,
        scale=job.scale,
        role=job.role,
        fps=clip.fps / gap,
        size=(window.height, window.width),
        window=(window.left, window.top),
        frames=[{"number": clip.shown[look.index].number, "role": look.role} for look in first],
        reference=[look.truth for look in first] if all(look.truth for look in first) else None,
        methods=[strip_of(name, looks) for name, looks in kept.items()],
        best=best_of(rows, job),
    )


def strip_of(name: str, looks: Sequence[Look]) -> Strip:
    """The images of a method one after the other, and its values as curves."""
    values: dict[str, dict[str, list[float | None]]] = {}
    for region, metric in dict.fromkeys(key for look in looks for key in look.values):
        values.setdefault(metric, {})[region] = [look.values.get((region, metric)) for look in looks]
    values = {metric: values[metric] for metric in METRICS if metric in values}
    return Strip(name, [look.image for look in looks], [look.flip for look in looks], values)


def best_of(rows: Sequence[Row], job: Job) -> str:
    """The method that is best in the first metric of a job."""
    ours = [row for row in rows if same(row, job) and row.region == "all" and row.metric in METRICS]
    values = {row.method: row.value for row in ours if row.metric == ours[0].metric}
    chosen = max if ours and is_higher_better(ours[0].metric) else min
    return chosen(values, key=values.__getitem__, default=job.methods[0])


def same(row: Row, job: Job) -> bool:
    """Whether a row is one of a job's, and about its role."""
    return (row.clip, row.mode, row.scale, row.role) == (job.clip, job.mode, job.scale, job.role)


# What a reader has to know.


def cropped(clip: Clip, job: Job, window: Window) -> list[str]:
    """Says which part of the clip is on the page, where it is not all of it."""
    height, width = (round(side * job.scale) for side in clip.size)
    whole = (window.height, window.width) == (height, width)
    if whole and len(window.frames) == len(clip):
        return []
    pixels = "" if whole else f", {window.width}x{window.height} of {width}x{height} pixels"
    first, last = (clip.shown[i].number for i in (window.frames[0], window.frames[-1]))
    return [
        f"{job.clip}: the images on this page are frames {first} to {last} of {len(clip)}{pixels}, where most changes; "
        f"the numbers below are of everything. A larger --megabytes shows more."
    ]


def unjudged(job: Job, made: Mapping[str, Sequence[Look]]) -> list[str]:
    """Says that there is nothing to compare with, where the clip has no references for the images."""
    if all(look.truth for looks in made.values() for look in looks if look.image):
        return []
    return [
        f"{job.clip} has no reference for these images any more: methods can be compared with each other, but there "
        f"are no curves and no FLIP; the tables hold what was measured when the reference was there."
    ]


def disagreements(rows: Sequence[Row], job: Job, made: Mapping[str, Sequence[Look]]) -> list[str]:
    """Says where the images that were made again have another PSNR than the rows."""
    said = []
    for name, seen in made.items():
        found = [v for look in seen if look.role == job.role and (v := look.values.get(("all", "psnr"))) is not None]
        told = [r.value for r in rows if same(r, job) and (r.method, r.metric, r.region) == (name, "psnr", "all")]
        if found and told and abs(statistics.fmean(found) - told[0]) > AGREE:
            said.append(
                f"{name} on {job.clip} made other images than when it was measured: {statistics.fmean(found):.2f} dB "
                f"here, {told[0]:.2f} dB in the results file. Evaluate again to have numbers of these images."
            )
    return said


# The command.


def located(results: Path, labels: Sequence[str], about: About | None, folder: Path | None) -> dict[str, Clip]:
    """The clips of a results file, where they were or in the folder that holds them now.

    Raises:
        FileNotFoundError: a clip is not there. ClipError: it is another one than was evaluated.
    """
    found = {}
    for label in labels:
        known = about.clips.get(label) if about else None
        name = Path(label).name
        places = [folder / name, folder] if folder else [*([Path(known.path)] if known else []), results.parent / name]
        if folder and len(labels) > 1:
            places.pop()
        place = next((path for path in places if path.is_dir() and any(path.iterdir())), None)
        if place is None:
            raise FileNotFoundError(
                f"the clip {name} of {results} is not at {places[0]}; say where it is with --clips FOLDER, "
                f"the folder that holds {name}"
            )
        found[label] = open_any(place)
        if known:
            require_same(found[label], name, known)
    return found


def require_same(clip: Clip, label: str, known: Source) -> None:
    """Raises ClipError where a clip is not the one that was evaluated."""
    advice = "point to the clip that was evaluated with --clips FOLDER, or evaluate this one again"
    if clip.size != known.size:
        now, then = (f"{width}x{height}" for height, width in (clip.size, known.size))
        raise ClipError(f"{clip.path} has frames of {now} pixels, but {label} had {then} when evaluated; {advice}")
    if len(clip) != known.frames:
        raise ClipError(f"{clip.path} has {len(clip)} frames, but {label} had {known.frames} when evaluated; {advice}")
    if fingerprint(clip.path) != known.sha256:
        raise ClipError(f"{clip.path} has changed since {label} was evaluated (its files have another hash); {advice}")


def command(
    results: Positional[Path],
    out: Out = Path("report.html"),
    clips: Path | None = None,
    methods: str = "",
    megabytes: float = MEGABYTES,
    device: str = "cpu",
) -> None:
    """One page of an evaluation that opens without a network: images to the pixel, curves, tables.

    Args:
        results: what `framecast evaluate CLIP --json results.json` wrote.
        out: the page.
        clips: folder that holds the clips, where they have moved.
        methods: names separated by commas; by default all of the results.
        megabytes: size that the page keeps to, by cropping large images and leaving out frames of long clips.
        device: cpu, cuda, mps.
    """
    wanted = {name.strip() for name in methods.split(",") if name.strip()}
    rows = [row for row in read_results(results) if not wanted or row.method in wanted]
    if wanted - {row.method for row in rows}:
        raise ValueError(f"{results} has no rows of {', '.join(sorted(wanted - {row.method for row in rows}))}")
    jobs = jobs_of(rows)
    about = read_provenance(results)
    found = located(results, list(dict.fromkeys(job.clip for job in jobs)), about, clips)
    with Progress(*Progress.get_default_columns(), TimeElapsedColumn(), transient=True) as progress:
        task = progress.add_task("report", total=sum(len(job.methods) for job in jobs))
        text = report(rows, found, about, megabytes=megabytes, device=device, advance=lambda: progress.advance(task))
    with exr.whole(out) as temporary:
        temporary.write_text(text)
    names = ", ".join(dict.fromkeys(row.method for row in rows))
    print(f"{out}: {names} on {', '.join(found)}, {out.stat().st_size / 1e6:.1f} MB")
