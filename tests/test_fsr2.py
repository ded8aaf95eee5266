"""The parts of FSR2 by themselves, and a wire that they keep visible."""

import pytest
import torch
from test_super_resolution import Picture, grid, played, shot, truth

from framecast.frame import perspective, project, world_position
from framecast.methods import fsr2
from framecast.methods.filters import Lanczos
from framecast.methods.fsr2 import FSR2, coarse_brightness, hidden_before, ridges
from framecast.methods.larger import torn


def line(width: int) -> torch.Tensor:
    """A bright column `width` pixels wide on grey."""
    luma = torch.full((1, 1, 9, 12), 0.4)
    luma[..., 4 : 4 + width] = 0.9
    return luma


def test_a_line_of_one_pixel_is_locked_and_one_of_two_is_not() -> None:
    locked = ridges(line(1))
    assert bool(locked[..., 4].all())
    assert int(locked.sum()) == 9
    assert not bool(ridges(line(2)).any())
    assert bool(ridges(1.3 - line(1))[..., 4].all())  # dark on bright, too


def test_slopes_and_edges_are_not_locked() -> None:
    x, y = grid(9, 12)
    assert not bool(ridges((0.2 + 0.05 * x + 0.02 * y)[None, None]).any())
    assert not bool(ridges(torch.where(x > 5, 0.9, 0.4)[None, None]).any())


def floor(turn: float) -> tuple[torch.Tensor, torch.Tensor]:
    """Depth of a slanted plane, and its motion as the camera turned by `turn` radians since the last frame."""
    height, width = 24, 32
    x, y = grid(height, width)
    depth = (6 / (0.3 + 0.02 * y + 0.004 * x))[None, None]
    lens = perspective(0.9, width / height)[None]
    now, c, s = torch.eye(4)[None], torch.cos(torch.tensor(turn)), torch.sin(torch.tensor(turn))
    before = torch.tensor([[c, 0, s, 0], [0, 1, 0, 0], [-s, 0, c, 0], [0, 0, 0, 1]])[None]
    there, _ = project(world_position(depth, now, lens), before, lens)
    return depth, there - torch.stack((x, y))


def test_a_plane_under_a_turning_camera_hides_nothing() -> None:
    depth, motion = floor(0.03)
    assert motion.abs().max() > 0.5
    assert hidden_before(depth, motion)[..., 2:-2, 2:-2].max() < 0.01


def test_what_something_nearer_covered_was_hidden() -> None:
    """A box that moved right by six pixels uncovers six columns on its left, and nothing else."""
    depth, motion = torch.full((1, 1, 12, 30), 10.0), torch.zeros(1, 2, 12, 30)
    depth[..., 14:20], motion[:, 0, :, 14:20] = 3.0, -6.0
    hidden = hidden_before(depth, motion)[0, 0]
    assert hidden[:, 9:13].min() > 0.9
    assert hidden[:, :7].max() == 0
    assert hidden[:, 14:].max() == 0


@pytest.mark.parametrize("speed", [0.5, 3.0])
def test_what_lies_beside_something_fast_has_no_history(speed: float) -> None:
    """The ring of one pixel around a box, whose vectors those of the box replace; the box itself keeps its own."""
    depth, motion = torch.full((1, 1, 12, 30), 10.0), torch.zeros(1, 2, 12, 30)
    depth[..., 4:8, 14:20], motion[:, 0, 4:8, 14:20] = 3.0, -speed
    ring = torch.zeros(12, 30, dtype=torch.bool)
    ring[3:9, 13:21], ring[4:8, 14:20] = speed > 1, False
    assert torch.equal(torn(depth, motion)[0, 0], ring)


def test_coarse_brightness_is_that_of_eight_pixels() -> None:
    luma = torch.full((1, 1, 16, 24), 0.25)
    torch.testing.assert_close(coarse_brightness(luma, (32, 48)), torch.full((1, 1, 32, 48), 0.25))
    luma[..., :8] = 0.5
    made = coarse_brightness(luma, (32, 48))
    torch.testing.assert_close(made[..., :8], torch.full((1, 1, 32, 8), 0.5))
    torch.testing.assert_close(made[..., -16:], torch.full((1, 1, 32, 16), 0.25))


def wire(thickness: float) -> Picture:
    """Dark, of a thickness in display pixels, and slanted a little: single frames miss parts of it."""
    return lambda x, y: torch.where((y - 0.07 * x - 8.2).abs() < thickness / 4, 0.05, 0.6)


@pytest.mark.parametrize("thickness", [0.75, 1.0])
@pytest.mark.parametrize("speed", [0.21, 0.7])
def test_a_wire_stays_visible_in_motion(monkeypatch: pytest.MonkeyPatch, thickness: float, speed: float) -> None:
    """Frames by themselves show it in dashes; with locks it is there in every column of every late frame, with at least
    half of the contrast that it has where it shares two rows of the reference."""
    size, count = (16, 32), 28
    frames = [shot(t, 2, wire(thickness), speed=speed, size=size) for t in range(count)]
    right = [truth(t, 2, wire(thickness), speed=speed, size=size) for t in range(20, count)]

    def least(images: list[torch.Tensor]) -> float:
        """Contrast of the wire where it is weakest."""
        return min((0.6 - image[0, 1, :, 8:-8].amin(0)).min().item() for image in images)

    alone, together = (least(played(method, frames)[20:]) for method in (Lanczos(), FSR2()))
    monkeypatch.setattr(fsr2, "ridges", lambda luma: luma < 0)
    without = least(played(FSR2(), frames)[20:])
    assert alone < 0.02
    assert together > 0.5 * least(right)
    assert together > 2 * without


def test_vectors_grow_as_the_image_does_at_sizes_that_do_not_divide() -> None:
    motion = fsr2.enlarged(shot(1, 1.5, size=(9, 37), speed=4.0), 1.5).motion
    torch.testing.assert_close(motion[:, 0], torch.full_like(motion[:, 0], -4 * 56 / 37))
