"""The picture that convinces: each frame over the one before, fetched along the vectors as claimed and as found.

Both are drawn in one image, this frame in red and the fetched one in cyan: grey where they agree, coloured where not.
"""

from pathlib import Path

import numpy as np
from jaxtyping import Float
from PIL import Image, ImageDraw, ImageFont

from framecast.doctor.camera import between, camera_motion
from framecast.doctor.examine import Examined
from framecast.doctor.motion import Shifts, displacement, resampled
from framecast.doctor.probe import sample
from framecast.doctor.say_motion import Told
from framecast.doctor.search import recorded_shifts
from framecast.doctor.take import Take
from framecast.exr import whole
from framecast.importers.settings import Motion

WIDTH = 640
"""Pixels of one panel; smaller pictures are enlarged."""

CLOSE = 8
"""A close-up shows a part of the picture this many times smaller than it."""


def draw(examined: Examined, path: Path) -> Path:
    """One PNG: above, whole pictures, below, the place where the second reading gains most."""
    take, told = examined.take, examined.told
    t = _frame(take)
    image, before = take.images[t], take.images[t - 1]
    claim = examined.claim.motion
    zero = np.zeros((2, *take.size), np.float32)
    as_claimed = zero if claim is None else _whole(take, t, claim, 0)
    as_found = as_claimed
    if told.answer is not None and told.motion is not None:
        as_found = _whole(take, t, told.motion, told.answer.best.reading.offset)
        as_found = as_found + _camera(take, t, told, as_found)
    first = as_claimed + _shift(recorded_shifts(take, [t])[0])
    second = as_found + _shift(_found_shift(told.answer.shifts if told.answer else None, t))
    names = ("as claimed", "as found")
    if np.abs(first - second).max() < 1e-3:
        first, names = zero, ("without vectors", "along the vectors, as claimed")
    columns = []
    overlays = [overlay(image, before, v) for v in (first, second)]
    errors = [np.abs(image - fetched(before, v)).mean(0) for v in (first, second)]
    gained = errors[0] - errors[1]
    place = _most(gained if np.abs(gained).max() > 1e-3 else errors[1])
    for name, picture, error in zip(names, overlays, errors, strict=True):
        columns.append(_column(picture, place, f"{name}: error {np.minimum(error, 1).mean():.3f}"))
    with whole(path) as temporary:
        Image.fromarray(np.concatenate(columns, 1)).save(temporary)
    return path


def _frame(take: Take) -> int:
    """The frame with vectors in the middle."""
    frames = [t for t in take.pairs if "motion" in take.stored[t]] or take.pairs or [1]
    return frames[len(frames) // 2]


def _whole(take: Take, t: int, motion: Motion, offset: int) -> np.ndarray:
    source = take.stored[t - offset] if 0 <= t - offset < len(take.stored) else {}
    if "motion" not in source:
        return np.zeros((2, *take.size), np.float32)
    stored = source["motion"]
    own = (stored.shape[1], stored.shape[2])
    flat = displacement(stored.reshape(len(stored), -1), motion, take.size, own) * np.float32(take.stretch)
    if motion.unwritten is not None:
        flat = np.where((stored.reshape(len(stored), -1) == motion.unwritten).all(0), 0, flat)
    planes = np.stack([resampled(plane.reshape(own), take.size) for plane in flat])
    return -planes if "next" in motion.direction else planes


def _camera(take: Take, t: int, told: Told, found: np.ndarray) -> np.ndarray:
    """What the recorded cameras add to vectors that lack it."""
    if not told.lacks or told.blanks is None or told.blanks.depth is None:
        return np.zeros_like(found)
    everything = np.arange(take.size[0] * take.size[1])
    pair = between(take, t, t - 1, everything[:1])
    field = camera_motion(take, pair, everything, told.blanks.depth).reshape(found.shape)
    if told.lacks == "camera":
        return field
    empty = (take.stored[t]["motion"] == told.blanks.code[:, None, None]).all(0)
    return np.where(resampled(empty, take.size), field, 0)


def _shift(pair: np.ndarray) -> np.ndarray:
    return np.asarray(pair, np.float32)[:, None, None]


def _found_shift(shifts: Shifts | None, t: int) -> np.ndarray:
    return np.array((shifts or {}).get((t, t - 1), (0.0, 0.0)))


def fetched(other: Float[np.ndarray, "3 h w"], motion: Float[np.ndarray, "2 h w"]) -> Float[np.ndarray, "3 h w"]:
    """The other frame where the vectors point."""
    height, width = other.shape[1:]
    y, x = np.mgrid[0:height, 0:width].astype(np.float32) + 0.5
    return sample(other, (x + motion[0]).ravel(), (y + motion[1]).ravel()).reshape(other.shape)


def overlay(
    image: Float[np.ndarray, "3 h w"], other: Float[np.ndarray, "3 h w"], motion: Float[np.ndarray, "2 h w"]
) -> Float[np.ndarray, "h w 3"]:
    """This frame in red and the fetched one in cyan, 0..1."""
    low, high = np.quantile(image, 0.01), np.quantile(image, 0.99)
    red, cyan = ((np.clip((p.mean(0) - low) / max(high - low, 1e-6), 0, 1)) for p in (image, fetched(other, motion)))
    return np.stack([red, cyan, cyan], -1)


def _most(gained: np.ndarray) -> tuple[int, int, int, int]:
    """The window (left, top, width, height) in which most is gained."""
    height, width = gained.shape
    w, h = max(width // CLOSE * 2, 8), max(height // CLOSE * 2, 8)
    total = np.pad(np.minimum(gained, 1).cumsum(0).cumsum(1), ((1, 0), (1, 0)))
    sums = total[h:, w:] - total[:-h, w:] - total[h:, :-w] + total[:-h, :-w]
    if sums.size == 0:
        return 0, 0, width, height
    top, left = np.unravel_index(int(np.argmax(sums)), sums.shape)
    return int(left), int(top), w, h


def _column(picture: np.ndarray, place: tuple[int, int, int, int], name: str) -> np.ndarray:
    """The whole picture with the window marked, and the window enlarged below."""
    height, width = picture.shape[:2]
    tall = round(WIDTH * height / width)
    codes = np.rint(picture * 255).astype(np.uint8)
    large = Image.fromarray(codes).resize((WIDTH, tall), Image.Resampling.BICUBIC)
    left, top, w, h = place
    part = Image.fromarray(codes[top : top + h, left : left + w]).resize((WIDTH, tall), Image.Resampling.NEAREST)
    draw_on = ImageDraw.Draw(large)
    scale = WIDTH / width
    draw_on.rectangle(
        (left * scale, top * scale, (left + w) * scale, (top + h) * scale), outline=(255, 210, 60), width=2
    )
    font = ImageFont.load_default(size=17)
    box = draw_on.textbbox((10, 8), name, font=font)
    draw_on.rectangle((box[0] - 6, box[1] - 5, box[2] + 6, box[3] + 5), fill=(16, 16, 20))
    draw_on.text((10, 8), name, font=font, fill=(240, 240, 240))
    ImageDraw.Draw(part).rectangle((0, 0, WIDTH - 1, tall - 1), outline=(255, 210, 60), width=2)
    gap = np.full((6, WIDTH, 3), 16, np.uint8)
    column = np.concatenate([np.asarray(large), gap, np.asarray(part)])
    return np.pad(column, ((0, 0), (3, 3), (0, 0)), constant_values=16)
