"""What lights a scene at one time: shadow maps drawn, lights packed, the pictures behind mirrors taken."""

from typing import Any

import numpy as np

from framecast.render import device, passes, shadows
from framecast.render.scene import Light, LightPose
from framecast.render.sky import Environment
from framecast.render.stage import Draw, Stage
from framecast.render.view import View, rays

Array = np.ndarray

_VECTORS = (("color", "kind", "u4"), ("position", "radius", "f4"), ("direction", "reach", "f4"))
LIGHT = np.dtype(
    [part for vector, scalar, kind in _VECTORS for part in ((vector, "f4", 3), (scalar, kind))]
    + [("inner", "f4"), ("outer", "f4"), ("shadow", "u4"), ("shadows", "u4"), ("splits", "f4", 4)]
)
MAP = np.dtype([("matrix", "f4", (4, 4)), ("texel", "f4"), ("range", "f4"), ("layer", "u4"), ("pad", "u4")])
KINDS = {"sun": 0, "point": 1, "spot": 2}


class Lighting:
    """The lights of a stage at one moment, on the GPU.

    `moment` is a place in STEPS: 0 draws shadows of the meshes at the stage's time, 1 of one frame before, where
    deforming meshes are kept as well.
    """

    def __init__(self, stage: Stage, moment: int) -> None:
        self.stage, self.moment, self.key = stage, moment, None
        casting = [light for light in stage.scene.lights if light.casts_shadow]
        suns = sum(light.kind == "sun" for light in casting)
        lamps = sum({"point": 6, "spot": 1}.get(light.kind, 0) for light in casting)
        self.suns = device.target(
            (shadows.SUN_SIZE,) * 2 if suns else (1, 1), passes.DEPTH, layers=max(suns * shadows.CASCADES, 1)
        )
        self.lamps = device.target((shadows.LAMP_SIZE,) * 2 if lamps else (1, 1), passes.DEPTH, layers=max(lamps, 1))
        count = max(suns * shadows.CASCADES + lamps, 1)
        self.light_buffer = device.buffer(np.zeros(max(len(stage.scene.lights), 1), LIGHT), "STORAGE|COPY_DST")
        self.map_buffer = device.buffer(np.zeros(count, MAP), "STORAGE|COPY_DST")
        self.matrices = [device.buffer(np.zeros(16, np.float32), "UNIFORM|COPY_DST") for _ in range(count)]
        self.instances = device.buffer(stage.instances(0.0, _ANY), "STORAGE|COPY_DST")
        self.group = device.bind(
            passes.layout("view"), device.buffer(np.zeros(12, np.float32), "UNIFORM"), self.instances
        )
        self.looks = [device.bind(passes.layout("uniform"), matrix) for matrix in self.matrices]

    def update(self, time: float, view: View) -> None:
        """Draws the shadow maps and packs the lights at `time`, for pictures taken from `view`."""
        scene = self.stage.scene
        maps: list[shadows.ShadowMap] = []
        packed = np.zeros(max(len(scene.lights), 1), LIGHT)
        layers = {"sun": 0, "lamp": 0}
        for k, light in enumerate(scene.lights):
            pose, kind = light.at(time), "sun" if light.kind == "sun" else "lamp"
            mine: list[shadows.ShadowMap] = []
            if light.casts_shadow and kind == "sun":
                mine = shadows.sun_maps(light, pose, view, scene.shadow_distance, self.stage.extent, layers[kind])
            elif light.casts_shadow:
                mine = shadows.lamp_maps(light, pose, layers[kind])
            packed[k] = _packed(light, pose, light.dimmer(time), len(maps), mine)
            layers[kind] += len(mine)
            maps += mine
        device.write(self.light_buffer, packed)
        device.write(self.instances, self.stage.instances(time, view))
        if maps:
            rows = [(m.matrix.T, m.texel, m.range, m.layer, 0) for m in maps]
            device.write(self.map_buffer, np.array(rows, MAP))
            self._draw(time, maps, packed)

    def _draw(self, time: float, maps: list[shadows.ShadowMap], packed: Array) -> None:
        encoder = device.open_device().create_command_encoder()
        for light in packed:
            texture = self.suns if light["kind"] == 0 else self.lamps
            for index in range(light["shadow"], light["shadow"] + light["shadows"]):
                device.write(self.matrices[index], maps[index].matrix.T.astype(np.float32))
                attachment = {"view": device.layer(texture, maps[index].layer), "depth_clear_value": 0.0}
                run = encoder.begin_render_pass(
                    color_attachments=[],
                    depth_stencil_attachment={**attachment, "depth_load_op": "clear", "depth_store_op": "store"},
                )
                run.set_bind_group(0, self.group)
                run.set_bind_group(2, self.looks[index])
                for draw in self.stage.seen(time, maps[index].matrix):
                    self._cast(run, draw)
                run.end()
        device.open_device().queue.submit([encoder.finish()])

    def _cast(self, run: Any, draw: Draw) -> None:
        mode = draw.material.alpha_mode
        if not draw.casts_shadow or mode == "blend":
            return
        run.set_pipeline(passes.shadow(mode == "mask"))
        run.set_bind_group(1, draw.surface[1])
        passes.bind_streams(run, draw, moments=(self.moment,), attributes=self.moment)
        run.draw_indexed(draw.index_count, draw.count, 0, 0, draw.first)


_ANY = View(np.eye(4), np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1.0], [0, 0, -1, 0]]))


def _packed(light: Light, pose: LightPose, dimmer: float, first: int, maps: list[shadows.ShadowMap]) -> tuple:
    color = np.asarray(light.color, np.float64) * light.intensity * dimmer
    direction = np.asarray(pose.direction, np.float64)
    direction = direction / max(float(np.linalg.norm(direction)), 1e-9)
    splits = ([m.far for m in maps] + [0.0] * 4)[:4]
    cones = np.cos(min(light.inner_cone, light.outer_cone - 1e-3)), np.cos(light.outer_cone)
    return (
        color,
        KINDS[light.kind],
        pose.position,
        light.radius,
        direction,
        light.reach,
        *cones,
        first,
        len(maps),
        splits,
    )


def pack(
    stage: Stage, view: View, size: tuple[int, int], jitter: tuple[float, float], exposure: float, mirrors: int
) -> Array:
    """The `Frame` struct of lighting.wgsl."""
    scene = stage.scene
    data = np.zeros(28, np.float32)
    data[:12] = rays(view).ravel()
    data[12:16] = np.append(view.camera[:3, 3], 1)
    data[16:20] = size[1], size[0], *jitter
    data[20:24] = view.near, exposure, scene.haze, view.projection[1, 1] * size[0] / 2
    data[24:27].view(np.uint32)[:] = len(scene.lights), scene.sky.sun_disc, mirrors
    data[27] = scene.occlusion_radius
    return data


def bind(lighting: Lighting, environment: Environment, frame: Any, reflections: Any) -> Any:
    """Bind group 2 of every lit pass."""
    return device.bind(
        passes.layout("lighting"),
        frame,
        lighting.light_buffer,
        lighting.map_buffer,
        device.stack(lighting.suns),
        device.stack(lighting.lamps),
        device.sampler("shadow"),
        environment.sky,
        environment.ambient,
        device.stack(environment.environment),
        device.sampler("sky"),
        device.stack(reflections),
        device.sampler("plain"),
    )
