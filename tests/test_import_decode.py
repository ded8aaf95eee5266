"""What stored numbers mean, by values that can be worked out by hand."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from framecast.clip import Record
from framecast.exr import ClipError
from framecast.frame import SKY, perspective
from framecast.importers.decode import (
    AXES,
    decode,
    decode_depth,
    decode_jitter,
    decode_motion,
    decode_normal,
)
from framecast.importers.settings import (
    Color,
    Depth,
    Jitter,
    Motion,
    Normal,
    Scalar,
    Settings,
)

AT: dict[str, Any] = {"files": ("{frame}.exr",)}
XY = {**AT, "channels": ("X", "Y")}
FOUR = {**AT, "channels": tuple("RGBA")}
H, W = 6, 10


def rows(matrix: torch.Tensor) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(float(v) for v in row) for row in matrix.double())


LENS = rows(perspective(0.9, W / H))


def view(angle: float = 0.3) -> tuple[tuple[float, ...], ...]:
    c, s = float(np.cos(angle)), float(np.sin(angle))
    return ((c, 0.0, s, 0.5), (0.0, 1.0, 0.0, -1.0), (-s, 0.0, c, -4.0), (0.0, 0.0, 0.0, 1.0))


def one(*values: float) -> np.ndarray:
    return np.array(values, np.float32)[:, None, None] * np.ones((1, 4, 8), np.float32)


@pytest.mark.parametrize(
    ("motion", "stored", "pixels"),
    [
        (Motion(**XY), (3, -2), (3, -2)),
        (Motion(**XY, direction="previous->current", sign=(1.0, -1.0)), (3, 2), (-3, 2)),  # ExtraNet
        (Motion(**XY, units="uv"), (0.5, 0.25), (4, 1)),  # FSR, Arm: current to previous, y down
        (Motion(**XY, units="ndc"), (0.5, 0.5), (2, 1)),
        (Motion(**XY, size=(16, 8)), (3, -2), (1.5, -1)),  # pixels of an image twice the size
        (  # Unreal's velocity target: current minus previous, y up, half the image is 1
            Motion(
                **XY,
                units="ndc",
                direction="previous->current",
                sign=(1.0, -1.0),
                bias=(32767 / 65535, 32767 / 65535),
                scale=(1 / 0.2495, 1 / 0.2495),
            ),
            (0.5 * 0.2495 + 32767 / 65535, -0.25 * 0.2495 + 32767 / 65535),
            (-2, -0.5),
        ),
        (  # the same through the square root: 2 / sqrt(2) * sqrt(0.5) = 1
            Motion(**XY, units="ndc", direction="previous->current", sign=(1.0, -1.0), packing="unreal_sqrt"),
            (1.0, -1.0),
            (-2, -1),
        ),
    ],
)
def test_vectors_by_hand(motion: Motion, stored: tuple[float, float], pixels: tuple[float, float]) -> None:
    np.testing.assert_allclose(decode_motion(one(*stored), motion, (4, 8)), one(*pixels), atol=1e-4)


def test_jitter_in_vectors_is_taken_out_as_rasters_move() -> None:
    """A point that stands still, rastered with two jitters, seems to move by their difference."""
    here, before = (0.25, -0.375), (-0.5, 0.125)
    point = np.array([3.0, 2.0])
    raster_here, raster_before = point - here, point - before  # the sample of a pixel lies at its centre + jitter
    stored = one(*(raster_before - raster_here))
    motion = Motion(**XY, jittered=True)
    shift = (before[0] - here[0], before[1] - here[1])
    np.testing.assert_allclose(decode_motion(stored, motion, (4, 8), shift), one(0, 0), atol=1e-6)


def test_where_nothing_was_written_the_camera_moved() -> None:
    motion = Motion(**XY, bias=(0.5, 0.5), unwritten=0.0)
    stored = one(0.5, 1.5)
    stored[:, 0] = 0
    found = decode_motion(stored, motion, (4, 8), camera=one(7, -7))
    np.testing.assert_array_equal(found[:, 0], one(7, -7)[:, 0])
    np.testing.assert_array_equal(found[:, 1:], one(0, 1)[:, 1:])
    np.testing.assert_array_equal(decode_motion(stored, motion, (4, 8))[:, 0], one(0, 0)[:, 0])
    apart = replace(motion, camera=False, unwritten=None)
    np.testing.assert_array_equal(decode_motion(one(0.5, 1.5), apart, (4, 8), camera=one(7, -7)), one(7, -6))
    with pytest.raises(ClipError, match="lack the camera's part"):
        decode_motion(stored, apart, (4, 8))


@pytest.mark.parametrize(
    ("depth", "stored", "distance"),
    [
        (Depth(**AT, channels=("Z",)), 7, 7),
        (Depth(**AT, channels=("Z",)), 0, SKY),
        (Depth(**AT, channels=("Z",)), float("inf"), SKY),
        (Depth(**AT, channels=("Z",), scale=0.01), 700, 7),  # centimetres
        (Depth(**AT, channels=("Z",), kind="reversed", near=0.1), 0.025, 4),
        (Depth(**AT, channels=("Z",), kind="reversed", near=0.1), 0, SKY),
        (Depth(**AT, channels=("Z",), kind="reversed", near=1.0, far=101.0), 1, 1),
        (Depth(**AT, channels=("Z",), kind="reversed", near=1.0, far=101.0), 0, SKY),
        (Depth(**AT, channels=("Z",), kind="device", near=0.1), 0.975, 4),
        (Depth(**AT, channels=("Z",), kind="device", near=0.1), 1, SKY),
        (Depth(**AT, channels=("Z",), kind="device", near=1.0, far=3.0), 0.75, 2),  # far (z - near) / (z (far - near))
        (
            Depth(**AT, channels=("Z",), kind="device", near=0.1, bias=-1.0, scale=0.5),
            0.95,
            4,
        ),  # -1..1, as OpenGL's NDC
        (Depth(**AT, channels=("Z",), kind="inverse"), 0.25, 4),
        (Depth(**AT, channels=("Z",), kind="unit", far=100.0), 0.04, 4),
        (Depth(**AT, channels=("Z",), kind="unit", far=100.0, bias=1.0, scale=-1.0), 0.96, 4),  # white is near
        (Depth(**AT, channels=("Z",), kind="unit", far=100.0), 1, SKY),
        (Depth(**FOUR, packing="base255", scale=10.0), None, 4),
    ],
)
def test_depth_by_hand(depth: Depth, stored: float | None, distance: float) -> None:
    values = one(102 / 255, 0, 0, 0) if stored is None else one(stored)
    np.testing.assert_allclose(decode_depth(values, depth), one(distance), rtol=1e-5)


def test_depth_along_the_ray_becomes_depth_along_the_axis() -> None:
    """A wall at distance 5 in front of the camera, by the length of each ray from the near plane on."""
    tangent = np.tan(0.45)
    x = (np.arange(W) + 0.5) * 2 / W - 1
    y = (np.arange(H) + 0.5) * 2 / H - 1
    length = np.sqrt(1 + (x * tangent * W / H) ** 2 + (y[:, None] * tangent) ** 2)
    stored = ((5 - 0.5) * length)[None].astype(np.float32)
    depth = Depth(**AT, channels=("T",), kind="euclidean", near=0.5)
    np.testing.assert_allclose(decode_depth(stored, depth, LENS), np.full((1, H, W), 5), rtol=1e-5)
    with pytest.raises(ClipError, match="only with the field of view"):
        decode_depth(stored, depth)


def test_normals_by_hand() -> None:
    up_in_unreal = Normal(**AT, channels=("R", "G", "B"), encoded=True)
    np.testing.assert_allclose(decode_normal(one(0.5, 0.5, 1.0), up_in_unreal, "unreal"), one(0, 1, 0), atol=1e-6)
    ahead = decode_normal(one(0, 0, 1), Normal(**AT, channels=("R", "G", "B")), "unity")
    np.testing.assert_allclose(ahead, one(0, 0, -1), atol=1e-6)  # a camera without rotation looks there
    in_view = Normal(**AT, channels=("R", "G", "B"), space="view")
    turned = ((0.0, 0.0, -1.0, 0.0), (0.0, 1.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    np.testing.assert_allclose(decode_normal(one(0, 0, 1), in_view, view=turned), one(1, 0, 0), atol=1e-6)
    assert decode_normal(one(0, 0, 1), in_view) is None
    marks = decode_normal(one(-1, -1, -1), Normal(**AT, channels=("R", "G", "B")))
    np.testing.assert_array_equal(marks, one(0, 0, 0))


def test_axes_are_rotations_and_mirrors() -> None:
    for name, matrix in AXES.items():
        np.testing.assert_allclose(matrix @ matrix.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(matrix) == pytest.approx(1 if name == "opengl" else -1)


def test_jitter_sequences() -> None:
    halton = Jitter(halton=8)
    assert [decode_jitter(halton, i, (4, 4))[0] for i in range(3)] == [0.0, -0.25, 0.25]
    assert decode_jitter(halton, 0, (4, 4))[1] == pytest.approx(1 / 3 - 0.5)
    assert decode_jitter(halton, 8, (4, 4)) == decode_jitter(halton, 0, (4, 4))
    assert decode_jitter(replace(halton, start=1), 0, (4, 4)) == decode_jitter(halton, 1, (4, 4))
    moved = Jitter(values=((0.25, 0.125), (0.0, 0.5)), sign=(-1.0, -1.0))
    assert decode_jitter(moved, 2, (4, 4)) == (-0.25, -0.125)
    assert decode_jitter(Jitter(values=((0.125, 0.25),), units="ndc"), 5, (4, 8)) == (0.5, 0.5)
    assert decode_jitter(Jitter(), 3, (4, 4)) == (0.0, 0.0)


def test_layers_of_other_sizes_take_the_nearest_pixel() -> None:
    made = Settings(
        color=Color(**AT, channels=("R", "G", "B")),
        depth=Depth(**AT, channels=("Z",)),
        motion=Motion(**XY),
    )
    depth = np.array([[[1.0, 2.0], [3.0, 4.0]]], np.float32)
    stored = {"color": np.zeros((3, 4, 4), np.float32), "depth": depth, "motion": np.ones((2, 2, 2), np.float32)}
    found = decode(stored, made, Record(number=0, time=0.0))
    np.testing.assert_array_equal(found["depth"][0], np.kron(depth[0], np.ones((2, 2))))
    np.testing.assert_array_equal(found["motion"], np.full((2, 4, 4), 2.0))  # a pixel is half as large now
    stored["depth"] = np.ones((1, 2, 4), np.float32)
    with pytest.raises(ClipError, match="do not show the same picture"):
        decode(stored, made, Record(number=0, time=0.0))
    padded = replace(made, crop=(3, 2))
    stored["depth"], stored["motion"] = np.ones((1, 3, 5), np.float32), np.ones((2, 2, 3), np.float32)
    assert decode(stored, padded, Record(number=0, time=0.0))["color"].shape == (3, 2, 3)


def test_rows_from_the_bottom_are_turned() -> None:
    made = Settings(depth=Depth(**AT, channels=("Z",)), bottom_up=True)
    stored = {"depth": np.arange(1.0, 5.0, dtype=np.float32).reshape(1, 4, 1)}
    assert decode(stored, made, Record(number=0, time=0.0))["depth"].ravel().tolist() == [4, 3, 2, 1]


def test_changing_exposure_is_evened_out() -> None:
    made = Settings(color=Color(**AT, channels=("R", "G", "B"), exposure=(2.0, 4.0)))
    record = Record(number=1, time=1.0, exposure=2.0, extra={"exposure": 4.0})
    np.testing.assert_array_equal(decode({"color": one(8, 8, 8)}, made, record)["color"], one(4, 4, 4))


def test_nan_is_left_for_the_clip_to_name() -> None:
    made = Settings(depth=Depth(**AT, channels=("Z",), kind="reversed", near=0.1), object=Scalar(**AT, channels=("i",)))
    stored = {"depth": one(np.nan), "object": one(np.nan)}
    found = decode(stored, made, Record(number=0, time=0.0))
    assert np.isnan(found["depth"]).all()
    assert np.isnan(found["object"]).all()
