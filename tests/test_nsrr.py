"""NSRR: known sizes, samples in their places, exact warps, what a reset forgets, losses."""

from dataclasses import replace

import pytest
import torch
from passing import H, W, shot, texture
from torch import Tensor, nn
from torch.utils._pytree import tree_leaves

from framecast.frame import Frame, concatenate
from framecast.losses import difference, similarity
from framecast.methods.extranet import scattered
from framecast.methods.larger import WHITE, decoded, encoded, nearness
from framecast.methods.nsrr import FAST, NSRR, Config, average, loss
from framecast.methods.taau import TAAU
from framecast.nets import multiply_accumulates, parameters
from framecast.resample import enlarge, place, positions, tent
from framecast.warp import scale_motion, warp

TINY = Config(features=(4, 2), weights=4, widths=(4, 4, 8))
STEADY = replace(TINY, accumulated=True)

PHASES = ((-0.25, -0.25), (0.25, 0.25), (0.25, -0.25), (-0.25, 0.25))
"""Jitter that puts samples on the centres of display pixels, all four in turn."""


def silent(config: Config = TINY) -> NSRR:
    """The method with a U-Net that adds nothing and a network that weighs all frames alike."""
    method = NSRR(config).eval()
    nn.init.zeros_(method.reconstruct.leave.weight)
    nn.init.zeros_(method.reweight[2].weight)  # type: ignore[arg-type]
    return method


def jittered(time: int, **about: float) -> Frame:
    """The passing wall, one frame apart, sampled at another quarter of each pixel every time."""
    return shot(float(time), jitter=PHASES[time % 4], span=1.0, **about)


def cut(frame: Frame, height: int, width: int) -> Frame:
    """The upper left part of what the method needs of a frame."""
    kept = {name: getattr(frame, name)[..., :height, :width] for name in NSRR.needs}
    return replace(frame, **dict.fromkeys(("albedo", "normal", "roughness", "metallic", "object")), **kept)


def truth(time: float, speed: float) -> Tensor:
    """The wall at display size."""
    y, x = torch.meshgrid((torch.arange(2 * H) + 0.5) / 2, (torch.arange(2 * W) + 0.5) / 2, indexing="ij")
    return texture(x - speed * time, y)[None]


def run(method: NSRR, frames: list[Frame]) -> list[Tensor]:
    """The images of the frames."""
    images, state = [], method.start(frames[0])
    with torch.no_grad():
        for frame in frames:
            image, state = method(frame, state)
            images.append(image)
    return images


def test_without_the_residual_it_is_the_published_network() -> None:
    """719,535 parameters with one network for the features of all frames; the paper has two, of 12,744 each."""
    method = NSRR(Config(scale=4, residual=False)).eval()
    assert parameters(method) == 719_535 + 12_744
    count = multiply_accumulates(method, lambda: run(method, [cut(shot(0.0), 9, 16)]))
    kept = 3 * 9 * 16 * 12_672  # features of three earlier frames, which the published count makes again
    assert 900 * (count + kept) == pytest.approx(382.7e9, rel=1e-3)  # 480 x 270 pixels are 900 times as many


def test_the_residual_and_the_fast_widths_are_what_the_card_says() -> None:
    assert parameters(NSRR()) == 732_279 + 3 * 64 * 9
    assert parameters(NSRR(FAST)) == 213_863


# Samples.


@pytest.mark.parametrize("jitter", PHASES)
def test_every_sample_covers_the_display_pixel_that_it_lies_in(jitter: tuple[float, float]) -> None:
    x, shift = torch.rand(1, 2, 5, 7) + 1, torch.tensor([jitter])
    values, cover = place(x, positions((5, 7), (10, 14), shift))
    row, column = int(jitter[1] > 0), int(jitter[0] > 0)
    torch.testing.assert_close(values[..., row::2, column::2], x)
    torch.testing.assert_close(cover[..., row::2, column::2], torch.ones(1, 1, 5, 7))
    assert float(cover.sum()) == pytest.approx(35)


@pytest.mark.parametrize("move", [(0.0, 0.0), (1.0, -2.0), (0.3, 0.45), (-1.7, 0.25)])
def test_placing_is_warping_an_image_with_zeros_between_the_samples(move: tuple[float, float]) -> None:
    x = torch.rand(2, 3, 9, 12)
    jitter = torch.tensor([[0.25, -0.25], [-0.25, -0.25]])
    motion = torch.tensor(move).view(1, 2, 1, 1).expand(2, 2, 9, 12)
    at = positions((9, 12), (18, 24), jitter) + torch.tensor(move).view(1, 2, 1, 1)
    values, cover = place(x, at)
    larger = scattered(torch.cat((x, torch.ones_like(x[:, :1])), 1), jitter, 2)
    warped = warp(larger, scale_motion(motion, 2))
    inner = (..., slice(5, -5), slice(5, -5))
    torch.testing.assert_close((values * cover)[inner], warped[:, :3][inner], atol=2e-4, rtol=0)
    torch.testing.assert_close(cover[inner], warped[:, 3:][inner], atol=2e-4, rtol=0)


def test_no_sample_lies_beyond_the_border() -> None:
    at = positions((5, 7), (10, 14), torch.zeros(1, 2)) + torch.tensor([20.0, 0.0]).view(1, 2, 1, 1)
    assert float(place(torch.rand(1, 1, 5, 7), at)[1].abs().max()) == 0


def test_depth_is_never_mistaken_for_no_sample() -> None:
    found = nearness(torch.tensor([0.0, 10.0, 1e4, 65504.0]).view(1, 1, 2, 2)).flatten()
    torch.testing.assert_close(found, torch.tensor([1.0, 0.75, 0.5005, 0.5]), atol=1e-4, rtol=0)


def test_colour_comes_back() -> None:
    color = torch.tensor([0.0, 0.18, 1.0, 37.0, 900.0]).view(1, 1, 1, 5).expand(1, 3, 1, 5)
    torch.testing.assert_close(decoded(encoded(color)), color, rtol=1e-2, atol=1e-6)
    assert float(decoded(torch.full((1, 3, 1, 1), 2.0)).max()) == pytest.approx(WHITE / (1 - WHITE))


def test_a_weighted_mean_of_equal_samples_is_the_sample() -> None:
    grey, cover = torch.full((1, 3, 4, 4), 0.3), torch.rand(1, 1, 4, 4)
    torch.testing.assert_close(average([(grey, cover), (grey, 7 * cover)], grey), grey)


# History.


@pytest.mark.parametrize("speed", [0.0, 1.0, 2.5])
def test_samples_of_earlier_frames_land_on_the_surface_that_they_show(speed: float) -> None:
    """Four frames sample all quarters of each pixel of a wall; moved rightly, they are the wall at display size."""
    frames = [jittered(t, speed=speed) for t in range(8)]
    image = run(silent(), frames)[-1]
    alone = enlarge(frames[-1].color, (2 * H, 2 * W), frames[-1].jitter, tent, 2).image
    wrong = run(silent(), [replace(f, motion=-f.motion + 1) for f in frames])[-1]  # type: ignore[operator]
    inner = (..., slice(2, -2), slice(24, -4))
    error, before, lost = ((x - truth(7, speed))[inner].abs().mean() for x in (image, alone, wrong))
    assert error < 0.5 * before  # a quarter of the mean is the enlarged frame
    assert error < 0.1 * lost


def test_what_is_accumulated_is_what_taau_makes() -> None:
    frames = [jittered(t, speed=0.4) for t in range(7)]
    frames[4] = replace(frames[4], reset=torch.tensor([True]))
    taau, state = TAAU(), TAAU().start(frames[0])
    for frame, image in zip(frames, run(silent(STEADY), frames), strict=True):
        expected, state = taau(frame, state)
        torch.testing.assert_close(image, expected, atol=1e-5, rtol=1e-4)


def test_the_image_of_the_fifth_frame_does_not_know_the_first() -> None:
    method = NSRR(TINY).eval()
    frames = [jittered(t) for t in range(6)]
    other = [replace(frames[0], color=frames[0].color + 1), *frames[1:]]  # type: ignore[operator]
    one, two = run(method, frames), run(method, other)
    assert not torch.equal(one[4], two[4])
    assert torch.equal(one[5], two[5])


def test_a_reset_is_a_fresh_start_whatever_its_motion_says() -> None:
    method = NSRR(TINY).eval()
    fresh = replace(jittered(4), reset=torch.tensor([True]))
    wild = replace(fresh, motion=torch.full_like(fresh.motion, float("nan")))  # type: ignore[arg-type]
    later = jittered(5)
    expected = run(method, [fresh, later])
    for last in (fresh, wild):
        found = run(method, [jittered(2), jittered(3), last, later])[2:]
        assert all(torch.equal(a, b) for a, b in zip(found, expected, strict=True))


def test_a_batch_is_its_images_one_resetting() -> None:
    method = NSRR(TINY).eval()
    one = [jittered(t) for t in range(4)]
    two = [jittered(t + 1, square=2.0) for t in range(4)]
    two[2] = replace(two[2], reset=torch.tensor([True]))
    both = run(method, [concatenate(pair) for pair in zip(one, two, strict=True)])
    for batch, a, b in zip(both, run(method, one), run(method, two), strict=True):
        torch.testing.assert_close(batch, torch.cat((a, b)), atol=1e-4, rtol=1e-4)


def test_frame_and_state_stay_as_they_were() -> None:
    method = NSRR(TINY).eval()
    state = method.start(jittered(0))
    with torch.no_grad():
        _, state = method(jittered(0), state)
        before = [leaf.clone() for leaf in tree_leaves((jittered(1), state))]
        frame = jittered(1)
        method(frame, state)
    assert all(torch.equal(a, b) for a, b in zip(before, tree_leaves((frame, state)), strict=True))


@pytest.mark.parametrize("config", [TINY, replace(TINY, residual=False), replace(TINY, scale=1.5), STEADY])
def test_every_configuration_runs_at_odd_sizes(config: Config) -> None:
    image = run(NSRR(config).eval(), [cut(jittered(t), 13, 21) for t in range(3)])[-1]
    assert image.shape == (1, 3, round(13 * config.scale), round(21 * config.scale))
    assert bool(torch.isfinite(image).all())
    assert bool((image >= 0).all())


# Training.


def test_similarity_is_what_a_loop_over_windows_says() -> None:
    a, b = torch.rand(1, 3, 10, 13), torch.rand(1, 3, 10, 13)
    values = []
    for top in (0, 3):
        for left in (0, 3, 6):
            for c in range(3):
                x, y = (image[0, c, top : top + 7, left : left + 7].double().flatten() for image in (a, b))
                light = (2 * x.mean() * y.mean() + 1e-4) / (x.mean() ** 2 + y.mean() ** 2 + 1e-4)
                covariance = ((x - x.mean()) * (y - y.mean())).mean()
                form = (2 * covariance + 9e-4) / (x.var(correction=0) + y.var(correction=0) + 9e-4)
                values.append(light * form)
    assert float(similarity(a, b)) == pytest.approx(float(torch.stack(values).mean()), abs=1e-4)


def test_no_loss_on_a_perfect_image() -> None:
    image = torch.rand(1, 3, 16, 16)
    assert all(float(term) == pytest.approx(0, abs=1e-5) for term in difference(image, image).values())
    grey = [replace(f, color=torch.full_like(f.color, 0.4)) for f in (jittered(t) for t in range(5))]  # type: ignore[arg-type]
    terms = loss(silent(), grey, torch.full((1, 1, 3, 2 * H, 2 * W), 0.4))
    assert all(float(term.detach()) == pytest.approx(0, abs=1e-4) for term in terms.values())


@pytest.mark.parametrize(("config", "count"), [(TINY, 5), (STEADY, 7)])
def test_the_loss_is_of_the_image_that_a_call_makes(config: Config, count: int) -> None:
    method, frames = NSRR(config).eval(), [jittered(t) for t in range(count)]
    target = truth(count - 1, 3.0)
    with torch.no_grad():
        terms = loss(method, frames, target[:, None])
        expected = difference(encoded(run(method, frames)[-1]), encoded(target))
    for name, term in terms.items():
        assert float(term) == pytest.approx(float(expected[name]), abs=1e-3)


def test_gradients_reach_every_layer_and_losses_are_numbers_in_half_the_bits() -> None:
    method = NSRR(TINY).train()
    with torch.autocast("cpu", torch.bfloat16):
        terms = loss(method, [jittered(t) for t in range(5)], 2 * truth(4, 3.0)[:, None])
    assert all(bool(torch.isfinite(term)) for term in terms.values())
    torch.stack(list(terms.values())).sum().backward()
    for name, p in method.named_parameters():
        assert p.grad is not None, name
        assert bool(torch.isfinite(p.grad).all()), name
        assert bool(p.grad.abs().sum() > 0), name
