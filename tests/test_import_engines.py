"""Files of Unreal and Unity: a known wall, written as the engines would, is the wall again."""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest
from dump import RGB, lay, moves_as_its_cameras, same
from wall import FOV, FRAMES, H, W, place, record, wall, write_wall

from framecast import exr
from framecast.cli import main
from framecast.clip import Layers
from framecast.importers import images, open_any, unity, unreal
from framecast.importers.cameras import rotator
from framecast.importers.encode import encode, files
from framecast.importers.folder import Listing
from framecast.importers.passes import passes
from framecast.importers.settings import (
    Color,
    Depth,
    Motion,
    Normal,
    Scalar,
    Settings,
)

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


def test_what_was_made_of_a_shot_and_lies_in_it_is_no_part_of_it(tmp_path: Path) -> None:
    shot = lay_queue(tmp_path / "ue", queue(2.0, (-1.0, 1.0)))
    for command in (["upsample", str(shot), "-o", str(shot / "made"), "--method", "hold"],) * 2:  # again: to go on
        assert main(command) == 0
    assert main(["import", str(shot), "-o", str(shot / "clip")]) == 0
    assert Listing(shot).names == tuple(f"shot.{record(t).number:04d}.exr" for t in range(FRAMES))
    (shot / "other").mkdir()
    (shot / "other" / "job.json").write_text("{}")
    (shot / "shot.0010.exr").rename(shot / "other" / "shot.0010.exr")
    assert "other/shot.0010.exr" in Listing(shot).names


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
