"""The scoreboard as pages: tables of everything measured, and the short one of the README."""

import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from framecast.bench import Row as Timing
from framecast.provenance import About
from framecast.results import MEAN, Role, Row, shown, with_means

MARKERS = ("<!-- scoreboard: made by benchmarks/scoreboard.py -->", "<!-- end of scoreboard -->")

METRICS = ("psnr", "ssim", "flip", "flip-hdr", "lpips", "cvvdp", "warped", "flicker")
REGIONS = ("disoccluded", "shading", "thin", "border", "static")
SHORT = {"interpolate": "between frames", "extrapolate": "ahead of the last", "larger": "twice the size"}
"""Parts that the README shows, and the heads of their columns."""


@dataclass(frozen=True)
class Board:
    """Everything measured, by part."""

    titles: Mapping[str, str]
    rows: Mapping[str, Sequence[Row]]
    times: Mapping[str, Sequence[Timing]]
    about: Mapping[str, About | None]


HEAD = """# Scoreboard

Every method that ships, in every mode that it has, on the scenes that no method is trained on. Made by
`python benchmarks/scoreboard.py`; how numbers are made: [evaluation](../evaluation.md). The best of a column is bold.
Times and memory are of one frame on one CPU core, eager. What papers claim of these methods: [claims](claims.md).
"""


def scoreboard(board: Board) -> str:
    """The page of all numbers."""
    known = next((about.machine for about in board.about.values() if about), {})
    facts = {name: value for name, value in known.items() if name != "load"}
    lines = [HEAD, "Measured with " + ", ".join(f"{name} {value}" for name, value in facts.items()) + "."]
    for part, rows in board.rows.items():
        lines += ["", f"## {board.titles[part]}", "", *clips(board.about.get(part)), ""]
        for role in roles(rows):
            mean = [row for row in with_means(rows) if row.role == role]
            many = len({row.clip for row in rows}) > 1
            every = [row for row in mean if row.clip == (MEAN if many else rows[0].clip)]
            of = "generated frames" if role == "generated" else "shaded frames"
            lines += [f"Mean over the scenes, {of}:", "", *numbers(every, board.times.get(part, ()), role), ""]
            lines += [f"PSNR by region, {of}:", "", *by_region(every), ""]
            if many:
                lines += [f"PSNR by scene, {of}:", "", *by_scene(mean), ""]
    return "\n".join(lines).rstrip() + "\n"


def clips(about: About | None) -> list[str]:
    """One line that says what was measured on."""
    if about is None:
        return []
    sizes = dict.fromkeys(f"{c.size[1]}x{c.size[0]}, {c.frames} frames" for c in about.clips.values())
    return [f"{', '.join(about.clips)}: {' and '.join(sizes)}."]


def roles(rows: Sequence[Row]) -> list[Role]:
    """The roles in which methods make something of their own: without enlarging, shaded frames only where all are."""
    changed = rows[0].mode == "pass" or rows[0].scale != 1
    generated = any(row.role == "generated" for row in rows)
    return [role for role, there in (("generated", generated), ("shaded", changed)) if there]  # type: ignore[misc]


def numbers(rows: Sequence[Row], times: Sequence[Timing], role: Role) -> list[str]:
    """A line for each method: metrics of all pixels, milliseconds, memory."""
    metrics = [metric for metric in METRICS if any(row.metric == metric and row.region == "all" for row in rows)]
    cells = [column({r.method: r.value for r in rows if (r.metric, r.region) == (m, "all")}, m) for m in metrics]
    mode = rows[0].mode
    wanted = "shaded" if role == "shaded" or mode == "pass" else mode
    spent = {time.method: time for time in times if time.role == wanted}
    cells += [{name: f"{time.median:.1f}" for name, time in spent.items()}]
    cells += [{name: f"{time.memory:.0f}" for name, time in spent.items()}]
    return table(rows, [*(metric.upper() for metric in metrics), "ms", "MB"], cells)


def by_region(rows: Sequence[Row]) -> list[str]:
    """A line for each method, PSNR in each region."""
    there = [region for region in REGIONS if any(row.region == region for row in rows)]
    found = [{r.method: r.value for r in rows if (r.metric, r.region) == ("psnr", one)} for one in there]
    return table(rows, there, [column(values, "psnr") for values in found])


def by_scene(rows: Sequence[Row]) -> list[str]:
    """A line for each method, PSNR on each clip."""
    scenes = [clip for clip in dict.fromkeys(row.clip for row in rows) if clip != MEAN]
    some = [row for row in rows if (row.metric, row.region) == ("psnr", "all")]
    found = [{row.method: row.value for row in some if row.clip == scene} for scene in scenes]
    return table(rows, scenes, [column(values, "psnr") for values in found])


def column(values: Mapping[str, float], metric: str) -> dict[str, str]:
    """Cells of a column by method, the best bold."""
    return {name: f"**{text}**" if best else text for name, (text, best) in shown(values, metric).items()}


def table(rows: Sequence[Row], heads: Sequence[str], cells: Sequence[Mapping[str, str]]) -> list[str]:
    """Lines of a markdown table, a line for each method."""
    lines = [f"| method | {' | '.join(heads)} |", "|---" + "|--:" * len(heads) + "|"]
    for name in dict.fromkeys(row.method for row in rows):
        lines.append(f"| `{name}` | {' | '.join(cell.get(name, '') for cell in cells)} |")
    return lines


def summary(board: Board) -> str:
    """The short table: PSNR and time of each method in the parts that most people ask for."""
    parts = [part for part in SHORT if part in board.rows]
    found: dict[str, list[dict[str, str]]] = {}
    for part in parts:
        role = "shaded" if part == "larger" else "generated"
        some = [r for r in board.rows[part] if (r.role, r.region, r.metric) == (role, "all", "psnr")]
        values = {
            name: statistics.fmean(r.value for r in some if r.method == name)
            for name in dict.fromkeys(r.method for r in some)
        }
        wanted = "shaded" if part == "larger" else part
        times = {t.method: f"{t.median:.0f}" for t in board.times.get(part, ()) if t.role == wanted}
        found[part] = [column(values, "psnr"), times]
    names = dict.fromkeys(row.method for part in parts for row in board.rows[part])
    heads = " | ".join(f"{SHORT[part]} | ms" for part in parts)
    lines = ["PSNR in dB on held-out scenes and time on one CPU core ([all numbers](docs/results/README.md),"]
    lines += [
        "[what papers claim](docs/results/claims.md)):",
        "",
        f"| method | {heads} |",
        "|---" + "|--:" * 2 * len(parts) + "|",
    ]
    for name in names:
        cells = " | ".join(cell.get(name, "") for part in parts for cell in found[part])
        lines.append(f"| `{name}` | {cells} |")
    return "\n".join(lines)


def replaced(readme: str, text: str) -> str:
    """A page with the text between its markers. Raises ValueError where it has none."""
    start, end = (readme.find(marker) for marker in MARKERS)
    if start < 0 or end < start:
        raise ValueError(f"README.md lacks the markers of the table: add the lines {MARKERS[0]} and {MARKERS[1]}")
    return f"{readme[: start + len(MARKERS[0])]}\n{text}\n{readme[end:]}"
