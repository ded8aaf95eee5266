"""ColorVideoVDP (Mantiuk et al. 2024) judges a film as a viewer would: an extra, imported where it is asked for."""

import importlib.util

import torch
from jaxtyping import Float
from torch import Tensor

NAME = "cvvdp"
"""Of the metric in rows: quality in JOD, 10 where no difference is seen; higher is better."""

DISPLAY = "standard_4k"
"""The viewing condition: a 30 inch 4K display of 200 cd/m2, seen from 0.75 m."""


def video_missing() -> str | None:
    """One sentence on how to install what is missing; None where the metric can run."""
    if importlib.util.find_spec("pycvvdp") is not None:
        return None
    return "cvvdp is left out: ColorVideoVDP is not installed; install it with: pip install 'framecast[video-quality]'"


class Film:
    """Images as displayed and what they should be, kept as half floats until all are there."""

    def __init__(self, fps: float) -> None:
        self.fps = fps
        self.images: list[Tensor] = []
        self.targets: list[Tensor] = []
        self.numbers: list[int] = []

    def add(self, number: int, image: Float[Tensor, "1 3 H W"], target: Float[Tensor, "1 3 H W"] | None) -> None:
        """The next image, of a frame of the clip; one without a truth is left out."""
        if target is not None:
            self.numbers.append(number)
            self.images.append(image[0].half().cpu())
            self.targets.append(target[0].half().cpu())

    @property
    def rate(self) -> float:
        """Images a second: fewer than the clip has where frames were left out."""
        if len(self.numbers) < 2:
            return self.fps
        return self.fps * (len(self.numbers) - 1) / (max(self.numbers) - min(self.numbers))

    def quality(self, device: str = "cpu") -> float:
        """JOD of the film."""
        import pycvvdp

        metric = pycvvdp.cvvdp(display_name=DISPLAY, device=torch.device(device), quiet=True)
        films = (torch.stack(film).float() for film in (self.images, self.targets))
        return float(metric.predict(*films, dim_order="FCHW", frames_per_second=self.rate)[0])
