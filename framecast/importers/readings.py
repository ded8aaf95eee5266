"""Which reading of the vectors fits the pictures, where a format leaves it open."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from framecast.clip import Layers
from framecast.color import encode_log
from framecast.importers.folder import Found, scan
from framecast.importers.settings import Motion
from framecast.warp import inside, warp

CLEAR = 0.9
"""A reading is taken when it leaves at most this part of the error of the documented one."""

PAIRS = 3
"""Pairs of frames that are compared."""


def fitting(folder: Path, found: Found) -> Found:
    """The reading with the least difference between each frame and the one before, warped by the vectors.

    The first reading stays where no other one is clearly better; a note says which was taken, and how sure that is.
    """
    if found.settings.color is None or found.settings.motion is None or not found.readings:
        return found
    readings = (found.settings.motion, *found.readings)
    errors = _errors(folder, found, readings)
    best = int(np.argmin(errors))
    if errors[best] > CLEAR * errors[0]:
        best = 0
    others = sorted(error for i, error in enumerate(errors) if i != best)
    said = f"vectors were read as {worded(readings[best])}"
    sure = (
        f"which fits the pictures {others[0] / max(errors[best], 1e-9):.1f} times better than any other reading"
        if others[0] > errors[best] / CLEAR
        else "which the pictures do not confirm (little moves); let framecast doctor look at a longer shot"
    )
    settings = replace(found.settings, motion=readings[best], notes=(*found.settings.notes, f"{said}, {sure}"))
    return Found(settings, found.poses)


def _errors(folder: Path, found: Found, readings: Sequence[Motion]) -> list[float]:
    """Mean difference of log colour over a few pairs of neighbours, for each reading."""
    only = dict.fromkeys(("albedo", "normal", "roughness", "metallic", "object", "motion_next"))
    settings = replace(found.settings, **only)  # type: ignore[arg-type]
    dump = scan(folder, settings, found.poses)
    whole = [index for index in range(1, len(dump.records)) if not dump.records[index].cut]
    indices = sorted({whole[place] for place in np.linspace(0, len(whole) - 1, PAIRS).astype(int)} if whole else ())
    sums = np.zeros(len(readings))
    for index in indices:
        record, earlier = dump.records[index], dump.records[index - 1]
        stored, before = dump.stored(record), _light(dump.decoded(dump.stored(earlier), earlier))
        for k, motion in enumerate(readings):
            fields = dump.decoded(stored, record, replace(settings, motion=motion))
            sums[k] += _difference(_light(fields), before, torch.from_numpy(fields["motion"])[None])
    return [float(error) for error in sums / max(len(indices), 1)]


def _light(fields: Layers) -> Float[Tensor, "1 3 h w"]:
    return encode_log(torch.from_numpy(np.ascontiguousarray(fields["color"], np.float32))[None])


def _difference(
    here: Float[Tensor, "1 3 h w"], before: Float[Tensor, "1 3 h w"], motion: Float[Tensor, "1 2 h w"]
) -> float:
    """Mean absolute difference where the vectors stay inside; infinite where most leave, or a pixel is NaN."""
    known = inside(motion)
    left = (warp(before, motion) - here).abs().mean(1, keepdim=True)[known]
    return float(left.mean()) if len(left) > known.numel() / 2 and bool(left.isfinite().all()) else float("inf")


def worded(motion: Motion) -> str:
    """A reading in a few words."""
    right, down = ("right" if motion.sign[0] > 0 else "left"), ("down" if motion.sign[1] > 0 else "up")
    root = ", square roots" if motion.packing == "unreal_sqrt" else ""
    return f"{motion.direction}, positive {right} and {down}, times {motion.scale[0]:g} {motion.units}{root}"
