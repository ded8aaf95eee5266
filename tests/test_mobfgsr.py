"""What the paper promises: exact quadratic motion, the nearest surface in front, closed gaps, revealed background."""

from dataclasses import replace

import pytest
import torch
from conftest import disc_frame

from framecast.frame import Frame, moment
from framecast.methods.mobfgsr import Config, MobFGSR, path, refine
from framecast.warp import EMPTY, key_depth, splat

DEFAULT = Config()


def run(frames: list[Frame], time: float, config: Config = DEFAULT) -> torch.Tensor:
    method = MobFGSR(config)
    state = method.start(frames[0])
    for frame in frames:
        _, state = method(frame, state)
    return method(moment(time), state)[0]


def moving(x: torch.Tensor, dx_prev: float, *, time: float) -> Frame:
    """A textured plane shifted as a whole: colour is a function of column - x(time)."""
    color = (0.5 + 0.4 * torch.sin((torch.arange(48) + 0.5 - x) * 0.8)).expand(1, 3, 16, 48).contiguous()
    motion = torch.zeros(1, 2, 16, 48)
    motion[:, 0] = dx_prev
    return Frame(
        color=color,
        depth=torch.full((1, 1, 16, 48), 3.0),
        motion=motion,
        jitter=torch.zeros(1, 2),
        time=torch.tensor([float(time)]),
        reset=torch.tensor([False]),
        span=torch.ones(1),
    )


def shift(t: float) -> float:
    return 3 * t + 0.5 * t * t


@pytest.mark.parametrize("dt", [-0.75, -0.5, -0.25, 0.5, 1.0])
def test_quadratic_motion_is_exact(dt: float) -> None:
    """Constant acceleration: the path from two vectors meets the true position at every time (figure 3)."""
    prev = moving(torch.tensor(shift(1)), shift(0) - shift(1), time=1)
    current = moving(torch.tensor(shift(2)), shift(1) - shift(2), time=2)
    inner = path(current, prev).displacement(torch.tensor([dt]))[:, :, :, 10:-10]
    torch.testing.assert_close(inner[:, 0], torch.full_like(inner[:, 0], shift(2 + dt) - shift(2)))


@pytest.mark.parametrize("time", [1.25, 1.5, 2.5])
def test_a_shifted_texture_lands_where_it_should(time: float) -> None:
    frames = [moving(torch.tensor(shift(t)), shift(t - 1) - shift(t), time=t) for t in (0, 1, 2)]
    image = run(frames, time)
    truth = moving(torch.tensor(shift(time)), 0, time=time).color
    still = frames[2].color
    error = (image - truth)[..., 12:-12].abs().mean()
    assert error < 0.15 * (still - truth)[..., 12:-12].abs().mean()


def test_without_a_usable_earlier_vector_motion_is_straight() -> None:
    prev = replace(moving(torch.tensor(3.0), 99.0, time=1), depth=torch.full((1, 1, 16, 48), 9.0))
    current = moving(torch.tensor(6.0), -3.0, time=2)
    moved = path(current, prev).displacement(torch.tensor([1.0]))
    assert (moved[:, 0] == 3).all()
    reset = replace(prev, depth=current.depth, reset=torch.tensor([True]))
    assert (path(current, reset).displacement(torch.tensor([1.0]))[:, 0] == 3).all()
    twice = moving(torch.tensor(3.0), -6.0, time=1)  # it slows down; or is as fast, over twice the time
    assert (path(current, twice).displacement(torch.tensor([1.0]))[:, 0, :, 3:] == 0).all()
    even = replace(twice, span=torch.tensor([2.0]))
    assert (path(current, even).displacement(torch.tensor([1.0]))[:, 0] == 3).all()


@pytest.mark.parametrize("time", [2.5, 3.5])
def test_a_crossing_disc_is_generated_in_the_right_place(time: float) -> None:
    """Interpolated and extrapolated, with true vectors and with estimated ones, the picture is close to the truth."""
    truth = disc_frame(time)
    core = torch.nn.functional.avg_pool2d(truth.object.float(), 5, 1, 2) == 1
    held = (disc_frame(3).color - truth.color).abs()[:, :1][core].mean()
    for config, forward in ((Config(), True), (Config(motion="quadratic"), False)):
        image = run([disc_frame(t, forward=forward) for t in (1, 2, 3)], time, config)
        assert (image - truth.color).abs()[:, :1][core].mean() < 0.3 * held


def test_the_nearest_surface_wins_where_two_meet() -> None:
    """Two discs' depths land on one pixel: the key keeps the smaller one."""
    depth = torch.full((1, 1, 1, 3), 5.0)
    depth[..., 0] = 2
    to = torch.zeros(1, 2, 1, 3)
    to[:, 0, :, 0], to[:, 0, :, 2] = 1, -1
    assert key_depth(splat(depth, to))[0, 0, 0].tolist() == [float("inf"), 2, float("inf")]


def bordered(keys: torch.Tensor) -> torch.Tensor:
    return torch.nn.functional.pad(keys, (1, 1, 1, 1), value=float(EMPTY))


def test_gaps_one_pixel_wide_are_closed_and_wide_holes_stay() -> None:
    far = (9 << 32) + 8
    keys = torch.full((1, 7, 9), far)
    keys[:, :, 3] = EMPTY  # a crack
    assert (refine(bordered(keys), 0.02)[:, 1:-1, 3] == far).all()
    keys[:, :, 2:5] = EMPTY  # a hole
    assert (refine(bordered(keys), 0.02)[:, 1:-1, 3] == EMPTY).all()


def test_background_seen_through_a_spread_surface_is_covered() -> None:
    """A near surface grows by a quarter, its cracks show the wall: they are closed with the surface."""
    wall, card = torch.tensor(8.0).view(torch.int32).item() << 32, torch.tensor(2.0).view(torch.int32).item() << 32
    keys = torch.full((1, 7, 9), wall)
    keys[:, :, 2:7] = card + 5
    keys[:, :, 4] = wall + 3
    assert (refine(bordered(keys), 0.02)[:, 1:-1, 4] == card + 5).all()
    assert (refine(bordered(keys), 0.02)[:, :, 0] == wall).all()


def test_brightness_threshold_takes_the_nearer_frame_alone() -> None:
    """Eq. 1: equal brightness, alpha 0.25 takes the earlier frame, 0.75 the later one; 0 mixes."""
    a, b = disc_frame(1), disc_frame(2)
    still = {"motion": torch.zeros_like(a.motion), "motion_next": torch.zeros_like(a.motion), "depth": a.depth}
    a = replace(a, **still)
    b = replace(b, **still, color=a.color + 0.01)
    for time, expected in ((1.25, a.color), (1.75, b.color)):
        assert torch.allclose(run([a, b], time, Config(brightness_threshold=0.13)), expected, atol=1e-3)
    mixed = run([a, b], 1.25)
    assert torch.allclose(mixed, a.color + 0.0025, atol=1e-3)


def test_after_a_reset_nothing_of_the_old_shot_is_used() -> None:
    old = [disc_frame(t) for t in (1, 2)]
    cut = replace(disc_frame(3), color=torch.full((1, 3, 32, 48), 7.0), reset=torch.tensor([True]))
    assert (run([*old, cut], 3.5) == 7).all()
