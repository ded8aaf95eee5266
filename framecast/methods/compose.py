"""Two methods one after the other: "a+b". What a makes of a frame is what b is given.

    extranet+nsrr   a makes frames at render size, b makes every frame larger
    nsrr+extranet   a makes shaded frames larger, b makes frames at that size

Paper:   none; the cascades that joint methods are compared with (Qin et al., FASSET, section 4.2).
Follows: nothing is known of either method but what `methods` lists.
Differs: Where a makes the frames, b remembers the shaded ones alone: others hold no samples of their own.
         An interpolated frame is made larger with what b knew at the shaded frame before it.
         Where a makes frames larger, b gets their buffers at that size (nearest sample, vectors in its pixels), and no
         jitter: the pixels of an image that was made lie on their centres.
Needs:   what both need
Modes:   those of the one that makes frames, and pass
State:   the states of both
"""

import warnings
from dataclasses import dataclass, replace
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn

from framecast.frame import BUFFERS, Frame
from framecast.methods.larger import Config, Unjittered
from framecast.methods.reproject import reaching
from framecast.resample import enlarged_motion, nearest_sample, size_at
from framecast.warp import pick

Method = Any
"""A module with the attributes that `methods` lists."""


@dataclass(frozen=True)
class State:
    """What both methods know."""

    first: Any
    second: Any
    before: Any
    """What the second one knew at the shaded frame before the last."""
    time: Float[Tensor, " b"]
    """Of the last shaded frame."""
    earlier: Float[Tensor, " b"]
    """Of the one before it; the same where there is none."""


torch.export.register_dataclass(State)


class Composed(nn.Module):
    """See the top of this file."""

    inner: tuple[str, ...] = ("first", "second")
    parts: tuple[str, ...] = ()
    step_motion: bool = False

    def __init__(self, first: Method, second: Method, name: str) -> None:
        """`name`: what the user calls both together.

        Raises:
            ValueError: the second cannot go on with what the first makes.
        """
        super().__init__()
        self.first, self.second, self.makes = first, second, generating(first)
        if self.makes and "pass" not in second.modes:
            raise ValueError(
                f"in {name!r} both methods make frames between or ahead of shaded ones; one of them has to make shaded "
                f"frames better or larger, as taa, bilinear or nsrr do"
            )
        modes = self.makes or generating(second)
        self.modes = (*modes, "pass")
        self.config = Config(scale_of(first) * scale_of(second))
        self.scales = (self.config.scale,)
        self.needs = tuple(dict.fromkeys((*first.needs, *second.needs)))
        buffers = tuple(field for field in second.needs if field != "color")
        asked = (*first.needs_generated, *buffers) if self.makes else second.needs_generated
        self.needs_generated = tuple(dict.fromkeys(asked)) if modes else ()
        known = None in (first.history, second.history)
        self.history = None if known else first.history + second.history

    def start(self, frame: Frame) -> State:
        """The state before the first frame, which is `frame`."""
        first = self.first.start(frame)
        image, _ = self.first(frame, first)
        second = self.second.start(self.between(frame, image))
        return State(first, second, second, frame.time, frame.time)

    def forward(self, frame: Frame, state: State) -> tuple[Float[Tensor, "b 3 H W"], State]:
        """The image that the second method makes."""
        if frame.color is None and not self.makes:
            image, second = self.finished(self.between(frame, None), state.second)
            return image, replace(state, second=second)
        image, first = self.first(frame, state.first)
        if frame.color is None:
            late = bool((frame.time >= state.time).all())
            known, time = (state.second, state.time) if late else (state.before, state.earlier)
            made, _ = self.finished(self.between(reaching(frame, time), image), known)
            return made, replace(state, first=first)
        made, second = self.finished(self.between(reaching(frame, state.time), image), state.second)
        return made, State(first, second, state.second, frame.time, state.time)

    def finished(self, frame: Frame, state: Any) -> tuple[Float[Tensor, "b 3 H W"], Any]:
        """What the second method makes; that images made larger by the first have no jitter is as it should be."""
        with warnings.catch_warnings():
            if not self.keeps_samples:
                warnings.simplefilter("ignore", Unjittered)
            made: tuple[Tensor, Any] = self.second(frame, state)
        return made

    @property
    def keeps_samples(self) -> bool:
        """Whether what the first method makes is of the size and on the samples of the frames."""
        return bool(self.makes) and scale_of(self.first) == 1

    def between(self, frame: Frame, image: Float[Tensor, "b 3 H W"] | None) -> Frame:
        """The frame that the second method gets: with this image, and where it was made larger, at its size."""
        if self.keeps_samples:
            return replace(frame, color=image)
        return enlarged(frame, image, scale_of(self.first))


def generating(method: Method) -> tuple[str, ...]:
    """The modes in which a method makes frames."""
    return tuple(mode for mode in method.modes if mode != "pass")


def scale_of(method: Method) -> float:
    """Output size divided by input size."""
    return float(getattr(getattr(method, "config", None), "scale", 1.0))


def enlarged(frame: Frame, image: Float[Tensor, "b 3 H W"] | None, scale: float) -> Frame:
    """The frame with this image and buffers at its size: nearest samples, vectors in its pixels, no jitter."""
    changes: dict[str, Tensor | None] = {"color": image, "jitter": torch.zeros_like(frame.jitter)}
    if frame.size is not None:
        size = size_at(frame.size, scale)
        nearest = nearest_sample(frame.size, size, frame.jitter)
        for name in BUFFERS:
            values = getattr(frame, name)
            if name.startswith("motion") and values is not None:
                changes[name] = enlarged_motion(values, size, frame.jitter)
            elif name != "color" and values is not None:
                changes[name] = pick(values, nearest)
    return replace(frame, **changes)  # type: ignore[arg-type]
