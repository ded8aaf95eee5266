"""Clips on disk: written and read without loss, half-rate views, and every way in which a folder can be wrong."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
import torch
from conftest import disc_frame, write_disc_clip

from framecast import exr
from framecast.clip import Clip, ClipError, Record, check, finish, open_clip, repaired, write_frame


def test_what_is_written_is_read_bit_for_bit(tmp_path: Path) -> None:
    layers = {
        "color": np.random.rand(3, 6, 8).astype(np.float16),
        "depth": np.random.rand(1, 6, 8).astype(np.float32),
        "motion": np.random.randn(2, 6, 8).astype(np.float32),
        "motion2": np.random.randn(2, 6, 8).astype(np.float32),
        "object": np.random.randint(0, 9, (1, 6, 8)).astype(np.uint32),
    }
    record = Record(number=7, time=3.0, jitter=(0.25, -0.125), cut=True, exposure=2.0, extra={"sun": 1})
    reference = np.random.rand(3, 12, 16).astype(np.float16)
    write_frame(tmp_path, record, layers, reference=reference)
    clip = finish(tmp_path, fps=30, scale=2, provenance={"by": "test"})
    assert clip.records == (record,)
    assert (clip.fps, clip.size, clip.scale, clip.provenance) == (30, (6, 8), 2, {"by": "test"})
    for name, pixels in clip.load(record).items():
        np.testing.assert_array_equal(pixels, layers[name])
    frame = clip[0]
    assert frame.jitter.tolist() == [[0.25, -0.125]]
    assert frame.object.dtype == torch.int32
    np.testing.assert_array_equal(clip.reference(0)[0].numpy(), reference.astype(np.float32))


def test_layers_are_named_like_the_fields(disc_clip: Clip) -> None:
    names = set(exr.read(disc_clip.path / "frames" / "0001.exr").channels)
    assert {"R", "G", "B", "depth.Z", "motion.X", "motion.Y", "motion_next.X", "object.Y"} <= names
    assert disc_clip.layers == ("color", "depth", "motion", "motion_next", "object")


def test_first_frame_and_cuts_reset(tmp_path: Path) -> None:
    clip = write_disc_clip(tmp_path, 5)
    records = [r.__class__(**{**r.__dict__, "cut": r.number == 4}) for r in clip.records]
    clip = clip.__class__(**{**clip.__dict__, "records": tuple(records)})
    assert [bool(clip[i].reset) for i in range(5)] == [True, False, False, True, False]
    half = clip.every(2)  # frames 1, 3, 5: the cut at 4 lies between
    assert [bool(half[i].reset) for i in range(3)] == [True, False, True]


def test_half_rate_motion_is_chained_through_the_hidden_frame(disc_clip: Clip) -> None:
    half = disc_clip.every(2)
    truth = disc_frame(4, step=2)
    assert len(half) == 4
    assert half[2].time.tolist() == [4]
    torch.testing.assert_close(half[2].motion, truth.motion)
    ahead = disc_frame(2, step=2)
    torch.testing.assert_close(half[1].motion_next, ahead.motion_next)


def test_vectors_beyond_the_end_of_a_clip_are_continued(disc_clip: Clip) -> None:
    """No frame is there to chain them through, and all vectors of a view reach over its gap."""
    last = disc_clip.every(2)[3]
    assert float(last.span) == 2
    torch.testing.assert_close(last.motion_next, disc_frame(6, step=2).motion_next)
    ahead = replace(disc_clip, load=lambda record: {"motion_next": disc_clip.load(record)["motion_next"]})
    straight = 2 * disc_clip[6].motion_next  # type: ignore[operator]
    torch.testing.assert_close(ahead.every(2)[3].motion_next, straight)


def test_motion2_is_used_where_recorded(tmp_path: Path) -> None:
    clip = write_disc_clip(tmp_path / "a", 3)
    for i, record in enumerate(clip.records):
        layers = clip.load(record)
        write_frame(tmp_path / "b", record, {**layers, "motion2": np.full_like(layers["motion"], 10 + i)})
    half = finish(tmp_path / "b", fps=24).every(2)
    assert (half[1].motion == 12).all()


def test_step_motion_stays_as_recorded(disc_clip: Clip) -> None:
    half = disc_clip.every(2, motion="step")
    assert float(half[1].span) == 1
    torch.testing.assert_close(half[1].motion, disc_clip[2].motion)


def test_every_starts_where_asked_and_composes(disc_clip: Clip) -> None:
    assert [r.number for r in disc_clip.every(2, start=1).shown] == [2, 4, 6]
    assert [r.number for r in disc_clip.every(2).every(2).shown] == [1, 5]
    quarter = disc_clip.every(2).every(2)[1]
    assert float(quarter.span) == 4
    truth = disc_frame(4, step=4)
    torch.testing.assert_close(quarter.motion, truth.motion)


def test_a_shot_of_every_second_frame_keeps_times_and_step_vectors(tmp_path: Path) -> None:
    for t in (0, 2, 4):
        frame = disc_frame(t)
        layers = {n: getattr(frame, n)[0].numpy() for n in ("color", "depth", "motion", "motion_next")}
        write_frame(tmp_path, Record(number=t + 1, time=float(t)), layers)
    clip = finish(tmp_path, fps=24, span=1)
    assert [float(clip[i].time) for i in range(3)] == [0, 2, 4]
    assert [float(clip[i].span) for i in range(3)] == [1, 1, 1]
    wide = clip.every(2)[1]  # the vectors reach 1 frame, the gap is 4: continued on their quadratic path
    assert float(wide.span) == 4
    torch.testing.assert_close(wide.motion, disc_frame(4, step=4).motion)


def test_a_healthy_clip_has_no_complaints(disc_clip: Clip) -> None:
    assert check(disc_clip) == ()


def test_nan_names_frame_and_layer_and_repair_counts(tmp_path: Path) -> None:
    write_disc_clip(tmp_path, 2)
    path = tmp_path / "frames" / "0002.exr"
    file = exr.read(path)
    file.channels["R"][3, 4] = np.nan
    file.channels["depth.Z"][0, 0] = np.inf
    exr.write(path, file.channels, attributes={"framecast": file.attributes["framecast"]})
    with pytest.raises(ClipError, match=r"frame 2 .* 1 NaN or infinite pixels in color"):
        open_clip(tmp_path)[1]
    assert len(check(open_clip(tmp_path))) == 1
    frame = open_clip(tmp_path, repair=True)[1]
    neighbours = torch.from_numpy(file.channels["R"][2:5, 3:6].astype(np.float32))
    assert float(frame.color[0, 0, 3, 4]) == pytest.approx(float(neighbours.nansum() / 8), rel=1e-3)
    layers, count = repaired({"depth": np.array([[[np.nan, 1.0]]]), "motion": np.full((2, 1, 2), np.inf)})
    assert count == 5
    assert layers["depth"].tolist() == [[[65504, 1]]]
    assert (layers["motion"] == 0).all()


def test_bad_folders_are_told_in_a_sentence(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="nowhere is not a folder"):
        open_clip(tmp_path / "nowhere")
    with pytest.raises(ClipError, match="framecast import"):
        open_clip(tmp_path)
    clip = write_disc_clip(tmp_path / "c", 3)
    (clip.path / "frames" / "0002.exr").unlink()
    with pytest.raises(ClipError, match="frame 2 is missing"):
        open_clip(clip.path)
    about = json.loads((clip.path / "clip.json").read_text())
    (clip.path / "clip.json").write_text(json.dumps({**about, "version": 99}))
    with pytest.raises(ClipError, match="version 99"):
        open_clip(clip.path)
    (clip.path / "clip.json").write_text(json.dumps({k: v for k, v in about.items() if k != "width"}))
    with pytest.raises(ClipError, match=r"cannot be read .*'width'"):
        open_clip(clip.path)
    (clip.path / "clip.json").write_text("{")
    with pytest.raises(ClipError, match="cannot be read"):
        open_clip(clip.path)


def test_two_sizes_in_one_clip_are_refused(tmp_path: Path) -> None:
    clip = write_disc_clip(tmp_path, 2)
    write_frame(tmp_path, clip.records[1], {"color": np.zeros((3, 4, 6), np.float32)})
    with pytest.raises(ClipError, match="frame 2 is 6x4 but the first one is 48x32"):
        open_clip(tmp_path)


def test_a_layer_of_another_size_is_refused(disc_clip: Clip) -> None:
    path = disc_clip.path / "frames" / "0001.exr"
    channels, corner = exr.read(path).channels, np.zeros(2, np.int32)
    height, width = disc_clip.size
    full, half = (np.array([width // k - 1, height // k - 1], np.int32) for k in (1, 2))
    vectors = {name: pixels[::2, ::2].copy() for name, pixels in channels.items() if name.startswith("motion.")}
    common = {"displayWindow": (corner, full), "type": OpenEXR.scanlineimage}
    rest = {name: pixels for name, pixels in channels.items() if name not in vectors}
    parts = [("frame", full, rest), ("vectors", half, vectors)]
    path.unlink()
    OpenEXR.File(
        [OpenEXR.Part({**common, "name": name, "dataWindow": (corner, end)}, held) for name, end, held in parts]
    ).write(str(path))
    with pytest.raises(ClipError, match=rf"motion of frame 1 .* has {width // 2}x{height // 2} pixels and the frame"):
        disc_clip[0]


@pytest.mark.parametrize("keep", [0.9, 0.5, 0.02])
def test_a_truncated_file_is_refused(disc_clip: Clip, keep: float, capfd: pytest.CaptureFixture[str]) -> None:
    path = disc_clip.path / "frames" / "0003.exr"
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * keep)])
    with pytest.raises(ClipError, match=r"0003\.exr .*(truncated|damaged)"):
        disc_clip[2]
    assert capfd.readouterr() == ("", "")


def test_a_failed_write_leaves_nothing(tmp_path: Path) -> None:
    folder = tmp_path / "readonly"
    folder.write_text("a file, not a folder")
    with pytest.raises(ClipError, match=r"cannot write .*0001\.exr"):
        write_frame(folder, Record(number=1, time=0.0), {"color": np.zeros((3, 4, 4), np.float32)})
    assert folder.read_text() == "a file, not a folder"
    with pytest.raises(ClipError, match="No space left on device"):
        _fill_the_disk(tmp_path / "x.exr")
    assert [p.name for p in tmp_path.iterdir()] == ["readonly"]


def _fill_the_disk(path: Path) -> None:
    with exr.whole(path) as temporary:
        temporary.write_bytes(b"half")
        raise OSError(28, "No space left on device")


def test_data_window_is_placed_on_the_display_window(tmp_path: Path) -> None:
    import OpenEXR

    pixels = np.arange(12, dtype=np.float32).reshape(3, 4)
    corners = np.array([[2, 1], [5, 3], [0, 0], [4, 4]], np.int32)
    window = {"dataWindow": (corners[0], corners[1]), "displayWindow": (corners[2], corners[3])}
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **window}
    OpenEXR.File(header, {"Z": pixels}).write(str(tmp_path / "w.exr"))
    out = exr.read(tmp_path / "w.exr").channels["Z"]
    assert out.shape == (5, 5)
    np.testing.assert_array_equal(out[1:4, 2:5], pixels[:, :3])
    assert out.sum() == pixels[:, :3].sum()
    assert exr.size(tmp_path / "w.exr") == (5, 5)
