"""What every method promises that makes frames and makes all of them larger, whatever it computes."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
import torch
from test_methods import fed, full, request, still
from torch import Tensor
from torch.utils._pytree import tree_leaves

from framecast.fit import method_named, scale_of
from framecast.frame import BUFFERS, Frame, concatenate
from framecast.methods import METHODS

JOINT = [name for name, make in METHODS.items() if set(make().modes) - {"pass"} and scale_of(make()) > 1]  # type: ignore[arg-type]

NAMES = [*JOINT, "hold+bilinear", "bilinear+mobfgsr", "extrass-warp+taau", "taau+warp-occlusion"]

pytestmark = pytest.mark.parametrize("name", NAMES)


def shaded(start: float = 0, **size: int) -> list[Frame]:
    """Three shaded frames, two apart, each jittered by itself."""
    return [jittered(full(start + t, first=t == 0, **size)) for t in (0, 2, 4)]


def jittered(frame: Frame) -> Frame:
    """The frame with a jitter of its time."""
    jitter = {0: (0.1, 0.0), 1: (0.25, -0.3), 2: (-0.2, 0.1), 3: (0.0, 0.4)}[int(frame.time[0]) // 2 % 4]
    return replace(frame, jitter=torch.tensor([jitter]))


def generated(method: Any, frames: list[Frame], scene: Callable[[float], Frame] = full) -> Tensor:
    """The image half a gap beyond the frames, which start at 0, or between the last two of them."""
    image: Tensor = method(request(method, time(method), scene), fed(method, frames))[0]
    return image


def time(method: Any) -> float:
    return 5.0 if "extrapolate" in method.modes else 3.0


@pytest.fixture(autouse=True)
def without_gradients() -> Any:
    with torch.no_grad():
        yield


@pytest.mark.parametrize(("height", "width"), [(32, 48), (33, 47)])
def test_every_image_is_larger_finite_and_not_negative(name: str, height: int, width: int) -> None:
    method, size = method_named(name), {"height": height, "width": width}
    frames = shaded(**size)
    image, _ = method(frames[0], method.start(frames[0]))
    larger = tuple(round(side * scale_of(method)) for side in (height, width))
    for made in (image, generated(method, frames, lambda t: full(t, **size))):
        assert made.shape == (1, 3, *larger)
        assert made.dtype == torch.float32
        assert bool(torch.isfinite(made).all())
        assert bool((made >= 0).all())


def test_a_batch_of_two_is_two_batches_of_one(name: str) -> None:
    """Also when one of the two resets in the middle and the other does not."""
    method = method_named(name)
    one, two = shaded(0), shaded(1)
    two[2] = replace(two[2], reset=torch.tensor([True]))
    both = fed(method, [concatenate(pair) for pair in zip(one, two, strict=True)])
    requests = [request(method, time(method)), request(method, time(method) + 1)]
    together = method(concatenate(requests), both)[0]
    apart = [method(f, fed(method, clip))[0] for f, clip in zip(requests, (one, two), strict=True)]
    torch.testing.assert_close(together, torch.cat(apart), atol=1e-3, rtol=1e-3)


def test_a_reset_is_a_fresh_start(name: str) -> None:
    method = method_named(name)
    after = shaded()
    cut = fed(method, [jittered(full(7, first=True)), jittered(full(9)), after[0]])
    fresh = fed(method, after[:1])
    for frame in (*after[1:], request(method, time(method))):
        image, cut = method(frame, cut)
        same, fresh = method(frame, fresh)
        torch.testing.assert_close(image, same, atol=1e-3, rtol=1e-3)


def test_frame_and_state_stay_as_they_were(name: str) -> None:
    method = method_named(name)
    frames = shaded()
    state = fed(method, frames[:2])
    for frame in (frames[2], request(method, time(method))):
        before = [leaf.clone() if isinstance(leaf, Tensor) else leaf for leaf in tree_leaves((frame, state))]
        method(frame, state)
        for was, now in zip(before, tree_leaves((frame, state)), strict=True):
            assert torch.equal(was, now)


def test_what_stands_still_is_shown_alike_in_both_roles(name: str) -> None:
    """A frame in between, of what is shown since several frames, is what the shaded one shows."""
    method = method_named(name)
    frames = [jittered(still(t)) for t in (0.0, 2.0, 4.0)]
    state = fed(method, frames)
    image = method(request(method, time(method), still), state)[0]
    shown = method(replace(frames[2], time=torch.tensor([6.0])), state)[0]
    assert float((image - shown).abs().mean()) < 0.03


def test_what_is_needed_is_used(name: str) -> None:
    """`needs` claims no buffer that the method can do without."""
    method = method_named(name)
    refused = pytest.raises((AssertionError, AttributeError, TypeError, ValueError))
    assert "color" in method.needs
    assert {*method.needs, *method.needs_generated} <= {*BUFFERS, "view", "projection"}
    for field in set(method.needs) - {"color"}:
        with refused:
            generated(method, [replace(f, **{field: None}) for f in shaded()])
    for field in method.needs_generated:
        with refused:
            generated(method, shaded(), lambda t, field=field: replace(full(t), **{field: None}))
