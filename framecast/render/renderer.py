"""Frames of a scene: every buffer of a clip's frame, references, and the masks that evaluation asks for.

Each is a pure function of scene, time, size and jitter; only scratch memory and finished shadow maps are kept between
calls.
"""

from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float

from framecast.color import to_display
from framecast.frame import SKY
from framecast.render import device
from framecast.render.canvas import Canvas, Jitter, Size
from framecast.render.lighting import Lighting
from framecast.render.scene import Scene
from framecast.render.sky import environment
from framecast.render.stage import STEPS, Stage
from framecast.render.view import View, view_of

Array = np.ndarray


class Renderer:
    """Draws one scene."""

    def __init__(self, scene: Scene) -> None:
        self.scene, self.stage = scene, Stage(scene)
        self.environment = environment(scene.sky)
        self.lights = Lighting(self.stage, 0)
        self.lights_before: Lighting | None = None
        self._canvases: dict[tuple[Size, int], Canvas] = {}
        self._lit_at: tuple[float, float] | None = None

    def views(self, time: float, size: Size) -> tuple[View, View, View, View]:
        """Cameras at the times of STEPS."""
        first, *others = (view_of(self.scene.camera, time + step, size[1] / size[0]) for step in STEPS)
        return first, others[0], others[1], others[2]

    def canvas(self, time: float, size: Size) -> Canvas:
        """A canvas aimed at `time`, lights and shadows drawn."""
        self.stage.move_to(time)
        view = view_of(self.scene.camera, time, size[1] / size[0])
        key = (time, size[1] / size[0])
        if key != self._lit_at:
            self.lights.update(time, view)
            self._lit_at = key
        canvas = self._canvases.get((size, 0))
        if canvas is None:
            canvas = self._canvases[size, 0] = Canvas(self.stage, size, self.lights, self.environment)
        canvas.aim(time, view)
        return canvas

    def canvas_before(self, time: float, size: Size) -> Canvas:
        """The same for `time - 1`, while the stage stays at `time`."""
        self.stage.move_to(time)
        if self.lights_before is None:
            self.lights_before = Lighting(self.stage, 1)
        view = view_of(self.scene.camera, time - 1, size[1] / size[0])
        self.lights_before.update(time - 1, view)
        canvas = self._canvases.get((size, 1))
        if canvas is None:
            canvas = self._canvases[size, 1] = Canvas(self.stage, size, self.lights_before, self.environment)
        canvas.aim(time - 1, view)
        return canvas

    def frame(self, time: float, size: Size, jitter: Jitter = (0.0, 0.0), lod_bias: float = 0.0) -> dict[str, Array]:
        """All layers of a frame as `c h w` arrays under the names of `Frame`, and `motion2`.

        Size is (height, width). Jitter is sample minus pixel centre, pixels, y down. `lod_bias` sharpens textures when
        negative: log2(render size / display size).
        """
        canvas = self.canvas(time, size)
        canvas.draw(jitter, lod_bias)
        vectors = canvas.draw_vectors(self.views(time, size), jitter)
        return {
            **surfaces(canvas),
            **{name: planes(vectors.targets[name]) for name in ("motion", "motion2", "motion_next")},
        }


def planes(texture: object) -> Float[Array, "c h w"]:
    """A texture as float32 planes."""
    return np.ascontiguousarray(device.read(texture).transpose(2, 0, 1), dtype=np.float32)


def surfaces(canvas: Canvas) -> dict[str, Array]:
    """Everything but motion of the picture just drawn."""
    albedo, normal = planes(canvas.targets["albedo"]), planes(canvas.targets["normal"])
    length = np.linalg.norm(normal[:3], axis=0, keepdims=True)
    return {
        "color": planes(canvas.lit)[:3],
        "depth": depth(canvas),
        "albedo": albedo[:3],
        "normal": normal[:3] / np.maximum(length, 1e-6),
        "roughness": albedo[3:],
        "metallic": normal[3:],
        "object": device.read(canvas.targets["object"]).transpose(2, 0, 1) & 0xFFFF,
    }


def depth(canvas: Canvas) -> Float[Array, "1 h w"]:
    """View depth in scene units, SKY where nothing was hit."""
    stored = planes(canvas.depth)
    return np.where(stored > 0, np.minimum(canvas.view.near / np.maximum(stored, 1e-30), SKY), SKY).astype(np.float32)


class Changes(NamedTuple):
    """What changed from one frame ago to a frame, at the size of its reference. All pixel centres, no jitter."""

    motion: Float[Array, "2 h w"]
    """Exact motion of this resolution, as in `Frame`."""
    disoccluded: Bool[Array, "1 h w"]
    """The surface was hidden or off screen one frame ago."""
    shading: Float[Array, "1 h w"]
    """How much the *same surface point* changed its displayed colour, 0..1: shadows, highlights, reflections move."""


def changes(renderer: Renderer, time: float, size: Size) -> Changes:
    """Compares the visible surface points with what they were, shaded exactly, one frame ago.

    Each point is shaded twice: as it is, and as it was, with that time's lights, shadows, mirrors and camera. Nothing
    is resampled, so a still, diffuse scene gives exactly 0. Both are shown with the exposure of `time`.
    """
    before = renderer.canvas_before(time, size)
    before.draw((0.0, 0.0), 0.0)
    canvas = renderer.canvas(time, size)
    canvas.draw((0.0, 0.0), 0.0)
    vectors = canvas.draw_vectors(renderer.views(time, size), (0.0, 0.0))
    now, then = (torch.from_numpy(planes(lit)[:3].copy()) for lit in (canvas.lit, vectors.relight(before)))
    gain = renderer.scene.exposure(time) / max(renderer.scene.exposure(time - 1), 1e-9)
    shading = (to_display(now) - to_display(then * gain)).abs().amax(0, keepdim=True).numpy()
    motion, was = planes(vectors.targets["motion"]), planes(vectors.targets["depth_before"])
    hidden = disoccluded(motion, was, depth(before))
    return Changes(motion, hidden, np.where(hidden, 0, shading).astype(np.float32))


def disoccluded(
    motion: Float[Array, "2 h w"], was: Float[Array, "1 h w"], before: Float[Array, "1 h w"]
) -> Bool[Array, "1 h w"]:
    """Whether a surface point was hidden one frame ago.

    `was` is the point's depth then, `before` the depth buffer of then. A point counts as seen if one of the four pixels
    around its earlier place is no nearer than itself, less 2 %. Off screen counts as hidden.
    """
    height, width = motion.shape[1:]
    y, x = np.mgrid[0:height, 0:width] + 0.5
    x, y = x + motion[0], y + motion[1]
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    left, top = np.floor(x - 0.5).astype(int), np.floor(y - 0.5).astype(int)
    corners = [
        before[0, np.clip(top + j, 0, height - 1), np.clip(left + i, 0, width - 1)] for j in (0, 1) for i in (0, 1)
    ]
    return (~inside | (was[0] * 0.98 > np.max(corners, 0)))[None]
