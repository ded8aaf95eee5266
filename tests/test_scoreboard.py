"""The scoreboard measures everything once, its pages say what was measured, and claims hold where numbers say so."""

import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import pytest
import torch
from conftest import disc_frame, write_disc_clip
from torch.nn.functional import interpolate

from framecast.bench import Row as Timing
from framecast.clip import finish, write_frame
from framecast.methods import METHODS
from framecast.results import Row, read_results

FOLDER = Path(__file__).parent.parent / "benchmarks"


@pytest.fixture
def scripts(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[ModuleType, ModuleType, ModuleType]]:
    monkeypatch.syspath_prepend(str(FOLDER))
    import claims
    import scoreboard
    import scoreboard_page

    yield scoreboard, scoreboard_page, claims
    for name in ("claims", "scoreboard", "scoreboard_page"):
        sys.modules.pop(name)


def large(folder: Path) -> None:
    clip = write_disc_clip(folder, 6, jitter=torch.tensor([[0.25, -0.25]]))
    for i, record in enumerate(clip.records):
        color = disc_frame(i).color
        assert color is not None
        reference = interpolate(color, scale_factor=2.0)[0].numpy()
        write_frame(folder, replace(record, jitter=(0.25, -0.25)), dict(clip.load(record)), reference=reference)
    finish(folder, fps=24, scale=2)


def test_the_pages_are_what_was_measured_and_nothing_is_measured_twice(
    scripts: tuple[ModuleType, ModuleType, ModuleType], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scoreboard, pages, _ = scripts
    for name in set(METHODS) - {"hold", "blend", "mobfgsr", "bilinear"}:
        monkeypatch.delitem(METHODS, name)
    folder, out = tmp_path / "held", tmp_path / "out"
    write_disc_clip(folder / "plain" / "disc", 6)
    large(folder / "large" / "disc")
    out.mkdir()
    (out / "README.md").write_text("\n".join(("before", *pages.MARKERS, "after")))

    def run() -> str:
        scoreboard.main(folder, "48x32", "disc", "psnr", repeats=1, render=False, out=out)
        return (out / "docs/results/README.md").read_text()

    page = run()
    rows = {part.name: read_results(folder / f"{part.name}.json") for part in scoreboard.PARTS}
    assert {row.method for row in rows["interpolate"]} == {"hold", "blend", "mobfgsr"}
    assert (
        {row.method for row in rows["same-size"]} == {row.method for row in rows["larger"]} == {"mobfgsr", "bilinear"}
    )
    assert {row.method for row in rows["larger-extrapolate"]} == {"mobfgsr"}
    key = ("blend", "generated", "all", "psnr")
    (value,) = [r.value for r in rows["interpolate"] if (r.method, r.role, r.region, r.metric) == key]
    line = next(line for line in page.splitlines() if line.startswith("| `blend` |"))
    assert line.split("|")[2].strip().strip("*") == f"{value:.2f}"
    assert float(line.split("|")[3]) > 0
    readme = (out / "README.md").read_text().splitlines()
    assert (readme[0], readme[-1]) == ("before", "after")
    assert any(line.startswith("| `bilinear` |") for line in readme)
    assert "not yet measured" in (out / "docs/results/claims.md").read_text()
    for name in ("evaluate", "bench"):
        monkeypatch.setattr(scoreboard, name, None)
    monkeypatch.setattr(scoreboard, "bench", type("Kept", (), {"Row": Timing}))
    assert run() == page  # from what is held alone
    (out / "README.md").write_text("nothing")
    with pytest.raises(ValueError, match="lacks the markers"):
        run()


def test_a_new_method_is_measured_and_the_others_are_kept(
    scripts: tuple[ModuleType, ModuleType, ModuleType], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scoreboard, _, _ = scripts
    clip = write_disc_clip(tmp_path / "disc", 6)
    part, path = scoreboard.PARTS[0], tmp_path / "rows.json"

    def run(*names: str) -> dict[str, float]:
        rows = scoreboard.evaluated(path, part, [clip], names, "psnr", 1)
        return {row.method: row.value for row in rows if (row.role, row.region) == ("generated", "all")}

    held = run("hold", "blend")
    marked = path.read_text().replace(str(held["hold"]), "77.0")
    path.write_text(marked)
    assert run("hold", "blend", "mobfgsr").keys() == {"hold", "blend", "mobfgsr"}
    assert run("hold", "blend", "mobfgsr")["hold"] == 77.0


def timing(method: str, role: str, median: float) -> Timing:
    return Timing(method, role, False, median, median, median, 1.0, {}, 0.0, 0.0, None, None, 0)  # type: ignore[arg-type]


def test_claims_hold_where_the_numbers_say_so(scripts: tuple[ModuleType, ModuleType, ModuleType]) -> None:
    *_, claims = scripts
    one, other = claims.of("I", "mobfgsr"), claims.of("I", "warp3d")

    def rows(first: float, second: float, metric: str = "psnr") -> dict[str, list[Row]]:
        values = {("mobfgsr", "a"): first, ("mobfgsr", "b"): first + 2, ("warp3d", "a"): second}
        return {
            "interpolate": [
                Row(m, clip, "interpolate", "generated", "all", metric, v) for (m, clip), v in values.items()
            ]
        }

    ahead = claims.Claim("paper", "ahead", "", one, other, 4.0)
    assert claims.margin(ahead, rows(30, 28), {}) == pytest.approx(3.0)  # the mean over clips
    assert claims.verdict(ahead, 0.1) == "holds"
    assert claims.verdict(ahead, -0.1) == "**does not hold**"
    assert claims.verdict(ahead, claims.margin(ahead, {}, {})) == "not yet measured"
    flip = replace(ahead, metric="flip")
    assert claims.margin(flip, rows(0.1, 0.5, "flip"), {}) == pytest.approx(-0.6)  # less is better
    close = replace(ahead, kind="close")
    assert [claims.verdict(close, amount) for amount in (-0.9, 1.1)] == ["holds", "**does not hold**"]
    times = {"interpolate": [timing("mobfgsr", "interpolate", 2.0), timing("warp3d", "interpolate", 20.0)]}
    faster = replace(ahead, kind="faster")
    assert claims.margin(faster, {}, times) == 10.0
    assert claims.verdict(faster, 0.9) == "**does not hold**"
    page = claims.page(rows(30, 28), times)
    assert f"of {len(claims.CLAIMS)}" not in page
    assert page.count("not yet measured |") == len(claims.CLAIMS)
