"""References: what a display should have shown, as the mean of many jittered pictures; and what varies inside a pixel.

A reference is rendered at display size N times with sample offsets from the Halton(2, 3) sequence, and averaged over
each pixel with equal weights (a box filter one display pixel wide). The mean is taken of c / (1 + max(r, g, b)) and
taken back afterwards, so that edges of bright highlights come out smooth under any display transform; where a pixel is
uniform this is exactly the mean of radiance. Texture level of detail is that of the display resolution; seen at a
slant, textures are resolved by the samples instead of by anisotropic look-ups.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from framecast.frame import SKY
from framecast.render import device, passes
from framecast.render.canvas import Canvas, Size
from framecast.render.renderer import Renderer
from framecast.resample import jitter

Array = np.ndarray

RANGES = (
    *(f"color_{end}.{c}" for end in ("min", "max") for c in "RGB"),
    "depth_min.Z",
    "depth_max.Z",
    "normal_spread.Y",
    "geometric_spread.Y",
)
"""Channels of a range file. The spreads are the largest sum of absolute differences between the normal of any sample
of the pixel and that of its first one (0..6), normal-mapped and not."""
_KEPT = 14
"""Numbers a pixel in ranges.wgsl: RANGES, then the first sample's two normals."""


class Reference(NamedTuple):
    """One frame as a display should show it."""

    color: Float[Array, "3 h w"]
    """Linear, times exposure."""
    ranges: Float[Array, "10 h w"] | None
    """In the order of RANGES."""


def reference(renderer: Renderer, time: float, size: Size, samples: int = 64, *, ranges: bool = False) -> Reference:
    """Renders the reference of a moment at display size (height, width)."""
    canvas = renderer.canvas(time, size)
    height, width = size
    sums = device.buffer(np.zeros((height, width, 4), np.float32), "STORAGE|COPY_SRC")
    found = device.buffer(np.zeros((height, width, _KEPT), np.float32), "STORAGE|COPY_SRC") if ranges else None
    settings = device.buffer(np.zeros(4, np.uint32), "UNIFORM|COPY_DST")
    groups = {"gather": device.bind(passes.layout("gather"), settings, sums, canvas.lit)}
    if found is not None:
        normals = canvas.targets["normal"], canvas.targets["geometric"]
        groups["ranges"] = device.bind(passes.layout("ranges"), settings, found, canvas.lit, *normals)
    for index in range(samples):
        canvas.draw(jitter(index, samples), 0.0, one_of_many=samples > 1)
        device.write(settings, np.array([width, height, index, 0], np.uint32))
        _gather(groups, canvas)
    mean = device.read_floats(sums, (height, width, 4))[..., :3].transpose(2, 0, 1) / samples
    color = mean / np.maximum(1 - mean.max(0, keepdims=True), 1 / SKY)
    spread = None if found is None else device.read_floats(found, (height, width, _KEPT))[..., : len(RANGES)]
    return Reference(color.astype(np.float32), None if spread is None else spread.transpose(2, 0, 1).copy())


def _gather(groups: dict, canvas: Canvas) -> None:
    height, width = canvas.size
    encoder = device.open_device().create_command_encoder()
    run = encoder.begin_compute_pass()
    for name, group in groups.items():
        run.set_pipeline(passes.compute(name))
        run.set_bind_group(0, group)
        run.dispatch_workgroups(-(-width // 16), -(-height // 8))
    run.end()
    device.open_device().queue.submit([encoder.finish()])
