"""Train the table of weights with which framecast resamples pictures (`framecast/table.py`), and write it.

    python examples/train_table.py CLIP CLIP ... -o table.safetensors

A network of two hidden layers maps a position between pixels to the weights of the 4 x 4 pixels around it (Mob-FGSR,
section 4). Pictures are moved by random parts of a pixel again and again until they are back in place; what they have
lost on the way is the loss. References are used where a clip has them, else shaded colour, compressed as
histories are. A few minutes on one core.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import torch
import torch.nn.functional as F
import tyro
from jaxtyping import Float, Int
from torch import Tensor, nn
from tyro.conf import Positional, arg

from framecast import checkpoint
from framecast.clip import Clip, open_clip
from framecast.color import tonemap
from framecast.table import LEVELS

MOVES = (2, 3, 4, 6, 8)
"""How often a picture is moved before it is compared; one number after another."""

EDGE = 12
"""Pixels along the border of a crop that are not compared: their surroundings were not there."""


class Weights(nn.Module):
    """Position between pixels -> weights of 4 x 4 pixels: bilinear ones, and what the network adds to them.

    What is added sums to 0, is nothing at whole pixels, fades out two pixels away from the position, and is the mean
    of what the network says of the position's eight mirror images: the weights keep these symmetries exactly.
    """

    def __init__(self, width: int = 32) -> None:
        super().__init__()
        layers = [nn.Linear(2, width), nn.Tanh(), nn.Linear(width, width), nn.Tanh(), nn.Linear(width, 16)]
        self.network = nn.Sequential(*layers)
        nn.init.zeros_(layers[-1].weight)  # type: ignore[arg-type]
        nn.init.zeros_(layers[-1].bias)  # type: ignore[arg-type]

    def forward(self, position: Float[Tensor, "n 2"]) -> Float[Tensor, "n 4 4"]:
        """Weights at (x, y) in [0, 1], rows first."""
        added = torch.zeros(1)
        for mirror_x, mirror_y, swap in ((a, b, c) for a in (0, 1) for b in (0, 1) for c in (0, 1)):
            seen = (position - torch.tensor([mirror_x, mirror_y])).abs()
            weights = self.network(2 * (seen.flip(1) if swap else seen) - 1).view(-1, 4, 4)
            weights = weights.transpose(1, 2) if swap else weights
            added = added + weights.flip([axis + 1 for axis, m in enumerate((mirror_y, mirror_x)) if m]) / 8
        distance = (position[:, :, None] - torch.arange(-1, 3)).abs()
        near = (2 - distance).clamp(min=0)
        window = near[:, 1, :, None] * near[:, 0, None, :]
        added = added * window
        added = added - window * (added.sum((1, 2)) / window.sum((1, 2)))[:, None, None]
        tent = (1 - distance).clamp(min=0)
        between = 4 * (position * (1 - position)).sum(1)
        return tent[:, 1, :, None] * tent[:, 0, None, :] + between[:, None, None] * added


def table(network: Weights) -> Float[Tensor, "32 32 16"]:
    """The network at every 1/32 pixel. At whole columns or rows its two sides are made equal."""
    steps = torch.arange(LEVELS) / LEVELS
    y, x = torch.meshgrid(steps, steps, indexing="ij")
    weights = network(torch.stack((x.flatten(), y.flatten()), 1)).view(LEVELS, LEVELS, 4, 4)
    columns = torch.cat((_even(weights[:, :1], -1), weights[:, 1:]), 1)
    return torch.cat((_even(columns[:1], -2), columns[1:])).flatten(2)


def _even(weights: Tensor, axis: int) -> Tensor:
    """Weights whose first three entries along an axis are the same in both directions; the fourth is 0 there."""
    three, last = weights.split((3, 1), axis)
    return torch.cat(((three + three.flip(axis)) / 2, last), axis)


def moved(
    images: Float[Tensor, "n h w"], weights: Float[Tensor, "32 32 16"], steps: Int[Tensor, "n 2"]
) -> Float[Tensor, "n h w"]:
    """Each image resampled `steps` 32nds of a pixel to the right and down of where it was, 0 to 31; borders wrap."""
    kernels = weights[steps[:, 1], steps[:, 0]].view(-1, 1, 4, 4)
    return F.conv2d(F.pad(images[None], (1, 2, 1, 2), mode="circular"), kernels, groups=len(images))[0]


def there_and_back(moves: int, count: int) -> list[Int[Tensor, "n 2"]]:
    """Moves of `count` images that sum to whole pixels: random ones for half of the images, equal ones for the rest,
    as of a camera that travels evenly."""
    steady = (torch.arange(count) % 2 == 0)[:, None]
    first = torch.randint(0, LEVELS, (count, 2))
    steps = [torch.where(steady, first, torch.randint(0, LEVELS, (count, 2))) for _ in range(moves - 1)]
    return [*steps, -torch.stack(steps).sum(0) % LEVELS]


def loss(images: Float[Tensor, "n h w"], weights: Float[Tensor, "32 32 16"], moves: int) -> Float[Tensor, ""]:
    """Mean squared difference after that many moves."""
    steps = there_and_back(moves, len(images))
    result = images
    for step in steps:
        result = moved(result, weights, step)
    whole = torch.stack(steps).sum(0) // LEVELS
    truth = torch.stack([i.roll((-int(y), -int(x)), (0, 1)) for i, (x, y) in zip(images, whole, strict=True)])
    return (result - truth)[:, EDGE:-EDGE, EDGE:-EDGE].square().mean()


def pictures(clips: Sequence[Clip], every: int = 4) -> list[Float[Tensor, "3 h w"]]:
    """Every few frames of the clips, compressed."""
    found = []
    for clip in clips:
        for index in range(0, len(clip), every):
            image = clip.reference(index) if clip.scale is not None else clip[index].color
            found += [] if image is None else [tonemap(image)[0]]
    return found


def crops(images: Sequence[Tensor], count: int, size: int) -> Float[Tensor, "n h w"]:
    """Random channels of random places."""
    found = []
    for _ in range(count):
        image = images[int(torch.randint(len(images), ()))]
        y, x = (int(torch.randint(side - size + 1, ())) for side in image.shape[-2:])
        found.append(image[int(torch.randint(3, ())), y : y + size, x : x + size])
    return torch.stack(found)


def train(images: Sequence[Tensor], steps: int, seed: int) -> Float[Tensor, "32 32 16"]:
    """The table after that many steps of Adam, its rate falling along a cosine."""
    torch.manual_seed(seed)
    network = Weights()
    optimiser = torch.optim.Adam(network.parameters(), 3e-3)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps, 1e-5)
    mean = 0.0
    for step in range(steps):
        error = loss(crops(images, 32, 48), table(network), MOVES[step % len(MOVES)])
        optimiser.zero_grad()
        error.backward()  # type: ignore[no-untyped-call]
        optimiser.step()
        schedule.step()
        mean = 0.99 * mean + 0.01 * float(error)
        if step % 100 == 99:
            print(f"step {step + 1}: {-10 * math.log10(mean / (1 - 0.99 ** (step + 1))):.2f} dB", flush=True)
    return table(network).detach()


@dataclass(frozen=True)
class Options:
    """Train a resampling table on clips."""

    clips: Positional[tuple[Path, ...]]
    out: Annotated[Path, arg(aliases=["-o"])] = Path("table.safetensors")
    steps: int = 1200
    seed: int = 0


def main(options: Options) -> None:
    """Trains and writes."""
    images = pictures([open_clip(path) for path in options.clips])
    result = train(images, options.steps, options.seed)
    about = {"method": "mobfgsr-table", "config": {"steps": options.steps, "pictures": len(images)}}
    checkpoint.save(options.out, {"table": result}, about)
    print(f"{options.out}: {LEVELS} x {LEVELS} x 16 weights from {len(images)} pictures")


if __name__ == "__main__":
    main(tyro.cli(Options))
