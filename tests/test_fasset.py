"""FASSET: known sizes, two ways to render, what an untrained network shows, holes, history, any size, losses."""

from dataclasses import replace
from itertools import combinations, pairwise
from pathlib import Path

import pytest
import torch
from passing import H, W, run, shot
from torch import Tensor
from torch.utils._pytree import tree_leaves

from framecast.checkpoint import describe, fill, save
from framecast.color import decode_log
from framecast.frame import Frame, concatenate, unshaded
from framecast.methods import TRAINABLE, inr
from framecast.methods.fasset import (
    BETTER,
    FASSET,
    PUBLISHED,
    coarser,
    loss,
    moved,
    published_loss,
    recipe,
    seen,
    smaller,
    terms,
)
from framecast.methods.fasset_network import Config
from framecast.methods.filters import Bilinear
from framecast.methods.guided import GuidedWarp
from framecast.methods.inr import RenderINR
from framecast.methods.larger import Config as Size
from framecast.methods.taau import TAAU
from framecast.nets import multiply_accumulates, parameters
from framecast.resample import positions

JITTERS = ((0.0, 0.0), (0.25, -0.3), (-0.2, 0.1), (0.4, 0.2))


def alternating(count: int = 5, *, speed: float = 3.0, square: float | None = None) -> list[Frame]:
    """Shaded and unshaded frames in turn, their vectors to the last shaded frame."""
    frames = [
        shot(float(t), speed=speed, square=square, jitter=JITTERS[t % 4], span=1.0 if t % 2 else 2.0)
        for t in range(count)
    ]
    return [unshaded(frame) if t % 2 else frame for t, frame in enumerate(frames)]


def fresh(config: Config = BETTER, *, stirred: float = 0.0) -> FASSET:
    """The method with a last layer that gives nothing, or something of this size."""
    torch.manual_seed(0)
    method = FASSET(config).eval()
    for network in method.networks:
        torch.nn.init.normal_(network.render.layers[-1].weight, std=stirred)  # type: ignore[union-attr]
    return method


def test_parameters_and_operations_beside_the_published_ones() -> None:
    """0.27 million and 216 billion from 1280 x 720 to 2560 x 1440; RenderINR below 40 thousand."""
    for config in (PUBLISHED, BETTER):
        method = FASSET(config).eval()
        assert 0.24e6 <= parameters(method) <= 0.30e6
        assert parameters(method.networks[0].render) < 40_000  # type: ignore[arg-type, union-attr]
        state = method.start(shot(0.0))
        count = multiply_accumulates(method, lambda method=method, state=state: method(shot(0.0), state))
        assert 170e9 < count / (H * W) * 1280 * 720 < 216e9


@pytest.mark.parametrize("size", [(24, 40), (36, 60), (41, 68), (72, 120)])
def test_the_first_layer_may_come_before_reading(size: tuple[int, int], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(inr, "TILE", 5 * size[1])
    torch.manual_seed(0)
    network = RenderINR(6, 3, 4)
    torch.nn.init.normal_(network.layers[-1].weight)  # type: ignore[arg-type]
    maps, known, jitter = torch.randn(2, 6, 24, 40), torch.randn(2, 3, *size), torch.tensor([[0.3, -0.4], [0.0, 0.1]])
    plain = network.plain(maps, known, jitter).detach()
    with torch.no_grad():
        torch.testing.assert_close(network(maps, known, jitter), plain, atol=1e-3, rtol=1e-4)
        with torch.autocast("cpu", torch.bfloat16):
            rounded = network(maps, known, jitter)
    assert float((rounded - plain).abs().mean() / plain.abs().mean()) < 0.02


def test_features_are_read_where_pixels_lie_between_samples() -> None:
    """A ramp over the samples' places is, read at any size, the ramp over the pixels' places."""
    jitter = torch.tensor([[0.3, -0.2]])
    ramp = (torch.arange(16) + 0.5 + jitter[0, 0]).expand(1, 1, 10, 16).contiguous()
    read = inr.sampled(ramp, (15, 24), jitter)
    places = (torch.arange(24) + 0.5) * (16 / 24)
    torch.testing.assert_close(read[0, 0, 4, 3:-3], places[3:-3], atol=1e-4, rtol=0)


def test_pixels_of_one_sample_are_told_apart() -> None:
    """At twice the size the four pixels around a sample read other features, and are told where the sample lies."""
    maps = torch.randn(1, 3, 6, 8)
    read = torch.nn.functional.pixel_unshuffle(inr.sampled(maps, (12, 16), torch.zeros(1, 2)), 2)[0, :4, 1:-1, 1:-1]
    at = positions((6, 8), (12, 16), torch.zeros(1, 2))
    away = torch.nn.functional.pixel_unshuffle(at.round() - at, 2).unflatten(1, (2, 4))[0]
    for a, b in combinations(range(4), 2):
        assert float((read[a] - read[b]).abs().min()) > 0
        assert float((away[:, a] - away[:, b]).abs().amax(0).min()) == pytest.approx(0.5)


def test_depth_enters_alike_whatever_else_is_in_view() -> None:
    """Of what FrameEncoder sees, one far pixel changes itself alone: depth is not scaled by what the image holds."""
    near = shot(0.0)
    assert near.depth is not None
    depth = near.depth.clone()
    depth[..., 10, 20] = 60000.0
    one, other = (inputs_of(fresh(), [frame])[0] for frame in (near, replace(near, depth=depth)))
    assert (one != other)[0].any(0).nonzero().tolist() == [[10, 20]]


@pytest.mark.parametrize(("size", "words"), [((20, 60), "smaller than the frame"), ((48, 60), "another aspect")])
def test_sizes_that_cannot_be_made_are_refused(size: tuple[int, int], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        RenderINR(2, 1, 3)(torch.zeros(1, 2, 24, 40), torch.zeros(1, 1, *size), torch.zeros(1, 2))


@pytest.mark.parametrize("scale", [1.5, 2.0, 3.0, 1.7])
def test_an_untrained_network_shows_what_taau_makes_at_any_size(scale: float) -> None:
    frames = [shot(float(t), jitter=JITTERS[t % 4]) for t in (0, 2, 4)]
    method, plain = fresh(replace(BETTER, scale=scale)), TAAU(Size(scale))
    state = plain.start(frames[0])
    for frame, image in zip(frames, run(method, frames), strict=True):
        expected, state = plain(frame, state)
        assert image.shape[-2:] == (round(H * scale), round(W * scale))
        torch.testing.assert_close(image, expected, atol=1e-4, rtol=1e-4)


def test_as_published_an_untrained_network_shows_the_frame_enlarged_or_the_last_one_warped() -> None:
    first, second = (shot(t, speed=4.0, span=1.0) for t in (0.0, 1.0))
    images, plain = run(fresh(PUBLISHED), [first, unshaded(second)]), Bilinear()
    for image, frame in zip(images, (first, second), strict=True):
        expected = plain(frame, plain.start(frame))[0]
        torch.testing.assert_close(image[..., 10:], expected[..., 10:], atol=1e-3, rtol=1e-3)


def test_a_frame_in_between_is_the_accumulated_image_moved_and_guided_warping_in_holes() -> None:
    frames = alternating(6, square=3.0)
    method = fresh()
    images = run(method, frames)
    state = method.start(frames[0])
    with torch.no_grad():
        for frame in frames[:5]:
            _, state = method(frame, state)
        base, aimed = method.extrapolate(frames[5], state)
    assert bool((base.mask == 0).any())
    torch.testing.assert_close(images[5], decode_log(base.image), atol=1e-5, rtol=1e-5)
    hole = torch.nn.functional.interpolate(1 - base.mask, scale_factor=2.0, mode="nearest") > 0
    inner = ~(torch.nn.functional.max_pool2d(1.0 - hole.float(), 5, 1, 2) > 0).expand_as(base.image)
    assert bool(inner.any())
    torch.testing.assert_close(base.image[inner], base.alone[inner])
    guided = GuidedWarp()
    expected = guided(frames[5], guided.start(frames[4]))[0]
    torch.testing.assert_close(decode_log(base.color), expected, atol=1e-5, rtol=1e-4)
    assert aimed.motion is not None


def test_what_stands_still_stays_in_frames_in_between() -> None:
    frames = alternating(6, speed=0.0)
    images = run(fresh(), frames)
    torch.testing.assert_close(images[5], images[4], atol=1e-4, rtol=1e-4)


def test_what_is_added_to_a_still_scene_comes_to_rest() -> None:
    """It is the mean over all frames, of which one more changes less and less; frames in between show that mean."""
    frames = [replace(f, jitter=torch.tensor([JITTERS[t % 4]])) for t, f in enumerate([shot(0.0, speed=0.0)] * 24)]
    frames = [replace(f, time=torch.tensor([2.0 * t]), reset=torch.tensor([t == 0])) for t, f in enumerate(frames)]
    method = fresh(stirred=0.05)
    state, added = method.start(frames[0]), []
    with torch.no_grad():
        for frame in frames:
            _, state = method(frame, state)
            added.append(state.added)
        between = unshaded(replace(frames[1], time=torch.tensor([47.0])))
        base, aimed = method.extrapolate(between, state)
        image, _ = method(between, state)
    changes = [float((b - a).abs().mean()) for a, b in pairwise(added)]
    assert max(changes[-4:]) < 0.2 * changes[0]
    assert aimed.motion is not None
    own = float((image - decode_log(base.image + added[-1])).abs().mean())
    assert own < 0.2 * float((image - decode_log(base.image)).abs().mean())


def inputs_of(method: FASSET, frames: list[Frame]) -> list[Tensor]:
    """What FrameEncoder was given for each frame."""
    found: list[Tensor] = []
    for network in method.networks:
        network.frame.register_forward_pre_hook(lambda _, given: found.append(given[0]))  # type: ignore[union-attr]
    run(method, frames)
    return found


def test_holes_are_cut_out_of_both_kinds_of_frames() -> None:
    """Shaded ones are multiplied by the mask of what the last shaded frame shows; not so in the ablation."""
    frames = alternating(6, square=3.0)
    for found in inputs_of(fresh(), frames)[4:]:
        hole = (found[:, 3:4] == 0).expand(-1, 3, -1, -1)
        assert bool(hole.any())
        assert bool((found[:, :3][hole] == 0).all())
        assert bool((found[:, :3][~hole] > 0).all())
    whole = inputs_of(fresh(replace(BETTER, mask=False)), frames)
    assert bool((whole[4][:, 3] == 1).all())
    assert bool((whole[5][:, 3] == 0).any())


def test_the_mask_marks_what_the_square_uncovers() -> None:
    frames = alternating(3, speed=0.0, square=3.0)
    method = fresh()
    state = method(frames[0], method.start(frames[0]))[1]
    _, aimed, _ = method.accumulate(frames[2], state)
    mask = seen(aimed, state)[0, 0]
    assert bool((mask[9:15, 5:9] == 0).all())
    assert float(mask[9:15, 12:16].min()) == 1
    assert float(mask[:, 22:].min()) == 1


def test_a_batch_is_its_images_and_a_reset_a_fresh_start() -> None:
    method = fresh(stirred=0.05)
    one, two = alternating(5), alternating(5, square=2.0)
    two[2] = replace(two[2], reset=torch.tensor([True]))
    both = run(method, [concatenate(pair) for pair in zip(one, two, strict=True)])
    apart = run(method, one), run(method, two[2:])
    for k in range(5):
        torch.testing.assert_close(both[k][:1], apart[0][k], atol=1e-4, rtol=1e-3)
    for k in (2, 3, 4):
        torch.testing.assert_close(both[k][1:], apart[1][k - 2], atol=1e-4, rtol=1e-3)


def test_frames_in_between_leave_no_trace_and_the_past_does() -> None:
    method, frames = fresh(stirred=0.05), alternating(5)
    state = method.start(frames[0])
    with torch.no_grad():
        _, state = method(frames[0], state)
        _, after = method(frames[1], state)
        for was, now in zip(tree_leaves(state), tree_leaves(after), strict=True):
            assert torch.equal(was, now)
        image, _ = method(frames[2], state)
        forgetful, _ = method(frames[2], replace(state, kept=torch.zeros_like(state.kept)))
    assert float((image - forgetful).abs().max()) > 1e-4


def test_what_the_recurrent_module_keeps_moves_along() -> None:
    kept = torch.randn(1, 4, 3, 5)
    frame = replace(shot(2.0), motion=torch.full((1, 2, H, W), -8.0))
    torch.testing.assert_close(moved(kept, frame)[..., 1:, 1:], kept[..., :-1, :-1], atol=1e-4, rtol=0)
    assert not moved(kept, replace(frame, reset=torch.tensor([True]))).any()


def test_one_network_serves_every_size() -> None:
    method, frames = fresh(stirred=0.05), alternating(2)
    whole = method.state_dict()
    for scale in (1.5, 3.0):
        other = FASSET(replace(BETTER, scale=scale)).eval()
        other.load_state_dict(whole)
        for image, same in zip(run(other, frames), run(method.at(scale).eval(), frames), strict=True):
            assert image.shape[-2:] == (round(H * scale), round(W * scale))
            assert torch.equal(image, same)


def test_both_kinds_of_frames_share_weights_unless_asked() -> None:
    frames = alternating(2)
    method = fresh(replace(BETTER, shared=False), stirred=0.05)
    assert parameters(method) == 2 * parameters(fresh())
    before = run(method, frames)
    with torch.no_grad():
        method.networks[1].render.layers[-1].bias.add_(0.1)  # type: ignore[operator, union-attr]
    after = run(method, frames)
    assert torch.equal(before[0], after[0])
    assert float((after[1] - before[1]).abs().mean()) > 0.01


def test_terms_have_the_published_divisors() -> None:
    """Ten pixels with errors 0.1 to 1, the last two of them holes."""
    image = torch.arange(1, 11).view(1, 1, 2, 5).expand(1, 3, 2, 5) / 10
    mask = torch.ones(1, 1, 2, 5)
    mask[..., 1, 3:] = 0
    found = terms(image, torch.zeros(1, 3, 2, 5), mask)
    assert float(found["l1"]) == pytest.approx(0.55)
    assert float(found["hole"]) == pytest.approx(0.95)
    assert float(found["hard"]) == pytest.approx(1.0 / 10)
    assert float(terms(image, image, mask)["hard"]) == 0
    assert float(terms(image, torch.zeros(1, 3, 2, 5), torch.ones(1, 1, 2, 5))["hole"]) == 0


@pytest.mark.parametrize("which", [loss, published_loss])
def test_losses_vanish_for_the_truth_and_gradients_reach_every_layer(which: object) -> None:
    assert callable(which)
    frames = alternating(4, square=3.0)
    method = fresh(stirred=0.05)
    with torch.no_grad():
        truth = torch.stack(run(method, frames), 1)
        found = which(method, frames, truth)
    assert all(float(term) < 2e-3 for term in found.values())
    found = which(method.train(), frames, torch.rand_like(truth))
    torch.stack(list(found.values())).sum().backward()
    assert all(p.grad is not None and bool(p.grad.abs().sum() > 0) for p in method.parameters())
    assert recipe.mode == "alternate"


@pytest.mark.parametrize("start", [3, 4])
def test_other_sizes_are_learnt_from_the_same_samples(start: int) -> None:
    frames = [replace(frame, time=frame.time + start) for frame in alternating(8, square=2.0)]
    found = loss(fresh(stirred=0.05).train(), frames, torch.rand(1, 2, 3, 2 * H, 2 * W))
    assert set(found) == {"l1", "hole", "hard"}
    assert all(bool(torch.isfinite(term)) for term in found.values())


@pytest.mark.parametrize("place", [(0, 0), (1, 1), (1, 0), (0, 1)])
def test_every_second_sample_lies_where_it_was_taken(place: tuple[int, int]) -> None:
    frame = shot(2.0, jitter=(0.3, -0.2))
    ramp = (torch.arange(W) + 0.5 + 0.3).expand(1, 3, H, W)
    few = coarser(replace(frame, color=ramp), place)
    assert few.color is not None
    assert few.motion is not None
    assert frame.motion is not None
    assert bool((few.jitter.abs() <= 0.5).all())
    places = (torch.arange(W // 2) + 0.5 + few.jitter[0, 0]) * 2
    torch.testing.assert_close(few.color[0, 0, 0], places)
    torch.testing.assert_close(few.motion, frame.motion[..., ::2, ::2] / 2)


def test_smaller_truths_are_means_of_what_they_cover() -> None:
    image = torch.rand(1, 2, 3, 8, 16)
    assert smaller(image).shape == (1, 2, 3, 6, 12)
    torch.testing.assert_close(smaller(torch.full_like(image, 0.7)), torch.full((1, 2, 3, 6, 12), 0.7))
    ramp = (torch.arange(16) + 0.5).expand(1, 1, 3, 8, 16) / 1e4  # dark, where the curve is a line
    expected = (torch.arange(12) + 0.5) * 4 / 3 / 1e4
    torch.testing.assert_close(smaller(ramp)[0, 0, 0, 0], expected, atol=3e-5, rtol=0)


def test_the_ablations_can_be_trained() -> None:
    names = [name for name in TRAINABLE if name.startswith("fasset")]
    assert len(names) == 6
    for name in names:
        make, _ = TRAINABLE[name]
        assert isinstance(make(), FASSET)


@pytest.mark.parametrize("lacking", ["albedo", "normal", "motion", "depth"])
def test_a_missing_buffer_is_named(lacking: str) -> None:
    frames = alternating(2)
    with pytest.raises(ValueError, match=f"no {lacking}"):
        fresh().start(replace(frames[0], **{lacking: None}))
    method = fresh()
    state = method.start(frames[0])
    with pytest.raises(ValueError, match=f"time 1 has no {lacking}: render"):
        method(replace(frames[1], **{lacking: None}), state)


def test_other_sizes_and_weights_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"0\.5 times is smaller; use at least 1"):
        FASSET(Config(scale=0.5))
    method, frame = fresh(), shot(0.0)
    few = coarser(frame, (0, 0))
    with pytest.raises(ValueError, match="has 20x12 pixels and those before it 40x24; start anew"):
        method(few, method.start(frame))
    wide = FASSET(replace(BETTER, latents=(32, 16)))
    save(tmp_path / "w.safetensors", wide.state_dict(), describe("fasset", wide))
    with pytest.raises(ValueError, match="another configuration of fasset: latents"):
        fill(method, "fasset", tmp_path / "w.safetensors")
