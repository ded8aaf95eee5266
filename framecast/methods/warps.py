"""Extrapolation by motion vectors alone: the last shaded frame read where the G-buffers of the new one point.

Paper:   plain motion vectors (`warp`), and occlusion motion vectors (`warp-occlusion`): Zeng, Liu, Yang, Wang, Yan,
         "Temporally Reliable Motion Vectors for Real-time Ray Tracing", Computer Graphics Forum 40(2) 2021,
         https://doi.org/10.1111/cgf.142616
Follows: `warp`: each pixel of the frame to generate reads the last shaded colour at the end of its vector. With
         occlusion vectors: light in place of colour (demodulated by the base colour, warped in the log domain,
         modulated by the new frame's base colour); where the last frame does not show the surface, it is read beside
         whatever covered it (Eq. 6), with the motion of the occluder taken from the splatted vectors of this frame.
         Both images are inputs of ExtraNet.
Differs: the occluder's transform between the two frames is its motion vector, exact for what moves rigidly on screen.
         Jitter of both frames is part of every read. Shadow and reflection vectors of the paper need a ray tracer.
Needs:   color; of the generated frame motion, for occlusion vectors every G-buffer but roughness and the cameras
Modes:   extrapolate
State:   the last shaded frame
"""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor, nn

from framecast.color import decode_log, encode_log, modulate
from framecast.frame import Frame
from framecast.methods.guided import begins_unshaded, mean_of
from framecast.methods.reproject import (
    GEOMETRY,
    Geometry,
    chosen,
    geometry,
    light,
    occluder_motion,
    steps,
    surface,
    valid,
)
from framecast.warp import warp


@dataclass(frozen=True)
class Last:
    """The last shaded frame."""

    color: Float[Tensor, "b 3 h w"]
    """Colour, or light without texture, encoded by `encode_log`."""
    jitter: Float[Tensor, "b 2"]
    time: Float[Tensor, " b"]


@dataclass(frozen=True)
class LastSurfaces:
    """The last shaded frame, and what it shows."""

    color: Float[Tensor, "b 3 h w"]
    """Light without texture, encoded by `encode_log`."""
    shows: Geometry


torch.export.register_dataclass(Last)
torch.export.register_dataclass(LastSurfaces)


class Warp(nn.Module):
    """Plain motion vectors: no test of whether the last frame shows the surface."""

    needs: tuple[str, ...] = ("color",)
    needs_generated: tuple[str, ...] = ("motion",)
    modes: tuple[str, ...] = ("extrapolate",)
    scales: tuple[float, ...] = (1.0,)
    parts: tuple[str, ...] = ("generate",)
    history: int | None = 1
    step_motion: bool = False

    def start(self, frame: Frame) -> Last:
        """The state before the first frame, which is `frame`."""
        assert frame.color is not None
        return Last(encode_log(frame.color), frame.jitter, frame.time)

    def forward(self, frame: Frame, state: Last) -> tuple[Float[Tensor, "b 3 h w"], Last]:
        """The frame's own image where it was shaded, else the last one seen along its motion."""
        if frame.color is not None:
            return frame.color, self.start(frame)
        if begins_unshaded(frame, "warp", "the last frame of the shot before is shown"):
            frame = at_rest(frame)
        return self.generate(frame, state), state

    def generate(self, frame: Frame, state: Last) -> Float[Tensor, "b 3 h w"]:
        """The last image along the frame's motion."""
        return decode_log(warp(state.color, steps(frame, state.time, state.jitter)))


class OcclusionWarp(nn.Module):
    """Motion vectors of the surfaces where the last frame shows them, of their occluders elsewhere."""

    needs: tuple[str, ...] = ("color", "depth", "albedo", "metallic", "normal", "object", "view", "projection")
    needs_generated: tuple[str, ...] = (*GEOMETRY, "albedo", "metallic")
    modes: tuple[str, ...] = ("extrapolate",)
    scales: tuple[float, ...] = (1.0,)
    parts: tuple[str, ...] = ("generate",)
    history: int | None = 1
    step_motion: bool = False

    def start(self, frame: Frame) -> LastSurfaces:
        """The state before the first frame, which is `frame`."""
        return LastSurfaces(light(frame), geometry(frame))

    def forward(self, frame: Frame, state: LastSurfaces) -> tuple[Float[Tensor, "b 3 h w"], LastSurfaces]:
        """The frame's own image where it was shaded, else the last light along its motion, on its own surfaces."""
        if frame.color is not None:
            return frame.color, self.start(frame)
        past = state
        if begins_unshaded(frame, "warp-occlusion"):
            frame, past = at_rest(frame), replace(state, color=chosen(frame.reset, mean_of(state.color), state.color))
        return self.generate(frame, past), state

    def generate(self, frame: Frame, state: LastSurfaces) -> Float[Tensor, "b 3 h w"]:
        """The last light, along the occluder's motion where the surface was hidden, on the frame's surfaces."""
        now = geometry(frame)
        motion = steps(frame, state.shows.time, state.shows.jitter)
        seen = valid(now, state.shows, motion)
        around = torch.where(seen, motion, occluder_motion(now.depth, motion))
        return modulate(decode_log(warp(state.color, around)), surface(frame))


def at_rest(frame: Frame) -> Frame:
    """The frame without motion where it resets, which means nothing there."""
    vectors = {name: image for name in ("motion", "motion_next") if (image := getattr(frame, name)) is not None}
    still = {name: chosen(frame.reset, torch.zeros_like(image), image) for name, image in vectors.items()}
    return replace(frame, **still)
