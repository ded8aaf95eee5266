"""The two shaded frames between or beyond which a method generates: the state of every method without memory."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from framecast.frame import BUFFERS, Frame


@dataclass(frozen=True)
class Pair:
    """The last two shaded frames; the same frame twice right after a reset."""

    prev: Frame
    """The shaded frame before `current`."""
    current: Frame
    """The last shaded frame."""

    def position(self, time: Float[Tensor, " b"]) -> Float[Tensor, "b 1 1 1"]:
        """Where `time` lies: 0 at the previous shaded frame, 1 at the current one, above 1 beyond it.

        With one frame alone there is nothing to lie between: 1.
        """
        gap = self.current.time - self.prev.time
        at = (time - self.prev.time) / torch.where(gap > 0, gap, 1)
        return torch.where(gap > 0, at, 1)[:, None, None, None]


torch.export.register_dataclass(Pair)


def begin(frame: Frame, keeps: Sequence[str]) -> Pair:
    """The state when `frame` is the only shaded one. `keeps`: the buffers (field names) that the method reads."""
    slim = _slim(frame, keeps, torch.ones_like(frame.reset))
    return Pair(prev=slim, current=slim)


def advance(frame: Frame, state: Pair, keeps: Sequence[str]) -> Pair:
    """The state after one more shaded frame; those of the batch that reset begin anew."""
    slim, old = _slim(frame, keeps, frame.reset), state.current
    values: dict[str, Any] = {
        f.name: _where(frame.reset, getattr(slim, f.name), getattr(old, f.name)) for f in fields(slim)
    }
    return Pair(prev=Frame(**values), current=slim)


def _slim(frame: Frame, keeps: Sequence[str], fresh: Bool[Tensor, " b"]) -> Frame:
    """The frame with the buffers in `keeps` alone, and without motion to frames that are not there.

    A fresh frame's motion is meaningless: it becomes the straight continuation of `motion_next`, or nothing.
    """
    changes: dict[str, Any] = {name: None for name in BUFFERS if name not in keeps}
    if frame.motion is not None and "motion" in keeps:
        ahead = frame.motion_next if "motion_next" in keeps else None
        straight = torch.zeros_like(frame.motion) if ahead is None else -ahead
        changes["motion"] = _where(fresh, straight, frame.motion)
    return replace(frame, **changes)


def _where(choose: Bool[Tensor, " b"], a: Tensor | None, b: Tensor | None) -> Tensor | None:
    """`a` where chosen, else `b`; where one of them was not rendered, `b` (of one shot, whatever that is)."""
    if a is None or b is None:
        return b
    return torch.where(choose.view(-1, *[1] * (a.ndim - 1)), a, b)
