"""IFRNet: a frame between two shaded ones, from their colour alone, by flow that a network finds and refines.

Paper:   Kong, Jiang, Luo, Chu, Huang, Tai, Wang, Yang, "IFRNet: Intermediate Feature Refine Network for Efficient Frame
         Interpolation", IEEE/CVF Conference on Computer Vision and Pattern Recognition (CVPR) 2022
Follows: one encoder for both frames; decoders from coarse to fine that refine at once the flow from the new frame to
         both and features of the new frame itself, and see those of both frames warped along it; at full size a mask
         that mixes both warped frames, and a residual; Charbonnier and census loss.
Differs: Three sizes in place of four, and fewer channels than in its smallest variant: 0.4 million parameters. It
         stands for what is done without a renderer's vectors and buffers, not for the best that is done so.
         Where both frames agree, nothing moves and nothing is added. The mask starts from the time: untrained, it
         blends. Colour is x / (1 + max) under the sRGB curve. The census loss counts a tenth.
         No distillation of flow, which needs another trained network, and no loss between features.
Needs:   color
Modes:   interpolate
State:   the last two shaded frames
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from framecast.frame import Frame
from framecast.methods.larger import decoded, encoded
from framecast.methods.pair import Pair, advance, begin
from framecast.nets import padded
from framecast.recipe import Recipe
from framecast.warp import warp

CHANGE = 0.02
"""Difference of both frames, as displayed, from which on all that the network says counts."""

AROUND = 17
"""Pixels, in a square, one of which has to differ."""

CENSUS = 0.1
"""Weight of the census loss, which is ten times the other."""

SHARPEST = 0.99
"""Largest share of one frame that the time alone gives."""


@dataclass(frozen=True)
class Config:
    """The network."""

    widths: tuple[int, int, int] = (16, 32, 48)
    """Channels of the encoder at a half, a quarter and an eighth of the size."""
    inner: tuple[int, int, int] = (32, 48, 64)
    """Those inside of the decoders at these sizes."""
    scale: float = 1.0
    """Output size divided by input size."""


def conv(inputs: int, outputs: int, stride: int = 1) -> nn.Sequential:
    """3 x 3 convolution and rectifier with a slope of its own for each channel."""
    return nn.Sequential(nn.Conv2d(inputs, outputs, 3, stride, 1), nn.PReLU(outputs))


class Residual(nn.Module):
    """Five convolutions; the second and the fourth are of the last channels alone."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.side = channels // 3
        self.whole = nn.ModuleList((conv(channels, channels), conv(channels, channels)))
        self.part = nn.ModuleList((conv(self.side, self.side), conv(self.side, self.side)))
        self.leave = nn.Conv2d(channels, channels, 3, 1, 1)
        self.slope = nn.PReLU(channels)

    def forward(self, x: Float[Tensor, "b c h w"]) -> Float[Tensor, "b c h w"]:
        y = x
        for whole, part in zip(self.whole, self.part, strict=True):
            y = whole(y)
            y = torch.cat((y[:, : -self.side], part(y[:, -self.side :])), 1)
        added: Tensor = self.slope(x + self.leave(y))
        return added


def decoder(inputs: int, inner: int, outputs: int) -> nn.Sequential:
    """Twice the size; what it gives starts near 0."""
    leave = nn.ConvTranspose2d(inner, outputs, 4, 2, 1)
    nn.init.normal_(leave.weight, std=1e-3)
    assert leave.bias is not None
    nn.init.zeros_(leave.bias)
    return nn.Sequential(conv(inputs, inner), Residual(inner), leave)


class Network(nn.Module):
    """Both frames and the time, to flows, mask and residual; sides are multiples of 8."""

    def __init__(self, config: Config) -> None:
        super().__init__()
        a, b, c = config.widths
        self.encoder = nn.ModuleList(nn.Sequential(conv(x, y, 2), conv(y, y)) for x, y in ((3, a), (a, b), (b, c)))
        fine, middle, coarse = config.inner
        self.decoders = nn.ModuleList(
            (decoder(2 * c + 1, coarse, 4 + b), decoder(3 * b + 4, middle, 4 + a), decoder(3 * a + 4, fine, 8))
        )

    def features(self, image: Float[Tensor, "b 3 h w"]) -> list[Tensor]:
        """Of one frame, the largest first."""
        found = []
        for stage in self.encoder:
            image = stage(image)
            found.append(image)
        return found

    def forward(
        self, before: Float[Tensor, "b 3 h w"], after: Float[Tensor, "b 3 h w"], at: Float[Tensor, "b 1 1 1"]
    ) -> tuple[Float[Tensor, "b 4 h w"], Float[Tensor, "b 1 h w"], Float[Tensor, "b 3 h w"]]:
        """Flow from the new frame to the one before and to the one after, in pixels; mask; residual."""
        left, right = self.features(before), self.features(after)
        moment = at.expand(-1, 1, *left[-1].shape[-2:])
        found = self.decoders[0](torch.cat((left[-1], right[-1], moment), 1)).float()
        flow, own = found[:, :4], found[:, 4:]
        for size, decode in zip((1, 0), list(self.decoders)[1:], strict=True):
            sides = (warp(left[size].float(), flow[:, :2]), warp(right[size].float(), flow[:, 2:]))
            found = decode(torch.cat((own, *sides, flow), 1)).float()
            larger = 2 * F.interpolate(flow, scale_factor=2.0, mode="bilinear")
            flow, own = larger + found[:, :4], found[:, 4:]
        return flow, own[:, :1], own[:, 1:]


class IFRNet(nn.Module):
    """See the top of this file."""

    needs: tuple[str, ...] = ("color",)
    needs_generated: tuple[str, ...] = ()
    modes: tuple[str, ...] = ("interpolate",)
    scales: tuple[float, ...] = (1.0,)
    parts: tuple[str, ...] = ("image",)
    history: int | None = 2
    step_motion: bool = False

    def __init__(self, config: Config = Config()) -> None:
        super().__init__()
        self.config = config
        self.network = Network(config)

    def start(self, frame: Frame) -> Pair:
        """The state before the first frame, which is `frame`."""
        return begin(frame, self.needs)

    def forward(self, frame: Frame, state: Pair) -> tuple[Float[Tensor, "b 3 h w"], Pair]:
        """The frame's own image where it was shaded, else the one in between."""
        if frame.color is not None:
            return frame.color, advance(frame, state, self.needs)
        return decoded(self.image(state, state.position(frame.time))), state

    def image(self, state: Pair, at: Float[Tensor, "b 1 1 1"]) -> Float[Tensor, "b 3 h w"]:
        """The image at a part of the way, tone-mapped under the sRGB curve."""
        assert state.prev.color is not None
        assert state.current.color is not None
        before, after = encoded(state.prev.color), encoded(state.current.color)
        height, width = before.shape[-2:]
        flow, mask, added = (
            values[..., :height, :width] for values in self.network(padded(before, 8), padded(after, 8), at)
        )
        apart = ((before - after).abs().amax(1, keepdim=True) / CHANGE).clamp(max=1)
        counts = F.max_pool2d(apart, AROUND, 1, AROUND // 2)
        earlier, later = warp(before, flow[:, :2] * counts), warp(after, flow[:, 2:] * counts)
        share = torch.sigmoid(torch.logit(1 - at, 1 - SHARPEST) + mask)
        return later + share * (earlier - later) + added * counts


# Training.


def loss(method: IFRNet, frames: Sequence[Frame], targets: Float[Tensor, "b n 3 H W"]) -> dict[str, Float[Tensor, ""]]:
    """Both terms on the frame in between."""
    first, second, between = frames
    state = advance(second, method.start(first), method.needs)
    image, truth = method.image(state, state.position(between.time)), encoded(targets[:, -1])
    return {"charbonnier": ((image - truth).square() + 1e-6).sqrt().mean(), "census": CENSUS * census(image, truth)}


def census(image: Float[Tensor, "b 3 h w"], truth: Float[Tensor, "b 3 h w"]) -> Float[Tensor, ""]:
    """How differently pixels compare with those around, 7 x 7, whatever the brightness; 0 for equal images."""
    apart = (ranks(image) - ranks(truth)).square()
    return (apart / (0.1 + apart)).mean()


def ranks(image: Float[Tensor, "b 3 h w"]) -> Float[Tensor, "b 49 i j"]:
    """Of each pixel but those of the border how it differs from each of the 7 x 7 around, d / sqrt(0.81 + d^2) with d
    in 255ths."""
    grey = image.mean(1, keepdim=True) * 255
    height, width = grey.shape[-2:]
    around = F.unfold(F.pad(grey, (3, 3, 3, 3), mode="replicate"), 7).view(-1, 49, height, width)
    d = around - grey
    return (d * (0.81 + d * d).rsqrt())[..., 1:-1, 1:-1]


recipe = Recipe(loss=loss, mode="interpolate", shaded=2, crop=(128, 128), batch=4, steps=3000, rate=5e-4, warmup=100)
