"""Clips in the layouts of others: read back by our importers, by their published rules, and by hand."""

import json
import math
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from wall import FOV, H, W, record, wall, write_wall

from framecast import exr
from framecast.cli import main
from framecast.clip import Clip, ClipError, finish, write_frame
from framecast.color import decode_srgb
from framecast.export_clip import TARGETS, export
from framecast.export_clip.noisebase import rgbe
from framecast.frame import camera_motion, world_position
from framecast.importers import extranet, images, open_any
from framecast.importers.decode import AXES


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Clip:
    return write_wall(tmp_path_factory.mktemp("wall") / "clip", 7, references=True)


def exported(clip: Clip, to: str, folder: Path) -> Path:
    said = export(clip, folder / to, to)
    assert said
    assert [path.name for path in folder.iterdir()] == [to]
    return folder / to


def same(found: Clip, wanted: Clip, **tolerance: float) -> None:
    assert len(found) == len(wanted)
    for index in range(len(wanted)):
        for name, near in tolerance.items():
            a, b = (getattr(c[index], name).double() for c in (found, wanted))
            torch.testing.assert_close(a, b, rtol=near, atol=near, msg=lambda text, name=name: f"{name}: {text}")


def test_extranets_raw_files(clip: Clip, tmp_path: Path) -> None:
    out = exported(clip, "extranet", tmp_path)
    names = sorted(path.name for path in out.glob("*.0012.exr"))
    buffers = (*extranet.BUFFERS, extranet.MARK, "NoV", "WorldPosition")
    assert names == sorted(f"Scene{buffer}.0012.exr" for buffer in buffers)
    half = 1e-3
    same(open_any(out), clip, color=half, depth=half, motion=1e-5, albedo=half, normal=half, roughness=half, object=0)
    # By its rules: pixels, current minus previous, y up; depth 1 at 100 m; positions in cm and Unreal's axes.
    motion, depth = (exr.read(out / f"Scene{b}.0012.exr").channels for b in ("MotionVector", "SceneDepth"))
    np.testing.assert_allclose(motion["R"], -wall(2)["motion"][0], atol=1e-5)
    np.testing.assert_allclose(motion["G"], wall(2)["motion"][1], atol=1e-5)
    np.testing.assert_allclose(depth["R"] * 100, wall(2)["depth"][0], rtol=1e-5)
    position = exr.read(out / "SceneWorldPosition.0012.exr").channels
    np.testing.assert_allclose(position["R"], np.full((H, W), 600), rtol=1e-4)  # the wall is 6 metres ahead
    assert (exr.read(out / "SceneNoV.0012.exr").channels["R"] > 0.5).all()


def test_extranets_arrays(clip: Clip, tmp_path: Path) -> None:
    out = exported(clip, "extranet-npz", tmp_path)
    assert sorted(path.name for path in out.iterdir()) == ["compressed.0015.npz", "compressed.0016.npz"]
    with np.load(out / "compressed.0015.npz") as arrays:
        planes = arrays["i"].astype(np.float32)
    assert planes.shape == (H, W, 30)
    fields = wall(5)
    light = fields["color"] / (fields["albedo"] + 0.04 * (1 - fields["metallic"]))
    np.testing.assert_allclose(planes[..., 21:24], np.moveaxis(light[::-1], 0, 2), rtol=2e-3)
    np.testing.assert_allclose(planes[..., 24], fields["metallic"][0])
    np.testing.assert_allclose(planes[..., 25], fields["roughness"][0], atol=1e-3)
    np.testing.assert_allclose(planes[..., 26] * 100, fields["depth"][0], rtol=2e-3)
    turned = np.einsum("ij,jhw->hwi", AXES["unreal"].T, fields["normal"])
    np.testing.assert_allclose(planes[..., 27:30], turned[..., ::-1], atol=1e-3)
    # The wall's pattern stands still, so that the frame before, warped, shows the same picture where nothing is a hole.
    holes, whole = planes[..., 0:3], planes[..., 12:15]
    seen = (holes >= 0).all(2)
    assert 0.5 < seen.mean() < 1
    np.testing.assert_array_equal(holes[seen], whole[seen])
    np.testing.assert_array_equal(holes[~seen], -1)
    np.testing.assert_array_equal(planes[..., 9:12][seen], holes[seen])
    error = np.abs(whole - planes[..., 21:24])[seen].mean()
    assert error < 0.25 * np.abs(_light(4) - planes[..., 21:24])[seen].mean()


def _light(time: int) -> np.ndarray:
    fields = wall(time)
    return np.moveaxis((fields["color"] / (fields["albedo"] + 0.04 * (1 - fields["metallic"])))[::-1], 0, 2)


def test_stssnets_arrays_come_back(clip: Clip, tmp_path: Path) -> None:
    out = exported(clip, "stssnet", tmp_path)
    found = open_any(out)
    assert [r.number for r in found.records] == [15, 16]
    assert found.size == (2 * H, 2 * W)
    frame = found[1]
    small = {name: getattr(frame, name)[0].numpy()[:, ::2, ::2] for name in ("motion", "depth", "albedo", "normal")}
    np.testing.assert_allclose(small["motion"] / 2, wall(6)["motion"], atol=1e-2)
    np.testing.assert_allclose(small["depth"], wall(6)["depth"], rtol=3e-3)
    np.testing.assert_allclose(small["albedo"], wall(6)["albedo"], atol=1e-3)
    np.testing.assert_allclose(small["normal"], wall(6)["normal"], atol=1e-3)
    reference = clip.reference(6)
    assert reference is not None
    torch.testing.assert_close(frame.color, reference, rtol=0, atol=2e-3)
    shaded = np.load(out / "compressed.0016.NoWarp.npy").astype(np.float32)
    warped = np.load(out / "compressed.0016.Warp.npy").astype(np.float32)
    assert shaded.shape == warped.shape == (H, W, 33)
    own = decode_srgb(torch.from_numpy(shaded[..., 11::-1][..., 0:3].copy())).numpy()  # 9..11 turned to R, G, B
    np.testing.assert_allclose(np.moveaxis(own, 2, 0), wall(6)["color"], atol=3e-3)
    np.testing.assert_array_equal(shaded[..., 12:15], shaded[..., 9:12])
    np.testing.assert_array_equal(shaded[..., 15:33], warped[..., 15:33])
    assert (warped[..., 0:3] == -1).any()


def test_mob_fgsrs_pictures_come_back(clip: Clip, tmp_path: Path) -> None:
    out = exported(clip, "mobfgsr", tmp_path)
    found = open_any(out)
    same(found, clip, color=1e-2, motion=1e-4)
    far = max(float(clip[i].depth.max()) for i in range(len(clip))) * 1.001
    torch.testing.assert_close(found[3].depth * far, clip[3].depth, rtol=1e-5, atol=1e-5)
    pixels = images.read(out / "HR_Inputs" / "motion_vectors_x" / "0013.png", tuple("RGBA"))
    share = sum(np.rint(plane * 255) / 255 ** (k + 1) for k, plane in enumerate(pixels.astype(np.float64)))
    np.testing.assert_allclose((2 * share - 1) * W, -wall(3)["motion"][0], atol=1e-4)  # uv - mx is the previous place


def test_arms_data_comes_back(clip: Clip, tmp_path: Path) -> None:
    out = exported(clip, "arm-nss", tmp_path)
    found = open_any(out)
    same(found, clip, color=1e-3, depth=1e-3, motion=2e-2, projection=1e-5)
    assert (found.fps, found.records[1].cut, found.is_cut(0)) == (30, False, True)
    about = json.loads((out / "0000.json").read_text())
    assert about["TargetResolution"] == {"X": 2 * W, "Y": 2 * H}
    row = about["Frames"][2]
    assert row["FovY"] == pytest.approx(FOV)
    assert math.tan(row["FovX"] / 2) == pytest.approx(math.tan(FOV / 2) * W / H)
    data = np.array(row["ViewProjection"]).reshape(4, 4, order="F")  # column by column, for row vectors
    point = np.array([0.4, 1.2, -6, 1])
    here = record(2)
    np.testing.assert_allclose(point @ data, np.array(here.projection) @ np.array(here.view) @ point, rtol=1e-5)
    motion = exr.read(out / "x2/motion/0000/0002.exr").channels
    assert motion["R"].dtype == np.float16
    np.testing.assert_allclose(motion["R"] * W, wall(2)["motion"][0], rtol=2e-3)
    large = exr.read(out / "motion_gt/0000/0002.exr").channels
    np.testing.assert_array_equal(large["G"][::2, ::2], motion["G"])
    depth = exr.read(out / "x2/depth/0000/0002.exr").channels["R"]
    near = about["Frames"][0]["CameraNearPlane"]
    np.testing.assert_allclose(near / (1 - depth), wall(2)["depth"][0], rtol=1e-3)
    truth = exr.read(out / "ground_truth/0000/0002.exr").channels["R"]
    np.testing.assert_allclose(truth, clip.reference(2)[0, 0].numpy(), atol=1e-6)


def zarr(path: Path) -> dict[str, np.ndarray]:
    """The arrays of a Zarr store of one chunk a frame."""
    out: dict[str, np.ndarray] = {}
    with zipfile.ZipFile(path) as archive:
        for entry in archive.namelist():
            if not entry.endswith("/.zarray"):
                continue
            name, about = entry.removesuffix("/.zarray"), json.loads(archive.read(entry))
            chunks = [
                np.frombuffer(
                    zlib.decompress(archive.read(".".join([f"{name}/{f}", *["0"] * (len(about["shape"]) - 1)]))),
                    about["dtype"],
                )
                for f in range(about["shape"][0])
            ]
            out[name] = np.stack(chunks).reshape(about["shape"])
    return out


def test_noisebases_store(clip: Clip, tmp_path: Path) -> None:
    out = exported(clip, "noisebase", tmp_path)
    held = zarr(out / "scene0000.zip")
    shapes = {name: (values.shape, str(values.dtype)) for name, values in held.items()}
    assert shapes["color"] == ((7, 4, H, W, 1), "uint8")
    assert shapes["normal"] == ((7, 3, H, W, 1), "float16")
    assert shapes["reference"] == ((7, 3, 2 * H, 2 * W), "float32")
    assert shapes["exposure"] == ((7, 2), "float32")
    frame = clip[3]
    color, (low, high) = held["color"][3, ..., 0].astype(np.float64), held["exposure"][3]
    decoded = color[:3] / 255 * np.exp((color[3] + 1) / 256 * (high - low) + low)
    np.testing.assert_allclose(decoded, frame.color[0].numpy(), atol=4e-3)
    position = world_position(frame.depth, frame.view, frame.projection)[0].numpy()
    np.testing.assert_allclose(held["position"][3, ..., 0], position, atol=1e-5)
    row = np.append(position[:, 5, 7], 1) @ held["view_proj_mat"][3]  # row vectors
    np.testing.assert_allclose((row[:2] / row[3] + [1, -1]) * [W / 2, -H / 2], [7.5, 5.5], atol=1e-3)
    eye, target = held["camera_position"][3], held["camera_target"][3]
    np.testing.assert_allclose(eye, [0.9, 1.15, 0.6], atol=1e-5)
    assert target[2] < eye[2]
    static = wall(3)["object"][0] == 0
    assert (held["motion"][3, ..., 0][:, static] == 0).all()
    assert (held["motion"][0] == 0).all()


def test_rgbe_of_black_and_of_one_brightness() -> None:
    black, exposure = rgbe(np.zeros((3, 2, 2), np.float32))
    assert not black.any()
    assert exposure.tolist() == [0, 0]
    flat, (low, high) = rgbe(np.full((3, 2, 2), 4.0, np.float32))
    found = flat[:3] / 255 * np.exp((flat[3].astype(float) + 1) / 256 * (high - low) + low)
    np.testing.assert_allclose(found, 4, rtol=1e-5)


PRECISION: dict[str, dict[str, float]] = {
    "extranet": {"color": 1e-3, "depth": 1e-3, "motion": 1e-3, "albedo": 1e-3, "roughness": 1e-3, "object": 0},
    "mobfgsr": {"color": 1e-2, "motion": 1e-4},
    "arm-nss": {"color": 1e-3, "depth": 1e-3, "motion": 2e-3},
}
"""Of each buffer, relative and absolute, in layouts that an importer reads."""


@settings(max_examples=9, deadline=None)
@given(st.sampled_from(sorted(PRECISION)), st.integers(0, 2**31), st.sampled_from((0.05, 1.0, 8.0)))
def test_any_numbers_come_back_within_the_precision_of_the_layout(
    tmp_path_factory: pytest.TempPathFactory, to: str, seed: int, reach: float
) -> None:
    rng, folder = np.random.default_rng(seed), tmp_path_factory.mktemp("any")
    bright = 1.0 if to == "mobfgsr" else 60.0 * reach  # it keeps 8 bits
    for time in range(3):
        layers = wall(time)
        layers["color"] = rng.uniform(0, bright, (3, H, W)).astype(np.float32)
        layers["depth"] = rng.uniform(0.2, 40 * reach, (1, H, W)).astype(np.float32)
        layers["motion"] = rng.uniform(-reach, reach, (2, H, W)).astype(np.float32)
        layers["albedo"], layers["roughness"] = (rng.random((n, H, W), np.float32) for n in (3, 1))
        layers["object"] = rng.integers(0, 255, (1, H, W)).astype(np.uint32)
        large = layers["color"].repeat(2, 1).repeat(2, 2)
        write_frame(folder / "clip", record(time), layers, reference=large, half=frozenset())
    made = finish(folder / "clip", fps=30, scale=2.0)
    export(made, folder / to, to)
    same(open_any(folder / to), made, **PRECISION[to])


def test_cameras_and_vectors_agree_before_and_after(clip: Clip) -> None:
    """The wall itself: what the other tests take for granted."""
    np.testing.assert_allclose(camera_motion(clip[2], clip[1])[0], wall(2)["motion"], atol=1e-3)


REFUSED: list[tuple[str, dict[str, Any], str]] = [
    ("arm-nss", {"references": False}, "has no reference images; arm-nss needs them"),
    ("stssnet", {"references": False}, "has no reference images; stssnet needs them"),
    ("extranet-npz", {"frames": 4}, "has 4 frames; this layout needs 6 in a row without a cut"),
    ("nsrr", {}, "nsrr is not known; export to extranet, extranet-npz"),
]


@pytest.mark.parametrize(("to", "about", "said"), REFUSED)
def test_what_cannot_be_exported_is_said(tmp_path: Path, to: str, about: dict[str, Any], said: str) -> None:
    small = write_wall(tmp_path / "clip", about.pop("frames", 2), **about)
    with pytest.raises(ClipError, match=said):
        export(small, tmp_path / "out", to)
    assert [path.name for path in tmp_path.iterdir()] == ["clip"]


def test_a_clip_without_the_buffers_is_refused_by_the_command(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for time in range(2):
        fields = wall(time)
        write_frame(tmp_path / "clip", record(time), {name: fields[name] for name in ("color", "motion")})
    finish(tmp_path / "clip", fps=24)
    assert main(["export-clip", str(tmp_path / "clip"), "--to", "extranet", "-o", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert "has no depth, albedo, normal, roughness, metallic, object; extranet needs color, depth, motion" in said
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine.txt").write_text("x")
    assert main(["export-clip", str(tmp_path / "clip"), "--to", "extranet", "-o", str(tmp_path / "out")]) == 2
    assert "exists already; give another name" in capsys.readouterr().err
    assert set(TARGETS) == {"extranet", "extranet-npz", "stssnet", "mobfgsr", "arm-nss", "noisebase"}


def test_the_command_says_what_it_made(clip: Clip, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["export-clip", str(clip.path), "--to", "mobfgsr", "-o", str(tmp_path / "out")]) == 0
    assert "out: 7 frames in the layout of mobfgsr; depth 1 is " in capsys.readouterr().out
