"""The main job through the command line: what is written, resumed, refused."""

import json
from dataclasses import replace
from pathlib import Path

import av
import numpy as np
import pytest
import torch
from conftest import write_disc_clip
from PIL import Image

from framecast import exr
from framecast.cli import main
from framecast.clip import Clip, ClipError, finish, open_clip, write_frame
from framecast.color import to_display
from framecast.results import VERSION
from framecast.upsample import Job, upsample


def pixels(folder: Path) -> dict[str, bytes]:
    return {p.name: b"".join(c.tobytes() for c in exr.read(p).channels.values()) for p in sorted(folder.glob("*.exr"))}


def test_doubles_the_rate_and_says_what_was_made(
    disc_clip: Clip, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["upsample", str(disc_clip.path), "-o", str(tmp_path / "out")]) == 0
    names = [f"{i:04d}.exr" for i in range(1, 14)]
    assert sorted(p.name for p in (tmp_path / "out").glob("*.exr")) == names
    last = capsys.readouterr().out.strip().splitlines()[-1]
    assert "13 images (7 shaded, 6 generated)" in last
    assert "48 frames a second" in last
    assert "20.8 ms of latency" in last
    shaded = exr.read(tmp_path / "out" / "0003.exr").channels["R"]
    np.testing.assert_array_equal(shaded, disc_clip[1].color[0, 0].half().numpy())


@pytest.mark.parametrize(
    ("mode", "method"), [("interpolate", "mobfgsr"), ("mixed", "mobfgsr-quadratic"), ("extrapolate", "bsr")]
)
def test_an_interrupted_run_goes_on_and_ends_with_the_same_pixels(
    disc_clip: Clip, tmp_path: Path, mode: str, method: str
) -> None:
    job = Job(method=method, rate=3, mode=mode)
    upsample(disc_clip, tmp_path / "whole", job)

    def stop_at(index: int):
        def progress(indices, total):
            for i in indices:
                if i == index:
                    raise KeyboardInterrupt
                yield i

        return progress

    for stop in (5, 12):
        with pytest.raises(KeyboardInterrupt):
            upsample(disc_clip, tmp_path / "parts", job, progress=stop_at(stop))
        assert len(pixels(tmp_path / "parts")) == stop
    made = upsample(disc_clip, tmp_path / "parts", job)
    assert (made.frames, made.skipped) == (19, 12)
    assert pixels(tmp_path / "parts") == pixels(tmp_path / "whole")


def test_interrupting_the_command_says_how_to_go_on(
    disc_clip: Clip, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("framecast.upsample.write_image", interrupt)
    assert main(["upsample", str(disc_clip.path), "-o", str(tmp_path / "o")]) == 130
    assert "run the same command again" in capsys.readouterr().err


def test_png_is_what_a_display_shows(disc_clip: Clip, tmp_path: Path) -> None:
    upsample(disc_clip, tmp_path / "o", Job(mode="pass", format="png"))
    image = np.asarray(Image.open(tmp_path / "o" / "0002.png"))
    expected = (to_display(disc_clip[1].color[0]) * 255).round().byte().permute(1, 2, 0).numpy()
    np.testing.assert_array_equal(image, expected)
    assert len(list((tmp_path / "o").glob("*.png"))) == 7


def test_mp4_plays_every_image_at_the_right_rate(disc_clip: Clip, tmp_path: Path) -> None:
    assert main(["upsample", str(disc_clip.path), "-o", str(tmp_path / "o.mp4"), "--fps", "2"]) == 0
    with av.open(str(tmp_path / "o.mp4")) as film:
        assert film.streams.video[0].average_rate == 48
        shown = [frame.to_ndarray(format="rgb24") for frame in film.decode(video=0)]
    assert len(shown) == 13
    first = to_display(disc_clip[0].color[0]).permute(1, 2, 0).numpy() * 255
    assert np.abs(shown[0] - first).mean() < 6
    assert [p.name for p in tmp_path.iterdir() if "mp4" in p.name] == ["o.mp4"]


def test_a_half_rate_shot_gets_its_missing_frames_back(tmp_path: Path) -> None:
    """Frames 0, 2, 4 with vectors to the frames between: generated frame 1 is close to the one left out."""
    full = write_disc_clip(tmp_path / "full", 5)
    half = full.every(2, motion="step")
    made = upsample(half, tmp_path / "o")
    assert (made.frames, made.fps) == (5, 24)
    truth, held = full[1].color[0, 0], full[0].color[0, 0]
    core = torch.nn.functional.avg_pool2d(full[1].object.float(), 5, 1, 2)[0, 0] == 1
    image = torch.from_numpy(exr.read(tmp_path / "o" / "0002.exr").channels["R"].astype(np.float32))
    assert (image - truth).abs()[core].mean() < 0.3 * (held - truth).abs()[core].mean()


def test_frames_recorded_without_colour_are_made_from_their_own_buffers(tmp_path: Path) -> None:
    """Every second frame has no colour: passing them to `warp` shows the disc where its own vectors say."""
    full = write_disc_clip(tmp_path / "full", 5)
    for record in full.records:
        layers = full.load(record)
        if record.number % 2 == 0:
            del layers["color"]
        write_frame(tmp_path / "half", record, layers)
    clip, job = finish(tmp_path / "half", fps=24), Job(method="warp", mode="pass")
    upsample(clip, tmp_path / "o", job)
    whole = pixels(tmp_path / "o")
    (tmp_path / "o" / "0002.exr").unlink()
    made = upsample(clip, tmp_path / "o", job)
    assert pixels(tmp_path / "o") == whole
    assert (made.frames, made.shaded, made.fps) == (5, 3, 24)
    truth, held = full[1].color[0, 0], full[0].color[0, 0]
    core = torch.nn.functional.avg_pool2d(full[1].object.float(), 5, 1, 2)[0, 0] == 1
    image = torch.from_numpy(exr.read(tmp_path / "o" / "0002.exr").channels["R"].astype(np.float32))
    assert (image - truth).abs()[core].mean() < 0.3 * (held - truth).abs()[core].mean()


@pytest.fixture
def told(capsys: pytest.CaptureFixture[str]):
    """Runs a command that must fail with exit code 2 and one line on standard error, which it returns."""

    def run(*arguments: object) -> str:
        assert main([str(a) for a in arguments]) == 2
        captured = capsys.readouterr()
        assert captured.err.startswith("framecast: ")
        assert captured.err.count("\n") == 1, captured.err
        return captured.err

    return run


def test_bad_input_is_told_in_one_sentence_and_nothing_is_written(disc_clip: Clip, tmp_path: Path, told) -> None:
    clip, out = disc_clip.path, tmp_path / "o"
    assert "nowhere is not there" in told("upsample", tmp_path / "nowhere", "-o", out)
    assert "there is no method 'magic'" in told("upsample", clip, "-o", out, "--method", "magic")
    assert "rate is 0" in told("upsample", clip, "-o", out, "--fps", "0")
    assert "projection" in told("upsample", clip, "-o", out, "--method", "warp3d")
    assert "nothing was rendered" in told("upsample", clip, "-o", out, "--method", "warp", "--mode", "extrapolate")
    path = clip / "frames" / "0002.exr"
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    assert "0002.exr" in told("upsample", clip, "-o", out)
    path.unlink()
    assert "frame 2 is missing" in told("upsample", clip, "-o", out)
    assert [p.name for p in tmp_path.rglob("*.part*")] == []


def test_nan_is_refused_or_repaired(disc_clip: Clip, tmp_path: Path, told, capsys: pytest.CaptureFixture[str]) -> None:
    path = disc_clip.path / "frames" / "0004.exr"
    file = exr.read(path)
    file.channels["G"][5, 5] = np.nan
    exr.write(path, file.channels, attributes={"framecast": file.attributes["framecast"]})
    assert "frame 4" in told("upsample", disc_clip.path, "-o", tmp_path / "o")
    assert "frame 4" in told("check", disc_clip.path)
    assert main(["upsample", str(disc_clip.path), "-o", str(tmp_path / "o"), "--repair"]) == 0
    assert "1 NaN or infinite values of the input replaced" in capsys.readouterr().out
    assert all(np.isfinite(exr.read(p).channels["G"]).all() for p in (tmp_path / "o").glob("*.exr"))


def test_an_existing_output_is_kept(disc_clip: Clip, tmp_path: Path, told) -> None:
    out = tmp_path / "o"
    out.mkdir()
    (out / "precious.txt").write_text("mine")
    assert "exists already" in told("upsample", disc_clip.path, "-o", out)
    assert [p.name for p in out.iterdir()] == ["precious.txt"]
    upsample(disc_clip, tmp_path / "p")
    assert "--overwrite" in told("upsample", disc_clip.path, "-o", tmp_path / "p", "--fps", "3")
    assert main(["upsample", str(disc_clip.path), "-o", str(tmp_path / "p"), "--fps", "3", "--overwrite"]) == 0
    assert len(list((tmp_path / "p").glob("*.exr"))) == 19


@pytest.mark.parametrize("out", ["clip", ".", "clip/../clip"])
def test_the_frames_that_are_read_are_never_removed(tmp_path: Path, told, out: str) -> None:
    clip = write_disc_clip(tmp_path / "clip", 2)
    assert "holds the frames that are read" in told("upsample", clip.path, "-o", tmp_path / out, "--overwrite")
    assert "holds the frames that are read" in told("upsample", clip.path, "-o", tmp_path / out)
    assert len(open_clip(clip.path)) == 2


def test_a_film_does_not_take_the_place_of_a_folder(disc_clip: Clip, tmp_path: Path, told) -> None:
    (tmp_path / "film").mkdir()
    assert "film exists already" in told("upsample", disc_clip.path, "-o", tmp_path / "film", "--format", "mp4")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["disc", "film"]  # said before any image is made


def test_images_of_other_settings_are_not_gone_on_with(disc_clip: Clip, tmp_path: Path) -> None:
    upsample(disc_clip, tmp_path / "o", Job("hold"))
    other = replace(disc_clip, provenance={**disc_clip.provenance, "settings": {"motion": {"sign": [1, -1]}}})
    with pytest.raises(ClipError, match="is not this job"):
        upsample(other, tmp_path / "o", Job("hold"))


def test_labels_are_made_for_images_that_are_there(tmp_path: Path) -> None:
    clip, job = write_disc_clip(tmp_path / "clip", 2), Job("classifier", 1, "pass")
    clip = replace(clip, records=tuple(replace(r, jitter=(0.25 * r.number, -0.25)) for r in clip.records))
    upsample(clip, tmp_path / "o", job)
    upsample(clip, tmp_path / "o", job, debug="labels")
    assert [p.name for p in sorted((tmp_path / "o").glob("*.labels.png"))] == ["0001.labels.png", "0002.labels.png"]


def test_more_frames_are_refused_by_a_method_that_makes_none(disc_clip: Clip, tmp_path: Path, told) -> None:
    ask = ("upsample", disc_clip.path, "-o", tmp_path / "o", "--fps", "2", "--scale", "2", "--jitter", "zero")
    says = told(*ask, "--method", "taau")
    assert "taau makes no frames, and --fps 2 asks for 2 images" in says
    assert main([*map(str, ask), "--method", says.split()[-1]]) == 0
    assert len(list((tmp_path / "o").glob("*.exr"))) == 13


def test_a_full_disk_leaves_whole_files_only(disc_clip: Clip, tmp_path: Path, told, monkeypatch) -> None:
    written = []

    def full(self, name: str) -> None:
        if len(written) == 3:
            Path(name).write_bytes(b"half")
            raise RuntimeError(f'Failed to write pixel data to image file "{name}". No space left on device.')
        written.append(name)
        original(self, name)

    original = exr.OpenEXR.File.write
    monkeypatch.setattr(exr.OpenEXR.File, "write", full)
    assert "No space left on device" in told("upsample", disc_clip.path, "-o", tmp_path / "o")
    assert sorted(p.name for p in (tmp_path / "o").iterdir()) == ["0001.exr", "0002.exr", "0003.exr", "job.json"]
    monkeypatch.undo()
    assert main(["upsample", str(disc_clip.path), "-o", str(tmp_path / "o")]) == 0
    assert len(pixels(tmp_path / "o")) == 13


def test_import_writes_a_clip_and_lists_methods(
    disc_clip: Clip, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["import", str(disc_clip.path), "-o", str(tmp_path / "c")]) == 0
    text = capsys.readouterr().out
    assert "mobfgsr" in text
    assert "7 frames written" in text
    assert open_clip(tmp_path / "c").records == disc_clip.records
    assert main(["check", str(tmp_path / "c")]) == 0


def test_evaluate_writes_rows(disc_clip: Clip, tmp_path: Path) -> None:
    out = tmp_path / "r.json"
    assert main(["evaluate", str(disc_clip.path), "--methods", "hold,mobfgsr", "--json", str(out)]) == 0
    results = json.loads(out.read_text())
    assert results["version"] == VERSION
    assert {tuple(sorted(row)) for row in results["rows"]} == {
        ("clip", "method", "metric", "mode", "region", "role", "scale", "value")
    }
    value = {(r["method"], r["role"], r["region"], r["metric"]): r["value"] for r in results["rows"]}
    assert value["mobfgsr", "generated", "all", "psnr"] > value["hold", "generated", "all", "psnr"]


@pytest.mark.filterwarnings("default:these frames are not jittered")
def test_a_warning_is_one_sentence_said_once(
    disc_clip: Clip, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "large"
    assert main(["upsample", str(disc_clip.path), "-o", str(out), "--method", "taau", "--scale", "2"]) == 0
    told = capsys.readouterr().err.strip().splitlines()
    assert len(told) == 1
    assert told[0].startswith("framecast: these frames are not jittered")
    assert told[0].endswith("--jitter zero says so")
    assert exr.read(out / "0001.exr").size == (64, 96)


@pytest.mark.filterwarnings("error:these frames are not jittered")
def test_zero_jitter_can_be_said(disc_clip: Clip, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "large"
    ask = ["upsample", str(disc_clip.path), "-o", str(out), "--method", "taau", "--scale", "2", "--jitter", "zero"]
    assert main(ask) == 0
    assert capsys.readouterr().err == ""
    shaken = replace(disc_clip, records=tuple(replace(r, jitter=(0.25, -0.25)) for r in disc_clip.records))
    with pytest.raises(ClipError, match="is not this job"):  # what was made with other sample positions is not gone on
        upsample(shaken, out, Job("taau", 1, "pass", scale=2.0))
