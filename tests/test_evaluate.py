"""The evaluation protocol: what is hidden, what counts, which pixels are disoccluded, and what the file says."""

import json
import runpy
import statistics
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from conftest import disc_frame, write_disc_clip

from framecast import campaign
from framecast import evaluate as protocol
from framecast.campaign import command
from framecast.clip import Clip, ClipError, Record, finish, write_frame
from framecast.color import to_display
from framecast.evaluate import Settings, counts, evaluate, neighbours
from framecast.fit import require
from framecast.frame import Frame
from framecast.methods import METHODS
from framecast.metrics import psnr
from framecast.regions import regions
from framecast.results import Row, read_results, tables, with_means, write_results
from framecast.runtime import Output, stream

PSNR = Settings(metrics=("psnr",))


class Probe(torch.nn.Module):
    """Makes the image that a function of (frame, last shaded frame) gives, and keeps what it was shown."""

    needs: tuple[str, ...] = ("color",)
    needs_generated: tuple[str, ...] = ()
    modes: tuple[str, ...] = ("interpolate", "extrapolate")
    scales: tuple[float, ...] = (1.0,)
    history: int | None = 1
    step_motion: bool = False

    def __init__(self, image: Callable[[Frame, Frame], torch.Tensor], **attributes: object) -> None:
        super().__init__()
        self.image, self.seen = image, []
        for name, value in attributes.items():
            setattr(self, name, value)

    def start(self, frame: Frame) -> Frame:
        return frame

    def forward(self, frame: Frame, state: Frame) -> tuple[torch.Tensor, Frame]:
        self.seen.append(frame)
        if frame.color is not None:
            return frame.color, frame
        return self.image(frame, state), state


@pytest.fixture
def probe(monkeypatch: pytest.MonkeyPatch) -> Callable[..., Probe]:
    """Puts a method called probe among the others."""

    def make(image: Callable[[Frame, Frame], torch.Tensor] = lambda frame, state: state.color, **more: object) -> Probe:
        method = Probe(image, **more)
        monkeypatch.setitem(METHODS, "probe", lambda: method)
        return method

    return make


def value(rows: list[Row], metric: str, role: str = "generated", region: str = "all") -> float:
    (found,) = [r.value for r in rows if (r.metric, r.role, r.region) == (metric, role, region)]
    return found


def display(time: float) -> torch.Tensor:
    return to_display(disc_frame(time).color.half().float())


@pytest.mark.parametrize("mode", ["interpolate", "extrapolate", "mixed"])
def test_a_method_that_knows_the_truth_is_perfect(mode: str, disc_clip: Clip, probe: Callable) -> None:
    probe(lambda frame, state: disc_frame(float(frame.time)).color.half().float())
    rows = evaluate([disc_clip], ["probe"], mode)
    for region in ("all", "disoccluded"):
        assert [value(rows, m, region=region) for m in ("psnr", "ssim", "flip")] == [100, 1, 0]
    assert [value(rows, m, "shaded") for m in ("psnr", "ssim", "flip")] == [100, 1, 0]
    assert {(r.method, r.clip, r.mode) for r in rows} == {("probe", "disc", mode)}


def test_hold_has_the_error_of_the_frame_before(disc_clip: Clip) -> None:
    rows = evaluate([disc_clip], ["hold"], "interpolate", PSNR)
    truth = [float(psnr(display(t - 1), display(t))) for t in (1, 3, 5)]
    assert value(rows, "psnr") == pytest.approx(statistics.fmean(truth), abs=1e-3)
    rows = evaluate([disc_clip], ["hold"], "extrapolate", PSNR)
    assert value(rows, "psnr") == pytest.approx(statistics.fmean(truth[1:]), abs=1e-3)


def test_the_method_never_sees_a_hidden_frame(disc_clip: Clip, probe: Callable) -> None:
    method = probe()
    evaluate([disc_clip], ["probe"], "extrapolate", PSNR)
    assert [(float(f.time), f.color is not None) for f in method.seen] == [(t, t % 2 == 0) for t in range(7)]
    assert all(f.depth is None for f in method.seen if f.color is None)


def test_methods_that_need_them_get_the_buffers_of_the_hidden_frame(disc_clip: Clip, probe: Callable) -> None:
    method = probe(needs_generated=("depth", "motion"))
    evaluate([disc_clip], ["probe"], "extrapolate", PSNR)
    for frame in method.seen[1::2]:
        truth = disc_frame(float(frame.time))
        assert frame.color is None
        torch.testing.assert_close((frame.depth, frame.motion), (truth.depth, truth.motion))


@pytest.mark.parametrize(("step_motion", "forward", "span"), [(True, True, 1), (True, False, 2), (False, True, 2)])
def test_motion_to_the_hidden_frames_is_offered_where_wanted_and_recorded(
    step_motion: bool, forward: bool, span: float, tmp_path: Path, probe: Callable
) -> None:
    clip = write_disc_clip(tmp_path / "clip", 5)
    if not forward:
        clip = without(clip, "motion_next")
    method = probe(step_motion=step_motion)
    evaluate([clip], ["probe"], "interpolate", PSNR)
    assert float(method.seen[-2].span) == span
    torch.testing.assert_close(method.seen[-2].motion, disc_frame(4, step=span).motion)


def without(clip: Clip, layer: str) -> Clip:
    def load(record: Record) -> dict:
        return {k: v for k, v in clip.load(record).items() if k != layer}

    return replace(clip, load=load, layers=tuple(k for k in clip.layers if k != layer))


def cut_at(clip: Clip, *indices: int) -> Clip:
    records = tuple(replace(r, cut=i in indices) for i, r in enumerate(clip.records))
    return replace(clip, records=records)


def test_what_counts_is_of_one_shot(tmp_path: Path) -> None:
    clip = write_disc_clip(tmp_path / "clip", 12)

    def counted(mode: str, *cuts: int) -> list[int]:
        return [i for i in range(1, 12, 2) if counts(cut_at(clip, *cuts), i, mode)]

    assert counted("interpolate") == [1, 3, 5, 7, 9]  # nothing follows 11
    assert counted("extrapolate") == counted("mixed") == [3, 5, 7, 9]  # at 1 no motion is known
    assert counted("interpolate", 5) == counted("interpolate", 6) == [1, 3, 7, 9]
    assert counted("extrapolate", 5) == [3, 9]  # 5 is of the new shot, 6 is the only frame before 7
    assert counted("extrapolate", 6) == [3, 5, 9]  # 5 still belongs to the old shot
    assert counted("mixed", 6) == [3, 9]


def brute_disoccluded(time: float, *others: float) -> torch.Tensor:
    """Wall pixels around which another moment shows nothing but the disc, which hides the wall there."""
    here, mask = disc_frame(time).object[0, 0], torch.zeros(32, 48, dtype=torch.bool)
    for other in others:
        there = disc_frame(other).object[0, 0]
        for j in range(1, 31):
            for i in range(1, 47):
                mask[j, i] |= here[j, i] == 0 and bool(there[j - 1 : j + 2, i - 1 : i + 2].all())
    return mask


def test_disoccluded_is_what_a_neighbour_hides(disc_clip: Clip) -> None:
    before, both = brute_disoccluded(3, 2), brute_disoccluded(3, 2, 4)
    assert 0 < before.sum() < both.sum()
    for mode, truth in (("extrapolate", before), ("interpolate", both), ("mixed", both)):
        others = [disc_clip[i] for i in neighbours(disc_clip, 3, "generated", mode)]
        assert torch.equal(regions(disc_clip, 3, disc_clip[3], others)["disoccluded"][0, 0], truth)
    bare = without(disc_clip, "depth")
    assert regions(bare, 3, bare[3], [bare[2]]) == {"all": None}


def test_disoccluded_pixels_alone_make_the_regions_number(disc_clip: Clip, probe: Callable) -> None:
    def outside_it(frame: Frame, state: Frame) -> torch.Tensor:
        truth = disc_frame(float(frame.time))
        mask = brute_disoccluded(float(frame.time), float(frame.time) - 1)
        return torch.where(mask, truth.color.half().float(), 0.0)

    probe(outside_it)
    rows = evaluate([disc_clip], ["probe"], "extrapolate", PSNR)
    assert value(rows, "psnr", region="disoccluded") == 100
    assert value(rows, "psnr") < 20


def test_shaded_frames_are_compared_with_references_of_their_size(tmp_path: Path) -> None:
    clip = write_disc_clip(tmp_path, 5)
    for i, record in enumerate(clip.records):
        frame = disc_frame(i).color[0].numpy()
        layers = {k: v for k, v in clip.load(record).items() if k in ("color", "depth", "motion")}
        write_frame(tmp_path, record, layers, reference=frame * 0.5)
    plain = value(evaluate([clip], ["hold"], "interpolate", PSNR), "psnr")
    rows = evaluate([finish(tmp_path, fps=24, scale=1)], ["hold"], "interpolate", PSNR)
    half = [to_display((disc_frame(t).color * 0.5).half().float()) for t in (0, 2, 4)]
    truth = [float(psnr(display(t), h)) for t, h in zip((0, 2, 4), half, strict=True)]
    assert value(rows, "psnr", "shaded") == pytest.approx(statistics.fmean(truth), abs=1e-3)
    assert value(rows, "psnr") == pytest.approx(plain, abs=1e-6)  # generated ones still with what was hidden


def test_change_over_time_is_along_the_whole_way_from_the_image_before(disc_clip: Clip, probe: Callable) -> None:
    """Of a shot that holds every second frame, whether its vectors lead to those or to the frames left out."""
    probe(lambda frame, state: state.color)
    kept = tuple(replace(record, cut=False) for record in disc_clip.records[::2])
    found = []
    for span in (1.0, 2.0):

        def load(record: Record, span: float = span) -> dict:
            motion = disc_frame(record.time, step=span).motion[0].numpy()
            layers = {k: v for k, v in disc_clip.load(record).items() if k in ("color", "depth", "motion_next")}
            ahead = disc_frame(record.time, step=span).motion_next[0].numpy()
            return {**layers, "motion": motion, "motion_next": ahead}

        clip = replace(disc_clip, records=kept, load=load, span=span)
        rows = evaluate([clip], ["probe"], "interpolate", Settings(metrics=("warped",)))
        found.append(value(rows, "warped", "shaded"))
    assert found[0] == pytest.approx(found[1], rel=1e-4)


def test_time_is_the_median_after_the_first_two_of_a_role(disc_clip: Clip, monkeypatch: pytest.MonkeyPatch) -> None:
    def timed(*arguments: object, **named: object) -> Iterator[Output]:
        milliseconds = {True: iter((900, 800, 30)), False: iter((500, 400, 1, 2))}
        for output in stream(*arguments, **named):
            yield replace(output, milliseconds=float(next(milliseconds[output.generated])))

    monkeypatch.setattr(protocol, "stream", timed)
    rows = evaluate([disc_clip], ["hold"], "extrapolate", PSNR)
    assert (value(rows, "milliseconds"), value(rows, "milliseconds", "shaded")) == (30, 1.5)


def test_two_runs_give_the_same_numbers(disc_clip: Clip) -> None:
    first, second = (
        [r for r in evaluate([disc_clip], ["hold", "blend"], "interpolate") if r.metric != "milliseconds"]
        for _ in range(2)
    )
    assert first == second
    assert {row.region for row in first if row.role == "generated"} == {"all", "disoccluded", "border", "static"}
    assert {row.region for row in first if row.role == "shaded"} == {"all", "disoccluded", "border", "static"}


def test_clips_that_share_a_name_are_told_apart(disc_clip: Clip, tmp_path: Path) -> None:
    other = write_disc_clip(tmp_path / "other" / "disc", 3)
    assert protocol.labels([disc_clip, other]) == [str(disc_clip.path), str(other.path)]
    assert protocol.labels([disc_clip]) == ["disc"]


def test_a_missing_field_is_named_with_what_to_do(disc_clip: Clip, probe: Callable) -> None:
    method = probe(needs=("color", "motion"), needs_generated=("albedo",))
    sentence = (
        f"{disc_clip.path} has no albedo (it has color, depth, motion, motion_next, object); probe needs it. "
        f"Export the Diffuse Color pass, or use --method "
    )
    with pytest.raises(ClipError) as error:
        require(disc_clip, "probe", method)
    assert str(error.value).startswith(sentence)
    assert str(error.value).removeprefix(sentence) in set(METHODS) - {"probe"}
    with pytest.raises(ClipError, match=r"has no projection \(it has .* needs it\. Use --method "):
        require(disc_clip, "probe", probe(needs=("view", "projection")))
    require(disc_clip, "probe", probe(needs=("color", "view"), needs_generated=("depth",)))
    still = without(without(disc_clip, "motion"), "motion_next")
    with pytest.raises(ClipError, match=r"Export the Vector pass, or use --method (bilinear|lanczos)$"):
        require(still, "taau", METHODS["taau"]())


def test_bad_input_is_one_sentence(disc_clip: Clip, probe: Callable, tmp_path: Path) -> None:
    probe(modes=("extrapolate",))
    two, uneven = write_disc_clip(tmp_path / "two", 2), [r.time + (r.time == 1) * 0.4 for r in disc_clip.records]
    uneven_clip = replace(
        without(without(disc_clip, "motion"), "motion_next"),
        records=tuple(replace(r, time=t) for r, t in zip(disc_clip.records, uneven, strict=True)),
    )
    cases = [
        ([disc_clip], ["nothing"], "interpolate", PSNR, "no method 'nothing'; use one of hold"),
        ([disc_clip], ["probe"], "mixed", PSNR, "probe cannot run with --mode mixed .it can extrapolate.*hold"),
        ([disc_clip], ["hold"], "interpolate", Settings(metrics=("vmaf",)), "no metric 'vmaf'; use some of psnr"),
        ([two], ["hold"], "interpolate", PSNR, "two has 2 frames; .* at least 3 of one shot"),
        ([two], ["hold"], "extrapolate", PSNR, "at least 5 of one shot"),
        ([], ["hold"], "interpolate", PSNR, "at least one clip and one method"),
        ([without(disc_clip, "color")], ["hold"], "interpolate", PSNR, "has no color"),
        ([uneven_clip], ["hold"], "interpolate", PSNR, "no frame at time 1 .*evenly spaced"),
    ]
    for clips, methods, mode, settings, words in cases:
        with pytest.raises(ValueError, match=words):
            evaluate(clips, methods, mode, settings)


ROWS = [
    Row("hold", "a", "interpolate", "generated", "all", "psnr", 20.0),
    Row("hold", "a", "interpolate", "generated", "all", "flip", 0.1),
    Row("blend", "a", "interpolate", "generated", "all", "psnr", 24.0),
    Row("blend", "a", "interpolate", "generated", "all", "flip", 0.2),
    Row("hold", "b", "interpolate", "generated", "all", "psnr", 30.0),
    Row("blend", "b", "interpolate", "generated", "all", "psnr", 25.0),
    Row("hold", "a", "interpolate", "shaded", "all", "psnr", 100.0),
]


def test_results_are_read_as_written_and_other_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "out.json"
    write_results(path, ROWS)
    assert read_results(path) == ROWS
    held = json.loads(path.read_text())
    assert set(held) == {"version", "rows"}
    assert held["version"] == 2
    assert list(held["rows"][0]) == ["method", "clip", "mode", "role", "region", "metric", "value", "scale"]
    path.write_text(json.dumps({"version": 1, "rows": [{"new": 1}]}))
    with pytest.raises(ValueError, match=r"has version 1; this framecast reads version 2"):
        read_results(path)
    for damaged in (path.read_text()[:10], "[]", '{"version": 2, "rows": [{"method": "hold"}]}'):
        path.write_text(damaged)
        with pytest.raises(ValueError, match="is no results file"):
            read_results(path)
    with pytest.raises(FileNotFoundError, match="make one with"):
        read_results(tmp_path / "none.json")


def test_means_are_over_clips() -> None:
    means = {(r.method, r.role, r.metric): r.value for r in with_means(ROWS) if r.clip == "mean"}
    assert means["hold", "generated", "psnr"] == 25.0
    assert means["blend", "generated", "psnr"] == 24.5
    assert len(means) == 5


def test_tables_show_each_clip_and_the_mean_with_the_best_in_bold() -> None:
    made = tables(ROWS)
    assert list(made) == [f"{clip}: generated frames, interpolate" for clip in ("a", "b", "mean")]
    first, _, mean = made.values()
    assert list(first.columns[0].cells) == ["hold", "blend"]
    assert list(first.columns[1].cells) == ["20.00", "[bold]24.00[/bold]"]
    assert list(first.columns[2].cells) == ["[bold]0.1000[/bold]", "0.2000"]  # less is better
    assert list(mean.columns[1].cells) == ["[bold]25.00[/bold]", "24.50"]
    equal = tables([replace(r, value=1.0) for r in ROWS if r.role == "generated"])
    assert not any("bold" in str(cell) for table in equal.values() for column in table.columns for cell in column.cells)
    changed = [replace(r, value=40.0) if r.role == "shaded" else r for r in ROWS]
    assert "a: shaded frames, interpolate" in tables(changed)
    after = [replace(r, metric="warped", value=0.1) if r.role == "shaded" else r for r in ROWS]
    assert "a: shaded frames, interpolate" not in tables(after)  # only frames around them are wrong
    alike = [*changed, *(replace(r, method="blend") for r in changed if r.role == "shaded")]
    assert "a: shaded frames, interpolate" not in tables(alike)  # that of the clip, whatever the method


def test_a_table_that_is_too_wide_has_a_column_for_each_method() -> None:
    """And the same cells."""
    wide, narrow = tables(ROWS, 200)["a: generated frames, interpolate"], tables(ROWS, 15)
    turned = narrow["a: generated frames, interpolate"]
    assert [column.header for column in turned.columns] == ["method", "hold", "blend"]
    assert list(turned.columns[0].cells) == [column.header for column in wide.columns[1:]]
    for k in (0, 1):
        assert list(turned.columns[k + 1].cells) == [list(column.cells)[k] for column in wide.columns[1:]]


def test_command_prints_tables_and_writes_the_rows(
    disc_clip: Clip, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    path = tmp_path / "out.json"
    command((disc_clip.path,), methods="hold, blend", mode="extrapolate", json=path, metrics="psnr")
    timeless = [r for r in read_results(path) if r.metric != "milliseconds"]
    expected = evaluate([disc_clip], ["hold", "blend"], "extrapolate", PSNR)
    assert timeless == [r for r in expected if r.metric != "milliseconds"]
    assert [p.name for p in tmp_path.glob("*.json")] == ["out.json"]
    printed = capsys.readouterr().out
    assert "disc: generated frames, extrapolate" in printed
    assert f"hold, blend on disc, extrapolate -> {path} ({len(read_results(path))} rows)" in printed


def test_command_goes_on_where_it_was_interrupted(
    disc_clip: Clip, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, one, ran = tmp_path / "out.json", campaign.perform, []

    def interrupted(task: campaign.Task) -> list[Row]:
        if task.method == "blend":
            raise KeyboardInterrupt
        return one(task)

    def again(**changes: str) -> list[str]:
        ran.clear()
        command((disc_clip.path,), methods="hold,blend", json=path, **{"metrics": "psnr", **changes})
        return list(ran)

    monkeypatch.setattr(campaign, "perform", interrupted)
    with pytest.raises(KeyboardInterrupt):
        again()
    assert not path.exists()
    held = (tmp_path / ".out.part.json").read_text()
    monkeypatch.setattr(campaign, "perform", lambda task: ran.append(task.method) or one(task))
    assert again() == ["blend"]
    assert list(dict.fromkeys(r.method for r in read_results(path))) == ["hold", "blend"]
    assert again() == ["hold", "blend"]  # a finished file is measured anew
    for changes in ({"metrics": "psnr,flicker"}, {"mode": "extrapolate"}):
        (tmp_path / ".out.part.json").write_text(held)
        assert again(**changes) == ["hold", "blend"]  # other numbers were asked for
    (tmp_path / ".out.part.json").write_text(held)
    write_disc_clip(disc_clip.path, 7, depth=disc_frame(0).depth * 2)
    assert again() == ["hold", "blend"]  # the clip is another one


def test_command_takes_every_method_that_fits(
    disc_clip: Clip, probe: Callable, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    probe(needs=("color", "albedo"))
    monkeypatch.setitem(METHODS, "late", lambda: Probe(lambda frame, state: state.color, modes=("extrapolate",)))
    for name in set(METHODS) - {"hold", "blend", "probe", "late"}:
        monkeypatch.delitem(METHODS, name)
    command((disc_clip.path,), metrics="psnr,lpips" if protocol.lpips_missing() else "psnr")
    printed = capsys.readouterr()
    assert "hold, blend on disc" in printed.out
    assert protocol.lpips_missing() is None or "LPIPS is left out" in printed.err


def test_the_quality_page_holds_the_rows(disc_clip: Clip, tmp_path: Path) -> None:
    script = Path(__file__).parents[1] / "benchmarks" / "quality.py"
    other = write_disc_clip(tmp_path / "other", 5)
    output, path = tmp_path / "page.md", tmp_path / "rows.json"
    main = runpy.run_path(str(script))["main"]
    main((disc_clip.path, other.path), output, methods="hold,blend", metrics=("psnr", "flip"), json=path)
    lines, rows = output.read_text().splitlines(), with_means(read_results(path))
    head = lines.index("## Interpolate: disoccluded pixels")
    assert lines[head + 2] == "| method | disc | other | mean |"

    def cell(clip: str, metric: str, digits: int) -> str:
        keys = ("interpolate", "generated", "disoccluded", metric, clip)
        found = {r.method: r.value for r in rows if (r.mode, r.role, r.region, r.metric, r.clip) == keys}
        best = (max if metric == "psnr" else min)(found.values()) == found["blend"]
        return f"**{found['blend']:.{digits}f}**" if best else f"{found['blend']:.{digits}f}"

    cells = [f"{cell(clip, 'psnr', 2)} / {cell(clip, 'flip', 4)}" for clip in ("disc", "other", "mean")]
    assert lines[head + 5] == f"| blend | {' | '.join(cells)} |"
    assert "## Extrapolate: milliseconds a frame" in lines
