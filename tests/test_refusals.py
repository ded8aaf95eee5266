"""What users get wrong and clips lack: devices, disks, frames without colour or jitter, cuts that nothing begins."""

import warnings
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from passing import run, shot, write_shots

from framecast import upsample
from framecast.cli import main
from framecast.clip import Clip, check, finish, open_clip, write_frame
from framecast.fit import method_named
from framecast.frame import Frame, unshaded
from framecast.methods.reproject import light, surface
from framecast.runtime import require_device


def without_color(folder: Path, frames: int = 4, *, lacking: str = "color") -> Clip:
    """Frames of `write_shots`, every second one without a layer."""
    full = write_shots(folder / "full", frames)
    for i, record in enumerate(full.records):
        layers = {name: image for name, image in full.load(record).items() if i % 2 == 0 or name != lacking}
        write_frame(folder / "clip", record, layers)
    finish(folder / "clip", fps=24)
    return open_clip(folder / "clip")


@pytest.mark.parametrize("device", ["nonsense", "meta", "cuda:99"])
def test_a_device_that_is_not_there_is_one_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], device: str
) -> None:
    require_device("cpu")
    clip, out = write_shots(tmp_path / "clip", 3), tmp_path / "out"
    for command in (["upsample", str(clip.path), "-o", str(out)], ["evaluate", str(clip.path), "--methods", "hold"]):
        assert main([*command, "--device", device]) == 2
        told = capsys.readouterr().err
        assert told.startswith(f"framecast: device '{device}' cannot be used here (")
        assert told.count("\n") == 1
    assert not out.exists()


def test_what_the_system_refuses_is_one_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device", "somewhere")

    monkeypatch.setattr(upsample, "write_image", full)
    clip = write_shots(tmp_path / "clip", 3)
    assert main(["upsample", str(clip.path), "-o", str(tmp_path / "out")]) == 2
    assert "somewhere: No space left on device; free some space" in capsys.readouterr().err


def test_frames_are_not_made_around_those_that_were_not_shaded(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["upsample", str(without_color(tmp_path).path), "-o", str(tmp_path / "out"), "--method", "mobfgsr"]
    assert main(command) == 2
    assert "frame 2 of" in (told := capsys.readouterr().err)
    assert "was not shaded" in told
    assert "--mode pass" in told
    assert main([*command, "--mode", "pass", "--overwrite"]) == 0
    assert "(2 shaded, 2 generated)" in capsys.readouterr().out


def test_a_layer_that_some_frames_lack_is_found(tmp_path: Path) -> None:
    complaints = check(without_color(tmp_path, lacking="albedo"))
    assert [text.split(" of ")[0] for text in complaints] == ["frame 2", "frame 4"]
    assert all("no albedo, which the first frame has" in text for text in complaints)
    assert check(without_color(tmp_path / "other")) == ()


@pytest.mark.parametrize("name", ["warp-occlusion", "extranet", "fasset"])
def test_a_shot_that_begins_unshaded_shows_nothing_of_the_one_before(name: str) -> None:
    """But how bright it was: the same picture follows a shot and one that is that bright everywhere."""
    first = shot(0.0)
    even = light(first).mean((2, 3), keepdim=True).expand_as(light(first))
    other = replace(first, color=torch.expm1(even) * surface(first))
    begins = unshaded(replace(shot(1.0, square=2.0), reset=torch.tensor([True])))
    begins = replace(begins, motion=torch.full_like(shot(1.0).motion, 7.0))  # type: ignore[arg-type]
    with pytest.warns(UserWarning, match=f"time 1, which was not shaded, so that {name} has nothing"):
        images = [run(method_named(name), [old, begins])[1] for old in (first, other)]
    torch.testing.assert_close(images[0], images[1], atol=2e-3, rtol=2e-3)


def test_a_plain_warp_holds_the_last_frame_where_a_shot_begins_unshaded() -> None:
    first, begins = shot(0.0), unshaded(replace(shot(1.0), reset=torch.tensor([True])))
    with pytest.warns(UserWarning, match="the last frame of the shot before is shown"):
        image = run(method_named("warp"), [first, begins])[1]
    torch.testing.assert_close(image, first.color, atol=1e-4, rtol=0)


def jittered(time: float, jitter: tuple[float, float]) -> Frame:
    return shot(time, jitter=jitter, span=1.0)


@pytest.mark.parametrize("name", ["fasset", "mobfgsr"])
def test_frames_without_jitter_are_spoken_of_once_there_are_two(name: str) -> None:
    method = method_named(name, 2.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        run(method, [jittered(0.0, (0.0, 0.0)), jittered(1.0, (0.2, 0.0)), jittered(2.0, (0.0, 0.0))])
    with pytest.warns(UserWarning, match=f"not jittered.* {name} cannot show more"):
        run(method, [jittered(0.0, (0.0, 0.0)), jittered(1.0, (0.0, 0.0))])


def test_images_made_by_a_first_method_need_no_jitter() -> None:
    frames = [jittered(float(t), (0.1 * t, -0.2)) for t in range(3)]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        run(method_named("taau + taau"), frames)
    with pytest.warns(UserWarning, match="not jittered"):
        run(method_named("taau+taau"), [jittered(float(t), (0.0, 0.0)) for t in range(3)])
