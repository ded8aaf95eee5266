"""Classifier-guided supersampling from clips: samples with true classes, what is trained, classes beside images."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from test_labels import card, sliding, write
from test_super_resolution import state_after

from framecast import checkpoint
from framecast.cli import main
from framecast.clip import ClipError, open_clip
from framecast.data import Footage, Samples, footage
from framecast.fit import method_named
from framecast.labels import labels, likeliest
from framecast.methods import TRAINABLE
from framecast.methods.classifier import (
    Classifier,
    Config,
    loss_with_true_labels,
    recipe,
)


@pytest.fixture
def clip(tmp_path: Path) -> Path:
    lefts = (6, 10, 14)
    return write(tmp_path / "clip", [card(x) for x in lefts], [sliding(x, 4) for x in lefts])


SMALL = replace(recipe, shaded=3, truths=2, crop=(8, 10), recolour=False, stops=0.0)


def test_samples_carry_the_classes_of_their_place_and_frames(clip: Path, tmp_path: Path) -> None:
    source = footage(open_clip(clip), tmp_path / "cache", labels=True)
    samples = Samples([source], SMALL, fields=Classifier.needs, seed=0, scale=2)
    frames, found = samples.cut(source, 0, (2, 3), (8, 10))
    assert found.shape == (1, 2, 5, 16, 20)
    assert frames[0].size == (8, 10)
    for k in (0, 1):
        right = labels(open_clip(clip), k + 1)
        both = torch.cat((right.ghosting, right.aliasing), 1)[..., 4:20, 6:26].float()
        assert torch.equal(found[:, k, 3:], both)
    assert bool((found[:, :, 3] == 0).any())


@pytest.mark.parametrize("recolour", [False, True])
def test_classes_are_turned_with_colours_and_never_brightened(clip: Path, tmp_path: Path, recolour: bool) -> None:
    plain = footage(open_clip(clip), tmp_path / "cache", labels=True)
    bright = (plain.arrays["reference"][:, :2] > 0.4).astype(np.uint8) * 2
    source = Footage(plain.clip, {**plain.arrays, "labels": bright})
    changed = replace(SMALL, recolour=recolour, stops=2.0)
    samples = Samples([source], changed, fields=Classifier.needs, seed=3, scale=2)
    for number in range(6):
        found = samples[number].targets
        middle = (found[:, :, :3].amax((3, 4), keepdim=True) + found[:, :, :3].amin((3, 4), keepdim=True)) / 2
        if float(found[:, :, 3].std()) > 0:
            assert torch.equal(found[:, :, 3], (found[:, :, 0] > middle[:, :, 0]) * 2.0)
        assert set(found[:, :, 3:].unique().tolist()) <= {0.0, 2.0}


def test_labels_are_refused_where_there_is_nothing_to_make_them_of(clip: Path, tmp_path: Path) -> None:
    for path in (clip / "ranges").iterdir():
        path.unlink()
    with pytest.raises(ClipError, match="has no sample ranges"):
        footage(open_clip(clip), tmp_path / "cache", labels=True)
    footage(open_clip(clip), tmp_path / "cache")


def test_what_is_trained_differs_in_what_its_name_says() -> None:
    made = {name: make() for name, (make, _) in TRAINABLE.items() if name.startswith("classifier")}
    configs = {name: getattr(method, "config") for name, method in made.items()}  # noqa: B009
    assert configs["classifier"] == configs["classifier-true-labels"] == Config()
    assert configs["classifier-none"] == Config(classifier=False)
    for part in ("counter", "carried", "range"):
        assert configs[f"classifier-without-{part}"] == Config(**{part: False})
    assert TRAINABLE["classifier-true-labels"][1].loss is loss_with_true_labels


# Its classes beside its images.


@pytest.fixture
def weights(tmp_path: Path) -> Path:
    torch.manual_seed(0)
    method = Classifier()
    path = tmp_path / "weights.safetensors"
    checkpoint.save(path, method.state_dict(), {**checkpoint.describe("classifier", method), "step": 1})
    return path


def test_labels_are_written_beside_the_images(clip: Path, weights: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    method = f"classifier={weights}"
    assert (
        main(["upsample", str(clip), "-o", str(out), "--method", method, "--format", "png", "--debug", "labels"]) == 0
    )
    assert {p.name for p in out.glob("*.png")} == {f"000{k}{s}.png" for k in (1, 2, 3) for s in ("", ".labels")}
    opened = open_clip(clip)
    found = likeliest(state_after(method_named(method).eval(), [opened[k] for k in range(3)]).classes)
    page = np.asarray(Image.open(out / "0003.labels.png")).astype(int)[-24:, :40]
    colourful = page.max(2) - page.min(2) > 40
    assert np.array_equal(colourful, found.ghosting[0, 0].numpy() != 2)


def test_labels_that_nobody_makes_or_keeps_are_refused(
    clip: Path, weights: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for method, name, sentence in (
        ("taau", "out", "taau does not classify pixels"),
        (f"classifier={weights}", "out.mp4", "a film has none; use --format png"),
    ):
        asked = ["upsample", str(clip), "-o", str(tmp_path / name), "--method", method, "--debug", "labels"]
        assert main(asked) == 2
        assert sentence in capsys.readouterr().err
        assert not (tmp_path / name).exists()
