"""The demo: what a newcomer runs first."""

from pathlib import Path

import av
import pytest
from PIL import Image

from framecast.cli import main
from framecast.clip import check, open_clip
from framecast.demo import HARBOUR


def test_the_shipped_clip_is_healthy_and_small() -> None:
    clip = open_clip(HARBOUR)
    assert check(clip) == ()
    assert {"color", "depth", "motion", "motion_next", "object"} <= set(clip.layers)
    assert sum(p.stat().st_size for p in HARBOUR.rglob("*.exr")) < 8e6


def test_the_demo_beats_holding_the_last_frame(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["demo", "-o", str(tmp_path)]) == 0
    text = capsys.readouterr().out
    held, mixed, ours = (float(v) for v in next(r for r in text.splitlines() if "mean" in r).split()[1:])
    assert ours > mixed + 5 > held + 5
    assert f"{tmp_path / 'report.html'}: open it in a browser" in text
    with Image.open(tmp_path / "side-by-side.png") as picture:
        assert picture.size == (960, 540)
    with av.open(str(tmp_path / "harbour.mp4")) as film:
        assert film.streams.video[0].average_rate == 24
        assert sum(1 for _ in film.decode(video=0)) == 80
    sentence = next(line for line in text.splitlines() if "rate and size doubled" in line)
    doubled, enlarged = (float(word) for word in sentence.split() if word.replace(".", "").isdigit())
    assert doubled > enlarged + 2
    with Image.open(tmp_path / "larger.png") as picture:
        assert picture.size == (960, 270)
    names = ["harbour.mp4", "larger.mp4", "larger.png", "report.html", "side-by-side.png"]
    assert sorted(p.name for p in tmp_path.iterdir()) == names
