"""The GPU: opening it, and moving arrays there and back. Everything of wgpu that the passes share."""

import functools
from importlib import resources
from typing import Any

import numpy as np

import framecast.shaders
from framecast.exr import silenced

Array = np.ndarray

LIMITS = {
    "max-color-attachments": 8,
    "max-color-attachment-bytes-per-sample": 32,
    "max-storage-textures-per-shader-stage": 4,
    "max-storage-buffers-per-shader-stage": 8,
    "max-sampled-textures-per-shader-stage": 16,
    "max-bind-groups": 4,
    "max-vertex-buffers": 8,
    "max-vertex-attributes": 16,
    "max-inter-stage-shader-variables": 16,
}
"""What every WebGPU browser grants; asked for explicitly, so that no shader here can need more."""

MISSING = (
    "no Vulkan, Metal or D3D12 driver was found; on a machine without a GPU install Mesa's software driver: "
    "apt install mesa-vulkan-drivers libvulkan1"
)


@functools.cache
def open_device() -> Any:
    """The process's `wgpu.GPUDevice` with web limits.

    Raises:
        FileNotFoundError: wgpu or a driver is missing; the message names the package.
    """
    try:
        import wgpu
    except ImportError as error:
        raise FileNotFoundError("rendering needs wgpu; install it: pip install 'framecast[render]'") from error
    with silenced():  # drivers report a missing display while adapters are listed, which is not news here
        found = [
            a for a in wgpu.gpu.enumerate_adapters_sync() if a.info["backend_type"] in ("Vulkan", "Metal", "D3D12")
        ]
        if not found:
            raise FileNotFoundError(MISSING)
        best = min(found, key=lambda a: _ORDER.get(a.info["adapter_type"], 9))
        return best.request_device_sync(required_limits=LIMITS)


_ORDER = {"DiscreteGPU": 0, "IntegratedGPU": 1, "VirtualGPU": 2, "CPU": 3}


def adapter_name() -> str:
    """Device and driver, as written to `clip.json`: the same name promises the same bits."""
    info = open_device().adapter.info
    return f"{info['device']} ({info['backend_type']}, {info['description']})"


@functools.cache
def shader(*names: str) -> Any:
    """Shader module made of the named WGSL files, joined in order: shared functions first, the pass last."""
    folder = resources.files(framecast.shaders)
    code = "\n".join((folder / f"{name}.wgsl").read_text(encoding="utf-8") for name in names)
    return open_device().create_shader_module(label="+".join(names), code=code)


def buffer(data: Array, usage: str) -> Any:
    """GPU buffer with the bytes of `data`; `usage` as in WebGPU, such as "VERTEX|COPY_DST". Padded to 16 bytes."""
    raw = np.ascontiguousarray(data).tobytes()
    return open_device().create_buffer_with_data(data=raw + b"\0" * (-len(raw) % 16 or 16 * (not raw)), usage=usage)


def write(target: Any, data: Array) -> None:
    """Overwrites the beginning of a buffer. Later submissions see it, earlier ones do not."""
    raw = np.ascontiguousarray(data).tobytes()
    open_device().queue.write_buffer(target, 0, raw + b"\0" * (-len(raw) % 4))


def target(size: tuple[int, int], form: str, *, layers: int = 1) -> Any:
    """Texture (height, width) to draw into, read in a shader and copy back."""
    height, width = size
    return open_device().create_texture(
        size=(width, height, layers), format=form, usage="RENDER_ATTACHMENT|TEXTURE_BINDING|COPY_SRC|COPY_DST"
    )


def layer(texture: Any, index: int) -> Any:
    """View of one layer of an array texture."""
    return texture.create_view(dimension="2d", base_array_layer=index, array_layer_count=1)


def stack(texture: Any) -> Any:
    """View of all layers, as an array even if there is one."""
    return texture.create_view(dimension="2d-array")


_BYTES = {"rgba8": (np.uint8, 4), "rgba16": (np.float16, 4), "rg16": (np.float16, 2), "rg32": (np.float32, 2)}
_BYTES |= {"r32u": (np.uint32, 1), "depth": (np.float32, 1), "r32f": (np.float32, 1), "r16f": (np.float16, 1)}


def _element(form: str) -> tuple[type, int]:
    return next(value for key, value in _BYTES.items() if form.startswith(key))


def upload(levels: list[Array], form: str, *, layers: int = 1) -> Any:
    """Sampled texture from its mip levels, each (h, w, channels), or (layers * h, w, channels) for an array."""
    dtype, channels = _element(form)
    height, width = levels[0].shape[0] // layers, levels[0].shape[1]
    device = open_device()
    texture = device.create_texture(
        size=(width, height, layers), format=form, usage="TEXTURE_BINDING|COPY_DST", mip_level_count=len(levels)
    )
    for index, level in enumerate(levels):
        data: Array = np.ascontiguousarray(level, dtype=dtype)
        rows, columns = data.shape[0] // layers, data.shape[1]
        layout = {"bytes_per_row": columns * channels * data.itemsize, "rows_per_image": rows}
        device.queue.write_texture({"texture": texture, "mip_level": index}, data, layout, (columns, rows, layers))
    return texture


def read(texture: Any) -> Array:
    """The first layer of a texture as (h, w, channels); waits for the GPU."""
    dtype, channels = _element(texture.format)
    width, height = texture.size[:2]
    pitch = -(-width * channels * np.dtype(dtype).itemsize // 256) * 256
    data = open_device().queue.read_texture(
        {"texture": texture, "aspect": "depth-only" if texture.format.startswith("depth") else "all"},
        {"bytes_per_row": pitch, "rows_per_image": height},
        (width, height, 1),
    )
    rows = np.frombuffer(data, np.uint8).reshape(height, pitch)[:, : width * channels * np.dtype(dtype).itemsize]
    return np.ascontiguousarray(rows).view(dtype).reshape(height, width, channels)


def read_floats(source: Any, shape: tuple[int, ...]) -> Array:
    """A buffer of 32-bit floats as an array; waits for the GPU."""
    data = open_device().queue.read_buffer(source, size=4 * int(np.prod(shape)))
    return np.frombuffer(data, np.float32).reshape(shape)


def bind(layout: Any, *resources_: Any) -> Any:
    """Bind group whose entry k is the k-th resource: a buffer, a texture, a texture view or a sampler."""
    entries = []
    for index, item in enumerate(resources_):
        kind = type(item).__name__
        if kind == "GPUBuffer":
            item = {"buffer": item, "offset": 0, "size": item.size}
        elif kind == "GPUTexture":
            item = item.create_view()
        entries.append({"binding": index, "resource": item})
    return open_device().create_bind_group(layout=layout, entries=entries)


@functools.cache
def sampler(kind: str) -> Any:
    """`clamp` and `repeat` (trilinear; `+` anisotropic), `plain`, `sky` (repeats in x only) or `shadow` (comparing)."""
    device, linear = open_device(), {"mag_filter": "linear", "min_filter": "linear"}
    if kind == "shadow":
        return device.create_sampler(compare="greater-equal", **linear)
    if kind == "plain":
        return device.create_sampler(**linear)
    if kind == "sky":
        return device.create_sampler(address_mode_u="repeat", mipmap_filter="linear", **linear)
    mode = {"clamp": "clamp-to-edge", "repeat": "repeat"}[kind.rstrip("+")]
    return device.create_sampler(
        address_mode_u=mode,
        address_mode_v=mode,
        mipmap_filter="linear",
        max_anisotropy=8 if kind.endswith("+") else 1,
        **linear,
    )
