"""framecast upsample with extrass: a clip of shaded and unshaded frames in turn, and what is wrong with others."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from passing import write_shots

from framecast import exr
from framecast.cli import main
from framecast.clip import Clip, finish, open_clip, write_frame
from framecast.fit import method_named


def recorded(folder: Path, shaded: int = 2, *, frames: int = 5, cut: int = 0, lacking: str = "color") -> Clip:
    """Frames of `write_shots` of which every `shaded`-th has colour; `cut` is the number of a frame after a cut."""
    full = write_shots(folder / "full", frames, speed=2.0)
    for i, record in enumerate(full.records):
        layers = full.load(record)
        kept = {name: image for name, image in layers.items() if i % shaded == 0 or name not in ("color", lacking)}
        write_frame(folder / "clip", replace(record, cut=record.number == cut, jitter=(0.2, 0.1 * i - 0.3)), kept)
    finish(folder / "clip", fps=24)
    return open_clip(folder / "clip")


def asked(clip: Clip, out: Path, *more: str) -> int:
    return main(["upsample", str(clip.path), "-o", str(out), "--method", "extrass", "--scale", "2", *more])


def images(out: Path) -> list[np.ndarray]:
    return [np.stack([exr.read(path).channels[c] for c in "RGB"]) for path in sorted(out.glob("*.exr"))]


def test_every_second_frame_shaded_at_half_size(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    clip, out = recorded(tmp_path), tmp_path / "out"
    assert asked(clip, out, "--fps", "2") == 0
    assert "5 images (3 shaded, 2 generated), 80x48, 24 frames a second" in capsys.readouterr().out
    method, state = method_named("extrass"), None
    for frame, image in zip((clip[i] for i in range(5)), images(out), strict=True):
        with torch.no_grad():
            wanted, state = method(frame, method.start(frame) if state is None else state)
        np.testing.assert_allclose(image.astype(np.float32), wanted[0].numpy(), atol=2e-3)


@pytest.mark.parametrize(
    ("shaded", "fps", "says"),
    [
        (1, "2", "between the frames of a clip nothing was rendered"),
        (3, "2", "has one shaded frame in 3; use --fps 3"),
        (2, "3", "has one shaded frame in 2; use --fps 2"),
    ],
)
def test_frames_to_make_have_to_be_there(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], shaded: int, fps: str, says: str
) -> None:
    assert asked(recorded(tmp_path, shaded), tmp_path / "out", "--fps", fps) == 2
    assert says in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_buffer_that_unshaded_frames_lack_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert asked(recorded(tmp_path, lacking="albedo"), tmp_path / "out", "--fps", "2") == 2
    told = capsys.readouterr().err
    assert "the frame at time 1 was not shaded and has no albedo" in told
    assert told.count("\n") == 1


def test_another_size_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["upsample", str(recorded(tmp_path).path), "-o", str(tmp_path / "out"), "--method", "extrass"]
    assert main([*command, "--scale", "3"]) == 2
    assert "extrass cannot make 3 times the size (it can make 2)" in capsys.readouterr().err


@pytest.mark.filterwarnings("always")
def test_a_cut_on_an_unshaded_frame_is_said_and_shown(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert asked(recorded(tmp_path, cut=2), tmp_path / "out", "--fps", "2") == 0
    told = capsys.readouterr().err
    assert "a shot begins with the frame at time 1, which was not shaded" in told
    assert told.count("\n") == 1
    assert len(images(tmp_path / "out")) == 5


@pytest.mark.filterwarnings("always")
def test_too_long_without_a_shaded_frame_is_said_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert asked(recorded(tmp_path, 6, frames=12), tmp_path / "out", "--fps", "6") == 0
    told = capsys.readouterr().err
    assert "4 frames in a row were not shaded" in told
    assert told.count("\n") == 1
