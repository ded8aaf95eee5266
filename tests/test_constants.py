"""What an engine passes to an upscaler: the factors lead to the previous pixel, the flags say what the buffers are."""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from wall import FOV, H, W, wall, write_wall

from framecast.cli import main
from framecast.clip import Clip
from framecast.constants import TABLES, Constant, constants, phases
from framecast.importers.encode import encode_motion
from framecast.importers.settings import Color, Depth, Motion, Settings, plain

XY: dict[str, Any] = {"files": ("{frame}.exr",), "channels": ("X", "Y")}
Z: dict[str, Any] = {"files": ("{frame}.exr",), "channels": ("Z",)}


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Clip:
    return write_wall(tmp_path_factory.mktemp("wall") / "clip", 3)


def imported(clip: Clip, **fields: Any) -> Clip:
    """The clip as if it had been imported with these settings."""
    color = Color(files=("{frame}.exr",), channels=("R", "G", "B"))
    return replace(clip, provenance={"settings": plain(Settings(color=color, **fields))})


def named(rows: tuple[Constant, ...]) -> dict[str, Any]:
    assert all(row.why for row in rows)
    found = {row.name: row.value for row in rows}
    assert len(found) == len(rows)
    return found


STORED = [
    Motion(**XY),
    Motion(**XY, direction="previous->current", sign=(1.0, -1.0)),
    Motion(**XY, units="uv", direction="previous->current"),
    Motion(**XY, units="ndc", sign=(1.0, -1.0), scale=(2.0, 4.0)),
    Motion(**XY, size=(2 * W, 2 * H)),
]


@pytest.mark.parametrize("motion", STORED)
def test_stored_vectors_times_the_factor_are_what_each_interface_wants(clip: Clip, motion: Motion) -> None:
    wanted, shot = wall(2)["motion"], imported(clip, motion=motion)
    stored = encode_motion(wanted, motion)

    def factor(api: str, name: str) -> np.ndarray:
        return np.array(named(constants(shot, api))[name])[:, None, None]

    size = np.array([W, H])[:, None, None]
    for api, name in (
        ("fsr3", "motionVectorScale"),
        ("dlss", "InMVScaleX, InMVScaleY"),
        ("xess", "xessSetVelocityScale"),
    ):
        np.testing.assert_allclose(stored * factor(api, name), wanted, rtol=1e-5, atol=1e-5)  # render pixels
    np.testing.assert_allclose(stored * factor("streamline", "mvecScale") * size, wanted, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(stored * factor("arm", "motion") * size, wanted, rtol=1e-5, atol=1e-5)  # uv


def test_streamline_and_ngx_scale_in_opposite_directions(clip: Clip) -> None:
    """A clip's own vectors are pixels: NGX wants 1, Streamline one over the size."""
    assert named(constants(clip, "dlss"))["InMVScaleX, InMVScaleY"] == [1, 1]
    assert named(constants(clip, "streamline"))["mvecScale"] == [1 / W, pytest.approx(1 / H)]


@pytest.mark.parametrize(
    ("scale", "fsr", "others"), [(1.0, 8, 8), (1.5, 18, 18), (1.7, 23, 24), (2.0, 32, 32), (3.0, 72, 72)]
)
def test_jitter_phases(clip: Clip, scale: float, fsr: int, others: int) -> None:
    counts = {api: named(constants(clip, api, scale=scale))["jitter phases"] for api in TABLES if api != "arm"}
    assert counts == {"fsr3": fsr, "dlss": others, "streamline": others, "xess": others}
    assert named(constants(clip, "arm", scale=scale))["Samples.Count"] == others == phases(scale)


def test_mip_bias(clip: Clip) -> None:
    for scale in (1.5, 2.0, 3.0):
        found = {api: named(constants(clip, api, scale=scale))["mip bias"] for api in ("fsr3", "xess", "dlss")}
        assert found["xess"] == found["dlss"] == pytest.approx(math.log2(1 / scale), abs=1e-5)
        assert found["fsr3"] == pytest.approx(math.log2(1 / scale) - 1, abs=1e-5)


@pytest.mark.parametrize(
    ("depth", "inverted", "infinite"),
    [
        (Depth(**Z, kind="device", near=0.1, far=100.0), False, False),
        (Depth(**Z, kind="device", near=0.1), False, True),
        (Depth(**Z, kind="reversed", near=0.1, far=100.0), True, False),
        (Depth(**Z, kind="reversed", near=0.1), True, True),
    ],
)
def test_depth_flags_of_device_depth(clip: Clip, depth: Depth, inverted: bool, infinite: bool) -> None:
    shot = imported(clip, motion=STORED[0], depth=depth)
    fsr = named(constants(shot, "fsr3"))
    assert fsr["FFX_UPSCALE_ENABLE_DEPTH_INVERTED"] is inverted
    assert fsr["FFX_UPSCALE_ENABLE_DEPTH_INFINITE"] is infinite
    planes = ("FLT_MAX", 0.1) if inverted and infinite else (0.1, depth.far or "FLT_MAX")
    assert (fsr["cameraNear"], fsr["cameraFar"]) == planes
    assert named(constants(shot, "dlss"))["NVSDK_NGX_DLSS_Feature_Flags_DepthInverted"] is inverted
    assert named(constants(shot, "streamline"))["depthInverted"] is inverted
    assert named(constants(shot, "xess"))["XESS_INIT_FLAG_INVERTED_DEPTH"] is inverted
    arm = named(constants(shot, "arm"))
    assert (arm["ReverseZ"], arm["CameraFarPlane"]) == (inverted, depth.far or -1)
    assert "prepare depth" not in fsr


def test_linear_depth_is_to_be_written_as_a_depth_buffer(clip: Clip) -> None:
    fsr = named(constants(clip, "fsr3"))
    assert fsr["prepare depth"] == "near / z"
    assert fsr["FFX_UPSCALE_ENABLE_DEPTH_INVERTED"] is fsr["FFX_UPSCALE_ENABLE_DEPTH_INFINITE"] is True
    arm = named(constants(clip, "arm"))
    assert arm["prepare depth"] == "1 - near / z"
    assert arm["ReverseZ"] is False
    inverse = imported(clip, depth=Depth(**Z, kind="inverse"))
    assert named(constants(inverse, "xess"))["prepare depth"] == "near * v"


def test_what_no_factor_undoes_is_said_first(clip: Clip) -> None:
    assert "prepare motion" not in named(constants(clip, "fsr3"))
    codes = Motion(**XY, units="ndc", bias=(0.5, 0.5), packing="unreal_sqrt", unwritten=0.0)
    for api in TABLES:
        first = constants(imported(clip, motion=codes), api)[0]
        assert first.name == "prepare motion"
        assert first.value.startswith("subtract 0.5, 0.5; replace w by w |w| / 2; add the camera's motion")


def test_flags_and_times(clip: Clip) -> None:
    jittered = imported(clip, motion=replace(STORED[0], jittered=True))
    assert named(constants(jittered, "dlss"))["NVSDK_NGX_DLSS_Feature_Flags_MVJittered"] is True
    assert named(constants(clip, "dlss"))["NVSDK_NGX_DLSS_Feature_Flags_MVJittered"] is False
    fsr = named(constants(clip, "fsr3"))
    assert fsr["frameTimeDelta"] == pytest.approx(1000 / 30, rel=1e-5)  # milliseconds
    assert fsr["cameraFovAngleVertical"] == pytest.approx(FOV)
    assert fsr["reset"] == [10]
    assert fsr["jitterOffset"] == "-jitter"
    still = imported(clip, motion=replace(STORED[0], camera=False))
    assert named(constants(still, "streamline"))["cameraMotionIncluded"] is False


def test_the_command(clip: Clip, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["constants", str(clip.path), "--for", "xess", "--scale", "2"]) == 0
    text = capsys.readouterr().out
    assert "xessSetVelocityScale = [1.0, 1.0]\n    stored vectors are pixels" in text
    assert main(["constants", str(clip.path), "--for", "xess", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert {"name", "value", "why"} == set(rows[0])
    assert main(["constants", str(clip.path), "--for", "xess", "--scale", "0.5"]) == 2
    assert "a scale of 0.5 was asked for" in capsys.readouterr().err
    assert main(["constants", str(tmp_path), "--for", "xess"]) == 2
    with pytest.raises(ValueError, match="metalfx is not known; there are fsr3, dlss"):
        constants(clip, "metalfx")
