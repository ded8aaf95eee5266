"""ExtraNet: known sizes, what it begins with, what its network adds, losses."""

import math
from dataclasses import replace

import pytest
import torch
import torch.nn.functional as F
from passing import W, shot
from torch import Tensor, nn

from framecast.color import to_display
from framecast.frame import SKY, Frame, concatenate, unshaded
from framecast.methods import mixing
from framecast.methods.extranet import (
    BETTER,
    DIFFERENCES,
    Config,
    ExtraNet,
    History,
    Inputs,
    Network,
    differences,
    enlarged,
    features,
    hole_loss,
    loss,
    loss_as_shown,
    loss_without_shading,
    scattered,
    shading_loss,
)
from framecast.methods.mixing import BESIDE, REACH, mixed
from framecast.methods.reproject import (
    light,
    steps,
    surface,
)
from framecast.nets import multiply_accumulates, parameters


def fed(method: nn.Module, frames: list[Frame]) -> History:
    state = method.start(frames[0])
    for frame in frames:
        _, state = method(frame, state)
    return state


def silent(config: Config | None = None) -> ExtraNet:
    """The method with a network that adds nothing, so that its image is the warped one."""
    method = ExtraNet(config or Config()).eval()
    nn.init.zeros_(method.network.leave.weight)
    nn.init.zeros_(method.network.leave.bias)  # type: ignore[arg-type]
    return method


def test_the_default_is_the_published_network() -> None:
    network = Network(Config()).to("meta").eval()
    x = torch.zeros(1, 18, 720, 1280, device="meta")
    past = tuple(torch.zeros(1, 4, 720, 1280, device="meta") for _ in range(3))
    assert parameters(network) == 262_141
    assert multiply_accumulates(network, lambda: network(x, past)) == pytest.approx(50.1e9, rel=1e-3)


def test_the_counter_counts_what_can_be_counted_by_hand() -> None:
    layers = nn.Sequential(nn.Conv2d(3, 5, 3, 2, 1), nn.ConvTranspose2d(5, 2, 4, 2, 1))
    count = multiply_accumulates(layers, lambda: layers(torch.zeros(1, 3, 8, 8)))
    assert count == 4 * 4 * 5 * 27 + 4 * 4 * 5 * 2 * 16
    linear = nn.Linear(7, 3)
    assert multiply_accumulates(linear, lambda: linear(torch.zeros(2, 7))) == 2 * 21


def test_ablations_are_smaller_networks() -> None:
    full, without = parameters(Network(Config())), parameters(Network(Config(history=False)))
    assert without < full
    assert parameters(Network(Config(occlusion=False))) == full


def test_the_whole_history_lands_on_the_frame_to_generate() -> None:
    """Three frames of a passing wall, half a gap apart from the new one, all warp onto it."""
    method = silent()
    state = fed(method, [shot(t) for t in (0.0, 2.0, 4.0)])
    request = unshaded(shot(5.0, span=1.0))
    inputs = method.prepare(request, state, steps(request, state.newest.shows.time, state.newest.shows.jitter))
    truth = light(shot(5.0))
    columns = slice(16, W)  # 15 pixels have come in since the oldest
    for past in inputs.past:
        assert bool(past[:, 3:, :, columns].all())
        torch.testing.assert_close(past[:, :3, :, columns], truth[..., columns], atol=2e-3, rtol=0)
    assert not bool(inputs.past[0][:, 3, :, :14].any())
    assert bool(inputs.past[2][:, 3, :, 4:].all())


def test_depth_is_encoded_alike_whatever_else_is_in_view() -> None:
    near = shot(0)
    assert near.depth is not None
    depth = near.depth.clone()
    depth[..., 0, 0] = 5000
    a, b = features(near), features(replace(near, depth=depth))
    assert torch.equal(a[..., 1:, :], b[..., 1:, :])
    assert float(b[0, 3, 0, 0]) < 1
    assert float(features(replace(near, depth=torch.full_like(depth, SKY)))[0, 3, 0, 0]) == 1


# Losses.


def test_an_image_without_holes_has_no_hole_loss() -> None:
    error = torch.rand(2, 3, 8, 8)
    assert float(hole_loss(error, torch.zeros(2, 1, 8, 8))) == 0
    hole = torch.zeros(2, 1, 8, 8)
    hole[0, 0, 2, 3] = 1
    assert float(hole_loss(error, hole)) == pytest.approx(float(error[0, :, 2, 3].mean()) / 2)


def test_shading_loss_is_the_mean_of_the_worst_tenth_of_each_image_and_channel() -> None:
    error = torch.zeros(2, 3, 10, 10)
    error[0, 0, 0, :10] = 1.0  # ten of a hundred pixels, one channel of one image
    error[1, 2, 0, :5] = 1.0
    assert float(shading_loss(error)) == pytest.approx((1 + 0.5) / 6)


def test_no_loss_when_nothing_changes_and_gradients_reach_every_layer() -> None:
    frames = [shot(t, speed=0) for t in (0.0, 2.0, 4.0)]
    target = shot(5.0, speed=0, span=1.0)
    method = silent()
    terms = loss(method, [*frames, unshaded(target)], target.color[:, None])
    assert all(float(term.detach()) < 1e-4 for term in terms.values())
    method = ExtraNet().train()
    sum(loss(method, [*frames, unshaded(target)], 2 * target.color[:, None]).values()).backward()
    assert all(p.grad is not None and bool(torch.isfinite(p.grad).all()) for p in method.parameters())
    assert method.network.encoder is not None
    assert any(bool(p.grad.abs().sum() > 0) for p in method.network.encoder.parameters() if p.grad is not None)


def test_errors_as_displayed_vanish_for_the_truth_and_reach_every_layer() -> None:
    """Roots of mean squares of all pixels, holes, the worst tenth; a black frame is as wrong as the image is bright."""
    frames = [shot(t, speed=0) for t in (0.0, 2.0, 4.0)]
    target = shot(5.0, speed=0, span=1.0)
    given = [*frames, unshaded(target)]
    terms = loss_as_shown(silent(BETTER), given, target.color[:, None])
    assert terms.keys() == {"image", "hole", "shade"}
    assert all(float(term.detach()) < 6e-3 for term in terms.values())
    dark = loss_as_shown(silent(BETTER), given, torch.zeros_like(target.color[:, None]))
    shown = to_display(target.color).square().mean(1)
    assert float(dark["image"].detach()) == pytest.approx(5 * float(shown.mean().sqrt()), rel=1e-3)
    assert float(dark["hole"].detach()) == pytest.approx(0.5e-3, abs=1e-5)
    worst = shown.flatten().topk(round(shown.numel() / 10)).values.mean().sqrt()
    assert float(dark["shade"].detach()) == pytest.approx(0.5 * float(worst), rel=1e-3)
    method = ExtraNet(BETTER).train()
    moved = [*(shot(t) for t in (0.0, 2.0, 4.0)), unshaded(shot(5.0, span=1.0))]
    sum(loss_as_shown(method, moved, 2 * shot(5.0, span=1.0).color[:, None]).values()).backward()
    assert all(p.grad is not None and bool(torch.isfinite(p.grad).all()) for p in method.parameters())
    assert method.network.encoder is not None
    assert any(bool(p.grad.abs().sum() > 0) for p in method.network.encoder.parameters() if p.grad is not None)


def test_losses_under_bfloat16_are_near_those_of_float32() -> None:
    """Everything but the network stays in full precision: warps and positions would be off by pixels."""
    frames = [shot(t) for t in (0.0, 2.0, 4.0)]
    target = shot(5.0, span=1.0)
    method = silent()
    for terms in (loss, loss_without_shading):
        exact = terms(method, [*frames, unshaded(target)], target.color[:, None])
        with torch.autocast("cpu", torch.bfloat16):
            rounded = terms(method, [*frames, unshaded(target)], target.color[:, None])
        assert rounded.keys() == exact.keys()
        for name, term in rounded.items():
            assert term.dtype == torch.float32
            assert float(term.detach()) == pytest.approx(float(exact[name].detach()), abs=1e-3)


# The call.


def test_the_sky_is_warped_and_not_shaded() -> None:
    """A network of any weights leaves pixels at SKY as the warp made them, and changes the others."""

    def under_a_sky(frame: Frame) -> Frame:
        depth = frame.depth.clone()
        depth[..., :6, :] = SKY
        return replace(frame, depth=depth)

    method, still = ExtraNet().eval(), silent()
    nn.init.normal_(method.network.leave.weight)
    frames = [under_a_sky(shot(t)) for t in (0.0, 2.0, 4.0)]
    request = unshaded(under_a_sky(shot(5.0, span=1.0)))
    image, warped = (each(request, fed(each, frames))[0] for each in (method, still))
    assert torch.equal(image[..., :6, :], warped[..., :6, :])
    assert not torch.allclose(image[..., 6:, :], warped[..., 6:, :], atol=1e-2)


def test_the_image_is_the_warped_one_plus_what_the_network_adds() -> None:
    method = silent()
    state = fed(method, [shot(t, square=1.0) for t in (0.0, 2.0, 4.0)])
    request = unshaded(shot(5.0, square=1.0, span=1.0))
    image, after = method(request, state)
    assert after is state
    base = method.prepare(request, state, steps(request, state.newest.shows.time, state.newest.shows.jitter)).base
    torch.testing.assert_close(image, torch.expm1(base) * surface(request))
    nn.init.constant_(method.network.leave.bias, 0.1)  # type: ignore[arg-type]
    torch.testing.assert_close(method(request, state)[0], torch.expm1(base + 0.1) * surface(request))


@torch.no_grad()
def test_the_output_can_be_added_to_an_image_whose_holes_are_filled() -> None:
    """A network that adds nothing gives the warp where that is valid; behind the square one sees the wall."""
    frames = [shot(t, speed=0, square=3.0) for t in (0.0, 2.0, 4.0)]
    request = unshaded(shot(5.0, speed=0, square=3.0, span=1.0))
    state = fed(silent(BETTER), frames)
    inputs = silent().prepare(request, state, steps(request, state.newest.shows.time, state.newest.shows.jitter))
    plain, _ = silent()(request, state)
    image, _ = silent(BETTER)(request, state)
    truth = shot(5.0, speed=0, square=3.0, span=1.0).color
    assert truth is not None
    known = inputs.mask.bool().expand_as(plain)
    torch.testing.assert_close(image[known], plain[known])
    worse, better = ((found - truth)[~known].abs().mean() for found in (plain, image))
    assert float(better) < 0.3 * float(worse)


@torch.no_grad()
def test_what_does_not_change_is_left_alone_whatever_the_network_says() -> None:
    """Three like frames: the image is the warped one. A light that changes: the residual is added where it does."""
    method = ExtraNet(BETTER).eval()
    nn.init.constant_(method.network.leave.bias, 0.5)  # type: ignore[arg-type]
    still = [shot(t, speed=0, square=0.0) for t in (0.0, 2.0, 4.0)]
    request = unshaded(shot(5.0, speed=0, square=0.0, span=1.0))
    image, _ = method(request, fed(method, still))
    kept, _ = silent(BETTER)(request, fed(method, still))
    torch.testing.assert_close(image, kept)
    assert still[0].color is not None
    dimmer = still[0].color.clone()
    dimmer[..., :8] *= 0.5
    lit = [replace(still[0], color=dimmer), *still[1:]]
    changed = (method(request, fed(method, lit))[0] - kept).abs().amax(1)
    assert float(changed[..., :8].mean()) > 0.05
    assert float(changed[..., 12:].max()) < 1e-5


def known(height: int = 11, width: int = 14) -> Inputs:
    """Random images, masks and surfaces."""
    generator = torch.Generator().manual_seed(7)

    def noise(channels: int) -> Tensor:
        return torch.rand(1, channels, height, width, generator=generator)

    past = tuple(torch.cat((noise(3), (noise(1) > 0.3).float()), 1) for _ in range(3))
    return Inputs(noise(3), noise(3), past[-1][:, 3:], noise(6), 2 * noise(4), past, torch.zeros(1, 2))


def test_what_is_mixed_like_a_brute_force_twin(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each image by its own part, pixels around by how much their surface is like, beyond the border those at it."""
    monkeypatch.setattr(mixing, "TILE", 50)  # three rows at a time
    inputs = known()
    height, width = inputs.base.shape[-2:]
    logits = torch.randn(1, len(DIFFERENCES) + BESIDE, height, width, generator=torch.Generator().manual_seed(8))
    found = mixed(inputs.base, differences(inputs), inputs.surfaces, logits)
    with torch.no_grad():
        tiled = mixed(inputs.base, differences(inputs), inputs.surfaces, logits)
    torch.testing.assert_close(tiled, found)
    base, surfaces, parts = inputs.base[0], inputs.surfaces[0], torch.tanh(logits)[0]
    oldest, middle, newest = (past[0] for past in inputs.past)

    def mean_change(a: Tensor, b: Tensor, row: int, column: int) -> Tensor:
        total, count = torch.zeros(3), 0.0
        for i in range(max(0, row - 4), min(height, row + 5)):
            for j in range(max(0, column - 4), min(width, column + 5)):
                both = float(a[3, i, j] * b[3, i, j])
                total, count = total + both * (b[:3, i, j] - a[:3, i, j]), count + both
        return total / max(count, 0.02 * 81)

    for row, column in ((0, 0), (5, 7), (10, 13), (3, 12), (9, 1)):
        here = (slice(None), row, column)
        part = parts[here]
        others = [
            inputs.occluded[0][here] - base[here],
            middle[3, row, column] * (middle[:3, row, column] - base[here]),
            oldest[3, row, column] * (oldest[:3, row, column] - base[here]),
            mean_change(middle, newest, row, column),
            mean_change(oldest, middle, row, column),
        ]
        for distance in REACH:
            for y, x in ((-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1)):
                i = min(max(row + distance * y, 0), height - 1)
                j = min(max(column + distance * x, 0), width - 1)
                alike = math.exp(-float((surfaces[:, i, j] - surfaces[here]).square().sum()))
                others.append(alike * (base[:, i, j] - base[here]))
        expected = sum(float(a) * b for a, b in zip(part, others, strict=True))
        torch.testing.assert_close(found[0][here], expected, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("size", [(3, 5), (9, 4), (20, 31)])
def test_sums_and_maxima_of_nine_by_nine_are_those_of_pools(size: tuple[int, int]) -> None:
    image = torch.rand(2, 3, *size, generator=torch.Generator().manual_seed(4))
    torch.testing.assert_close(mixing.of_nine(torch.add, image), 81 * F.avg_pool2d(image, 9, 1, 4))
    assert torch.equal(mixing.of_nine(torch.maximum, image), F.max_pool2d(image, 9, 1, 4))


def test_light_does_not_cross_to_another_surface_and_hidden_light_is_not_mixed() -> None:
    inputs = known()
    surfaces = inputs.surfaces.clone()
    surfaces[..., :7], surfaces[..., 7:] = 0.0, 9.0
    base = inputs.base.clone()
    base[..., :7], base[..., 7:] = 0.2, 0.9
    hidden = tuple(torch.cat((past[:, :3], torch.zeros_like(past[:, 3:])), 1) for past in inputs.past)
    inputs = replace(inputs, surfaces=surfaces, base=base, occluded=base, past=hidden)
    logits = torch.full((1, len(DIFFERENCES) + BESIDE, 11, 14), 5.0)
    assert float(mixed(base, differences(inputs), surfaces, logits).abs().max()) < 1e-6


def test_without_history_older_light_plays_no_part() -> None:
    """No holes and a light that changed in the older frames: only the method with a history can tell."""
    frames = [shot(t, speed=0, square=0.0) for t in (0.0, 2.0, 4.0)]
    assert frames[0].color is not None
    other = [replace(frames[0], color=0.3 * frames[0].color), *frames[1:]]
    request = unshaded(shot(5.0, speed=0, square=0.0, span=1.0))
    for history in (False, True):
        method = ExtraNet(replace(BETTER, steady=False, history=history)).eval()
        nn.init.constant_(method.network.leave.bias, 0.5)  # type: ignore[arg-type]
        with torch.no_grad():
            a, b = (method(request, fed(method, shots))[0] for shots in (frames, other))
        assert torch.equal(a, b) != history


@pytest.mark.parametrize("config", [Config(), BETTER])
def test_a_batch_is_its_images_and_a_reset_a_fresh_start(config: Config) -> None:
    method = ExtraNet(config).eval()
    one = [shot(t) for t in (0.0, 2.0, 4.0)]
    two = [shot(0.0, square=2.0), shot(2.0, square=2.0), replace(shot(4.0, square=2.0), reset=torch.tensor([True]))]
    request = [unshaded(shot(5.0, span=1.0)), unshaded(shot(5.0, square=2.0, span=1.0))]
    with torch.no_grad():
        state = fed(method, [concatenate(pair) for pair in zip(one, two, strict=True)])
        both, _ = method(concatenate(request), state)
        apart = method(request[0], fed(method, one))[0], method(request[1], fed(method, two[2:]))[0]
    torch.testing.assert_close(both, torch.cat(apart), atol=1e-4, rtol=1e-4)


@pytest.mark.parametrize("config", [Config(), BETTER, Config(history=False), Config(occlusion=False), Config(scale=2)])
def test_every_configuration_runs_at_odd_sizes(config: Config) -> None:
    method = ExtraNet(config).eval()

    def cut(frame: Frame) -> Frame:
        size = {f: getattr(frame, f)[..., :13, :21] for f in {*ExtraNet.needs_generated} - {"view", "projection"}}
        return replace(frame, **size, color=None if frame.color is None else frame.color[..., :13, :21])

    with torch.no_grad():
        state = fed(method, [cut(shot(t)) for t in (0.0, 2.0)])
        image, _ = method(cut(unshaded(shot(3.0, span=1.0))), state)
        shown, _ = method(cut(shot(4.0)), state)
    for output in (image, shown):
        assert output.shape == (1, 3, 13 * config.scale, 21 * config.scale)
        assert bool(torch.isfinite(output).all())
        assert bool((output >= 0).all())


# ExtraNet+.


def test_values_lie_where_their_samples_do_and_zeros_between() -> None:
    x = torch.rand(2, 1, 3, 4) + 1
    jitter = torch.tensor([[-0.25, -0.25], [0.25, -0.25]])
    larger = scattered(x, jitter, 2)
    assert torch.equal(larger[0, :, ::2, ::2], x[0])
    assert torch.equal(larger[1, :, ::2, 1::2], x[1])
    assert int((larger == 0).sum()) == 2 * 9 * 4


def test_enlarging_knows_where_the_samples_were() -> None:
    """A ramp sampled off the centres is the same ramp when enlarged, also where networks are rounded."""
    columns = (torch.arange(8) + 0.5)[None].expand(8, 8)
    for shift, rounded in ((-0.4, False), (0.0, False), (0.3, False), (0.3, True)):
        with torch.autocast("cpu", torch.bfloat16, enabled=rounded):
            larger = enlarged((columns + shift)[None, None], torch.tensor([[shift, 0.0]]), 2)
        expected = (torch.arange(16) + 0.5) / 2
        torch.testing.assert_close(larger[0, 0, 5, 2:-2], expected[2:-2], atol=1e-5, rtol=0)
