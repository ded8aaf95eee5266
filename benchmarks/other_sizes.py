"""Clips whose references are 1.5 and 3 times the size, from a clip with references of twice the size.

    python benchmarks/other_sizes.py clips/harbor -o clips/other     # clips/other/harbor-1.5, clips/other/harbor-3

At 1.5 the frames stay as they are; at 3 every second sample of every second row stays, another one of the four in each
frame, as if rendered at half the size. References are averaged to three quarters.
"""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from tyro.conf import Positional, arg

from framecast.clip import Clip, ClipError, Layers, Record, finish, open_clip, write_frame
from framecast.methods.fasset import PLACES, smaller


def few(record: Record, layers: Layers, place: tuple[int, int]) -> tuple[Record, Layers]:
    """Of each 2 x 2 samples the one at `place` (x, y)."""
    x, y = place
    jitter = tuple((old + at - 0.5) / 2 for old, at in zip(record.jitter, place, strict=True))
    kept = {n: v[:, y::2, x::2] / (2 if n.startswith("motion") else 1) for n, v in layers.items()}
    return replace(record, jitter=(jitter[0], jitter[1])), {n: v.astype(layers[n].dtype) for n, v in kept.items()}


def written(clip: Clip, out: Path, scale: float) -> None:
    """The clip at another size."""
    for index, record in enumerate(clip.shown):
        reference = clip.reference(index)
        if reference is None:
            raise ClipError(f"frame {record.number} of {clip.path} has no reference; render the clip with --scale 2")
        layers = clip.checked(record)
        kept, some = few(record, layers, PLACES[index % 4]) if scale == 3 else (record, layers)
        large = np.ascontiguousarray(smaller(reference[None])[0, 0].numpy())
        write_frame(out, kept, {n: np.ascontiguousarray(v) for n, v in some.items()}, reference=large)
    finish(out, fps=clip.fps, span=clip.span, scale=scale, provenance={"made_from": clip.path.name})


def main(clips: Positional[tuple[Path, ...]], out: Annotated[Path, arg(aliases=["-o"])]) -> None:
    """Writes both clips of each.

    Args:
        clips: clips with references of twice the size.
        out: folder for the new ones.
    """
    for path in clips:
        clip = open_clip(path)
        if clip.scale != 2:
            raise ClipError(f"{path} has no references of twice its size; render it with --scale 2")
        for scale in (1.5, 3.0):
            written(clip, out / f"{path.name}-{scale:g}", scale)
            print(out / f"{path.name}-{scale:g}")


if __name__ == "__main__":
    tyro.cli(main)
