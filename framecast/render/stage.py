"""A scene on the GPU: vertex buffers, textures, and the matrices of every instance at the four times that motion
needs."""

import functools
from collections.abc import Callable
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import numpy as np
from jaxtyping import Float

from framecast.render import device, geometry
from framecast.render.scene import Instance, Material, Mesh, Scene, Texture
from framecast.render.view import View, in_sight

Array = np.ndarray

STEPS = (0, -1, -2, 1)
"""Times, relative to the frame, of the vertex positions that are kept on the GPU, in the order of their buffers."""

INSTANCE = np.dtype(
    [("model", "f4", (4, 4)), ("clip", "f4", (4, 4)), ("object", "u4"), ("mirror", "u4"), ("pad", "u4", 2)]
)


@dataclass(frozen=True, eq=False)
class Draw:
    """Instances `first` to `first + count` of one mesh and one material."""

    first: int
    count: int
    material: Material
    surface: tuple[Any, Any]
    """Bind groups of the material: with anisotropic samplers, and with plain ones (several times as fast on a CPU)."""
    positions: tuple[Any, ...]
    """Vertex buffers at the times of `STEPS`; four times the same one for rigid meshes."""
    attributes: tuple[Any, Any]
    """Normals, tangents and uvs at `time` and `time - 1`."""
    indices: Any
    index_count: int
    flipped: bool
    """The model matrix mirrors, so that triangles wind the other way."""
    casts_shadow: bool


class Stage:
    """Everything of a scene that lives on the GPU and does not depend on the picture's size."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.order = _grouped(scene.instances)
        self._still = {id(i): i.pose(0.0) for i in self.order if i.object == 0}
        self.pose = functools.lru_cache(maxsize=8)(self._poses)
        self.shape = functools.lru_cache(maxsize=8)(self._shapes)
        self.balls = functools.lru_cache(maxsize=8)(self.bounds)
        self._ball = functools.lru_cache(maxsize=None)(lambda mesh: _ball(mesh.positions))
        self.draws = tuple(self._draws())
        self.time: float | None = None

    def _poses(self, time: float) -> list:
        return [self._still.get(id(i)) or i.pose(time) for i in self.order]

    def _shapes(self, time: float) -> dict[int, geometry.Shape]:
        poses = self.pose(time)
        return {k: geometry.shape(i.mesh, poses[k]) for k, i in enumerate(self.order) if geometry.is_deforming(i.mesh)}

    def _draws(self) -> list[Draw]:
        poses, draws, position = self.pose(0.0), [], 0
        meshes: dict[int, tuple] = {}
        surface = functools.cache(_surface)
        for _, group in groupby(enumerate(self.order), key=lambda k: self._batch(k[0], poses[k[0]].matrix)):
            members = [item for _, item in group]
            one = members[0]
            if geometry.is_deforming(one.mesh) or id(one.mesh) not in meshes:
                meshes[id(one.mesh)] = _vertices(one.mesh, poses[position])
            positions, attributes, indices = meshes[id(one.mesh)]
            draws.append(
                Draw(position, len(members), one.material, surface(one.material), positions, attributes, indices,
                     one.mesh.indices.size, bool(np.linalg.det(poses[position].matrix[:3, :3]) < 0), one.casts_shadow)
            )  # fmt: skip
            position += len(members)
        return draws

    def _batch(self, index: int, matrix: Array) -> tuple:
        one = self.order[index]
        alone = index if geometry.is_deforming(one.mesh) or one.material.alpha_mode == "blend" else -1
        return id(one.material), id(one.mesh), one.casts_shadow, bool(np.linalg.det(matrix[:3, :3]) < 0), alone

    def models(self, time: float) -> Float[Array, "n 4 4"]:
        """Model-to-world matrices of all instances, in drawing order."""
        return np.stack([np.asarray(pose.matrix, np.float64) for pose in self.pose(time)])

    def move_to(self, time: float) -> None:
        """Writes the vertex positions of deforming meshes at `time` and around it."""
        if time == self.time:
            return
        shapes = [self.shape(time + step) for step in STEPS]
        for draw in self.draws:
            if draw.first in shapes[0]:
                for target, moment in zip(draw.positions, shapes, strict=True):
                    device.write(target, moment[draw.first].positions)
                for target, moment in zip(draw.attributes, shapes, strict=False):
                    device.write(target, moment[draw.first].attributes)
        self.time = time

    def instances(self, time: float, view: View) -> Array:
        """The `Instance` array of geometry.wgsl as one view sees it."""
        models = self.models(time)
        data = np.zeros(len(models), INSTANCE)
        data["model"] = models.transpose(0, 2, 1)
        data["clip"] = (view.clip @ models).transpose(0, 2, 1)
        data["object"] = [i.object for i in self.order]
        data["mirror"] = [0 if i.mirror is None else i.mirror + 1 for i in self.order]
        return data

    def motions(self, time: float, views: tuple[View, View, View, View]) -> Float[Array, "n 4 4 4"]:
        """The `Motion` array of motion.wgsl, from the views at the times of `STEPS`."""
        clips = [view.clip @ self.models(time + step) for view, step in zip(views[1:], STEPS[1:], strict=True)]
        return np.stack([*clips, self.models(time - 1)], 1).transpose(0, 1, 3, 2).astype(np.float32)

    def bounds(self, time: float) -> tuple[Float[Array, "n 3"], Float[Array, " n"]]:
        """Balls around all instances: centres and radii, world space."""
        shapes = self.shape(time)
        balls = [_ball(shapes[k].positions) if k in shapes else self._ball(i.mesh) for k, i in enumerate(self.order)]
        models = self.models(time)
        middles = np.stack([middle for middle, _ in balls])
        centres = np.einsum("nij,nj->ni", models[:, :3, :3], middles) + models[:, :3, 3]
        return centres, np.linalg.norm(models[:, :3, :3], 2, axis=(1, 2)) * np.array([radius for _, radius in balls])

    @functools.cached_property
    def extent(self) -> tuple[Array, float]:
        """A ball around the whole scene at all times of its suggested length: the same for every frame."""
        times = np.linspace(0, self.scene.frames, 7)
        centres, radii = (np.concatenate(parts) for parts in zip(*map(self.bounds, times), strict=True))
        middle = ((centres - radii[:, None]).min(0) + (centres + radii[:, None]).max(0)) / 2
        return middle, 1.05 * float((np.linalg.norm(centres - middle, axis=1) + radii).max())

    def seen(self, time: float, clip: Float[Array, "4 4"]) -> list[Draw]:
        """The draws of which something may show in the picture of a world-to-clip matrix."""
        visible = in_sight(clip, *self.balls(time))
        return [draw for draw in self.draws if visible[draw.first : draw.first + draw.count].any()]


def _ball(positions: Float[Array, "n 3"]) -> tuple[Array, float]:
    low, high = positions.min(0), positions.max(0)
    return (low + high) / 2, float(np.linalg.norm(high - low) / 2)


def _grouped(instances: tuple[Instance, ...]) -> list[Instance]:
    """Instances with the same material, mesh and shadow next to each other, else in the order given."""
    materials: dict[int, int] = {}
    meshes: dict[int, int] = {}
    for one in instances:
        materials.setdefault(id(one.material), len(materials))
        meshes.setdefault(id(one.mesh), len(meshes))
    return sorted(instances, key=lambda i: (materials[id(i.material)], meshes[id(i.mesh)], i.casts_shadow))


def _vertices(mesh: Mesh, pose: Any) -> tuple[tuple, tuple, Any]:
    shape, moving = geometry.shape(mesh, pose), geometry.is_deforming(mesh)
    copies: Callable[[Array, int], tuple] = lambda data, count: tuple(  # noqa: E731
        device.buffer(data, "VERTEX|COPY_DST") for _ in range(count)
    )
    positions = copies(shape.positions, 4) if moving else copies(shape.positions, 1) * 4
    attributes = copies(shape.attributes, 2) if moving else copies(shape.attributes, 1) * 2
    return positions, attributes, device.buffer(mesh.indices.astype(np.uint32), "INDEX")


def _surface(material: Material) -> tuple[Any, Any]:
    """Bind group 1 of geometry.wgsl, with the two kinds of samplers."""
    cutoff = material.alpha_cutoff if material.alpha_mode == "mask" else -1.0
    bend = material.normal_scale if material.normal_texture else 0.0
    numbers = [*material.base_color, *material.emissive, bend, material.roughness, material.metallic, cutoff, 0]
    base = material.base_texture
    textures = (base, material.normal_texture, material.roughness_metallic_texture, material.emissive_texture)
    images = [_blank() if t is None else _image(t, cutoff if t is base else -1.0) for t in textures]
    modes = ["repeat" if t is None or t.repeat else "clamp" for t in textures]
    uniform = device.buffer(np.array(numbers, np.float32), "UNIFORM")
    sharp, plain = ([device.sampler(mode + kind) for mode in modes] for kind in ("+", ""))
    bind = functools.partial(device.bind, surface_layout(), uniform, *images)
    return bind(*sharp), bind(*plain)


@functools.cache
def surface_layout() -> Any:
    """Layout of bind group 1."""
    kinds: list[dict] = [{"buffer": {"type": "uniform"}}, *[{"texture": {}}] * 4, *[{"sampler": {}}] * 4]
    entries = [{"binding": k, "visibility": "FRAGMENT", **kind} for k, kind in enumerate(kinds)]
    return device.open_device().create_bind_group_layout(entries=entries)


@functools.cache
def _blank() -> Any:
    """Stands where a material has no texture; never read."""
    return device.upload([np.zeros((1, 1, 4), np.uint8)], "rgba8unorm")


@functools.lru_cache(maxsize=512)
def _image(texture: Texture, cutoff: float) -> Any:
    pixels = texture.pixels
    if pixels.dtype != np.uint8:
        return device.upload(_mips(pixels.astype(np.float32), cutoff), "rgba16float")
    linear = pixels.astype(np.float32) / 255
    if not texture.srgb:
        levels = _mips(linear, cutoff)
        return device.upload([pixels, *(np.round(level * 255).clip(0, 255) for level in levels[1:])], "rgba8unorm")
    linear[..., :3] = np.where(
        linear[..., :3] <= 0.04045, linear[..., :3] / 12.92, ((linear[..., :3] + 0.055) / 1.055) ** 2.4
    )
    levels = [np.round(_encode(level) * 255).clip(0, 255) for level in _mips(linear, cutoff)[1:]]
    return device.upload([pixels, *levels], "rgba8unorm-srgb")


def _encode(image: Array) -> Array:
    """sRGB transfer of the three colours, alpha untouched."""
    color = image[..., :3].clip(0, 1)
    coded = np.where(color <= 0.0031308, 12.92 * color, 1.055 * color ** (1 / 2.4) - 0.055)
    return np.concatenate([coded, image[..., 3:]], -1)


def _mips(image: Float[Array, "h w 4"], cutoff: float) -> list[Array]:
    """The image and its halvings down to one pixel.

    Where alpha is tested against `cutoff` (>= 0), each level's alpha is scaled so that the tested area stays what it
    is in the image itself: foliage would thin out with distance otherwise.
    """
    levels, coverage = [image], float((image[..., 3] >= cutoff).mean())
    while max(levels[-1].shape[:2]) > 1:
        levels.append(_halve(levels[-1]))
    if cutoff > 0 and 0 < coverage < 1:
        for level in levels[1:]:
            edge = np.quantile(level[..., 3], 1 - coverage)
            level[..., 3] = (level[..., 3] * (cutoff / max(edge, 1e-3))).clip(0, 1)
    return levels


def _halve(image: Array) -> Array:
    height, width = image.shape[:2]
    rows = image if height == 1 else (image[0 : height // 2 * 2 : 2] + image[1 : height // 2 * 2 : 2]) / 2
    return rows if width == 1 else (rows[:, 0 : width // 2 * 2 : 2] + rows[:, 1 : width // 2 * 2 : 2]) / 2
