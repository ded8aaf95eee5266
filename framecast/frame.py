"""The data model: one rendered frame and the conventions that every other file relies on.

Read this first. Inside the package there is one convention, written under each field below; whatever an engine or
renderer writes is converted once, where a file is read (`clip.py`, `importers/`). `docs/conventions.md` is printed
from this file, and `tests/test_conventions.py` holds one executable law per field.

Pixel (column i, row j) has its centre at (i + 0.5, j + 0.5); x points right, y points down.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

SKY = 65504.0
"""Depth where nothing was hit: the largest finite half float, so that every file format can hold it."""


def about(meaning: str, layers: str = "", unit: str = "") -> dict[str, str]:
    """Field metadata: the meaning, the layer names that hold it in an EXR file, and the unit."""
    return {"meaning": meaning, "layers": layers, "unit": unit}


@dataclass(frozen=True, kw_only=True)
class Frame:
    """Everything a renderer knows about one time step; `None` where it was not rendered.

    A frame is *shaded* when `color` is there and has to be *generated* when it is `None`. Where nothing at all was
    rendered for a time, every buffer is `None` and only `time`, `jitter`, `reset` and `span` remain. The reference
    image is not a field: a method can never see it. Registered as a pytree, so frames pass through `torch.export`.
    """

    color: Float[Tensor, "b 3 h w"] | None = field(
        default=None,
        metadata=about(
            "scene-linear Rec.709 times exposure, at least 0, before tone mapping, sampled at the jittered position; "
            "None: not shaded, to be generated",
            "R G B",
            "linear",
        ),
    )
    depth: Float[Tensor, "b 1 h w"] | None = field(
        default=None,
        metadata=about(
            "view-space distance along the view axis, positive in front of the camera; nothing hit: SKY = 65504",
            "depth.Z",
            "scene units",
        ),
    )
    motion: Float[Tensor, "b 2 h w"] | None = field(
        default=None,
        metadata=about(
            "current to previous: previous position = position + motion; x right, y down; jitter removed; meaningless "
            "where reset",
            "motion.X motion.Y",
            "pixels of this resolution",
        ),
    )
    motion_next: Float[Tensor, "b 2 h w"] | None = field(
        default=None,
        metadata=about(
            "current to next: next position = position + motion_next; where present it beats any estimate",
            "motion_next.X motion_next.Y",
            "pixels of this resolution",
        ),
    )
    albedo: Float[Tensor, "b 3 h w"] | None = field(
        default=None, metadata=about("base colour", "albedo.R albedo.G albedo.B", "linear, 0..1")
    )
    normal: Float[Tensor, "b 3 h w"] | None = field(
        default=None, metadata=about("world-space unit normal; 0 at the sky", "normal.X normal.Y normal.Z", "unit")
    )
    roughness: Float[Tensor, "b 1 h w"] | None = field(
        default=None, metadata=about("perceptual roughness", "roughness.Y", "0..1")
    )
    metallic: Float[Tensor, "b 1 h w"] | None = field(default=None, metadata=about("metalness", "metallic.Y", "0..1"))
    object: Int[Tensor, "b 1 h w"] | None = field(
        default=None,
        metadata=about("integer id: 0 the static world, other values things that move by themselves", "object.Y", "id"),
    )
    jitter: Float[Tensor, "b 2"] = field(
        metadata=about("sample position minus pixel centre, x right, y down, in [-0.5, 0.5]", unit="pixels")
    )
    view: Float[Tensor, "b 4 4"] | None = field(
        default=None,
        metadata=about("world to camera, column vectors; right-handed, camera looks down -z, +y up", unit="matrix"),
    )
    projection: Float[Tensor, "b 4 4"] | None = field(
        default=None, metadata=about("camera to clip space, column vectors, unjittered; clip w = depth", unit="matrix")
    )
    time: Float[Tensor, " b"] = field(
        metadata=about(
            "moment of the frame; whole numbers on disk, anything between for generated frames", unit="frames"
        )
    )
    reset: Bool[Tensor, " b"] = field(metadata=about("history is invalid: first frame or camera cut", unit="bool"))
    span: Float[Tensor, " b"] = field(
        metadata=about(
            "how far in time motion reaches back and motion_next forward: the gap to the neighbouring shaded frames, "
            "or less where the renderer wrote vectors to frames that were not shaded",
            unit="frames",
        )
    )

    @property
    def is_shaded(self) -> bool:
        """True when the renderer shaded this frame; False when it has to be generated."""
        return self.color is not None

    @property
    def size(self) -> tuple[int, int] | None:
        """Height and width in pixels, or None where no buffer was rendered."""
        buffers = [getattr(self, name) for name in BUFFERS]
        return next(((b.shape[-2], b.shape[-1]) for b in buffers if b is not None), None)

    def to(self, device: torch.device | str) -> "Frame":
        """The same frame with every tensor on `device`."""
        return torch.utils._pytree.tree_map_only(Tensor, lambda t: t.to(device, non_blocking=True), self)


torch.export.register_dataclass(Frame)

BUFFERS: tuple[str, ...] = tuple(f.name for f in fields(Frame) if f.metadata["layers"])
"""Names of the per-pixel fields, in the order of `Frame`."""

LAYERS: dict[str, tuple[str, ...]] = {
    f.name: tuple(f.metadata["layers"].split()) for f in fields(Frame) if f.name in BUFFERS
}
"""EXR channel names of each buffer."""


def moment(time: float, *, batch: int = 1, device: torch.device | str = "cpu") -> Frame:
    """A frame for which nothing was rendered: a request to generate the image at `time` (in clip frames)."""
    return Frame(
        jitter=torch.zeros(batch, 2, device=device),
        time=torch.full((batch,), float(time), device=device),
        reset=torch.zeros(batch, dtype=torch.bool, device=device),
        span=torch.ones(batch, device=device),
    )


def unshaded(frame: Frame) -> Frame:
    """The frame with its colour taken away, G-buffers and motion kept."""
    return replace(frame, color=None)


def concatenate(frames: Sequence[Frame]) -> Frame:
    """Frames of the same size and with the same buffers joined along the batch.

    Raises:
        ValueError: a buffer is there in some frames and missing in others.
    """
    values: dict[str, Any] = {}
    for f in fields(Frame):
        parts = [getattr(frame, f.name) for frame in frames]
        missing = sum(part is None for part in parts)
        if missing not in (0, len(parts)):
            raise ValueError(
                f"{missing} of {len(parts)} frames have no {f.name}; batch frames that carry the same buffers"
            )
        values[f.name] = None if missing else torch.cat(parts)
    return Frame(**values)


def missing(frame: Frame, needs: Sequence[str]) -> tuple[str, ...]:
    """Those of `needs` (field names) that the frame does not carry."""
    return tuple(name for name in needs if getattr(frame, name) is None)


def pixel_grid(height: int, width: int, *, device: torch.device | str = "cpu") -> Float[Tensor, "2 h w"]:
    """Pixel centres (x, y) in pixels: column + 0.5, row + 0.5."""
    x = torch.arange(width, dtype=torch.float32, device=device) + 0.5
    y = torch.arange(height, dtype=torch.float32, device=device) + 0.5
    return torch.stack((x.expand(height, width), y[:, None].expand(height, width)))


def world_position(
    depth: Float[Tensor, "b 1 h w"], view: Float[Tensor, "b 4 4"], projection: Float[Tensor, "b 4 4"]
) -> Float[Tensor, "b 3 h w"]:
    """World-space position of what each pixel centre shows, in scene units; at the sky a point SKY units away.

    Perspective and orthographic projections both; the ray through the pixel is cut where its distance along the view
    axis equals `depth`.
    """
    height, width = depth.shape[-2:]
    x, y = pixel_grid(height, width, device=depth.device)
    ndc_x, ndc_y = 2 * x / width - 1, 1 - 2 * y / height
    p = projection[:, :, :, None, None]
    w = -p[:, 3, 2] * depth[:, 0] + p[:, 3, 3]  # clip-space w at camera-space z = -depth
    camera_x = (ndc_x * w + p[:, 0, 2] * depth[:, 0] - p[:, 0, 3]) / p[:, 0, 0]
    camera_y = (ndc_y * w + p[:, 1, 2] * depth[:, 0] - p[:, 1, 3]) / p[:, 1, 1]
    camera = torch.stack((camera_x, camera_y, -depth[:, 0], torch.ones_like(camera_x)), 1)
    return transformed(torch.linalg.inv(view), camera)[:, :3]


def transformed(matrix: Float[Tensor, "b 4 4"], points: Float[Tensor, "b 4 h w"]) -> Float[Tensor, "b 4 h w"]:
    """The matrix times the homogeneous point of every pixel, in full precision.

    Sums in place of a matrix product, which autocast would round to eight bits: far from the origin that is metres.
    """
    m = matrix[:, :, :, None, None]
    rows = [sum((m[:, i, j] * points[:, j] for j in range(1, 4)), m[:, i, 0] * points[:, 0]) for i in range(4)]
    return torch.stack(rows, 1)


def project(
    position: Float[Tensor, "b 3 h w"], view: Float[Tensor, "b 4 4"], projection: Float[Tensor, "b 4 4"]
) -> tuple[Float[Tensor, "b 2 h w"], Float[Tensor, "b 1 h w"]]:
    """Pixel position (x, y) and depth of world-space points on an image of the same size as `position`.

    Points behind the camera have depth at most 0 and a meaningless position.
    """
    height, width = position.shape[-2:]
    world = torch.cat((position, torch.ones_like(position[:, :1])), 1)
    camera = transformed(view, world)
    clip = transformed(projection, camera)
    w = torch.where(clip[:, 3].abs() < 1e-8, 1e-8, clip[:, 3])
    x = (clip[:, 0] / w + 1) * (width / 2)
    y = (1 - clip[:, 1] / w) * (height / 2)
    return torch.stack((x, y), 1), -camera[:, 2:3]


def camera_motion(frame: Frame, other: Frame) -> Float[Tensor, "b 2 h w"]:
    """Motion in pixels that the cameras alone cause, from `frame` to `other`, as if every surface stood still.

    Needs depth, view and projection of `frame` and the matrices of `other`. Points behind the other camera get 0.
    """
    if frame.depth is None or frame.view is None or frame.projection is None:
        raise ValueError("camera motion needs depth, view and projection of the frame")
    if other.view is None or other.projection is None:
        raise ValueError("camera motion needs view and projection of the other frame")
    position = world_position(frame.depth, frame.view, frame.projection)
    there, depth = project(position, other.view, other.projection)
    return torch.where(depth > 0, there - pixel_grid(*there.shape[-2:], device=there.device), 0)


def inverse_depth(depth: Float[Tensor, "b 1 h w"]) -> Float[Tensor, "b 1 h w"]:
    """1 / depth, and exactly 0 at the sky: bounded, and steady from frame to frame, unlike min-max scaling."""
    return torch.where(depth < SKY, 1 / depth.clamp(min=1e-6), 0)


def facing(frame: Frame) -> Float[Tensor, "b 1 h w"]:
    """Cosine between the normal and the direction to the camera (n·v), in [-1, 1]; 0 at the sky.

    Needs depth, normal, view and projection.
    """
    if frame.depth is None or frame.normal is None or frame.view is None or frame.projection is None:
        raise ValueError("n·v needs depth, normal, view and projection of the frame")
    eye = torch.linalg.inv(frame.view)[:, :3, 3, None, None]
    to_eye = eye - world_position(frame.depth, frame.view, frame.projection)
    return (frame.normal * torch.nn.functional.normalize(to_eye, dim=1)).sum(1, keepdim=True)


def perspective(vertical_fov: float, aspect: float, near: float = 0.1, far: float = 1000.0) -> Float[Tensor, "4 4"]:
    """Camera-to-clip matrix of a symmetric perspective; field of view in radians, clip z in 0..1 (near..far)."""
    f = 1 / torch.tan(torch.tensor(vertical_fov, dtype=torch.float64) / 2).item()
    depth = far / (near - far)
    rows = [[f / aspect, 0, 0, 0], [0, f, 0, 0], [0, 0, depth, near * depth], [0, 0, -1, 0]]
    return torch.tensor(rows, dtype=torch.float32)
