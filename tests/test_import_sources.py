"""Files of data sets and of any other kind, with cameras of every convention: a known wall is the wall again."""

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from dump import RGB, generic, lay, lay_generic, moves_as_its_cameras, same
from wall import FOV, FRAMES, H, W, place, record, wall

from framecast import exr
from framecast.clip import ClipError, check
from framecast.importers import describe, extranet, images, mobfgsr, open_any, save, stssnet
from framecast.importers.cameras import pose, posed
from framecast.importers.settings import (
    Cameras,
    Color,
    Depth,
    Motion,
    Normal,
    Settings,
    write_settings,
)

# Data sets.


def test_extranets_files(tmp_path: Path) -> None:
    clip = open_any(lay(tmp_path, extranet.settings_of("Medieval", set(extranet.BUFFERS))))
    assert clip.provenance["source"] == "extranet"
    same(clip, ("color", "depth", "motion", "albedo", "roughness", "metallic", "object"))
    partial = lay(tmp_path / "few", extranet.settings_of("a/Bunker", {"MotionVector"}))
    assert open_any(partial).layers == ("color", "motion")


def test_stssnets_arrays(tmp_path: Path) -> None:
    made = stssnet.settings_of(35)
    lay(tmp_path, made)
    for path in tmp_path.glob("*.npy"):
        planes = np.load(path)
        np.save(path, np.concatenate((planes, np.zeros((H, W, 35 - planes.shape[2]), np.float16)), 2))
    clip = open_any(tmp_path)
    assert clip.provenance["source"] == "stssnet"
    same(clip, ("color", "depth", "motion", "albedo", "normal", "roughness"), motion=2e-2, depth=1e-2, color=2e-3)


@pytest.mark.parametrize("root", ["", "HR_Inputs/"])
def test_mob_fgsrs_pictures(tmp_path: Path, root: str) -> None:
    made = mobfgsr.settings_of(root)
    assert made.depth is not None
    lay(tmp_path, replace(made, depth=replace(made.depth, scale=20.0, far=20.0)))
    clip = open_any(tmp_path)
    assert clip.provenance["source"] == "mobfgsr"
    same(clip, ("color", "motion"), color=1e-2)
    np.testing.assert_allclose(clip[1].depth[0].numpy() * 20, wall(1)["depth"], rtol=1e-4)


def mitsuba(folder: Path) -> Path:
    made = Settings(
        color=Color(files=("{frame}.exr",), channels=RGB),
        depth=Depth(files=("{frame}.exr",), channels=("dd.y.T",), kind="euclidean", near=0.01),
        normal=Normal(files=("{frame}.exr",), channels=("nn.X", "nn.Y", "nn.Z")),
        albedo=Color(files=("{frame}.exr",), channels=("albedo.R", "albedo.G", "albedo.B")),
    )
    return lay(folder, made)


def test_mitsubas_aovs_get_vectors_from_their_cameras(tmp_path: Path) -> None:
    mitsuba(tmp_path)
    bare = open_any(tmp_path)
    same(bare, ("color", "normal", "albedo"))
    assert bare.layers == ("color", "albedo", "normal")
    assert "no depth and no motion" in " ".join(bare.provenance["notes"])
    rows = [{"frame": t + 10, "camera_to_world": np.linalg.inv(record(t).view).T.tolist()} for t in range(FRAMES)]
    (tmp_path / "cameras.json").write_text(json.dumps({"fov": math.degrees(FOV), "frames": rows}))
    clip = open_any(tmp_path)  # matrices for rows are seen to be such
    same(clip, ("color", "depth", "motion", "normal", "albedo"), motion=5e-3)
    moves_as_its_cameras(clip)


def test_arms_data_by_its_json(tmp_path: Path) -> None:
    def at(buffer: str) -> tuple[str, ...]:
        return (f"x2/{buffer}/0000/{{frame}}.exr",)

    made = Settings(
        color=Color(files=at("color"), channels=RGB),
        depth=Depth(files=at("depth"), channels=("R",), kind="reversed", near=0.1),
        motion=Motion(files=at("motion"), channels=("R", "G"), units="uv"),
    )
    lay(tmp_path, made)
    rows = [
        {"FrameNumber": t + 10, "FovY": FOV, "CameraNearPlane": 0.1, "CameraFarPlane": -1.0, "Exposure": 2.0}
        | {"Jitter": {"X": 0.25, "Y": -0.5}, "CameraCut": t == 2}
        for t in range(FRAMES)
    ]
    (tmp_path / "0000.json").write_text(json.dumps({"EmulatedFramerate": 60, "ReverseZ": True, "Frames": rows}))
    clip = open_any(tmp_path)
    same(clip, ("color", "depth", "motion"))
    assert (clip.fps, clip.records[2].cut, clip.records[1].exposure) == (60.0, True, 2.0)
    assert clip[1].jitter[0].tolist() == [0.25, -0.5]
    torch.testing.assert_close(clip[1].projection[0, 1, 1].item(), 1 / math.tan(FOV / 2))
    (tmp_path / "0000.json").write_text("{}")
    with pytest.raises(ClipError, match=r"0000.json cannot be read \(it has no Frames\)"):
        open_any(tmp_path)


# Any folder with settings.


def test_a_folder_with_settings(tmp_path: Path) -> None:
    clip = open_any(lay_generic(tmp_path))
    same(clip, ("color", "depth", "motion"))
    assert clip.fps == 50
    assert clip.records[1].jitter == (0.25, pytest.approx(1 / 2 - 2 / 3))
    assert clip[1].projection is not None
    assert "found by hand" in describe(clip, {})
    assert open_any(tmp_path, fps=12).fps == 12
    assert check(save(clip, tmp_path.parent / "saved", full=True)) == ()


def test_names_in_another_case_are_found(tmp_path: Path) -> None:
    lay_generic(tmp_path)
    for path in (tmp_path / "depth").glob("*.exr"):
        exr.write(path, {"Depth.V": exr.read(path).channels["depth.v"]})
    same(open_any(tmp_path), ("depth",))


def test_vectors_in_the_file_of_the_next_frame(tmp_path: Path) -> None:
    made = replace(generic(), motion=replace(generic().motion, offset=-1))  # type: ignore[type-var]
    clip = open_any(lay_generic(tmp_path, made))
    assert len(clip) == FRAMES
    same(clip, ("color", "motion"))


def test_arrays_pictures_and_folders_at_once(tmp_path: Path) -> None:
    made = Settings(
        color=Color(files=("png/{frame}.png",), channels=RGB, encoding="srgb"),
        motion=Motion(files=("mv_{frame}.npz",), channels=("1", "0")),
        depth=Depth(files=("d/{frame}.npy",), channels=("0",)),
    )
    lay(tmp_path, made)
    write_settings(made, tmp_path)
    same(open_any(tmp_path), ("color", "motion", "depth"), color=1e-2, motion=1e-2, depth=2e-3)


def test_pictures_of_16_bits_keep_them(tmp_path: Path) -> None:
    import av

    values = np.arange(H * W * 3, dtype=np.uint16).reshape(H, W, 3) * 20
    path = tmp_path / "a.png"
    with av.open(str(path), "w", format="image2", options={"update": "1"}) as out:
        stream = out.add_stream("png", rate=1)
        stream.width, stream.height, stream.pix_fmt = W, H, "rgb48be"
        frame = av.VideoFrame.from_ndarray(values, format="rgb48le").reformat(format="rgb48be")
        for packet in (*stream.encode(frame), *stream.encode()):
            out.mux(packet)
    assert images.about(path) == images.About((H, W), RGB, 16, {})
    found = images.read(path, RGB)
    np.testing.assert_array_equal(np.rint(found * 65535).astype(np.uint16), np.moveaxis(values, 2, 0))


FLIP = np.diag([1.0, 1, -1, 1])


def unity_pose(time: int) -> dict[str, Any]:
    (x, y, z), right, up = place(time)
    (sy, cy), (sx, cx) = ((math.sin(a / 2), math.cos(a / 2)) for a in (right, -up))
    return {"position": [x, y, -z], "rotation": [cy * sx, sy * cx, -sy * sx, cy * cx]}


def in_directx(time: int) -> dict[str, Any]:
    view, projection = np.array(record(time).view), np.array(record(time).projection)
    return {"view": (FLIP @ view @ FLIP).T.tolist(), "projection": (projection @ FLIP).T.tolist()}


def in_unreal_centimetres(time: int) -> dict[str, Any]:
    (x, y, z), right, up = place(time)
    return {"position": [-100 * z, 100 * x, 100 * y], "rotation": [math.degrees(up), math.degrees(right), 0]}


CAMERAS: list[tuple[str, float, Callable[[int], dict[str, Any]]]] = [
    ("opengl", 1.0, lambda t: {"view": record(t).view, "projection": record(t).projection}),
    (
        "opengl",
        1.0,
        lambda t: {"camera_to_world": (10 * np.linalg.inv(record(t).view) @ np.diag([1, 1, 1, 0.1])).tolist()},
    ),
    ("unity", 1.0, unity_pose),
    ("unity", 1.0, lambda t: {"view": (np.array(record(t).view) @ FLIP).tolist()}),
    ("directx", 1.0, in_directx),
    ("unreal", 0.01, in_unreal_centimetres),
]


@pytest.mark.parametrize(("axes", "scale", "row"), CAMERAS)
def test_cameras_of_every_convention(tmp_path: Path, axes: Any, scale: float, row: Callable[[int], Any]) -> None:
    made = replace(
        generic(),
        axes=axes,
        normal=Normal(files=("n/{frame}.exr",), channels=RGB),
        cameras=Cameras(file="cameras.json", fov=math.degrees(FOV), scale=scale),
    )
    lay_generic(tmp_path, made)
    rows = [{"frame": t + 10, **row(t), "cut": t == 1, "jitter": [0.5, 0]} for t in range(FRAMES)]
    (tmp_path / "cameras.json").write_text(json.dumps({"frames": rows}))
    clip = open_any(tmp_path)
    moves_as_its_cameras(clip)
    same(clip, ("normal",))
    assert (clip.is_cut(1), clip.is_cut(2)) == (True, False)
    assert clip.records[1].jitter == (-0.5, 0)  # the settings say that the picture is moved


@pytest.mark.parametrize("near", [0.01, 1.0, 10.0])
@pytest.mark.parametrize("parallel", [False, True])
def test_a_shifted_lens_is_read_for_rows_and_for_columns_in_any_unit(near: float, parallel: bool) -> None:
    x, y, far = 0.3, -0.2, 100 * near
    deep = (1 / (near - far), near / (near - far)) if parallel else (far / (near - far), near * far / (near - far))
    ends = [[0, 0, 0, 1]] if parallel else [[0, 0, -1, 0]]
    shift = [[1.2, 0, 0, x], [0, 2.0, 0, y]] if parallel else [[1.2, 0, x, 0], [0, 2.0, y, 0]]
    matrix = np.array([*shift, [0, 0, *deep], *ends])
    for written in (matrix, matrix.T):
        found = pose({"projection": written.tolist()}, "opengl", (H, W)).projection
        np.testing.assert_allclose(np.array(found)[[0, 1, 3]], matrix[[0, 1, 3]], atol=1e-9)


@pytest.mark.parametrize("axes", ["opengl", "unreal", "unity", "directx"])
def test_cameras_that_are_written_are_read(axes: Any) -> None:
    rows = posed([record(1), replace(record(2), cut=True)], axes)["frames"]
    for row, wanted in zip(json.loads(json.dumps(rows)), (record(1), record(2)), strict=True):
        found = pose(row, axes, (H, W))
        np.testing.assert_allclose(found.view, wanted.view, atol=1e-6)
        np.testing.assert_allclose(np.array(found.projection)[:2], np.array(wanted.projection)[:2], atol=1e-6)
        assert found.cut == (wanted.number == record(2).number)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{", "cannot be read"),
        ('{"frames": [{"view": 1}]}', "cannot be read"),
        ('{"frames": [{"frame": 10, "view": [[1, 0], [0, 1]]}]}', "cannot be read"),
        (json.dumps({"frames": [{"frame": 10, "view": np.ones((4, 4)).tolist()}]}), "view is no pose"),
        ('{"frames": [{"frame": 10, "fov": 200}]}', "between 0 and 180"),
        ('{"frames": [{"frame": 10, "position": [NaN, 0, 0], "rotation": [0, 0, 0]}]}', "NaN or infinity"),
    ],
)
def test_a_wrong_file_of_cameras_is_said(tmp_path: Path, text: str, said: str) -> None:
    lay_generic(tmp_path, replace(generic(), axes="unreal", cameras=Cameras(file="cameras.json")))
    with pytest.raises(FileNotFoundError, match=r"write it, or remove cameras\.file"):
        open_any(tmp_path)
    (tmp_path / "cameras.json").write_text(text)
    with pytest.raises(ClipError, match=said):
        open_any(tmp_path)
