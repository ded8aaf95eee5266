"""The doctor on a world that is known on paper: every answer has to follow from the pictures."""

import json
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import doctor_scene
import numpy as np
import pytest
from doctor_scene import SIZE, changed, frames, write

from framecast import exr
from framecast.cli import main
from framecast.clip import Record, finish, write_frame
from framecast.doctor import camera, motion, probe, search
from framecast.doctor.depth import planarity
from framecast.doctor.edges import Edges, edges_of
from framecast.doctor.examine import examine
from framecast.doctor.follow import steps_of
from framecast.doctor.jitter import Match
from framecast.doctor.motion import displacement
from framecast.doctor.say_depth import tangents_of, tell_depth
from framecast.doctor.say_jitter import tell_jitter
from framecast.doctor.say_motion import fields_of, tell_motion
from framecast.doctor.say_rest import (
    tell_color,
    tell_edges,
    tell_exposure,
    tell_normals,
    tell_offset,
    tell_padding,
    tell_time,
)
from framecast.doctor.source import open_source
from framecast.doctor.surface import SIGNS, Normals, Tone, normals_of, tone_of
from framecast.doctor.take import Take, load
from framecast.doctor.timeline import exposure_of
from framecast.importers import open_any
from framecast.importers.decode import decode_motion
from framecast.importers.encode import encode_depth, encode_motion
from framecast.importers.folder import open_folder
from framecast.importers.settings import Color, Depth, Jitter, Motion, Normal, read_settings

MOTION = Motion(files=("{frame}.exr",), channels=("X", "Y"))


@pytest.fixture(scope="module")
def take(tmp_path_factory: pytest.TempPathFactory) -> Take:
    """Eight frames of the world, as the doctor loads them."""
    return load(open_source(write(tmp_path_factory.mktemp("world") / "clip", frames())))


@pytest.fixture(autouse=True)
def _few_points(monkeypatch: pytest.MonkeyPatch) -> None:
    """The pictures are small, and so is what has to be looked at."""
    monkeypatch.setattr(motion, "POINTS", 1600)
    monkeypatch.setattr(camera, "POINTS", 1600)
    monkeypatch.setattr(motion, "PAIRS", 5)


def altered(take: Take, name: str, change) -> Take:
    return replace(take, stored=[{**s, name: change(s[name])} if name in s else s for s in take.stored])


def fixes(findings) -> set[str]:
    return {f.code for f in findings if f.state == "fix"}


def test_vectors_in_points_are_those_that_importers_decode() -> None:
    stored = np.random.default_rng(0).uniform(0.3, 0.7, (2, 6, 9)).astype(np.float32)
    for units in ("pixels", "uv", "ndc"):
        for packing, bias in (("none", (0.0, 0.0)), ("none", (0.5, 0.4)), ("unreal_sqrt", (0.5, 0.5))):
            for direction in ("current->previous", "previous->current"):
                m = replace(
                    MOTION,
                    units=units,
                    packing=packing,
                    bias=bias,
                    direction=direction,
                    sign=(1.0, -1.0),
                    scale=(2.0, 3.0),
                )
                expected = decode_motion(stored, m, (6, 9))
                got = displacement(stored.reshape(2, -1), m, (6, 9), (6, 9)).reshape(2, 6, 9)
                np.testing.assert_allclose(got, expected, rtol=1e-5, atol=1e-5)


READINGS = {
    "motion.sign": replace(MOTION, direction="previous->current"),
    "motion.y": replace(MOTION, sign=(1.0, -1.0)),
    "motion.x": replace(MOTION, sign=(-1.0, 1.0)),
    "motion.length": replace(MOTION, scale=(2.0, 2.0)),
    "motion.unit": replace(MOTION, units="uv", direction="previous->current"),
    "motion.code": replace(MOTION, units="ndc", sign=(1.0, -1.0), bias=(32767 / 65535,) * 2, scale=(4.008,) * 2),
}  # fmt: skip


@pytest.mark.parametrize("code", READINGS)
def test_stored_in_another_convention_vectors_are_read_in_that(take: Take, code: str) -> None:
    stored = altered(take, "motion", lambda v: encode_motion(v, READINGS[code]).astype(np.float32))
    told = tell_motion(stored, MOTION)
    assert code in fixes(told.findings)
    found = fields_of(stored, told, [4])[4]
    apart = np.abs(found - take.stored[4]["motion"]).max(0)
    assert np.median(apart) < 0.05  # pixels
    assert told.answer is not None
    assert told.answer.best.mean < 0.75 * told.answer.claim.mean


def test_a_still_picture_is_undecidable_and_says_what_to_record(tmp_path: Path) -> None:
    examined = examine(write(tmp_path / "clip", frames(5, step=0, speed=0)))
    assert examined.report.verdict == "undecidable"
    assert "record a camera that moves" in examined.report.text()


def test_without_texture_nothing_is_claimed(take: Take) -> None:
    flat = replace(take, images=[np.zeros_like(image) for image in take.images])
    (finding,) = tell_motion(flat, MOTION).findings
    assert finding.state == "unknown"
    assert "no texture" in finding.says


def test_empty_vectors_of_a_moving_picture_are_no_still_picture(take: Take) -> None:
    told = tell_motion(altered(take, "motion", np.zeros_like), MOTION)
    assert fixes(told.findings) == {"motion.empty"}


def test_vectors_without_the_cameras_part_and_vectors_not_written(take: Take) -> None:
    moving = [np.abs(s["motion"] - _camera(t)).max(0) > 0.02 for t, s in enumerate(take.stored)]
    lacking = [
        {**s, "motion": np.where(m, s["motion"] - _camera(t), 0)}
        for t, (s, m) in enumerate(zip(take.stored, moving, strict=True))
    ]
    empty = [{**s, "motion": np.where(m, s["motion"], 0)} for s, m in zip(take.stored, moving, strict=True)]
    assert "motion.camera" in fixes(tell_motion(replace(take, stored=lacking), MOTION).findings)
    assert "motion.unwritten" in fixes(tell_motion(replace(take, stored=empty), MOTION).findings)
    told = tell_motion(replace(take, stored=empty), replace(MOTION, unwritten=0.0))
    assert ("motion.unwritten", "note") in {(f.code, f.state) for f in told.findings}
    assert fixes(told.findings) == set()


def _camera(t: int) -> np.ndarray:
    """The vectors of the world if the card did not slide."""
    record = frames(t + 1)[t][0]
    still = doctor_scene.frame(t, record.jitter)
    y, x = np.mgrid[0 : SIZE[0], 0 : SIZE[1]] + 0.5
    here = np.stack([x + record.jitter[0], y + record.jitter[1]])
    pose = doctor_scene.camera(t, 1.0)
    focal = SIZE[0] / 2 / np.tan(doctor_scene.FOV / 2)
    z = still["depth"][0].astype(float)
    local = np.stack([(here[0] - SIZE[1] / 2) / focal * z, (SIZE[0] / 2 - here[1]) / focal * z, -z, np.ones_like(z)])
    world = np.einsum("ij,jhw->ihw", pose, local)[:3]
    return (doctor_scene.places(world, doctor_scene.camera(t - 1, 1.0)) - here).astype(np.float32)


@pytest.mark.parametrize(("kind", "scale"), [("planar", 100.0), ("inverse", 0.1)])
def test_what_depth_is_follows_from_pictures_and_cameras_alone(tmp_path: Path, kind: str, scale: float) -> None:
    take = load(open_source(write(tmp_path / "clip", frames(5, jittered=False, speed=0))))
    stored = altered(take, "depth", lambda z: np.where(z < 60000, scale * z if kind == "planar" else scale / z, 0))
    points = probe.pick_points(take.images[4].astype(np.float32), np.ones(SIZE, bool), 800, 0)
    found = camera.distance_of(stored, camera.between(stored, 4, 3, points), points)
    assert found is not None
    assert found.kind == kind
    assert found.scale == pytest.approx(1 / scale if kind == "planar" else scale, rel=0.1)


def test_a_frame_left_out_and_a_frame_turned_around(take: Take, tmp_path: Path) -> None:
    shorter = [(replace(r, number=i + 1, time=float(i)), a) for i, (r, a) in enumerate(frames(9)[:4] + frames(9)[5:])]
    gap = load(open_source(write(tmp_path / "gap", shorter)))
    told = tell_motion(gap, MOTION)
    findings, apart = tell_time(gap, steps_of(gap, told), ())
    assert fixes(findings) == {"frames.skipped"}
    assert apart == {4}
    ahead = [{**s, "motion": -take.stored[min(t + 1, 7)]["motion"]} for t, s in enumerate(take.stored)]
    onward = replace(MOTION, direction="current->next")
    steps = steps_of(replace(take, stored=ahead), tell_motion(replace(take, stored=ahead), onward))
    assert [step.source for step in steps] == [step.frame - 1 for step in steps]
    last = [{**s, "motion": s["motion"] * (-1 if t == 7 else 1)} for t, s in enumerate(take.stored)]
    told = tell_motion(replace(take, stored=last), MOTION)
    findings, apart = tell_time(take, steps_of(replace(take, stored=last), told), ())
    assert fixes(findings) == {"motion.turned"}
    assert apart == {7}


def test_jitter_turned_lost_and_inside_the_vectors(take: Take) -> None:
    told = tell_motion(take, MOTION)
    assert told.answer is not None
    shake, every = told.answer.shake, fields_of(take, told, take.pairs)
    (fine,), _, inside = tell_jitter(take, shake, every, Jitter())
    assert (fine.state, inside) == ("fine", False)
    turned = replace(take, records=[replace(r, jitter=(r.jitter[0], -r.jitter[1])) for r in take.records])
    told = tell_motion(turned, MOTION)
    assert told.answer is not None
    (finding,), jitter, _ = tell_jitter(turned, told.answer.shake, every, Jitter())
    assert finding.code == "jitter.sign"
    assert jitter.sign == (1.0, -1.0)
    lost = replace(take, recorded=frozenset())
    (finding,), jitter, _ = tell_jitter(lost, replace(shake, recorded=None), every, Jitter())
    assert finding.code == "jitter.unrecorded"
    assert (jitter.halton, jitter.start) == (8, 0)
    steps = [np.subtract(r.jitter, take.records[max(t - 1, 0)].jitter) for t, r in enumerate(take.records)]
    held = replace(
        take,
        stored=[
            {**s, "motion": s["motion"] + d[:, None, None].astype(np.float32)}
            for s, d in zip(take.stored, steps, strict=True)
        ],
    )
    told = tell_motion(held, MOTION)
    assert told.answer is not None
    (finding,), _, inside = tell_jitter(held, told.answer.shake, fields_of(held, told, held.pairs), Jitter())
    assert finding.code == "motion.jittered"
    assert inside


@pytest.mark.parametrize(("kind", "near"), [("euclidean", 0.0), ("reversed", 0.1), ("inverse", 0.0)])
def test_kinds_of_depth_follow_from_planes_and_parallax(take: Take, kind: str, near: float) -> None:
    about = Depth(files=("{frame}.exr",), channels=("Z",), kind=kind, near=near)
    stored = altered(take, "depth", lambda z: encode_depth(z, about, take.records[0].projection).astype(np.float32))
    vectors = {t: take.stored[t]["motion"] for t in (2, 4, 6)}
    findings, found = tell_depth(stored, replace(about, kind="planar", near=0.0), vectors, 32)
    assert fixes(findings) == {"depth.kind"}
    assert found is not None
    assert found.kind in ({kind, "reversed"} if kind == "inverse" else {kind})
    findings, _ = tell_depth(stored, about, vectors, 32)
    assert fixes(findings) == set()


def test_planes_are_straight_in_inverse_depth_alone(take: Take) -> None:
    law = planarity(take, tangents_of(take))
    assert law.misfits["planar"] < 0.1 * min(m for k, m in law.misfits.items() if k != "planar")


def test_depth_in_centimetres_under_cameras_in_metres(take: Take) -> None:
    about = Depth(files=("{frame}.exr",), channels=("Z",))
    stored = altered(take, "depth", lambda z: np.where(z > 60000, z, z * 100).astype(np.float32))
    findings, found = tell_depth(stored, about, {t: take.stored[t]["motion"] for t in (2, 4, 6)}, 32)
    assert fixes(findings) == {"depth.scale"}
    assert found is not None
    assert found.scale == pytest.approx(0.01, rel=0.05)


def test_normals_in_view_space_turned_and_encoded(take: Take) -> None:
    about = Normal(files=("{frame}.exr",), channels=("X", "Y", "Z"))
    depths = {t: take.stored[t]["depth"][0] for t in take.full("normal")}
    tangent = tangents_of(take)[0]

    def told(change) -> tuple[set[str], Normal | None]:
        findings, found = tell_normals(normals_of(altered(take, "normal", change), depths, tangent, about), about)
        return fixes(findings), found

    assert told(lambda n: n)[0] == set()
    codes, found = told(lambda n: n * np.array([1, -1, 1], np.float32)[:, None, None])
    assert codes == {"normal.sign"}
    assert found is not None
    assert found.sign[1] == -1
    codes, found = told(lambda n: n / 2 + 0.5)
    assert codes == {"normal.encoded"}
    assert found is not None
    assert found.encoded
    views = [np.asarray(r.view)[:3, :3] @ np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]]) for r in take.records]
    tilted = replace(
        take,
        records=[
            replace(r, view=tuple(map(tuple, np.vstack([np.hstack([v, np.zeros((3, 1))]), [0, 0, 0, 1]]).tolist())))
            for r, v in zip(take.records, views, strict=True)
        ],
    )
    findings, found = tell_normals(normals_of(tilted, depths, tangent, about), about)  # as stored nearly view space
    assert fixes(findings) == {"normal.space"}


def test_planes_tell_world_from_view_where_the_camera_is_hardly_turned(tmp_path: Path) -> None:
    about = Normal(files=("{frame}.exr",), channels=("X", "Y", "Z"))
    take = load(open_source(write(tmp_path / "clip", frames(4, step=0.5))))
    depths = {t: take.stored[t]["depth"][0] for t in take.full("normal")}
    measured = normals_of(take, depths, tangents_of(take)[0], about)
    assert measured is not None
    assert measured.turning < 1
    assert [f.state for f in tell_normals(measured, about)[0]] == ["fine"]
    seen = [
        {**s, "normal": np.einsum("ij,jhw->ihw", np.asarray(r.view)[:3, :3], s["normal"])} if "normal" in s else s
        for s, r in zip(take.stored, take.records, strict=True)
    ]
    findings, _ = tell_normals(normals_of(replace(take, stored=seen), depths, tangents_of(take)[0], about), about)
    assert fixes(findings) == {"normal.space"}


def test_normals_without_cameras_are_only_wrong_where_an_axis_is_mirrored(take: Take) -> None:
    about = Normal(files=("{frame}.exr",), channels=("X", "Y", "Z"))
    alone = replace(take, recorded=frozenset())
    depths = {t: take.stored[t]["depth"][0] for t in take.full("normal")}
    tangent = tangents_of(take)[0]

    def told(turn: np.ndarray, axes: str = "opengl", *, view: bool = False) -> tuple[list[str], Normal | None]:
        stored = []
        for planes, record in zip(take.stored, take.records, strict=True):
            turned = turn @ np.asarray(record.view)[:3, :3] if view else turn
            normal = {k: np.einsum("ij,jhw->ihw", turned, n) for k, n in planes.items() if k == "normal"}
            stored.append({**planes, **normal})
        findings, found = tell_normals(normals_of(replace(alone, stored=stored), depths, tangent, about, axes), about)
        return [f"{f.state} {f.code}" for f in findings], found

    c, s = np.cos(0.9), np.sin(0.9)
    away, mirror = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]), np.diag([1.0, 1, -1])
    for turn, axes in ((away, "opengl"), (np.diag([-1.0, 1, -1]), "opengl"), (mirror, "unity")):
        assert told(turn, axes)[0] == ["fine normal"]
    for view in (True, False):  # the camera is hardly turned, so that world and view are nearly the same
        assert told(np.eye(3), view=view)[0] == ["unknown normal.open"]
    flipped = (1.0, -1.0, 1.0)
    facing = {sign: 3.0 if sign == flipped else 60.0 for sign in SIGNS}
    angles = {("view", sign): angle for sign, angle in facing.items()}
    mirrored = Normals(False, 1.0, 0.0, angles, {}, {"proper": 40.0, "mirrored": 3.0}, facing, 0.0, 1000)
    (finding,), found = tell_normals(mirrored, about)
    assert (finding.state, finding.code) == ("fix", "normal.sign")
    assert found is not None
    assert found.sign == flipped


def test_display_colour_is_told_by_albedo_edges(take: Take) -> None:
    about = Color(files=("{frame}.exr",), channels=("R", "G", "B"))
    assert fixes(tell_color(tone_of(take), about, 32)[0]) == set()
    encoded = altered(take, "color", lambda c: np.maximum(c, 0) ** (1 / 2.2))
    findings, found = tell_color(tone_of(encoded), about, 32)
    assert fixes(findings) == {"color.encoding"}
    assert found.encoding == "srgb"
    hazy = Tone(slope=0.5, edges=5000, peak=16.0, clipped=0.0, middle=0.2)
    assert fixes(tell_color(hazy, about, 32)[0]) == set()  # no display value is 16
    assert fixes(tell_color(replace(hazy, peak=1.0), about, 32)[0]) == {"color.encoding"}


def test_exposure_that_changes_all_over_the_picture(take: Take) -> None:
    told = tell_motion(take, MOTION)
    assert tell_exposure(exposure_of(take, steps_of(take, told)), 8) == ([], None)
    factors = 1 + 0.2 * (np.arange(8) % 2)
    lit = replace(take, images=[(i + np.log(f)).astype(np.float16) for i, f in zip(take.images, factors, strict=True)])
    findings, found = tell_exposure(exposure_of(lit, steps_of(lit, told)), 8)
    assert fixes(findings) == {"color.exposure"}
    np.testing.assert_allclose(found, factors, rtol=0.05)


def test_vectors_of_another_frame_jump_where_that_ones_depth_does(take: Take) -> None:
    assert tell_offset(take, 0) == ([], 0)
    late = [{**s, "motion": take.stored[max(t - 1, 0)]["motion"]} for t, s in enumerate(take.stored)]
    findings, offset = tell_offset(replace(take, stored=late), 0)
    assert fixes(findings) == {"motion.offset"}
    assert offset == -1


def test_dilated_vectors_reach_one_pixel_beyond_the_card() -> None:
    depth = np.full((20, 30), 9.0)
    depth[5:15, 10:20] = 3
    crisp, wide = (np.zeros((2, 20, 30), np.float32) for _ in range(2))
    crisp[0, 5:15, 10:20] = 4
    wide[0, 4:16, 9:21] = 4
    assert edges_of({0: crisp}, {0: depth}).dilated == 0
    assert edges_of({0: wide}, {0: depth}).dilated == 1
    soft = (crisp + np.roll(crisp, 1, 2) + np.roll(crisp, -1, 2)) / 3
    assert edges_of({0: soft}, {0: depth}).mixed > 0.4
    assert edges_of({0: wide}, {0: depth}, grain=1.0).count == 0  # vectors in steps of a pixel tell nothing
    assert [f.code for f in tell_edges(Edges(0, 0.0, 0.0), False)] == ["motion.edges"]


def test_padding_is_cut_off(take: Take) -> None:
    padded = replace(take, images=[np.pad(i, ((0, 0), (0, 6), (0, 4)), constant_values=-3) for i in take.images])
    findings, crop = tell_padding(padded)
    assert fixes(findings) == {"frames.padded"}
    assert crop is not None
    assert abs(crop[0] - SIZE[1]) <= 1
    assert abs(crop[1] - SIZE[0]) <= 1
    assert tell_padding(take) == ([], None)


def test_a_plain_background_beside_a_thing_is_no_padding(take: Take) -> None:
    cut = lambda i: np.pad(i[:, 8:-20, 9:-20], ((0, 0), (8, 20), (9, 20)), constant_values=-3)  # noqa: E731
    assert tell_padding(replace(take, images=[cut(image) for image in take.images])) == ([], None)


def test_vectors_that_are_alike_everywhere_were_written(tmp_path: Path) -> None:
    """A camera with parallel rays goes sideways by three pixels a frame, past a wall and a card that slides."""
    y, x = np.mgrid[0:72, 0:128] + 0.5
    for t in range(8):
        card = (np.abs(x - 40 - 2 * t) < 12) & (np.abs(y - 30) < 9)
        wall = np.stack([doctor_scene.noise((x + 3 * t) / k, y / k) for k in (9, 7, 5)])
        layers = {
            "color": np.where(card, 2 * doctor_scene.noise((x - 2 * t) / 5, y / 5), wall).astype(np.float32),
            "motion": np.stack([np.where(card, -2.0, 3.0), 0 * x]).astype(np.float32),
        }
        write_frame(tmp_path / "pan", Record(t, float(t)), layers)
    pan = load(open_source(finish(tmp_path / "pan", fps=24).path))
    assert {f.code for f in tell_motion(pan, MOTION).findings if f.state != "unknown"} == {"motion"}


def test_the_command_writes_settings_with_which_the_importer_reads_the_truth(tmp_path: Path, capsys) -> None:
    world, dump = frames(7), tmp_path / "dump"
    about = replace(MOTION, units="uv", direction="previous->current", sign=(1.0, -1.0))
    for record, layers in world:
        channels = {f"beauty.{c}": p for c, p in zip("RGB", layers["color"], strict=True)}
        channels |= dict(zip(("velocity.u", "velocity.v"), encode_motion(layers["motion"], about), strict=True))
        channels |= {"dist.Z": (0.1 / layers["depth"][0]).astype(np.float32)}
        exr.write(dump / f"shot.{record.number:04d}.exr", channels)
    (dump / "notes.txt").write_text("not an image")
    assert main(["doctor", str(dump), "-o", str(tmp_path / "out"), "--json"]) == 1
    said = json.loads(capsys.readouterr().out)
    assert {"motion.x", "motion.unit"} <= {f["code"] for f in said["findings"]}
    assert (tmp_path / "out" / "doctor.png").stat().st_size > 10_000
    clip = open_folder(dump, read_settings(tmp_path / "out"))
    got = clip[3].motion
    assert got is not None
    apart = np.abs(got[0].numpy() - world[3][1]["motion"]).max(0)
    assert np.median(apart) < 0.02


def test_a_healthy_clip_ends_with_0(tmp_path: Path, capsys) -> None:
    clip = write(tmp_path / "clip", frames())
    assert main(["doctor", str(clip), "-o", str(tmp_path / "out")]) == 0
    said = capsys.readouterr().out
    assert "healthy" in said
    assert "FIX" not in said


def test_a_turned_axis_ends_with_1_and_says_so_in_words(tmp_path: Path, capsys) -> None:
    flipped = changed(frames(), "motion", lambda v: v * np.array([1, -1])[:, None, None])
    folder, out = write(tmp_path / "clip", flipped), tmp_path / "out"
    assert main(["doctor", str(folder), "-o", str(out)]) == 1
    assert "vertical motion is upside down" in capsys.readouterr().out
    clip = open_any(folder, settings=out / "framecast-import.json")
    for index, (record, layers) in enumerate(frames()):
        found = clip.records[index]
        np.testing.assert_allclose(clip[index].motion[0], layers["motion"], atol=1e-4)
        np.testing.assert_allclose(found.view, record.view, atol=1e-6)
        assert found.jitter == pytest.approx(record.jitter)


def test_vectors_of_some_rows_and_columns_are_those_of_all(take: Take) -> None:
    told = tell_motion(take, MOTION)
    np.testing.assert_array_equal(fields_of(take, told, [4], 3)[4], fields_of(take, told, [4])[4][:, ::3, ::3])


def test_a_cut_under_a_camera_that_stands_is_no_camera_that_moves(tmp_path: Path) -> None:
    take = load(open_source(write(tmp_path / "clip", frames(6, jittered=False, step=0))))
    half = lambda a, t: np.ascontiguousarray(a[:, ::-1, ::-1]) if t >= 3 else a  # noqa: E731
    roll = np.diag([-1.0, -1, 1, 1])
    views = [roll @ np.asarray(r.view) if t >= 3 else np.asarray(r.view) for t, r in enumerate(take.records)]
    spliced = replace(
        take,
        images=[half(image, t) for t, image in enumerate(take.images)],
        stored=[{k: half(a.round(4), t) for k, a in s.items()} for t, s in enumerate(take.stored)],
        records=[replace(r, view=tuple(map(tuple, v.tolist()))) for r, v in zip(take.records, views, strict=True)],
    )
    assert motion.blank(spliced.stored[3]["motion"])[0].mean() > 0.5
    scene = motion.scene_of(spliced)
    assert scene is not None
    moved = camera.camera_fields(spliced, scene, camera.Distance())
    assert [float(np.abs(back).max()) > 1 for back, _ in moved] == [pair.here == 3 for pair in scene.pairs]
    assert camera.blanks_of(spliced, scene) is None


def test_where_two_pictures_have_nothing_in_common_no_frame_is_missing(take: Take) -> None:
    told = tell_motion(take, MOTION)
    noise = np.random.default_rng(1).normal(-1, 1, take.images[4].shape).astype(np.float32)
    lost = replace(take, images=[noise if t == 4 else image for t, image in enumerate(take.images)])
    assert {step.factor for step in steps_of(lost, told)} == {1.0}


def test_jitter_is_told_where_the_recorded_one_explains_the_shaking_though_vectors_cannot_be_judged(
    take: Take, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told = tell_motion(take, MOTION)
    assert told.answer is not None
    shake = told.answer.shake
    blurred = replace(shake, recorded=Match((0.5, 0.9), 0.85))
    assert search.truest(blurred, shake) is shake
    assert shake.certain
    assert not blurred.certain
    world = [(replace(r, jitter=(r.jitter[0], -r.jitter[1])), a) for r, a in frames()]
    unjudged = lambda *a: replace(tell_motion(*a), motion=None)  # noqa: E731
    monkeypatch.setattr(import_module("framecast.doctor.examine"), "tell_motion", unjudged)
    assert "jitter.sign" in fixes(examine(write(tmp_path / "clip", world)).report.findings)
