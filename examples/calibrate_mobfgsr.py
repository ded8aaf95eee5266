"""Calibrate the constants of Mob-FGSR on clips with references, by gradient, as section 4 of its paper says.

    python examples/calibrate_mobfgsr.py CLIP CLIP ...

a and b of Eq. 2 (`Config.blend`, `Config.falloff`) are learned on runs of shaded frames made larger, T_D and T_B of
Eq. 1 (`Config.depth_threshold`, `Config.brightness_threshold`) on frames interpolated between those. Conditions have no
gradient: they are taken as soft ones, a fifth of the threshold wide. Prints the values as they go.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
import tyro
from jaxtyping import Float
from torch import Tensor
from tyro.conf import Positional

from framecast.clip import Clip, open_clip
from framecast.color import luminance, to_display, untonemap
from framecast.frame import Frame
from framecast.methods.mobfgsr import Config, MobFGSR, enlarged, interpolate
from framecast.resample import nearest_sample
from framecast.warp import fetch, pick

PAPER = {"a": 0.34, "b": 0.81, "T_D": 0.0028, "T_B": 0.13}
RUN = 6
"""Shaded frames of a sample."""


@dataclass(frozen=True)
class Sample:
    """A part of a clip."""

    frames: list[Frame]
    references: list[Float[Tensor, "1 3 H W"]]
    """Of the frames, as displayed."""


def cut(frames: Sequence[Frame], references: Sequence[Tensor], crop: int) -> Sample:
    """A random run, from an even frame on, and place."""
    first = 2 * int(torch.randint((len(frames) - RUN) // 2 + 1, ()))
    assert frames[0].color is not None
    height, width = frames[0].color.shape[-2:]
    y, x = (int(torch.randint(max(side - crop, 0) + 1, ())) for side in (height, width))

    def part(image: Tensor | None, factor: int = 1) -> Any:
        here = (..., slice(y * factor, (y + crop) * factor), slice(x * factor, (x + crop) * factor))
        return None if image is None else image[here].contiguous()

    bare: dict[str, Any] = dict.fromkeys(("albedo", "normal", "roughness", "metallic", "object", "view", "projection"))
    names = ("color", "depth", "motion", "motion_next")
    run = range(first, first + RUN)
    cropped = [replace(frames[i], **bare, **{name: part(getattr(frames[i], name)) for name in names}) for i in run]
    cropped[0] = replace(cropped[0], reset=torch.tensor([True]))
    return Sample(cropped, [part(references[i], 2) for i in run])


def larger_error(sample: Sample, a: Tensor, b: Tensor) -> Tensor:
    """Mean squared error of the second half of the run made twice as large."""
    method = MobFGSR(Config(scale=2.0, blend=a, falloff=b))  # type: ignore[arg-type]
    state, errors = method.start(sample.frames[0]), []
    for frame, truth in zip(sample.frames, sample.references, strict=True):
        image, state = method(frame, state)
        errors.append((to_display(image) - truth).square().mean())
    return torch.stack(errors[RUN // 2 :]).mean()


def between_error(sample: Sample, depth: Tensor, brightness: Tensor) -> Tensor:
    """Mean squared error of the frame between the last two shaded ones, Eq. 1 with soft conditions."""
    config = Config(scale=2.0)
    method = MobFGSR(config)
    with torch.no_grad():
        state: Any = method.start(sample.frames[0])
        for frame in sample.frames[::2]:
            _, state = method(frame, state)
        time = (state.pair.prev.time + state.pair.current.time) / 2
        small = interpolate(state.pair, time, config)
        size = (state.image.shape[-2], state.image.shape[-1])
        index = nearest_sample((small.weight.shape[-2], small.weight.shape[-1]), size, torch.zeros(1, 2))
        large = enlarged(small, state.image)
        images = method.read(state.before, large.to_previous), method.read(state.image, large.to_current)
        depths = fetch(state.pair.prev.depth, small.to_previous), fetch(state.pair.current.depth, small.to_current)
        apart = pick((depths[0] / depths[1]).log(), index)
        change = (luminance(to_display(untonemap(images[1]))) - luminance(to_display(untonemap(images[0])))).abs()
    before, after = (torch.sigmoid((side - depth) / (0.2 * depth)) for side in (apart, -apart))
    alike = torch.sigmoid((brightness - change) / (0.2 * brightness))
    weight = after + (1 - after - before) * 0.5 * (1 - alike)  # alike: the one of two equally near frames is the first
    image = images[0] + weight * (images[1] - images[0])
    return (to_display(untonemap(image)) - sample.references[2 * ((RUN - 1) // 2) - 1]).square().mean()


def calibrate(
    clips: Sequence[tuple[Sequence[Frame], Sequence[Tensor]]],
    halved: Sequence[tuple[Sequence[Frame], Sequence[Tensor]]],
    steps: int,
    crop: int,
    seed: int,
) -> dict[str, float]:
    """The four constants after `steps` of Adam each, from the paper's values on.

    Args:
        clips: frames and displayed references, every frame shaded.
        halved: the same, of which every second frame is shaded and its motion leads over the gap.
    """
    torch.manual_seed(seed)
    logs = {name: torch.tensor(value).log().requires_grad_() for name, value in PAPER.items()}
    optimiser = torch.optim.Adam(logs.values(), 0.03)
    for step in range(steps):
        value = {name: log.exp() for name, log in logs.items()}
        one, two = (source[int(torch.randint(len(source), ()))] for source in (clips, halved))
        error = larger_error(cut(*one, crop), value["a"], value["b"])
        error = error + between_error(cut(*two, crop), value["T_D"], value["T_B"])
        optimiser.zero_grad()
        error.backward()
        optimiser.step()
        if step % 20 == 19:
            print(
                f"step {step + 1}: " + ", ".join(f"{n} {float(log.exp()):.4f}" for n, log in logs.items()), flush=True
            )
    return {name: float(log.exp()) for name, log in logs.items()}


def shaded(clip: Clip) -> tuple[list[Frame], list[Tensor]]:
    """Frames and references as displayed; those of a half-rate view keep the places of the frames left out."""
    references = [clip.reference(i) for i in range(len(clip))]
    return [clip[i] for i in range(len(clip))], [to_display(r) for r in references if r is not None]


def main(clips: Positional[tuple[Path, ...]], steps: int = 200, crop: int = 64, seed: int = 0) -> None:
    """Calibrate on clips.

    Args:
        clips: clips with references of twice the size of their frames.
        steps: steps of Adam.
        crop: side of a sample, pixels of the frames.
        seed: of the choice of samples.
    """
    whole, halved = [], []
    for path in clips:
        clip = open_clip(path)
        frames, references = shaded(clip)
        view = clip.every(2)
        gaps = [view[i // 2] for i in range(len(clip))]
        whole.append((frames, references))
        halved.append((gaps, references))
    found = calibrate(whole, halved, steps, crop, seed)
    print(", ".join(f"{name} {value:.4f} (the paper: {PAPER[name]:g})" for name, value in found.items()))


if __name__ == "__main__":
    tyro.cli(main)
