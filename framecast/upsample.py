"""The main job: a clip in, a sequence with more frames out, whole files only, going on where it was.

out/0001.exr ...     linear colour, half float; or 0001.png, display colour, 8 bits
out/0001.labels.png  how the method classified the pixels of the image, where asked for
out/job.json         what was asked for, so that the same command goes on and another one is refused
out.mp4              the same as a film; its frames lie in a folder beside it until it is complete
"""

import contextlib
import json
import shutil
import statistics
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from fractions import Fraction
from itertools import islice, pairwise
from pathlib import Path
from typing import Any, Literal

import av
import numpy as np
from jaxtyping import Float
from PIL import Image
from torch import Tensor

from framecast import exr
from framecast.clip import Clip, ClipError
from framecast.color import to_display
from framecast.fit import method_named, require, require_mode, scale_of
from framecast.frame import Frame
from framecast.labels import likeliest, show
from framecast.methods.classifier import Classifier
from framecast.runtime import Mode, Output, latency, require_device, schedule, stream

Format = Literal["exr", "png", "mp4"]
Debug = Literal["labels"]


@dataclass(frozen=True)
class Job:
    """What decides the pixels of the output."""

    method: str = "mobfgsr"
    rate: int = 2
    """Frames out for each shaded frame in."""
    mode: Mode = "interpolate"
    format: Format = "exr"
    scale: float | None = None
    """Size of the images out divided by that of the frames in; None: what the method makes unasked."""


@dataclass(frozen=True)
class Made:
    """What `upsample` did."""

    out: Path
    frames: int
    """Images in the output."""
    shaded: int
    """How many of them the renderer shaded."""
    fps: float
    skipped: int
    """Images that an earlier run had made."""
    milliseconds: float
    """Median time of the method for a generated image; 0 where none was made."""
    latency_ms: float
    """How long images wait because of the mode, at the clip's speed."""
    size: tuple[int, int]
    """Height and width of the images."""


def upsample(
    clip: Clip,
    out: Path,
    job: Job = Job(),
    *,
    device: str = "cpu",
    compile: bool = False,
    overwrite: bool = False,
    debug: Debug | None = None,
    progress: Callable[[Iterable[int], int], Iterable[int]] = lambda indices, total: indices,
) -> Made:
    """Write the clip at `job.rate` times its frame rate and `job.scale` times its size.

    Interrupted and called again, it goes on where it was.

    Args:
        out: a folder, or a file name for mp4.
        overwrite: remove what is there first.
        debug: labels: also write how the method classified the pixels of each image.
        progress: wraps the indices of the images still to make; gets their number too.

    Raises:
        ClipError: `out` holds something else, the clip cannot be used or read, the disk is full.
        ValueError: unknown method or device, or a method that cannot run in this mode.
    """
    if job.rate < 1:
        raise ValueError(f"rate is {job.rate}; it has to be a whole number, at least 1")
    require_device(device)
    method = method_named(job.method, job.scale)
    if job.mode != "pass":
        require_mode(job.method, method, job.mode)
    require(clip, job.method, method)
    if job.mode != "pass" and method.needs_generated:
        job = _as_recorded(clip, job, method.needs_generated)
    if debug is not None:
        _require_classes(job, method)
    folder = out.with_name(f".{out.name}.frames") if job.format == "mp4" else out
    _begin(clip, out, folder, job, overwrite)
    plan = Plan(clip, job)
    done = _first_missing(plan, folder, debug)
    spent: list[float] = []
    if done < plan.total:
        state: list[Any] = [None]
        run = stream_with(method, device, compile, lambda new: state.__setitem__(0, new))
        images = _images(clip, plan, done, method.history, run)
        with _nothing_left_of_nothing(folder):
            for index, output in zip(progress(range(done, plan.total), plan.total - done), images, strict=True):
                path = plan.path(folder, index)
                if debug is not None:
                    show(output.image, likeliest(state[0].classes), _labels(path))
                write_image(path, output.image)
                spent += [output.milliseconds] if output.generated else []
    if job.format == "mp4" and not out.is_file():
        encode([plan.path(folder, i) for i in range(plan.total)], out, plan.fps)
        shutil.rmtree(folder)
    wait = latency(job.rate, job.mode) * job.rate / plan.fps * 1e3
    typical = statistics.median(spent) if spent else 0.0
    height, width = (round(side * scale_of(method)) for side in clip.size)
    return Made(out, plan.total, plan.shaded, plan.fps, done, typical, wait, (height, width))


def _as_recorded(clip: Clip, job: Job, needs: Sequence[str]) -> Job:
    """The job for a method that reads buffers of the frames that it makes: they lie in the clip, without colour, and
    all frames are passed on as they were recorded. Refused where there are none, or not as many as asked for."""
    shaded = [index for index, record in enumerate(clip.shown) if "color" in clip.load(record)]
    gaps = {after - before for before, after in pairwise(shaded)} or {len(clip)}
    if shaded[:1] == [0] and gaps == {job.rate}:
        return replace(job, mode="pass")
    wants = f"{job.method} needs {' and '.join(needs)} of each frame that it makes"
    if gaps == {1}:
        raise ValueError(
            f"{wants}, and between the frames of a clip nothing was rendered; use --method mobfgsr, or record those "
            f"frames, too, without colour"
        )
    if shaded[:1] == [0] and len(gaps) == 1:
        raise ClipError(f"{wants}, and {clip.path} has one shaded frame in {(gap := gaps.pop())}; use --fps {gap}")
    raise ClipError(f"{wants}, and shaded frames of {clip.path} are not evenly spaced; pass it as it is: --mode pass")


def _require_classes(job: Job, method: object) -> None:
    """Refuses labels where the method has none, or where nothing would be left of them."""
    if not isinstance(method, Classifier) or method.classify is None:
        raise ValueError(
            f"{job.method} does not classify pixels, so that there are no labels to write; use "
            f"--method classifier, or leave out --debug labels"
        )
    if job.format == "mp4":
        raise ValueError("labels are written beside images, and a film has none; use --format png, or exr")


@dataclass(frozen=True)
class Plan:
    """Where each image of the output comes from."""

    clip: Clip
    job: Job

    @property
    def rate(self) -> int:
        """Images for each shaded frame."""
        return 1 if self.job.mode == "pass" else self.job.rate

    @property
    def total(self) -> int:
        """Images in the output, from the first shaded frame to the last."""
        return self.rate * (len(self.clip) - 1) + 1

    @property
    def shaded(self) -> int:
        """Frames that the renderer shaded."""
        return sum(self.is_shaded(index) for index in range(len(self.clip)))

    @property
    def fps(self) -> float:
        """Images a second, so that the shot keeps its length."""
        times = [record.time for record in self.clip.shown]
        gap = (times[-1] - times[0]) / (len(times) - 1) if len(times) > 1 else 1.0
        return self.clip.fps / gap * self.rate

    def path(self, folder: Path, index: int) -> Path:
        """File of an image, numbered from 1."""
        return folder / f"{index + 1:04d}.{'exr' if self.job.format == 'exr' else 'png'}"

    def entry(self, index: int, history: int | None) -> int:
        """Shaded frame at which a run has to start so that image `index` comes out as in a run from the beginning."""
        shaded = index // self.rate
        if history is not None and self.job.mode != "pass":  # passed on, not every frame of the clip is shaded
            return max(shaded - history + 1, 0)
        cuts = (i for i in range(shaded, -1, -1) if self.clip.is_cut(i))
        return next((i for i in cuts if self.is_shaded(i)), 0)

    def is_shaded(self, index: int) -> bool:
        """Whether the renderer shaded a frame of the clip; those that are passed on may be others."""
        return self.job.mode != "pass" or "color" in self.clip.load(self.clip.shown[index])


def _first_missing(plan: Plan, folder: Path, debug: Debug | None) -> int:
    """Index of the first image that is not there, or not its labels where they are asked for; the total if none is."""

    def there(path: Path) -> bool:
        return path.is_file() and (debug is None or _labels(path).is_file())

    return next((i for i in range(plan.total) if not there(plan.path(folder, i))), plan.total)


def _labels(path: Path) -> Path:
    """File of the labels of an image."""
    return path.with_suffix(".labels.png")


def stream_with(
    method: object, device: str, compile: bool, watch: Callable[[Any], None] = lambda state: None
) -> Callable[[Iterable[list[Frame]]], Iterator[Output]]:
    """`runtime.stream` with everything but the frames."""
    return lambda groups: stream(method, groups, device=device, compile=compile, watch=watch)  # type: ignore[arg-type]


def _images(
    clip: Clip, plan: Plan, first: int, history: int | None, run: Callable[[Iterable[list[Frame]]], Iterator[Output]]
) -> Iterator[Output]:
    """Images from index `first` on. A run that goes on starts early enough to know what came before."""
    start = plan.entry(first, history)
    frames = (shaded(clip, i, plan.job) for i in range(start, len(clip)))
    groups = schedule(frames, plan.rate, plan.job.mode, first=start)
    return islice(run(groups), first - start * plan.rate, None)


def shaded(clip: Clip, index: int, job: Job) -> Frame:
    """A frame of the clip; refused where others are to be made around it and it was not shaded itself."""
    frame = clip[index]
    if job.mode != "pass" and not frame.is_shaded:
        raise ClipError(
            f"frame {clip.shown[index].number} of {clip.path} was not shaded, and --mode {job.mode} makes more frames "
            f"around those of a clip; pass it as it is, and {job.method} makes the frames without colour: --mode pass"
        )
    return frame


def _begin(clip: Clip, out: Path, folder: Path, job: Job, overwrite: bool) -> None:
    """Make sure that the output is empty or an interrupted run of the same job, and never what is read."""
    if out.resolve() in (place := clip.path.resolve(), *place.parents):
        raise ClipError(f"{out} holds the frames that are read, {clip.path}; give another name with -o")
    if overwrite:
        shutil.rmtree(folder, ignore_errors=True)
        if out.is_dir() and not out.is_symlink():
            shutil.rmtree(out)
        else:
            out.unlink(missing_ok=True)
    about = {"job": asdict(job), "clip": str(place), "frames": _identity(clip)}
    asked = json.dumps(about | {"settings": clip.provenance.get("settings")}, indent=1)
    mark = folder / "job.json"
    if out.is_file() or (out.is_dir() and folder != out):
        raise ClipError(f"{out} exists already; give another name with -o, or pass --overwrite")
    if mark.is_file() and mark.read_text() == asked:
        return
    if folder.is_dir() and any(folder.iterdir()):
        raise ClipError(f"{folder} exists already and is not this job; give another name with -o, or pass --overwrite")
    with exr.whole(mark) as temporary:
        temporary.write_text(asked)


@contextlib.contextmanager
def _nothing_left_of_nothing(folder: Path) -> Iterator[None]:
    """Removes the folder again where a run fails before its first image."""
    try:
        yield
    except BaseException:
        if not any(folder.glob("[0-9]*")):
            shutil.rmtree(folder, ignore_errors=True)
        raise


def _identity(clip: Clip) -> list[list[float]]:
    """Changes when frames of the clip are added, removed, or moved in time or inside their pixels."""
    return [[record.number, record.time, *record.jitter] for record in clip.shown]


def write_image(path: Path, image: Float[Tensor, "1 3 H W"]) -> None:
    """A linear image as half-float EXR, or as 8-bit PNG after the display transform; the whole file or nothing."""
    if path.suffix == ".exr":
        pixels = image[0].clamp(max=65504).half().cpu().numpy()
        exr.write(path, dict(zip("RGB", pixels, strict=True)))
        return
    codes = (to_display(image[0].float()) * 255 + 0.5).byte().permute(1, 2, 0).cpu().numpy()
    with exr.whole(path) as temporary:
        Image.fromarray(np.ascontiguousarray(codes)).save(temporary)


def encode(images: list[Path], out: Path, fps: float) -> None:
    """PNG files as an H.264 film (MPEG-4 where the codec is missing); odd sizes repeat their last row or column."""
    codec, options = ("libx264", {"crf": "16"}) if "libx264" in av.codecs_available else ("mpeg4", {"qscale": "2"})
    with Image.open(images[0]) as first:
        width, height = first.size
    with exr.whole(out) as temporary, av.open(str(temporary), "w", format="mp4") as container:
        film: Any = container.add_stream(codec, rate=Fraction(fps).limit_denominator(1001), options=options)
        film.width, film.height, film.pix_fmt = width + width % 2, height + height % 2, "yuv420p"
        for path in images:
            pixels = np.pad(np.asarray(Image.open(path)), ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
            container.mux(film.encode(av.VideoFrame.from_ndarray(pixels, format="rgb24")))
        container.mux(film.encode(None))
