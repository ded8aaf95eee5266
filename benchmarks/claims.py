"""What five papers claim of the methods here, what they measured, and what is measured on our scenes.

A claim is that one method is ahead of another by some margin; it holds where ours is ahead too. The margins of papers
are means over the scenes of the table that is named. Claims whose methods do not ship are listed as not yet measured.
"""

import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from framecast.bench import Row as Timing
from framecast.results import Role, Row, is_higher_better

Rows = Mapping[str, Sequence[Row]]
Times = Mapping[str, Sequence[Timing]]

CLOSE = 1.0
"""Decibels up to which results count as close to each other, where a paper says no more than that."""

PARTS: dict[str, tuple[str, Role]] = {
    "I": ("interpolate", "generated"),
    "E": ("extrapolate", "generated"),
    "SR": ("larger", "shaded"),
    "ISR": ("larger-interpolate", "generated"),
    "ESR": ("larger-extrapolate", "generated"),
    "ESR, shaded": ("larger-extrapolate", "shaded"),
}
"""Part of the scoreboard, and role, by a short name."""


@dataclass(frozen=True)
class Side:
    """A method in a part of PARTS."""

    part: str
    method: str


@dataclass(frozen=True)
class Claim:
    """The first is ahead of the second: by a difference of a metric, or as many times faster."""

    paper: str
    text: str
    where: str
    """Table or section of the paper."""
    first: Side
    second: Side
    theirs: float | None
    """The paper's margin; None where it says no number."""
    metric: str = "psnr"
    region: str = "all"
    kind: Literal["ahead", "close", "faster"] = "ahead"


MOB, SS, FAST = "Mob-FGSR (Yang et al. 2024)", "ExtraSS (Wu et al. 2023)", "FASSET (Qin et al. 2023)"
NET, SORT = "ExtraNet (Guo et al. 2021)", "Classifier-guided supersampling (Guo et al. 2022)"


def of(part: str, method: str) -> Side:
    """Short for a side."""
    return Side(part, method)


OURS = "mobfgsr-quadratic"
"""Mob-FGSR with the paper's estimate of motion."""

PUBLISHED = "extranet-published"
"""ExtraNet as ExtraSS compares with it: `extranet` begins with the guided warp of ExtraSS."""

CLAIMS = (
    Claim(MOB, "interpolated frames beat 3D warping", "Table 2", of("I", OURS), of("I", "warp3d"), 4.22),
    Claim(MOB, "in SSIM too", "Table 2", of("I", OURS), of("I", "warp3d"), 0.049, "ssim"),
    Claim(MOB, "interpolated frames beat BSR", "Table 2", of("I", OURS), of("I", "bsr"), 5.39),
    Claim(MOB, "extrapolated frames beat 3D warping", "Table 2", of("E", OURS), of("E", "warp3d"), 2.98),
    Claim(MOB, "interpolated frames beat AFME", "Table 2", of("I", OURS), of("I", "afme"), 6.54),
    Claim(MOB, "interpolation is better than extrapolation", "Table 2", of("I", OURS), of("E", OURS), 1.24),
    Claim(MOB, "NSRR's larger images are a little better", "Table 2", of("SR", "nsrr"), of("SR", "mobfgsr"), 1.03),
    Claim(MOB, "MNSS's larger images are a little better", "Table 2", of("SR", "mnss"), of("SR", "mobfgsr"), 0.44),
    Claim(
        MOB, "FSR 2's larger images are comparable", "5.2", of("SR", "fsr2"), of("SR", "mobfgsr"), None, kind="close"
    ),
    Claim(MOB, "larger images beat TSR's", "Table 3", of("SR", "mobfgsr"), of("SR", "tsr"), 1.07),
    Claim(MOB, "DLSS 2's larger images are better", "5.2", of("SR", "dlss"), of("SR", "mobfgsr"), None),
    Claim(MOB, "enlarged and shaded beats enlarged and interpolated", "Table 2", of("SR", OURS), of("ISR", OURS), 0.70),
    Claim(MOB, "enlarged and interpolated beats extrapolated", "Table 2", of("ISR", OURS), of("ESR", OURS), 1.10),
    Claim(MOB, "ExtraNet's extrapolation is better", "Table 3", of("E", "extranet"), of("E", OURS), 3.17),
    Claim(MOB, "and better than interpolation", "Table 3", of("E", "extranet"), of("I", OURS), 2.24),
    Claim(
        MOB, "interpolation is faster than 3D warping", "Table 4", of("I", OURS), of("I", "warp3d"), 10.9, kind="faster"
    ),
    Claim(MOB, "interpolation is faster than BSR", "Table 4", of("I", OURS), of("I", "bsr"), 1.41, kind="faster"),
    Claim(
        MOB, "extrapolation is faster than interpolation", "Table 4", of("E", OURS), of("I", OURS), 1.15, kind="faster"
    ),
    Claim(
        MOB, "larger images are made faster than MNSS's", "5.3", of("SR", OURS), of("SR", "mnss"), 7.73, kind="faster"
    ),
    Claim(SS, "NSRR's larger images beat TAAU's", "Table 1", of("SR", "nsrr"), of("SR", "taau"), 0.55),
    Claim(SS, "ExtraSS's shaded images beat TAAU's", "Table 1", of("ESR, shaded", "extrass"), of("SR", "taau"), 0.59),
    Claim(SS, "its extrapolated ones beat TAAU's", "Table 1", of("ESR", "extrass"), of("SR", "taau"), 0.39),
    Claim(
        SS,
        "its extrapolated ones are close to its shaded ones",
        "Table 1",
        of("ESR", "extrass"),
        of("ESR, shaded", "extrass"),
        -0.20,
        kind="close",
    ),
    Claim(SS, "guided warping alone beats ExtraNet", "Table 2", of("E", "extrass-warp"), of("E", PUBLISHED), 1.76),
    Claim(
        SS,
        "with refinement it beats ExtraNet by more",
        "Table 2",
        of("E", "extrass-refined"),
        of("E", PUBLISHED),
        2.27,
    ),
    Claim(SS, "refinement improves the warp", "Table 2", of("E", "extrass-refined"), of("E", "extrass-warp"), 0.51),
    Claim(
        SS,
        "refined warping is faster than ExtraNet",
        "Table 4",
        of("E", "extrass-refined"),
        of("E", "extranet"),
        2.06,
        kind="faster",
    ),
    Claim(
        SS,
        "larger images are made faster than NSRR's",
        "Table 4",
        of("ESR, shaded", "extrass"),
        of("SR", "nsrr"),
        6.84,
        kind="faster",
    ),
    Claim(
        FAST,
        "extrapolated, enlarged frames beat ExtraNet's",
        "Table 2",
        of("ESR", "fasset"),
        of("ESR", "extranet-plus"),
        1.76,
    ),
    Claim(
        FAST,
        "NSRR's larger shaded frames are a little better",
        "Table 2",
        of("SR", "nsrr"),
        of("ESR, shaded", "fasset"),
        0.41,
    ),
    Claim(
        FAST,
        "enlarging ExtraNet is faster",
        "Table 3",
        of("ESR", "extranet-plus"),
        of("ESR", "fasset"),
        2.06,
        kind="faster",
    ),
    Claim(
        NET,
        "occlusion motion fills disocclusions better than motion vectors alone",
        "4.2",
        of("E", "warp-occlusion"),
        of("E", "warp"),
        None,
        region="disoccluded",
    ),
    Claim(
        NET,
        "the method improves on occlusion motion in disocclusions",
        "4",
        of("E", "extranet"),
        of("E", "warp-occlusion"),
        None,
        region="disoccluded",
    ),
    Claim(
        NET,
        "and in moving shadows and reflections",
        "4",
        of("E", "extranet"),
        of("E", "warp-occlusion"),
        None,
        region="shading",
    ),
    Claim(SORT, "a classifier of history beats TAAU", "supplement", of("SR", "classifier"), of("SR", "taau"), None),
)


def value(rows: Rows, side: Side, metric: str, region: str) -> float | None:
    """A method's mean over the clips; None where it was not measured."""
    part, role = PARTS[side.part]
    wanted = (side.method, role, metric, region)
    found = [r.value for r in rows.get(part, ()) if (r.method, r.role, r.metric, r.region) == wanted]
    return statistics.fmean(found) if found else None


def milliseconds(times: Times, side: Side) -> float | None:
    """Median time of one frame; None where it was not measured."""
    part, role = PARTS[side.part]
    wanted = "shaded" if role == "shaded" else "extrapolate" if "extrapolate" in part else "interpolate"
    found = [t.median for t in times.get(part, ()) if (t.method, t.role) == (side.method, wanted)]
    return found[0] if found else None


def margin(claim: Claim, rows: Rows, times: Times) -> float | None:
    """How far the first is ahead of the second here; None where one was not measured."""
    if claim.kind == "faster":
        first, second = (milliseconds(times, side) for side in (claim.first, claim.second))
        return None if first is None or second is None else second / first
    first, second = (value(rows, side, claim.metric, claim.region) for side in (claim.first, claim.second))
    if first is None or second is None:
        return None
    return first - second if is_higher_better(claim.metric) else second - first


def verdict(claim: Claim, ours: float | None) -> str:
    """Whether a claim holds, or that it is not known yet."""
    if ours is None:
        return "not yet measured"
    holds = {"ahead": ours > 0, "faster": ours > 1, "close": abs(ours) <= CLOSE}[claim.kind]
    return "holds" if holds else "**does not hold**"


def said(claim: Claim, amount: float | None) -> str:
    """A margin with its unit."""
    if amount is None:
        return ""
    if claim.kind == "faster":
        return f"{amount:.2f} times"
    return f"{amount:+.2f} dB" if claim.metric == "psnr" else f"{amount:+.3f}"


HEAD = """# What papers claim, and what is measured here

A claim is that one method is ahead of another; it holds where it is ahead here too. Margins of the papers are means
over the scenes of the table that is named: other scenes, other sizes, other machines, so that the sign says more than
the size. Ours are means over the held-out scenes of the [scoreboard](README.md), in PSNR over all pixels where nothing
else is said; times are of this machine. Made by `python benchmarks/scoreboard.py`.
"""

FOOT = f"""
I: interpolated, E: extrapolated, SR: every frame twice the size, ISR and ESR: both at once. Where a paper gives no
number, close means within {CLOSE:g} dB. `extranet` begins with the guided warp of ExtraSS and cannot be compared with
it; ExtraNet as published was trained here for a short time alone and does not ship ([ExtraNet](extranet.md)).
"""


def page(rows: Rows, times: Times) -> str:
    """The page of all claims."""
    ours = {claim: margin(claim, rows, times) for claim in CLAIMS}
    known = [verdict(claim, amount) for claim, amount in ours.items() if amount is not None]
    holding, rest = f"{known.count('holds')} of {len(known)} measured claims hold", len(CLAIMS) - len(known)
    lines = [HEAD, f"{holding}; {rest} are not yet measured, as their methods do not ship."]
    for paper in dict.fromkeys(claim.paper for claim in CLAIMS):
        lines += ["", f"## {paper}", ""]
        lines += ["| claim | where | measured as | the paper | here | |", "|---|---|---|--:|--:|---|"]
        for claim in (one for one in CLAIMS if one.paper == paper):
            sides = f"`{claim.first.method}` ({claim.first.part}) against `{claim.second.method}` ({claim.second.part})"
            region = "" if claim.region == "all" else f", {claim.region}"
            cells = (said(claim, claim.theirs), said(claim, ours[claim]), verdict(claim, ours[claim]))
            lines.append(f"| {claim.text} | {claim.where} | {sides}{region} | {' | '.join(cells)} |")
    return "\n".join([*lines, FOOT])
