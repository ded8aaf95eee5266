"""Bilinear and Lanczos: each frame enlarged by itself, with its jitter taken back.

Paper:   none; the floor of every comparison. The window is that of Duchon, "Lanczos filtering in one and two
         dimensions", Journal of Applied Meteorology 18(8), 1979.
Follows: weights of the 2 x 2 (bilinear) or 4 x 4 (Lanczos, two lobes) samples nearest to each pixel, by their true
         distance to it, so that nothing shifts as the jitter changes.
Differs: Both work in x / (1 + max(r, g, b)), as the other methods do, so that highlights do not spread. Lanczos stays
         between the smallest and the largest of the 3 x 3 samples around, without which it rings.
Needs:   color
Modes:   pass
State:   none
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import nn

from framecast.color import tonemap, untonemap
from framecast.frame import Frame
from framecast.methods.larger import TWICE, Config, output_size, require
from framecast.resample import enlarge, lanczos, nearest_sample, neighbourhood, tent
from framecast.warp import pick


@dataclass(frozen=True)
class Nothing:
    """What is remembered of the frames before."""


torch.export.register_dataclass(Nothing)


class Bilinear(nn.Module):
    """See the top of this file."""

    needs: tuple[str, ...] = ("color",)
    needs_generated: tuple[str, ...] = ()
    modes: tuple[str, ...] = ("pass",)
    scales: tuple[float, ...] = (1.0, 1.5, 2.0, 3.0)
    parts = ("upscale",)
    history: int | None = 1
    step_motion: bool = False

    def __init__(self, config: Config = TWICE) -> None:
        super().__init__()
        self.config = config

    def start(self, frame: Frame) -> Nothing:
        """No state."""
        return Nothing()

    def forward(self, frame: Frame, state: Nothing) -> tuple[Float[torch.Tensor, "b 3 H W"], Nothing]:
        """The frame's own colour at the larger size.

        Raises:
            ValueError: the frame was not shaded.
        """
        require(frame, type(self).__name__.lower(), self.needs)
        return self.upscale(frame), state

    def upscale(self, frame: Frame) -> Float[torch.Tensor, "b 3 H W"]:
        """The arithmetic."""
        assert frame.color is not None
        image = enlarge(tonemap(frame.color), output_size(frame, self.config.scale), frame.jitter, tent, 2).image
        return untonemap(image)


class Lanczos(Bilinear):
    """See the top of this file."""

    def upscale(self, frame: Frame) -> Float[torch.Tensor, "b 3 H W"]:
        """The arithmetic."""
        assert frame.color is not None
        return untonemap(bounded_lanczos(tonemap(frame.color), output_size(frame, self.config.scale), frame.jitter))


def bounded_lanczos(
    image: Float[torch.Tensor, "b c h w"], size: tuple[int, int], jitter: Float[torch.Tensor, "b 2"]
) -> Float[torch.Tensor, "b c H W"]:
    """`enlarge` with the Lanczos kernel, kept among the 3 x 3 samples around the nearest one."""
    nearest = nearest_sample((image.shape[-2], image.shape[-1]), size, jitter)
    around = neighbourhood(image)
    large = enlarge(image, size, jitter, lanczos, 4).image
    return torch.minimum(torch.maximum(large, pick(around.low, nearest)), pick(around.high, nearest))
