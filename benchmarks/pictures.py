"""Parts of what methods make of a frame, enlarged, beside one another: pictures for docs/results.

    python benchmarks/pictures.py CLIP... --columns frame,taau,extrass,truth -o docs/images/extrass.jpg

One row for each clip. A column is a method, `truth`, or `frame`: what was shaded, its pixels as they are. Methods that
make frames get every second one and show the frame as one that was not shaded, beside the `frame` before it; others get
all of them. The part is where the error of the column `--than` is larger than that of the column before the truth by
most, and it is printed.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import torch
import torch.nn.functional as F
import tyro
from jaxtyping import Float
from PIL import Image
from torch import Tensor
from tyro.conf import Positional, arg

from framecast.clip import Clip, open_clip
from framecast.color import to_display
from framecast.evaluate import Footage, Settings, images
from framecast.exr import whole
from framecast.fit import method_named

GAP = 4
"""White pixels between parts."""


@dataclass(frozen=True)
class Part:
    """A part of an image at display size."""

    left: int
    top: int
    width: int
    height: int


def main(
    clips: Positional[tuple[Path, ...]],
    out: Annotated[Path, arg(aliases=["-o"])],
    columns: str = "frame,taau,extrass,truth",
    than: str = "taau",
    frame: int = 7,
    size: tuple[int, int] = (100, 72),
    zoom: int = 3,
    scale: float = 2.0,
) -> None:
    """Make a picture.

    Args:
        clips: folders of clips with references.
        out: the picture, .jpg or .png.
        columns: what is shown from left to right, separated by commas.
        than: which column the one before the truth should be better than.
        frame: which frame of the clips.
        size: width and height of the parts, in pixels of the images.
        zoom: how much they are enlarged.
        scale: of the images.
    """
    names = columns.split(",")
    hidden, rows = generated(names), []
    for clip in map(open_clip, clips):
        shown = {name: column(clip, name, frame, scale, hidden) for name in names}
        best, other, truth = (shown[name] for name in (names[-2], than, names[-1]))
        part = where((other - truth).square() - (best - truth).square(), size)
        print(clip.path.name, part)
        rows.append([cut(shown[name], part, zoom) for name in names])
    across = [
        F.pad(torch.cat([F.pad(one, (0, GAP), value=1.0) for one in row], 3), (0, 0, 0, GAP), value=1.0) for row in rows
    ]
    picture = torch.cat(across, 2)[0, :, :-GAP, :-GAP].permute(1, 2, 0)
    pixels = (picture.clamp(0, 1) * 255).round().to(torch.uint8)
    with whole(out) as temporary:
        Image.fromarray(np.asarray(pixels)).save(
            temporary, format="PNG" if out.suffix == ".png" else "JPEG", quality=92
        )


def generated(names: list[str]) -> bool:
    """Whether any of the columns makes frames."""
    return any("extrapolate" in method_named(name).modes for name in names if name not in ("frame", "truth"))


@torch.no_grad()
def column(clip: Clip, name: str, frame: int, scale: float, hidden: bool) -> Float[Tensor, "1 3 H W"]:
    """What a column shows, at the size of the images, as displayed; `hidden`: the frame was not shaded."""
    if name == "frame":
        color = clip[frame - hidden].color
        assert color is not None
        return F.interpolate(to_display(color), scale_factor=scale, mode="nearest-exact")
    if name == "truth":
        reference = clip.reference(frame)
        assert reference is not None
        return to_display(reference)
    ahead = "extrapolate" in method_named(name).modes
    for made in images(
        Footage(clip), name, "extrapolate" if ahead else "pass", Settings((), scale=None if ahead else scale)
    ):
        for one in made:
            if one.index == frame and (one.role == "generated") == ahead:
                return one.shown
    raise SystemExit(f"{name} shows no frame {frame} of {clip.path}; it has {len(clip)}")


def where(error: Float[Tensor, "1 3 H W"], size: tuple[int, int]) -> Part:
    """The part of a size over which values sum up to most."""
    width, height = size
    sums = F.avg_pool2d(error.mean(1, keepdim=True), (height, width), 1)
    top, left = divmod(int(sums.argmax()), sums.shape[3])
    return Part(left, top, width, height)


def cut(image: Float[Tensor, "1 3 H W"], part: Part, zoom: int) -> Float[Tensor, "1 3 h w"]:
    """A part of an image, each pixel a square."""
    piece = image[..., part.top : part.top + part.height, part.left : part.left + part.width]
    return F.interpolate(piece, scale_factor=zoom, mode="nearest-exact")


if __name__ == "__main__":
    tyro.cli(main)
