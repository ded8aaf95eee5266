"""What the networks of methods cost: numbers that training changes, and multiply-accumulates for one image."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from rich.table import Table
from torch import nn

from framecast.fit import method_named
from framecast.frame import Frame, moment, unshaded
from framecast.methods import METHODS, TRAINABLE
from framecast.nets import multiply_accumulates, parameters
from framecast.sample import scene

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
        state = method.start(scene(0.0, SIDE, SIDE))
        for time in (0.0, 2.0, 4.0):
            shaded = counted(method, scene(time, SIDE, SIDE), state)
            state = method(scene(time, SIDE, SIDE), state)[1]
        makes = [mode for mode in method.modes if mode != "pass"]
        at = 5.0 if "extrapolate" in makes else 3.0
        request = unshaded(scene(at, SIDE, SIDE)) if method.needs_generated else moment(at)
        return Cost(name, parameters(method), shaded, counted(method, request, state) if makes else None)


def counted(method: nn.Module, frame: Frame, state: Any) -> float:
    """Multiply-accumulates for one pixel of a frame."""
    return multiply_accumulates(method, lambda: method(frame, state)) / SIDE**2


def table(costs: Sequence[Cost], width: int, height: int) -> Table:
    """The costs to print, operations of whole frames of this size in billions."""
    made = Table(caption=f"multiply-accumulates of one {width}x{height} frame, billions")
    for column in ("network", "parameters", "shaded", "generated"):
        made.add_column(column, justify="left" if column == "network" else "right")
    for c in costs:
        whole = [None if n is None else n * width * height / 1e9 for n in (c.shaded, c.generated)]
        made.add_row(c.method, f"{c.parameters:,}", *("" if n is None else f"{n:.1f}" for n in whole))
    return made
