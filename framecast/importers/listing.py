"""Image files of a folder, by number."""

import json
import re
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from framecast.exr import ClipError
from framecast.importers import images
from framecast.importers.blender import ranges

MOST = 200_000
"""Files that a folder is searched for."""


@dataclass(frozen=True)
class Listing:
    """Files of a folder and of the folders in it, by path relative to it."""

    folder: Path

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Image files in order, without hidden ones and without clips and images that were made from them.

        Raises:
            FileNotFoundError: no such folder.
        """
        if not self.folder.is_dir():
            what = "a file" if self.folder.is_file() else "not there"
            raise FileNotFoundError(f"{self.folder} is {what}; give the folder that holds the rendered files")
        found, made = [], set[str]()
        for depth in ("*", "*/*", "*/*/*", "*/*/*/*"):
            for path in self.folder.glob(depth):
                name = path.relative_to(self.folder).as_posix()
                if path.suffix.lower() in images.EXTENSIONS and not any(p.startswith(".") for p in name.split("/")):
                    found.append(name)
                elif path.name in ("clip.json", "job.json") and "/" in name and _is_ours(path):
                    made.add(name.rpartition("/")[0] + "/")
                if len(found) > MOST:
                    raise ClipError(f"{self.folder} holds more than {MOST} files; give the folder of one shot")
        return tuple(sorted(name for name in found if not name.startswith(tuple(made))))

    def numbered(self, pattern: str) -> dict[int, str]:
        """Files that match a pattern, by frame number.

        Raises:
            ClipError: two sequences, or two files of one frame, match.
        """
        expression = re.compile(expressed(pattern))
        groups: dict[tuple[str, ...], dict[int, str]] = {}
        for name in self.names:
            if match := expression.fullmatch(name):
                numbers = groups.setdefault(tuple(v for k, v in match.groupdict().items() if k != "frame"), {})
                number = int(match["frame"])
                if number in numbers:
                    raise ClipError(
                        f"{self.folder} holds two files of frame {number}, {numbers[number]} and {name}; keep one"
                    )
                numbers[number] = name
        if len(groups) > 1:
            each = " and ".join(f"{next(iter(g.values()))} ... {ranges(g)}" for g in list(groups.values())[:4])
            raise ClipError(
                f"{self.folder} holds {len(groups)} sequences ({each}); put each shot into a folder of its own"
            )
        return dict(sorted(next(iter(groups.values())).items())) if groups else {}

    def first(self, pattern: str) -> images.About | None:
        """What the first file that matches a pattern says of itself; None where none does."""
        expression = re.compile(expressed(pattern))
        name = next((name for name in self.names if expression.fullmatch(name)), None)
        return None if name is None else images.about(self.folder / name)

    def patterns(self) -> dict[str, str]:
        """File patterns of all numbered files, each with its first file; the last number of a name is the frame's."""
        found: dict[str, str] = {}
        for name in self.names:
            parent, _, file = name.rpartition("/")
            if match := re.fullmatch(r"(.*?)(\d+)(\D*\.\w+)", file):
                pattern = f"{match[1]}{{frame}}{match[3]}"
                found.setdefault(f"{parent}/{pattern}" if parent else pattern, name)
        return found


def _is_ours(path: Path) -> bool:
    """Whether this package wrote a file that says what lies beside it, `clip.json` or `job.json`."""
    try:
        about = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return False
    keys = {"job", "clip", "frames"} if path.name == "job.json" else {"format", "version", "frames"}
    return isinstance(about, dict) and keys <= about.keys()


def expressed(pattern: str) -> str:
    """A regular expression for a file pattern; letters match in any case."""
    parts = re.split(r"(\{frame\}|\*)", pattern)
    stars = iter(range(len(parts)))
    text = [
        r"(?P<frame>\d{1,9})"
        if part == "{frame}"
        else rf"(?P<s{next(stars)}>[^/]*)"
        if part == "*"
        else re.escape(part)
        for part in parts
    ]
    return "(?i)" + "".join(text)
