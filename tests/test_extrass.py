"""ExtraSS: known sizes, which encoder sees what, what an untrained network shows, history, losses."""

from dataclasses import replace

import pytest
import torch
from passing import H, W, shot
from torch import Tensor

from framecast.color import encode_srgb, tonemap
from framecast.frame import Frame, concatenate, unshaded
from framecast.methods.extrass import ExtraSS, loss, recipe
from framecast.methods.guided import GuidedWarp
from framecast.methods.larger import encoded
from framecast.nets import multiply_accumulates, parameters
from framecast.resample import enlarge, tent

SIZE = (2 * H, 2 * W)


def larger(color: Tensor, frame: Frame) -> Tensor:
    """A frame's colour at twice the size, tone-mapped under the sRGB curve."""
    return encode_srgb(enlarge(tonemap(color), SIZE, frame.jitter, tent, 2).image.clamp(0, 1))


def alternating(count: int = 4, *, speed: float = 3.0, square: float | None = None) -> list[Frame]:
    """Shaded and unshaded frames in turn, their vectors to the frame before."""
    jitters = ((0.0, 0.0), (0.25, -0.3), (-0.2, 0.1), (0.4, 0.2))
    frames = [shot(float(t), speed=speed, square=square, jitter=jitters[t % 4], span=1.0) for t in range(count)]
    return [unshaded(frame) if t % 2 else frame for t, frame in enumerate(frames)]


def run(method: ExtraSS, frames: list[Frame]) -> list[Tensor]:
    images, state = [], method.start(frames[0])
    with torch.no_grad():
        for frame in frames:
            image, state = method(frame, state)
            images.append(image)
    return images


def fresh(*, trust: float | None = None) -> ExtraSS:
    """The method with a decoder that adds nothing, and keeps as much of the last image as the logit says."""
    torch.manual_seed(0)
    method = ExtraSS().eval()
    with torch.no_grad():
        method.decoder.leave.weight.zero_()
        if trust is not None:
            assert method.decoder.leave.bias is not None
            method.decoder.leave.bias[12:] = trust
    return method


def test_parameters_and_operations_are_those_written_down() -> None:
    method = ExtraSS()
    assert parameters(method) == 378_032
    count = multiply_accumulates(method, lambda: run(method, [shot(0.0)]))
    a, b, c, d = 24, 32, 48, 64
    whole = 9 * (31 * a + a * a + (a + b) * a + a * a + a * 16)
    half = 9 * (a * b + b * b + (b + c) * b + b * b)
    quarter = 9 * (b * c + c * c + (c + d) * c + c * c)
    eighth = 9 * (c * d + d * d)
    assert count == H * W * (64 * whole + 16 * half + 4 * quarter + eighth) // 64


def test_without_history_a_network_that_adds_nothing_shows_the_enlarged_frame() -> None:
    frames = alternating(1)
    image = run(fresh(), frames)[0]
    assert frames[0].color is not None
    torch.testing.assert_close(encoded(image), larger(frames[0].color, frames[0]), atol=1e-3, rtol=0)


def test_an_unshaded_frame_begins_as_the_guided_warp() -> None:
    """Nothing kept of the last image, nothing added: the enlarged guided warp, and its network is the other encoder."""
    frames = alternating(2, square=3.0)
    method = fresh(trust=-30)
    found = run(method, frames)[1]
    warped, _ = GuidedWarp()(frames[1], GuidedWarp().start(frames[0]))
    torch.testing.assert_close(encoded(found), larger(warped, frames[1]), atol=1e-3, rtol=0)


def test_each_kind_of_frame_has_its_encoder() -> None:
    torch.manual_seed(1)
    method, frames = ExtraSS().eval(), alternating(2)
    torch.nn.init.normal_(method.decoder.leave.weight, std=0.1)
    before = run(method, frames)
    with torch.no_grad():
        method.extrapolated.stages[0][0].weight.mul_(2)
    after = run(method, frames)
    assert torch.equal(before[0], after[0])
    assert not torch.allclose(before[1], after[1], atol=1e-3)


def test_the_last_image_is_carried_along_by_unshaded_frames_too() -> None:
    """Where all is kept and nothing moves, the first image stays, whatever is shaded later."""
    frames = alternating(4, speed=0.0)
    images = run(fresh(trust=30), frames)
    for image in images[1:]:
        torch.testing.assert_close(encoded(image), encoded(images[0]), atol=2e-3, rtol=0)


def test_a_batch_is_its_images_and_a_reset_a_fresh_start() -> None:
    torch.manual_seed(2)
    method = ExtraSS().eval()
    torch.nn.init.normal_(method.decoder.leave.weight, std=0.05)
    one, two = alternating(4), alternating(4, square=2.0)
    two[2] = replace(two[2], reset=torch.tensor([True]))
    both = run(method, [concatenate(pair) for pair in zip(one, two, strict=True)])
    apart = run(method, one), run(method, two[2:])
    for k in range(4):
        torch.testing.assert_close(both[k][:1], apart[0][k], atol=1e-4, rtol=1e-3)
    for k in (2, 3):
        torch.testing.assert_close(both[k][1:], apart[1][k - 2], atol=1e-4, rtol=1e-3)


def test_losses_vanish_for_the_truth_and_gradients_reach_every_layer() -> None:
    torch.manual_seed(3)
    method, frames = ExtraSS(), alternating(4, square=3.0)
    with torch.no_grad():
        terms = loss(method, frames, torch.stack(run(method.eval(), frames), 1))
    assert float(terms["l1"]) < 1e-3
    assert float(terms["ssim"]) < 1e-3
    assert float(terms["hole"]) < 1e-3
    assert float(terms["temporal"]) > 0
    terms = loss(method.train(), frames, torch.rand(1, 4, 3, *SIZE))
    torch.stack(list(terms.values())).sum().backward()
    assert all(p.grad is not None and bool(p.grad.abs().sum() > 0) for p in method.parameters())
    assert recipe.mode == "alternate"


def test_the_temporal_term_is_of_shaded_frames_alone() -> None:
    method, frames = ExtraSS(), alternating(2)
    assert "temporal" not in loss(method, frames, torch.rand(1, 2, 3, *SIZE))


@pytest.mark.parametrize("lacking", ["albedo", "normal", "motion"])
def test_a_missing_buffer_is_named(lacking: str) -> None:
    with pytest.raises(ValueError, match=f"no {lacking}"):
        ExtraSS().start(replace(shot(0.0), **{lacking: None}))
