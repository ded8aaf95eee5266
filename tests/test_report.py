"""The report: images come back from the text that they were packed into, and what cannot be shown is said."""

import base64
import json
import re
import shutil
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from conftest import disc_frame, write_disc_clip

from framecast import packing
from framecast.cli import main
from framecast.clip import Clip, ClipError, Record, finish, open_clip, write_frame
from framecast.color import to_display
from framecast.evaluate import Settings, evaluate
from framecast.frame import Frame
from framecast.methods import METHODS
from framecast.metrics import psnr
from framecast.report import Images, Job, jobs_of, place, report, window_of
from framecast.results import Row, read_provenance, read_results, write_results

PSNR = Settings(metrics=("psnr",))


def unpack(text: str, width: int, height: int, count: int) -> np.ndarray:
    """What `packing.pack` wrote, one pixel after the other, as its description says."""
    raw = zlib.decompress(base64.b64decode(text))
    total = count * height * width
    planes = np.zeros((count, height, width), int)
    for k in range(total):
        p, y, x = k // (height * width), k // width % height, k % width
        a, b, c = planes[p, y, x - 1], planes[p, y - 1, x], planes[p, y - 1, x - 1]
        guess = sorted((a, b, a + b - c))[1] if x and y else a if x else b if y else 0
        code = raw[k] + 256 * raw[total + k]
        planes[p, y, x] = guess + (code // 2 if code % 2 == 0 else -(code + 1) // 2)
    return planes if count == 1 else np.stack((planes[1] + planes[0], planes[0], planes[2] + planes[0]))


@pytest.mark.parametrize(("count", "height", "width"), [(3, 7, 5), (1, 4, 9), (3, 1, 6), (3, 5, 1)])
def test_images_come_back_from_their_text(count: int, height: int, width: int) -> None:
    codes = np.random.randint(0, 2496, (count, height, width)).astype(np.uint16)
    assert np.array_equal(unpack(packing.pack(codes), width, height, count), codes)


def test_a_smooth_image_takes_less_than_noise() -> None:
    ramp = (np.arange(64)[:, None] * 3 + np.arange(64) * 5).astype(np.uint16)[None]
    noise = np.random.randint(0, 512, (1, 64, 64)).astype(np.uint16)
    assert len(packing.pack(ramp)) < len(packing.pack(noise)) / 20


def decoded(codes: np.ndarray) -> torch.Tensor:
    return torch.from_numpy((2 ** (codes / packing.STEPS) - 1) / packing.FLOOR)


@pytest.mark.parametrize("stops", [-4, 0, 4])
def test_codes_hold_what_is_seen_at_any_exposure(stops: int) -> None:
    linear = torch.logspace(-6, 4, 3000).view(3, 100, 10)
    back = decoded(packing.encode(linear)).float()
    assert (to_display(back * 2.0**stops) - to_display(linear * 2.0**stops)).abs().max() * 255 < 0.5
    bright = linear > 0.01
    assert ((back - linear) / linear)[bright].abs().max() < 0.0045


def test_codes_end_at_black_and_at_the_brightest_half_float() -> None:
    codes = packing.encode(torch.tensor([-1.0, 0.0, 65504.0, 1e9]).expand(3, 1, 4))
    assert codes[0, 0, 0] == codes[0, 0, 1] == 0
    assert codes[0, 0, 2] == codes[0, 0, 3] < 4096
    assert decoded(codes)[0, 0, 2] == pytest.approx(65504, rel=0.004)


def test_what_two_methods_share_is_held_once() -> None:
    images, codes = Images(), np.ones((3, 4, 4), np.uint16)
    assert images.add(codes) == images.add(codes.copy()) != images.add(codes + np.uint16(1))
    assert len(images.held) == 2


# The page.


def data_of(text: str) -> dict:
    return json.loads(re.search(r'<script type="application/json" id="data">(.*?)</script>', text, re.S)[1])


def images_of(text: str) -> dict[str, np.ndarray]:
    """Every image of a page by its id."""
    found = re.findall(r'<script type="text/plain" id="(\w+)" data-size="(\d+) (\d+) (\d+)">(.*?)</script>', text)
    return {name: unpack(packed, *map(int, size)) for name, *size, packed in found}


def cells_of(text: str) -> list[list[str]]:
    """Texts of the first table, line by line."""
    body = re.search(r"<tbody>(.*?)</tbody>", text)[1]
    return [re.findall(r"<t[hd][^>]*>(?:<strong>)?(.*?)(?:</strong>)?</t", line) for line in body.split("</tr>")[:-1]]


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Clip:
    """Seven frames of `disc_frame`."""
    return write_disc_clip(tmp_path_factory.mktemp("clips") / "disc", 7)


@pytest.fixture(scope="module")
def page(clip: Clip) -> str:
    return report(evaluate([clip], ["hold", "mobfgsr"], "interpolate"), {"disc": clip})


def test_the_page_holds_the_images_of_the_methods(page: str, clip: Clip) -> None:
    run, images = data_of(page)["runs"][0], images_of(page)
    truth = [clip[i].color[0] for i in range(7)]
    assert [images[name].tolist() for name in run["reference"]] == [packing.encode(t).tolist() for t in truth]
    hold, ours = run["methods"]
    assert hold["images"] == [run["reference"][i // 2 * 2] for i in range(7)]
    assert [a == b for a, b in zip(ours["images"], run["reference"], strict=True)] == [True, False] * 3 + [True]
    assert [frame["role"] for frame in run["frames"]] == ["shaded", "generated"] * 3 + ["shaded"]
    assert (run["fps"], run["size"], run["best"]) == (24, [32, 48], "mobfgsr")


def test_curves_are_the_values_of_the_frames(page: str, clip: Clip) -> None:
    run, rows = data_of(page)["runs"][0], data_of(page)["rows"]
    shown = [to_display(clip[i].color) for i in range(7)]
    truth = [float(psnr(shown[i - 1], shown[i])) if i % 2 else None for i in range(7)]
    assert run["methods"][0]["values"]["psnr"]["all"] == pytest.approx(truth)
    for strip in run["methods"]:
        for metric, region in (("psnr", "disoccluded"), ("ssim", "all"), ("flip", "all"), ("warped", "all")):
            found = [v for v in strip["values"][metric][region] if v is not None]
            key = (strip["name"], "generated", region, metric)
            (told,) = [r["value"] for r in rows if (r["method"], r["role"], r["region"], r["metric"]) == key]
            assert np.mean(found) == pytest.approx(told, abs=1e-6)


def test_flip_maps_have_the_mean_of_their_value(page: str) -> None:
    run, images = data_of(page)["runs"][0], images_of(page)
    hold = run["methods"][0]
    for name, value in zip(hold["flip"], hold["values"]["flip"]["all"], strict=True):
        assert (name is None) == (value is None)
        if name:
            assert images[name].mean() / 255 == pytest.approx(value, abs=1 / 255)


def test_tables_hold_the_numbers_with_the_best_in_bold(page: str) -> None:
    rows = [Row(**row) for row in data_of(page)["rows"]]
    for line in cells_of(page):
        told = {r.metric: r.value for r in rows if (r.method, r.role, r.region) == (line[0], "generated", "all")}
        assert line[1:5] == [f"{told['psnr']:.2f}", *(f"{told[m]:.4f}" for m in ("ssim", "flip", "warped"))]
    assert re.search(r'<th scope="row">mobfgsr</th><td><strong>', page)


def test_names_cannot_break_the_page(tmp_path: Path) -> None:
    clip = write_disc_clip(tmp_path / "a<!--<b>&", 3)
    text = report(evaluate([clip], ["hold"], "interpolate", PSNR), {clip.path.name: clip})
    assert "<b>&" not in text
    assert "<!--<" not in text
    assert data_of(text)["runs"][0]["clip"] == "a<!--<b>&"
    assert "a&lt;!--&lt;b&gt;&amp;: generated frames" in text


def test_nothing_of_the_page_lies_elsewhere(page: str) -> None:
    without = page.replace("http://www.w3.org/2000/svg", "")
    assert not re.search(r"https?:|//cdn|<link|@import|src=", without)


def test_clips_of_different_size_and_length_stand_on_one_page(tmp_path: Path, clip: Clip) -> None:
    other = write_disc_clip(tmp_path / "other", 5)
    rows = evaluate([clip, other], ["hold"], "interpolate", PSNR)
    runs = data_of(report(rows, {"disc": clip, "other": other}))["runs"]
    assert [(run["clip"], len(run["frames"])) for run in runs] == [("disc", 7), ("other", 5)]


# What fits.


def test_large_images_are_cropped_to_where_most_changes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("framecast.report.SMALLEST", 24)
    for t in range(3):
        color = np.random.default_rng(0).random((3, 40, 30), dtype=np.float32)
        color[:, 34:38, 20:28] = t
        write_frame(tmp_path, Record(t, float(t)), {"color": color})
    clip = finish(tmp_path, fps=24)
    job = Job("clip", "interpolate", 1.0, ("hold",))
    assert window_of(clip, job, 1e5).height == 40
    window = window_of(clip, job, 10e3)
    assert (window.height, window.width, len(window.frames)) == (24, 18, 2)
    assert window.top + window.height >= 38
    assert window.left <= 20
    assert window.left + window.width >= 28
    text = report(evaluate([clip], ["hold"], "interpolate", PSNR), {clip.path.name: clip}, megabytes=0.31)
    assert "18x24 of 30x40 pixels" in text
    assert sum(len(packed) for packed in re.findall(r'data-size="[^"]*">(.*?)<', text)) < 10e3
    run, images = data_of(text)["runs"][0], images_of(text)
    assert run["window"] == [window.left, window.top]
    assert [name and images[name].shape for name in run["methods"][0]["flip"]] == [None, (1, 24, 18)]
    assert list(run["methods"][0]["values"]) == ["psnr"]  # FLIP of all pixels is not known


def test_the_busiest_place_is_that_of_a_loop() -> None:
    change = torch.rand(1, 1, 9, 11)
    sums = {(y, x): float(change[0, 0, y : y + 4, x : x + 5].sum()) for y in range(6) for x in range(7)}
    assert place(change, 4, 5) == max(sums, key=sums.__getitem__)


# What is said.


class Twice(torch.nn.Module):
    """Every pixel four times."""

    needs = ("color",)
    needs_generated = ()
    modes = ("pass",)
    scales = (2.0,)
    history = 1
    step_motion = False

    def __init__(self) -> None:
        super().__init__()
        self.config = type("Config", (), {"scale": 2.0})()

    def start(self, frame: Frame) -> Frame:
        return frame

    def forward(self, frame: Frame, state: Frame) -> tuple[torch.Tensor, Frame]:
        return torch.nn.functional.interpolate(frame.color, scale_factor=2), state


def test_without_references_images_are_still_shown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(METHODS, "twice", Twice)
    for t in range(2):
        frame = disc_frame(t)
        layers = {name: getattr(frame, name)[0].numpy() for name in ("color", "depth", "motion")}
        write_frame(tmp_path, Record(t, float(t)), layers, reference=np.full((3, 64, 96), 0.5, np.float32))
    clip = finish(tmp_path, fps=24, scale=2)
    rows = evaluate([clip], ["twice"], "pass", PSNR)
    name = clip.path.name
    run = data_of(report(rows, {name: clip}))["runs"][0]
    assert (run["size"], run["role"], len(run["reference"])) == ([64, 96], "shaded", 2)
    shutil.rmtree(tmp_path / "reference")
    text = report(rows, {name: open_clip(tmp_path)})
    run = data_of(text)["runs"][0]
    assert run["reference"] is None
    assert run["methods"][0]["values"] == {}
    assert "has no reference for these images any more" in text
    assert cells_of(text)[0][:2] == ["twice", f"{rows[0].value:.2f}"]


def test_other_images_than_were_measured_are_pointed_out(clip: Clip) -> None:
    rows = evaluate([clip], ["hold"], "interpolate", PSNR)
    assert "made other images" not in report(rows, {"disc": clip})
    wrong = [replace(row, value=row.value + 0.5) if row.metric == "psnr" else row for row in rows]
    assert "hold on disc made other images" in report(wrong, {"disc": clip})


def test_no_rows_and_too_few_frames_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no rows to report"):
        jobs_of([])
    one = write_disc_clip(tmp_path / "one", 1)
    with pytest.raises(ClipError, match="has 1 frame; to hide every second one"):
        report([Row("hold", "one", "interpolate", "generated", "all", "psnr", 30.0)], {"one": one})


@pytest.fixture
def results(tmp_path: Path) -> Path:
    """A results file of a clip in a folder beside it."""
    write_disc_clip(tmp_path / "shots" / "disc", 5)
    path = tmp_path / "out.json"
    assert (
        main(
            [
                "evaluate",
                str(tmp_path / "shots" / "disc"),
                "--methods",
                "hold,blend",
                "--metrics",
                "psnr",
                "--json",
                str(path),
            ]
        )
        == 0
    )
    return path


def test_results_say_what_they_were_made_from(results: Path) -> None:
    about = read_provenance(results)
    source = about.clips["disc"]
    assert (source.frames, source.size, source.fps, len(source.sha256)) == (5, (32, 48), 24, 64)
    assert list(about.methods) == ["hold", "blend"]
    assert about.settings["metrics"] == ["psnr"]
    assert {"framecast", "torch", "python", "cpu"} <= set(about.machine)
    write_results(results, read_results(results))
    assert read_provenance(results) is None


def test_the_command_writes_the_page(results: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = results.with_name("page.html")
    assert main(["report", str(results), "-o", str(out), "--methods", "blend"]) == 0
    assert capsys.readouterr().out.splitlines()[-1].startswith(f"{out}: blend on disc, 0.")
    text = out.read_text()
    assert [strip["name"] for strip in data_of(text)["runs"][0]["methods"]] == ["blend"]
    assert f"SHA-256 {read_provenance(results).clips['disc'].sha256}" in text
    assert sorted(path.name for path in results.parent.iterdir()) == ["out.json", "page.html", "shots"]


def test_a_clip_that_moved_is_found_where_the_user_says(results: Path, capsys: pytest.CaptureFixture[str]) -> None:
    new = results.parent / "elsewhere"
    (results.parent / "shots").rename(new)
    out = ["report", str(results), "-o", str(results.with_name("page.html"))]
    assert main(out) == 2
    said = capsys.readouterr().err
    assert "the clip disc of" in said
    assert "--clips FOLDER" in said
    assert main([*out, "--clips", str(new)]) == 0
    assert main([*out, "--clips", str(new / "disc")]) == 0


def test_another_clip_in_its_place_is_refused(results: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = results.parent / "shots" / "disc"

    def said() -> str:
        assert main(["report", str(results), "-o", str(results.with_name("page.html"))]) == 2
        return capsys.readouterr().err

    write_frame(folder, Record(1, 0.0), {"color": np.zeros((3, 32, 48), np.float32)})
    assert "disc has changed since disc was evaluated" in said()
    shutil.rmtree(folder)
    write_disc_clip(folder, 3)
    assert "has 3 frames, but disc had 5" in said()
    shutil.rmtree(folder)
    write_frame(folder, Record(1, 0.0), {"color": np.zeros((3, 16, 16), np.float32)})
    finish(folder, fps=24)
    assert "has frames of 16x16 pixels, but disc had 48x32" in said()


def test_other_files_are_refused_in_a_sentence(results: Path, capsys: pytest.CaptureFixture[str]) -> None:
    held = json.loads(results.read_text())

    def said(content: object, *more: str) -> str:
        results.write_text(json.dumps(content))
        assert main(["report", str(results), *more]) == 2
        return capsys.readouterr().err

    assert "has version 7; this framecast reads version 2" in said({**held, "version": 7})
    assert "there are no rows to report" in said({**held, "rows": []})
    assert "is no results file" in said({**held, "about": {"clips": 3}})
    assert "has no rows of nobody" in said(held, "--methods", "nobody")
