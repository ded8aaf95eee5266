"""How a method is trained: the part of training that belongs to the method, written in its file."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from torch import Tensor

from framecast.frame import Frame

Loss = Callable[[Any, Sequence[Frame], Tensor], dict[str, Tensor]]
"""(method, frames in arrival order, truth of the last ones `b n 3 H W`, or 5 with `Recipe.labels`) -> terms of the
loss by name, scalars; their sum is minimised."""


@dataclass(frozen=True)
class Recipe:
    """Loss, samples, optimiser and schedule; the defaults are ExtraNet's where it says."""

    loss: Loss
    mode: Literal["extrapolate", "interpolate", "alternate", "pass"] = "extrapolate"
    """What a sample is: every second frame of the clip shaded, and one to generate after the last (extrapolate), before
    it (interpolate) or after each of them (alternate); or consecutive frames, all shaded (pass)."""
    shaded: int = 3
    """Shaded frames of a sample."""
    truths: int = 1
    """Frames of a sample, the last ones, whose truth the loss gets."""
    labels: bool = False
    """Whether the true classes of its pixels (see `labels.py`) follow the colour of each truth, as two channels."""
    crop: tuple[int, int] = (256, 256)
    """Height and width of a sample, pixels; smaller where the clip is smaller."""
    batch: int = 8
    """Samples of a step, over all processes."""
    steps: int = 50_000
    rate: float = 1e-3
    """Learning rate of Adam at its highest, after the warm-up."""
    betas: tuple[float, float] = (0.9, 0.999)
    warmup: int = 200
    """Steps over which the rate rises from 0."""
    floor: float = 1e-6
    """Learning rate at the last step, reached along a cosine."""
    settle: float = 0.6
    """Part of the steps after which normalisation uses the statistics it has gathered, as it does after training:
    those of single small batches are noise to which a network must not get used."""
    clip_norm: float = 1.0
    """Largest norm of the gradient; longer ones are shortened to it."""
    stops: float = 1.0
    """Samples are brightened and darkened at random by up to this many factors of two."""
    recolour: bool = True
    """Samples have their colour channels exchanged and tinted by up to half a factor of two, and their world turned, at
    random: a few scenes have few colours, and one sun each."""
