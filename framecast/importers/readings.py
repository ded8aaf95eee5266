"""Which reading of the vectors fits the pictures, where a format leaves it open."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from torch import Tensor

from framecast.clip import Clip
from framecast.color import encode_log
from framecast.importers.folder import Found, open_folder
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
    errors = [_error(open_folder(folder, replace(found.settings, motion=motion), found.poses)) for motion in readings]
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


def worded(motion: Motion) -> str:
    """A reading in a few words."""
    right, down = ("right" if motion.sign[0] > 0 else "left"), ("down" if motion.sign[1] > 0 else "up")
    root = ", square roots" if motion.packing == "unreal_sqrt" else ""
    return f"{motion.direction}, positive {right} and {down}, times {motion.scale[0]:g} {motion.units}{root}"


def _error(clip: Clip) -> float:
    """Mean absolute difference of log colour over a few pairs of neighbours; infinite where nothing can be compared."""
    indices = np.unique(np.linspace(1, len(clip) - 1, PAIRS).astype(int))
    return float(np.mean([_difference(clip, int(index)) for index in indices]))


def _difference(clip: Clip, index: int) -> float:
    here, before = clip[index], clip[index - 1]
    if here.color is None or before.color is None or here.motion is None or bool(here.reset[0]):
        return float("inf")
    warped = warp(encode_log(before.color), here.motion)
    left: Tensor = (warped - encode_log(here.color)).abs().mean(1, keepdim=True)
    known = inside(here.motion)
    return float(left[known].mean()) if known.float().mean() > 0.5 else float("inf")
