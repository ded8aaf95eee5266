"""What every method promises that makes shaded frames larger and generates none, whatever it computes."""

import copy
import sys
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
import torch
from torch.utils._pytree import tree_leaves

from framecast.fit import method_named
from framecast.frame import BUFFERS, SKY, Frame, concatenate
from framecast.methods import METHODS
from framecast.resample import jitter, phases

NAMES = [name for name in sorted(METHODS) if tuple(METHODS[name]().modes) == ("pass",)]  # type: ignore[arg-type]
TEMPORAL = [name for name in NAMES if METHODS[name]().history != 1]
EACH = [(name, scale) for name in NAMES for scale in METHODS[name]().scales]  # type: ignore[union-attr]
LEARNED = {name for name in NAMES if any(True for _ in METHODS[name]().parameters())}
"""Networks: what they make of a picture in motion is measured (docs/results/super-resolution.md) and no law."""
LAWFUL = [(name, scale) for name, scale in EACH if name not in LEARNED]

Picture = Callable[[torch.Tensor, torch.Tensor], torch.Tensor]
"""Brightness at positions x, y in pixels of the render size."""


def waves(x: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
    """Smooth, but with detail finer than the render size resolves."""
    return 0.4 + 0.15 * torch.sin(x * 0.7) * torch.cos(y * 0.5) + 0.15 * torch.sin(2.6 * x + 1.9 * y)


def edges(x: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
    """Slanted stripes with hard edges."""
    return 0.2 + 0.6 * (torch.remainder(x + 0.37 * y, 5.0) < 2.3)


def gradient(x: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
    return 0.2 + 0.006 * x + 0.01 * y


def grid(height: int, width: int, step: float = 1.0) -> tuple[torch.Tensor, torch.Tensor]:
    x, y = (torch.arange(width) + 0.5) * step, (torch.arange(height) + 0.5) * step
    return x.expand(height, width), y[:, None].expand(height, width)


def shot(
    t: int,
    scale: float,
    picture: Picture = waves,
    *,
    speed: float = 0.0,
    size: tuple[int, int] = (18, 24),
    **changes: Any,
) -> Frame:
    """Frame `t` of a picture that moves right by `speed` render pixels a frame, sampled where the jitter says."""
    height, width = size
    at = torch.tensor([jitter(t, phases(scale))])
    x, y = grid(height, width)
    color = picture(x + at[0, 0] - speed * t, y + at[0, 1]).expand(1, 3, height, width)
    motion = torch.zeros(1, 2, height, width)
    motion[:, 0] = -speed
    every: dict[str, Any] = {
        "color": color.contiguous(),
        "depth": torch.full((1, 1, height, width), 5.0),
        "motion": motion,
        "motion_next": -motion,
        "albedo": color.contiguous(),
        "normal": torch.zeros(1, 3, height, width),
        "roughness": torch.zeros(1, 1, height, width),
        "metallic": torch.zeros(1, 1, height, width),
        "object": torch.zeros(1, 1, height, width, dtype=torch.int32),
        "view": torch.eye(4)[None],
        "projection": torch.eye(4)[None],
    }
    frame = Frame(**every, jitter=at, time=torch.tensor([float(t)]), reset=torch.tensor([t == 0]), span=torch.ones(1))
    return replace(frame, **changes)


def truth(t: int, scale: float, picture: Picture = waves, *, speed: float = 0.0, size: tuple[int, int] = (18, 24)):
    """What the display should show: the mean over each of its pixels."""
    height, width = round(size[0] * scale), round(size[1] * scale)
    fine = 4
    x, y = grid(height * fine, width * fine, 1 / scale / fine)
    values = picture(x - speed * t, y).expand(1, 3, -1, -1)
    return torch.nn.functional.avg_pool2d(values, fine)


@torch.no_grad()
def played(method: Any, frames: list[Frame]) -> list[torch.Tensor]:
    """The images of the frames."""
    state, images = method.start(frames[0]), []
    for frame in frames:
        image, state = method(frame, state)
        images.append(image)
    return images


@torch.no_grad()
def state_after(method: Any, frames: list[Frame]) -> Any:
    state = method.start(frames[0])
    for frame in frames:
        _, state = method(frame, state)
    return state


def error(image: torch.Tensor, target: torch.Tensor) -> float:
    """Root mean square, away from the border."""
    return (image - target)[..., 4:-4, 4:-4].square().mean().sqrt().item()


@pytest.mark.parametrize("name", NAMES)
def test_documented_and_declared(name: str) -> None:
    method: Any = METHODS[name]()
    text = sys.modules[type(method).__module__].__doc__ or ""
    for word in ("Paper:", "Follows:", "Differs:", "Needs:", "Modes:", "State:"):
        assert word in text, f"{name} does not say {word}"
    assert set(method.needs) <= {*BUFFERS, "view", "projection"}
    assert method.needs_generated == ()
    assert not method.step_motion
    assert method.history is None or method.history >= 1


@pytest.mark.parametrize(("name", "scale"), EACH)
@pytest.mark.parametrize("size", [(12, 16), (9, 11)])
def test_images_are_as_large_as_they_should_be_and_finite(name: str, scale: float, size: tuple[int, int]) -> None:
    method = method_named(name, scale)
    for image in played(method, [shot(t, scale, size=size, speed=0.6) for t in range(3)]):
        assert image.shape == (1, 3, round(size[0] * scale), round(size[1] * scale))
        assert image.dtype == torch.float32
        assert bool(torch.isfinite(image).all())
        assert bool((image >= 0).all())


@pytest.mark.parametrize("name", NAMES)
def test_a_scale_it_cannot_make_is_refused_in_a_sentence(name: str) -> None:
    with pytest.raises(ValueError, match=f"{name} cannot make 7 times the size"):
        method_named(name, 7.0)


@pytest.mark.parametrize(("name", "scale"), LAWFUL)
@pytest.mark.parametrize("value", [0.0, 0.3, 40.0])
def test_a_constant_picture_stays_constant(name: str, scale: float, value: float) -> None:
    frames = [shot(t, scale, lambda x, y: torch.full_like(x, value), speed=0.4) for t in range(6)]
    for image in played(method_named(name, scale), frames):
        torch.testing.assert_close(image, torch.full_like(image, value), atol=1e-5, rtol=2e-4)


@pytest.mark.parametrize(("name", "scale"), LAWFUL)
def test_nothing_shifts_with_jitter(name: str, scale: float) -> None:
    """A slope keeps its place in every phase; half a pixel of shift would be 5 times the tolerance."""
    frames = [shot(t, scale, gradient) for t in range(8)]
    right = truth(0, scale, gradient)
    edge = round(3 * scale)
    for image in played(method_named(name, scale), frames):
        torch.testing.assert_close(
            image[..., edge:-edge, edge:-edge], right[..., edge:-edge, edge:-edge], atol=1e-3, rtol=0
        )


@pytest.mark.parametrize("name", NAMES)
def test_a_batch_of_two_is_two_batches_of_one(name: str) -> None:
    """Also when one of the two resets in the middle and the other does not, and their jitter differs."""
    method: Any = METHODS[name]()
    scale = method.config.scale
    one = [shot(t, scale, speed=0.4) for t in range(4)]
    two = [replace(shot(t + 5, scale, gradient, speed=-0.7), reset=torch.tensor([t in (0, 2)])) for t in range(4)]
    apart = [torch.cat(pair) for pair in zip(played(method, one), played(method, two), strict=True)]
    together = played(method, [concatenate(pair) for pair in zip(one, two, strict=True)])
    torch.testing.assert_close(torch.stack(together), torch.stack(apart), atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize("name", NAMES)
def test_a_reset_is_a_fresh_start(name: str) -> None:
    """Motion to a frame before the cut is not used, either."""
    method: Any = METHODS[name]()
    scale = method.config.scale
    after = [shot(t, scale, speed=0.4) for t in range(3)]
    assert after[0].motion is not None
    after[0] = replace(after[0], motion=torch.full_like(after[0].motion, 13.0))
    other = [shot(t, scale, gradient) for t in range(3)]
    for cut, fresh in zip(played(method, other + after)[3:], played(method, after), strict=True):
        assert torch.equal(cut, fresh)


@pytest.mark.parametrize("name", NAMES)
def test_frame_and_state_stay_as_they_were(name: str) -> None:
    method: Any = METHODS[name]()
    scale = method.config.scale
    state = state_after(method, [shot(t, scale, speed=0.4) for t in range(3)])
    frame = shot(3, scale, speed=0.4)
    before = copy.deepcopy((frame, state))
    with torch.no_grad():
        method(frame, state)
    for was, now in zip(tree_leaves(before), tree_leaves((frame, state)), strict=True):
        assert torch.equal(was, now)


@pytest.mark.parametrize("name", NAMES)
def test_what_is_not_needed_changes_nothing(name: str) -> None:
    method: Any = METHODS[name]()
    scale = method.config.scale
    frames = [shot(t, scale, speed=0.4) for t in range(3)]
    spare = dict.fromkeys({*BUFFERS, "view", "projection"} - set(method.needs))
    bare = [replace(frame, **spare) for frame in frames]
    for image, other in zip(played(method, frames), played(method, bare), strict=True):
        assert torch.equal(image, other)


@pytest.mark.parametrize("name", NAMES)
def test_a_buffer_that_is_needed_and_missing_is_named(name: str) -> None:
    method: Any = METHODS[name]()
    frame = shot(0, 2.0)
    state = method.start(frame)
    for field in method.needs:
        with pytest.raises(ValueError, match=f"has no {field}"):
            method(replace(frame, **{field: None}), state)


@pytest.mark.parametrize("name", TEMPORAL)
def test_motion_of_another_size_is_refused_in_a_sentence(name: str) -> None:
    method: Any = METHODS[name]()
    frame = shot(0, 2.0)
    object.__setattr__(frame, "motion", torch.zeros(1, 2, 36, 48))  # past the checks of types, which only tests have
    with pytest.raises(ValueError, match=r"motion has 48x36 pixels and color 24x18; .* needs all buffers at the size"):
        method.start(frame)


@pytest.mark.parametrize("name", TEMPORAL)
def test_frames_without_jitter_are_spoken_of_once_there_are_two(name: str, recwarn: pytest.WarningsRecorder) -> None:
    method: Any = METHODS[name]()
    scale = method.config.scale
    played(method, [shot(t, scale) for t in range(3)])
    played(method, [shot(0, scale, jitter=torch.zeros(1, 2)), shot(1, scale)])
    assert not recwarn.list
    with pytest.warns(UserWarning, match="these frames are not jittered"):
        played(method, [shot(t, scale, jitter=torch.zeros(1, 2)) for t in range(2)])


TEMPORAL_EACH = [(name, scale) for name, scale in LAWFUL if name in TEMPORAL]


@pytest.mark.parametrize(("name", "scale"), [(name, scale) for name, scale in EACH if name in TEMPORAL])
def test_a_still_picture_gets_better_and_then_stays(name: str, scale: float) -> None:
    """The error falls with the number of frames; after two periods of the jitter, and no fewer than 64 frames, no
    pixel changes by 1/255 in a whole period."""
    period = phases(scale)
    settled = max(64, 2 * period)
    small = (10, 12)
    images = played(method_named(name, scale), [shot(t, scale, size=small) for t in range(settled + period)])
    right = truth(0, scale, size=small)
    errors = [error(images[n - 1], right) for n in (1, max(period // 4, 4), settled)]
    assert errors[1] < (1 if name in LEARNED else 0.8) * errors[0]
    assert errors[2] < errors[1]
    late = torch.stack(images[settled:])[..., 2:-2, 2:-2]
    assert (late.amax(0) - late.amin(0)).max() < 1 / 255


@pytest.mark.parametrize(("name", "scale"), TEMPORAL_EACH)
def test_a_moving_picture_is_better_than_one_frame_enlarged(name: str, scale: float) -> None:
    """Wrong signs or units of motion or jitter would make it worse."""
    speed, count = 0.37, 12
    frames = [shot(t, scale, edges, speed=speed) for t in range(count)]
    right = [truth(t, scale, edges, speed=speed) for t in range(count)]
    made, plain = (played(method_named(which, scale), frames) for which in (name, "bilinear"))
    ours, theirs = (sum(error(i, r) for i, r in zip(x[6:], right[6:], strict=True)) for x in (made, plain))
    assert ours < 0.9 * theirs


@pytest.mark.parametrize("name", TEMPORAL)
def test_what_comes_from_off_screen_is_this_frames_alone(name: str) -> None:
    method: Any = METHODS[name]()
    scale = method.config.scale
    frames = [shot(0, scale, gradient), shot(1, scale)]
    assert frames[1].motion is not None
    frames[1] = replace(frames[1], motion=torch.full_like(frames[1].motion, 100.0))
    alone = replace(frames[1], reset=torch.tensor([True]))
    torch.testing.assert_close(played(method, frames)[1], played(method, [alone])[0], atol=1e-5, rtol=0)


@pytest.mark.parametrize("name", [name for name in TEMPORAL if name not in LEARNED])
def test_what_was_hidden_shows_nothing_of_what_hid_it(name: str) -> None:
    """A white wall before a dark one moves away fast: what it uncovers is dark at once."""
    method: Any = METHODS[name]()
    scale = method.config.scale
    frames = []
    for t in range(4):
        front = torch.zeros(1, 1, 18, 24, dtype=torch.bool)
        front[..., : 20 - 4 * t] = True
        motion = torch.zeros(1, 2, 18, 24)
        motion[:, :1] = torch.where(front, 4.0, 0.0)
        color = torch.where(front, 0.9, 0.1).expand(1, 3, 18, 24).contiguous()
        frames.append(shot(t, scale, color=color, motion=motion, depth=torch.where(front, 2.0, SKY)))
    image = played(method, frames)[3]
    uncovered = image[..., 3:-3, round(10 * scale) : round(12 * scale)]
    torch.testing.assert_close(uncovered, torch.full_like(uncovered, 0.1), atol=0.02, rtol=0)


@pytest.mark.parametrize("name", TEMPORAL)
def test_vectors_that_reach_part_of_the_way_lead_to_the_last_frame(name: str) -> None:
    """A renderer that skips every second frame writes vectors to the ones that it skipped."""
    method: Any = METHODS[name]()
    frames = [shot(t, method.config.scale, speed=0.75, motion_next=None) for t in range(4)]
    apart = [replace(frame, time=2 * frame.time) for frame in frames]
    step = [replace(frame, motion=frame.motion / 2) for frame in apart]  # type: ignore[operator]
    whole = [replace(frame, span=2 * frame.span) for frame in apart]
    images = (played(method, each)[-1] for each in (frames, whole, step))
    for image in (first := next(images), *images):
        torch.testing.assert_close(image, first, atol=1e-4, rtol=0)
