"""The networks of FASSET: frame feature extractor and RenderINR. `fasset.py` says where they are from."""

from dataclasses import dataclass
from typing import Literal

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from framecast.methods.inr import RenderINR
from framecast.nets import GatedConv

SURFACE = 7
"""Channels of `surfaces`: base colour, depth, normal."""


@dataclass(frozen=True)
class Config:
    """The network and what it adds to; the defaults are what the paper describes."""

    scale: float = 2.0
    """Output size divided by input size, at least 1."""
    widths: tuple[int, int, int, int] = (24, 32, 40, 48)
    """Channels at the size of the frame, a half, a quarter and an eighth of it."""
    kept: int = 32
    """Channels of the recurrent module."""
    latents: tuple[int, int] = (24, 12)
    """Channels of the features from FrameEncoder, and from GEncoder."""
    base: Literal["warped", "guided", "accumulated"] = "warped"
    """What the output is added to where a frame was not shaded: the last one warped along the motion; the same by
    guided warping, holes filled; or what TAAU accumulated, warped, with guided warping in holes. Where it was shaded:
    the frame enlarged, and with "accumulated" what TAAU makes of it."""
    looks: bool = False
    """Whether RenderINR sees that image at its own pixel."""
    offset: bool = False
    """Whether RenderINR is told where the nearest sample lies, from the pixel's centre."""
    gencoder: bool = True
    """GEncoder; without it base colour, depth and normal stand in for its features."""
    mask: bool = True
    """Multiply shaded frames by the mask of what the frame before them shows."""
    shared: bool = True
    """The same weights for both kinds of frames."""


def layer(inputs: int, outputs: int) -> nn.Sequential:
    """3 x 3 convolution and rectifier."""
    return nn.Sequential(nn.Conv2d(inputs, outputs, 3, 1, 1), nn.ReLU())


def gated(inputs: int, outputs: int, stride: int = 1) -> nn.Sequential:
    """Light-weight gated 3 x 3 convolution and rectifier; all gates start half open."""
    gate = GatedConv(inputs, outputs, stride=stride, norm=False)
    with torch.no_grad():
        nn.init.kaiming_normal_(gate.conv.weight, nonlinearity="relu")
        gate.conv.weight.mul_(2)
        gate.conv.weight[-1:].zero_()
        assert gate.conv.bias is not None
        gate.conv.bias.zero_()
    return nn.Sequential(gate, nn.ReLU())


class Recurrent(nn.Module):
    """Convolutional gated recurrent unit: what it keeps, h, becomes h + z (tanh(...) - h)."""

    def __init__(self, inputs: int, kept: int) -> None:
        super().__init__()
        self.gates = nn.Conv2d(inputs + kept, 2 * kept, 3, 1, 1)
        self.candidate = nn.Conv2d(inputs + kept, kept, 3, 1, 1)

    def forward(self, x: Float[Tensor, "b c h w"], kept: Float[Tensor, "b k h w"]) -> Float[Tensor, "b k h w"]:
        update, reset = torch.sigmoid(self.gates(torch.cat((x, kept), 1)).float()).chunk(2, 1)
        candidate = torch.tanh(self.candidate(torch.cat((x, reset * kept), 1)).float())
        new: Tensor = kept + update * (candidate - kept)
        return new


class FrameEncoder(nn.Module):
    """U-Net: three sizes down by gated convolutions, the recurrent module, and up again; sides are multiples of 8."""

    def __init__(self, inputs: int, config: Config) -> None:
        super().__init__()
        a, b, c, d = config.widths
        self.enter = nn.Sequential(gated(inputs, a), gated(a, a))
        self.down = nn.ModuleList(nn.Sequential(gated(x, y, 2), gated(y, y)) for x, y in ((a, b), (b, c), (c, d)))
        self.recurrent = Recurrent(d, config.kept)
        self.up = nn.ModuleList(layer(x, y) for x, y in ((config.kept + c, c), (c + b, b), (b + a, a)))
        self.leave = nn.Conv2d(a, config.latents[0], 3, 1, 1)

    def forward(self, x: Float[Tensor, "b c h w"], kept: Float[Tensor, "b k i j"]) -> tuple[Tensor, Tensor]:
        """Features at the size of the input, and what the recurrent module keeps."""
        sizes = [self.enter(x)]
        for down in self.down:
            sizes.append(down(sizes[-1]))
        kept = self.recurrent(sizes.pop(), kept)
        x = kept
        for up in self.up:
            x = up(torch.cat((F.interpolate(x, scale_factor=2.0, mode="bilinear"), sizes.pop()), 1))
        return self.leave(x), kept


class Network(nn.Module):
    """Frame feature extractor and RenderINR."""

    def __init__(self, config: Config) -> None:
        super().__init__()
        seen = 3 if config.base == "accumulated" else 0
        self.frame = FrameEncoder(8 + seen, config)
        wide = config.latents[1]
        self.surface = (
            nn.Sequential(layer(SURFACE, 16), layer(16, 16), nn.Conv2d(16, wide, 3, 1, 1)) if config.gencoder else None
        )
        self.reweight = nn.Sequential(layer(3 + SURFACE, 16), layer(16, 16), nn.Conv2d(16, 2, 3, 1, 1), nn.Tanh())
        nn.init.constant_(self.reweight[2].bias, -1.0986)  # type: ignore[arg-type]  # both weigh 1
        known = 2 + 7 * config.looks + 2 * config.offset
        self.render = RenderINR(config.latents[0] + (wide if config.gencoder else SURFACE), known, 4 if seen else 3)

    def extract(self, x: Tensor, around: Tensor, kept: Tensor) -> tuple[Tensor, Tensor]:
        """Features for RenderINR and for the recurrent module.

        Args:
            x: what FrameEncoder sees, b c h w.
            around: colour and `surfaces`, b 10 h w.
        """
        features, kept = self.frame(x, kept)
        surface = around[:, 3:] if self.surface is None else self.surface(around[:, 3:])
        weights = 5 * (self.reweight(around).float() + 1)
        return torch.cat((features.float() * weights[:, :1], surface.float() * weights[:, 1:]), 1), kept
