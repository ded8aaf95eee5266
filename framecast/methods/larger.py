"""What every method that makes shaded frames larger asks of them, said before it meets a shape it cannot explain."""

import warnings
from dataclasses import dataclass

import torch
from torch import Tensor

from framecast.frame import Frame
from framecast.resample import size_at


@dataclass(frozen=True)
class Config:
    """The size."""

    scale: float = 2.0
    """Output size divided by input size."""


SAME, TWICE = Config(scale=1.0), Config()


def require(frame: Frame, name: str, needs: tuple[str, ...]) -> None:
    """Raises ValueError where `frame` has no colour or lacks buffers, or where they are not all of one size."""
    lacking = [field for field in needs if getattr(frame, field) is None]
    if lacking:
        raise ValueError(
            f"{name} makes shaded frames larger and needs their {' and '.join(needs)}; the frame at time "
            f"{float(frame.time[0]):g} has no {' and no '.join(lacking)}"
        )
    sizes = {field: tuple(getattr(frame, field).shape[-2:]) for field in needs}
    odd = next((field for field in needs if sizes[field] != sizes["color"]), None)
    if odd is not None:
        (height, width), (tall, wide) = sizes["color"], sizes[odd]
        raise ValueError(
            f"{odd} has {wide}x{tall} pixels and color {width}x{height}; {name} needs all buffers at the size of the "
            f"colour: write {odd} at render size, in pixels of that size"
        )


def warn_of_stillness(before: Tensor, now: Tensor, name: str) -> None:
    """Warns where neither of two frames after one another was jittered."""
    if not bool(before.any() | now.any()):
        warnings.warn(
            f"these frames are not jittered, so every one of them samples a still scene at the same places, and {name} "
            f"cannot show more than one frame holds; render with jitter (Halton (2, 3), see framecast.resample), or "
            f"import the clip again with the jitter it was rendered with",
            stacklevel=3,
        )


def output_size(frame: Frame, scale: float) -> tuple[int, int]:
    """Height and width of the image made from a shaded frame."""
    assert frame.color is not None
    return size_at((frame.color.shape[-2], frame.color.shape[-1]), scale)


def where(choose: Tensor, a: Tensor, b: Tensor) -> Tensor:
    """Of each batch entry `a` where chosen, else `b`."""
    return torch.where(choose.view(-1, *[1] * (a.ndim - 1)), a, b)
