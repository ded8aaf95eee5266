"""Methods after one another: what the second one is given, sizes, resets, memory, and what does not fit."""

from dataclasses import replace
from typing import Any

import pytest
import torch
from passing import H, W, shot
from torch import Tensor
from torch.utils._pytree import tree_leaves

from framecast.fit import method_named
from framecast.frame import Frame, concatenate, moment, unshaded
from framecast.methods.compose import Composed, enlarged, reaching
from framecast.methods.filters import Bilinear
from framecast.methods.larger import Config
from framecast.methods.taau import TAAU

JITTERS = ((0.0, 0.0), (0.25, -0.3), (-0.2, 0.1), (0.4, 0.2))


def shaded(count: int = 3, *, start: int = 0) -> list[Frame]:
    """Frames two apart, their vectors to the one before."""
    return [replace(shot(2.0 * t, jitter=JITTERS[t % 4]), time=torch.tensor([2.0 * t + start])) for t in range(count)]


def run(method: Any, frames: list[Frame]) -> tuple[list[Tensor], Any]:
    images, state = [], method.start(frames[0])
    with torch.no_grad():
        for frame in frames:
            image, state = method(frame, state)
            images.append(image)
    return images, state


@pytest.mark.parametrize("name", ["hold", "blend", "warp", "mobfgsr", "extrass-warp"])
def test_bilinear_after_a_method_enlarges_what_it_makes(name: str) -> None:
    both, alone, plain = method_named(f"{name}+bilinear"), method_named(name), Bilinear()
    frames = shaded()
    images, state = run(both, frames)
    own, known = run(alone, frames)
    for frame, image, small in zip(frames, images, own, strict=True):
        torch.testing.assert_close(image, plain(replace(frame, color=small), plain.start(frame))[0])
    asked = unshaded(shot(5.0, jitter=(0.1, 0.2))) if alone.needs_generated else moment(5.0)
    small, _ = alone(asked, known)
    torch.testing.assert_close(both(asked, state)[0], plain(replace(asked, color=small), plain.start(frames[0]))[0])


def test_a_method_after_bilinear_makes_frames_of_the_large_images() -> None:
    both, plain = method_named("bilinear+hold"), Bilinear()
    frames = shaded()
    images, state = run(both, frames)
    expected = [plain(frame, plain.start(frame))[0] for frame in frames]
    for image, large in zip(images, expected, strict=True):
        torch.testing.assert_close(image, large)
    assert torch.equal(both(moment(5.0), state)[0], images[-1])
    assert (both.config.scale, both.modes, both.needs_generated) == (2.0, ("interpolate", "extrapolate", "pass"), ())


def test_a_method_with_memory_sees_the_shaded_frames_alone() -> None:
    """Its image of a frame in between is what it makes of it after the last shaded one, and leaves no trace."""
    both, plain = method_named("hold+taau"), TAAU(Config(2.0))
    frames = shaded(4)
    _, state = run(both, frames[:3])
    _, known = run(plain, frames[:3])
    between = shot(5.0, jitter=(0.1, 0.2), span=1.0)
    held = replace(between, color=frames[2].color)
    image, after = both(unshaded(between), state)
    torch.testing.assert_close(image, plain(held, known)[0])
    for was, now in zip(tree_leaves(state), tree_leaves(after), strict=True):
        assert torch.equal(was, now)
    torch.testing.assert_close(both(frames[3], after)[0], plain(frames[3], known)[0])
    assert set(both.needs_generated) == {"depth", "motion"}


def test_an_interpolated_frame_is_made_larger_with_what_was_known_before_it() -> None:
    both, plain = method_named("blend+taau"), TAAU(Config(2.0))
    frames = shaded(3)
    _, state = run(both, frames)
    _, known = run(plain, frames[:2])
    between = shot(3.0, jitter=(0.1, 0.2), span=1.0)
    small, _ = method_named("blend")(moment(3.0), run(method_named("blend"), frames)[1])
    torch.testing.assert_close(both(unshaded(between), state)[0], plain(replace(between, color=small), known)[0])


def test_vectors_reach_the_frame_that_was_seen_last() -> None:
    """Those of a frame that reach one frame back are made twice as long where the second method saw the one before."""
    frame = shot(4.0, span=1.0)
    assert frame.motion is not None
    aimed = reaching(frame, torch.tensor([2.0]))
    assert aimed.motion is not None
    torch.testing.assert_close(aimed.motion, 2 * frame.motion)
    assert float(aimed.span) == 2
    reset = replace(frame, reset=torch.tensor([True]))
    assert torch.equal(reaching(reset, torch.tensor([2.0])).motion, frame.motion)  # type: ignore[arg-type]


def test_buffers_of_large_frames_are_those_of_the_nearest_samples() -> None:
    frame = shot(2.0, square=3.0)
    image = torch.rand(1, 3, 2 * H, 2 * W)
    large = enlarged(replace(frame, motion_next=frame.motion), image, 2.0)
    assert large.color is image
    for name in ("depth", "albedo", "normal", "object", "roughness"):
        small = getattr(frame, name)
        assert torch.equal(getattr(large, name), small.repeat_interleave(2, 2).repeat_interleave(2, 3))
    for name in ("motion", "motion_next"):
        values = getattr(large, name)
        assert torch.equal(values[..., ::2, ::2], 2 * frame.motion)  # type: ignore[operator]
    assert not large.jitter.any()


def test_both_cascades_of_networks_run_and_batch() -> None:
    for name in ("extranet+nsrr", "nsrr+extranet"):
        both = method_named(name)
        frames, asked = shaded(3), unshaded(shot(5.0, jitter=(0.1, 0.2), span=1.0))
        twice = [concatenate((frame, frame)) for frame in frames]
        images, state = run(both, frames)
        pairs, states = run(both, twice)
        with torch.no_grad():
            images.append(both(asked, state)[0])
            pairs.append(both(concatenate((asked, asked)), states)[0])
        for image, pair in zip(images, pairs, strict=True):
            assert image.shape == (1, 3, 2 * H, 2 * W)
            assert bool(torch.isfinite(image).all())
            torch.testing.assert_close(pair, image.expand_as(pair), atol=1e-3, rtol=1e-3)


@pytest.mark.parametrize("name", ["hold+taau", "taau+warp", "blend+bilinear"])
def test_a_reset_is_a_fresh_start(name: str) -> None:
    method = method_named(name)
    first, after = shaded(2), shaded(2, start=8)
    after[0] = replace(after[0], reset=torch.tensor([True]))
    asked = replace(unshaded(shot(3.0, span=1.0)), time=torch.tensor([11.0]))
    cut, late = run(method, [*first, *after])
    fresh, early = run(method, after)
    for image, same in zip((*cut[2:], method(asked, late)[0]), (*fresh, method(asked, early)[0]), strict=True):
        torch.testing.assert_close(image, same, atol=1e-4, rtol=1e-4)


def test_the_scale_is_that_of_the_method_that_makes_frames_larger() -> None:
    for name, scale in (("hold+bilinear", 3.0), ("bilinear+hold", 1.5), ("taa+bilinear", 2.0)):
        method = method_named(name, scale)
        assert isinstance(method, Composed)
        images, _ = run(method, shaded(2))
        assert images[1].shape[-2:] == (round(H * scale), round(W * scale))


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("extranet+hold", "both methods make frames .* one of them has to"),
        ("hold+nothing", "there is no method 'nothing'"),
        ("+bilinear", "there is no method ''"),
        ("extranet+nsrr-five-frames", "nsrr-five-frames has no weights of its own"),
    ],
)
def test_what_does_not_fit_is_refused(name: str, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        method_named(name)
    with pytest.raises(ValueError, match="nsrr cannot make 3 times the size"):
        method_named("extranet+nsrr", 3.0)
    with pytest.raises(ValueError, match=r"extranet-plus cannot make 1 times the size \(it can make 2\)"):
        method_named("extranet-plus", 1.0)


@pytest.mark.parametrize("name", ["taau+mobfgsr", "bilinear+bsr", "bilinear+warp"])
def test_after_one_frame_motion_is_not_known_and_the_image_stands_still(name: str) -> None:
    method = method_named(name)
    images, state = run(method, shaded(1))
    still = shot(1.0, speed=0.0, span=1.0)
    image, _ = method(unshaded(still) if method.needs_generated else moment(1.0), state)
    torch.testing.assert_close(image, images[0], atol=1e-3, rtol=0)
