"""The GPU benchmark runs, tiny, on a CPU too: packed crops, training, timing, and going on where it was."""

import importlib.util
import json
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import torch
from passing import write_shots

from framecast.clip import ClipError
from framecast.data import Footage, footage, window
from framecast.methods import METHODS

FOLDER = Path(__file__).parent.parent / "benchmarks" / "gpu"


def script(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, FOLDER / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def source(tmp_path: Path) -> Footage:
    return footage(write_shots(tmp_path / "clip", 7, square=2.0), tmp_path / "cache")


def test_packed_crops_are_the_clip_within_what_they_keep(source: Footage, tmp_path: Path) -> None:
    crops = script("crops")
    assert crops.pack([source], tmp_path / "crops", size=16, limit=1) == 1
    packed = next(crops.unpack(tmp_path / "crops"))
    first = packed.clip.records[0]
    start = next(i for i, r in enumerate(source.clip.records) if r.number == first.number)
    view, whole = window(packed, (0, 0), (16, 16)).every(2), source.clip
    frame = view[1]
    assert frame.color is not None
    candidates = whole.every(2, start=start)[1]
    assert candidates.color is not None
    places = np.lib.stride_tricks.sliding_window_view(candidates.color[0, 0].numpy(), (16, 16))
    found = np.abs(places - frame.color[0, 0].numpy()).max((2, 3)).min()
    assert found < 1e-3
    assert frame.motion is not None
    assert candidates.motion is not None
    assert set(frame.motion[0, 0].unique().tolist()) <= set(candidates.motion[0, 0].unique().tolist())
    hidden = window(packed, (0, 0), (16, 16))[5]
    assert hidden.normal is not None
    torch.testing.assert_close(hidden.normal[0, 2], torch.ones(16, 16))


def test_no_crops_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ClipError, match="holds no crops"):
        next(script("crops").unpack(tmp_path))


def test_everything_runs_and_goes_on(source: Footage, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    crops = script("crops")
    run = script("run")
    crops.pack([source], tmp_path / "crops", size=16, limit=1)
    few = {name: METHODS[name] for name in ("hold", "warp", "mobfgsr", "bilinear")}
    monkeypatch.setattr(run, "METHODS", few)
    out = tmp_path / "out"
    command = ["--tiny", "--crops", str(tmp_path / "crops"), "--out", str(out)]
    run.main(command)
    folder = out / run.card()
    assert (folder / "runs" / "extranet" / "weights.safetensors").is_file()
    rows = [json.loads(line) for line in (folder / "timings.jsonl").read_text().splitlines()]
    assert {row["method"] for row in rows} == {*few, "extranet", "extranet-plus"}
    assert {row["method"] for row in rows if row["variant"] == "half"} == {"extranet", "extranet-plus"}
    assert all(row["milliseconds"] > 0 for row in rows)
    run.main([*command, "--step", "time"])
    assert len((folder / "timings.jsonl").read_text().splitlines()) == len(rows)


def test_time_that_is_over_leaves_the_rest_for_later(tmp_path: Path) -> None:
    run = script("run")
    assert not run.time_all(tmp_path / "timings.jsonl", run.TINY, lambda: True)
    assert not (tmp_path / "timings.jsonl").exists()
