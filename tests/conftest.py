"""Shared by all tests: fixed seeds, two threads, and a small analytic clip."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from framecast.clip import Clip, Record, finish, write_frame
from framecast.frame import SKY, Frame

torch.set_num_threads(1)  # tiny images: threads only wait for each other


@pytest.fixture(autouse=True)
def _seed() -> None:
    torch.manual_seed(0)
    np.random.seed(0)


def disc_frame(time: float, *, step: float = 1.0, height: int = 32, width: int = 48, forward: bool = True) -> Frame:
    """A disc at depth 2 that crosses a textured wall at depth 5 with constant acceleration; vectors over `step`."""
    y, x = torch.meshgrid(torch.arange(height) + 0.5, torch.arange(width) + 0.5, indexing="ij")

    def centre(t: float) -> float:
        return 8 + 3 * t + 0.25 * t * t

    hit = (x - centre(time)) ** 2 + (y - height / 2) ** 2 < 36
    wall = 0.5 + 0.3 * torch.sin(x * 0.9) * torch.cos(y * 0.7)
    disc = 0.2 + 0.1 * torch.sin((x - centre(time)) * 1.1)
    color = torch.where(hit, disc, wall).expand(3, -1, -1)
    back, ahead = centre(time - step) - centre(time), centre(time + step) - centre(time)
    sky = y < 4
    depth = torch.where(hit, 2.0, torch.where(sky, SKY, 5.0))
    zero = torch.zeros_like(x)

    def vectors(dx: float) -> torch.Tensor:
        return torch.stack((torch.where(hit, dx, zero), zero))[None]

    return Frame(
        color=color[None].contiguous(),
        depth=depth[None, None],
        motion=vectors(back),
        motion_next=vectors(ahead) if forward else None,
        object=hit[None, None].int(),
        jitter=torch.zeros(1, 2),
        view=torch.eye(4)[None],
        projection=None,
        time=torch.tensor([float(time)]),
        reset=torch.tensor([time == 0]),
        span=torch.tensor([float(step)]),
    )


@pytest.fixture
def disc_clip(tmp_path: Path) -> Clip:
    """Seven frames of `disc_frame` on disk."""
    return write_disc_clip(tmp_path / "disc", 7)


def write_disc_clip(folder: Path, frames: int, **changes: object) -> Clip:
    """`disc_frame` at 0, 1, 2 ... as a clip on disk."""
    for t in range(frames):
        frame = replace(disc_frame(t), **changes)
        layers = {n: getattr(frame, n)[0].numpy() for n in ("color", "depth", "motion", "motion_next", "object")}
        view = tuple(tuple(row) for row in torch.eye(4).tolist())
        write_frame(folder, Record(number=t + 1, time=float(t), view=view), layers)
    return finish(folder, fps=24)


@pytest.fixture
def small_shadow_maps(monkeypatch: pytest.MonkeyPatch) -> None:
    """Shadow maps of the renderer that suit tiny pictures."""
    from framecast.render import shadows

    monkeypatch.setattr(shadows, "SUN_SIZE", 512)
    monkeypatch.setattr(shadows, "LAMP_SIZE", 256)
