"""The numbers and flags that an engine passes to an upscaler for buffers like these: `framecast constants`.

Buffers are meant as their engine stores them, where the clip was imported with settings, else as a clip stores them:
vectors in pixels from the current to the previous frame, y down, and linear depth. Each number comes with the sentence
that explains it. Sources: the public interface headers and guides of FSR 2 and 3, DLSS (NGX), Streamline, XeSS, and
the specification of Arm's data.
"""

import json
import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from tyro.conf import Positional, arg

from framecast.clip import Clip
from framecast.importers import open_any
from framecast.importers.settings import Depth, Motion, Settings, parsed

Name = Literal["fsr3", "dlss", "streamline", "xess", "arm"]


PIXELS = "after this factor they are render pixels from the current to the previous frame, y down"


@dataclass(frozen=True)
class Constant:
    """One number or flag."""

    name: str
    value: Any
    """A number, a pair, a boolean, or text where the value is a formula or changes every frame."""
    why: str


@dataclass(frozen=True)
class Buffers:
    """What the numbers depend on."""

    clip: Clip
    motion: Motion
    depth: Depth | None
    """None: linear distance, as a clip stores it."""
    ratio: float
    """Display size over render size, per axis."""

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the rendered frames."""
        return self.clip.size[1], self.clip.size[0]

    @property
    def to_pixels(self) -> tuple[float, float]:
        """What a stored vector is multiplied by to lead to the previous frame in render pixels, y down."""
        width, height = self.size
        own = self.motion.size or (width, height)
        unit = {
            "pixels": (width / own[0], height / own[1]),
            "uv": (width, height),
            "ndc": (width / 2, height / 2),
        }[self.motion.units]
        turned = -1.0 if self.motion.direction == "previous->current" else 1.0
        x, y = (u * s * c * turned for u, s, c in zip(unit, self.motion.sign, self.motion.scale, strict=True))
        return x, y


def constants(clip: Clip, api: str, *, scale: float | None = None) -> tuple[Constant, ...]:
    """Numbers and flags of one interface.

    Args:
        api: fsr3, dlss, streamline, xess or arm.
        scale: display size over render size; None: that of the clip's references, or 2.

    Raises:
        ValueError: an unknown interface, or a scale below 1.
    """
    if api not in TABLES:
        raise ValueError(f"{api} is not known; there are {', '.join(TABLES)}")
    ratio = scale if scale is not None else clip.scale or 2.0
    if not 1 <= ratio <= 16:
        raise ValueError(f"a scale of {ratio:g} was asked for; display over render size lies between 1 and 16")
    told = clip.provenance.get("settings")
    settings = parsed(told) if told else Settings()
    motion = settings.motion or Motion(files=("",), channels=("",))
    buffers = Buffers(clip, motion, settings.depth, ratio)
    return (*_preparation(buffers), *TABLES[api](buffers))


def _preparation(buffers: Buffers) -> tuple[Constant, ...]:
    """What no interface can undo with a factor."""
    motion = buffers.motion
    steps = []
    if motion.packing in ("base255", "base256"):
        steps.append(f"unpack {motion.packing}")
    if any(motion.bias):
        steps.append(f"subtract {motion.bias[0]:.6g}, {motion.bias[1]:.6g}")
    if motion.packing == "unreal_sqrt":
        steps.append("replace w by w |w| / 2")
    if "next" in motion.direction:
        steps.append("write vectors that lead to the previous frame: these lead to the next one")
    if not motion.camera or motion.unwritten is not None:
        steps.append("add the camera's motion where none was written")
    if not steps:
        return ()
    why = "every interface multiplies vectors, none subtracts: do this in a pass of your own, before the factors below"
    return (Constant("prepare motion", "; ".join(steps), why),)


def _pair(x: float, y: float) -> list[float]:
    return [float(f"{x:.8g}"), float(f"{y:.8g}")]


def phases(ratio: float) -> int:
    """Jitter phases that give each display pixel as many samples as 8 do without upsampling: 8 ratio², rounded up."""
    return math.ceil(8 * ratio * ratio - 1e-9)


def _jitter(name: str, why: str = "") -> Constant:
    text = (
        "by how much the projection moves the picture, in render pixels, x right, y down: minus the sample position "
        "(clip.json's jitter). Add (2 x / w, -2 y / h) to NDC of the projection."
    )
    return Constant(name, "-jitter", f"{text} {why}".strip())


def _inverted(buffers: Buffers) -> bool:
    return buffers.depth is None or buffers.depth.kind == "reversed"


def _device(buffers: Buffers) -> bool:
    return buffers.depth is not None and buffers.depth.kind in ("device", "reversed")


def _write_depth(buffers: Buffers, *, forward: bool = False) -> tuple[Constant, ...]:
    """How to make the depth that is expected from the one that is there."""
    if _device(buffers):
        return ()
    kind = buffers.depth.kind if buffers.depth else "planar"
    near = "near * v" if kind == "inverse" else "near / z"
    formula = f"1 - {near}" if forward else near
    why = f"depth is {kind}; what is read is a depth buffer with an infinite far plane, {int(forward)} at the sky"
    return (Constant("prepare depth", formula, why),)


def _fov(buffers: Buffers) -> tuple[float, float] | None:
    """Vertical field of view in radians, and near plane; None where no camera is known."""
    matrix = buffers.clip.records[0].projection
    if matrix is None or matrix[3][3] != 0:
        return None
    near = buffers.depth.near if buffers.depth and buffers.depth.near else _near(np.asarray(matrix))
    return 2 * math.atan(1 / matrix[1][1]), float(f"{near:.6g}")


def _near(p: np.ndarray) -> float:
    a, b = float(p[2, 2]), float(p[2, 3])
    near = b / a if a < -0.5 else b / (1 + a)
    return near if near > 0 else 0.1


def _frame_time(buffers: Buffers, name: str) -> Constant:
    value = float(f"{1000 / buffers.clip.fps:.6g}")
    return Constant(name, value, "milliseconds since the frame before; given in seconds, history never settles")


def _reset(buffers: Buffers, name: str) -> Constant:
    clip = buffers.clip
    cuts = [clip.shown[i].number for i in range(len(clip)) if clip.is_cut(i)]
    return Constant(name, cuts, "true in these frames only: the first, and the first after each cut")


def _mip(buffers: Buffers, less: float, why: str) -> Constant:
    return Constant("mip bias", float(f"{-math.log2(buffers.ratio) - less:.6g}"), why)


def _units(buffers: Buffers) -> str:
    motion = buffers.motion
    along = "down" if motion.sign[1] > 0 else "up"
    return f"stored vectors are {motion.units}, {motion.direction}, y {along}"


def _fsr3(buffers: Buffers) -> list[Constant]:
    exact = 8 * buffers.ratio**2
    count = int(exact + 1e-9)
    guide = f"; the guide rounds up ({phases(buffers.ratio)})" if phases(buffers.ratio) != count else ""
    infinite = buffers.depth is None or buffers.depth.far is None or not _device(buffers)
    reverse = _inverted(buffers) or not _device(buffers)
    fov = _fov(buffers)
    rows = [
        Constant(
            "motionVectorScale",
            _pair(*buffers.to_pixels),
            f"{_units(buffers)}; {PIXELS}",
        ),
        Constant(
            "FFX_UPSCALE_ENABLE_MOTION_VECTORS_JITTER_CANCELLATION",
            buffers.motion.jittered,
            "set only where the jitter is in the vectors; better take it out, the flag's sign has been wrong",
        ),
        Constant(
            "FFX_UPSCALE_ENABLE_DISPLAY_RESOLUTION_MOTION_VECTORS",
            False,
            "vectors have the size of the rendered frames",
        ),
        _jitter("jitterOffset", "AMD's sample passes a negated one: go by the rule, not by the sample's sign."),
        Constant(
            "jitter phases",
            count,
            f"Halton(2, 3), from the second entry, minus 1/2: int(8 x {buffers.ratio:g}²){guide}",
        ),
        _mip(buffers, 1, "log2(render / display) - 1 for every material texture"),
        *_write_depth(buffers),
        Constant(
            "FFX_UPSCALE_ENABLE_DEPTH_INVERTED",
            reverse,
            "whether 1 is near; recommended, together with an infinite far plane",
        ),
        Constant("FFX_UPSCALE_ENABLE_DEPTH_INFINITE", infinite, "whether the far plane is infinite"),
        Constant("FFX_UPSCALE_ENABLE_HIGH_DYNAMIC_RANGE", True, "colour is linear and goes beyond 1"),
        *_exposure(buffers, "preExposure", "FFX_UPSCALE_ENABLE_AUTO_EXPOSURE"),
        _frame_time(buffers, "frameTimeDelta"),
        Constant("viewSpaceToMetersFactor", *_metres(buffers)),
        _reset(buffers, "reset"),
    ]
    if fov is not None:
        flipped = "the greatest float, and cameraFar is this near plane" if reverse and infinite else "the near plane"
        rows += [
            Constant("cameraFovAngleVertical", float(f"{fov[0]:.8g}"), "radians"),
            Constant("cameraNear", "FLT_MAX" if reverse and infinite else fov[1], f"with these depth flags {flipped}"),
            Constant("cameraFar", fov[1] if reverse and infinite else _far(buffers), "in scene units"),
        ]
    return rows


def _far(buffers: Buffers) -> Any:
    return buffers.depth.far if buffers.depth and buffers.depth.far else "FLT_MAX"


def _metres(buffers: Buffers) -> tuple[Any, str]:
    if buffers.clip.provenance.get("source") == "unreal":
        return 1.0, "distances given here are metres; 0.01 with distances in Unreal's centimetres"
    return 1.0, "scene units were taken for metres; 0.01 where they are centimetres"


def _exposure(buffers: Buffers, name: str, automatic: str | None) -> list[Constant]:
    values = sorted({record.exposure for record in buffers.clip.shown})
    held = values[0] if len(values) == 1 else "exposure of each frame"
    rows = [Constant(name, held, "factor that is in colour already, divided out first; 1 where there is none")]
    if automatic:
        why = "no exposure texture comes with these buffers; a wrong one looks like ghosting in dim light"
        rows.append(Constant(automatic, True, why))
    return rows


def _dlss(buffers: Buffers) -> list[Constant]:
    width, height = buffers.size
    reverse = _inverted(buffers) or not _device(buffers)
    return [
        Constant(
            "InMVScaleX, InMVScaleY",
            _pair(*buffers.to_pixels),
            f"{_units(buffers)}; NGX wants render pixels after this factor. Streamline's mvecScale goes the other way, "
            f"to -1..1: do not copy it from there",
        ),
        Constant("NVSDK_NGX_DLSS_Feature_Flags_MVLowRes", True, "vectors have the size of the rendered frames"),
        Constant(
            "NVSDK_NGX_DLSS_Feature_Flags_MVJittered", buffers.motion.jittered, "whether the jitter is in the vectors"
        ),
        _jitter(
            "InJitterOffsetX, InJitterOffsetY", "A still camera over a still scene shakes where the sign is wrong."
        ),
        Constant("jitter phases", phases(buffers.ratio), "8 (display / render)², at least"),
        _mip(buffers, 0, "log2(render / display), added to the bias that a texture has"),
        *_write_depth(buffers),
        Constant("NVSDK_NGX_DLSS_Feature_Flags_DepthInverted", reverse, "whether 1 is near"),
        Constant("NVSDK_NGX_DLSS_Feature_Flags_IsHDR", True, "colour is linear and goes beyond 1"),
        *_exposure(buffers, "InPreExposure", "NVSDK_NGX_DLSS_Feature_Flags_AutoExposure"),
        Constant("InRenderSubrectDimensions", [width, height], "the part of the buffers that is the picture"),
        _frame_time(buffers, "InFrameTimeDeltaInMsec"),
        _reset(buffers, "InReset"),
    ]


def _streamline(buffers: Buffers) -> list[Constant]:
    width, height = buffers.size
    x, y = buffers.to_pixels
    reverse = _inverted(buffers) or not _device(buffers)
    rows = [
        Constant(
            "mvecScale",
            _pair(x / width, y / height),
            f"{_units(buffers)}; Streamline wants -1..1 after this factor, {{1/w, 1/h}} for pixels; "
            f"NGX's InMVScale goes the other way, to pixels",
        ),
        Constant("cameraMotionIncluded", buffers.motion.camera, "whether the camera's motion is in the vectors"),
        Constant("motionVectorsJittered", buffers.motion.jittered, "whether the jitter is in the vectors"),
        Constant("motionVectors3D", False, "vectors have two components"),
        Constant(
            "motionVectorsDilated", False, "vectors belong to their own pixel, not to the nearest of its neighbours"
        ),
        _jitter("jitterOffset"),
        Constant("jitter phases", phases(buffers.ratio), "8 (display / render)², at least"),
        _mip(buffers, 0, "log2(render / display), added to the bias that a texture has"),
        *_write_depth(buffers),
        Constant("depthInverted", reverse, "whether 1 is near"),
        Constant("cameraViewToClip, clipToPrevClip", "unjittered, row-major", "no jitter in any matrix"),
        Constant("orthographicProjection", _orthographic(buffers), "from the projection of the first frame"),
        _reset(buffers, "reset"),
    ]
    fov = _fov(buffers)
    if fov is not None:
        rows += [
            Constant("cameraFOV", float(f"{fov[0]:.8g}"), "vertical, radians"),
            Constant("cameraNear", fov[1], "in scene units"),
        ]
    return rows


def _orthographic(buffers: Buffers) -> bool:
    matrix = buffers.clip.records[0].projection
    return matrix is not None and matrix[3][3] != 0


def _xess(buffers: Buffers) -> list[Constant]:
    reverse = _inverted(buffers) or not _device(buffers)
    return [
        Constant(
            "xessSetVelocityScale",
            _pair(*buffers.to_pixels),
            f"{_units(buffers)}; {PIXELS}",
        ),
        Constant("XESS_INIT_FLAG_USE_NDC_VELOCITY", False, "vectors are pixels after the factor above"),
        Constant(
            "XESS_INIT_FLAG_HIGH_RES_MV", False, "vectors have the size of the rendered frames; depth is needed then"
        ),
        Constant("XESS_INIT_FLAG_JITTERED_MV", buffers.motion.jittered, "whether the jitter is in the vectors"),
        _jitter("jitterOffsetX, jitterOffsetY", "In row-vector matrices: P[2][0] += 2 x / w, P[2][1] -= 2 y / h."),
        Constant("jitter phases", phases(buffers.ratio), "Halton, at least 8 (display / render)²"),
        _mip(buffers, 0, "log2(render / display), without FSR's further -1"),
        *_write_depth(buffers),
        Constant("XESS_INIT_FLAG_INVERTED_DEPTH", reverse, "whether 1 is near"),
        Constant("XESS_INIT_FLAG_LDR_INPUT_COLOR", False, "colour is linear and goes beyond 1"),
        *_exposure(buffers, "exposure in colour", "XESS_INIT_FLAG_ENABLE_AUTOEXPOSURE"),
        _reset(buffers, "resetHistory"),
    ]


def _arm(buffers: Buffers) -> list[Constant]:
    width, height = buffers.size
    x, y = buffers.to_pixels
    reverse = _device(buffers) and _inverted(buffers)
    rows = [
        Constant(
            "motion",
            _pair(x / width, y / height),
            f"{_units(buffers)}; after this factor uv of the last frame = uv + motion, 0..1 over the image, y down",
        ),
        Constant("Jitter", "jitter", "in render pixels; `NormalizedPerRatioJitter` is the same over the render size"),
        Constant("Samples.Count", phases(buffers.ratio), "positions of the sequence; `Quantized` where tiled"),
        *_write_depth(buffers, forward=True),
        Constant(
            "ReverseZ", reverse, "forward depth is preferred" if not reverse else "1 is near; forward is preferred"
        ),
        Constant("EmulatedFramerate", round(buffers.clip.fps), "frames a second"),
        *_exposure(buffers, "Exposure", None),
        _reset(buffers, "CameraCut"),
    ]
    fov = _fov(buffers)
    if fov is not None:
        aspect = width / height
        rows += [
            Constant("FovY", float(f"{fov[0]:.8g}"), "radians"),
            Constant("FovX", float(f"{2 * math.atan(math.tan(fov[0] / 2) * aspect):.8g}"), "radians"),
            Constant("CameraNearPlane", fov[1], "metres; the plug-in for Unreal writes centimetres"),
            Constant(
                "CameraFarPlane", buffers.depth.far if buffers.depth and buffers.depth.far else -1.0, "-1: infinite"
            ),
        ]
    return rows


TABLES: dict[str, Callable[[Buffers], list[Constant]]] = {
    "fsr3": _fsr3,
    "dlss": _dlss,
    "streamline": _streamline,
    "xess": _xess,
    "arm": _arm,
}


def command(
    clip: Positional[Path],
    api: Annotated[Name, arg(name="for")],
    scale: float | None = None,
    json: bool = False,
) -> None:
    """Print what an engine passes to an upscaler for buffers like these, and why.

    Args:
        clip: a clip, or a folder that can be imported.
        api: the upscaler's interface.
        scale: display size over render size; by default that of the clip's references, or 2.
        json: print JSON.
    """
    rows = constants(open_any(clip), api, scale=scale)
    print(as_json(rows) if json else as_text(rows))


def as_json(rows: tuple[Constant, ...]) -> str:
    """A list of objects with name, value and why."""
    return json.dumps([asdict(row) for row in rows], indent=1)


def as_text(rows: tuple[Constant, ...]) -> str:
    """Two lines a constant."""
    return "\n".join(f"{row.name} = {json.dumps(row.value)}\n    {row.why}" for row in rows)
