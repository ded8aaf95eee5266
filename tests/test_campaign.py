"""Evaluations spread over processes and machines give the same rows; methods that enlarge have both roles."""

import builtins
import csv
import importlib.util
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path

import pytest
import torch
from conftest import disc_frame, write_disc_clip
from torch.nn.functional import interpolate

from framecast import campaign, video
from framecast.campaign import command, spread, tasks
from framecast.cli import main
from framecast.clip import Clip, ClipError, finish, write_frame
from framecast.color import to_display
from framecast.evaluate import Settings, evaluate
from framecast.frame import Frame
from framecast.methods import METHODS
from framecast.results import Row, read_results

SETTINGS = Settings(("psnr", "flip", "warped", "flicker"), threads=1)


def timeless(rows: list[Row]) -> list[Row]:
    return [row for row in rows if row.metric != "milliseconds"]


def test_two_processes_give_the_rows_of_one_in_its_order(disc_clip: Clip, tmp_path: Path) -> None:
    other, table = write_disc_clip(tmp_path / "other", 5), tmp_path / "rows.csv"
    found = []
    for workers in (1, 2):
        path = tmp_path / f"{workers}.json"
        command((disc_clip.path, other.path), "hold,blend", json=path, csv=table, metrics="psnr,flip", workers=workers)
        found.append(timeless(read_results(path)))
    assert found[0] == found[1]
    assert len({(row.clip, row.method) for row in found[0]}) == 4
    with table.open() as file:
        held = [{**row, "value": float(row["value"]), "scale": float(row["scale"])} for row in csv.DictReader(file)]
    assert [row for row in held if row["metric"] != "milliseconds"] == [asdict(row) for row in found[1]]


@pytest.mark.skipif(importlib.util.find_spec("ray") is None, reason="Ray is not installed (pip install ray)")
@pytest.mark.filterwarnings("ignore")  # Ray warns of its own future and of sockets that it leaves to the system
def test_a_ray_cluster_gives_the_same_rows(disc_clip: Clip, tmp_path: Path) -> None:
    wanted = tasks([disc_clip], ["hold", "blend"], "interpolate", SETTINGS)
    there = dict(spread(wanted, ray="local"))
    for task in wanted:
        assert timeless(there[task]) == timeless(campaign.perform(task))


def test_without_ray_the_command_says_how_to_install_it(
    disc_clip: Clip, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    real = builtins.__import__

    def absent(name: str, *rest: object, **more: object) -> object:
        if name == "ray":
            raise ImportError(name)
        return real(name, *rest, **more)  # type: ignore[arg-type]

    monkeypatch.setattr(builtins, "__import__", absent)
    assert main(["evaluate", str(disc_clip.path), "--methods", "hold", "--ray", "local"]) == 2
    assert "Ray, which is not installed; install it: pip install 'framecast[cluster]'" in capsys.readouterr().err


class Twice(torch.nn.Module):
    """Every image twice the size, generated ones `offset` brighter; and keeps what it was shown."""

    needs: tuple[str, ...] = ("color",)
    needs_generated: tuple[str, ...] = ()
    modes: tuple[str, ...] = ("extrapolate", "pass")
    scales: tuple[float, ...] = (2.0,)
    history: int | None = 1
    step_motion = False

    def __init__(self, seen: list[tuple[float, bool]], offset: float = 0.0) -> None:
        super().__init__()
        self.seen, self.offset, self.config = seen, offset, Sized()

    def start(self, frame: Frame) -> Frame:
        return frame

    def forward(self, frame: Frame, state: Frame) -> tuple[torch.Tensor, Frame]:
        self.seen.append((float(frame.time[0]), frame.color is not None))
        shown = disc_frame(float(frame.time[0])).color
        assert shown is not None
        image = interpolate(shown.half().float(), scale_factor=2.0)
        return (image, frame) if frame.color is not None else (image + self.offset, state)


class Sized:
    scale = 2.0


def large_clip(folder: Path, frames: int = 7) -> Clip:
    """The disc with references of twice the size."""
    clip = write_disc_clip(folder, frames)
    for i, record in enumerate(clip.records):
        color = disc_frame(i).color
        assert color is not None
        write_frame(folder, record, dict(clip.load(record)), reference=interpolate(color, scale_factor=2.0)[0].numpy())
    return finish(folder, fps=24, scale=2)


@pytest.fixture
def twice(monkeypatch: pytest.MonkeyPatch) -> Callable[..., list[tuple[float, bool]]]:
    def make(offset: float = 0.0) -> list[tuple[float, bool]]:
        seen: list[tuple[float, bool]] = []
        monkeypatch.setitem(METHODS, "twice", lambda: Twice(seen, offset))
        return seen

    return make


def test_methods_that_enlarge_and_generate_are_seen_in_both_roles(tmp_path: Path, twice: Callable) -> None:
    clip, seen = large_clip(tmp_path / "clip"), twice()
    rows = evaluate([clip], ["twice"], "extrapolate", SETTINGS)
    assert {time for time, shaded in seen if shaded} == set(range(7))
    assert {time for time, shaded in seen if not shaded} == {
        1,
        2,
        3,
        4,
        5,
    }  # 6 and 0 have no neighbours to be made from
    regions = {role: {row.region for row in rows if row.role == role} for role in ("shaded", "generated")}
    assert regions["shaded"] == regions["generated"] == {"all", "disoccluded", "border", "static"}
    values = {(row.role, row.region, row.metric): row.value for row in rows}
    for role in ("shaded", "generated"):
        assert [values[role, "all", metric] for metric in ("psnr", "flip", "warped")] == [100, 0, 0]
    assert values["generated", "all", "flicker"] == 0
    assert {row.scale for row in rows} == {2.0}


def test_flicker_is_the_step_between_the_roles_of_a_frame(tmp_path: Path, twice: Callable) -> None:
    twice(0.1)
    rows = evaluate([large_clip(tmp_path / "clip")], ["twice"], "extrapolate", SETTINGS)
    (flicker,) = [r.value for r in rows if (r.metric, r.region) == ("flicker", "all")]
    color = [interpolate(disc_frame(t).color.half().float(), scale_factor=2.0) for t in (3, 4, 5)]
    steps = [float((to_display(c + 0.1) - to_display(c)).abs().mean()) for c in color]
    assert flicker == pytest.approx(sum(steps) / 3, abs=1e-6)


def test_flicker_of_methods_that_give_shaded_frames_back_is_their_error(disc_clip: Clip) -> None:
    rows = evaluate([disc_clip], ["hold"], "interpolate", SETTINGS)
    (flicker,) = [r.value for r in rows if (r.metric, r.region) == ("flicker", "all")]
    shown = [to_display(disc_frame(t).color.half().float()) for t in range(7)]
    assert flicker == pytest.approx(sum(float((shown[t] - shown[t - 1]).abs().mean()) for t in (1, 3, 5)) / 3, abs=1e-5)


def test_without_references_is_said_which_metrics_remain(
    disc_clip: Clip, twice: Callable, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    twice()
    path = tmp_path / "out.json"
    command((disc_clip.path,), "twice", "extrapolate", json=path, metrics="psnr,flicker")
    assert "no references, and images of 96x64 pixels are to be judged: psnr needs references of that size, " in (
        said := capsys.readouterr().err
    )
    assert "flicker remains. Render the clip with --scale 2" in said
    assert {row.metric for row in read_results(path)} == {"flicker", "milliseconds"}
    with pytest.raises(ClipError, match=r"psnr needs references of that size, nothing remains"):
        command((disc_clip.path,), "twice", "extrapolate", metrics="psnr")
    with pytest.raises(ClipError, match=r"has no references.* nothing remains"):
        command((disc_clip.path,), "twice", "pass")


def test_a_reference_that_is_gone_is_named(tmp_path: Path, twice: Callable) -> None:
    twice()
    clip = large_clip(tmp_path / "clip")
    (clip.path / "reference" / "0003.exr").unlink()
    with pytest.raises(ClipError, match=r"frame 3 of .*clip has no reference of 96x64 pixels.* copy it again"):
        evaluate([clip], ["twice"], "pass", SETTINGS)


def test_references_of_twice_the_size_serve_images_of_the_frames_own(tmp_path: Path) -> None:
    clip = large_clip(tmp_path / "clip")
    (truth,) = {
        r.value
        for r in evaluate([clip], ["bilinear"], "pass", Settings(("psnr",), scale=1.0))
        if (r.metric, r.region) == ("psnr", "all")
    }
    assert truth > 60  # every pixel four times, averaged again, is the frame; half floats round


def test_bad_input_is_said_in_a_sentence(tmp_path: Path, disc_clip: Clip, capsys: pytest.CaptureFixture) -> None:
    one = write_disc_clip(tmp_path / "one", 1)
    cases = [
        ([str(one.path), "--methods", "hold"], "one has 1 frame; to hide every second one"),
        ([], "nothing to evaluate; give at least one clip and one method"),
        ([str(disc_clip.path), "--methods", "hold", "--workers", "0"], "--workers 0; both have to be at least 1"),
        ([str(disc_clip.path), "--methods", "hold", "--ray", "127.0.0.1:1"], "no Ray cluster answers at 127.0.0.1:1"),
    ]
    for arguments, words in cases[: 4 if importlib.util.find_spec("ray") else 3]:
        assert main(["evaluate", *arguments]) == 2
        assert words in capsys.readouterr().err


def test_what_is_not_installed_is_left_out_and_said(
    disc_clip: Clip, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name, *a: None if name == "pycvvdp" else find(name, *a))
    command((disc_clip.path,), "hold", metrics="psnr,cvvdp")
    assert "install it with: pip install 'framecast[video-quality]'" in capsys.readouterr().err
    with pytest.raises(ValueError, match="ColorVideoVDP is not installed"):
        evaluate([disc_clip], ["hold"], "interpolate", Settings(("cvvdp",)))


@pytest.mark.skipif(video.video_missing() is not None, reason="ColorVideoVDP is not installed (pip install cvvdp)")
@pytest.mark.filterwarnings("ignore")  # of the packages that it needs
def test_colorvideovdp_is_ten_for_equal_films_and_falls_with_the_error(disc_clip: Clip) -> None:
    color = [to_display(disc_frame(t).color.half().float()) for t in range(7)]
    found = []
    for noise in (0.0, 0.05, 0.2):
        film = video.Film(24.0)
        for number, target in enumerate(color):
            film.add(number, (target + noise * torch.rand_like(target)).clamp(0, 1), target)
        found.append(film.quality())
    assert found[0] == pytest.approx(10, abs=1e-3)
    assert found == sorted(found, reverse=True)
    assert len(set(found)) == 3


def test_a_film_of_every_second_frame_is_slower() -> None:
    image = torch.zeros(1, 3, 2, 2)
    for step, rate in ((1, 24.0), (2, 12.0)):
        film = video.Film(24.0)
        assert film.rate == 24
        for number in range(8):
            film.add(number, image, image if number % step == 0 else None)
        assert film.rate == rate
    assert len(film.images) == 4


def test_a_task_sets_the_threads_that_make_rows_the_same(disc_clip: Clip, monkeypatch: pytest.MonkeyPatch) -> None:
    taken: list[int] = []
    monkeypatch.setattr(torch, "set_num_threads", taken.append)
    (task,) = tasks([disc_clip], ["hold"], "interpolate", SETTINGS)
    campaign.perform(task)
    campaign.perform(replace(task, settings=replace(SETTINGS, threads=None)))
    assert taken == [1]
