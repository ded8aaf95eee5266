"""RenderINR: a small network that gives the colour at any place of an image from the features around it.

`fasset.py` uses it and says where it is from. Features lie on the samples of a frame and are read bilinearly where the
centre of each pixel falls, at any size of the image.
"""

from itertools import pairwise

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor, library, nn

TILE = 16384
"""Pixels of a tile: what a layer makes of it, 4 MB in half precision, stays in the caches of a core."""


class RenderINR(nn.Module):
    """Features around a pixel, and what is known of it itself, to values of the pixel; rectifiers between layers.

    The last layer starts near 0.
    """

    def __init__(self, latents: int, known: int, outputs: int, widths: tuple[int, ...] = (128, 128, 128)) -> None:
        super().__init__()
        sides = (latents + known, *widths, outputs)
        self.layers = nn.ModuleList(nn.Linear(a, b) for a, b in pairwise(sides))
        for layer in self.layers:
            nn.init.kaiming_normal_(layer.weight, nonlinearity="relu")  # type: ignore[arg-type]
            nn.init.zeros_(layer.bias)  # type: ignore[arg-type]
        nn.init.normal_(self.layers[-1].weight, std=1e-3)  # type: ignore[arg-type]

    def forward(
        self, maps: Float[Tensor, "b c h w"], known: Float[Tensor, "b k H W"], jitter: Float[Tensor, "b 2"]
    ) -> Float[Tensor, "b n H W"]:
        """Values of every pixel of an image.

        Args:
            maps: features on the samples of the frame.
            known: what is known of each pixel of the image; its size is that of the image.
            jitter: where the samples lie, from their pixels' centres.

        Raises:
            ValueError: the image is smaller than the maps, or of another aspect.
        """
        require_size((maps.shape[-2], maps.shape[-1]), (known.shape[-2], known.shape[-1]))
        return self.plain(maps, known, jitter) if torch.is_grad_enabled() else self.fast(maps, known, jitter)

    def plain(
        self, maps: Float[Tensor, "b c h w"], known: Float[Tensor, "b k H W"], jitter: Float[Tensor, "b 2"]
    ) -> Float[Tensor, "b n H W"]:
        """As it is written down: features are read at every pixel, and all layers follow."""
        x = torch.cat((sampled(maps, (known.shape[-2], known.shape[-1]), jitter), known), 1).permute(0, 2, 3, 1)
        for layer in self.layers[:-1]:
            x = F.relu(layer(x))
        values: Tensor = self.layers[-1](x)
        return values.permute(0, 3, 1, 2).float()

    def fast(
        self, maps: Float[Tensor, "b c h w"], known: Float[Tensor, "b k H W"], jitter: Float[Tensor, "b 2"]
    ) -> Float[Tensor, "b n H W"]:
        """The same: bilinear reading and the first layer, which is linear, may change places, and the smaller one of
        both images is the cheaper place for it. Under autocast all in its precision."""
        kind = maps.device.type
        dtype = torch.get_autocast_dtype(kind) if torch.is_autocast_enabled(kind) else torch.float32
        parameters = [p.to(dtype) for p in self.parameters()]  # weight and bias of each layer in turn
        arguments = maps.to(dtype), known.to(dtype), jitter, parameters
        return render_tiles(*arguments) if kind == "cpu" else _rendered(*arguments, known.shape[-2])


@library.custom_op("framecast::render_tiles", mutates_args=())
def render_tiles(maps: Tensor, known: Tensor, jitter: Tensor, parameters: list[Tensor]) -> Tensor:
    """Every pixel, a few rows at a time. Compiled code calls this as it is."""
    return _rendered(maps, known, jitter, parameters, max(1, TILE // known.shape[-1]))


@render_tiles.register_fake
def _(maps: Tensor, known: Tensor, jitter: Tensor, parameters: list[Tensor]) -> Tensor:
    return known.new_empty(len(known), len(parameters[-1]), *known.shape[-2:], dtype=torch.float32)


def _rendered(maps: Tensor, known: Tensor, jitter: Tensor, parameters: list[Tensor], rows: int) -> Tensor:
    with torch.autocast(maps.device.type, enabled=False):
        weight, bias, *others = parameters
        first = F.linear(maps.permute(0, 2, 3, 1), weight[:, : maps.shape[1]], bias)
        own, (height, width) = weight[:, maps.shape[1] :].T, known.shape[-2:]
        values = torch.empty(len(maps), height, width, len(others[-1]), device=maps.device)
        for k in range(len(maps)):
            low, high, part = taps(maps.shape[2], height, jitter[k, 1])
            left, right, share = taps(maps.shape[3], width, jitter[k, 0])
            share, part = share[:, None].to(first.dtype), part[:, None, None].to(first.dtype)
            for top in range(0, height, rows):
                here = slice(top, top + rows)
                lowest, highest = int(low[top]), int(high[here][-1])
                lines = first[k, lowest : highest + 1]  # across first: fewer rows than down first
                lines = torch.lerp(lines.index_select(1, left), lines.index_select(1, right), share)
                x = torch.lerp(lines[low[here] - lowest], lines[high[here] - lowest], part[here]).flatten(0, 1)
                x = x.addmm_(known[k, :, here].permute(1, 2, 0).flatten(0, 1), own).relu_()
                for at in range(0, len(others) - 2, 2):
                    x = F.linear(x, others[at], others[at + 1]).relu_()
                values[k, here] = F.linear(x, others[-2], others[-1]).view(-1, width, len(others[-1]))
        return values.permute(0, 3, 1, 2).contiguous()


def taps(
    small: int, large: int, jitter: Float[Tensor, ""]
) -> tuple[Int[Tensor, " n"], Int[Tensor, " n"], Float[Tensor, " n"]]:
    """Of each pixel of an axis the sample before it, the one after it, and how far it lies between them."""
    position = (torch.arange(large, device=jitter.device) + 0.5) * (small / large) - 0.5 - jitter
    before = position.floor()
    low, high = (index.clamp(0, small - 1).long() for index in (before, before + 1))
    return low, high, position - before


def sampled(
    maps: Float[Tensor, "b c h w"], size: tuple[int, int], jitter: Float[Tensor, "b 2"]
) -> Float[Tensor, "b c H W"]:
    """Features at the centre of every pixel of an image, bilinear between the samples; beyond them the last one."""
    x, y = (
        (torch.arange(large, device=maps.device) + 0.5) * (2 / large) - 1 - jitter[:, axis, None] * (2 / small)
        for axis, small, large in ((0, maps.shape[-1], size[1]), (1, maps.shape[-2], size[0]))
    )
    grid = torch.stack((x[:, None].expand(-1, *size), y[:, :, None].expand(-1, *size)), -1)
    return F.grid_sample(maps.float(), grid, padding_mode="border", align_corners=False)


def require_size(small: tuple[int, int], size: tuple[int, int]) -> None:
    """Raises ValueError where images of a size cannot be made from frames of another."""
    (height, width), (tall, wide) = small, size
    if tall < height or wide < width:
        raise ValueError(
            f"an image of {wide}x{tall} pixels is smaller than the frame of {width}x{height} that it is made from; "
            f"use a scale of at least 1"
        )
    if abs(tall * width - wide * height) > max(height, width):
        raise ValueError(
            f"an image of {wide}x{tall} pixels has another aspect than the frame of {width}x{height} that it is made "
            f"from; give both sides the same scale, here {round(height * wide / width)} rows for {wide} columns"
        )
