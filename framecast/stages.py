"""Where the time of a method goes: a stopwatch in each of its stages, while it runs as it always does."""

import copy
import time as clock
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FunctionType, MethodType
from typing import Any

import torch
from torch import nn


def wait(device: torch.device) -> None:
    """Returns when the device has done what it was given."""
    if device.type != "cpu":
        getattr(torch, device.type).synchronize()


class Stopwatch:
    """Time spent in functions that may call each other; each has only what it spends itself."""

    def __init__(self, device: str) -> None:
        self.device = torch.device(device)
        self.spent: dict[str, float] = {}
        self.open: list[str] = []
        self.since = 0.0

    def switch(self, to: str | None) -> None:
        """What is open gets the time since the last switch; `to` is opened, None closes the last."""
        wait(self.device)
        now = clock.perf_counter()
        if self.open:
            self.spent[self.open[-1]] = self.spent.get(self.open[-1], 0.0) + (now - self.since) * 1e3
        if to is None:
            self.open.pop()
        else:
            self.open.append(to)
        self.since = clock.perf_counter()

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """The time inside belongs to a stage, which a profile shows by its name."""
        self.switch(name)
        try:
            with torch.profiler.record_function(name):
                yield
        finally:
            self.switch(None)


def stages_of(call: nn.Module, fast: bool) -> tuple[str, ...]:
    """What a method consists of: its compiled parts, or eager every function that its class names for others."""
    if fast:
        return tuple(getattr(call, "parts", ("forward",)))
    classes = type(call).__mro__[: type(call).__mro__.index(nn.Module)]
    found = [name for one in classes for name, value in vars(one).items() if isinstance(value, FunctionType)]
    return tuple(name for name in dict.fromkeys(found) if not name.startswith("_") and name not in ("start", "forward"))


def staged(method: nn.Module, fast: bool, watch: Stopwatch) -> nn.Module:
    """The method, compiled or not, with the stopwatch in every stage."""
    call = copy.copy(method)

    def watched(name: str) -> Callable[..., Any]:
        # Eager functions get the copy as `self`, so that what they call is watched too; compiled ones are whole.
        run = getattr(method, name) if fast else MethodType(getattr(type(method), name), call)

        def timed_run(*arguments: Any, **named: Any) -> Any:
            with watch.stage(name):
                return run(*arguments, **named)

        return timed_run

    for name in stages_of(method, fast):
        object.__setattr__(call, name, watched(name))
    return call
