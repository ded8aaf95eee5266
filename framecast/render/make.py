"""Clips from scenes: `framecast render`.

    clip/frames/0007.exr      the frame at render size, jittered: everything in `Frame`, and motion2
    clip/reference/0007.exr   the mean of many samples, at display size
    clip/masks/0007.exr       at display size: exact motion, what was hidden one frame ago, what changed its shading
    clip/ranges/0007.exr      on request, at display size: smallest and largest values over a pixel's samples
    clip/preview.png          on request: every buffer of one frame

Frames are independent, so any number of processes may write them, and a run that was stopped goes on where it was.
"""

import json
import multiprocessing
import os
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.progress import track

from framecast import clip, exr, resample
from framecast.render import device, reference
from framecast.render.preview import sheet
from framecast.render.renderer import Renderer, changes
from framecast.render.scene import Scene
from framecast.render.view import view_of

Array = np.ndarray

MASKS = ("motion.X", "motion.Y", "disoccluded.Y", "shading.Y")
"""Channels of a mask file, at display size: `renderer.Changes`."""


@dataclass(frozen=True)
class Settings:
    """What decides the pixels of a rendered clip."""

    source: str
    """Name of a scene (see --list), or a .glb or .gltf file."""
    size: tuple[int, int] = (360, 640)
    """Height and width of the frames."""
    scale: float = 2.0
    """Size of the references divided by the size of the frames."""
    seed: int = 0
    """Variant of the scene."""
    samples: int = 64
    """Samples per display pixel in references; 0: no references and no masks."""
    ranges: bool = False
    """Also write the ranges over those samples."""
    jitter: bool = True
    """Move the sample inside its pixel from frame to frame; without it every frame is sampled at pixel centres."""

    @property
    def offsets(self) -> int:
        """How many sample positions the frames go through; 0 without jitter."""
        return resample.phases(self.scale) if self.jitter else 0

    @property
    def display(self) -> tuple[int, int]:
        """Height and width of the references."""
        return round(self.size[0] * self.scale), round(self.size[1] * self.scale)


def load(source: str, seed: int = 0) -> Scene:
    """A scene by name, or from a glTF file.

    Raises:
        FileNotFoundError: no such file. ValueError: no scene of this name.
    """
    if source.lower().endswith((".glb", ".gltf")):
        from framecast.render import gltf

        return gltf.load(Path(source))
    from framecast.render.scenes import SCENES

    if source not in SCENES:
        raise ValueError(
            f"there is no scene {source!r}; choose one of {', '.join(SCENES)}, or give a .glb or .gltf file"
        )
    return SCENES[source](seed)


def listing() -> list[tuple[str, str, str]]:
    """Name, split and description of every scene."""
    from framecast.render.scenes import SCENES, TRAIN

    lines = {name: (make.__doc__ or name).strip().splitlines()[0] for name, make in SCENES.items()}
    return [(name, "train" if name in TRAIN else "test", line) for name, line in lines.items()]


def render_clip(
    settings: Settings, folder: Path, *, frames: int | None = None, workers: int = 1, preview: bool = False
) -> clip.Clip:
    """Renders a clip, or what is missing of it, and opens it.

    Args:
        frames: how many, from 0 on; None: as many as the scene suggests.
        workers: processes. On a software driver each uses its share of the cores.
        preview: also write a contact sheet of the frame in the middle.

    Raises:
        FileNotFoundError: no driver, or no such file. ValueError: no such scene, or sizes that make no sense.
        ClipError: the folder holds frames that were rendered otherwise.
    """
    scene = load(settings.source, settings.seed)
    _check(settings, folder, workers)
    count = scene.frames if frames is None else frames
    todo = [number for number in range(count) if not _frame_path(folder, number).is_file()]
    for _ in track(_numbers(settings, folder, scene, todo, workers), f"{scene.name}", total=len(todo)):
        pass
    if preview:
        _write_preview(settings, folder, scene, count // 2)
    scale = settings.scale if settings.samples else None
    return clip.finish(folder, fps=scene.fps, span=1.0, scale=scale, provenance=_provenance(settings, scene))


def _check(settings: Settings, folder: Path, workers: int) -> None:
    if min(settings.size) < 8 or settings.scale < 1 or settings.samples < 0 or workers < 1:
        raise ValueError(
            f"cannot render {settings.size[1]}x{settings.size[0]} at scale {settings.scale} with {settings.samples} "
            f"samples and {workers} workers; sizes start at 8x8, scale at 1, samples at 0, workers at 1"
        )
    device.open_device()
    for path in sorted((folder / "frames").glob("[0-9]*.exr"))[:1]:
        record = json.loads(exr.attributes(path).get("framecast", "{}"))
        if record.get("extra", {}).get("render") != _key(settings):
            raise clip.ClipError(
                f"{folder} holds frames of another render; choose an empty folder, or delete {folder / 'frames'}"
            )


def _key(settings: Settings) -> str:
    return json.dumps(asdict(settings), sort_keys=True)


def _frame_path(folder: Path, number: int) -> Path:
    return folder / "frames" / f"{number:04d}.exr"


def _provenance(settings: Settings, scene: Scene) -> dict:
    return {
        "made_by": "framecast render",
        "adapter": device.adapter_name(),
        "scene": scene.name,
        "split": scene.split,
        **asdict(settings),
        "jitter": f"halton(2, 3), {settings.offsets} phases" if settings.jitter else "none",
        "reference": "mean over a box of one display pixel, taken of c / (1 + max(c))",
    }


def _numbers(settings: Settings, folder: Path, scene: Scene, todo: list[int], workers: int) -> Iterator[int]:
    """Renders frames and yields their numbers as they are done."""
    if workers == 1 or len(todo) < 2:
        yield from _render_all(settings, folder, scene, todo)
        return
    os.environ.setdefault("LP_NUM_THREADS", str(max(1, (os.cpu_count() or 1) // workers)))
    jobs = [(settings, folder, todo[k::workers]) for k in range(workers)]
    context = multiprocessing.get_context("spawn")
    done = context.SimpleQueue()
    processes = [context.Process(target=_work, args=(*job, done), daemon=True) for job in jobs]
    for process in processes:
        process.start()
    for _ in todo:
        result = done.get()
        if isinstance(result, str):
            for process in processes:
                process.terminate()
            raise ValueError(f"a worker stopped: {result}")
        yield result


def _work(settings: Settings, folder: Path, numbers: list[int], done: Any) -> None:
    """One process's share of the frames."""
    try:
        for number in _render_all(settings, folder, load(settings.source, settings.seed), numbers):
            done.put(number)
    except Exception as error:
        done.put(f"{type(error).__name__}: {error}")


def _render_all(settings: Settings, folder: Path, scene: Scene, numbers: Iterable[int]) -> Iterator[int]:
    renderer = Renderer(scene)
    for number in numbers:
        render_frame(renderer, settings, folder, number)
        yield number


def render_frame(renderer: Renderer, settings: Settings, folder: Path, number: int) -> None:
    """Writes everything of one frame; its frame file comes last, so where that exists the rest is complete."""
    scene, time = renderer.scene, float(number)
    image = None
    if settings.samples:
        made = reference.reference(renderer, time, settings.display, settings.samples, ranges=settings.ranges)
        image = made.color
        if made.ranges is not None:
            exr.write(folder / "ranges" / f"{number:04d}.exr", dict(zip(reference.RANGES, made.ranges, strict=True)))
        exr.write(folder / "masks" / f"{number:04d}.exr", masks(renderer, number, settings.display))
    offset = resample.jitter(number, settings.offsets)
    layers = renderer.frame(time, settings.size, offset, -float(np.log2(settings.scale)))
    view = view_of(scene.camera, time, settings.size[1] / settings.size[0])
    record = clip.Record(
        number=number,
        time=time,
        jitter=offset,
        view=_rows(np.linalg.inv(view.camera)),
        projection=_rows(view.projection),
        cut=number in scene.cuts,
        exposure=float(scene.exposure(time)),
        extra={"render": _key(settings)},
    )
    clip.write_frame(folder, record, layers, reference=image)


def _rows(matrix: Array) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(float(value) for value in row) for row in matrix)


def masks(renderer: Renderer, number: int, size: tuple[int, int]) -> dict[str, Array]:
    """Channels of a mask file; at the first frame and at cuts everything counts as hidden before."""
    if number == 0 or number in renderer.scene.cuts:
        empty = np.zeros(size, np.float32)
        return dict(zip(MASKS, (empty, empty, np.ones(size, np.float16), empty.astype(np.float16)), strict=True))
    found = changes(renderer, float(number), size)
    planes = (*found.motion, found.disoccluded[0].astype(np.float16), found.shading[0].astype(np.float16))
    return dict(zip(MASKS, planes, strict=True))


def _write_preview(settings: Settings, folder: Path, scene: Scene, number: int) -> None:
    renderer = Renderer(scene)
    layers = renderer.frame(float(number), settings.size, (0.0, 0.0), 0.0)
    if settings.samples:
        made = reference.reference(renderer, float(number), settings.display, min(settings.samples, 16))
        found = changes(renderer, float(number), settings.display)
        extra = {"disoccluded": found.disoccluded, "moving shading": found.shading * 4}
        layers = {"color": layers.pop("color"), "reference": made.color, **layers, **extra}
    page = sheet(layers, f"{scene.name}, frame {number}, {settings.size[1]}x{settings.size[0]}")
    with exr.whole(folder / "preview.png") as temporary:
        page.save(temporary, format="PNG")
