"""`framecast render`, as a function whose arguments are the command's options."""

from pathlib import Path
from typing import Annotated

from rich.console import Console
from rich.table import Table
from tyro.conf import Positional, arg

from framecast.render.make import Settings, listing, render_clip


def command(
    source: Positional[str] = "",
    out: Annotated[Path | None, arg(aliases=["-o"])] = None,
    size: str = "640x360",
    scale: float = 2.0,
    frames: int | None = None,
    seed: int = 0,
    samples: int = 64,
    workers: int = 1,
    ranges: bool = False,
    jitter: bool = True,
    preview: bool = False,
    list: Annotated[bool, arg(aliases=["-l"])] = False,
) -> None:
    """Render a clip with exact buffers and references, from a scene in code or a glTF file.

    Interrupted and started again, it goes on where it was.

    Args:
        source: name of a scene, or a .glb or .gltf file.
        out: folder of the clip.
        size: width and height of the frames.
        scale: size of the references divided by the size of the frames.
        frames: how many; as many as the scene suggests if not given.
        seed: variant of the scene.
        samples: samples per display pixel in references; 0: no references.
        workers: processes.
        ranges: also write smallest and largest values over those samples.
        jitter: move the sample inside its pixel from frame to frame, as temporal supersampling needs it.
        preview: also write every buffer of one frame on one picture.
        list: show the scenes instead.
    """
    if list:
        _show()
        return
    if not source or out is None:
        raise ValueError("name a scene (--list shows them) or a .glb or .gltf file, and a folder: -o clip/")
    settings = Settings(source, parsed(size), scale, seed, samples, ranges, jitter)
    made = render_clip(settings, out, frames=frames, workers=workers, preview=preview)
    count = f"{len(made)} frame" + "s" * (len(made) != 1)
    (height, width), display = made.size, settings.display
    also = f", references of {samples} samples at {display[1]}x{display[0]}" if samples else ""
    print(f"{out}: {count}, {width}x{height}{also}")


def parsed(size: str) -> tuple[int, int]:
    """Height and width from a text like 640x360. Raises ValueError with one sentence."""
    try:
        width, height = (int(part) for part in size.lower().split("x"))
    except ValueError:
        raise ValueError(f"size is WIDTHxHEIGHT in pixels, such as 640x360; got {size!r}") from None
    return height, width


def _show() -> None:
    table = Table("scene", "split", "what it shows", box=None)
    for row in listing():
        table.add_row(*row)
    Console().print(table)
