"""What TAAU does beyond the contract: steady where one frame's neighbourhood is not, quick where light changes."""

from dataclasses import replace

import torch
from test_super_resolution import gradient, played, shot, state_after, truth

from framecast.methods.larger import Config
from framecast.methods.taau import TAAU
from framecast.resample import phases


def checker(x: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
    """Squares of one display pixel at twice the size: each frame sees one of the two colours alone."""
    return 0.1 + 0.8 * torch.remainder((2 * x).floor() + (2 * y).floor(), 2)


SMALL = (8, 10)
CHANGES = (0.05, 4.0)
"""What brightness is multiplied by."""


def test_a_checker_of_display_pixels_is_steady_and_there() -> None:
    period = phases(2)
    frames = [shot(t, 2, checker, size=SMALL) for t in range(64 + period)]
    seen = {frame.color[..., 2:-2, 2:-2].std().item() for frame in frames[:8] if frame.color is not None}
    assert max(seen) < 1e-6  # the trap: within a frame there is nothing to see
    images = torch.stack(played(TAAU(), frames)[64:])[..., 4:-4, 4:-4]
    assert (images.amax(0) - images.amin(0)).max() < 1 / 255
    right = truth(0, 2, checker, size=SMALL)[..., 4:-4, 4:-4]
    contrast = (images[-1] - images[-1].mean()) * (right - right.mean())
    assert contrast.mean() > 0.2 * (right - right.mean()).square().mean()


def test_a_change_of_light_does_not_wait() -> None:
    """On what is still, long settled and smooth, within two frames."""
    bright = [shot(t, 2, gradient, size=SMALL) for t in range(40)]
    for share in CHANGES:
        other = [shot(t, 2, lambda x, y, s=share: torch.full_like(x, 0.4 * s), size=SMALL) for t in range(40, 42)]
        image = played(TAAU(), bright + other)[-1]
        torch.testing.assert_close(image, torch.full_like(image, 0.4 * share), atol=0.02, rtol=0)


def test_what_stands_still_is_the_mean_of_its_samples_and_what_moves_forgets() -> None:
    still = state_after(TAAU(), [shot(t, 2, size=SMALL) for t in range(20)])
    moving = state_after(TAAU(), [shot(t, 2, size=SMALL, speed=0.25) for t in range(20)])
    inner = (slice(None), slice(None), slice(6, -6), slice(6, -6))
    assert still.weight[inner].mean() > 3 * moving.weight[inner].mean()
    assert moving.still[inner].max() == 0
    assert still.still[inner].min() >= 10


def test_history_is_read_where_it_was_at_sizes_that_do_not_divide() -> None:
    """37 pixels become 56, and vectors grow by that: 1.5 times as long they are 0.05 pixels off."""
    frames, method = [shot(t, 1.5, size=(9, 37), speed=4.0) for t in (0, 1)], TAAU(Config(1.5))
    state = state_after(method, frames[:1])
    columns = torch.arange(56.0).expand_as(state.color).contiguous()
    state = replace(state, color=columns, square=torch.full_like(state.square, 1e6))  # whose box holds everything
    moved = (method.look(frames[1], state).history.color - columns)[..., 9:-2]
    torch.testing.assert_close(moved, torch.full_like(moved, -4 * 56 / 37), atol=1e-3, rtol=0)
