"""Labels on scenes whose classes are known to the pixel, and what the command says and shows."""

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from torch import Tensor

from framecast import exr
from framecast.cli import main
from framecast.clip import ClipError, Record, finish, open_clip, write_frame
from framecast.frame import SKY
from framecast.labels import COLORS, NONE, Labels, Ranges, classify, labels, opened, overlay

H, W, FINE = 24, 40, 8
VISIBILITY, SHADING, GEOMETRY, TEXTURE = 0, 1, 0, 1

Picture = Callable[[Tensor, Tensor], tuple[Tensor, Tensor]]
"""Brightness and depth at positions x, y in pixels."""


def still() -> Tensor:
    return torch.zeros(1, 2, H, W)


def ranges(picture: Picture, turned: float = 0.0, bent: float = 0.0) -> Ranges:
    """What 8 x 8 samples of every pixel span."""
    x = (torch.arange(W * FINE) + 0.5) / FINE
    y = ((torch.arange(H * FINE) + 0.5) / FINE)[:, None]
    color, depth = (torch.as_tensor(v, dtype=torch.float32).expand(H * FINE, W * FINE) for v in picture(x + 0 * y, y))
    (low, high), (near, far) = (_ends(v) for v in (color, depth))
    spread = [torch.full((1, 1, H, W), value) for value in (max(turned, bent), turned)]
    return Ranges(low.expand(1, 3, H, W), high.expand(1, 3, H, W), near, far, *spread)


def _ends(values: Tensor) -> tuple[Tensor, Tensor]:
    cells = values.view(1, 1, H, FINE, W, FINE)
    return cells.amin((3, 5)), cells.amax((3, 5))


def where(classes: Tensor, kind: int) -> Tensor:
    return classes[0, 0] == kind


def box(rows: slice, columns: slice) -> Tensor:
    mask = torch.zeros(H, W, dtype=torch.bool)
    mask[rows, columns] = True
    return mask


# Visibility.


def card(left: float) -> Picture:
    """A card from row 6 to 18, 12 pixels wide, half as far away as the wall behind it."""

    def picture(x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
        on = (x >= left) & (x < left + 12) & (y >= 6) & (y < 18)
        return torch.where(on, 0.6, 0.2), torch.where(on, 2.0, 4.0)

    return picture


def sliding(left: int, speed: float) -> Tensor:
    """Motion of a picture with the card there, which came from `speed` pixels further left."""
    motion = still()
    motion[0, 0, 6:18, left : left + 12] = -speed
    return motion


def test_a_card_uncovers_the_wall_behind_it() -> None:
    """Four columns that it left, and the card's own last column, whose pixels may hold some of the wall."""
    found = classify(ranges(card(14)), ranges(card(10)), sliding(14, 4), sliding(10, 4))
    assert torch.equal(where(found.ghosting, VISIBILITY), box(slice(6, 18), slice(10, 15)))
    assert not where(found.ghosting, SHADING).any()
    assert bool(where(found.aliasing, NONE).all())  # edges between pixels are in none of them


def test_what_moves_with_its_background_uncovers_nothing() -> None:
    found = classify(ranges(card(14)), ranges(card(14)), still(), still())
    assert bool(where(found.ghosting, NONE).all())


@pytest.mark.parametrize(("speed", "seen"), [(1, False), (2, True)])
def test_surfaces_are_apart_when_their_velocities_are(speed: int, seen: bool) -> None:
    """The square of one pixel a frame is not above the threshold, that of two is."""
    before, now = sliding(10, speed), sliding(10 + speed, speed)
    found = classify(ranges(card(10 + speed)), ranges(card(10)), now, before)
    assert bool(where(found.ghosting, VISIBILITY).any()) is seen


def test_depth_alone_decides_where_the_frame_before_has_no_velocity() -> None:
    found = classify(ranges(card(11)), ranges(card(10)), sliding(11, 1), None)
    assert torch.equal(where(found.ghosting, VISIBILITY), box(slice(6, 18), slice(10, 11)))


def test_beyond_the_screen_and_after_a_cut_there_is_no_history() -> None:
    wall: Picture = lambda x, y: (torch.tensor(0.3), torch.tensor(3.0))  # noqa: E731
    motion = still()
    motion[:, 0] = 5.0
    found = classify(ranges(wall), ranges(wall), motion, motion)
    assert torch.equal(where(found.ghosting, VISIBILITY), box(slice(None), slice(W - 5, W)))
    cut = classify(ranges(wall), None, still())
    assert bool(where(cut.ghosting, VISIBILITY).all())


def test_before_the_sky_nothing_is_hidden() -> None:
    """The sky hides nothing, and what stood before it hid it."""
    sky: Picture = lambda x, y: (torch.tensor(0.3), torch.tensor(SKY))  # noqa: E731
    near: Picture = lambda x, y: (torch.tensor(0.3), torch.tensor(3.0))  # noqa: E731
    other = still() + 3
    assert bool(where(classify(ranges(near), ranges(sky), still(), other).ghosting, NONE).all())
    assert bool(where(classify(ranges(sky), ranges(near), still(), other).ghosting, VISIBILITY).all())


# Shading.


def shadow(edge: float, wide: float = W) -> Picture:
    """A floor in sunlight, dark from `wide` pixels left of the edge to the edge."""
    return lambda x, y: (torch.where((x < edge) & (x >= edge - wide), 0.1, 0.9), torch.tensor(5.0))


def test_a_shadow_that_crosses_a_floor_is_shading_where_it_has_come() -> None:
    found = classify(ranges(shadow(20)), ranges(shadow(12)), still(), still())
    assert torch.equal(where(found.ghosting, SHADING), box(slice(None), slice(12, 20)))
    assert not where(found.ghosting, VISIBILITY).any()
    back = classify(ranges(shadow(12)), ranges(shadow(20)), still(), still())
    assert torch.equal(back.ghosting, found.ghosting)


def test_pixels_that_hold_the_edge_of_a_shadow_are_texture_and_not_shading() -> None:
    found = classify(ranges(shadow(20.5)), ranges(shadow(12)), still(), still())
    assert torch.equal(where(found.aliasing, TEXTURE), box(slice(None), slice(20, 21)))
    assert torch.equal(where(found.ghosting, SHADING), box(slice(None), slice(12, 20)))


@pytest.mark.parametrize(("wide", "seen"), [(2, False), (3, True)])
def test_thin_changes_are_opened_away(wide: int, seen: bool) -> None:
    found = classify(ranges(shadow(20, wide)), ranges(shadow(-50)), still(), still())
    expected = box(slice(None), slice(20 - wide, 20)) if seen else box(slice(0), slice(0))
    assert torch.equal(where(found.ghosting, SHADING), expected)


def test_a_change_too_small_to_see_is_none_and_light_moving_with_its_surface_either() -> None:
    dim: Picture = lambda x, y: (torch.tensor(0.50), torch.tensor(5.0))  # noqa: E731
    bright: Picture = lambda x, y: (torch.tensor(0.55), torch.tensor(5.0))  # noqa: E731
    assert bool(where(classify(ranges(bright), ranges(dim), still(), still()).ghosting, NONE).all())
    motion = still()
    motion[:, 0] = -8.0
    moved = classify(ranges(shadow(20)), ranges(shadow(12)), motion, motion)
    assert not where(moved.ghosting, SHADING).any()


def test_what_is_uncovered_is_not_shading() -> None:
    """The card is three times as bright as the wall, but what changed beside it is another surface."""
    found = classify(ranges(card(20)), ranges(card(10)), sliding(20, 10), sliding(10, 10))
    assert torch.equal(where(found.ghosting, VISIBILITY), box(slice(6, 18), slice(10, 21)))
    assert not where(found.ghosting, SHADING).any()


def test_an_opening_keeps_what_touches_the_border() -> None:
    mask = box(slice(0, 3), slice(0, 3)) | box(slice(10, 12), slice(10, 30))
    assert torch.equal(opened(mask[None, None])[0, 0], box(slice(0, 3), slice(0, 3)))


# Aliasing.


def checker(angle: float) -> Picture:
    """A disc of radius 9 with squares of half a pixel, turned about its middle, on a grey wall."""
    cos, sin = np.cos(angle), np.sin(angle)

    def picture(x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
        u, v = x - W / 2, y - H / 2
        dark = ((cos * u + sin * v) * 2).floor() + ((cos * v - sin * u) * 2).floor()
        inside = u * u + v * v < 81
        return torch.where(inside, torch.where(dark % 2 == 0, 0.1, 0.9), 0.85), torch.tensor(4.0)

    return picture


def turning(angle: float) -> Tensor:
    """Motion to where the turned disc was before."""
    x, y = torch.arange(W) + 0.5 - W / 2, (torch.arange(H) + 0.5 - H / 2)[:, None]
    cos, sin = np.cos(angle), np.sin(angle)
    motion = torch.stack((cos * x + sin * y - x, cos * y - sin * x - y))[None]
    return torch.where((x * x + y * y < 81)[None, None], motion, 0.0).float()


def test_a_fine_checker_that_turns_is_texture_wherever_it_is_and_never_shading() -> None:
    found = classify(ranges(checker(0.4)), ranges(checker(0.3)), turning(0.1), turning(0.1))
    x, y = (torch.arange(W) + 0.5 - W / 2).abs(), (torch.arange(H) + 0.5 - H / 2).abs()[:, None]
    whole, touched = (x + 0.5) ** 2 + (y + 0.5) ** 2 < 81, (x - 0.5) ** 2 + (y - 0.5) ** 2 < 81
    texture = where(found.aliasing, TEXTURE)
    assert bool(texture[whole].all())
    assert not texture[~touched].any()
    assert not where(found.aliasing, GEOMETRY).any()
    assert not where(found.ghosting, SHADING).any()
    assert not where(found.ghosting, VISIBILITY).any()


def test_pixels_with_a_silhouette_are_geometry_whatever_their_colours() -> None:
    found = classify(ranges(card(10.5)), None, still())
    edges = box(slice(6, 18), slice(10, 11)) | box(slice(6, 18), slice(22, 23))
    assert torch.equal(where(found.aliasing, GEOMETRY), edges)
    assert not where(found.aliasing, TEXTURE).any()


def test_a_floor_seen_at_a_slant_has_no_edges_up_to_its_horizon() -> None:
    """Depth varies by far more than 1 % inside of its pixels. At the horizon it does end."""
    floor: Picture = lambda x, y: (torch.tensor(0.4), torch.where(y > 4, 40 / (y - 4).clamp(min=1e-3), SKY) + 0 * x)  # noqa: E731
    geometry = where(classify(ranges(floor), None, still()).aliasing, GEOMETRY)
    assert not geometry[:4].any()
    assert not geometry[6:].any()


@pytest.mark.parametrize(
    ("turned", "bent", "kind"), [(0.6, 0.0, GEOMETRY), (0.0, 0.6, TEXTURE), (0.6, 0.9, GEOMETRY), (0.4, 0.4, NONE)]
)
def test_normals_of_surfaces_are_geometry_and_those_of_normal_maps_texture(
    turned: float, bent: float, kind: int
) -> None:
    wall: Picture = lambda x, y: (torch.tensor(0.3), torch.tensor(3.0))  # noqa: E731
    found = classify(ranges(wall, turned, bent), None, still())
    assert bool(where(found.aliasing, kind).all())


def test_faint_light_in_a_dark_channel_is_no_texture() -> None:
    faint: Picture = lambda x, y: (torch.where(x % 1 < 0.5, 0.0, 0.005), torch.tensor(3.0))  # noqa: E731
    assert bool(where(classify(ranges(faint), None, still()).aliasing, NONE).all())


# Clips and the command.


def write(folder: Path, pictures: list[Picture], motions: list[Tensor]) -> Path:
    """A clip at half the size of its references and ranges."""
    channels = [f"color_{end}.{c}" for end in ("min", "max") for c in "RGB"]
    channels += ["depth_min.Z", "depth_max.Z", "normal_spread.Y", "geometric_spread.Y"]
    for number, (picture, motion) in enumerate(zip(pictures, motions, strict=True)):
        r = ranges(picture)
        planes = torch.cat((r.low, r.high, r.near, r.far, r.bent, r.turned), 1)[0].numpy()
        name = f"{number:04d}.exr"
        exr.write(folder / "ranges" / name, dict(zip(channels, planes, strict=True)))
        exr.write(folder / "masks" / name, {"motion.X": motion[0, 0].numpy(), "motion.Y": motion[0, 1].numpy()})
        small = {"color": r.high[0, :, ::2, ::2].numpy(), "depth": r.near[0, :, ::2, ::2].numpy()}
        small["motion"] = motion[0, :, ::2, ::2].numpy() / 2
        record = Record(number=number, time=float(number), jitter=(0.25, 0.25 - 0.5 * (number % 2)))
        write_frame(folder, record, small, reference=r.high[0].numpy())
    finish(folder, fps=30.0, scale=2.0)
    return folder


@pytest.fixture
def clip(tmp_path: Path) -> Path:
    lefts = (6, 10, 14)
    return write(tmp_path / "clip", [card(x) for x in lefts], [sliding(x, 4) for x in lefts])


def test_labels_of_a_clip_are_those_of_its_frames(clip: Path) -> None:
    opened_clip = open_clip(clip)
    first, second, third = (labels(opened_clip, k) for k in range(3))
    assert bool(where(first.ghosting, VISIBILITY).all())
    assert torch.equal(where(second.ghosting, VISIBILITY), box(slice(6, 18), slice(6, 11)))
    assert torch.equal(where(third.ghosting, VISIBILITY), box(slice(6, 18), slice(10, 15)))


def test_the_picture_shows_each_class_in_its_colour_and_half() -> None:
    classes = torch.full((1, 1, H, W), NONE, dtype=torch.uint8)
    ghosting, aliasing = classes.clone(), classes.clone()
    ghosting[..., 3, 4], ghosting[..., 5, 6], aliasing[..., 7, 8], aliasing[..., 9, 10] = 0, 1, 0, 1
    page = overlay(torch.full((1, 3, H, W), 0.5), Labels(ghosting, aliasing)).astype(int)
    grey = page[0, 0]
    assert len(set(grey.tolist())) == 1
    for (row, column), name in zip(
        ((3, 4), (5, 6), (7, 8 + W), (9, 10 + W)), ("visibility", "shading", "geometry", "texture"), strict=True
    ):
        assert int(np.abs(page[row, column] - 0.35 * grey - 0.65 * np.array(COLORS[name])).max()) <= 1
    assert int((page != grey).any(2).sum()) == 4


def test_the_command_writes_a_picture(clip: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "labels.png"
    assert main(["labels", str(clip), "-o", str(out), "--frame", "2"]) == 0
    assert "frame 2" in capsys.readouterr().out
    page = np.asarray(Image.open(out)).astype(int)
    page = page[-H:]
    assert page.shape == (H, 2 * W, 3)
    reddish = page[..., 0] - page[..., 1] > 40
    assert torch.equal(torch.from_numpy(reddish[:, :W]), box(slice(6, 18), slice(10, 15)))


def test_what_is_missing_is_said_in_a_sentence(clip: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    one = write(tmp_path / "one", [card(6)], [still()])
    for arguments, sentence in (
        ([str(one)], "holds one frame, which has no history to fail"),
        ([str(clip), "--frame", "7"], "has no frame 7 (it has 0 to 2)"),
    ):
        assert main(["labels", *arguments, "-o", str(tmp_path / "x.png")]) == 2
        assert sentence in capsys.readouterr().err
    shutil.rmtree(clip / "ranges")
    with pytest.raises(ClipError, match=r"has no sample ranges .* framecast render SCENE -o CLIP --ranges"):
        labels(open_clip(clip), 1)
    assert not (tmp_path / "x.png").exists()
