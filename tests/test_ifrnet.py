"""IFRNet: what an untrained network shows, what flow means, what never changes, losses."""

from dataclasses import replace

import pytest
import torch
from conftest import disc_frame
from torch import Tensor, nn

from framecast.frame import Frame, concatenate, moment
from framecast.methods.ifrnet import IFRNet, census, loss, recipe
from framecast.methods.larger import decoded, encoded
from framecast.nets import parameters


def stirred() -> IFRNet:
    """The method with decoders that say something."""
    torch.manual_seed(0)
    method = IFRNet().eval()
    for decoder in method.network.decoders:
        nn.init.normal_(decoder[2].weight, std=0.02)  # type: ignore[index, arg-type]
    return method


def run(method: IFRNet, frames: list[Frame], time: float) -> Tensor:
    state = method.start(frames[0])
    with torch.no_grad():
        for frame in frames:
            _, state = method(frame, state)
        image: Tensor = method(concatenate([moment(time)] * len(frames[0].reset)), state)[0]
    return image


def pair(start: float = 0.0) -> list[Frame]:
    """Two frames of the moving disc, two apart, of sides that 8 does not divide."""
    return [replace(disc_frame(start + t, step=2, height=26, width=45), time=torch.tensor([t])) for t in (0.0, 2.0)]


def fixed(method: IFRNet, flow: tuple[float, float, float, float], mask: float, added: float = 0.0) -> IFRNet:
    """The method with a network that says the same everywhere."""

    class Fixed(nn.Module):
        def forward(self, before: Tensor, after: Tensor, at: Tensor) -> tuple[Tensor, Tensor, Tensor]:
            whole = torch.ones_like(before[:, :1])
            return torch.tensor(flow).view(1, 4, 1, 1) * whole, mask * whole, added * whole.expand_as(before)

    method.network = Fixed()  # type: ignore[assignment]
    return method


@pytest.mark.parametrize("time", [0.5, 1.0, 1.6])
def test_an_untrained_network_blends(time: float) -> None:
    frames = pair()
    before, after = (encoded(frame.color) for frame in frames if frame.color is not None)
    image = run(fixed(IFRNet(), (0, 0, 0, 0), 0.0), frames, time)
    torch.testing.assert_close(image, decoded(before + (time / 2) * (after - before)), atol=1e-4, rtol=1e-3)


def test_flow_leads_from_the_new_frame_to_each_of_both() -> None:
    """A ramp that moves two pixels to the right in each half: the flow to the first frame is (-2, 0)."""
    frames = pair()
    steps = torch.arange(45.0).expand(1, 3, 26, 45) / 100
    frames = [
        replace(frame, color=decoded((steps + 0.2 - 0.02 * k).clamp(0, 1)))
        for k, frame in zip((0, 2), frames, strict=True)
    ]
    expected = decoded(steps + 0.2 - 0.02)
    for flow, mask in (((-2.0, 0.0, 9.0, 9.0), 30.0), ((9.0, 9.0, 2.0, 0.0), -30.0)):
        image = run(fixed(IFRNet(), flow, mask), frames, 1.0)
        torch.testing.assert_close(image[..., 3:-3], expected[..., 3:-3], atol=1e-4, rtol=1e-3)


def test_where_both_frames_agree_nothing_changes() -> None:
    frames = pair()
    same = [replace(frame, color=frames[0].color) for frame in frames]
    for method in (stirred(), fixed(IFRNet(), (3, 1, -2, 4), 0.5, added=0.2)):
        torch.testing.assert_close(run(method, same, 1.0), frames[0].color, atol=1e-4, rtol=1e-3)
    assert (
        float((run(stirred(), frames, 1.0) - run(fixed(IFRNet(), (0, 0, 0, 0), 0.0), frames, 1.0)).abs().max()) > 0.01
    )


def test_a_batch_is_its_images() -> None:
    method, one, two = stirred(), pair(), pair(3.0)
    both = run(method, [concatenate(each) for each in zip(one, two, strict=True)], 0.7)
    for image, frames in zip(both.split(1), (one, two), strict=True):
        torch.testing.assert_close(image, run(method, frames, 0.7), atol=1e-4, rtol=1e-3)


def test_census_compares_order_and_not_brightness() -> None:
    image = torch.rand(1, 3, 12, 16) / 2
    assert float(census(image, image)) == 0
    assert float(census(image, image + 0.3)) < 1e-6
    assert float(census(image, 0.5 - image)) > 0.5


def test_the_loss_vanishes_for_the_truth_and_gradients_reach_every_layer() -> None:
    method, frames = stirred().train(), [*pair(), moment(1.0)]
    with torch.no_grad():
        terms = loss(method, frames, run(method, frames[:2], 1.0)[:, None])
    assert float(terms["charbonnier"]) < 2e-3
    assert float(terms["census"]) < 1e-2
    terms = loss(method, frames, torch.rand(1, 1, 3, 26, 45))
    torch.stack(list(terms.values())).sum().backward()
    assert all(p.grad is not None and bool(p.grad.abs().sum() > 0) for p in method.parameters())
    assert recipe.mode == "interpolate"
    assert parameters(method) < 0.5e6
