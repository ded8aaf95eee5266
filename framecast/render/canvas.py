"""One picture of a stage: its buffers, and the passes that fill them."""

from typing import Any

import numpy as np

from framecast.render import device, lighting, passes
from framecast.render.lighting import Lighting
from framecast.render.sky import Environment
from framecast.render.stage import Draw, Stage
from framecast.render.view import View, mirrored, pack, sky_turn

Array = np.ndarray
Size = tuple[int, int]
Jitter = tuple[float, float]


class Canvas:
    """Targets of one size (height, width) for pictures of a stage in one lighting.

    `lit` holds radiance times exposure and, in alpha, view depth. Mirrors are canvases of their own, whose lit pictures
    are the layers of `reflections`.
    """

    def __init__(self, stage: Stage, size: Size, light: Lighting, environment: Environment, *, lit: Any = None) -> None:
        self.stage, self.size, self.light = stage, size, light
        self.targets = {name: device.target(size, form) for name, form in passes.FORMATS.items()}
        self.depth = device.target(size, passes.DEPTH)
        self.occlusion = device.target(size, passes.OCCLUSION)
        mirrors = stage.scene.mirrors if lit is None else ()
        self.lit: Any = None
        self._lit_view = lit
        if lit is None:
            self.lit = device.target(size, passes.LIT)
            self._lit_view = self.lit.create_view()
        self.reflections = device.target(size if mirrors else (1, 1), passes.LIT, layers=max(len(mirrors), 1))
        behind = [device.layer(self.reflections, k) for k in range(len(mirrors))]
        self.mirrors = [Canvas(stage, size, light, environment, lit=view) for view in behind]
        self.view_buffer = device.buffer(np.zeros(12, np.float32), "UNIFORM|COPY_DST")
        self.frame_buffer = device.buffer(np.zeros(28, np.float32), "UNIFORM|COPY_DST")
        self.instances = device.buffer(stage.instances(0.0, _SOME_VIEW), "STORAGE|COPY_DST")
        self.groups = self._groups(environment)
        self.vectors: Vectors | None = None
        self.one_of_many = False

    def _groups(self, environment: Environment) -> dict[str, Any]:
        surface = [self.targets[name] for name in passes.FORMATS]
        return {
            "view": device.bind(passes.layout("view"), self.view_buffer, self.instances),
            "occlusion": device.bind(passes.layout("occlusion"), self.depth, self.targets["geometric"]),
            "now": device.bind(passes.layout("now"), *surface, self.depth, self.occlusion),
            "nothing": device.bind(passes.layout("nothing")),
            "lighting": lighting.bind(self.light, environment, self.frame_buffer, self.reflections),
        }

    def aim(self, time: float, view: View) -> None:
        """Takes the next pictures at `time` from `view`."""
        self.time, self.view = time, view
        self.draws = self.stage.seen(time, view.clip)
        device.write(self.instances, self.stage.instances(time, view))
        for canvas, mirror in zip(self.mirrors, self.stage.scene.mirrors, strict=False):  # mirrors show no mirrors
            canvas.aim(time, mirrored(view, mirror))

    def draw(self, jitter: Jitter, lod_bias: float, *, one_of_many: bool = False) -> None:
        """Draws and lights one picture. `one_of_many`: it will be averaged with many others of different jitter."""
        for canvas in self.mirrors:
            canvas.draw(jitter, lod_bias, one_of_many=one_of_many)
        self.one_of_many = one_of_many
        exposure = self.stage.scene.exposure(self.time)
        device.write(self.view_buffer, pack(self.view, jitter, self.size, lod_bias, 3.0 if one_of_many else 0.0))
        frame = lighting.pack(self.stage, self.view, self.size, jitter, exposure, len(self.mirrors))
        device.write(self.frame_buffer, frame)
        encoder = device.open_device().create_command_encoder()
        self._draw_surfaces(encoder)
        self._fill(encoder, passes.occlusion(), "occlusion", self.occlusion.create_view())
        self._fill(encoder, passes.light("now"), "now", self._lit_view)
        self._draw_glass(encoder)
        device.open_device().queue.submit([encoder.finish()])

    def _draw_surfaces(self, encoder: Any) -> None:
        run = encoder.begin_render_pass(
            color_attachments=[_cleared(texture) for texture in self.targets.values()],
            depth_stencil_attachment={**_depth(self.depth), "depth_load_op": "clear"},
        )
        run.set_bind_group(0, self.groups["view"])
        for draw in self.draws:
            if draw.material.alpha_mode != "blend":
                run.set_pipeline(passes.gbuffer(passes.variant(draw, mirrored=self.view.plane is not None)))
                self._draw(run, draw)
        run.end()

    def _draw(self, run: Any, draw: Draw) -> None:
        run.set_bind_group(1, draw.surface[self.one_of_many])
        passes.bind_streams(run, draw, moments=(self.light.moment,), attributes=self.light.moment)
        run.draw_indexed(draw.index_count, draw.count, 0, 0, draw.first)

    def _draw_glass(self, encoder: Any) -> None:
        glass = [draw for draw in self.draws if draw.material.alpha_mode == "blend"]
        if not glass or self.view.plane is not None:
            return
        centres, _ = self.stage.balls(self.time)
        eye = self.view.camera[:3, 3]
        glass.sort(key=lambda draw: -float(np.linalg.norm(centres[draw.first] - eye)))
        run = encoder.begin_render_pass(
            color_attachments=[{"view": self._lit_view, "load_op": "load", "store_op": "store"}],
            depth_stencil_attachment={**_depth(self.depth), "depth_load_op": "load"},
        )
        run.set_bind_group(0, self.groups["view"])
        run.set_bind_group(2, self.groups["lighting"])
        for draw in glass:
            run.set_pipeline(passes.glass(passes.variant(draw, mirrored=False)))
            self._draw(run, draw)
        run.end()

    def _fill(self, encoder: Any, pipeline: Any, group: str, target: Any) -> None:
        _fill(encoder, pipeline, (self.groups[group], self.groups["nothing"], self.groups["lighting"]), [target])

    def draw_vectors(self, views: tuple[View, View, View, View], jitter: Jitter) -> "Vectors":
        """Motion over the picture just drawn; `views` at time, time - 1, time - 2 and time + 1."""
        if self.vectors is None:
            self.vectors = Vectors(self)
        self.vectors.draw(views, jitter)
        return self.vectors


class Vectors:
    """Motion targets of a canvas."""

    def __init__(self, canvas: Canvas) -> None:
        self.canvas = canvas
        self.targets = {name: device.target(canvas.size, form) for name, form in passes.VECTORS.items()}
        count = len(canvas.stage.order)
        self.motions = device.buffer(np.zeros((count, 4, 4, 4), np.float32), "STORAGE|COPY_DST")
        height, width = canvas.size
        screen = device.buffer(np.array([width, height, 1e-4, 0], np.float32), "UNIFORM")
        self.turn = device.buffer(np.zeros(84, np.float32), "UNIFORM|COPY_DST")
        self.group = device.bind(passes.layout("motion"), canvas.view_buffer, canvas.instances, self.motions, screen)
        self.sky = device.bind(passes.layout("uniform"), self.turn)
        self.relit = device.target(canvas.size, passes.LIT)
        surface = [canvas.targets[name] for name in passes.FORMATS]
        before = [self.targets["motion"], canvas.occlusion, self.targets["depth_before"], self.targets["normal_before"]]
        self.before = device.bind(passes.layout("before"), *surface, *before)

    def draw(self, views: tuple[View, View, View, View], jitter: Jitter) -> None:
        """Draws the vectors."""
        canvas = self.canvas
        device.write(self.motions, canvas.stage.motions(canvas.time, views))
        device.write(self.turn, sky_turn(views, jitter, canvas.size))
        encoder = device.open_device().create_command_encoder()
        run = encoder.begin_render_pass(
            color_attachments=[_cleared(texture) for texture in self.targets.values()],
            depth_stencil_attachment={**_depth(canvas.depth), "depth_load_op": "load"},
        )
        run.set_bind_group(0, self.sky)
        run.set_pipeline(passes.sky_motion())
        run.draw(3)
        run.set_bind_group(0, self.group)
        for draw in canvas.draws:
            if draw.material.alpha_mode != "blend":
                run.set_pipeline(passes.motion(draw.material.double_sided, draw.flipped))
                run.set_bind_group(1, draw.surface[1])
                passes.bind_streams(run, draw, moments=(0, 1, 2, 3), attributes=1)
                run.draw_indexed(draw.index_count, draw.count, 0, 0, draw.first)
        run.end()
        device.open_device().queue.submit([encoder.finish()])

    def relight(self, before: Canvas) -> Any:
        """The surfaces of this picture as the lights and the camera of `before` showed them: a lit texture."""
        encoder = device.open_device().create_command_encoder()
        groups = (self.before, before.groups["nothing"], before.groups["lighting"])
        _fill(encoder, passes.light("before"), groups, [self.relit.create_view()])
        device.open_device().queue.submit([encoder.finish()])
        return self.relit


_SOME_VIEW = lighting._ANY


def _cleared(texture: Any) -> dict:
    return {"view": texture.create_view(), "load_op": "clear", "store_op": "store", "clear_value": (0, 0, 0, 0)}


def _depth(texture: Any) -> dict:
    return {"view": texture.create_view(), "depth_clear_value": 0.0, "depth_store_op": "store"}


def _fill(encoder: Any, pipeline: Any, groups: tuple, targets: list[Any]) -> None:
    """One triangle over the whole of the targets."""
    attachments = [{"view": t, "load_op": "clear", "store_op": "store", "clear_value": (0, 0, 0, 0)} for t in targets]
    run = encoder.begin_render_pass(color_attachments=attachments)
    run.set_pipeline(pipeline)
    for index, group in enumerate(groups):
        run.set_bind_group(index, group)
    run.draw(3)
    run.end()
