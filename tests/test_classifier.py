"""Classifier-guided supersampling: published sizes, buffers with known values, counters, classes, losses, samples."""

import math
from dataclasses import replace
from typing import Any

import pytest
import torch
from test_super_resolution import gradient, played, shot, state_after, truth
from torch import Tensor
from torch.utils._pytree import tree_leaves

from framecast.color import encode_srgb, tonemap, untonemap
from framecast.frame import Frame, concatenate
from framecast.methods.classifier import (
    FIRST,
    KEEP,
    RANGE,
    Classifier,
    Config,
    Mixed,
    Network,
    displayed,
    errors,
    kept,
    likelihoods,
    loss,
    loss_with_true_labels,
    mix,
    one_hot,
    slopes,
)
from framecast.methods.classifier_buffers import BLUR, Seen, State, look
from framecast.methods.larger import TAP
from framecast.nets import multiply_accumulates, parameters

TINY = Config(widths=(8, 16, 32, 64), inner=8)
ABLATIONS = [replace(TINY, **{name: False}) for name in ("counter", "carried", "range", "classifier")]
SIZE = (36, 48)


def tiny(config: Config = TINY) -> Classifier:
    torch.manual_seed(0)
    method = Classifier(config).eval()
    for layer in method.modules():
        if isinstance(layer, torch.nn.BatchNorm2d):  # as after training: none of them does nothing
            torch.nn.init.uniform_(layer.running_var, 0.1, 0.5)  # type: ignore[arg-type]
    return method


def classes(ghosting: int = 2, aliasing: int = 2, batch: int = 1) -> Tensor:
    """True classes, the same for all pixels."""
    return torch.tensor([ghosting, aliasing]).float()[None, :, None, None].expand(batch, 2, *SIZE).contiguous()


def remembered(frame: Frame, **changes: Any) -> State:
    """A state in which there is a history worth eight samples."""
    state = Classifier(TINY).start(frame)
    about = {"known": torch.ones_like(frame.reset), "time": frame.time - 1, "worth": torch.full_like(state.worth, 8.0)}
    return replace(state, **{**about, **changes})


# The networks.


def test_all_scales_together_make_32_channels() -> None:
    """Halves of 32, 64 and 128 channels and all of 256, spread over 1, 4, 16 and 64 pixels: 16 + 8 + 4 + 4."""
    network = Network(12, (32, 64, 128, 256), 3)
    assert network.joined(torch.rand(1, 12, 16, 24)).shape == (1, 32, 16, 24)
    assert network(torch.rand(1, 12, 16, 24)).shape == (1, 6 + 3, 16, 24)


def test_sizes_are_those_of_the_layers() -> None:
    method = Classifier().eval()
    scales = [(92, 32), (16, 64), (32, 128), (64, 256)]
    blocks = [(a * b, 9 * b, b * b) for a, b in scales]
    decoder = 3 * 32 * 32 + 32 * (6 + 8)
    mixing = (19 + 2 + 6 + 8) * 64 + 64 * 12
    weights = sum(map(sum, blocks)) + decoder + mixing
    biases = sum(3 * b for _, b in scales) + 3 * 32 + 14 + 64 + 12
    norms = 2 * (sum(2 * b for _, b in scales) + 3 * 32 + 14)
    assert parameters(method) == weights + biases + norms == 126_102
    frame = shot(0, 2.0, size=(16, 16))
    state = method.start(frame)
    half = sum(sum(block) / 4**k for k, block in enumerate(blocks)) + decoder
    assert multiply_accumulates(method, lambda: method(frame, state)) == 32 * 32 * (half / 4 + mixing)


def test_coarse_scales_see_far_and_the_mixing_network_one_pixel() -> None:
    method = tiny()
    x = torch.rand(1, 19 + 2 + 6 + 8, 8, 8)
    y = x.clone()
    y[..., 3, 5] += 1
    changed = (method.mix(x) != method.mix(y))[0, 0].nonzero()
    assert changed.tolist() == [[3, 5]]
    network = Network(8, (32, 64, 128, 256), 0).eval()
    a = torch.rand(1, 8, 16, 16)
    b = a.clone()
    b[..., :4, :4] += 20 * torch.randn(1, 8, 4, 4)
    changed = (network.joined(a) != network.joined(b))[0, :, 8:, 8:]
    assert bool(changed[28:].any())  # the coarsest scale sees all of the picture, the finest 3 x 3 pixels
    assert not changed[:16].any()


# The buffers.


@pytest.mark.parametrize("speed", [0.0, 0.5, 1.3])
def test_the_last_image_lands_on_the_frame(speed: float) -> None:
    """Jitter of neither frame matters: images have none."""
    frame = shot(4, 2.0, gradient, speed=speed)
    state = remembered(frame, image=tonemap(truth(3, 2.0, gradient, speed=speed)))
    seen = look(frame, state, 2.0)
    right = tonemap(truth(4, 2.0, gradient, speed=speed))
    inner = (..., slice(6, -6), slice(6, -6))
    torch.testing.assert_close(seen.history[inner], right[inner], atol=1e-4, rtol=0)
    for current in (seen.sharp, seen.smooth):
        torch.testing.assert_close(current[inner], right[inner], atol=1e-3, rtol=0)
    assert bool(seen.valid[inner].all())


def test_depths_differ_by_their_reverse_relative_to_the_nearer_one() -> None:
    """What stood at 2 uncovers what stands at 5: (1/2 - 1/5) / (1/2). What comes nearer is below 0."""
    frame = shot(1, 2.0)
    for there, expected in ((2.0, 0.6), (5.0, 0.0), (8.0, -0.375)):
        seen = look(frame, remembered(frame, depth=torch.full((1, 1, *SIZE), 1 / there)), 2.0)
        torch.testing.assert_close(seen.difference, torch.full_like(seen.difference, expected), atol=1e-5, rtol=0)


def test_the_range_of_colours_is_that_of_the_last_frames_neighbourhoods() -> None:
    method = tiny()
    _, state = method(frame := shot(0, 2.0), method.start(shot(0, 2.0)))
    shown = encode_srgb(tonemap(frame.color))[0, 0]
    column, row = 9, 5  # of the frame; its jitter is (0, -1/6), so display pixels 10, 11 and 18, 19 lie around it
    around = shown[row - 1 : row + 2, column - 1 : column + 2]
    found = state.range[0, :, 2 * row, 2 * column]
    torch.testing.assert_close(found[0], around.min())
    torch.testing.assert_close(found[3], around.max())
    later = look(shot(1, 2.0, speed=3.0), state, 2.0)
    assert torch.equal(later.range[0, :, 10, 24], state.range[0, :, 10, 18])


def test_classes_are_carried_between_pixels() -> None:
    frame = shot(1, 2.0, speed=0.25)  # half a display pixel
    each = torch.zeros(1, 6, *SIZE)
    each[:, 0, :, 10] = 1
    seen = look(frame, remembered(frame, classes=each), 2.0)
    torch.testing.assert_close(seen.classes[0, 0, 20, 9:13], torch.tensor([0.0, 0.5, 0.5, 0.0]), atol=1e-3, rtol=0)


def test_motion_is_that_of_what_lies_in_front() -> None:
    frame = shot(1, 2.0)
    depth, motion = torch.full((1, 1, 18, 24), 5.0), torch.zeros(1, 2, 18, 24)
    depth[..., 10], motion[:, 0, :, 10] = 2.0, -1.5
    seen = look(replace(frame, depth=depth, motion=motion), remembered(frame), 2.0)
    assert seen.motion[0, 0, 10, 16:26].tolist() == [0.0] * 2 + [-3.0] * 6 + [0.0] * 2


# Counters.


def test_the_counter_counts_frames_until_history_fails() -> None:
    method, frames = tiny(), [shot(t, 2.0) for t in range(5)]
    hidden = classes()
    hidden[..., 7, 9] = 0
    state, found = method.start(frames[0]), []
    with torch.no_grad():
        for t, frame in enumerate(frames):
            made = method.make(frame, state, hidden if t == 3 else classes(1))
            found.append((float(made.counter[0, 0, 0, 0]), float(made.counter[0, 0, 7, 9])))
            state = kept(made, frame)
    assert found == [(0, 0), (1, 1), (2, 2), (3, 0), (4, 1)]


def test_the_counter_moves_with_the_picture_and_starts_off_the_screen() -> None:
    frame = shot(1, 2.0, speed=2.0)
    columns = torch.arange(48.0).expand(1, 1, *SIZE).contiguous()
    with torch.no_grad():
        made = tiny().make(frame, remembered(frame, counter=columns), classes())
    assert made.counter[0, 0, 3].tolist() == [0.0] * 4 + [float(k + 1) for k in range(44)]


# Mixing.


def mixed(
    seen: Seen,
    trust: float = 99,
    fresh: float = 0,
    bound: float = -99,
    sharp: float = -99,
    taps: float = 0,
    hidden: float = 0,
    unsettled: float = 1,
) -> Mixed:
    """What the network that mixes makes if it says the same of all pixels; by default to change nothing."""
    raw = torch.tensor([trust, fresh, bound, sharp, *[taps] * 8]).float()[:, None, None].expand(1, 12, *SIZE)
    every = torch.ones(1, 1, *SIZE)
    return mix(seen, raw, hidden * every, unsettled * every)


def test_frame_and_history_weigh_what_they_are_worth() -> None:
    frame = shot(1, 2.0)
    state = remembered(frame, image=torch.rand(1, 3, *SIZE), worth=torch.full((1, 1, *SIZE), 3.0))
    seen = look(frame, state, 2.0)
    for trust, fresh in ((1.0, 1.0), (0.5, 1.0), (0.25, 4.0)):
        old, new = 3 * trust, seen.confidence * fresh
        logit = 99 if trust == 1 else math.log(trust / (1 - trust))
        found = mixed(seen, logit, math.atanh(math.log(fresh) / RANGE))
        expected = (old * seen.history + new * seen.smooth) / (old + new)
        torch.testing.assert_close(found.kept, expected, atol=1e-5, rtol=0)
        torch.testing.assert_close(found.worth, old + new, atol=1e-5, rtol=1e-5)


def test_what_is_surely_hidden_is_worth_next_to_nothing() -> None:
    frame = shot(1, 2.0)
    seen = look(frame, remembered(frame, image=torch.rand(1, 3, *SIZE)), 2.0)
    before, after = (mixed(seen, KEEP, hidden=h).worth - seen.confidence for h in (0.0, 1.0))
    assert bool((before > 0.98 * 8 - 1e-3).all())
    assert bool((after < 0.02 * 8).all())


def test_unchanged_a_still_image_is_the_mean_of_its_samples() -> None:
    method, frames = tiny(), [shot(t, 2.0) for t in range(5)]
    for p in method.mix.parameters():
        torch.nn.init.zeros_(p)
    with torch.no_grad():
        method.mix[2].bias.copy_(torch.tensor([99.0, 0.0, -99.0, -99.0, *[0.0] * 8]))
        state, total, weights = method.start(frames[0]), torch.zeros(1, 3, *SIZE), torch.zeros(1, 1, *SIZE)
        for frame in frames:
            made = method.make(frame, state, classes())
            weight = made.seen.confidence
            if frame is frames[0]:
                weight = weight.clamp(min=FIRST)
            total, weights = total + weight * made.seen.smooth, weights + weight
            state = kept(made, frame)
    torch.testing.assert_close(state.image, total / weights, atol=1e-5, rtol=0)
    assert float((state.worth - weights).abs().max()) < 1e-4
    assert torch.equal(made.mixed.image, state.image)


def test_reading_between_pixels_takes_worth_away() -> None:
    frames = [shot(1, 2.0, speed=speed) for speed in (0.0, 0.25, 0.5)]  # half a display pixel, and a whole one
    found = [look(frame, remembered(frame), 2.0).worth[0, 0, 20, 20] for frame in frames]
    assert [float(each) for each in found] == pytest.approx([8, 8 * (1 - BLUR / 2), 8], rel=1e-3)


def test_history_can_be_kept_within_the_colours_of_the_frame() -> None:
    frame = shot(1, 2.0)
    seen = look(frame, remembered(frame, image=torch.ones(1, 3, *SIZE), worth=torch.full((1, 1, *SIZE), 64.0)), 2.0)
    free, bound = (mixed(seen, bound=b).kept for b in (-99, 99))
    most = tonemap(frame.color).amax()  # type: ignore[arg-type]
    assert float(free.mean()) > 0.95
    assert float(bound.max()) <= float(most) + 1e-6


def test_sharpness_is_between_cubic_and_linear() -> None:
    frame = shot(1, 2.0)
    seen = look(frame, Classifier(TINY).start(frame), 2.0)
    assert bool((seen.sharp != seen.smooth).any())
    assert torch.equal(mixed(seen, sharp=-99).kept, seen.smooth)
    torch.testing.assert_close(mixed(seen, sharp=99).kept, seen.sharp)


def test_the_image_is_sharpened_or_smoothed_and_what_is_kept_is_not() -> None:
    frame = shot(1, 2.0)
    seen = look(frame, remembered(frame, image=torch.rand(1, 3, *SIZE) * 0.2 + 0.4), 2.0)
    plain, smooth, sharp = (mixed(seen, taps=math.atanh(t / TAP)) for t in (0, 1 / 9, -1 / 9))
    assert torch.equal(plain.image, plain.kept)
    assert torch.equal(smooth.kept, plain.kept)
    inner = (..., slice(1, -1), slice(1, -1))
    mean = torch.nn.functional.avg_pool2d(plain.kept, 3, 1, 1)
    torch.testing.assert_close(smooth.image[inner], mean[inner], atol=1e-5, rtol=0)
    torch.testing.assert_close((sharp.image + smooth.image)[inner], 2 * plain.kept[inner], atol=1e-5, rtol=0)


def test_whatever_the_network_says_a_constant_stays_what_it_is() -> None:
    method = tiny()
    torch.nn.init.normal_(method.mix[2].weight)
    for image in played(method, [shot(t, 2.0, lambda x, y: torch.full_like(x, 0.3), speed=0.4) for t in range(4)]):
        torch.testing.assert_close(image, torch.full_like(image, 0.3), atol=1e-5, rtol=0)


def test_what_is_settled_stays() -> None:
    frame = shot(1, 2.0)
    seen = look(frame, remembered(frame, image=0.9 * torch.rand(1, 3, *SIZE)), 2.0)
    found = mixed(seen, KEEP, 0, 0, 0, 0.3, unsettled=0)
    assert torch.equal(found.kept, seen.history)
    assert torch.equal(found.image, seen.history)


def after(frames: list[Frame], truths: list[Tensor]) -> State:
    """The state of a network without knowledge that is told the classes."""
    method = tiny()
    state = method.start(frames[0])
    with torch.no_grad():
        for frame, each in zip(frames, truths, strict=True):
            state = kept(method.make(frame, state, each), frame)
    return state


def test_frames_at_rest_are_counted_until_something_moves_or_history_fails() -> None:
    quiet, frames = [classes()] * 6, [shot(t, 2.0) for t in range(6)]
    assert bool((after(frames, quiet).rest.frames == 5).all())
    shaded = classes()
    shaded[:, 0, 7, 9] = 1
    found = after(frames, [*quiet[:4], shaded, quiet[0]]).rest.frames
    assert float(found[0, 0, 7, 9]) == 1
    assert float(found[0, 0, 7, 10]) == 5
    moving = after([*frames[:5], shot(5, 2.0, speed=0.4)], quiet).rest.frames
    assert bool((moving == 0).all())


def test_light_that_changes_ends_rest_where_it_does() -> None:
    """What is complete does not follow by itself: 0.3 became 0.5 in its right half."""
    brighter = torch.where(torch.arange(24.0) < 12, 0.3, 0.5).expand(1, 3, 18, 24).contiguous()
    frames = [shot(t, 2.0, color=brighter) for t in range(1, 25)]
    method, state = tiny(), remembered(frames[0], image=tonemap(torch.full((1, 3, *SIZE), 0.3)))
    state = replace(state, rest=replace(state.rest, frames=torch.full((1, 1, *SIZE), 200.0)))
    with torch.no_grad():
        for frame in frames:
            state = kept(method.make(frame, state, classes()), frame)
    found = state.rest.frames[0, 0]
    assert bool((found[:, :16] == 224).all())
    assert bool((found[:, 32:] < 24).all())
    assert float((untonemap(state.image)[..., 32:] - 0.5).abs().max()) < 0.1


def test_slopes_are_differences_of_brightness() -> None:
    x, y = torch.arange(6.0).expand(5, 6), torch.arange(5.0)[:, None].expand(5, 6)
    found = slopes((0.1 * x + 0.03 * y).expand(1, 3, 5, 6))[0, :, 1:-1, 1:-1]
    torch.testing.assert_close(found[0], torch.full_like(found[0], 0.2))
    torch.testing.assert_close(found[1], torch.full_like(found[1], 0.06))


def test_true_classes_take_the_place_of_the_networks() -> None:
    method, frame = tiny(), shot(1, 2.0)
    state = remembered(frame, image=torch.rand(1, 3, *SIZE))
    with torch.no_grad():
        hidden, fine, own = (method.make(frame, state, t) for t in (classes(0, 1), classes(), None))
    assert torch.equal(hidden.classes[0, :, 4, 4], torch.tensor([1.0, 0, 0, 0, 1, 0]))
    assert bool((hidden.mixed.image != fine.mixed.image).any())
    assert torch.equal(hidden.logits, own.logits)
    torch.testing.assert_close(own.classes.unflatten(1, (2, 3)).sum(2), torch.ones(1, 2, *SIZE))
    assert torch.equal(own.classes, likelihoods(own.logits))


@pytest.mark.parametrize("name", ["counter", "carried", "range"])
def test_an_ablation_does_not_see_what_it_leaves_out(name: str) -> None:
    frame = shot(1, 2.0)
    memory = {"counter": ("counter", "worth"), "carried": ("classes",), "range": ("range",)}[name]
    plain = remembered(frame, image=torch.rand(1, 3, *SIZE))
    other = replace(plain, **{each: torch.rand_like(getattr(plain, each)) * 3 for each in memory})
    with torch.no_grad():
        seen, blind = (
            bool((method.make(frame, plain).mixed.image != method.make(frame, other).mixed.image).any())
            for method in (tiny(), tiny(replace(TINY, **{name: False})))
        )
    assert seen
    assert not blind


def test_without_a_classifier_nothing_is_classified() -> None:
    method = tiny(replace(TINY, classifier=False))
    frames = [shot(t, 2.0) for t in range(3)]
    state = state_after(method, frames)
    torch.testing.assert_close(state.classes, torch.full_like(state.classes, 1 / 3))
    assert bool((state.counter == 2).all())
    assert parameters(method) == (19 + 2) * 8 + 8 + 8 * 12 + 12


# The call.


def test_a_reset_is_a_fresh_start_whatever_its_motion_says() -> None:
    method = tiny()
    after = [shot(t, 2.0, speed=0.4) for t in range(3)]
    after[0] = replace(after[0], motion=torch.full_like(after[0].motion, float("nan")))  # type: ignore[arg-type]
    fresh = played(method, after)
    cut = played(method, [shot(t, 2.0, gradient) for t in range(3)] + after)[3:]
    assert all(torch.equal(a, b) for a, b in zip(cut, fresh, strict=True))


def test_what_comes_from_off_screen_is_this_frames_alone() -> None:
    method = tiny()
    frames = [shot(0, 2.0, gradient), shot(1, 2.0)]
    frames[1] = replace(frames[1], motion=torch.full_like(frames[1].motion, 100.0))  # type: ignore[arg-type]
    alone = replace(frames[1], reset=torch.tensor([True]))
    assert torch.equal(played(method, frames)[1], played(method, [alone])[0])


def test_a_batch_is_its_images_one_resetting() -> None:
    method = tiny()
    one = [shot(t, 2.0, speed=0.4) for t in range(4)]
    two = [replace(shot(t + 5, 2.0, gradient, speed=-0.7), reset=torch.tensor([t in (0, 2)])) for t in range(4)]
    apart = [torch.cat(pair) for pair in zip(played(method, one), played(method, two), strict=True)]
    together = played(method, [concatenate(pair) for pair in zip(one, two, strict=True)])
    torch.testing.assert_close(torch.stack(together), torch.stack(apart), atol=1e-5, rtol=1e-5)


def test_frame_and_state_stay_as_they_were() -> None:
    method = tiny()
    state, frame = state_after(method, [shot(t, 2.0) for t in range(2)]), shot(2, 2.0, speed=0.3)
    before = [leaf.clone() for leaf in tree_leaves((frame, state))]
    method(frame, state)
    assert all(torch.equal(a, b) for a, b in zip(before, tree_leaves((frame, state)), strict=True))


@pytest.mark.parametrize("config", [replace(TINY, scale=1.5), replace(TINY, scale=3.0), *ABLATIONS])
def test_every_configuration_runs_at_odd_sizes(config: Config) -> None:
    frames = [shot(t, config.scale, size=(9, 13), speed=0.6) for t in range(3)]
    for image in played(tiny(config), frames):
        assert image.shape == (1, 3, round(9 * config.scale), round(13 * config.scale))
        assert bool(torch.isfinite(image).all())
        assert bool((image >= 0).all())


def test_what_is_missing_is_said_in_a_sentence() -> None:
    frame = replace(shot(0, 2.0), motion=None)
    with pytest.raises(ValueError, match=r"classifier makes shaded frames larger .* has no motion"):
        Classifier(TINY).start(frame)


# Training.


def targets(count: int, **kinds: int) -> Tensor:
    """Truth of the frames 1, 2 ... of a still picture, and classes."""
    return torch.stack([torch.cat((truth(0, 2.0), classes(**kinds)), 1)] * count, 1)


@pytest.mark.parametrize("config", [TINY, ABLATIONS[-1]])
def test_gradients_reach_every_layer_and_losses_are_numbers_in_half_the_bits(config: Config) -> None:
    method, frames = tiny(config).train(), [shot(t, 2.0) for t in range(3)]
    with torch.autocast("cpu", torch.bfloat16):
        terms = loss(method, frames, targets(2, ghosting=1, aliasing=0))
    named = {"image", "temporal"} | ({"ghosting", "aliasing"} if config.classifier else set())
    assert set(terms) == named
    torch.stack(list(terms.values())).sum().backward()
    for name, p in method.named_parameters():
        assert p.grad is not None, name
        assert bool(torch.isfinite(p.grad).all()), name
        if "bias" not in name:  # those before a normalisation change nothing
            assert bool(p.grad.abs().sum() > 0), name


def test_the_loss_of_true_labels_is_made_with_them() -> None:
    method, frames = tiny(), [shot(t, 2.0) for t in range(3)]
    truth_of_both = targets(2, ghosting=0, aliasing=1)
    with torch.no_grad():
        own, given = loss(method, frames, truth_of_both), loss_with_true_labels(method, frames, truth_of_both)
        state, total = method.start(frames[0]), []
        for frame, target in zip(frames, (None, *truth_of_both.unbind(1)), strict=True):
            made = method.make(frame, state, None if target is None else target[:, 3:])
            state = kept(made, frame)
            total += [] if target is None else [errors(made, target, None)]
    assert float(own["image"]) != float(given["image"])
    for name in ("image", "ghosting", "aliasing"):
        assert float(given[name]) == pytest.approx(sum(float(each[name]) for each in total) / 2, rel=1e-4)


def test_errors_are_least_where_colour_and_classes_are_right() -> None:
    """A still picture shown as it is, sure of its classes: nothing is left. Sure of others: much."""
    method, frame = tiny(), shot(1, 2.0)
    right = truth(0, 2.0)
    with torch.no_grad():
        made = method.make(frame, remembered(frame, image=tonemap(right)))
        target = torch.cat((right, classes(1, 0)), 1)
        sure = 30 * torch.cat([one_hot(target[:, k]) for k in (3, 4)], 1)
        perfect = replace(made, mixed=replace(made.mixed, image=tonemap(right)), logits=sure)
        dark = replace(made.mixed, image=0.5 * tonemap(right))
        before = displayed(perfect, target)
        found = errors(perfect, target, before)
        wrong = errors(replace(perfect, logits=sure.flip(1), mixed=dark), target, before)
        held = errors(replace(perfect, mixed=dark), torch.cat((right, classes()), 1), before)
        both = displayed(replace(perfect, mixed=dark), target)
        again = errors(replace(perfect, mixed=dark), torch.cat((right, classes()), 1), both)
    assert all(float(term) == pytest.approx(0, abs=6e-3) for term in found.values())
    assert float(wrong["ghosting"]) > 1
    assert float(wrong["aliasing"]) > 1
    root = (both[:, :3] - both[:, 3:]).square().mean().sqrt()
    assert float(wrong["image"]) == pytest.approx(5 * float(root), rel=1e-3)
    assert float(wrong["temporal"]) == 0  # history does not hold where light changed
    assert float(held["temporal"]) > 0.1
    assert float(again["temporal"]) == pytest.approx(0, abs=1e-4)  # as wrong as the image before: no flicker
