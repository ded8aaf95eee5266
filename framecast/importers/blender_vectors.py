"""Does a shot's Vector pass hold what Blender should have written? Two ways in which it does not, found by looking."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from framecast.clip import Layers, Record
from framecast.exr import ClipError
from framecast.frame import SKY


def check_vectors(folder: Path, records: Sequence[Record], read: Callable[[Record], Layers], first: Layers) -> None:
    """Refuse vectors that are all 0 while things move, and those of Blender 5 under a moving orthographic camera.

    Reads one frame, and only where it has nothing but zeros although something moved, the others. Both frames that are
    compared lie before the first cut, across which everything changes and nothing moves.

    Args:
        read: pixels of a frame as Blender left them, in our convention. first: those of the first frame.

    Raises:
        ClipError: with what to change in Blender.
    """
    before_cut = next((i for i, record in enumerate(records) if i and record.cut), len(records))
    if before_cut < 2:
        return
    pair = [first, read(records[before_cut // 2])]
    if all(_reversing(layers) for layers in pair):
        raise ClipError(
            f"{folder}: the vectors zoom, to the frame before and to the one after alike, as Blender 5 wrongly writes "
            f"them for an orthographic camera that moves; use a perspective camera with a long lens, or Blender 3"
        )
    if any(layers["motion"].any() for layers in pair) or not _moved(*pair):
        return
    if not any(read(record)["motion"].any() for record in records):
        raise ClipError(
            f"{folder}: every vector is 0 although the picture moves; Blender writes no vectors while Motion Blur is "
            f"on: switch it off (Render properties > Motion Blur) and render again"
        )


def _moved(a: Layers, b: Layers) -> bool:
    """Whether a frame shows other geometry (other colours where there is no depth) than another one.

    Something moved where a value of `b` lies beyond all values of `a` in a 3 x 3 neighbourhood, so that sampling noise
    and changing light do not count.
    """
    if "depth" in a:
        before, after, margin = a["depth"][0], b["depth"][0], 0.01
    else:
        before, after, margin = _blocks(a["color"]), _blocks(b["color"]), 0.05
    near = np.lib.stride_tricks.sliding_window_view(np.pad(before, 1, mode="edge"), (3, 3))
    beyond = (after < near.min((2, 3)) * (1 - margin)) | (after > near.max((2, 3)) * (1 + margin))
    return float(beyond.mean()) > 0.003


def _blocks(color: np.ndarray) -> np.ndarray:
    """Mean of colour over 4 x 4 pixels, one channel; partial blocks at the right and bottom read darker."""
    gray = color.astype(np.float32).mean(0)
    return np.add.reduceat(np.add.reduceat(gray, range(0, gray.shape[0], 4), 0), range(0, gray.shape[1], 4), 1) / 16


def _reversing(layers: Layers) -> bool:
    """Whether the picture seems to zoom the same way to both neighbours, everywhere: no camera moves like that."""
    solid = layers["depth"][0] < SKY if "depth" in layers else np.ones(layers["motion"].shape[1:], bool)
    if "motion_next" not in layers or solid.sum() < 64:
        return False
    column = np.nonzero(solid)[1]
    slopes = []
    for name in ("motion", "motion_next"):
        x = layers[name][0][solid]
        if not np.isfinite(x).all() or x.std() < 0.5 or abs(np.corrcoef(column, x)[0, 1]) < 0.8:
            return False
        slopes.append(np.polyfit(column, x, 1)[0])
    return bool(slopes[0] * slopes[1] > 0)
