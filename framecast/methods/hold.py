"""Hold: a frame that was not shaded repeats one that was.

Paper:   none; what a display does with a slower renderer, and the floor of every comparison.
Follows: extrapolation repeats the last shaded frame, interpolation the nearer one in time, the earlier where tied.
Differs: nothing.
Needs:   color
Modes:   interpolate, extrapolate
State:   the last two shaded frames
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn

from framecast.frame import Frame
from framecast.methods.pair import Pair, advance, begin


@dataclass(frozen=True)
class Config:
    """Nothing to set."""


class Hold(nn.Module):
    """See the top of this file."""

    needs: tuple[str, ...] = ("color",)
    needs_generated: tuple[str, ...] = ()
    modes: tuple[str, ...] = ("interpolate", "extrapolate")
    scales: tuple[float, ...] = (1.0,)
    history: int | None = 2
    step_motion: bool = False

    def __init__(self, config: Config = Config()) -> None:
        super().__init__()
        self.config = config

    def start(self, frame: Frame) -> Pair:
        """The state before the first frame, which is `frame`."""
        return begin(frame, self.needs)

    def forward(self, frame: Frame, state: Pair) -> tuple[Float[Tensor, "b 3 h w"], Pair]:
        """The frame's own image where it was shaded, else the repeated one."""
        if frame.color is not None:
            return frame.color, advance(frame, state, self.needs)
        assert state.prev.color is not None
        assert state.current.color is not None
        return torch.where(state.position(frame.time) > 0.5, state.current.color, state.prev.color), state
