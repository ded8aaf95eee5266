"""What evaluation found: rows of numbers, their files, and tables of them."""

import csv
import json
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Literal, get_args

from rich import box
from rich.console import Console
from rich.table import Table

from framecast import exr
from framecast.metrics import METRICS
from framecast.provenance import About, read_about

VERSION = 2
"""Of the results file."""

MEAN = "mean"
"""Name under which `with_means` gives the mean over clips."""

Mode = Literal["interpolate", "extrapolate", "mixed", "pass"]
Role = Literal["shaded", "generated"]
ROLES: tuple[Role, ...] = get_args(Role)

DIGITS = {"psnr": 2, "cvvdp": 3, "milliseconds": 1}
"""Decimals shown; 4 for every other metric."""

TIME = "milliseconds"
"""Name of the metric that is the median time of the method for one frame."""


@dataclass(frozen=True)
class Row:
    """One number: the mean over the frames of a clip that a method was seen in."""

    method: str
    clip: str
    mode: Mode
    role: Role
    region: str
    """"all", or a part of the pixels by the names that `regions.regions` gives."""
    metric: str
    """A name of `metrics.METRICS`, "cvvdp", or TIME."""
    value: float
    scale: float = 1.0
    """Size of the images divided by the size of the frames."""


def write_results(path: Path | str, rows: Sequence[Row], about: About | None = None) -> None:
    """Rows as JSON with what they were made from, the whole file or nothing."""
    held = {"version": VERSION, "rows": [asdict(row) for row in rows], **({"about": asdict(about)} if about else {})}
    with exr.whole(Path(path)) as temporary:
        temporary.write_text(json.dumps(held, indent=1) + "\n")


def write_csv(path: Path | str, rows: Sequence[Row]) -> None:
    """Rows as a table of text with a line of names, the whole file or nothing."""
    with exr.whole(Path(path)) as temporary, temporary.open("w", newline="") as file:
        writer = csv.DictWriter(file, [one.name for one in fields(Row)])
        writer.writeheader()
        writer.writerows(asdict(row) for row in rows)


def read_results(path: Path | str) -> list[Row]:
    """The rows of a file that `write_results` made.

    Raises:
        FileNotFoundError: no such file. ValueError: not a results file, or one of another version.
    """
    return _read(Path(path))[0]


def read_provenance(path: Path | str) -> About | None:
    """What the rows of a file were made from; None where it does not say. Raises as `read_results` does."""
    return _read(Path(path))[1]


def _read(path: Path) -> tuple[list[Row], About | None]:
    advice = f"make one with: framecast evaluate CLIP --json {path}"
    if not path.is_file():
        raise FileNotFoundError(f"{path} is no file; {advice}")
    try:
        held = json.loads(path.read_text())
        if held["version"] == VERSION:
            about = held.get("about")
            return [Row(**row) for row in held["rows"]], read_about(about) if about else None
    except (json.JSONDecodeError, AttributeError, KeyError, TypeError, UnicodeDecodeError) as error:
        raise ValueError(f"{path} is no results file ({type(error).__name__}: {error}); {advice}") from error
    raise ValueError(f"{path} has version {held['version']}; this framecast reads version {VERSION}: {advice}")


def with_means(rows: Sequence[Row]) -> list[Row]:
    """The rows, then for each method and number the mean over its clips, under the clip name MEAN."""
    found: dict[Row, list[float]] = {}
    for row in rows:
        found.setdefault(replace(row, clip=MEAN, value=0.0), []).append(row.value)
    return [*rows, *(replace(row, value=statistics.fmean(values)) for row, values in found.items())]


def shown(values: Mapping[str, float], metric: str) -> dict[str, tuple[str, bool]]:
    """Each method's value as text, and whether it is the best as shown (none is where all are equal)."""
    digits, higher = DIGITS.get(metric, 4), is_higher_better(metric)
    texts = {method: f"{value:.{digits}f}" for method, value in values.items()}
    best = (max if higher else min)(texts.values(), key=float, default="")
    return {method: (text, text == best and len(set(texts.values())) > 1) for method, text in texts.items()}


def is_higher_better(metric: str) -> bool:
    """Whether larger values are better; those of time are not."""
    return metric == "cvvdp" or (metric in METRICS and METRICS[metric].higher_is_better)


def heading(region: str, metric: str) -> str:
    """Title of a column: the metric, and the region where it is not all pixels."""
    name = "ms" if metric == TIME else metric.upper()
    return name if region == "all" else f"{name}\n{region}"


def columns(rows: Sequence[Row]) -> list[tuple[str, str]]:
    """(region, metric) of the rows, metrics of all pixels first, then the first metric of each region, times last."""
    first = next((row.metric for row in rows if row.metric in METRICS), "")
    found = dict.fromkeys((row.region, row.metric) for row in rows if row.region == "all" or row.metric == first)
    return sorted(found, key=lambda key: (key[1] == TIME, key[0] != "all"))


def tables(rows: Sequence[Row], width: int | None = None) -> dict[str, Table]:
    """Tables by title, one for each mode, role and clip, and for the mean of several clips.

    A line for each method, or where that is wider than `width` characters for each metric; the best in bold. Shaded
    frames have a table only where a method changed them.
    """
    return {title: _table(group, width) for title, group in groups(rows).items()}


def groups(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """The rows of each table by its title."""
    several = len({row.clip for row in rows}) > 1
    found: dict[tuple[str, Role, str, float], list[Row]] = {}
    for row in with_means(rows) if several else rows:
        found.setdefault((row.mode, row.role, row.clip, row.scale), []).append(row)
    return {
        f"{clip}: {role} frames, {mode}" + (f", {scale:g} times the size" if scale != 1 else ""): group
        for (mode, role, clip, scale), group in found.items()
        if role == "generated" or not _untouched(group)
    }


def _untouched(rows: Sequence[Row]) -> bool:
    """Whether no method made something of its own: values that compare images with the truth are perfect, or the same
    for several methods."""
    found: dict[tuple[str, str], dict[str, float]] = {}
    for row in rows:
        if row.metric in METRICS and METRICS[row.metric].compares in ("display", "linear"):
            found.setdefault((row.region, row.metric), {})[row.method] = row.value
    return all(
        len(set(values.values())) == 1 and (len(values) > 1 or METRICS[metric].perfect in values.values())
        for (_, metric), values in found.items()
    )


def _table(rows: Sequence[Row], width: int | None) -> Table:
    methods = list(dict.fromkeys(row.method for row in rows))
    lines = [["method", *methods]]
    for region, metric in columns(rows):
        values = {row.method: row.value for row in rows if (row.region, row.metric) == (region, metric)}
        cells = shown(values, metric)
        texts = [cells.get(method, ("", False)) for method in methods]
        lines.append([heading(region, metric), *(f"[bold]{text}[/bold]" if best else text for text, best in texts)])
    table = _laid_out(list(zip(*lines, strict=True)))
    too_wide = width is not None and Console(width=10_000).measure(table).maximum > width
    return _laid_out([[text.replace("\n", " ") for text in line] for line in lines]) if too_wide else table


def _laid_out(lines: Sequence[Sequence[str]]) -> Table:
    """The first line are headings, and the first of each line says what it is."""
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for k, text in enumerate(lines[0]):
        table.add_column(text, justify="right" if k else "left", overflow="fold")
    for line in lines[1:]:
        table.add_row(*line)
    return table
