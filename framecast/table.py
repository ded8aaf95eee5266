"""Resampling through a learned table: 16 weights for each of 32 x 32 positions between pixels (Mob-FGSR, section 4).

A position is rounded to the nearest 1/32 pixel; its table entry weighs the 4 x 4 pixels around it. Entries are made by
a small network that learned to resample pictures again and again (`examples/train_table.py`), are symmetric under
mirroring and transposition, sum to 1, and at whole pixels are the pixel itself: what stands still is never softened.
"""

from functools import cache

import safetensors.torch
import torch
from jaxtyping import Float
from torch import Tensor

from framecast.resample import INNER, between, first_of_sixteen, sixteen
from framecast.weights import FOLDER

LEVELS = 32
"""Positions told apart between two pixels."""

TAPS = 16
"""Pixels weighed: rows and columns -1, 0, 1, 2 from the one at or before the position."""


def resample(
    image: Float[Tensor, "b c h w"],
    motion: Float[Tensor, "b 2 H W"],
    table: Float[Tensor, "32 32 16"],
    *,
    bounded: bool = False,
) -> Float[Tensor, "b c H W"]:
    """Content of another frame placed on this pixel grid, `out(p) = image(p + motion(p))`, like `warp.warp`.

    `table[y, x]` are the weights, row by row, at y / 32 and x / 32 pixels past a pixel centre. Pixels outside take the
    nearest edge pixel. Weights may be negative, so that hard edges ring: compress HDR colour first.

    Args:
        bounded: keep values between the smallest and the largest of the four nearest pixels, so that nothing rings.
    """
    height, width = image.shape[-2:]
    grid_h, grid_w = motion.shape[-2:]
    x = torch.arange(grid_w, dtype=torch.float32, device=motion.device) + motion[:, 0]
    y = torch.arange(grid_h, dtype=torch.float32, device=motion.device)[:, None] + motion[:, 1]
    column, level_x = _split(x, width)
    row, level_y = _split(y, height)
    # Joined, both are made before anything is read from there, instead of anew for every weight and pixel.
    places = torch.stack((first_of_sixteen(row, column, width), (level_y * LEVELS + level_x).to(torch.int32) * TAPS))
    first, entry = places.clamp(min=0)
    entries = table.flatten()
    weights = [entries[entry + k] for k in range(TAPS)]
    results = []
    for taps in sixteen(image, first):
        value = weights[0] * taps[0]
        for weight, tap in zip(weights[1:], taps[1:], strict=True):
            value = value + weight * tap
        results.append(between([taps[k] for k in INNER], value) if bounded else value)
    return torch.stack(results, 1)


def _split(position: Tensor, size: int) -> tuple[Tensor, Tensor]:
    """Pixel at or before a position, and how many 32nds the position lies past it; positions outside at the edge."""
    steps = (position.clamp(0, size - 1) * LEVELS + 0.5).floor()
    whole = (steps / LEVELS).floor()
    return whole, steps - whole * LEVELS


@cache
def shipped_table() -> Float[Tensor, "32 32 16"]:
    """The table that ships with the package; do not change it in place."""
    return safetensors.torch.load_file(FOLDER / "mobfgsr-table.safetensors")["table"]
