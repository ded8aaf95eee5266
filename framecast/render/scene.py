"""What the renderer draws: meshes, materials, lights, a camera, a sky, all pure functions of time.

Everything is numpy and knows nothing of the GPU. World space is right-handed; +y is up by habit. A camera looks down
its own -z with +y up. Matrices act on column vectors (`matrix @ point`), so the translation stands in the last column.
Time is in clip frames and may be any real number, also negative: the renderer evaluates `time - 2`, `time - 1`, `time`
and `time + 1` to get exact motion, so every callable here has to give the same answer for the same time, always.

Light is measured in plain radiometric units that only exposure turns into a picture: a white diffuse surface facing a
sun of intensity pi has radiance 1.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float, Integer, Num

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class Texture:
    """An image for a material. Row 0 is the top row and uv (0, 0) is its top-left corner, as in glTF."""

    pixels: Num[Array, "h w 4"]
    """uint8, or a float type for values outside [0, 1]. Alpha is coverage, not premultiplied."""
    srgb: bool = False
    """Whether the colour of uint8 pixels is sRGB-encoded (base colour and emissive are; normals and roughness are
    not)."""
    repeat: bool = True
    """Tiles outside [0, 1], or else repeats its border."""


@dataclass(frozen=True, eq=False)
class Material:
    """A glTF metallic-roughness material. Factors multiply textures, and every texture is optional."""

    base_color: tuple[float, float, float, float] = (1.0, 1.0, 1.0, 1.0)
    """Linear RGB reflectance and opacity."""
    base_texture: Texture | None = None
    normal_texture: Texture | None = None
    """Tangent space, rgb = normal / 2 + 0.5, green up (the glTF way)."""
    normal_scale: float = 1.0
    roughness: float = 1.0
    """Perceptual roughness; the GGX alpha is its square."""
    metallic: float = 0.0
    roughness_metallic_texture: Texture | None = None
    """Green = roughness, blue = metallic."""
    emissive: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Radiance that the surface adds, linear RGB, any size."""
    emissive_texture: Texture | None = None
    alpha_mode: Literal["opaque", "mask", "blend"] = "opaque"
    """`mask`: pixels with alpha below `alpha_cutoff` are not there. `blend`: drawn over the lit picture, absent from
    buffers."""
    alpha_cutoff: float = 0.5
    double_sided: bool = False


@dataclass(frozen=True, eq=False)
class Mesh:
    """Indexed triangles, counter-clockwise when seen from outside, in model space."""

    positions: Float[Array, "n 3"]
    normals: Float[Array, "n 3"]
    uvs: Float[Array, "n 2"]
    indices: Integer[Array, " m"]
    """Three per triangle."""
    tangents: Float[Array, "n 4"] | None = None
    """xyz and the sign of the bitangent. None: derived from the uvs where a normal texture needs them."""
    joints: Integer[Array, "n 4"] | None = None
    weights: Float[Array, "n 4"] | None = None
    """Skin: four joints a vertex and their weights (sum 1)."""
    morphs: Float[Array, "k n 3"] | None = None
    """Position offsets of k morph targets, added before skinning."""
    morph_normals: Float[Array, "k n 3"] | None = None
    """Normal offsets of the same targets. None: normals are recomputed from the morphed triangles."""


class Pose(NamedTuple):
    """Where a mesh is at one time."""

    matrix: Array
    """4x4, model to world. For a skinned mesh joints already lead to world space, and this is the identity (as in
    glTF)."""
    joints: Array | None = None
    """j 4 4, joint world matrix @ inverse bind matrix."""
    morph_weights: Array | None = None
    """k."""


@dataclass(frozen=True, eq=False)
class Instance:
    """One mesh with one material, somewhere at any time."""

    mesh: Mesh
    material: Material
    object: int = 0
    """0 = static world; its pose is then read once, at time 0. Things that move by themselves have numbers of their
    own, 1 to 2047 (exact in a half float); the parts of one thing share a number."""
    pose: Callable[[float], Pose] = field(default=lambda time: Pose(np.eye(4)))
    casts_shadow: bool = True
    mirror: int | None = None
    """Index in `Scene.mirrors`: this surface lies in that plane and shows the planar reflection, blurred by its
    roughness."""


class LightPose(NamedTuple):
    """Where a light is at one time: position (3), and direction (3), the unit vector along which the light travels."""

    position: Array
    direction: Array


@dataclass(frozen=True, eq=False)
class Light:
    """A sun, a point or a spot light."""

    kind: Literal["sun", "point", "spot"]
    color: tuple[float, float, float]
    """Linear RGB."""
    intensity: float
    """Sun: irradiance on a surface that faces it. Point and spot: radiant intensity; the irradiance is intensity /
    distance^2."""
    at: Callable[[float], LightPose]
    radius: float = 0.0
    """Softness of the shadow's edge. Sun: half its angle in the sky, radians (the real one 0.0047). Others: radius in
    scene units."""
    inner_cone: float = 0.0
    outer_cone: float = 0.785
    """Spot: half angles in radians where the light begins to fall off and where it ends."""
    reach: float = 50.0
    """Point and spot: scene units from where on there is no light; it fades smoothly towards it."""
    casts_shadow: bool = True
    dimmer: Callable[[float], float] = field(default=lambda time: 1.0)
    """Factor on the intensity, for flicker."""


@dataclass(frozen=True, eq=False)
class Camera:
    """A perspective camera with infinite far distance and square pixels."""

    at: Callable[[float], Array]
    """Camera to world, 4x4, rigid."""
    vertical_fov: float
    """Full angle in radians."""
    near: float = 0.05
    """Scene units."""


@dataclass(frozen=True, eq=False)
class Sky:
    """Radiance from infinitely far away, as an equirectangular image.

    The top row looks to +y, the middle column to -z, columns run to the right (towards +x). `ambient` lights the
    surfaces (diffuse and glossy) where the visible sky would be wrong, as in a room; None: the same as `radiance`.
    """

    radiance: Float[Array, "h w 3"]
    ambient: Float[Array, "h2 w2 3"] | None = None
    sun_disc: bool = True
    """Draws the discs of suns with a soft halo, which follow the sun lights. They are not part of the images."""


@dataclass(frozen=True, eq=False)
class Mirror:
    """A plane that reflects exactly: the scene is rendered once more behind it. Reflects the side that `normal` points
    to."""

    point: Float[Array, "3"]
    normal: Float[Array, "3"]


@dataclass(frozen=True, eq=False)
class Scene:
    """A world and a way through it."""

    name: str
    instances: tuple[Instance, ...]
    lights: tuple[Light, ...]
    camera: Camera
    sky: Sky
    exposure: Callable[[float], float] = field(default=lambda time: 1.0)
    """Factor from radiance to the colours of the clip."""
    cuts: frozenset[int] = frozenset()
    """Frames that have nothing to do with the one before."""
    frames: int = 60
    """Suggested length; callables have to work beyond it as well."""
    fps: float = 30.0
    mirrors: tuple[Mirror, ...] = ()
    haze: float = 0.0
    """Density of a uniform haze per scene unit; it takes the colour of the blurred sky behind it."""
    occlusion_radius: float = 0.5
    """Scene units over which corners darken each other (ambient occlusion)."""
    shadow_distance: float = 60.0
    """Scene units from the camera up to which the sun casts shadows."""
    split: Literal["train", "test"] = "train"
