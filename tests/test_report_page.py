"""The page of the report in a browser: every control does what it says, without an error and without a network."""

import json
import os
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import torch
from conftest import write_disc_clip

from framecast.clip import Clip
from framecast.color import to_display
from framecast.evaluate import Settings, evaluate
from framecast.flip import flip_map
from framecast.report import report

BROWSERS = ("/usr/bin/chromium", "/usr/bin/chromium-browser", "/usr/bin/google-chrome")
FLAGS = ("--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking", "--disable-sync")
SIZE = (1280, 900)


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    path = next((name for name in BROWSERS if Path(name).is_file()), None)
    if path is None and os.environ.get("FRAMECAST_NEEDS_CHROMIUM"):
        pytest.fail("no Chromium, and FRAMECAST_NEEDS_CHROMIUM is set; install it with: apt install chromium")
    if path is None:
        pytest.skip("no Chromium: the report's page is not tested in a browser; install it with: apt install chromium")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        running = driver.chromium.launch(executable_path=path, args=FLAGS)
        yield running
        running.close()


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Clip:
    """Seven frames of `disc_frame`."""
    return write_disc_clip(tmp_path_factory.mktemp("clips") / "disc", 7)


@pytest.fixture(scope="module")
def file(clip: Clip, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A report of that clip."""
    path = tmp_path_factory.mktemp("report") / "report.html"
    path.write_text(report(evaluate([clip], ["hold", "blend", "mobfgsr"], "interpolate"), {"disc": clip}))
    return path


class Opened:
    """A page in the browser, and what a person can do with it."""

    def __init__(self, page: Any) -> None:
        self.page = page

    def settled(self) -> None:
        """Waits until what was asked for is drawn."""
        self.page.evaluate("() => new Promise((then) => requestAnimationFrame(() => requestAnimationFrame(then)))")
        self.page.wait_for_selector("body[data-drawn]:not([data-waiting])")

    def do(self, action: Callable[[Any], object]) -> None:
        action(self.page)
        self.settled()

    def key(self, *keys: str) -> None:
        self.do(lambda page: [page.keyboard.press(key) for key in keys])

    def view(self, name: str) -> None:
        self.do(lambda page: page.check(f"input[name=view][value={name}]", force=True))

    def slide(self, name: str, value: float) -> None:
        self.do(lambda page: page.fill(f"#{name}", str(value)))

    def stage(self) -> str:
        """The whole picture, to be compared with another."""
        return str(self.page.evaluate("document.getElementById('stage').toDataURL()"))

    def spot(self, x: float, y: float) -> torch.Tensor:
        """Red, green and blue, 0..255, at a place of the stage, in parts of its width and height."""
        script = """([x, y]) => { const s = document.getElementById('stage'), p = s.getContext('2d');
            return [...p.getImageData(Math.floor(x * s.width), Math.floor(y * s.height), 1, 1).data]; }"""
        return torch.tensor(self.page.evaluate(script, [x, y])[:3], dtype=torch.float32)

    def show(self, a: str, b: str) -> None:
        self.do(lambda page: (page.select_option("#a", a), page.select_option("#b", b)))

    def text(self, name: str) -> str:
        return str(self.page.inner_text(f"#{name}"))

    def at(self, **state: object) -> None:
        """Goes to an address that says what is on show."""
        query = "&".join(f"{key}={value}" for key, value in state.items())
        script = """(query) => new Promise((then) => {
            const before = location.hash;
            addEventListener('hashchange', () => then(), { once: true });  // after the page's own
            location.hash = query;
            if (location.hash === before) then(); })"""
        self.page.evaluate(script, query)
        self.settled()

    def pixel(self, x: int, y: int, place: tuple[float, float] = (0.5, 0.5), **state: object) -> torch.Tensor:
        """Bytes of the stage at a place of it, when pixel (x, y) of the image lies in its middle, 40 times as large."""
        self.at(zoom=40, x=x + 0.5, y=y + 0.5, **state)
        return self.spot(*place)


@pytest.fixture(scope="module")
def shared(browser: Any, file: Path) -> Iterator[Opened]:
    """One page for all tests; nothing may be asked of any network and nothing may go wrong."""
    page = browser.new_context(viewport={"width": 1280, "height": 900}, offline=True).new_page()
    wrong: list[str] = []
    ours = "Canvas2D: Multiple readback"  # advice for the tests, which read single pixels
    page.on("console", lambda message: message.text.startswith(ours) or wrong.append(message.text))
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.on("request", lambda request: asked.append(request.url))
    asked: list[str] = []
    yield Opened(page)
    assert wrong == []
    assert [url for url in asked if not url.startswith(("file:", "about:", "blob:", "data:"))] == []


@pytest.fixture
def opened(shared: Opened, file: Path) -> Opened:
    """The page as it opens: mobfgsr against the reference at the generated frame 4."""
    shared.page.goto("about:blank")
    shared.page.goto(file.as_uri())
    shared.settled()
    return shared


def data_of(file: Path) -> dict[str, Any]:
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', file.read_text(), re.S)
    assert found
    data: dict[str, Any] = json.loads(found[1])
    return data


def shown(clip: Clip, index: int, stops: float = 0.0) -> torch.Tensor:
    """Bytes of a frame of the clip, 3 h w."""
    color = clip[index].color
    assert color is not None
    return to_display(color[0] * 2.0**stops) * 255


EDGE = (19, 16)
"""A pixel that the disc covers at frame 4 (index 3) and not at frame 3, of which `hold` shows the image."""


def test_it_opens_with_the_best_method_against_the_reference(opened: Opened) -> None:
    assert [opened.page.input_value(f"#{name}") for name in ("a", "b", "metric", "region")] == [
        "mobfgsr",
        "reference",
        "psnr",
        "all",
    ]
    assert opened.text("where").startswith("frame 4 · generated")
    assert opened.page.is_checked("input[value=wipe]")


@pytest.mark.parametrize(("index", "stops"), [(0, 0), (3, 0), (3, 2), (6, -3)])
def test_the_stage_shows_each_pixel_as_it_is(opened: Opened, clip: Clip, index: int, stops: float) -> None:
    for x, y in (EDGE, (30, 12)):
        found = opened.pixel(x, y, a="reference", b="hold", frame=index, exposure=stops, wipe=0.9)
        assert (found - shown(clip, index, stops)[:, y, x]).abs().max() <= 1


def test_the_wipe_decides_which_image_is_where(opened: Opened, clip: Clip) -> None:
    x, y = EDGE
    truth, held = shown(clip, 3)[:, y, x], shown(clip, 2)[:, y, x]
    assert (truth - held).abs().min() > 20
    for wipe, expected in ((0.8, held), (0.2, truth)):
        found = opened.pixel(x, y, a="hold", b="reference", frame=3, wipe=wipe)
        assert (found - expected).abs().max() <= 1


def test_the_wipe_is_dragged_and_slid(opened: Opened) -> None:
    before, box = opened.stage(), opened.page.locator("#stage").bounding_box()
    mouse, middle = opened.page.mouse, box["y"] + 50
    opened.do(
        lambda page: (
            mouse.move(box["x"] + box["width"] / 2, middle),
            mouse.down(),
            mouse.move(box["x"] + box["width"] / 4, middle),
            mouse.up(),
        )
    )
    assert opened.page.input_value("#wipe") == "25"
    assert opened.stage() != before
    opened.slide("wipe", 50)
    opened.do(lambda page: mouse.move(0, 0))
    assert opened.stage() == before


def test_scrubber_and_keys_change_the_frame(opened: Opened) -> None:
    stages = [opened.stage()]
    for act in (
        lambda: opened.slide("scrubber", 0),
        lambda: opened.do(lambda page: page.focus("#stage")) or opened.key("ArrowRight"),
        lambda: opened.key("End"),
    ):
        act()
        stages.append(opened.stage())
    assert opened.text("where").startswith("frame 7 · shaded · 0.25 s")
    assert opened.page.input_value("#scrubber") == "6"
    assert len(set(stages)) == 4
    opened.key("Home", "ArrowRight", "ArrowRight", "ArrowRight")
    assert opened.stage() == stages[0]


def test_play_runs_through_the_frames_and_stops(opened: Opened) -> None:
    opened.page.click("#play")
    seen = set()
    for _ in range(200):
        seen.add(opened.page.input_value("#scrubber"))
        if len(seen) >= 5:
            break
        opened.page.wait_for_timeout(20)
    assert len(seen) >= 5
    assert opened.page.get_attribute("#play", "aria-label") == "Pause"
    assert opened.text("rate") == "24 frames a second"
    opened.page.keyboard.press("ArrowLeft")
    opened.settled()
    assert opened.page.get_attribute("#play", "aria-label") == "Play"


def test_difference_is_black_where_images_are_equal(opened: Opened, clip: Clip) -> None:
    black = [8, 8, 16]
    same = opened.pixel(30, 12, view="difference", a="hold", b="reference", frame=3)
    assert same.tolist() == black
    other = opened.pixel(*EDGE, view="difference", a="hold", b="reference", frame=3)
    louder = opened.pixel(*EDGE, view="difference", a="hold", b="reference", frame=3, gain=2)
    assert louder.mean() > other.mean() > 40
    assert opened.pixel(*EDGE, view="difference", a="hold", b="reference", frame=2).tolist() == black


def test_flip_shows_where_a_viewer_sees_the_error(opened: Opened, clip: Clip) -> None:
    truth, held = (shown(clip, i)[None] / 255 for i in (3, 2))
    heat = flip_map(held, truth)[0, 0]
    inside = heat[8:24, 16:32]
    places = [divmod(int(k), 16) for k in (inside.argmin(), inside.argmax())]
    found = [opened.pixel(x + 16, y + 8, view="flip", a="hold", b="reference", frame=3) for y, x in places]
    assert inside.max() > inside.min() + 0.1
    assert found[1].mean() > found[0].mean() + 10


def test_two_and_all_images_move_together(opened: Opened, clip: Clip) -> None:
    x, y = 24, 16
    for place, index in (((0.25, 0.5), 2), ((0.75, 0.5), 3)):
        found = opened.pixel(x, y, place, view="side", a="hold", b="reference", frame=3)
        assert (found - shown(clip, index)[:, y, x]).abs().max() <= 1
    opened.view("all")
    labels = opened.page.evaluate("document.getElementById('stage').width / document.getElementById('stage').height")
    assert labels > 1


def test_flicker_by_hand_shows_one_then_the_other(opened: Opened, clip: Clip) -> None:
    opened.pixel(*EDGE, a="hold", b="reference", frame=3)
    opened.do(lambda page: page.focus("#stage"))
    for expected in (2, 3, 2):
        opened.key("f")
        found = opened.spot(0.5, 0.5)
        assert (found - shown(clip, expected)[:, EDGE[1], EDGE[0]]).abs().max() <= 1


def test_the_slice_shows_one_row_of_every_frame(opened: Opened, clip: Clip) -> None:
    opened.at(view="slice", a="reference", b="hold", row=16, frame=0)
    box = opened.page.locator("#stage").bounding_box()
    width, height = box["width"], box["height"]
    left, strip = round(width * 0.42) + 6, height / 2
    places = [
        ((left + 40.5 / 48 * (width - left - 6)) / width, (6 + (i + 0.5) / 7 * (strip - 12)) / height) for i in range(7)
    ]
    for index, place in enumerate(places):
        assert (opened.spot(*place) - shown(clip, index)[:, 16, 40]).abs().max() <= 2
    opened.slide("row", 2)
    for index, place in enumerate(places):
        assert (opened.spot(*place) - shown(clip, index)[:, 2, 40]).abs().max() <= 2
    opened.do(lambda page: page.mouse.click(box["x"] + places[4][0] * width, box["y"] + places[4][1] * height))
    assert opened.text("where").startswith("frame 5")


def test_the_pointer_tells_the_values_of_a_pixel(opened: Opened, clip: Clip) -> None:
    opened.at(zoom=40, x=20, y=16, a="reference", b="hold", frame=3)
    box = opened.page.locator("#stage").bounding_box()
    opened.do(lambda page: page.mouse.move(box["x"] + box["width"] / 2 + 10, box["y"] + box["height"] / 2 + 10))
    color = clip[3].color
    assert color is not None
    told = re.search(r"x (\d+), y (\d+)\s*reference ([\d.]+)\s+([\d.]+)\s+([\d.]+)", opened.text("probe"))
    assert told
    assert told.groups()[:2] == ("20", "16")
    assert [float(v) for v in told.groups()[2:]] == pytest.approx(color[0, :, 16, 20].tolist(), rel=0.006)


def test_the_numbers_are_those_of_the_results(opened: Opened, file: Path) -> None:
    rows = [row for row in data_of(file)["rows"] if row["role"] == "generated"]
    table = opened.page.locator("table", has=opened.page.locator("caption", has_text="generated")).first
    head = table.locator("thead th").all_inner_texts()
    assert head[:7] == ["method", "PSNR", "SSIM", "FLIP", "WARPED", "FLICKER", "PSNR\ndisoccluded"]
    for line in table.locator("tbody tr").all():
        method, *cells = line.locator("th, td").all_inner_texts()
        for title, cell in zip(head[1:7], cells, strict=False):
            metric, region = [*title.lower().split("\n"), "all"][:2]
            (told,) = [r["value"] for r in rows if (r["method"], r["metric"], r["region"]) == (method, metric, region)]
            assert cell == f"{told:.{2 if metric == 'psnr' else 4}f}"


def test_curves_and_legend_follow_the_metric_and_the_frame(opened: Opened, file: Path) -> None:
    strips = {strip["name"]: strip["values"] for strip in data_of(file)["runs"][0]["methods"]}

    def legend() -> dict[str, str]:
        lines = [text.split("\n") for text in opened.page.locator("#legend button").all_inner_texts()]
        return dict(lines)

    assert legend() == {name: f"{values['psnr']['all'][3]:.2f}" for name, values in strips.items()}
    opened.do(lambda page: page.click("th button[data-metric=ssim]"))
    assert opened.page.input_value("#metric") == "ssim"
    assert legend() == {name: f"{values['ssim']['all'][3]:.4f}" for name, values in strips.items()}
    opened.do(lambda page: page.locator("#curves circle").last.click())
    assert opened.text("where").startswith("frame 6 · generated")
    assert legend()["hold"] == f"{strips['hold']['ssim']['all'][5]:.4f}"
    assert opened.page.locator("#scatter .name").all_text_contents() == list(strips)


def test_the_address_brings_back_what_was_on_show(opened: Opened) -> None:
    opened.show("blend", "hold")
    opened.view("difference")
    opened.slide("gain", 3)
    opened.page.wait_for_timeout(500)
    stage = opened.stage()
    opened.page.reload()
    opened.settled()
    assert opened.page.input_value("#a") == "blend"
    assert opened.stage() == stage
    opened.at(a="nobody", frame=99, view="nothing", zoom="x")
    assert opened.text("where").startswith("frame 4")


def test_clips_take_turns(opened: Opened, clip: Clip, tmp_path: Path, file: Path) -> None:
    other = write_disc_clip(tmp_path / "other", 5)
    rows = evaluate([clip, other], ["hold"], "interpolate", Settings(metrics=("psnr",)))
    page = tmp_path / "two.html"
    page.write_text(report(rows, {"disc": clip, "other": other}))
    opened.page.goto(page.as_uri())
    opened.settled()
    before = opened.stage()
    assert (opened.page.get_attribute("#scrubber", "max"), opened.text("where")[:7]) == ("6", "frame 4")
    opened.do(lambda page: page.select_option("#run", "1"))
    assert (opened.page.get_attribute("#scrubber", "max"), opened.text("where")[:7]) == ("4", "frame 4")
    opened.key("Home")
    assert opened.stage() != before


def test_every_control_has_a_name_and_the_stage_says_what_it_shows(opened: Opened) -> None:
    nameless = opened.page.evaluate(
        """() => [...document.querySelectorAll('button, input, select, [role=img], [role=region]')].filter((e) =>
            !(e.getAttribute('aria-label') || e.innerText || [...(e.labels ?? [])].some((l) => l.textContent.trim())))
            .map((e) => e.outerHTML)"""
    )
    assert nameless == []
    said = opened.page.get_attribute("#stage", "aria-label")
    assert re.fullmatch(r"Wipe of mobfgsr \(PSNR [\d.]+\) and reference, frame 4 of 7, generated", said)
    opened.page.keyboard.press("?")
    assert opened.page.is_visible("#help")


@pytest.mark.parametrize("width", [390, 1280])
def test_nothing_runs_off_the_side(browser: Any, file: Path, width: int) -> None:
    page = browser.new_page(viewport={"width": width, "height": 800}, color_scheme="dark")
    page.goto(file.as_uri())
    Opened(page).settled()
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    light = "getComputedStyle(document.body).backgroundColor.match(/\\d+/g).reduce((a, b) => a + Number(b), 0)"
    assert page.evaluate(light) < 150
    page.click("#theme")
    assert page.evaluate(light) > 600
    page.close()
