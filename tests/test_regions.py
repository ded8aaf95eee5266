"""Regions of a frame: each law on a picture whose answer is plain."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from conftest import disc_frame, write_disc_clip

from framecast import exr
from framecast.clip import Clip
from framecast.evaluate import Footage, Made, change, neighbours
from framecast.frame import SKY
from framecast.regions import border, hidden, moving_shading, regions, static, thin
from framecast.warp import warp


def test_wires_are_thin_and_walls_are_not() -> None:
    depth = torch.full((1, 1, 12, 16), 8.0)
    depth[..., 3] = 2.0  # one pixel wide
    depth[..., 7:9] = 2.0  # two
    depth[..., 11:14] = 2.0  # three
    expected = torch.zeros(16, dtype=torch.bool)
    expected[[3, 7, 8]] = True
    assert torch.equal(thin(depth)[0, 0, 5], expected)
    assert torch.equal(thin(torch.where(depth == 8, SKY, depth))[0, 0, 5], expected)  # before the sky too


def test_a_slanted_floor_and_a_small_step_are_not_thin() -> None:
    slanted = torch.linspace(2, 40, 16).expand(1, 1, 12, 16).contiguous()
    step = torch.full((1, 1, 12, 16), 8.0)
    step[..., 5] = 7.6
    assert not thin(slanted).any()
    assert not thin(step).any()


def test_the_border_is_a_sixteenth_of_the_height() -> None:
    mask = border(torch.ones(1, 1, 64, 100))[0, 0]
    assert mask.sum() == 64 * 100 - 56 * 92
    assert mask[:4].all()
    assert not mask[4:60, 4:96].any()


def test_what_moves_on_the_screen_is_not_static() -> None:
    motion = torch.zeros(1, 2, 2, 3)
    motion[0, :, 0, 1] = torch.tensor([0.04, 0.04])
    motion[0, 1, 1, 2] = 0.04
    assert static(motion)[0, 0].tolist() == [[True, False, True], [True, True, True]]


def test_moving_shading_is_read_from_the_masks_of_the_frame(disc_clip: Clip) -> None:
    assert moving_shading(disc_clip, 2) is None
    change = np.zeros((64, 96), np.float16)
    change[8:12, 20:24] = 0.5
    exr.write(disc_clip.path / "masks" / "0003.exr", {"shading.Y": change})
    found = moving_shading(disc_clip, 2)
    assert found is not None
    assert found.nonzero()[:, 2:].tolist() == [[y, x] for y in (4, 5) for x in (10, 11)]
    static_too = regions(disc_clip, 2, disc_clip[2], [disc_clip[1]])["static"]
    assert not (static_too & found).any()


def test_shaded_frames_look_back_to_the_frame_before_and_not_across_cuts(tmp_path: Path) -> None:
    clip = write_disc_clip(tmp_path, 7)
    assert neighbours(clip, 3, "shaded", "pass") == (2,)
    assert neighbours(clip, 4, "shaded", "extrapolate") == (2,)
    assert neighbours(clip, 0, "shaded", "pass") == ()
    assert neighbours(clip, 3, "generated", "interpolate") == (2, 4)


def made(time: int, offset: float = 0.0, before: Made | None = None) -> Made:
    color = disc_frame(time).color
    assert color is not None
    return Made(time, "generated", 0, color + offset, color, color + offset, color, before=before)


def warped(before: Made, now: Made, clip: Clip) -> float:
    """Mean difference of changes where both frames show the surface."""
    found = change(Footage(clip), replace(now, before=before))
    assert found is not None
    image, target, seen = found
    return float((image - target).abs()[seen.expand_as(image)].mean())


def test_a_steady_error_does_not_count_and_a_changing_one_does(disc_clip: Clip) -> None:
    assert warped(made(2, 0.1), made(3, 0.1), disc_clip) == pytest.approx(0, abs=1e-6)
    assert warped(made(2, 0.1), made(3, -0.1), disc_clip) == pytest.approx(0.2, abs=1e-6)


def test_changes_are_measured_along_motion_and_where_both_frames_show_the_surface(disc_clip: Clip) -> None:
    found = change(Footage(disc_clip), made(3, before=made(2)))
    assert found is not None
    _, target, seen = found
    frame = disc_frame(3)
    assert frame.motion is not None
    torch.testing.assert_close(target, frame.color - warp(disc_frame(2).color, frame.motion))
    assert not (seen & hidden(frame, [disc_frame(2)])).any()
    assert seen.float().mean() > 0.8


def test_nothing_changes_over_a_gap_or_a_cut(disc_clip: Clip) -> None:
    assert change(Footage(disc_clip), made(3, before=made(1))) is None
    assert change(Footage(disc_clip.every(1, start=3)), made(0, before=made(-1))) is None
