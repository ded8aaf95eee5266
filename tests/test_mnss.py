"""MNSS: known sizes, history where it belongs, samples in their places, what a reset forgets, losses."""

from dataclasses import replace

import pytest
import torch
from passing import H, W, run, shot
from test_nsrr import cut, jittered, truth
from torch import nn
from torch.utils._pytree import tree_leaves

from framecast.frame import concatenate, pixel_grid
from framecast.losses import difference
from framecast.methods.larger import encoded
from framecast.methods.mnss import MNSS, Config, loss, moved, shown
from framecast.nets import multiply_accumulates, parameters
from framecast.resample import at_samples

TINY = Config(inner=4, joint=2)

SIZE = (2 * H, 2 * W)


def silent(config: Config = TINY) -> MNSS:
    """The method with a blending network that adds nothing, and a map that trusts the history everywhere."""
    method = MNSS(config).eval()
    nn.init.zeros_(method.second[4].weight)  # type: ignore[arg-type]
    nn.init.zeros_(method.trust[2].weight)  # type: ignore[arg-type]
    nn.init.constant_(method.trust[2].bias, 10)  # type: ignore[arg-type]
    return method


def test_the_default_is_variant_b_and_a_convolution_for_the_samples() -> None:
    method = MNSS().eval()
    assert parameters(method) == 9_908 + 6 * 3 * 9 + 3
    frame = cut(shot(0.0), 8, 16)
    count = multiply_accumulates(method, lambda: run(method, [frame]))
    assert count == 8 * 16 * (4 * (9_908 - 80) + 6 * 3 * 9)  # of the parameters 80 are added, not multiplied


# Where things lie.


def test_the_image_is_read_where_the_samples_were_taken() -> None:
    """An image that holds its own coordinates, in pixels of the frame, read at samples off the centres."""
    grid = pixel_grid(*SIZE)[None] / 2
    jitter = torch.tensor([[0.2, -0.4]])
    found = at_samples(torch.cat((grid, grid[:, :1]), 1), (H, W), jitter)[:, :2]
    inner = (..., slice(1, -1), slice(1, -1))
    torch.testing.assert_close(found[inner], (pixel_grid(H, W)[None] + jitter[:, :, None, None])[inner])


@pytest.mark.parametrize("speed", [0.0, 1.0, 2.25])
def test_the_last_image_lands_on_the_frame(speed: float) -> None:
    """Jitter of neither frame matters: images have none."""
    image = torch.cat((truth(3, speed), torch.full((1, 1, *SIZE), 0.7)), 1)
    last = jittered(3, speed=speed)
    state = MNSS(TINY).start(last)
    state = replace(state, image=image, depth=last.depth, motion=last.motion, known=torch.tensor([True]))
    found, known, still = moved(jittered(4, speed=speed), state, SIZE)
    inner = (..., slice(4, -4), slice(12, -4))
    torch.testing.assert_close(found[:, :3][inner], truth(4, speed)[inner], atol=0.01, rtol=0)
    assert bool((known[inner] == 1).all())
    assert bool((known[..., : max(0, int(2 * speed) - 1)] == 0).all())
    assert bool((still == (speed == 0)).all())


def test_a_sample_changes_the_pixels_around_it_alone() -> None:
    method = silent()
    frames = [jittered(t, speed=0.0) for t in range(2)]
    brighter = frames[1].color.clone()  # type: ignore[union-attr]
    brighter[0, :, 10, 20] += 0.3
    one, two = (run(method, [frames[0], last])[-1] for last in (frames[1], replace(frames[1], color=brighter)))
    changed = (one - two).abs().amax(1)[0] > 0.02
    rows, columns = changed.nonzero().unbind(1)
    assert int((one - two).abs().amax(1)[0].argmax()) == 21 * 2 * W + 41  # jitter is to the right and down
    assert int(rows.min()) >= 17
    assert int(rows.max()) <= 25
    assert int(columns.min()) >= 37
    assert int(columns.max()) <= 45


def test_what_stands_still_gets_better_with_every_round_of_jitter() -> None:
    """All four quarters of each pixel sampled twice, against once, against the first frame alone."""
    images = run(silent(), [jittered(t, speed=0.0) for t in range(8)])
    inner = (..., slice(4, -4), slice(4, -4))
    first, once, twice = ((images[k] - truth(0, 0.0))[inner].abs().mean() for k in (0, 3, 7))
    assert once < 0.7 * first
    assert twice <= 1.05 * once


def test_what_stands_still_comes_to_rest() -> None:
    """The networks themselves do not: with weights that shift every image, the state would run away."""
    method = MNSS(TINY).eval()
    nn.init.constant_(method.second[4].bias, 0.01)  # type: ignore[arg-type]
    images = run(method, [jittered(t, speed=0.0) for t in range(70)])
    torch.testing.assert_close(images[69], images[66], atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize("light", [0.5, 2.0])
def test_what_came_to_rest_follows_a_change_of_light(light: float) -> None:
    frames = [jittered(t, speed=0.0) for t in range(90)]
    lit = [replace(f, color=f.color * light) for f in frames[70:]]  # type: ignore[operator]
    images = run(MNSS(TINY).eval(), [*frames[:70], *lit])
    right = light * images[69]
    assert (images[-1] - right).abs().mean() < 0.2 * (images[69] - right).abs().mean()


def test_history_with_the_wrong_motion_is_worse_than_none() -> None:
    frames = [jittered(t, speed=2.0) for t in range(6)]
    wrong = [replace(f, motion=-f.motion) for f in frames]  # type: ignore[operator]
    inner = (..., slice(4, -4), slice(24, -24))
    right, lost, none = (
        (image - truth(5, 2.0))[inner].abs().mean()
        for image in (run(silent(), frames)[-1], run(silent(), wrong)[-1], run(silent(), frames[5:])[-1])
    )
    assert right < none < lost


# The call.


def test_a_reset_is_a_fresh_start_whatever_its_motion_says() -> None:
    method = MNSS(TINY).eval()
    fresh = replace(jittered(4), reset=torch.tensor([True]))
    wild = replace(fresh, motion=torch.full_like(fresh.motion, float("nan")))  # type: ignore[arg-type]
    later = jittered(5)
    expected = run(method, [fresh, later])
    for last in (fresh, wild):
        found = run(method, [jittered(2), jittered(3), last, later])[2:]
        assert all(torch.equal(a, b) for a, b in zip(found, expected, strict=True))


def test_a_batch_is_its_images_one_resetting() -> None:
    method = MNSS(TINY).eval()
    one = [jittered(t) for t in range(4)]
    two = [jittered(t + 1, square=2.0) for t in range(4)]
    two[2] = replace(two[2], reset=torch.tensor([True]))
    both = run(method, [concatenate(pair) for pair in zip(one, two, strict=True)])
    for batch, a, b in zip(both, run(method, one), run(method, two), strict=True):
        torch.testing.assert_close(batch, torch.cat((a, b)), atol=1e-4, rtol=1e-4)


def test_frame_and_state_stay_as_they_were() -> None:
    method = MNSS(TINY).eval()
    with torch.no_grad():
        _, state = method(jittered(0), method.start(jittered(0)))
        frame = jittered(1)
        before = [leaf.clone() for leaf in tree_leaves((frame, state))]
        method(frame, state)
    assert all(torch.equal(a, b) for a, b in zip(before, tree_leaves((frame, state)), strict=True))


@pytest.mark.parametrize("config", [TINY, replace(TINY, scale=1.5)])
def test_every_configuration_runs_at_odd_sizes(config: Config) -> None:
    image = run(MNSS(config).eval(), [cut(jittered(t), 13, 21) for t in range(3)])[-1]
    assert image.shape == (1, 3, round(13 * config.scale), round(21 * config.scale))
    assert bool(torch.isfinite(image).all())
    assert bool((image >= 0).all())


# Training.


def test_no_loss_on_what_is_one_grey() -> None:
    frames = [jittered(t) for t in range(3)]
    grey = [replace(f, color=torch.full_like(f.color, 0.4)) for f in frames]  # type: ignore[arg-type]
    terms = loss(silent(), grey, torch.full((1, 3, 3, *SIZE), 0.4))
    assert all(float(term.detach()) == pytest.approx(0, abs=1e-3) for term in terms.values())


def test_the_loss_is_the_mean_over_the_images_that_calls_make() -> None:
    method, frames = MNSS(TINY).eval(), [jittered(t, speed=1.0) for t in range(3)]
    targets = [truth(t, 1.0) for t in range(3)]
    with torch.no_grad():
        terms = loss(method, frames, torch.stack(targets, 1))
        each = [difference(encoded(a), encoded(b)) for a, b in zip(run(method, frames), targets, strict=True)]
    for name in ("ssim", "l1"):
        assert float(terms[name]) == pytest.approx(sum(float(one[name]) for one in each) / 3, abs=1e-4)
    assert float(terms["smooth"]) > 0


def test_gradients_reach_every_layer_and_losses_are_numbers_in_half_the_bits() -> None:
    method, frames = MNSS(TINY).train(), [jittered(t) for t in range(3)]
    with torch.autocast("cpu", torch.bfloat16):
        terms = loss(method, frames, torch.stack([2 * truth(t, 3.0) for t in range(3)], 1))
    assert all(bool(torch.isfinite(term)) for term in terms.values())
    torch.stack(list(terms.values())).sum().backward()
    for name, p in method.named_parameters():
        assert p.grad is not None, name
        assert bool(torch.isfinite(p.grad).all()), name
        assert bool(p.grad.abs().sum() > 0), name


def test_networks_see_colour_under_the_srgb_curve_and_depth_as_it_is() -> None:
    seen = shown(torch.tensor([0.0, 0.5, 2.0, 0.6]).view(1, 4, 1, 1)).flatten()
    torch.testing.assert_close(seen, torch.tensor([0.0, 0.7354, 0.9996, 0.6]), atol=1e-3, rtol=0)
