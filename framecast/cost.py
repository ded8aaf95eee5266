"""What the networks of methods cost: numbers that training changes, and multiply-accumulates for one image."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from rich.table import Table
from torch import nn

from framecast.fit import method_named
from framecast.frame import Frame, moment, perspective, unshaded
from framecast.methods import METHODS, TRAINABLE
from framecast.nets import multiply_accumulates, parameters

SIDE = 64
"""Height and width of the frames on which operations are counted: no network pads them."""


@dataclass(frozen=True)
class Cost:
    """What one method costs; operations are those of convolutions and linear layers alone."""

    method: str
    parameters: int
    shaded: float
    """Multiply-accumulates for one pixel of a shaded frame."""
    generated: float | None
    """The same for a frame to generate; None where the method makes none."""


def cost(name: str) -> Cost:
    """The cost of a method, or of a network that is only trained, by name.

    Raises:
        ValueError: there is no such method.
    """
    method: Any = (TRAINABLE[name][0]() if name in TRAINABLE and name not in METHODS else method_named(name)).eval()
    with torch.no_grad():
        state = method.start(plain(0.0))
        for time in (0.0, 2.0, 4.0):
            shaded = counted(method, plain(time), state)
            state = method(plain(time), state)[1]
        makes = [mode for mode in method.modes if mode != "pass"]
        at = 5.0 if "extrapolate" in makes else 3.0
        request = unshaded(plain(at)) if method.needs_generated else moment(at)
        return Cost(name, parameters(method), shaded, counted(method, request, state) if makes else None)


def counted(method: nn.Module, frame: Frame, state: Any) -> float:
    """Multiply-accumulates for one pixel of a frame."""
    return multiply_accumulates(method, lambda: method(frame, state)) / SIDE**2


def plain(time: float) -> Frame:
    """A grey wall that stands still, with every buffer."""
    flat = torch.full((1, 3, SIDE, SIDE), 0.5)
    still = torch.zeros(1, 2, SIDE, SIDE)
    return Frame(
        color=flat,
        depth=flat[:, :1] * 10,
        motion=still,
        motion_next=still,
        albedo=flat,
        normal=torch.tensor([0.0, 0.0, 1.0]).view(1, 3, 1, 1).expand_as(flat).contiguous(),
        roughness=flat[:, :1],
        metallic=flat[:, :1],
        object=torch.zeros(1, 1, SIDE, SIDE, dtype=torch.int32),
        jitter=torch.full((1, 2), 0.25),
        view=torch.eye(4)[None],
        projection=perspective(0.9, 1.0)[None],
        time=torch.tensor([time]),
        reset=torch.tensor([time == 0]),
        span=torch.tensor([2.0]),
    )


def table(costs: Sequence[Cost], width: int, height: int) -> Table:
    """The costs to print, operations of whole frames of this size in billions."""
    made = Table(caption=f"multiply-accumulates of one {width}x{height} frame, billions")
    for column in ("network", "parameters", "shaded", "generated"):
        made.add_column(column, justify="left" if column == "network" else "right")
    for c in costs:
        whole = [None if n is None else n * width * height / 1e9 for n in (c.shaded, c.generated)]
        made.add_row(c.method, f"{c.parameters:,}", *("" if n is None else f"{n:.1f}" for n in whole))
    return made
