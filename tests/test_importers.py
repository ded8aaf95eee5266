"""Any source into our own format: exact, whole or not at all, resumed after an interruption, and described."""

import json
import math
import resource
import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest
import torch

from framecast import exr
from framecast.clip import Clip, ClipError
from framecast.importers import describe, open_any, save
from framecast.importers.blender import open_shot

DATA = Path(__file__).parent / "data" / "blender"


def test_saved_is_what_was_read(tmp_path: Path) -> None:
    clip = open_shot(DATA / "step2")
    saved = save(clip, tmp_path / "clip", full=True)
    assert [p.name for p in tmp_path.iterdir()] == ["clip"]
    assert sorted(p.name for p in saved.path.iterdir()) == ["clip.json", "frames"]
    assert (saved.records, saved.fps, saved.span) == (clip.records, clip.fps, clip.span)
    assert saved.provenance == clip.provenance
    for index in range(len(clip)):
        for name in (*clip.layers, "view", "projection", "time", "reset", "span"):
            torch.testing.assert_close(getattr(saved[index], name), getattr(clip[index], name), rtol=0, atol=0)
    half = save(saved, tmp_path / "half")  # any clip can be saved
    torch.testing.assert_close(half[1].color, clip[1].color, rtol=1e-3, atol=1e-4)
    assert exr.read(half.path / "frames" / "0003.exr").channels["R"].dtype == np.float16


@pytest.mark.parametrize("beside", [True, False])
def test_an_interrupted_import_goes_on_where_it_was(tmp_path: Path, beside: bool) -> None:
    shot = Path(shutil.copytree(DATA / "v5", tmp_path / "shot"))
    files = {p.name for p in (tmp_path if beside else shot).iterdir()}
    clip, out = open_shot(shot), (tmp_path if beside else shot) / "clip"

    def interrupted(indices: Sequence[int]) -> Iterator[int]:
        yield indices[0]
        yield indices[1]
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        save(clip, out, progress=interrupted)
    assert not out.exists()
    (part,) = (p for p in out.parent.iterdir() if p.name not in files)
    done = part / "frames" / "0003.exr"
    before = done.stat().st_mtime_ns
    (part / "frames" / "0004.exr").write_bytes(b"torn")
    saved = save(clip, out)
    assert (out / "frames" / "0003.exr").stat().st_mtime_ns == before
    torch.testing.assert_close(saved[1].depth, clip[1].depth)
    assert {p.name for p in out.parent.iterdir()} == {"clip", *files}


def test_leftovers_of_another_source_are_not_taken(tmp_path: Path) -> None:
    def interrupted(indices: Sequence[int]) -> Iterator[int]:
        yield indices[0]
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        save(open_shot(DATA / "v5"), tmp_path / "clip", progress=interrupted)
    other = open_shot(DATA / "v34")
    torch.testing.assert_close(save(other, tmp_path / "clip", full=True)[0].color, other[0].color)


def test_leftovers_of_other_settings_are_not_taken(tmp_path: Path) -> None:
    """A settings file may lie anywhere, so that the files of the shot do not tell that it changed."""

    def interrupted(indices: Sequence[int]) -> Iterator[int]:
        yield indices[0]
        raise KeyboardInterrupt

    def read(sign: list[int]) -> Clip:
        vectors = {"files": "{frame}.exr", "channels": ["ViewLayer.Vector.X", "ViewLayer.Vector.Y"], "sign": sign}
        (tmp_path / "told.json").write_text(json.dumps({"motion": vectors}))
        return open_any(DATA / "step2", settings=tmp_path / "told.json")

    with pytest.raises(KeyboardInterrupt):
        save(read([1, 1]), tmp_path / "clip", progress=interrupted)
    other = read([-1, -1])
    torch.testing.assert_close(save(other, tmp_path / "clip")[0].motion, other[0].motion)


def test_an_existing_output_is_refused_and_untouched(tmp_path: Path) -> None:
    clip = open_shot(DATA / "step2")
    (tmp_path / "taken").mkdir()
    (tmp_path / "taken" / "diary.txt").write_text("dear")
    with pytest.raises(ClipError, match=r"taken exists already; give another name"):
        save(clip, tmp_path / "taken")
    assert [p.name for p in tmp_path.rglob("*")] == ["taken", "diary.txt"]
    (tmp_path / "empty").mkdir()
    assert len(save(clip, tmp_path / "empty")) == 4
    with pytest.raises(ValueError, match="view of a clip"):
        save(clip.every(2), tmp_path / "view")


def test_a_full_disk_leaves_nothing_behind(tmp_path: Path) -> None:
    clip = open_shot(DATA / "v5")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (2000, limits[1]))  # a real refusal of the file system
    try:
        with pytest.raises(ClipError, match=r"cannot write .*free some space"):
            save(clip, tmp_path / "clip")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert list(tmp_path.iterdir()) == []


def test_what_is_found_lacking_and_allowed_is_described() -> None:
    needs = {"hold": ("color",), "warp": ("color", "motion", "time"), "shade": ("color", "roughness", "view")}
    text = describe(open_shot(DATA / "step2"), needs)
    lines = dict(line.split(maxsplit=1) for line in text.splitlines())
    assert "4 frames (1-7 step 2), 64x36, 24 frames a second" in lines["shot"]
    assert lines["found"] == "color, depth, motion, motion_next, albedo, normal, object, view, projection"
    assert lines["lacks"] == "roughness, metallic"
    assert lines["allows"] == "hold, warp"
    assert lines["not"] == "shade (needs roughness)"
    assert "note" in lines


def test_open_any_takes_our_own_format_too(disc_clip: Clip) -> None:
    assert open_any(disc_clip.path).records == disc_clip.records
    assert open_any(disc_clip.path, fps=60).fps == 60
    for wrong in (0, -3, math.nan, math.inf):
        with pytest.raises(ValueError, match="frames a second were asked for; give a number above 0"):
            open_any(disc_clip.path, fps=wrong)
