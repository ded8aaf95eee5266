"""Which layer is what: by name where the name says it, else by what the numbers look like."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from framecast.importers.passes import Pass

WORDS: dict[str, tuple[str, ...]] = {
    "motion_next": ("motionnext", "nextmotion", "forwardmotion", "flownext", "forwardflow", "motionforward"),
    "skip": ("motion2", "cryptomatte", "cryptoobject", "crypto", "noisyimage", "alpha", "position", "shadow", "uv"),
    "motion": ("motionvectors", "motionvector", "motion", "velocity", "vector", "mvec", "flow", "speed", "mv"),
    "normal": ("normal", "nrm", "gbuffera"),
    "albedo": ("albedo", "basecolor", "diffusecolor", "diffcol", "diffuse", "gbufferc"),
    "roughness": ("roughness",),
    "metallic": ("metallic", "metalness"),
    "object": ("object", "indexob", "stencil", "objectid", "idmask"),
    "depth": ("depth", "zbuffer", "linearz", "distance"),
    "color": ("combined", "beauty", "color", "colour", "rgb", "image", "radiance", "final", "scene", "hdr", "lit"),
}
"""Words that name a buffer, looked for in the channel's prefix, then in the file's name; earlier rows win."""

SPELLINGS: dict[str, tuple[str, ...]] = {
    "motion_next": ("XY", "RG", "UV", "ZW", "01"),
    "motion": ("XY", "RG", "UV", "01"),
    "normal": ("XYZ", "RGB", "012"),
    "albedo": ("RGB", "XYZ", "012"),
    "color": ("RGB", "XYZ", "012"),
    "depth": ("Z", "Y", "V", "R", "X", "0", "DEPTH"),
    "roughness": ("Y", "V", "R", "X", "Z", "0"),
    "metallic": ("Y", "V", "R", "X", "Z", "0"),
    "object": ("Y", "V", "R", "X", "Z", "0"),
}
"""Channels that hold a buffer, best first."""


@dataclass(frozen=True)
class Held:
    """One buffer: the pattern of its files and its channels."""

    pattern: str
    channels: tuple[str, ...]
    bits: int
    size: tuple[int, int]


def by_name(held: Sequence[Pass]) -> dict[str, Held]:
    """Buffers whose name says what they are. Vectors of four 8-bit channels are packed, of four floats two vectors."""
    found: dict[str, Held] = {}
    for candidate in held:
        role = named(candidate)
        if role is None or role == "skip" or role in found:
            continue
        letters = candidate.letters
        if role == "motion" and candidate.about.bits == 8 and {"R", "G", "B", "A"} <= set(letters):
            found[role] = _held(candidate, "RGBA")
            continue
        spelling = next((s for s in SPELLINGS[role] if _has(letters, s)), None)
        if spelling is None:
            continue
        found[role] = _held(candidate, spelling)
        if role == "motion" and "motion_next" not in found and {"X", "Y", "Z", "W"} <= set(letters):
            found["motion_next"] = _held(candidate, "ZW")
    return found


def _has(letters: Mapping[str, str], spelling: str) -> bool:
    return spelling in letters if spelling == "DEPTH" else set(spelling) <= set(letters)


def _held(candidate: Pass, spelling: str) -> Held:
    keys = (spelling,) if spelling == "DEPTH" else tuple(spelling)
    about = candidate.about
    return Held(candidate.pattern, tuple(candidate.letters[k] for k in keys), about.bits, about.size)


def named(candidate: Pass) -> str | None:
    """The buffer that the name of a pass stands for, None where it does not say."""
    stem, _, prefix = candidate.label.partition("/")
    for label in (prefix, stem):
        for role, words in WORDS.items():
            if any(word in label for word in words):
                return role
        if label in ("z", "d"):
            return "depth"
        if label in ("n",):
            return "normal"
    letters = set(candidate.letters)
    if not prefix and {"R", "G", "B"} <= letters and candidate.about.bits == 32:
        return "color"
    return "depth" if (not prefix and letters & {"DEPTH"}) or letters == {"Z"} else None


def by_content(planes: Mapping[str, tuple[Held, np.ndarray, np.ndarray]], lacking: Sequence[str]) -> dict[str, str]:
    """For buffers that no name gave, the layer that looks like them.

    Args:
        planes: unnamed layers by label: where they lie, and the numbers `c h w` of two frames.
        lacking: buffers that are still to be found.
    """
    found: dict[str, str] = {}
    left = dict(planes)

    def take(role: str, scores: dict[str, float]) -> None:
        if role in lacking and scores and max(scores.values()) > 0:
            label = max(scores, key=scores.__getitem__)
            found[role] = label
            left.pop(label)

    take("normal", {k: unit_share(a) - 0.8 for k, (_, a, _) in left.items() if len(a) >= 3})
    take("motion", {k: vector_score(h, a) for k, (h, a, _) in left.items() if len(a) >= 2})
    take("color", {k: contrast(a) for k, (_, a, _) in left.items() if len(a) >= 3})
    take("albedo", {k: float(a.min() >= 0 and a.max() <= 1.01) for k, (_, a, _) in left.items() if len(a) >= 3})
    take("depth", {k: smoothness(a) for k, (_, a, _) in left.items() if len(a) == 1})
    return found


def unit_share(a: np.ndarray) -> float:
    """Share of the pixels that hold a unit vector, as it is or as n / 2 + 1/2; of those that hold anything."""
    v = a[:3].astype(np.float32)
    shares = []
    for w in (v, 2 * v - 1):
        length = np.sqrt((w * w).sum(0))
        written = (np.abs(v).max(0) > 1e-3) & np.isfinite(length)
        shares.append(float((np.abs(length[written] - 1) < 0.05).mean()) if written.mean() > 0.05 else 0.0)
    return max(shares)


def vector_score(held: Held, a: np.ndarray) -> float:
    """Above 0 where numbers may be vectors: both signs, or codes about one half; two channels before three or four."""
    v = np.nan_to_num(a[:2].astype(np.float32), nan=0, posinf=0, neginf=0)
    signed = float(v.min() < 0) * float((np.abs(v) < 1e4).all())
    middle = float(np.median(np.abs(v - 0.5)) < 0.2 and v.min() >= 0 and v.max() <= 1.01)
    idle = len(a) == 2 or (len(a) == 3 and np.ptp(a[2]) < 1e-6) or (len(a) == 4 and held.bits == 8)
    return (signed + 0.5 * middle) * (1.0 if idle else 0.1)


def contrast(a: np.ndarray) -> float:
    """How much pixels differ from each other, brightest against usual."""
    v = np.nan_to_num(a[:3].astype(np.float32), nan=0, posinf=0, neginf=0)
    return float(np.quantile(v, 0.999) / (abs(np.median(v)) + 1e-3) + v.std()) if v.min() >= 0 else 0.0


def smoothness(a: np.ndarray) -> float:
    """Above 0 where neighbours hold nearly equal numbers and yet there are many numbers: distances do, ids do not."""
    v = np.nan_to_num(a[0].astype(np.float32), nan=0, posinf=0, neginf=0)
    distinct = len(np.unique(v[::4, ::4]))
    spread = np.median(np.abs(v - np.median(v))) + 1e-9
    return 1 / (0.1 + float(np.median(np.abs(np.diff(v, axis=1))) / spread)) if distinct > 30 else 0.0
