"""ExtraSS: known sizes, what an untrained network shows, which encoder sees what, history that cannot grow, losses."""

import warnings
from dataclasses import replace
from itertools import pairwise

import pytest
import torch
from jaxtyping import Float
from passing import H, W, run, shot
from torch import Tensor

from framecast.color import untonemap
from framecast.frame import Frame, concatenate, unshaded
from framecast.methods.extrass import (
    ACCUMULATED,
    ALONE,
    GUESSED,
    KEPT,
    Config,
    ExtraSS,
    Gathered,
    Predicted,
    loss,
    recipe,
)
from framecast.methods.guided import GuidedWarp, extrapolated
from framecast.methods.larger import AROUND, TAP, encoded, sharpened
from framecast.methods.taau import TAAU, mix
from framecast.nets import multiply_accumulates, parameters
from framecast.resample import from_ycocg, phases

SIZE = (2 * H, 2 * W)


def alternating(count: int = 4, *, speed: float = 3.0, square: float | None = None) -> list[Frame]:
    """Shaded and unshaded frames in turn, their vectors to the frame before."""
    jitters = ((0.0, 0.0), (0.25, -0.3), (-0.2, 0.1), (0.4, 0.2))
    frames = [shot(float(t), speed=speed, square=square, jitter=jitters[t % 4], span=1.0) for t in range(count)]
    return [unshaded(frame) if t % 2 else frame for t, frame in enumerate(frames)]


def fresh(last: float = -30.0, frame: float = -30.0, believed: float = 30.0, counts: float = 0.0) -> ExtraSS:
    """The method with a head that adds nothing, and these logits of the last image, of the enlarged frame and of
    history, and of what the frame counts."""
    torch.manual_seed(0)
    method = ExtraSS().eval()
    with torch.no_grad():
        leave = method.head[2]
        assert isinstance(leave, torch.nn.Conv2d)
        assert leave.bias is not None
        leave.weight.zero_()
        leave.bias[len(AROUND) :] = torch.tensor([last, frame, believed, counts])
    return method


def test_parameters_and_operations_are_those_written_down() -> None:
    method = ExtraSS()
    assert parameters(method) == 402_380
    count = multiply_accumulates(method, lambda: run(method, [shot(0.0)]))
    a, b, c, d = 24, 32, 48, 64
    whole = 9 * (63 * a + a * a + (a + b) * a + a * a + a * 32)
    half = 9 * (a * b + b * b + (b + c) * b + b * b)
    quarter = 9 * (b * c + c * c + (c + d) * c + c * c)
    eighth = 9 * (c * d + d * d)
    full = 9 * 23 * 32 + 32 * 12
    assert count == H * W * (64 * whole + 16 * half + 4 * quarter + eighth) // 64 + 4 * H * W * full


def test_where_all_frames_are_shaded_a_network_that_adds_nothing_is_taau() -> None:
    frames = [shot(float(t), square=2.0, jitter=(0.1 * t, -0.2), span=1.0) for t in range(3)]
    found, taau = run(fresh(), frames), TAAU()
    state = taau.start(frames[0])
    for frame, image in zip(frames, found, strict=True):
        wanted, state = taau(frame, state)
        torch.testing.assert_close(encoded(image), encoded(wanted), atol=1e-4, rtol=0)


def test_an_unshaded_frame_gives_samples_too() -> None:
    """What the guided warp makes of it is accumulated as if it had been shaded; what was filled in counts less."""
    frames = alternating(3, square=3.0)
    assert frames[1].object is not None
    frames[1] = replace(frames[1], albedo=torch.where(frames[1].object == 7, 0.9, 0.5).expand(1, 3, H, W).contiguous())
    _, known = extrapolated(frames[1], GuidedWarp().start(frames[0]))
    assert not bool(known.all())
    warped, _ = GuidedWarp()(frames[1], GuidedWarp().start(frames[0]))
    taau, trust = TAAU(), (None, GUESSED + (1 - GUESSED) * known.float(), None)
    state = taau.start(frames[0])
    for k, found in enumerate(run(fresh(), frames)):
        frame = replace(frames[k], color=warped) if k == 1 else frames[k]
        wanted, state = mix(taau.look(frame, state, trust[k]))
        torch.testing.assert_close(encoded(found), encoded(wanted), atol=1e-4, rtol=0)


def test_without_a_network_images_are_those_of_one_that_adds_nothing() -> None:
    frames = alternating(4, square=3.0)
    for found, wanted in zip(run(ExtraSS(ACCUMULATED), frames), run(fresh(), frames), strict=True):
        torch.testing.assert_close(encoded(found), encoded(wanted), atol=1e-5, rtol=0)
    assert parameters(ExtraSS(ACCUMULATED)) == 0


def test_samples_that_are_not_trusted_leave_history_as_it_is() -> None:
    frames, taau = [shot(float(t), speed=0.0, jitter=(0.1 * t, 0.2), span=1.0) for t in range(2)], TAAU()
    _, state = taau.accumulate(frames[0], taau.start(frames[0]))
    nothing = torch.zeros(1, 1, H, W)
    _, after = mix(taau.look(replace(frames[1], color=torch.rand(1, 3, H, W)), state, nothing))
    torch.testing.assert_close(after.weight, state.weight)


def test_history_that_the_network_does_not_believe_is_gone() -> None:
    """The image is the frame's own, and what is known afterwards is worth that one sample."""
    gathered, made = third(fresh(believed=-30.0))
    known = gathered.sample.history.weight > 0
    assert float(known.float().mean()) > 0.5
    apart = torch.where(known, made.image - own(gathered), 0)
    torch.testing.assert_close(apart, torch.zeros_like(apart), atol=1e-4, rtol=0)
    more = torch.where(known, made.history.weight - gathered.sample.confidence, 0)
    torch.testing.assert_close(more, torch.zeros_like(more), atol=1e-4, rtol=0)


def test_a_frame_that_counts_more_is_nearer_to_the_image() -> None:
    made = [third(fresh(counts=counts)) for counts in (-5.0, 0.0, 5.0)]
    apart = [float((each.image - own(gathered)).square().mean()) for gathered, each in made]
    assert apart[0] > 1.5 * apart[1] > 1.5**2 * apart[2]


def test_an_image_goes_towards_the_pixels_around_it_by_half_at_most() -> None:
    image, taps = torch.rand(1, 3, 4, 5), torch.zeros(1, len(AROUND), 4, 5)
    assert float(sharpened(image, taps).abs().max()) == 0
    taps[:, AROUND.index((1, 2))] = 30.0
    right = torch.cat((image[..., 1:], image[..., -1:]), 3)
    torch.testing.assert_close(sharpened(image, taps), TAP * (right - image))
    taps[:, AROUND.index((0, 1))] = -30.0
    above = torch.cat((image[..., :1, :], image[..., :-1, :]), 2)
    torch.testing.assert_close(sharpened(image, taps), TAP * (right - image) - TAP * (above - image))


def third(method: ExtraSS) -> tuple[Gathered, Predicted]:
    """What the method knows and makes of the third of three shaded frames."""
    frames = [shot(float(t), speed=1.3, square=3.0, jitter=(0.1 * t, -0.2), span=1.0) for t in range(3)]
    state = method.start(frames[0])
    with torch.no_grad():
        for frame in frames[:2]:
            _, state = method(frame, state)
        gathered = method.gather(frames[2], state)
        return gathered, method.predict(gathered, False)


def own(gathered: Gathered) -> Float[Tensor, "b 3 H W"]:
    """The frame's own enlarged image."""
    return encoded(untonemap(from_ycocg(gathered.sample.image).clamp(0, 1)))


def test_nothing_is_added_to_what_stands_still() -> None:
    """After two periods of the jitter the image stays, whatever the network says of frames that differ by jitter."""
    torch.manual_seed(4)
    method, period = ExtraSS().eval(), phases(2.0)
    torch.nn.init.normal_(method.head[2].weight, std=0.05)
    corner = [(2 * ((k * 7) % period) / period - 1, 2 * ((k * 3) % period) / period - 1) for k in range(period)]
    jitters = [(0.5 * x, 0.5 * y) for x, y in corner]
    frames = [shot(float(t), speed=0.0, square=2.0, jitter=jitters[t % period], span=1.0) for t in range(3 * period)]
    images = run(method, [unshaded(frame) if t % 2 else frame for t, frame in enumerate(frames)])
    changes = [float((encoded(a) - encoded(b)).abs().max()) for a, b in pairwise(images)]
    assert max(changes[: period // 2]) > 0.01
    assert max(changes[-period // 2 :]) < 1 / 255


def test_two_unshaded_frames_follow_both_vectors() -> None:
    """The surface is found where two vectors of different length lead, one after the other."""
    frames = alternating(3)
    steps = [torch.tensor([x, 0.0]).view(1, 2, 1, 1).expand(1, 2, H, W).contiguous() for x in (-3.0, -5.0)]
    method, state = fresh(), None
    given = [frames[0], replace(frames[1], motion=steps[0]), replace(unshaded(frames[2]), motion=steps[1])]
    with torch.no_grad():
        for frame in given:
            _, state = method(frame, method.start(frame) if state is None else state)
    assert state is not None
    torch.testing.assert_close(state.reach[0, 0, :, 8:], torch.full((H, W - 8), -8.0))
    assert int(state.alone) == 2


def test_each_kind_of_frame_has_its_encoder() -> None:
    torch.manual_seed(1)
    method, frames = ExtraSS().eval(), alternating(2, square=3.0)
    torch.nn.init.normal_(method.head[2].weight, std=2.0)
    before = run(method, frames)
    with torch.no_grad():
        method.extrapolated.stages[0][0].weight.mul_(2)
    after = run(method, frames)
    assert torch.equal(before[0], after[0])
    assert not torch.allclose(before[1], after[1], atol=1e-3)


def test_an_error_in_the_last_image_dies_out_whatever_the_network_says() -> None:
    """It enters by nine tenths, at most; reads between pixels are kept within those around them."""
    method, frames = fresh(last=30.0), alternating(6, speed=0.7)
    with torch.no_grad():
        _, state = method(frames[0], method.start(frames[0]))
        states = [state, replace(state, last=torch.rand_like(state.last))]
        apart = float((states[0].last - states[1].last).abs().max())
        for k, frame in enumerate(frames[1:], 1):
            states = [method(frame, state)[1] for state in states]
            error = float((states[0].last - states[1].last).abs().max())
            assert 0 < error <= 1.02 * KEPT**k * apart


def test_a_batch_is_its_images_and_a_reset_a_fresh_start() -> None:
    torch.manual_seed(2)
    method = ExtraSS().eval()
    torch.nn.init.normal_(method.head[2].weight, std=0.05)
    one, two = alternating(4), alternating(4, square=2.0)
    two[2] = replace(two[2], reset=torch.tensor([True]))
    both = run(method, [concatenate(pair) for pair in zip(one, two, strict=True)])
    apart = run(method, one), run(method, two[2:])
    for k in range(4):
        torch.testing.assert_close(both[k][:1], apart[0][k], atol=1e-4, rtol=1e-3)
    for k in (2, 3):
        torch.testing.assert_close(both[k][1:], apart[1][k - 2], atol=1e-4, rtol=1e-3)


def test_a_shot_that_begins_unshaded_is_shown_under_mean_light() -> None:
    """Nothing of the shot before remains but how bright it was; and one sentence says so."""
    frames = alternating(2, speed=0.0)
    assert frames[0].color is not None
    assert frames[1].albedo is not None
    bright = replace(frames[0], color=torch.full_like(frames[0].color, 0.27))
    other = replace(frames[1], reset=torch.tensor([True]), albedo=torch.rand_like(frames[1].albedo))
    assert other.albedo is not None
    with pytest.warns(UserWarning, match="shade the first frame of every shot"):
        image, _ = GuidedWarp()(other, GuidedWarp().start(bright))
    torch.testing.assert_close(image, 0.27 / 0.54 * (other.albedo + 0.04), atol=1e-4, rtol=1e-3)
    with pytest.warns(UserWarning, match="time 1, which was not shaded"):
        found = run(fresh(), [bright, other])[1]
    assert float((found - found.mean()).abs().max()) > 0.1
    guess = fresh().gather(replace(frames[1], reset=torch.tensor([True])), fresh().start(bright))
    assert float(guess.known.max()) == 0  # and counts as what was filled in


def test_too_many_unshaded_frames_are_warned_of_once() -> None:
    frames = [frame if t == 0 else unshaded(frame) for t, frame in enumerate(alternating(ALONE + 3))]
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        run(fresh(), frames[:ALONE])
        assert caught == []
        run(fresh(), frames)
    assert [str(one.message).startswith(f"{ALONE} frames in a row were not shaded") for one in caught] == [True]


def test_losses_vanish_for_the_truth_and_gradients_reach_every_layer() -> None:
    torch.manual_seed(3)
    method, frames = ExtraSS(), alternating(4, square=3.0)
    with torch.no_grad():
        terms = loss(method, frames, torch.stack(run(method.eval(), frames), 1))
    assert float(terms["image"]) < 0.3  # what is left is of the shaded frame that is made as if it were not
    terms = loss(method.train(), frames, torch.rand(1, 4, 3, *SIZE))
    torch.stack(list(terms.values())).sum().backward()
    assert all(p.grad is not None and bool(p.grad.abs().sum() > 0) for p in method.parameters())
    assert recipe.mode == "alternate"


def test_what_is_accumulated_learns_for_later_images_and_the_last_image_does_not() -> None:
    method, frames = ExtraSS(), alternating(4, square=3.0)
    state = method.start(frames[0])
    for frame in frames[:3]:
        image, state = method(frame, state)
    state.history.color.retain_grad()
    image, _ = method(frames[3], state)
    image.square().mean().backward()
    assert state.history.color.grad is not None
    assert bool(state.history.color.grad.abs().sum() > 0)
    assert not state.last.requires_grad


def test_the_temporal_term_compares_the_encoders_on_one_frame() -> None:
    method, frames = ExtraSS(), alternating(2)
    truth = torch.rand(1, 2, 3, *SIZE)
    assert "temporal" not in loss(method, frames, truth)
    more = loss(method, alternating(4), torch.rand(1, 4, 3, *SIZE))
    assert float(more["temporal"].detach()) > 0


def test_another_scale_is_refused() -> None:
    with pytest.raises(ValueError, match="2 times the size, not 3"):
        ExtraSS(Config(scale=3.0))


@pytest.mark.parametrize("lacking", ["albedo", "normal", "motion"])
def test_a_missing_buffer_is_named(lacking: str) -> None:
    with pytest.raises(ValueError, match=f"no {lacking}"):
        ExtraSS().start(replace(shot(0.0), **{lacking: None}))
    method, frames = ExtraSS(), alternating(2)
    with pytest.raises(ValueError, match=f"time 1 was not shaded and has no {lacking}"):
        method(replace(frames[1], **{lacking: None}), method.start(frames[0]))
    with pytest.raises(ValueError, match=f"time 1 was not shaded and has no {lacking}"):
        GuidedWarp()(replace(frames[1], **{lacking: None}), GuidedWarp().start(frames[0]))
