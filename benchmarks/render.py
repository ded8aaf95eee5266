"""What rendering costs, and whether true motion explains the references: one row per scene, as Markdown.

python benchmarks/render.py                      # all scenes
python benchmarks/render.py courtyard neon --samples 64
python benchmarks/render.py courtyard --workers  # how two processes scale
"""

import os
import shutil
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import numpy as np
import torch
import tyro

from framecast.color import to_display
from framecast.render import device, make, reference
from framecast.render.renderer import Renderer, changes

SIZE, DISPLAY = (360, 640), (720, 1280)
TIMES = ("frames/s", "CPU s/frame", "outside the queue", "reference, s", "its CPU s")
COLUMNS = ("scene", "triangles", *TIMES, "calm, still", "calm, warped", "moving, still", "moving, warped", "moving")


@dataclass(frozen=True)
class Options:
    """What to measure."""

    scenes: Annotated[tuple[str, ...], tyro.conf.Positional] = ()
    """Names, or glTF files; none: all scenes."""
    samples: int = 64
    """Samples of the timed reference; its time is given for 64."""
    frames: int = 4
    """Frames timed per scene."""
    workers: bool = False
    """Time one and two workers instead."""
    environment: dict[str, str] = field(default_factory=dict)
    """Environment variables for the driver, such as LP_NUM_THREADS 1."""


class Queue:
    """Time spent in the GPU's queue (submitting waits on a software driver): the rest is Python, copying and files."""

    def __init__(self) -> None:
        self.seconds, self.inside = 0.0, False
        queue = device.open_device().queue
        for name in ("read_texture", "read_buffer", "submit"):
            setattr(queue, name, self._timed(getattr(queue, name)))

    def _timed(self, call):
        def timed(*args, **kwargs):
            if self.inside:  # reading submits, too
                return call(*args, **kwargs)
            self.inside, start = True, time.perf_counter()
            try:
                return call(*args, **kwargs)
            finally:
                self.inside = False
                self.seconds += time.perf_counter() - start

        return timed


def warped(image: torch.Tensor, motion: np.ndarray) -> torch.Tensor:
    """Bilinear look-up at position + motion; `3 h w` and `2 h w`."""
    height, width = image.shape[1:]
    y, x = torch.meshgrid(torch.arange(height) + 0.5, torch.arange(width) + 0.5, indexing="ij")
    offset = torch.from_numpy(motion)
    grid = torch.stack([(x + offset[0]) / width * 2 - 1, (y + offset[1]) / height * 2 - 1], -1)[None]
    return torch.nn.functional.grid_sample(image[None], grid, align_corners=False, padding_mode="border")[0]


def psnr(error: torch.Tensor, where: np.ndarray) -> str:
    """Over the pixels in a mask."""
    if where.sum() < 50:
        return "-"
    return f"{-10 * float(torch.log10((error[:, torch.from_numpy(where)] ** 2).mean())):.1f}"


def prediction(renderer: Renderer, moment: float, samples: int = 8) -> list[str]:
    """PSNR of the previous reference against the current one, as it is and warped, in all seen pixels and in calm and
    moving shading; and the share of moving pixels."""
    before, now = (
        to_display(torch.from_numpy(reference.reference(renderer, moment + step, SIZE, samples).color))
        for step in (-1.0, 0.0)
    )
    found = changes(renderer, moment, SIZE)
    seen, moving = ~found.disoccluded[0], found.shading[0] > 0.05
    guess = warped(before, found.motion)
    rows = [psnr(image - now, seen & part) for part in (~moving, moving) for image in (before, guess)]
    return [*rows, f"{100 * float((seen & moving).mean()):.1f} %"]


def row(name: str, options: Options, queue: Queue) -> str:
    """Measures one scene."""
    renderer = Renderer(make.load(name))
    settings = make.Settings(name, size=SIZE, samples=0)
    folder = Path(tempfile.mkdtemp())
    make.render_frame(renderer, settings, folder, 0)
    queue.seconds, start, work = 0.0, time.perf_counter(), time.process_time()
    for number in range(1, options.frames + 1):
        make.render_frame(renderer, settings, folder, number)
    seconds = (time.perf_counter() - start) / options.frames
    work = (time.process_time() - work) / options.frames
    waiting = queue.seconds / options.frames
    shutil.rmtree(folder)
    reference.reference(renderer, 1.0, DISPLAY, 2)
    start, effort = time.perf_counter(), time.process_time()
    reference.reference(renderer, 1.0, DISPLAY, options.samples)
    part = options.samples / 64
    image, effort = (time.perf_counter() - start) / part, (time.process_time() - effort) / part
    triangles = sum(draw.index_count // 3 * draw.count for draw in renderer.stage.draws)
    cells = [
        name,
        f"{triangles / 1000:.0f} k",
        f"{1 / seconds:.2f}",
        f"{work:.2f}",
        f"{100 * (1 - waiting / seconds):.0f} %",
    ]
    return " | ".join(
        [*cells, f"{image:.0f}", f"{effort:.0f}", *prediction(renderer, renderer.scene.frames // 2 - 2.0)]
    )


def scaling(name: str, frames: int) -> None:
    """Times one and two processes over the same frames, each with a fresh folder."""
    for workers in (1, 2):
        folder = Path(tempfile.mkdtemp())
        start = time.perf_counter()
        settings = make.Settings(name, size=SIZE, samples=0)
        make.render_clip(settings, folder, frames=frames, workers=workers)
        print(f"{name}: {workers} workers, {frames} frames, {time.perf_counter() - start:.1f} s")
        shutil.rmtree(folder)


def main() -> None:
    options = tyro.cli(Options, description=__doc__)
    os.environ.update(options.environment)
    names = options.scenes or tuple(entry[0] for entry in make.listing())
    if options.workers:
        for name in names:
            scaling(name, options.frames)
        return
    queue = Queue()
    print(f"{device.adapter_name()}, {os.cpu_count()} cores\n")
    print(" | ".join(COLUMNS))
    print("|".join(["---"] * len(COLUMNS)))
    for name in names:
        print(row(name, options, queue), flush=True)


if __name__ == "__main__":
    main()
