"""What every method that generates frames promises, whatever it computes; `test_joint.py`: those that enlarge, too."""

import copy
import sys
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
import torch
from conftest import disc_frame
from torch import nn
from torch.utils._pytree import tree_leaves

from framecast.fit import scale_of
from framecast.frame import BUFFERS, Frame, concatenate, moment, perspective, unshaded
from framecast.methods import METHODS

OPTIONAL = {"motion_next"}
"""Fields that methods may use where a clip has them, without asking for them."""

GUIDED = {"extrass-warp", "extrass-refined"}
"""Methods to which objects are such a field."""

EVERYTHING = (*BUFFERS, "view", "projection")


def optional(name: str) -> set[str]:
    """Those of a method."""
    return OPTIONAL | ({"object"} if name in GUIDED else set())


GENERATING = [
    name
    for name in sorted(METHODS)
    if set(METHODS[name]().modes) - {"pass"} and scale_of(METHODS[name]()) == 1  # type: ignore[arg-type]
]

pytestmark = pytest.mark.parametrize("name", GENERATING)


def camera() -> torch.Tensor:
    """A view matrix that is neither the identity nor symmetric."""
    c, s = torch.cos(torch.tensor(0.3)), torch.sin(torch.tensor(0.3))
    return torch.tensor([[c, 0, s, 0.7], [0, 1, 0, -0.2], [-s, 0, c, 3.0], [0, 0, 0, 1]])[None]


def full(time: float, *, height: int = 32, width: int = 48, first: bool = False) -> Frame:
    """A frame of the moving disc with every buffer, vectors over the gap of 2 to the neighbouring shaded frames."""
    frame = disc_frame(time, step=2, height=height, width=width)
    assert frame.color is not None
    return replace(
        frame,
        albedo=frame.color.clamp(0.1, 1),
        normal=torch.tensor([0.0, 0.6, 0.8]).view(1, 3, 1, 1).expand_as(frame.color),
        roughness=frame.color[:, :1],
        metallic=frame.color[:, 1:2],
        view=camera(),
        projection=perspective(0.9, width / height)[None],
        reset=torch.tensor([first]),
    )


def still(time: float) -> Frame:
    """The scene as it is at 0, standing still."""
    frame = full(0)
    assert frame.motion is not None
    zero = torch.zeros_like(frame.motion)
    reset = torch.tensor([time == 0])
    return replace(frame, motion=zero, motion_next=zero, time=torch.tensor([time]), reset=reset)


def request(method: nn.Module, time: float, scene: Callable[[float], Frame] = full) -> Frame:
    """A frame to generate: its time alone, or what the scene shows then where the method needs G-buffers."""
    return unshaded(scene(time)) if method.needs_generated else moment(time)


def shaded(start: float = 0, **size: int) -> list[Frame]:
    """Three shaded frames, two apart."""
    return [full(start + t, first=t == 0, **size) for t in (0, 2, 4)]


def fed(method: nn.Module, frames: list[Frame]) -> Any:
    """The state after the frames."""
    state = method.start(frames[0])
    for frame in frames:
        _, state = method(frame, state)
    return state


def times(method: nn.Module) -> list[float]:
    """Moments between the last two of `shaded`, and beyond, as far as the method serves them."""
    between = [2.25, 3.0, 3.9] if "interpolate" in method.modes else []
    return between + ([4.3, 5.0, 6.0] if "extrapolate" in method.modes else [])


def generated(method: nn.Module, frames: list[Frame], scene: Callable[[float], Frame] = full) -> list[torch.Tensor]:
    """The images at all `times` after the frames, which start at 0."""
    state = fed(method, frames)
    return [method(request(method, t, scene), state)[0] for t in times(method)]


def test_documented_and_declared(name: str) -> None:
    method = METHODS[name]()
    text = sys.modules[type(method).__module__].__doc__ or ""
    for word in ("Paper:", "Follows:", "Differs:", "Needs:", "Modes:", "State:"):
        assert word in text, f"{name} does not say {word}"
    assert set(method.needs) | set(method.needs_generated) <= set(EVERYTHING)
    assert method.modes
    assert set(method.modes) <= {"interpolate", "extrapolate", "pass"}
    assert method.history is None or method.history >= 1
    assert isinstance(method.step_motion, bool)


@pytest.mark.parametrize(("height", "width"), [(32, 48), (33, 47), (5, 9)])
def test_images_of_the_same_size_finite_and_not_negative(name: str, height: int, width: int) -> None:
    method = METHODS[name]()
    size = {"height": height, "width": width}
    images = generated(method, shaded(**size), lambda t: full(t, **size))
    assert images
    for image in images:
        assert image.shape == (1, 3, height, width)
        assert image.dtype == torch.float32
        assert bool(torch.isfinite(image).all())
        assert bool((image >= 0).all())


def test_shaded_frames_pass_through(name: str) -> None:
    method = METHODS[name]()
    frames = shaded()
    state = method.start(frames[0])
    for frame in frames:
        image, state = method(frame, state)
        assert torch.equal(image, frame.color)


def test_a_batch_of_two_is_two_batches_of_one(name: str) -> None:
    """Also when one of the two resets in the middle and the other does not."""
    method = METHODS[name]()
    one, two = shaded(0), shaded(1)
    two[2] = replace(two[2], reset=torch.tensor([True]))
    states = [fed(method, clip) for clip in (one, two)]
    both = fed(method, [concatenate(pair) for pair in zip(one, two, strict=True)])
    for t in times(method):
        requests = [request(method, t), request(method, t + 1)]
        apart = [method(f, s)[0] for f, s in zip(requests, states, strict=True)]
        together, _ = method(concatenate(requests), both)
        torch.testing.assert_close(together, torch.cat(apart), atol=1e-5, rtol=1e-5)


def test_a_reset_is_a_fresh_start(name: str) -> None:
    method = METHODS[name]()
    after = shaded()
    cut = fed(method, [full(7, first=True), full(9), *after[:1]])
    fresh = fed(method, after[:1])
    for t in (0.5, 2.0):
        assert torch.equal(*(method(request(method, t), state)[0] for state in (cut, fresh)))
    for frame in after[1:]:
        _, cut = method(frame, cut)
        _, fresh = method(frame, fresh)
        for t in (frame.time.item() - 0.5, frame.time.item() + 0.5):
            assert torch.equal(*(method(request(method, t), state)[0] for state in (cut, fresh)))


def test_right_after_a_reset_the_image_is_a_picture_of_the_scene(name: str) -> None:
    """Motion to a frame before the cut must not be used: where nothing else is known the image stands still."""
    method = METHODS[name]()
    first = full(0, first=True)
    assert first.motion is not None
    wild = replace(first, motion=torch.full_like(first.motion, 13.0), motion_next=None)
    state = fed(method, [full(-4, first=True), wild])
    image, _ = method(request(method, 1.0, still), state)
    torch.testing.assert_close(image, first.color, atol=1e-3, rtol=0)


def test_frame_and_state_stay_as_they_were(name: str) -> None:
    method = METHODS[name]()
    frames = shaded()
    state = fed(method, frames[:2])
    for frame in (frames[2], *(request(method, t) for t in times(method))):
        before = copy.deepcopy((frame, state))
        method(frame, state)
        for was, now in zip(tree_leaves(before), tree_leaves((frame, state)), strict=True):
            assert torch.equal(was, now)


def test_generating_does_not_change_what_comes_after(name: str) -> None:
    method = METHODS[name]()
    frames = shaded()
    state = method.start(frames[0])
    for frame in frames:
        _, state = method(frame, state)
        _, state = method(request(method, frame.time.item() + 1), state)
    for t, image in zip(times(method), generated(method, frames), strict=True):
        assert torch.equal(method(request(method, t), state)[0], image)


def test_the_same_on_every_run(name: str) -> None:
    once, again = (generated(METHODS[name](), shaded()) for _ in range(2))
    assert all(torch.equal(a, b) for a, b in zip(once, again, strict=True))


def test_what_stands_still_stays(name: str) -> None:
    method = METHODS[name]()
    for image in generated(method, [still(t) for t in (0.0, 2.0, 4.0)], still):
        torch.testing.assert_close(image, full(0).color, atol=1e-3, rtol=0)


def test_what_is_not_needed_changes_nothing(name: str) -> None:
    method = METHODS[name]()
    frames = shaded()
    spare = dict.fromkeys(set(EVERYTHING) - {*method.needs, *optional(name)})
    unasked = dict.fromkeys(set(EVERYTHING) - {*method.needs_generated, *optional(name)})
    expected = generated(method, frames)
    bare = generated(method, [replace(f, **spare) for f in frames], lambda t: replace(full(t), **unasked))
    for image, other in zip(expected, bare, strict=True):
        assert torch.equal(image, other)


def test_works_without_optional_buffers(name: str) -> None:
    method = METHODS[name]()
    without = dict.fromkeys(optional(name))
    frames = [replace(f, **without) for f in shaded()]
    images = generated(method, frames, lambda t: replace(full(t), **without))
    assert all(bool(torch.isfinite(image).all()) for image in images)


def test_what_is_needed_is_used(name: str) -> None:
    """`needs` claims no buffer that the method can do without."""
    method = METHODS[name]()
    refused = pytest.raises((AssertionError, AttributeError, TypeError, ValueError))
    assert "color" in method.needs
    for field in set(method.needs) - {"color"}:
        with refused:
            generated(method, [replace(f, **{field: None}) for f in shaded()])
    for field in method.needs_generated:
        with refused:
            generated(method, shaded(), lambda t, field=field: replace(full(t), **{field: None}))
