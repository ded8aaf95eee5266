"""An analytic shot for tests of methods with G-buffers: a textured wall passes by, a square may cross it."""

from collections.abc import Sequence
from pathlib import Path

import torch
from torch import Tensor, nn

from framecast.clip import Clip, Record, finish, write_frame
from framecast.frame import Frame

H, W = 24, 40


def texture(x: Tensor, y: Tensor) -> Tensor:
    """Colour of the wall at a place of it, in pixels."""
    return torch.stack((0.5 + 0.3 * torch.sin(x * 0.4), 0.5 + 0.3 * torch.cos(y * 0.5), 0.4 + 0.2 * torch.sin(x + y)))


def shot(
    time: float,
    *,
    speed: float = 3.0,
    square: float | None = None,
    jitter: tuple[float, float] = (0.0, 0.0),
    span: float = 2.0,
) -> Frame:
    """A textured wall at depth 5 that an orthographic camera sees pass by, `speed` pixels a frame to the right.

    `square`: a grey square of 8 pixels at depth 2, object 7, moving that many pixels a frame from column 4.
    """
    y, x = torch.meshgrid(torch.arange(H) + 0.5 + jitter[1], torch.arange(W) + 0.5 + jitter[0], indexing="ij")
    color = texture(x - speed * time, y)
    hit = torch.zeros(H, W, dtype=torch.bool)
    if square is not None:
        left = 4 + square * time
        hit = (x >= left) & (x < left + 8) & (y >= 8) & (y < 16)
    motion = torch.stack((torch.where(hit, -(square or 0.0) * span, -speed * span), torch.zeros(H, W)))
    view = torch.eye(4)
    view[0, 3] = speed * time  # the wall stands still in the world, the camera moves past it, one unit a pixel
    projection = torch.diag(torch.tensor([2 / W, 2 / H, -0.01, 1.0]))
    return Frame(
        color=torch.where(hit, torch.tensor(0.05), color)[None],
        depth=torch.where(hit, 2.0, 5.0)[None, None],
        motion=motion[None],
        albedo=torch.full((1, 3, H, W), 0.5),
        normal=torch.tensor([0.0, 0.0, 1.0]).view(1, 3, 1, 1).expand(1, 3, H, W).contiguous(),
        roughness=torch.full((1, 1, H, W), 0.5),
        metallic=torch.zeros(1, 1, H, W),
        object=(hit.int() * 7)[None, None],
        jitter=torch.tensor([jitter]),
        view=view[None],
        projection=projection[None],
        time=torch.tensor([float(time)]),
        reset=torch.tensor([time == 0]),
        span=torch.tensor([span]),
    )


def run(method: nn.Module, frames: Sequence[Frame]) -> list[Tensor]:
    """The images that a method makes of frames, from a fresh start."""
    images: list[Tensor] = []
    state = method.start(frames[0])  # type: ignore[operator]
    with torch.no_grad():
        for frame in frames:
            image, state = method(frame, state)
            images.append(image)
    return images


def write_shots(folder: Path, frames: int, **about: float) -> Clip:
    """`shot` at 0, 1, 2 ... with vectors to the frame before and the one before that, as a clip on disk."""
    names = ("color", "depth", "motion", "albedo", "normal", "roughness", "metallic", "object")
    for t in range(frames):
        frame = shot(float(t), span=1.0, **about)
        layers = {name: getattr(frame, name)[0].numpy() for name in names}
        layers["motion2"] = 2 * layers["motion"]
        assert frame.view is not None
        assert frame.projection is not None
        view, projection = (tuple(tuple(row) for row in m[0].tolist()) for m in (frame.view, frame.projection))
        write_frame(folder, Record(number=t + 1, time=float(t), view=view, projection=projection), layers)
    return finish(folder, fps=24)
