"""What stored depth means, by two laws that hold for 1 / z and for nothing else.

On a plane 1 / z is an affine function of the position in the image (planarity), and what the camera does to a still
world is a smooth field plus 1 / z times another (parallax). Each reading of the numbers is a candidate for 1 / z; the
one that obeys is taken. With recorded cameras the second law also gives the unit.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from framecast.doctor.camera import polynomial, sky_of
from framecast.doctor.motion import resampled
from framecast.doctor.probe import thinned
from framecast.doctor.take import Take
from framecast.importers.settings import Depth

VIEWS = (25.0, 40.0, 55.0, 70.0, 90.0)
"""Vertical fields of view in degrees that are tried where the lens is not known."""


GRAINS = 400
"""Steps of the stored numbers that a slope has to rise by before its bending is looked at."""


@dataclass(frozen=True)
class Law:
    """How badly each kind of depth obeys a law; small is good. `weight`: pixels that could tell."""

    misfits: Mapping[str, float]
    weight: int

    def ratio(self, kind: str) -> float:
        """Misfit of a kind over the least one of the others."""
        others = [m for k, m in self.misfits.items() if family(k) != family(kind)]
        return self.misfits[kind] / max(min(others, default=np.inf), 1e-12)


def family(kind: str) -> str:
    """Kinds that are affine functions of each other obey alike: device, reversed and inverse."""
    return "inverse" if kind in ("device", "reversed", "inverse") else kind


def candidates(raw: np.ndarray, tangents: Sequence[float]) -> dict[str, np.ndarray]:
    """1 / z up to a factor (and a constant, for inverse), for each way to read the numbers.

    Args:
        raw: numbers `h w`, not of the sky. tangents: of half the vertical field of view, that are to be tried.
    """
    positive = np.maximum(np.abs(raw.astype(np.float64)), 1e-9)
    out = {"planar": 1 / positive, "inverse": raw - (1.0 if is_device(raw) else 0.0)}
    height, width = raw.shape
    y, x = np.mgrid[0:height, 0:width] + 0.5
    for tangent in tangents:
        reach = ((2 * x - width) ** 2 + (2 * y - height) ** 2) * (tangent / height) ** 2
        out[f"euclidean {tangent:.4f}"] = np.sqrt(1 + reach) / positive
    return out


def is_device(raw: np.ndarray) -> bool:
    """Whether numbers lie as those of device depth do, most of them near 1, which then stands for infinity."""
    return float(raw.max()) <= 1.0 + 1e-6 and float(raw.min()) >= 0 and float(np.median(raw)) > 0.5


def planarity(take: Take, tangents: Sequence[float]) -> Law:
    """The lower third of how much each candidate bends, as a share of its slope, two pixels to either side.

    Only slopes count that are large against the candidate itself and against the step of the stored numbers. A
    candidate that hardly slopes where another one does would be a world without relief, and is none.
    """
    bends: dict[str, list[np.ndarray]] = {}
    for t in _some(take):
        stored = take.stored[t]["depth"][0]
        raw = np.nan_to_num(stored.astype(np.float64), nan=0, posinf=3e38, neginf=0)
        solid = ~sky_of(stored)
        raw = np.where(solid, raw, 1)
        step = GRAINS * np.abs(raw) * (2.0**-11 if stored.dtype == np.float16 else 2.0**-24)
        for name, f in candidates(raw, tangents).items():
            for turn in (False, True):
                planes = [(p.T if turn else p)[thinned(len(p))] for p in (f, raw, step, solid)]
                (a, b, c), (r, _, s), (_, floor, _), ends = (_along(p) for p in planes)
                rise = np.abs(c - a) / 2
                tells = ends[0] & ends[1] & ends[2] & (rise > 2e-3 * np.abs(b)) & (rise < 0.2 * np.abs(b))
                tells &= np.abs(s - r) / 2 > floor
                bends.setdefault(name, []).append((np.abs(a - 2 * b + c)[tells] / rise[tells])[::3])
    joined = {k: np.concatenate(v) for k, v in bends.items()}
    weight = max(map(len, joined.values()), default=0)
    return Law({k: float(np.quantile(v, 0.3)) if len(v) > weight / 10 else np.inf for k, v in joined.items()}, weight)


def _along(plane: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Values two pixels to the left, here, and two pixels to the right."""
    return plane[:, :-4], plane[:, 2:-2], plane[:, 4:]


def _some(take: Take, most: int = 4) -> list[int]:
    frames = [t for t in take.full("depth") if take.joined[t]] or take.full("depth")
    return frames[:: max(1, len(frames) // most)][:most]


def parallax(take: Take, vectors: Mapping[int, np.ndarray], tangents: Sequence[float]) -> tuple[Law, float]:
    """What a smooth field plus each candidate (and its square) times others leaves of the vectors, in pixels; and
    what is left without any depth.

    Args:
        vectors: by frame, `2 h w` pixels, towards the previous frame.
    """
    left: dict[str, list[float]] = {}
    without = []
    for t, field in list(vectors.items())[:6]:
        raw = resampled(
            np.nan_to_num(take.stored[t]["depth"][0].astype(np.float64), nan=0, posinf=3e38, neginf=0), take.size
        )
        solid = ~resampled(sky_of(take.stored[t]["depth"][0]), take.size)
        places = np.flatnonzero(solid)
        if len(places) < 1000:
            continue
        places = np.random.default_rng(t).choice(places, min(len(places), 4000), replace=False)
        y, x = places // take.size[1] + 0.5, places % take.size[1] + 0.5
        basis, v = polynomial(x, y, take.size), field.reshape(2, -1)[:, places].T.astype(np.float64)
        without.append(_residual(basis, v))
        for name, f in candidates(np.where(solid, raw, 1), tangents).items():
            inverse = f.flat[places]
            inverse = inverse / (np.median(np.abs(inverse)) + 1e-12)
            once = inverse[:, None] * basis[:, :3]
            left.setdefault(name, []).append(_residual(np.concatenate([basis, once, inverse[:, None] * once], 1), v))
    flat = float(np.median(without)) if without else 0.0
    return Law({k: float(np.median(v)) for k, v in left.items()}, 4000 * len(without)), flat


def _residual(basis: np.ndarray, v: np.ndarray) -> float:
    """Median length of what the best robust combination of the basis leaves of vectors `n 2`."""
    weight = np.ones(len(v))
    for _ in range(12):
        normal = (basis * weight[:, None]).T @ basis
        ridge = 1e-12 * np.trace(normal) * np.eye(len(normal))
        solution = np.linalg.solve(normal + ridge, (basis * weight[:, None]).T @ v)
        length = np.sqrt(((v - basis @ solution) ** 2).sum(1))
        weight = 1 / (1 + (length / (2 * np.median(length) + 1e-4)) ** 2)
    return float(np.median(length))


__all__ = ["Depth", "Law", "candidates", "family", "parallax", "planarity", "replace"]
