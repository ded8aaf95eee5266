"""Pipelines: how each shader is run. One function per pass, each made once per variant."""

import functools
from typing import Any, NamedTuple

from framecast.render import device
from framecast.render.stage import Draw, surface_layout

FORMATS = {
    "albedo": "rgba16float",
    "normal": "rgba16float",
    "emissive": "rgba16float",
    "geometric": "rg16float",
    "object": "r32uint",
}
"""First pass, 32 bytes a sample: the most that the web allows, which is why motion is a second pass."""
VECTORS = {
    "motion": "rg32float",
    "motion2": "rg32float",
    "motion_next": "rg32float",
    "depth_before": "r32float",
    "normal_before": "rg16float",
}
"""Second pass, 32 bytes again; run only for pictures that are written with vectors."""
DEPTH, LIT, OCCLUSION = "depth32float", "rgba16float", "r16float"

_POSITION = {"array_stride": 12, "step_mode": "vertex"}
_ATTRIBUTES = (("float32x3", 0), ("float32x4", 12), ("float32x2", 28))


def _stream(location: int) -> dict:
    return {**_POSITION, "attributes": [{"format": "float32x3", "offset": 0, "shader_location": location}]}


def _attributes(first: int, count: int) -> dict:
    parts = [
        {"format": form, "offset": offset, "shader_location": first + k}
        for k, (form, offset) in enumerate(_ATTRIBUTES[:count])
    ]
    return {"array_stride": 36, "step_mode": "vertex", "attributes": parts}


def _entries(stages: str, *kinds: dict) -> Any:
    entries = [{"binding": k, "visibility": stages, **kind} for k, kind in enumerate(kinds)]
    return device.open_device().create_bind_group_layout(entries=entries)


_UNIFORM, _STORAGE = {"buffer": {"type": "uniform"}}, {"buffer": {"type": "read-only-storage"}}
_WRITTEN = {"buffer": {"type": "storage"}}
_PLAIN, _FLOAT, _UINT = ({"texture": {"sample_type": kind}} for kind in ("unfilterable-float", "float", "uint"))
_DEPTH = {"texture": {"sample_type": "depth"}}
_DEPTHS = {"texture": {"sample_type": "depth", "view_dimension": "2d-array"}}
_FLOATS = {"texture": {"sample_type": "float", "view_dimension": "2d-array"}}


@functools.cache
def layout(name: str) -> Any:
    """Bind group layouts, by the part they play."""
    both = "VERTEX|FRAGMENT"
    if name == "view":
        return _entries(both, _UNIFORM, _STORAGE)
    if name == "motion":
        return _entries(both, _UNIFORM, _STORAGE, _STORAGE, _UNIFORM)
    if name == "uniform":
        return _entries(both, _UNIFORM)
    if name == "nothing":
        return _entries(both)
    if name == "occlusion":
        return _entries("FRAGMENT", _DEPTH, _PLAIN)
    if name == "now":
        return _entries("FRAGMENT", *[_PLAIN] * 4, _UINT, _DEPTH, _PLAIN)
    if name == "before":
        return _entries("FRAGMENT", *[_PLAIN] * 4, _UINT, *[_PLAIN] * 4)
    if name == "lighting":
        shadows = (_DEPTHS, _DEPTHS, {"sampler": {"type": "comparison"}})
        images: tuple[dict, ...] = (_FLOAT, _FLOAT, _FLOATS, {"sampler": {}}, _FLOATS, {"sampler": {}})
        return _entries("FRAGMENT", _UNIFORM, _STORAGE, _STORAGE, *shadows, *images)
    if name == "gather":
        return _entries("COMPUTE", _UNIFORM, _WRITTEN, _PLAIN)
    if name == "ranges":
        return _entries("COMPUTE", _UNIFORM, _WRITTEN, _PLAIN, _PLAIN, _PLAIN)
    raise KeyError(name)


def _pipeline(code: Any, groups: tuple[Any, ...], **parts: Any) -> Any:
    gpu = device.open_device()
    parts["vertex"] = {"module": code, "entry_point": "vertex", "buffers": [], **parts.get("vertex", {})}
    if "fragment" in parts:
        parts["fragment"] = {"module": code, "entry_point": "fragment", "targets": [], **parts["fragment"]}
    return gpu.create_render_pipeline(layout=gpu.create_pipeline_layout(bind_group_layouts=list(groups)), **parts)


def _faces(double_sided: bool, flipped: bool) -> dict:
    winding, cull = "cw" if flipped else "ccw", "none" if double_sided else "back"
    return {"topology": "triangle-list", "front_face": winding, "cull_mode": cull}


def _depth(compare: str, writes: bool) -> dict:
    return {"format": DEPTH, "depth_write_enabled": writes, "depth_compare": compare}


class Variant(NamedTuple):
    """What a pipeline that draws surfaces is made for."""

    mask: bool
    double_sided: bool
    flipped: bool
    """Front faces wind clockwise."""
    clip: bool
    """Seen in a mirror: what lies behind its plane is cut away."""
    textures: tuple[bool, bool, bool, bool]
    """Base, normal, roughness and metallic, emissive: whether there is one."""

    @property
    def constants(self) -> dict[str, int]:
        """Overrides of geometry.wgsl."""
        values = (self.mask, self.clip, *self.textures)
        return dict(zip(("MASK", "CLIP", "BASE", "BUMPS", "SURFACE", "GLOW"), map(int, values), strict=True))


def variant(draw: Draw, *, mirrored: bool) -> Variant:
    """The variant that a draw needs."""
    m = draw.material
    textures = (m.base_texture, m.normal_texture, m.roughness_metallic_texture, m.emissive_texture)
    present = [texture is not None for texture in textures]
    return Variant(
        m.alpha_mode == "mask",
        m.double_sided,
        draw.flipped != mirrored,
        mirrored,
        (present[0], present[1], present[2], present[3]),
    )


@functools.cache
def gbuffer(kind: Variant) -> Any:
    """First pass: surfaces."""
    return _pipeline(
        device.shader("geometry", "gbuffer"),
        (layout("view"), surface_layout()),
        vertex={"buffers": [_stream(0), _attributes(1, 3)], "constants": kind.constants},
        fragment={"targets": [{"format": form} for form in FORMATS.values()], "constants": kind.constants},
        primitive=_faces(kind.double_sided, kind.flipped),
        depth_stencil=_depth("greater", writes=True),
    )


@functools.cache
def motion(double_sided: bool, flipped: bool) -> Any:
    """Second pass: vectors, on the samples of the first."""
    return _pipeline(
        device.shader("geometry", "motion"),
        (layout("motion"), surface_layout()),
        vertex={"buffers": [_stream(k) for k in range(4)] + [_attributes(4, 1)]},
        fragment={"targets": [{"format": form} for form in VECTORS.values()]},
        primitive=_faces(double_sided, flipped),
        depth_stencil=_depth("equal", writes=False),
    )


@functools.cache
def sky_motion() -> Any:
    """Vectors where nothing was hit."""
    return _pipeline(
        device.shader("sky_motion"),
        (layout("uniform"),),
        fragment={"targets": [{"format": form} for form in VECTORS.values()]},
        primitive={"topology": "triangle-list"},
        depth_stencil=_depth("equal", writes=False),
    )


@functools.cache
def shadow(mask: bool) -> Any:
    """Depth as a light sees it; both sides of every surface cast shadows."""
    parts: dict = {"fragment": {}} if mask else {}
    return _pipeline(
        device.shader("geometry", "shadow"),
        (layout("view"), surface_layout(), layout("uniform")),
        vertex={"buffers": [_stream(0), _attributes(1, 3)]},
        primitive={"topology": "triangle-list", "cull_mode": "none"},
        depth_stencil=_depth("greater", writes=True),
        **parts,
    )


@functools.cache
def occlusion() -> Any:
    """Ambient occlusion."""
    return _pipeline(
        device.shader("lighting", "ambient_occlusion"),
        (layout("occlusion"), layout("nothing"), layout("lighting")),
        fragment={"targets": [{"format": OCCLUSION}]},
        primitive={"topology": "triangle-list"},
    )


@functools.cache
def light(surface: str) -> Any:
    """Lighting of the surfaces as they are ("now") or as they were one frame ago ("before")."""
    return _pipeline(
        device.shader("lighting", "shadow_lookup", "shade", f"surface_{surface}", "light"),
        (layout(surface), layout("nothing"), layout("lighting")),
        fragment={"targets": [{"format": LIT}]},
        primitive={"topology": "triangle-list"},
    )


@functools.cache
def glass(kind: Variant) -> Any:
    """Surfaces that let light through, lit while they are drawn over the picture."""
    add = {"src_factor": "src-alpha", "dst_factor": "one-minus-src-alpha", "operation": "add"}
    keep = {"src_factor": "zero", "dst_factor": "one", "operation": "add"}
    target = {"format": LIT, "blend": {"color": add, "alpha": keep}}
    return _pipeline(
        device.shader("geometry", "lighting", "shadow_lookup", "shade", "glass"),
        (layout("view"), surface_layout(), layout("lighting")),
        vertex={"buffers": [_stream(0), _attributes(1, 3)], "constants": kind.constants},
        fragment={"targets": [target], "constants": kind.constants},
        primitive=_faces(kind.double_sided, kind.flipped),
        depth_stencil=_depth("greater", writes=False),
    )


@functools.cache
def compute(name: str) -> Any:
    """A compute pass whose shader and layout share a name."""
    gpu = device.open_device()
    pipeline_layout = gpu.create_pipeline_layout(bind_group_layouts=[layout(name)])
    return gpu.create_compute_pipeline(
        layout=pipeline_layout, compute={"module": device.shader(name), "entry_point": "main"}
    )


def bind_streams(run: Any, draw: Draw, *, moments: tuple[int, ...], attributes: int) -> None:
    """Binds the vertex positions at the given places of STEPS, then the attributes at one of them."""
    for slot, moment in enumerate(moments):
        run.set_vertex_buffer(slot, draw.positions[moment])
    run.set_vertex_buffer(len(moments), draw.attributes[attributes])
    run.set_index_buffer(draw.indices, "uint32")
