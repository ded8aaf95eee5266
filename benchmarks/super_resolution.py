"""Super-resolution in numbers: quality on clips with references, laws of known pictures, speed; as a markdown page.

    python benchmarks/super_resolution.py quality CLIP... [--native FOLDER]
    python benchmarks/super_resolution.py laws CLIP...
    python benchmarks/super_resolution.py speed [--sizes 640x360*2] [--threads 2]

Each writes its part of docs/results/super-resolution.md and leaves the others as they are.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import super_resolution_laws as laws_of
import super_resolution_speed as speed_of
import tyro
from quality import TITLES, table

from framecast import __version__, exr
from framecast.clip import open_clip
from framecast.evaluate import Settings, evaluate_clip, labels
from framecast.results import Row, read_results, with_means, write_results

PAGE = Path("docs/results/super-resolution.md")
ROWS = PAGE.with_suffix(".json")
SINGLE = ("bilinear", "lanczos")
TEMPORAL = ("taau", "fsr2", "nsrr", "mnss", "mobfgsr")
METRICS = ("psnr", "ssim", "flip", "warped")
TITLE = "# Super-resolution"
HOW = (
    "PSNR / SSIM / FLIP / warped against references of twice the size, the best in bold. warped is how much more or",
    "less an image changes along true motion than the truth does: what flickers by itself. Metrics and regions:",
    "[evaluation](../evaluation.md). Clips:",
    "",
)


def quality(
    clips: tyro.conf.Positional[tuple[Path, ...]],
    native: Path | None = None,
    methods: str = ",".join((*SINGLE, *TEMPORAL)),
    json: Path = ROWS,
    page: Path = PAGE,
) -> None:
    """Every method on clips with references twice as large as their frames.

    Args:
        clips: clips that no network and no constant was trained or chosen on.
        native: folder of the same clips (by name) rendered at the size of the references, for `taa`.
        methods: names separated by commas.
        json: file for the rows; those that it holds are not measured again.
        page: the markdown page.
    """
    opened = [open_clip(path) for path in clips]
    rows = read_results(json) if json.is_file() else []
    settings = Settings((*METRICS, "flicker"), scale=2.0)
    for clip, label in zip(opened, labels(opened), strict=True):
        wanted = [(name, name, "pass") for name in methods.split(",")]
        if "mobfgsr" in methods.split(","):
            wanted += [("mobfgsr", f"mobfgsr, {mode}d", mode) for mode in ("interpolate", "extrapolate")]
        if native is not None:
            wanted.append(("taa", "taa at native size", "pass"))
        for name, called, mode in wanted:
            if any((row.method, row.clip) == (called, label) for row in rows):
                continue
            seen, how = clip, settings
            if name == "taa" and native is not None:  # at display size, against references of that size
                seen, how = replace(open_clip(native / label), scale=1.0), replace(settings, scale=1.0)
            found = evaluate_clip(seen, label, name, mode, how)  # type: ignore[arg-type]
            role = "shaded" if mode == "pass" else "generated"
            rows += [replace(row, method=called) for row in found if row.role == role]
            write_results(json, rows)
            print(f"{called} on {label}: done", flush=True)
    sizes = [
        f"- {label}: {c.size[1]}x{c.size[0]}, {len(c)} frames" for label, c in zip(labels(opened), opened, strict=True)
    ]
    write(
        page,
        "Quality",
        [
            *HOW,
            *sizes,
            *parts(rows),
        ],
    )


def parts(rows: Sequence[Row]) -> list[str]:
    """Tables of all pixels and of disoccluded ones, and of the step between generated frames and shaded ones."""
    several = with_means(rows) if len({row.clip for row in rows}) > 1 else list(rows)
    lines: list[str] = []
    for region, metrics in (("all", METRICS), ("disoccluded", METRICS[:3])):  # what is new has no past to change from
        part = [row for row in several if row.region == region]
        lines += ["", f"### {TITLES[region].capitalize()}", "", *table(part, metrics)]
    step = [row for row in several if (row.metric, row.region) == ("flicker", "all")]
    return [*lines, "", "### Flicker: from a generated frame to the same one shaded", "", *table(step, ("flicker",))]


def laws(clips: tyro.conf.Positional[tuple[Path, ...]], page: Path = PAGE) -> None:
    """Known pictures: a still one, a wire in motion, and repeated moves of the clips' references.

    Args:
        clips: clips with references.
        page: the markdown page.
    """
    lines = ["A still picture, error (root mean square, as displayed) after some frames, and the most by which any"]
    lines += ["pixel changes over a whole period of the jitter after the 64th:", ""]
    lines += laws_of.still(("taa", *TEMPORAL))
    lines += [
        "",
        f"A dark wire, three quarters of a display pixel thick, moves by {laws_of.SPEED} pixels a frame. Its contrast",
    ]
    lines += ["as displayed, 0.55 where it is wholly seen:", "", *laws_of.thin((*SINGLE, *TEMPORAL))]
    lines += [
        "",
        "References moved eight times by half a pixel, there and back:",
        "",
        *laws_of.moves([open_clip(p) for p in clips]),
    ]
    write(page, "Laws", lines)


def speed(
    sizes: str = "640x360*2",
    methods: str = ",".join((*SINGLE, *TEMPORAL)),
    repeats: int = 20,
    threads: int = 2,
    compiled: bool = True,
    page: Path = PAGE,
) -> None:
    """Milliseconds of one more image, beside OpenCV's resize, and memory.

    Args:
        sizes: width x height * scale, separated by commas.
        methods: names separated by commas.
        repeats: images that each method makes.
        threads: CPU threads.
        compiled: compiled methods, too.
        page: the markdown page.
    """
    lines = speed_of.compared(sizes, methods.split(","), repeats, threads, compiled)
    if compiled:
        width, height = (int(side) for side in sizes.split("*")[0].split("x"))
        lines += [
            "",
            f"### One read of a {width}x{height} image, compiled",
            "",
            *speed_of.reads((height, width), repeats),
        ]
    write(page, "Speed", lines)


def write(page: Path, title: str, lines: Sequence[str]) -> None:
    """One part of the page, the others as they are."""
    text = page.read_text() if page.is_file() else TITLE
    head, *found = text.split("\n## ")
    parts = {part.partition("\n")[0]: part.partition("\n")[2].strip() for part in found}
    parts[title] = "\n".join([f"framecast {__version__}.", "", *lines])
    with exr.whole(page) as temporary:
        temporary.write_text("\n\n## ".join([head.strip(), *(f"{t}\n\n{body}" for t, body in parts.items())]) + "\n")
    print(f"{page}: {title}")


if __name__ == "__main__":
    tyro.extras.subcommand_cli_from_dict({"quality": quality, "laws": laws, "speed": speed})
