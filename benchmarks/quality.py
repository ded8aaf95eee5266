"""Quality of generated frames: every method on clips at full rate, as a markdown page.

    python benchmarks/quality.py CLIP... -o docs/results/frame-generation.md --json docs/results/frame-generation.json

Clips are clips or folders of rendered EXR files. `docs/evaluation.md` says how the numbers are made.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import tyro

from framecast import __version__, exr
from framecast.evaluate import Settings, labels
from framecast.evaluate import jobs as evaluation
from framecast.fit import fitting
from framecast.importers import open_any
from framecast.metrics import METRICS
from framecast.results import MEAN, Mode, Row, shown, with_means, write_results


def main(
    clips: tyro.conf.Positional[tuple[Path, ...]],
    output: Annotated[Path, tyro.conf.arg(aliases=("-o",))],
    methods: str = "",
    modes: tuple[Mode, ...] = ("interpolate", "extrapolate"),
    metrics: tuple[str, ...] = ("psnr", "ssim", "flip"),
    regions: tuple[str, ...] = ("all", "disoccluded"),
    json: Path | None = None,
    device: str = "cpu",
) -> None:
    """Evaluate methods on clips and write the tables.

    Args:
        clips: clips, or folders of rendered EXR files, at full rate.
        output: the markdown page.
        methods: names separated by commas; by default every one that fits the clips.
        modes: interpolate, extrapolate, mixed.
        metrics: psnr, ssim, flip, flip-hdr, warped, flicker, lpips.
        regions: all, disoccluded, shading, thin, border, static.
        json: file for the rows.
        device: cpu, cuda, mps.
    """
    opened = [open_any(path) for path in clips]
    rows: list[Row] = []
    for mode in modes:
        names = methods.split(",") if methods else fitting(opened, mode)
        for found in evaluation(opened, names, mode, Settings(metrics, device)):
            rows += found
            print(f"{found[0].method} on {found[0].clip}, {mode}: done", flush=True)
    sizes = {name: f"{c.size[1]}x{c.size[0]}, {len(c)} frames" for name, c in zip(labels(opened), opened, strict=True)}
    with exr.whole(output) as temporary:
        temporary.write_text(page(rows, sizes, metrics, regions))
    if json is not None:
        write_results(json, rows)
    print(f"{output}: {len(rows)} rows")


TITLES = {
    "all": "all pixels",
    "disoccluded": "disoccluded pixels",
    "shading": "moving shading",
    "thin": "thin things",
    "border": "along the border",
    "static": "static pixels",
}


def page(
    rows: Sequence[Row], clips: dict[str, str], metrics: Sequence[str], regions: Sequence[str] = ("all", "disoccluded")
) -> str:
    """The markdown page: for each mode a table of each region and one of times."""
    names = " / ".join(metric.upper() for metric in metrics)
    lines = ["# Quality of generated frames", ""]
    lines += [f"framecast {__version__}. Every second frame hidden, generated, compared with what was hidden: {names}"]
    lines += ["(the best in bold). How: [evaluation](../evaluation.md). Clips:", ""]
    lines += [f"- {name}: {about}" for name, about in clips.items()]
    several = with_means(rows) if len(clips) > 1 else list(rows)
    generated = [row for row in several if row.role == "generated"]
    for mode in dict.fromkeys(row.mode for row in rows):
        here = [row for row in generated if row.mode == mode]
        for region in regions:
            part = [row for row in here if row.region == region]
            lines += ["", f"## {mode.capitalize()}: {TITLES[region]}", "", *table(part, metrics)]
        lines += ["", f"## {mode.capitalize()}: milliseconds a frame", "", *table(here, ("milliseconds",))]
    return "\n".join(lines) + "\n"


def table(rows: Sequence[Row], metrics: Sequence[str]) -> list[str]:
    """Lines of a table: methods down, clips across, the metrics of a cell beside each other."""
    clips = sorted(dict.fromkeys(row.clip for row in rows), key=lambda clip: clip == MEAN)
    cells = {}
    for clip in clips:
        for metric in metrics:
            values = {row.method: row.value for row in rows if (row.clip, row.metric) == (clip, metric)}
            cells[clip, metric] = shown(values, metric) if metric in METRICS else plain(values)
    lines = [f"| method | {' | '.join(clips)} |", "|---" * (len(clips) + 1) + "|"]
    for method in dict.fromkeys(row.method for row in rows):
        texts = [[cells[clip, metric].get(method, ("", False)) for metric in metrics] for clip in clips]
        joined = (" / ".join(f"**{t}**" if best else t for t, best in cell) for cell in texts)
        lines.append(f"| {method} | {' | '.join(joined)} |")
    return lines


def plain(values: dict[str, float]) -> dict[str, tuple[str, bool]]:
    """Times, without a best one: the baselines that do least are fastest."""
    return {method: (text, False) for method, (text, _) in shown(values, "milliseconds").items()}


if __name__ == "__main__":
    tyro.cli(main)
