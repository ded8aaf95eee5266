"""Larger images: what a still scene converges to, what a moving one keeps, and what is thrown away."""

from dataclasses import replace
from itertools import pairwise
from typing import Any

import pytest
import torch
from torch import Tensor

from framecast.color import to_display
from framecast.fit import method_named
from framecast.frame import Frame, concatenate, moment
from framecast.methods.mobfgsr import Config, MobFGSR
from framecast.methods.mobfgsr_sr import samples
from framecast.resample import jitter, phases

H, W = 16, 24


def scene(x: Tensor, y: Tensor) -> Tensor:
    """Colour at places in pixels of the small image: waves shorter than its pixels can show, and an edge."""
    waves = 0.4 + 0.1 * torch.sin(2.4 * x + 0.7 * y) + 0.1 * torch.cos(2.1 * y - 0.5 * x)
    return torch.stack((waves, waves * 0.8 + 0.1, torch.where(x + 0.5 * y > 13, 0.5, 0.3)))


def places(scale: float, offset: tuple[float, float] = (0.0, 0.0)) -> tuple[Tensor, Tensor]:
    y, x = torch.meshgrid(torch.arange(round(H * scale)), torch.arange(round(W * scale)), indexing="ij")
    return (x + 0.5) / scale + offset[0], (y + 0.5) / scale + offset[1]


def shot(time: int, *, speed: float = 0.0, scale: float = 2.0, card: float | None = None) -> Frame:
    """The scene passing by to the right, sampled with jitter; a grey card of depth 1 from column `card` on."""
    offset = jitter(time, phases(scale))
    x, y = places(1, offset)
    color, motion = scene(x - speed * time, y), torch.zeros(1, 2, H, W)
    motion[:, 0] = -speed
    depth = torch.full((1, 1, H, W), 5.0)
    if card is not None:
        hit = (x >= card) & (x < card + 8)
        color, depth = torch.where(hit, 0.05, color), torch.where(hit, 1.0, depth)
    return Frame(
        color=color[None],
        depth=depth,
        motion=motion,
        jitter=torch.tensor([offset]),
        time=torch.tensor([float(time)]),
        reset=torch.tensor([time == 0]),
        span=torch.tensor([1.0]),
    )


def truth(time: float, speed: float, scale: float = 2.0) -> Tensor:
    """The mean over each large pixel."""
    x, y = places(scale * 4)
    fine = scene(x - speed * time, y)[None]
    return torch.nn.functional.avg_pool2d(fine, 4)


def shown(method: MobFGSR, frames: list[Frame]) -> tuple[list[Tensor], Any]:
    state, images = method.start(frames[0]), []
    for frame in frames:
        image, state = method(frame, state)
        images.append(image)
    return images, state


def error(image: Tensor, time: float, speed: float = 0.0, scale: float = 2.0) -> float:
    edge = 6
    difference = to_display(image) - to_display(truth(time, speed, scale))
    return float(difference[..., edge:-edge, edge:-edge].square().mean())


def test_a_still_scene_converges_and_comes_to_rest() -> None:
    """64 jittered frames: the error falls, and at the end no pixel changes by more than 1/255 from frame to frame."""
    images, _ = shown(method_named("mobfgsr", 2.0), [shot(t) for t in range(64)])
    errors = [error(image, 0) for image in images]
    first, early, later, last = (sum(errors[a:b]) / (b - a) for a, b in ((0, 1), (4, 8), (16, 32), (48, 64)))
    assert last < later < early < first
    assert last < 0.25 * first
    displayed = [to_display(image) for image in images[-16:]]
    changes = [float((b - a).abs().max()) for a, b in pairwise(displayed)]
    assert max(changes) < 1 / 255


@pytest.mark.parametrize("scale", [1.5, 2.0, 3.0])
def test_samples_weigh_alike_across_and_down(scale: float) -> None:
    """Columns and rows, and their jitter, exchanged: the same weights exchanged. The released formula fails this."""
    color = torch.rand(1, 3, 8, 12)
    plain = samples(color, torch.tensor([[0.3, -0.1]]), scale, 1.5)
    turned = samples(color.transpose(2, 3).contiguous(), torch.tensor([[-0.1, 0.3]]), scale, 1.5)
    torch.testing.assert_close(turned.weight, plain.weight.transpose(2, 3))
    assert float(plain.weight.std()) > 0.1


@pytest.mark.parametrize("scale", [1.5, 2.0, 3.0])
def test_a_passing_scene_gains_detail_from_frames_before(scale: float) -> None:
    """Against the same frame alone."""
    frames = [shot(t, speed=0.37, scale=scale) for t in range(10)]
    method = method_named("mobfgsr", scale)
    images, _ = shown(method, frames)
    alone, _ = shown(method, [replace(frames[-1], reset=torch.tensor([True]))])
    assert images[-1].shape == (1, 3, round(H * scale), round(W * scale))
    assert error(images[-1], 9, 0.37, scale) < 0.8 * error(alone[0], 9, 0.37, scale)


@pytest.mark.parametrize("time", [8.5, 9.5])
def test_generated_images_are_as_detailed_as_those_around(time: float) -> None:
    frames = [shot(t, speed=0.4) for t in range(10)]
    images, state = shown(MobFGSR(Config(scale=2.0)), frames)
    made, _ = MobFGSR(Config(scale=2.0))(moment(time), state)
    assert error(made, time, 0.4) < 1.3 * error(images[-1], 9, 0.4)
    assert error(made, time, 0.4) < 0.5 * error(images[-1], time, 0.4)


def test_what_was_hidden_owes_nothing_to_the_history() -> None:
    """A card leaves from one frame to the next: what it hid is the new frame alone."""
    method = MobFGSR(Config(scale=2.0))
    images, _ = shown(method, [shot(0, card=4.0), shot(1, card=4.0), shot(2, card=4.0), shot(3)])
    alone, _ = shown(method, [replace(shot(3), reset=torch.tensor([True]))])
    inner = (..., slice(4, -4), slice(12, 20))
    torch.testing.assert_close(images[-1][inner], alone[0][inner])


def test_what_comes_into_view_owes_nothing_to_the_history() -> None:
    """The scene jumps by half of the screen: the left half was never seen, and is not the edge pixel smeared."""
    frames = [shot(0), replace(shot(1, speed=12.0), reset=torch.tensor([False]))]
    images, _ = shown(MobFGSR(Config(scale=2.0)), frames)
    alone, _ = shown(MobFGSR(Config(scale=2.0)), [replace(frames[1], reset=torch.tensor([True]))])
    torch.testing.assert_close(images[-1][..., :20], alone[0][..., :20])


def test_a_light_switched_off_leaves_no_ghost() -> None:
    """Still pixels are patient with what jitter misses, for `PATIENCE` frames and no longer."""
    lit = [shot(t) for t in range(12)]
    dark = [replace(f, color=0.1 * f.color) for f in (shot(t) for t in range(12, 26))]
    images, _ = shown(MobFGSR(Config(scale=2.0)), lit + dark)
    limit = float(dark[0].color.max()) * 1.2  # type: ignore[union-attr]
    assert float(images[12].max()) > limit
    assert float(images[-1].max()) < limit


def test_a_reset_begins_anew_and_a_batch_is_its_parts() -> None:
    method = MobFGSR(Config(scale=2.0))
    one = [shot(t, speed=0.3) for t in range(4)]
    two = [replace(f, reset=torch.tensor([t in (0, 2)])) for t, f in enumerate(shot(t, speed=-0.7) for t in range(4))]
    both, state = shown(method, [concatenate(pair) for pair in zip(one, two, strict=True)])
    apart = [shown(method, frames) for frames in (one, two)]
    fresh, _ = shown(method, two[2:])
    torch.testing.assert_close(both[-1], torch.cat([images[-1] for images, _ in apart]), atol=1e-5, rtol=1e-5)
    torch.testing.assert_close(fresh[-1], apart[1][0][-1], atol=1e-5, rtol=1e-5)
    for time in (2.5, 3.5):
        request = concatenate([moment(time), moment(time)])
        expected = torch.cat([method(moment(time), state)[0] for _, state in apart])
        torch.testing.assert_close(method(request, state)[0], expected, atol=1e-5, rtol=1e-5)


def test_bright_spots_stay_finite_and_no_image_is_negative() -> None:
    """A lamp of 60000 beside black, moved between pixels: nothing rings below 0 or beyond what there was."""
    frames = [shot(t, speed=0.5) for t in range(4)]
    spots = torch.zeros(1, 3, H, W)
    spots[..., ::4, ::5] = 6e4
    images, state = shown(MobFGSR(Config(scale=2.0)), [replace(f, color=spots) for f in frames])
    images += [MobFGSR(Config(scale=2.0))(moment(t), state)[0] for t in (2.5, 3.5)]
    for image in images:
        assert bool(torch.isfinite(image).all())
        assert float(image.min()) >= 0
        assert float(image.max()) <= 6.5e4


@pytest.mark.parametrize("scale", [1.0, 2.0])
def test_motion_of_another_size_is_refused_in_a_sentence(scale: float) -> None:
    method, frame = MobFGSR(Config(scale=scale)), shot(0)
    state, other = method.start(frame), shot(1)
    object.__setattr__(other, "motion", torch.zeros(1, 2, H // 2, W // 2))  # past the checks of types, only tests have
    with pytest.raises(ValueError, match=r"motion has 12x8 pixels and color 24x16; mobfgsr needs all buffers"):
        method(other, state)
