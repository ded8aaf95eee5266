"""The main job on the clip that ships with the package: every second frame is hidden, made again and compared.

Then with a quarter of the pixels besides: what is left is an eighth of what was rendered.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import torch
from jaxtyping import Float
from PIL import Image, ImageDraw, ImageFont
from torch import Tensor
from tyro.conf import arg

from framecast.campaign import made_from
from framecast.clip import Clip, open_clip
from framecast.color import to_display
from framecast.evaluate import Settings, evaluate, labels
from framecast.exr import whole
from framecast.fit import method_named
from framecast.frame import BUFFERS, Frame
from framecast.metrics import psnr
from framecast.report import report
from framecast.runtime import schedule, stream
from framecast.upsample import encode

HARBOUR = Path(__file__).parent / "shots" / "harbour"
"""Nine frames of an evening harbour, rendered with Blender by `examples/blender/demo_scene.py`."""

LOOPS = 5
"""How often the film goes back and forth, so that half a second can be judged."""

QUARTERS = ((0, 0), (1, 1), (0, 1), (1, 0))
"""Row and column of the one pixel of each 2 x 2 that is kept of a shaded frame, in turn."""

Out = Annotated[Path, arg(aliases=["-o"])]
Panel = tuple[str, Float[Tensor, "1 3 h w"]]


def demo(out: Out = Path("demo-out"), clip: Path = HARBOUR, method: str = "mobfgsr") -> None:
    """Double the frame rate of the clip that ships with framecast, and compare with the frames that were hidden.

    Writes a film (every second frame held, beside the doubled rate), a picture of one frame and a report to look into,
    and prints PSNR. Then doubles the size of the frames with the rate: a film and a picture of that.

    Args:
        out: folder for the film, the picture and the report; files of an earlier demo are replaced.
        clip: another clip with all of its frames.
        method: how the hidden frames are made.
    """
    full = open_clip(clip)
    made = generated(full, method)
    hidden = {t: full[t].color for t in range(1, len(full), 2)}
    print(
        f"{clip.name}: {len(full)} frames of {full.size[1]}x{full.size[0]}, every second one hidden, made by {method}\n"
    )
    print("hidden frame   held   mixed   framecast   (PSNR in dB)")
    scores = [[quality(image, hidden[t]) for _, image in guesses(full, made, t)] for t in sorted(hidden)]
    for t, row in zip(sorted(hidden), scores, strict=True):
        print(f"{t + 1:12} {row[0]:6.2f} {row[1]:7.2f} {row[2]:11.2f}")
    held, mixed, ours = np.mean(scores, axis=0)
    print(f"{'mean':>12} {held:6.2f} {mixed:7.2f} {ours:11.2f}")
    names = (f"shaded, {full.fps / 2:g} a second", f"framecast, {full.fps:g} a second")
    beside = film(
        out / "harbour.mp4", full, lambda t: list(zip(names, (present(full, t // 2 * 2), made[t]), strict=True))
    )
    print(f"\n{picture(out, full, made)}\n{beside}", flush=True)
    print(f"{compared(out, full, method)}: open it in a browser")
    print(f"\n{larger(out, full)}", flush=True)
    print(
        f"framecast: {len(hidden)} frames made from their neighbours, "
        f"{ours - held:.1f} dB closer to the hidden ones than the last frame held"
    )


def generated(full: Clip, method: str) -> dict[int, Float[Tensor, "1 3 h w"]]:
    """Images of the half-rate view at full rate, by frame."""
    made = method_named(method)
    view = full.every(2, motion="step" if made.step_motion and "motion_next" in full.layers else "gap")
    groups = schedule((view[i] for i in range(len(view))), 2, "interpolate")
    return {round(o.time): o.image for o in stream(made, groups)}


def guesses(full: Clip, made: dict[int, Tensor], t: int) -> list[Panel]:
    """What one could show in place of hidden frame `t`."""
    before, after = present(full, t - 1), present(full, t + 1)
    return [("last frame held", before), ("both mixed", (before + after) / 2), ("framecast", made[t])]


def present(full: Clip, t: int) -> Float[Tensor, "1 3 h w"]:
    """Colour of a shaded frame."""
    color = full[t].color
    assert color is not None
    return color


def quality(image: Tensor, truth: Tensor | None) -> float:
    """PSNR as displayed, dB."""
    assert truth is not None
    return float(psnr(to_display(image), to_display(truth)))


def picture(out: Path, full: Clip, made: dict[int, Tensor]) -> Path:
    """The hidden frame in the middle of the clip and three guesses at it, side by side in two rows."""
    t = len(full) // 2 // 2 * 2 + 1
    truth = present(full, t)
    panels = [(f"{name}, {quality(image, truth):.1f} dB", image) for name, image in guesses(full, made, t)]
    rows = [tiled(panels[:2]), tiled([panels[2], ("hidden frame", truth)])]
    path = out / "side-by-side.png"
    with whole(path) as temporary:
        Image.fromarray(np.concatenate(rows)).save(temporary)
    return path


def film(path: Path, full: Clip, panels: Callable[[int], Sequence[Panel]]) -> Path:
    """The panels of each frame beside each other, back and forth at the clip's own speed."""
    order = [*range(len(full)), *range(len(full) - 2, 0, -1)] * LOOPS
    folder = path.parent / ".film"
    for t in range(len(full)):
        with whole(folder / f"{t:04d}.png") as temporary:
            Image.fromarray(tiled(panels(t))).save(temporary)
    encode([folder / f"{t:04d}.png" for t in order], path, full.fps)
    for t in range(len(full)):
        (folder / f"{t:04d}.png").unlink()
    folder.rmdir()
    return path


def larger(out: Path, full: Clip) -> str:
    """Size and rate doubled, from every second frame with a quarter of its pixels: a film, a picture, and PSNR."""
    view, method = full.every(2), method_named("mobfgsr", 2.0)
    shaded = {round(f.time.item()): f for f in (quartered(view[i], i) for i in range(len(view)))}
    groups = schedule(iter(shaded.values()), 2, "interpolate")
    made = {round(o.time): o.image for o in stream(method, groups)}
    plain = method_named("bilinear", 2.0)
    single = {t: plain(f, plain.start(f))[0] for t, f in shaded.items()}

    def panels(t: int) -> list[Panel]:
        small = shaded[t // 2 * 2].color
        assert small is not None
        blocks = small.repeat_interleave(2, 2).repeat_interleave(2, 3)
        return [("an eighth of the pixels", blocks), ("framecast, all of them", made[t])]

    shown = range(2, len(full))
    held, ours = (
        float(np.mean([quality(image(t), present(full, t)) for t in shown]))
        for image in (lambda t: single[t // 2 * 2], lambda t: made[t])
    )
    t, path = len(full) // 2 // 2 * 2 + 1, out / "larger.png"
    with whole(path) as temporary:
        Image.fromarray(tiled(panels(t))).save(temporary)
    return (
        f"{path}\n{film(out / 'larger.mp4', full, panels)}\n"
        f"framecast: rate and size doubled, {ours:.1f} dB; the last frame enlarged and held, {held:.1f} dB"
    )


def quartered(frame: Frame, number: int) -> Frame:
    """A frame of half the size: one pixel of each 2 x 2, as a renderer with jitter would have shaded it."""
    row, column = QUARTERS[number % 4]
    assert frame.color is not None
    height, width = (side // 2 * 2 for side in frame.color.shape[-2:])

    def part(image: Tensor | None, factor: float = 1.0) -> Tensor | None:
        return None if image is None else (image[..., row:height:2, column:width:2] * factor).contiguous()

    kept: dict[str, Any] = dict.fromkeys(BUFFERS)
    kept |= {name: part(getattr(frame, name)) for name in ("color", "depth")}
    kept |= {name: part(getattr(frame, name), 0.5) for name in ("motion", "motion_next")}
    return replace(frame, **kept, jitter=torch.tensor([[column / 2 - 0.25, row / 2 - 0.25]]))


def compared(out: Path, full: Clip, method: str) -> Path:
    """The report of the three guesses, with the numbers that they are measured by."""
    names, settings = list(dict.fromkeys(("hold", "blend", method))), Settings(metrics=("psnr", "ssim", "warped"))
    rows, path = evaluate([full], names, "interpolate", settings), out / "report.html"
    with whole(path) as temporary:
        temporary.write_text(report(rows, {labels([full])[0]: full}, made_from([full], names, "interpolate", settings)))
    return path


def tiled(panels: Sequence[Panel]) -> np.ndarray:
    """Images side by side as displayed, 8 bits, each with its name in the corner."""
    font = ImageFont.load_default(size=15)
    tiles = []
    for name, image in panels:
        codes = (to_display(image[0]) * 255).round().to(torch.uint8).permute(1, 2, 0).numpy()
        tile = Image.fromarray(np.ascontiguousarray(codes))
        draw = ImageDraw.Draw(tile)
        box = draw.textbbox((8, 6), name, font=font)
        draw.rectangle((box[0] - 5, box[1] - 4, box[2] + 5, box[3] + 4), fill=(16, 16, 20))
        draw.text((8, 6), name, font=font, fill=(240, 240, 240))
        tiles.append(np.asarray(tile))
    return np.concatenate(tiles, 1)
