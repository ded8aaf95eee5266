"""Every source that is recognised: a known wall, written as it would be, is the wall again; and what is refused."""

import json
import math
import shutil
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest
import torch
from wall import FOV, FRAMES, H, W, place, record, wall, write_wall

from framecast import exr
from framecast.cli import main
from framecast.clip import Clip, ClipError, Layers, check
from framecast.frame import camera_motion
from framecast.importers import describe, extranet, images, mobfgsr, open_any, save, stssnet, unity, unreal
from framecast.importers.cameras import rotator
from framecast.importers.encode import encode, files
from framecast.importers.folder import Listing
from framecast.importers.passes import passes
from framecast.importers.settings import (
    Cameras,
    Color,
    Depth,
    Jitter,
    Motion,
    Normal,
    Scalar,
    Settings,
    write_settings,
)

RGB = ("R", "G", "B")


def lay(
    folder: Path, made: Settings, frames: int = FRAMES, attributes: Callable[[int], dict[str, str]] | None = None
) -> Path:
    """The wall in a folder as settings say."""
    for time in range(frames):
        here = record(time)
        stored = encode(wall(time), made, here, record(max(time - 1, 0)), record(time + 1))
        for name, channels in files(stored, made, here.number).items():
            if attributes and name.endswith(".exr"):
                exr.write(folder / name, channels, attributes=attributes(time))
            else:
                images.write(folder / name, channels)
    return folder


def same(clip: Clip, names: tuple[str, ...], **tolerance: float) -> None:
    """The frames of a clip are the wall's; vectors of the first one lead nowhere."""
    assert set(names) <= set(clip.layers)
    for index in range(len(clip)):
        frame, wanted = clip[index], wall(index)
        for name in names:
            found = getattr(frame, name)[0].double().numpy()
            near = tolerance.get(name, 1e-3)
            np.testing.assert_allclose(
                found, wanted[name].astype(float), rtol=near, atol=near, err_msg=f"{name} {index}"
            )


def moves_as_its_cameras(clip: Clip) -> None:
    """Depth and cameras of neighbours give the wall's vectors: position, rotation, lens and handedness are right."""
    found = camera_motion(clip[2], clip[1])[0].numpy()
    np.testing.assert_allclose(found, wall(2)["motion"], atol=5e-3)
    assert clip[2].normal is None or camera_facing(clip) > 0.5


def camera_facing(clip: Clip) -> float:
    from framecast.frame import facing

    return float(facing(clip[2]).min())


# Unreal.


def in_unreal(time: int) -> dict[str, str]:
    """What the Movie Render Queue writes into a header: x ahead, y right, z up, centimetres and degrees."""
    (x, y, z), right, up = place(time)
    across = 2 * math.atan(math.tan(FOV / 2) * W / H)
    values = {
        "curPos/x": -z * 100,
        "curPos/y": x * 100,
        "curPos/z": y * 100,
        "curRot/pitch": math.degrees(up),
        "curRot/yaw": math.degrees(right),
        "curRot/roll": 0.0,
        "FinalImage/fov": math.degrees(across),
    }
    return {f"unreal/camera/{name}": f"{value:.9g}" for name, value in values.items()}


def queue(scale: float, sign: tuple[float, float], file: str = "shot.{frame}.exr", camera: str = "") -> Settings:
    """How one version of the queue might store the wall."""
    vectors = tuple(f"FinalImageMovieRenderQueue_MotionVectors{camera}.{c}" for c in "RG")
    depth = tuple(f"FinalImageMovieRenderQueue_WorldDepth{camera}.{c}" for c in "R")
    return Settings(
        axes="unreal",
        color=Color(files=(file,), channels=RGB),
        depth=Depth(files=(file,), channels=depth, scale=0.01),
        motion=Motion(
            files=(file,),
            channels=vectors,
            units="uv",
            direction="previous->current",
            bias=(0.5, 0.5),
            scale=(scale, scale),
            sign=sign,
        ),
        normal=Normal(files=(file,), channels=tuple(f"FinalImageWorldNormal.{c}" for c in RGB)),
    )


def lay_queue(folder: Path, made: Settings) -> Path:
    """With the channel G of depth and B of vectors, which the queue writes, too."""
    lay(folder, made, attributes=in_unreal)
    for path in folder.glob("*.exr"):
        found = exr.read(path)
        more = {n.removesuffix("R") + "G": p for n, p in found.channels.items() if "WorldDepth" in n}
        exr.write(path, {**found.channels, **more}, attributes=found.attributes)
    return folder


@pytest.mark.parametrize(("scale", "sign"), [(2.0, (-1.0, 1.0)), (1.0, (1.0, -1.0)), (2.0, (1.0, 1.0))])
def test_the_movie_render_queue_is_read_whatever_its_vectors_mean(
    tmp_path: Path, scale: float, sign: tuple[float, float]
) -> None:
    clip = open_any(lay_queue(tmp_path, queue(scale, sign)))
    assert clip.provenance["source"] == "unreal"
    same(clip, ("color", "depth", "motion", "normal"), motion=2e-3)
    moves_as_its_cameras(clip)
    (note,) = (note for note in clip.provenance["notes"] if note.startswith("vectors were read as"))
    assert "times better than any other reading" in note


def test_the_queue_with_a_camera_name_and_one_file_a_pass(tmp_path: Path) -> None:
    clip = open_any(lay_queue(tmp_path / "named", queue(2.0, (-1.0, 1.0), camera="_CineCameraActor1")))
    same(clip, ("color", "depth", "motion"), motion=2e-3)
    apart = tmp_path / "apart"
    for path in (tmp_path / "named").glob("*.exr"):
        found = exr.read(path)
        for name in ("FinalImage", "FinalImageMovieRenderQueue_MotionVectors", "FinalImageMovieRenderQueue_WorldDepth"):
            prefix = "" if name == "FinalImage" else f"{name}_CineCameraActor1."
            held = {c: found.channels[f"{prefix}{c}"] for c in "RGB" if f"{prefix}{c}" in found.channels}
            file = f"Seq.{name}.{path.stem.rpartition('.')[2]}.exr"
            exr.write(apart / file, held, attributes=found.attributes)
    again = open_any(apart)
    same(again, ("color", "depth", "motion"), motion=2e-3)
    moves_as_its_cameras(again)


def targets(packing: str) -> Settings:
    code = 32767 / 65535
    return Settings(
        axes="unreal",
        color=Color(files=("SceneColor_{frame}.exr",), channels=RGB),
        depth=Depth(files=("SceneDepthZ_{frame}.exr",), channels=("R",), kind="reversed", near=0.1),
        motion=Motion(
            files=("SceneVelocity_{frame}.exr",),
            channels=("R", "G"),
            units="ndc",
            direction="previous->current",
            sign=(1.0, -1.0),
            bias=(code, code),
            scale=(1 / 0.2495, 1 / 0.2495),
            packing=packing,  # type: ignore[arg-type]
        ),
        albedo=Color(files=("GBufferC_{frame}.exr",), channels=RGB),
        normal=Normal(files=("GBufferA_{frame}.exr",), channels=RGB, encoded=True),
        metallic=Scalar(files=("GBufferB_{frame}.exr",), channels=("R",)),
        roughness=Scalar(files=("GBufferB_{frame}.exr",), channels=("B",)),
    )


@pytest.mark.parametrize("packing", ["none", "unreal_sqrt"])
def test_raw_targets_of_unreal(tmp_path: Path, packing: str) -> None:
    lay(tmp_path, targets(packing))
    for path in tmp_path.glob("GBufferB*.exr"):
        held = exr.read(path).channels
        exr.write(path, {**held, "G": np.zeros_like(held["R"])})
    same(open_any(tmp_path), ("color", "depth", "motion", "albedo", "normal", "metallic", "roughness"), motion=2e-3)
    assert open_any(tmp_path)[1].view is None


def test_unwritten_velocity_is_filled_from_the_cameras(tmp_path: Path) -> None:
    lay(tmp_path, targets("none"))
    for path in tmp_path.glob("SceneVelocity*.exr"):
        held = exr.read(path).channels
        exr.write(
            path, {name: np.where(np.arange(W) < W // 2, 0, plane).astype(np.float32) for name, plane in held.items()}
        )
    rows = [
        {"frame": t + 10, "position": [100 * v for v in (-place(t)[0][2], place(t)[0][0], place(t)[0][1])]}
        | {"rotation": [math.degrees(place(t)[2]), math.degrees(place(t)[1]), 0]}
        for t in range(FRAMES)
    ]
    (tmp_path / "cameras.json").write_text(json.dumps({"fov": math.degrees(FOV), "frames": rows}))
    clip = open_any(tmp_path)
    moves_as_its_cameras(clip)
    np.testing.assert_allclose(clip[2].motion[0].numpy(), wall(2)["motion"], atol=5e-3)


def test_a_rotator_turns_right_and_up_and_clockwise() -> None:
    ahead, right, up = rotator(0, 90, 0).T
    np.testing.assert_allclose([ahead, right, up], [[0, 1, 0], [-1, 0, 0], [0, 0, 1]], atol=1e-12)
    np.testing.assert_allclose(rotator(90, 0, 0)[:, 0], [0, 0, 1], atol=1e-12)
    np.testing.assert_allclose(rotator(0, 0, 90)[:, 1], [0, 0, -1], atol=1e-12)  # what was right is below


# Unity.


def recorder(sign: tuple[float, float]) -> Settings:
    def at(name: str) -> tuple[str, ...]:
        return (f"{name}_{{frame}}.exr",)

    return Settings(
        axes="unity",
        color=Color(files=at("Beauty"), channels=RGB),
        depth=Depth(files=at("Depth"), channels=("R",), kind="reversed", near=0.3, far=1000.0),
        motion=Motion(
            files=at("MotionVectors"), channels=("R", "G"), units="uv", direction="previous->current", sign=sign
        ),
        albedo=Color(files=at("Albedo"), channels=RGB),
        normal=Normal(files=at("Normal"), channels=RGB),
        roughness=Scalar(files=at("Smoothness"), channels=("R",), bias=1.0, scale=-1.0),
        metallic=Scalar(files=at("Metal"), channels=("R",)),
    )


@pytest.mark.parametrize("sign", [(1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
def test_unitys_recorder_one_sequence_an_aov(tmp_path: Path, sign: tuple[float, float]) -> None:
    clip = open_any(lay(tmp_path, recorder(sign)))
    assert clip.provenance["source"] == "unity"
    same(clip, ("color", "depth", "motion", "albedo", "normal", "roughness", "metallic"))


def test_unitys_recorder_one_file_of_many_parts(tmp_path: Path) -> None:
    lay(tmp_path / "apart", recorder((1.0, -1.0)))
    for time in range(FRAMES):
        parts = []
        for path in sorted((tmp_path / "apart").glob(f"*_{time + 10:04d}.exr")):
            header = {"name": path.stem.partition("_")[0], "type": OpenEXR.scanlineimage}
            parts.append(OpenEXR.Part(header, dict(exr.read(path).channels)))
        (tmp_path / "one").mkdir(exist_ok=True)
        OpenEXR.File(parts).write(str(tmp_path / "one" / f"AOV_{time + 10:04d}.exr"))
    same(open_any(tmp_path / "one"), ("color", "depth", "motion", "albedo", "normal", "roughness", "metallic"))


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


def generic() -> Settings:
    return Settings(
        fps=50.0,
        color=Color(files=("beauty/*.{frame}.exr",), channels=RGB),
        depth=Depth(files=("depth/{frame}.exr",), channels=("depth.v",), kind="inverse"),
        motion=Motion(files=("mv/{frame}.exr",), channels=("R", "G"), units="ndc", sign=(1.0, -1.0)),
        jitter=Jitter(halton=4, sign=(-1.0, -1.0)),
        cameras=Cameras(fov=math.degrees(FOV)),
        notes=("found by hand",),
    )


def lay_generic(folder: Path, made: Settings | None = None) -> Path:
    made = made or generic()
    assert made.color is not None
    lay(folder, replace(made, color=replace(made.color, files=("beauty/take1.{frame}.exr",))))
    write_settings(made, folder)
    return folder


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


# The command line: one sentence, exit 2, nothing left behind.


def refused(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> str:
    code = main([str(a) for a in arguments])
    said = capsys.readouterr()
    assert code == 2, said.out
    assert said.err.startswith("framecast: ")
    assert "Traceback" not in said.err
    assert said.err.count("\n") == 1
    return said.err


def spoil(folder: Path, name: str, change: Callable[[np.ndarray], np.ndarray]) -> None:
    path = folder / name
    exr.write(path, {k: change(v) for k, v in exr.read(path).channels.items()})


def remove(*names: str) -> Callable[[Path], None]:
    return lambda folder: [(folder / name).unlink() for name in names] and None  # type: ignore[func-returns-value]


def another_shot(folder: Path) -> None:
    shutil.copy(folder / "beauty/take1.0010.exr", folder / "beauty/take2.0010.exr")


def one_frame(folder: Path) -> None:
    for path in folder.rglob("*.exr"):
        if "0010" not in path.name:
            path.unlink()


def eight_bits(folder: Path) -> None:
    about = json.loads((folder / "framecast-import.json").read_text())
    about["depth"] = {"files": "d{frame}.png", "channels": "R"}
    (folder / "framecast-import.json").write_text(json.dumps(about))
    for number in range(10, 10 + FRAMES):
        images.write(folder / f"d{number:04d}.png", dict.fromkeys("RGB", np.ones((H, W))))


def rename_key(folder: Path) -> None:
    path = folder / "framecast-import.json"
    path.write_text(path.read_text().replace('"kind"', '"knid"'))


def truncate(folder: Path) -> None:
    path = folder / "mv/0011.exr"
    path.write_bytes(path.read_bytes()[:-200])


def shrink(folder: Path) -> None:
    path = folder / "mv/0012.exr"
    exr.write(path, {k: v[:-2] for k, v in exr.read(path).channels.items()})


def lose_channel(folder: Path) -> None:
    path = folder / "mv/0012.exr"
    exr.write(path, {"R": exr.read(path).channels["R"], "GG": exr.read(path).channels["G"]})


def poison(folder: Path) -> None:
    spoil(folder, "beauty/take1.0012.exr", lambda plane: np.where(np.arange(W) == 3, np.nan, plane).astype(plane.dtype))


BROKEN: list[tuple[Callable[[Path], None], str]] = [
    (remove("beauty/take1.0011.exr", "mv/0011.exr", "depth/0011.exr"), "frame 11 is missing in the middle"),
    (remove("beauty/take1.0011.exr"), "color lacks frame 11, which other buffers have"),
    (remove("depth/0012.exr"), "depth lacks frame 12, which other buffers have"),
    (remove(*(f"mv/00{n}.exr" for n in range(10, 14))), "has no file mv/{frame}.exr for motion"),
    (another_shot, "holds 2 sequences .* put each shot into a folder of its own"),
    (one_frame, "holds 1 frame of a sequence; give at least two"),
    (eight_bits, "depth is stored in 8 bits, whose 256 steps are too coarse"),
    (rename_key, "depth.knid is not known; did you mean kind"),
    (truncate, "truncated or damaged"),
    (shrink, "0012.exr is 40x22 but the first one is 40x24"),
    (lose_channel, r"0012.exr lacks G for motion \(it has GG, R\)"),
    (poison, "frame 12 of .*: 72 NaN or infinite pixels in color; .* --repair"),
]


@pytest.mark.parametrize(("break_it", "said"), BROKEN)
def test_what_is_broken_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], break_it: Callable[[Path], None], said: str
) -> None:
    import re

    folder = lay_generic(tmp_path / "dump")
    break_it(folder)
    assert re.search(said, refused(capsys, "import", folder, "-o", tmp_path / "clip"))
    assert [path.name for path in tmp_path.iterdir()] == ["dump"]


def test_other_files_among_them_do_not_matter(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = lay_generic(tmp_path / "dump")
    (folder / "notes.txt").write_text("mine")
    (folder / "depth" / ".0010.exr.swp").write_bytes(b"x")
    (folder / "preview.png").write_bytes(b"not a picture")
    (folder / "beauty" / "take1.0099.tmp").write_bytes(b"x")
    assert main(["import", str(folder), "-o", str(tmp_path / "clip"), "--full"]) == 0
    same(open_any(tmp_path / "clip"), ("color", "depth", "motion"))
    assert f"{tmp_path / 'clip'}: 4 frames written" in capsys.readouterr().out


def test_repair_on_the_way_in(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = lay_generic(tmp_path / "dump")
    poison(folder)
    assert main(["import", str(folder), "-o", str(tmp_path / "clip"), "--repair"]) == 0
    assert "72 NaN or infinite values replaced" in capsys.readouterr().out


def test_sources_can_be_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = lay(tmp_path / "dump", extranet.settings_of("S", set(extranet.BUFFERS)))
    out = tmp_path / "clip"
    assert "is not recognised" in refused(capsys, "import", folder, "-o", out, "--from", "unity")
    assert "unrael is not known; import from blender" in refused(
        capsys, "import", folder, "-o", out, "--from", "unrael"
    )
    assert "does not exist; let framecast doctor" in refused(capsys, "import", folder, "-o", out, "--from", "generic")
    settings = write_settings(extranet.settings_of("S", {"MotionVector"}), tmp_path / "mine.json")
    both = refused(capsys, "import", folder, "-o", out, "--from", "extranet", "--settings", settings)
    assert "leave --from extranet out" in both
    assert main(["import", str(folder), "-o", str(out), "--settings", str(settings)]) == 0
    assert open_any(out).layers == ("color", "motion")


def test_what_is_not_recognised_is_told_what_was_looked_for(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    exr.write(tmp_path / "x" / "a_0001.exr", {"foo.R": np.zeros((4, 4), np.float32)})
    said = refused(capsys, "import", tmp_path / "x", "-o", tmp_path / "clip")
    assert "holds 1 image file, such as a_{frame}.exr with the channels foo.R" in said
    assert "looked for what Blender, unreal, unity, extranet" in said
    assert len(said) < 500
    assert f"framecast doctor {tmp_path / 'x'}" in said
    assert "is not there; give the folder" in refused(capsys, "import", tmp_path / "y", "-o", tmp_path / "clip")


def test_a_still_shot_says_that_its_vectors_are_not_confirmed(tmp_path: Path) -> None:
    made = recorder((1.0, -1.0))
    for time in range(3):
        still: Layers = {**wall(0), "motion": np.zeros((2, H, W), np.float32)}
        for name, channels in files(encode(still, made, record(0)), made, time).items():
            images.write(tmp_path / name, channels)
    clip = open_any(tmp_path)
    assert any("which the pictures do not confirm" in note for note in clip.provenance["notes"])
    assert clip.provenance["settings"]["motion"]["sign"] == [1.0, -1.0]  # as documented


def test_passes_are_told_apart_by_file_and_prefix(tmp_path: Path) -> None:
    write_wall(tmp_path / "clip")
    held: Mapping[str, Any] = {p.label: p for p in passes(Listing(tmp_path / "clip" / "frames"))}
    assert "/motion" in held
    assert unity.recognise(Listing(tmp_path / "clip" / "frames")) is None
    assert unreal.recognise(Listing(tmp_path / "clip" / "frames")) is None
