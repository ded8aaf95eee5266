"""What each choice of `mobfgsr` and `bsr` is worth: PSNR of generated frames, as a markdown table.

    python benchmarks/ablation.py CLIP... -o docs/results/frame-generation-choices.md

The last row is a bound, not a method: the hidden frame's own vectors, which no method sees, fetch from both neighbours,
and what one of them hides is taken from the other. What it misses is not motion: shading that changed, and noise.
"""

from collections.abc import Callable, Iterator
from pathlib import Path
from statistics import fmean
from typing import Annotated, Any

import torch
import tyro

from framecast import exr
from framecast.clip import Clip
from framecast.color import to_display
from framecast.evaluate import Footage, Settings, counts, index_at, outputs
from framecast.frame import Frame
from framecast.importers import open_any
from framecast.methods.bsr import BSR
from framecast.methods.bsr import Config as BSRConfig
from framecast.methods.mobfgsr import Config, MobFGSR
from framecast.metrics import psnr
from framecast.results import Mode
from framecast.warp import disoccluded, warp

CHOICES: dict[str, Callable[[], Any]] = {
    "mobfgsr": MobFGSR,
    "· vectors of the pixel itself, not of the nearest surface around": lambda: MobFGSR(Config(dilate=False)),
    "· T_B = 0.13: one frame alone where brightness agrees": lambda: MobFGSR(Config(brightness_threshold=0.13)),
    "· T_D = 2 % of the depth in place of 10 %": lambda: MobFGSR(Config(depth_threshold=0.02)),
    "· T_D = 50 %": lambda: MobFGSR(Config(depth_threshold=0.5)),
    "· gaps of 10 % depth in place of 2 %": lambda: MobFGSR(Config(gap_threshold=0.1)),
    "· estimated motion (mobfgsr-quadratic)": lambda: MobFGSR(Config(motion="quadratic")),
    "· estimated motion, T_B = 0.13": lambda: MobFGSR(Config(motion="quadratic", brightness_threshold=0.13)),
    "bsr": BSR,
    "· the better fit wins in place of the nearer, T_B = 0.13": lambda: BSR(BSRConfig(visible="fitting", color=0.13)),
}


def scores(clip: Clip, method: Any, mode: Mode) -> Iterator[float]:
    """PSNR of each generated frame that counts."""
    for output in outputs(Footage(clip), method, mode, Settings()):
        index = index_at(clip, output.time)
        if output.generated and counts(clip, index, mode):
            yield float(psnr(to_display(output.image), to_display(_color(clip[index]))))


def bound(clip: Clip, mode: Mode) -> Iterator[float]:
    """PSNR of the hidden frames fetched along their own true vectors."""
    for index in (i for i in range(1, len(clip) - 1, 2) if counts(clip, i, mode)):
        hidden, before, after = clip[index], clip[index - 1], clip[index + 1]
        assert hidden.motion is not None
        assert hidden.motion_next is not None
        image = warp(_color(before), hidden.motion)
        if mode == "interpolate":
            late = warp(_color(after), hidden.motion_next)
            lost = _lost(hidden, before, hidden.motion), _lost(hidden, after, hidden.motion_next)
            both = (image + late) / 2
            image = torch.where(lost[0] & ~lost[1], late, torch.where(lost[1] & ~lost[0], image, both))
        yield float(psnr(to_display(image), to_display(_color(hidden))))


def _color(frame: Frame) -> torch.Tensor:
    assert frame.color is not None
    return frame.color


def _lost(frame: Frame, other: Frame, motion: torch.Tensor) -> torch.Tensor:
    assert frame.depth is not None
    assert other.depth is not None
    return disoccluded(frame.depth, other.depth, motion)


def main(
    clips: tyro.conf.Positional[tuple[Path, ...]],
    output: Annotated[Path, tyro.conf.arg(aliases=("-o",))],
) -> None:
    """Measure every choice on the clips (full rate, vectors both ways) and write the table."""
    opened = [open_any(path) for path in clips]
    names = " | ".join(clip.path.name for clip in opened)
    lines = [
        "# What each choice is worth",
        "",
        f"PSNR in dB of generated frames, mean of {names.replace(' | ', ', ')}.",
    ]
    lines += ["Made by `python benchmarks/ablation.py`. Rows with a dot change the method above them.", ""]
    lines += ["| choice | interpolated | extrapolated |", "|---|---|---|"]
    runs: dict[str, Callable[[Clip, Mode], Iterator[float]]] = {
        name: lambda clip, mode, make=make: scores(clip, make(), mode)
        for name, make in CHOICES.items()  # type: ignore[misc]
    }
    for name, run in {**runs, "*bound: the hidden frame's own vectors*": bound}.items():
        cells = [fmean(fmean(run(clip, mode)) for clip in opened) for mode in ("interpolate", "extrapolate")]
        lines.append(f"| {name} | {cells[0]:.2f} | {cells[1]:.2f} |")
        print(lines[-1], flush=True)
    with exr.whole(output) as temporary:
        temporary.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    tyro.cli(main)
