"""Blend: the two shaded frames around a moment, mixed by time.

Paper:   none; the cross-fade of every video editor.
Follows: (1 - a) previous + a current in linear light, a = 0 at the previous shaded frame and 1 at the current one.
Differs: beyond the current frame it holds: continuing the mix there (a > 1) makes negative light and doubles every
         edge that moved.
Needs:   color
Modes:   interpolate, extrapolate
State:   the last two shaded frames
"""

from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor, nn

from framecast.frame import Frame
from framecast.methods.pair import Pair, advance, begin


@dataclass(frozen=True)
class Config:
    """Nothing to set."""


class Blend(nn.Module):
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
        """The frame's own image where it was shaded, else the mix."""
        if frame.color is not None:
            return frame.color, advance(frame, state, self.needs)
        assert state.prev.color is not None
        assert state.current.color is not None
        weight = state.position(frame.time).clamp(0, 1)
        return state.prev.color * (1 - weight) + state.current.color * weight, state
