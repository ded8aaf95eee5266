"""What the doctor says: findings in words, a verdict, and the same for machines."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

from framecast.importers.settings import Settings, plain

State = Literal["fine", "note", "fix", "unknown"]

MARKS: dict[str, str] = {"fine": "ok", "note": "note", "fix": "FIX", "unknown": "?"}


@dataclass(frozen=True)
class Finding:
    """One answer."""

    code: str
    """What it is about, buffer first: motion.y, depth.kind, ..."""
    state: State
    """fine; note: worth knowing; fix: wrong as claimed; unknown: cannot be told from these frames."""
    says: str
    """One sentence."""
    before: float | None = None
    after: float | None = None
    """Errors as claimed and as found, where an experiment compared them; their unit is in the sentence."""
    votes: float | None = None
    """Standard deviations by which parts of the pictures that agree outnumber those that do not."""


@dataclass(frozen=True)
class Report:
    """Everything about one folder."""

    folder: str
    source: str
    """Who seems to have written it."""
    frames: tuple[int, ...]
    """Numbers of the frames that were looked at."""
    total: int
    size: tuple[int, int]
    """Width and height."""
    findings: tuple[Finding, ...]
    settings: Settings
    """How to import the folder."""
    written: tuple[str, ...] = field(default=())
    """Files that were written."""

    @property
    def verdict(self) -> str:
        """healthy, fix, or undecidable: whether the vectors are right cannot be told."""
        states = {f.state for f in self.findings}
        if "fix" in states:
            return "fix"
        decided = any(f.code == "motion" and f.state == "fine" for f in self.findings)
        return "healthy" if decided else "undecidable"

    def text(self) -> str:
        """For people."""
        width, height = self.size
        looked = (
            f"{len(self.frames)} of {self.total} frames" if len(self.frames) < self.total else f"{self.total} frames"
        )
        order = {"fix": 0, "unknown": 1, "fine": 2, "note": 3}
        rows = sorted(self.findings, key=lambda f: order[f.state])
        lines = [f"{self.folder}: {looked} looked at, {width}x{height}, read as {self.source}", ""]
        lines += [f"{MARKS[f.state]:>5}  {f.says}" for f in rows]
        return "\n".join([*lines, "", *self.written, self.summary()])

    def summary(self) -> str:
        """One line."""
        wrong = [f.code for f in self.findings if f.state == "fix"]
        if self.verdict == "healthy":
            return "healthy: what the buffers claim is what the pictures show"
        if wrong:
            return f"{len(wrong)} to fix: {', '.join(wrong)}"
        return "undecidable: these frames cannot show whether the vectors are right"

    def json(self) -> dict[str, Any]:
        """For machines."""
        return {
            "version": 1,
            "folder": self.folder,
            "source": self.source,
            "verdict": self.verdict,
            "frames": list(self.frames),
            "total": self.total,
            "size": list(self.size),
            "findings": [{k: v for k, v in asdict(f).items() if v is not None} for f in self.findings],
            "settings": plain(self.settings),
            "written": list(self.written),
        }


def worst(findings: Sequence[Finding]) -> State:
    """The most serious state."""
    return next((s for s in ("fix", "unknown", "note") if any(f.state == s for f in findings)), "fine")
