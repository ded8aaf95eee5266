"""Weights that ship with the package."""

from pathlib import Path

import pytest
import safetensors.torch
import torch
from torch import nn

from framecast import weights


def test_half_precision_becomes_single(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(weights, "FOLDER", tmp_path)
    numbers = torch.arange(6.0).view(2, 3)
    safetensors.torch.save_file({"weight": numbers.half()}, tmp_path / "small.safetensors")
    layer = weights.shipped("small", nn.Linear(3, 2, bias=False))
    assert layer.weight.dtype == torch.float32
    assert torch.equal(layer.weight, numbers)
    assert not layer.training  # normalisation as it was learnt, whoever calls


def test_what_is_missing_damaged_or_of_something_else_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(weights, "FOLDER", tmp_path)
    with pytest.raises(FileNotFoundError, match=r"none\.safetensors does not exist; install framecast again, or train"):
        weights.shipped("none", nn.Linear(3, 2))
    (tmp_path / "torn.safetensors").write_bytes(b"\x07")
    safetensors.torch.save_file({"other": torch.zeros(1)}, tmp_path / "other.safetensors")
    for name in ("torn", "other"):
        with pytest.raises(ValueError, match=f"{name}.safetensors is damaged, or of another version"):
            weights.shipped(name, nn.Linear(3, 2))


def test_every_file_has_a_card_and_is_small() -> None:
    files = sorted(weights.FOLDER.glob("*.safetensors"))
    assert {"extranet", "mobfgsr-table", "nsrr", "mnss", "classifier", "fasset"} <= {path.stem for path in files}
    for path in files:
        assert "Licence: Apache-2.0" in path.with_suffix(".md").read_text()
        assert path.stat().st_size < 1e6
