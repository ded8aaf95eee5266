"""Blender shots as clips: real renders against values known on paper, and all that can be wrong with a folder."""

import json
import re
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import torch

from framecast import exr
from framecast.cli import main
from framecast.clip import ClipError, check
from framecast.frame import SKY, camera_motion, world_position
from framecast.importers import open_any, repairs, save
from framecast.importers.blender import absent, open_shot, ranges
from framecast.importers.blender_camera import read_shot

DATA = Path(__file__).parent / "data" / "blender"
TRUTH = json.loads((DATA / "truth.json").read_text())
RIGHT = sorted(set(TRUTH) - {"motion-blur", "v34-motion-blur", "ortho"})
"""Fixtures whose vectors Blender wrote as it should."""


def copy(name: str, to: Path) -> Path:
    return Path(shutil.copytree(DATA / name, to / name))


def render(folder: Path, number: int, *, prefix: str = "ViewLayer.", stem: str = "", **passes: object) -> Path:
    """A file as Blender writes it, 8 x 6 unless a pass says otherwise; `Vector=None` leaves a pass out."""
    basic = {"Combined": dict.fromkeys("RGBA", 0.5), "Depth": {"Z": 4.0}, "Vector": dict.fromkeys("XYZW", 1.0)}
    attributes = {k: str(v) for k, v in passes.items() if isinstance(v, str)}
    given = {k: v for k, v in passes.items() if isinstance(v, dict)}
    kept = {k: v for k, v in {**basic, **given}.items() if passes.get(k, v) is not None}
    channels = {
        f"{prefix}{name.replace('_', ' ')}.{channel}": np.broadcast_to(np.asarray(value, np.float32), (6, 8))
        if np.size(value) in (1, 48)
        else np.asarray(value, np.float32)
        for name, values in kept.items()
        for channel, value in values.items()
    }
    path = folder / f"{stem}{number:04d}.exr"
    exr.write(path, channels, attributes=attributes)
    return path


def probes(name: str, number: int) -> Iterator[tuple[int, int, dict]]:
    for probe in TRUTH[name]["frames"][str(number)]:
        x, y = probe["pixel"]
        yield x, y, probe


# Real renders.


@pytest.mark.parametrize("name", RIGHT)
def test_depth_motion_and_object_are_those_of_the_formulas(name: str) -> None:
    clip = open_shot(DATA / name)
    assert len(clip) == len(TRUTH[name]["frames"])
    for index, record in enumerate(clip.records):
        frame = clip[index]
        for x, y, probe in probes(name, record.number):
            assert frame.object[0, 0, y, x] == probe["object"]
            assert float(frame.depth[0, 0, y, x]) == pytest.approx(min(probe["depth"], SKY), rel=1e-3)
            if probe["surface"] == "sky" and name == "pan":
                continue  # its own test below
            for field in ("motion", "motion_next"):
                value = getattr(frame, field)
                assert value is not None or name == "v34-nodes"
                if value is not None:
                    np.testing.assert_allclose(value[0, :, y, x].numpy(), probe[field], atol=0.01, err_msg=field)


def test_background_follows_a_turning_camera_where_its_neighbours_are_known() -> None:
    clip = open_shot(DATA / "pan")  # shot.json has the cameras of frames 3, 4 and 5
    frame = clip[1]
    seen = [(x, y, p) for x, y, p in probes("pan", 4) if p["surface"] == "sky"]
    assert len(seen) > 3
    for x, y, probe in seen:
        np.testing.assert_allclose(frame.motion[0, :, y, x].numpy(), probe["motion"], atol=1e-3)
        np.testing.assert_allclose(frame.motion_next[0, :, y, x].numpy(), probe["motion_next"], atol=1e-3)
    x, y, _ = seen[0]
    assert clip[0].motion[0, :, y, x].abs().max() == 0  # no camera of frame 2
    assert clip[0].motion_next[0, :, y, x].abs().max() > 1
    assert any("background" in note for note in open_shot(DATA / "step2").provenance["notes"])
    assert not any("background" in note for note in clip.provenance["notes"])


@pytest.mark.parametrize("name", ["v5", "v34", "v34-ortho", "pan"])
def test_cameras_and_depth_give_the_world_back(name: str) -> None:
    clip = open_shot(DATA / name)
    for index, record in enumerate(clip.records):
        frame = clip[index]
        z = world_position(frame.depth, frame.view, frame.projection)[0, 2]
        for x, y, probe in probes(name, record.number):
            if probe["surface"] != "sky":
                assert float(z[y, x]) == pytest.approx({"plane": 0.0, "cube": 4.0}[probe["surface"]], abs=0.003)


def test_cameras_alone_explain_the_motion_of_what_stands_still() -> None:
    clip = open_shot(DATA / "v5")
    expected = camera_motion(clip[1], clip[0])
    for x, y, probe in probes("v5", 4):
        if probe["surface"] == "plane":
            np.testing.assert_allclose(expected[0, :, y, x].numpy(), probe["motion"], atol=1e-3)


def test_every_spelling_gives_the_same_buffers() -> None:
    clips = {name: open_shot(DATA / name) for name in ("v5", "v5-one-part", "v5-two-layers", "v5-nodes", "v34-nodes")}
    frames = {name: clip[[r.number for r in clip.records].index(4)] for name, clip in clips.items()}
    for name, frame in frames.items():
        if name != "v34-nodes":  # which samples other points of the pixel
            torch.testing.assert_close(frame.color, frames["v5"].color, atol=0, rtol=0)
        for x, y, probe in probes("v5", 4):  # paint and a darker shade of it
            paint = {"cube": (0.25, 0.5), "plane": (2.0, 5 / 3), "sky": (0, 0)}[probe["surface"]]
            red, green, blue = frame.albedo[0, :, y, x].tolist()
            assert (red, green) == pytest.approx((paint[0] * blue, paint[1] * blue), abs=1e-3)
    assert clips["v5-two-layers"].provenance["view_layer"] == "Main"
    assert any("Second" in note for note in clips["v5-two-layers"].provenance["notes"])
    assert "motion_next" not in clips["v34-nodes"].layers
    assert any("motion_next" in note for note in clips["v34-nodes"].provenance["notes"])


@pytest.mark.parametrize("name", RIGHT)
def test_real_shots_pass_the_clip_check(name: str) -> None:
    assert check(open_shot(DATA / name)) == ()


def test_normals_are_unit_or_zero() -> None:
    frame = open_shot(DATA / "v5")[1]
    length = frame.normal.norm(dim=1)
    assert ((length < 0.01) | ((length - 1).abs() < 1e-4)).all()
    assert (length[frame.object[:, 0] == 7] > 0.99).all()


def test_every_second_frame_keeps_vectors_of_the_full_rate() -> None:
    clip = open_shot(DATA / "step2")
    assert [r.time for r in clip.records] == [0, 2, 4, 6]
    assert [r.number for r in clip.records] == [1, 3, 5, 7]
    assert clip[1].span.tolist() == [1]


@pytest.mark.parametrize("name", ["motion-blur", "v34-motion-blur"])
def test_motion_blur_is_named_as_the_cause_of_empty_vectors(name: str) -> None:
    with pytest.raises(ClipError, match=r"every vector is 0 .*Motion Blur"):
        open_shot(DATA / name)


def test_motion_blur_is_noticed_without_cameras_and_depth(tmp_path: Path) -> None:
    ramp = np.tile(np.arange(48, dtype=np.float32) % 12, (48, 1)) + 1
    for number, shift in ((1, 0), (2, 6)):
        moved = np.roll(ramp, shift, 1)
        zero = {c: np.zeros((48, 48)) for c in "XYZW"}
        render(tmp_path, number, Combined=dict.fromkeys("RGBA", moved), Depth=None, Vector=zero)
    with pytest.raises(ClipError, match="Motion Blur"):
        open_shot(tmp_path)


def test_a_shot_that_moves_in_a_few_frames_only_has_vectors(tmp_path: Path) -> None:
    for number in range(1, 6):  # something jumps between the frames 1 and 3 that are looked at, seen by frame 2 alone
        depth = np.full((6, 8), 4.0)
        depth[2:4, 2:4] = 4.0 if number == 1 else 2.0
        render(tmp_path, number, Depth={"Z": depth}, Vector=dict.fromkeys("XYZW", float(number == 2)))
    assert open_shot(tmp_path)[1].motion.abs().max() == 1


def test_a_still_shot_under_changing_light_may_have_no_motion(tmp_path: Path) -> None:
    depth = 4 + np.random.rand(6, 8) * 0.001
    for number in (1, 2, 3):
        light = dict.fromkeys("RGBA", 0.2 * number)
        render(tmp_path, number, Combined=light, Depth={"Z": depth}, Vector=dict.fromkeys("XYZW", 0.0))
    assert open_shot(tmp_path)[1].motion.abs().max() == 0


def test_still_pictures_one_after_the_other_may_have_no_motion(tmp_path: Path) -> None:
    for number in range(1, 6):  # the camera is another one from frame 3 on
        depth, name = (4.0, "wide") if number < 3 else (2.0, "close")
        render(tmp_path, number, Depth={"Z": depth}, Vector=dict.fromkeys("XYZW", 0.0), Camera=name)
    assert [r.cut for r in open_shot(tmp_path).records] == [False, False, True, False, False]


def test_wrong_vectors_of_a_moving_orthographic_camera_are_refused() -> None:
    with pytest.raises(ClipError, match=r"orthographic.*perspective"):
        open_shot(DATA / "ortho")


def test_a_zoom_is_not_taken_for_an_orthographic_camera(tmp_path: Path) -> None:
    zoom = np.tile(np.arange(48, dtype=np.float32) - 24, (48, 1)) * 0.3
    still = np.zeros((48, 48))
    for number in (1, 2):  # the previous position lies outwards, the next one inwards
        wide = {"Combined": dict.fromkeys("RGBA", still + 1), "Depth": {"Z": still + 5}}
        render(tmp_path, number, **wide, Vector={"X": zoom, "Y": still, "Z": zoom, "W": still})
    frame = open_shot(tmp_path)[1]
    assert frame.motion[0, 0, 0, 0] == pytest.approx(-7.2)
    assert frame.motion_next[0, 0, 0, 0] == pytest.approx(7.2)


# What the passes become.


def test_signs_sky_and_negatives(tmp_path: Path) -> None:
    depth = np.full((6, 8), 3.0)
    depth[0, :4] = 1e10, 1e11, np.inf, 1e5  # background, outside the border, half-float background, far away
    color = {"R": -0.25, "G": 0.0, "B": 9.0, "A": 1.0}
    render(tmp_path, 1, Combined=color, Depth={"Z": depth}, Vector={"X": 1, "Y": 2, "Z": 3, "W": 4})
    frame = open_shot(tmp_path)[0]
    assert frame.color[0, :, 2, 2].tolist() == [0, 0, 9]
    assert frame.depth[0, 0, 0].tolist() == [SKY] * 4 + [3] * 4
    assert frame.motion[0, :, 1, 1].tolist() == [1, -2]
    assert frame.motion_next[0, :, 1, 1].tolist() == [-3, 4]


def test_odd_names_and_material_passes(tmp_path: Path) -> None:
    extra = {"Roughness": {"X": 0.25}, "METALLIC": {"X": 1.0}, "Base_Color": dict.fromkeys("RGB", 0.7)}
    odd = {
        "combined": dict.fromkeys("rgba", 0.5),
        "vector": dict.fromkeys("xyzw", 2.0),
        "DiffCol": dict.fromkeys("RGB", 0.1),
    }
    render(tmp_path, 1, prefix="my.layer.", Combined=None, Vector=None, **odd, **extra)
    clip = open_shot(tmp_path)
    frame = clip[0]
    assert clip.provenance["view_layer"] == "my.layer"
    assert float(frame.roughness.max()) == 0.25
    assert float(frame.metallic.min()) == 1
    assert float(frame.albedo[0, 1, 0, 0]) == pytest.approx(0.7)  # the one that metals have too
    assert frame.motion[0, 0, 0, 0] == 2


def test_a_composite_layer_is_left_alone(tmp_path: Path) -> None:
    path = render(tmp_path, 1)
    composite = {f"Composite.Combined.{c}": np.ones((6, 8), np.float32) for c in "RGBA"}
    exr.write(path, composite | exr.read(path).channels)
    clip = open_shot(tmp_path)
    assert float(clip[0].color.max()) == 0.5
    assert any("Composite left alone" in note for note in clip.provenance["notes"])


def test_frame_rate_is_asked_told_read_or_assumed(tmp_path: Path) -> None:
    assert open_shot(DATA / "v5", fps=12).fps == 12
    assert open_shot(DATA / "v5").fps == 24
    for number in (59, 60):
        render(tmp_path, number, Frame=str(number), Time=f"00:00:01:{number - 30:02d}")
    clip = open_shot(tmp_path)
    assert clip.fps == 30
    assert any("timecode" in note for note in clip.provenance["notes"])
    render(tmp_path / "mute", 1)
    clip = open_shot(tmp_path / "mute")
    assert (clip.fps, "assumed" in clip.provenance["notes"][0]) == (24, True)
    with pytest.raises(ValueError, match="above 0"):
        open_shot(tmp_path, fps=0)


def test_another_camera_is_a_cut(tmp_path: Path) -> None:
    for number in range(1, 5):
        render(tmp_path, number, Camera="wide" if number < 3 else "close")
    clip = open_shot(tmp_path)
    assert [bool(clip[i].reset) for i in range(4)] == [True, False, True, False]


def test_a_cut_in_a_frame_that_was_left_out_cuts_the_next_one(tmp_path: Path) -> None:
    eye = np.eye(4).tolist()
    for number in (1, 3, 5):
        render(tmp_path, number)
    rows = [{"frame": n, "camera_to_world": eye, "lens_mm": 36, "cut": n == 4} for n in range(1, 6)]
    (tmp_path / "shot.json").write_text(json.dumps({"frames": rows}))
    assert [r.cut for r in open_shot(tmp_path).records] == [False, False, True]


@pytest.mark.parametrize(
    ("size", "camera", "rows"),
    [  # what Blender itself says for these cameras (`Object.calc_matrix_camera`), rows x, y and w
        ((64, 36), {"lens_mm": 35}, [[3.45679, 0, 0, 0], [0, 1.944444, 0, 0], [0, 0, -1, 0]]),
        (
            (36, 64),
            {"lens_mm": 50, "shift": [0.1, -0.2]},
            [[2.777778, 0, 0.2, 0], [0, 4.938272, -0.711111, 0], [0, 0, -1, 0]],
        ),
        (
            (50, 40),
            {
                "lens_mm": 50,
                "sensor_fit": "VERTICAL",
                "sensor_height_mm": 20,
                "shift": [0.3, 0.1],
                "pixel_aspect": [1, 1.5],
            },
            [[9.375, 0, 1.125, 0], [0, 5, 0.2, 0], [0, 0, -1, 0]],
        ),
        (
            (50, 60),
            {"camera": "ORTHO", "ortho_scale": 7, "shift": [0.1, 0.05], "pixel_aspect": [1, 1.5]},
            [[0.357143, 0, 0, -0.25], [0, 0.285714, 0, -0.1], [0, 0, 0, 1]],
        ),
    ],
)
def test_projections_are_blenders_own(tmp_path: Path, size: tuple, camera: dict, rows: list) -> None:
    to_world = np.diag([2.0, 2.0, 2.0, 1.0]) + np.eye(4, k=3) * 5  # a scaled camera at x = 5
    entry = {"frame": 1, "camera_to_world": to_world.tolist(), **camera}
    (tmp_path / "shot.json").write_text(json.dumps({"frames": [entry]}))
    found = read_shot(tmp_path, size).cameras[1]
    np.testing.assert_allclose(np.array(found.projection)[[0, 1, 3]], rows, atol=2e-6)
    np.testing.assert_allclose(found.view, np.eye(4) - np.eye(4, k=3) * 5)


def test_a_panorama_has_no_projection() -> None:
    clip = open_shot(DATA / "panorama")
    assert clip[0].projection is None
    assert clip[0].view is not None
    assert any("panorama" in note for note in clip.provenance["notes"])


# Folders that cannot be used.


def _gap(folder: Path) -> None:
    for number in (1, 2, 3, 4, 6, 7, 8, 9):
        render(folder, number)


def _gap_of_two(folder: Path) -> None:
    for number in (1, 3, 5, 11):
        render(folder, number)


def _two_sizes(folder: Path) -> None:
    render(folder, 1)
    large = np.ones((12, 16))
    render(folder, 2, Combined=dict.fromkeys("RGBA", large), Depth={"Z": large}, Vector=dict.fromkeys("XYZW", large))


def _two_stems(folder: Path) -> None:
    for number in (1, 2):
        render(folder, number, stem="hall_")
        render(folder, number, stem="yard_")


def _double(folder: Path) -> None:
    render(folder, 1)
    shutil.copy(folder / "0001.exr", folder / "1.exr")


def _header_only(folder: Path) -> None:
    path = render(folder, 1)
    path.write_bytes(path.read_bytes()[:200])


def _truncated(folder: Path) -> None:
    path = render(folder, 1)
    path.write_bytes(path.read_bytes()[:-60])


def _pass_lost(folder: Path) -> None:
    render(folder, 1)
    render(folder, 2, Depth=None)


def _bad_json(folder: Path) -> None:
    render(folder, 1)
    (folder / "shot.json").write_text('{"frames": [{"frame": 1')


def _no_matrix(folder: Path) -> None:
    render(folder, 1)
    (folder / "shot.json").write_text('{"frames": [{"frame": 1}]}')


BROKEN = {
    "nothing": (lambda folder: folder.mkdir(), r"holds no EXR file; render the animation as OpenEXR MultiLayer"),
    "unnumbered": (
        lambda folder: render(folder, 1).rename(folder / "still.exr"),
        r"1 EXR files without a frame number",
    ),
    "gap": (_gap, r"frame 5 is missing in the middle \(found 1-4, 6-9\)"),
    "gap of two": (_gap_of_two, r"frames 7, 9 are missing in the middle \(found 1, 3, 5, 11\)"),
    "two sizes": (_two_sizes, r"frame 2 is 16x12 but frame 1 is 8x6"),
    "two stems": (_two_stems, r"2 sequences \(hall_ 1-2 and yard_ 1-2\)"),
    "double": (_double, r"two files of frame 1"),
    "header only": (_header_only, r"0001\.exr is not a readable EXR file \(truncated or damaged\)"),
    "truncated": (_truncated, r"0001\.exr .*truncated"),
    "no Combined": (lambda folder: render(folder, 1, Combined=None), r"no Combined pass \(it has ViewLayer\.Depth, "),
    "no Vector": (lambda folder: render(folder, 1, Vector=None), r"no Vector pass .*switch Motion Blur off"),
    "pass lost": (_pass_lost, r"0002\.exr lacks ViewLayer\.Depth\.Z"),
    "bad json": (_bad_json, r"shot\.json cannot be read"),
    "no matrix": (_no_matrix, r"shot\.json lacks 'camera_to_world'"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_what_is_wrong_is_said_in_one_sentence(name: str, tmp_path: Path) -> None:
    make, words = BROKEN[name]
    make(tmp_path / "shot")
    with pytest.raises(ClipError, match=words) as caught:
        save(open_any(tmp_path / "shot"), tmp_path / "clip")
    assert "\n" not in str(caught.value)
    assert [p.name for p in tmp_path.iterdir()] == ["shot"]


@pytest.mark.parametrize("name", BROKEN)
def test_the_command_line_says_it_and_leaves_nothing(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    make, words = BROKEN[name]
    make(tmp_path / "shot")
    for command in ("import", "upsample"):
        assert main([command, str(tmp_path / "shot"), "-o", str(tmp_path / "out")]) == 2
        error = capsys.readouterr().err
        assert re.search(words, error)
        assert error.count("\n") == 1
        made = [path for path in tmp_path.rglob("*") if "shot" not in path.parts]
        assert all(exr.read(path).size for path in made if path.suffix == ".exr")
        assert not made or "pass lost" in name or "truncated" in name, made


def test_no_such_folder(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="is not there; give the folder"):
        open_any(tmp_path / "nowhere")
    with pytest.raises(FileNotFoundError, match="is a file; give the folder"):
        open_any(render(tmp_path, 1))


def test_only_headers_and_two_frames_are_read_at_opening(tmp_path: Path) -> None:
    for number in range(1, 7):
        path = render(tmp_path, number)
    path.write_bytes(path.read_bytes()[:-60])
    clip = open_shot(tmp_path)
    assert clip[4].color is not None
    with pytest.raises(ClipError, match=r"0006\.exr .*truncated"):
        clip[5]


# NaN and infinite pixels.


@pytest.fixture
def spoiled(tmp_path: Path) -> Path:
    folder = tmp_path / "spoiled"
    for number in (1, 2, 3):
        color = {c: np.full((6, 8), 0.5) for c in "RGBA"}
        vector = {c: np.ones((6, 8)) for c in "XYZW"}
        if number == 2:
            color["R"][2, 3], color["G"][2, 3], vector["Y"][0, 0] = np.nan, -np.inf, np.inf
        render(folder, number, Combined=color, Vector=vector, Object_Index={"X": np.full((6, 8), 3.0)})
    return folder


def test_bad_pixels_are_named_by_frame_and_layer(spoiled: Path) -> None:
    clip = open_shot(spoiled)
    assert clip[0].color is not None
    with pytest.raises(ClipError, match=r"frame 2 of .*: 2 NaN or infinite pixels in color; .*--repair"):
        clip[1]


def test_repair_replaces_and_counts(spoiled: Path, tmp_path: Path) -> None:
    frame = open_shot(spoiled, repair=True)[1]
    assert frame.color[0, :, 2, 3].tolist() == [0.5, 0.5, 0.5]
    assert frame.motion[0, :, 0, 0].tolist() == [1, 0]
    saved = save(open_shot(spoiled), tmp_path / "clip", repair=True)
    assert repairs(saved) == 3
    torch.testing.assert_close(saved[1].color, frame.color)
    assert saved[1].object.unique().tolist() == [3]


def test_ranges() -> None:
    assert ranges([3, 1, 2]) == "1-3"
    assert ranges([1, 2, 4, 6, 7]) == "1-2, 4, 6-7"
    assert ranges([1, 3, 5, 7]) == "1-7 step 2"
    assert ranges([4]) == "4"
    assert absent([4]) == absent([1, 3, 5]) == ""
    assert absent([1, 2, 4]) == "frame 3 is"
    assert absent([1, 3, 7, 13, 23]) == "frames 5, 9, 11, 15-21 step 2 are"
    assert absent([1, 2, 999_999_999]) == "frames 3-999999998 are"  # a date among the frames takes no memory
