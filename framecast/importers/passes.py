"""What the numbered files of a folder hold, by name: how importers recognise their passes."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from framecast.importers import images
from framecast.importers.folder import Listing

MOST = 64
"""File patterns whose first file is looked into."""


@dataclass(frozen=True)
class Pass:
    """Channels with one prefix in the files of one pattern."""

    pattern: str
    label: str
    """File name and channel prefix, lower case, without blanks, dots, dashes and underscores; a slash between."""
    letters: dict[str, str]
    """Last parts of the channel names, upper case, with the whole names."""
    about: images.About

    def layer(self, letters: str) -> dict[str, Any]:
        """The arguments `files` and `channels` of a layer."""
        return {"files": (self.pattern,), "channels": tuple(self.letters[letter] for letter in letters)}


def plain(text: str) -> str:
    """Lower case, without what separates words."""
    return re.sub(r"[\s_.\-]", "", text.lower())


def passes(listing: Listing) -> list[Pass]:
    """Every pass of every numbered file, in order; one header a pattern is read."""
    found = []
    for pattern, name in list(listing.patterns().items())[:MOST]:
        about = images.about(listing.folder / name)
        groups: dict[str, dict[str, str]] = {}
        for channel in about.names:
            prefix, _, letter = channel.rpartition(".")
            groups.setdefault(prefix, {})[letter.upper()] = channel
        stem = plain(pattern.rpartition(".")[0].replace("{frame}", "").rpartition("/")[2])
        for prefix, letters in groups.items():
            found.append(Pass(pattern, f"{stem}/{plain(prefix)}", letters, about))
    return found


def find(held: Sequence[Pass], words: Sequence[str], letters: Sequence[str]) -> tuple[Pass, str] | None:
    """The first pass whose label ends with one of the words, and the letters that it has.

    Args:
        words: best first; the file's name without a prefix counts as a label, too.
        letters: alternatives such as XYZ and RGB, best first.
    """
    for word in words:
        for candidate in held:
            stem, _, prefix = candidate.label.partition("/")
            if prefix.endswith(word) if prefix else stem.endswith(word):
                for wanted in letters:
                    if set(wanted) <= set(candidate.letters):
                        return candidate, wanted
    return None
