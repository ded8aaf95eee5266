"""The page of a report, filled: `page.html` with its style, scripts, tables, facts and packed images, as one text.

The tables are plain HTML, so that they are read without scripts; everything that moves is in the scripts.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from html import escape
from pathlib import Path
from string import Template
from typing import Any

from framecast import packing
from framecast.metrics import METRICS
from framecast.provenance import About
from framecast.results import DIGITS, Mode, Role, Row, columns, groups, heading, is_higher_better, shown

FOLDER = Path(__file__).parent
SCRIPTS = ("images.js", "view.js", "charts.js", "page.js")


@dataclass(frozen=True)
class Strip:
    """What one method made of the frames on the page."""

    name: str
    images: Sequence[str | None]
    """Ids of packed images, one for each frame."""
    flip: Sequence[str | None]
    """Ids of FLIP maps against the reference, 0..255; None where a frame is not compared."""
    values: Mapping[str, Mapping[str, Sequence[float | None]]]
    """By metric, region and frame; None where it has no value."""


@dataclass(frozen=True)
class Run:
    """Methods on one clip in one mode and size: one choice on the page."""

    title: str
    clip: str
    mode: Mode
    scale: float
    role: Role
    """Of the frames that the comparison is about."""
    fps: float
    size: tuple[int, int]
    """Height and width of the images here."""
    window: tuple[int, int]
    """Left and top of them in the whole image."""
    frames: Sequence[Mapping[str, Any]]
    """`number` and `role` of each."""
    reference: Sequence[str | None] | None
    methods: Sequence[Strip]
    best: str
    """Name of the method that a reader sees first."""


@dataclass(frozen=True)
class Content:
    """Everything on the page."""

    runs: Sequence[Run]
    images: Mapping[str, tuple[str, str]]
    """Size ("width height planes") and packed text by id."""
    rows: Sequence[Row]
    about: About | None
    facts: Mapping[str, str] = field(default_factory=dict)
    """What else there is to say on how the page was made, by what it is about."""
    notes: Sequence[str] = ()
    """What a reader has to know before anything else, one sentence each."""


def page(content: Content) -> str:
    """The whole page."""
    title = heading_of(content.runs)
    return Template((FOLDER / "page.html").read_text()).substitute(
        title=escape(f"{title} · framecast"),
        heading=escape(title),
        lead=escape(lead(content)),
        notes="\n".join(f'<p class="warning">{escape(note)}</p>' for note in content.notes),
        css=(FOLDER / "page.css").read_text(),
        js="\n".join((FOLDER / name).read_text() for name in SCRIPTS),
        tables="\n".join(table(name, group) for name, group in tables(content)),
        about=facts(content),
        data=json.dumps(data(content), separators=(",", ":")).replace("<", "\\u003c"),
        images="\n".join(
            f'<script type="text/plain" id="{name}" data-size="{size}">{text}</script>'
            for name, (size, text) in content.images.items()
        ),
    )


def data(content: Content) -> dict[str, Any]:
    """What the scripts read."""
    metrics = {name: {"higher": is_higher_better(name), "digits": DIGITS.get(name, 4)} for name in METRICS}
    coding = {"steps": packing.STEPS, "floor": packing.FLOOR, "brightest": packing.BRIGHTEST}
    rows = [asdict(row) for row in content.rows]
    return {"runs": [asdict(run) for run in content.runs], "rows": rows, "metrics": metrics, "coding": coding}


def heading_of(runs: Sequence[Run]) -> str:
    """What the page is about, in a few words."""
    clips = list(dict.fromkeys(run.clip for run in runs))
    modes = ", ".join(dict.fromkeys(MODES[run.mode] for run in runs))
    return f"{clips[0] if len(clips) == 1 else f'{len(clips)} clips'}: {modes}"


MODES: dict[Mode, str] = {
    "interpolate": "frames between frames",
    "extrapolate": "frames ahead of the last",
    "mixed": "frames ahead and between",
    "pass": "every frame improved",
}
"""What is done, for people who have not read the documentation."""


def lead(content: Content) -> str:
    """The result in one sentence: which method comes closest, and by how much."""
    run = content.runs[0]
    metric = next((row.metric for row in content.rows if row.metric in METRICS), "")
    values = {
        row.method: row.value
        for row in content.rows
        if (row.clip, row.mode, row.scale, row.role) == (run.clip, run.mode, run.scale, run.role)
        and (row.metric, row.region) == (metric, "all")
    }
    what = "the hidden frames" if run.role == "generated" else "the references"
    if len(values) < 2:
        return f"{', '.join(strip.name for strip in run.methods)} against {what} of {run.clip}."
    first, second = sorted(values, key=lambda name: values[name], reverse=is_higher_better(metric))[:2]
    texts = {name: text for name, (text, _) in shown(values, metric).items()}
    unit = " dB" if metric == "psnr" else ""
    return (
        f"{first} comes closest to {what} of {run.clip}: {metric.upper()} {texts[first]}{unit}; "
        f"next is {second} with {texts[second]}{unit}."
    )


def tables(content: Content) -> list[tuple[str, list[Row]]]:
    """Titles and rows of the tables, those of generated frames first."""
    return sorted(groups(content.rows).items(), key=lambda item: item[1][0].role != "generated")


def table(title: str, rows: Sequence[Row]) -> str:
    """A table of numbers, a line for each method, the best of each column in bold."""
    cells, head = [], ['<th scope="col">method</th>']
    for region, metric in columns(rows):
        values = {row.method: row.value for row in rows if (row.region, row.metric) == (region, metric)}
        cells.append(shown(values, metric))
        text = escape(heading(region, metric))
        if metric in METRICS:
            text = f'<button type="button" data-metric="{metric}" data-region="{escape(region)}">{text}</button>'
        head.append(f'<th scope="col">{text}</th>')
    lines = []
    for method in dict.fromkeys(row.method for row in rows):
        texts = [cell.get(method, ("", False)) for cell in cells]
        values_here = "".join(f"<td>{f'<strong>{text}</strong>' if best else text}</td>" for text, best in texts)
        lines.append(f'<tr><th scope="row">{escape(method)}</th>{values_here}</tr>')
    return (
        f'<div class="wide" role="region" tabindex="0" aria-label="{escape(title)}"><table>'
        f"<caption>{escape(title)}</caption><thead><tr>{''.join(head)}</tr></thead>"
        f"<tbody>{''.join(lines)}</tbody></table></div>"
    )


def facts(content: Content) -> str:
    """Clips, methods, settings, versions and hashes."""
    about = content.about
    parts = [listed("This page", content.facts)]
    if about is not None:
        clips = {
            label: f"{one.frames} frames of {one.size[1]}x{one.size[0]}, {one.fps:g} a second, SHA-256 {one.sha256}"
            for label, one in about.clips.items()
        }
        parts.append(listed("Clips", clips))
        parts.append(listed("Methods", {name: said(config) for name, config in about.methods.items()}))
        parts.append(listed("Settings", {name: said(value) for name, value in about.settings.items()}))
        parts.append(listed("Versions and machine", {name: said(value) for name, value in about.machine.items()}))
    return "\n".join(parts)


def listed(title: str, entries: Mapping[str, str]) -> str:
    """Names and texts that fold away."""
    if not entries:
        return ""
    body = "".join(f"<dt>{escape(name)}</dt><dd>{escape(text)}</dd>" for name, text in entries.items())
    return f"<details open><summary>{escape(title)}</summary><dl>{body}</dl></details>"


def said(value: Any) -> str:
    """A value of JSON for people."""
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {said(one)}" for key, one in value.items()) or "nothing to set"
    if isinstance(value, list | tuple):
        return ", ".join(said(one) for one in value)
    names = {None: "not given", True: "yes", False: "no"}
    return names[value] if value is None or isinstance(value, bool) else str(value)
