"""Materials and textures of a glTF file."""

import functools
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from framecast.render.gltf_file import File, image
from framecast.render.scene import Material, Texture

MIRRORED, CLAMPED = 33648, 33071


class Look(NamedTuple):
    """A material and how its textures are laid on."""

    material: Material
    uv_set: int = 0
    """Which TEXCOORD attribute its textures use; that of the base colour where they differ."""
    offset: tuple[float, float] = (0.0, 0.0)
    rotation: float = 0.0
    scale: tuple[float, float] = (1.0, 1.0)
    """KHR_texture_transform of the same texture: uv' = offset + rotation · scale · uv."""


def looks(file: File) -> list[Look]:
    """Every material of the file, then the specification's default one."""

    @functools.cache
    def texture(index: int, srgb: bool) -> Texture | None:
        entry = file.document.textures[index]
        if entry.source is None:
            return None
        pixels = image(file, entry.source)
        sampler = None if entry.sampler is None else file.document.samplers[entry.sampler]
        wraps = set() if sampler is None else {sampler.wrapS, sampler.wrapT}
        if MIRRORED in wraps:
            # A texture that holds its own mirror images repeats the same way.
            pixels = np.concatenate([pixels, pixels[:, ::-1]], axis=1)
            pixels = np.concatenate([pixels, pixels[::-1]], axis=0)
        return Texture(pixels, srgb=srgb, repeat=wraps != {CLAMPED})

    found = [_look(file, material, texture) for material in file.document.materials or ()]
    return [*found, Look(Material(metallic=1.0, roughness=1.0))]


def _look(file: File, given: Any, texture: Any) -> Look:
    extensions = given.extensions or {}
    base = given.pbrMetallicRoughness
    colour = list(base.baseColorFactor or (1, 1, 1, 1)) if base is not None else [1.0, 1.0, 1.0, 1.0]
    base_info = base.baseColorTexture if base is not None else None
    surface_info = base.metallicRoughnessTexture if base is not None else None
    roughness, metallic = _either(base, "roughnessFactor"), _either(base, "metallicFactor")
    old = extensions.get("KHR_materials_pbrSpecularGlossiness")
    if old is not None:
        colour = list(old.get("diffuseFactor", (1, 1, 1, 1)))
        base_info, surface_info = old.get("diffuseTexture"), None
        roughness, metallic = 1.0 - float(old.get("glossinessFactor", 1.0)), 0.0
    strength = float((extensions.get("KHR_materials_emissive_strength") or {}).get("emissiveStrength", 1.0))
    emissive = tuple(strength * float(e) for e in given.emissiveFactor or (0, 0, 0))
    emissive_info = given.emissiveTexture
    if "KHR_materials_unlit" in extensions:
        emissive, emissive_info, colour[:3] = tuple(colour[:3]), base_info, [0.0, 0.0, 0.0]
    infos = [base_info, given.normalTexture, surface_info, emissive_info]
    material = Material(
        base_color=(float(colour[0]), float(colour[1]), float(colour[2]), float(colour[3])),
        base_texture=_texture(base_info, True, texture),
        normal_texture=_texture(given.normalTexture, False, texture),
        normal_scale=float(_value(given.normalTexture, "scale", 1.0)),
        roughness=roughness,
        metallic=metallic,
        roughness_metallic_texture=_texture(surface_info, False, texture),
        emissive=(float(emissive[0]), float(emissive[1]), float(emissive[2])),
        emissive_texture=_texture(emissive_info, True, texture),
        alpha_mode={"MASK": "mask", "BLEND": "blend"}.get(given.alphaMode or "OPAQUE", "opaque"),  # type: ignore[arg-type]
        alpha_cutoff=0.5 if given.alphaCutoff is None else float(given.alphaCutoff),
        double_sided=bool(given.doubleSided),
    )
    return _laid(material, next((info for info in infos if info is not None), None))


def _either(base: Any, name: str) -> float:
    """A factor, 1 where the file says nothing."""
    value = None if base is None else base.get(name)
    return 1.0 if value is None else float(value)


def _value(info: Any, name: str, default: Any) -> Any:
    """A field of a texture reference, where there is a reference and it has the field."""
    value = None if info is None else info.get(name)
    return default if value is None else value


def _texture(info: Any, srgb: bool, texture: Any) -> Texture | None:
    return None if info is None else texture(_value(info, "index", 0), srgb)


def _laid(material: Material, info: Any) -> Look:
    shift = _value(info, "extensions", {}).get("KHR_texture_transform") or {}
    u, v = shift.get("offset", (0.0, 0.0))
    wide, tall = shift.get("scale", (1.0, 1.0))
    uv_set = int(shift.get("texCoord", _value(info, "texCoord", 0)))
    return Look(material, uv_set, (float(u), float(v)), float(shift.get("rotation", 0.0)), (float(wide), float(tall)))


def moved_uvs(uvs: Float[ndarray, "n 2"], look: Look) -> Float[ndarray, "n 2"]:
    """Texture coordinates after the look's KHR_texture_transform."""
    cosine, sine = np.cos(look.rotation), np.sin(look.rotation)
    turned = np.array([[cosine, sine], [-sine, cosine]]) * np.array(look.scale)
    return (uvs @ turned.T + look.offset).astype(np.float32)
