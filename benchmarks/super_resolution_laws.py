"""What is known of a picture in advance, measured for every method: a part of `super_resolution.py`.

Pictures are functions of the place, so that every frame samples them where its jitter says and the truth is exact.
"""

from collections.abc import Callable, Sequence
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor

from framecast.clip import Clip
from framecast.color import to_display, tonemap
from framecast.fit import method_named, scale_of
from framecast.frame import Frame
from framecast.metrics import measure
from framecast.resample import jitter, phases, sharp_warp
from framecast.table import resample, shipped_table
from framecast.warp import warp

SIZE = (48, 64)
SPEED = 0.21
"""Render pixels a frame by which the wire moves to the right."""
EDGE = 8
"""Display pixels along the border that are not counted."""

Picture = Callable[[Tensor, Tensor], Tensor]
"""Brightness at places x, y in pixels of the frames."""


def detail(x: Tensor, y: Tensor) -> Tensor:
    """Waves finer than the frames resolve, and slanted stripes with hard edges."""
    waves = 0.35 + 0.1 * torch.sin(x * 0.7) * torch.cos(y * 0.5) + 0.12 * torch.sin(2.6 * x + 1.9 * y)
    return waves + 0.25 * (torch.remainder(x + 0.37 * y, 11.0) < 3.1)


def wire(x: Tensor, y: Tensor) -> Tensor:
    """Dark, three quarters of a display pixel thick at twice the size, slanted a little."""
    return torch.where((y - 0.07 * x - 22.2).abs() < 0.19, 0.05, 0.6)


def shot(t: int, picture: Picture, scale: float, speed: float = 0.0) -> Frame:
    """Frame `t` of a flat picture that moves right by `speed` pixels a frame."""
    height, width = SIZE
    at = torch.tensor([jitter(t, phases(scale))])
    x, y = (torch.arange(width) + 0.5).expand(SIZE), (torch.arange(height) + 0.5)[:, None].expand(SIZE)
    motion = torch.zeros(1, 2, *SIZE)
    motion[:, 0] = -speed
    return Frame(
        color=picture(x + at[0, 0] - speed * t, y + at[0, 1]).expand(1, 3, *SIZE).contiguous(),
        depth=torch.full((1, 1, *SIZE), 5.0),
        motion=motion,
        jitter=at,
        time=torch.tensor([float(t)]),
        reset=torch.tensor([t == 0]),
        span=torch.ones(1),
    )


def truth(picture: Picture, scale: float) -> Tensor:
    """The mean over each display pixel at time 0."""
    fine, (height, width) = 4, (round(side * scale) for side in SIZE)
    x, y = (((torch.arange(n * fine) + 0.5) / (scale * fine)) for n in (width, height))
    every = picture(x.expand(len(y), -1), y[:, None].expand(-1, len(x)))
    return F.avg_pool2d(every.expand(1, 3, -1, -1), fine)


def images(name: str, frames: int, picture: Picture, speed: float = 0.0) -> list[Tensor]:
    """What a method shows, without the border; as displayed."""
    method = method_named(name, None if name == "taa" else 2.0).eval()
    scale, found = scale_of(method), []
    state: Any = method.start(shot(0, picture, scale, speed))
    with torch.no_grad():
        for t in range(frames):
            image, state = method(shot(t, picture, scale, speed), state)
            found.append(to_display(image)[..., EDGE:-EDGE, EDGE:-EDGE])
    return found


def still(names: Sequence[str]) -> list[str]:
    """Markdown: a still picture's error after some frames, and what pixels change by in the period after the 64th."""
    counts = (1, 4, 16, 64)
    lines = [
        f"| method | {' | '.join(f'{n} frames' for n in counts)} | largest change later |",
        "|---" + "|---:" * 5 + "|",
    ]
    for name in names:
        scale = 1.0 if name == "taa" else 2.0
        made = images(name, 64 + phases(scale), detail)
        right = to_display(truth(detail, scale))[..., EDGE:-EDGE, EDGE:-EDGE]
        errors = [float((made[n - 1] - right).square().mean().sqrt()) for n in counts]
        late = torch.stack(made[64:])
        change = float((late.amax(0) - late.amin(0)).max()) * 255
        lines.append(f"| {name} | {' | '.join(f'{e:.4f}' for e in errors)} | {change:.2f} / 255 |")
    return lines


def thin(names: Sequence[str]) -> list[str]:
    """Markdown: contrast of a wire that moves, in its weakest column over the last frames and in the mean."""
    made = {name: images(name, 28, wire, SPEED)[20:] for name in names}
    moved = [truth(lambda x, y, t=t: wire(x - SPEED * t, y), 2.0) for t in range(20, 28)]  # type: ignore[misc]
    made["the truth"] = [to_display(image)[..., EDGE:-EDGE, EDGE:-EDGE] for image in moved]
    ground = float(to_display(torch.full((1, 3, 1, 1), 0.6)).mean())
    lines = ["| method | weakest column | mean |", "|---|---:|---:|"]
    for name, last in made.items():
        contrast = ground - torch.stack(last)[:, 0, 1].amin(1)
        lines.append(f"| {name} | {float(contrast.min()):.3f} | {float(contrast.mean()):.3f} |")
    return lines


def moves(clips: Sequence[Clip], each: int = 4) -> list[str]:
    """Markdown: what is left of references after eight moves by half a pixel, there and back along both axes."""
    steps = {
        "learned table": lambda image, motion: resample(image, motion, shipped_table()),
        "Catmull-Rom": lambda image, motion: sharp_warp(image, motion, bounded=False),
        "bilinear": warp,
    }
    lines = ["| read by | SSIM | PSNR |", "|---|---:|---:|"]
    for name, step in steps.items():
        found = []
        for clip in clips:
            for index in range(0, len(clip), max(1, len(clip) // each)):
                image = clip.reference(index)
                assert image is not None
                found.append(moved(tonemap(image), step))
        ssim, psnr = (sum(values[m] for values in found) / len(found) for m in ("ssim", "psnr"))
        lines.append(f"| {name} | {ssim:.4f} | {psnr:.2f} |")
    return lines


def moved(image: Tensor, step: Callable[[Tensor, Tensor], Tensor]) -> dict[str, float]:
    """Quality of an image in [0, 1] after the moves."""
    result = image
    for k in range(8):
        result = step(result, torch.full((1, 2, *image.shape[-2:]), 0.5 if k % 2 == 0 else -0.5))
    inner = (..., slice(12, -12), slice(12, -12))
    values = measure(result[inner].clamp(0, 1), image[inner], ["ssim", "psnr"], {"all": None})
    return {metric: value for (_, metric), value in values.items()}
