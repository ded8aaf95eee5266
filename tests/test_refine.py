"""The flow of light: nothing before training, light alone moves, surfaces stay; the network sees time."""

from dataclasses import replace

import pytest
import torch
from passing import H, W, shot
from torch import Tensor

from framecast.frame import Frame, concatenate, unshaded
from framecast.losses import census, charbonnier
from framecast.methods.guided import GuidedWarp, guides
from framecast.methods.refine import MATCHED, RefinedWarp, blended, followed, loss, matched, shadows, shifted
from framecast.nets import parameters
from framecast.warp import warp


def shadowed(time: float, *, speed: float = 4.0) -> Frame:
    """A still floor of tiles over which a soft shadow moves, so many pixels a frame."""
    frame = shot(time, speed=0.0, span=2.0)
    assert frame.albedo is not None
    x, y = torch.arange(W) + 0.5, torch.arange(H)[:, None] + 0.5
    tiles = 0.3 + 0.4 * (((x // 3) + (y // 3)) % 2)
    shadow = 1 - 0.8 * torch.exp(-(((x - 8 - speed * time) / 5) ** 2)) * torch.ones_like(y)
    albedo = tiles.expand(1, 3, H, W).contiguous()
    return replace(frame, albedo=albedo, color=(albedo + 0.04) * shadow)


def moving_light(speed: float) -> list[Frame]:
    """Two shaded frames of it, and one to extrapolate."""
    last = replace(shadowed(3.0, speed=speed), span=torch.ones(1))
    return [shadowed(0.0, speed=speed), shadowed(2.0, speed=speed), unshaded(last)]


def flow(x: float, y: float = 0.0) -> Tensor:
    return torch.tensor([x, y]).view(1, 2, 1, 1).expand(1, 2, H, W).contiguous()


def trained(seed: int = 0) -> RefinedWarp:
    """A network whose flows are anything but 0."""
    torch.manual_seed(seed)
    method = RefinedWarp().eval()
    assert method.network is not None
    for name, p in method.network.decoder.named_parameters():
        if name.endswith("3.weight"):
            torch.nn.init.normal_(p, std=0.5)
    return method


def test_what_does_not_move_stays_where_the_guided_warp_left_it() -> None:
    method, plain = RefinedWarp(MATCHED), GuidedWarp()
    frames = [shot(t, square=2.0, jitter=(0.1 * t, -0.2)) for t in (0.0, 2.0)]
    new = unshaded(shot(3.0, square=2.0, span=1.0))
    state = followed(frames[1], method.start(frames[0]))
    found, _ = method(new, state)
    torch.testing.assert_close(found, plain(new, plain.start(frames[1]))[0])


def test_a_shadow_is_followed_without_training_and_an_untrained_network_changes_nothing() -> None:
    torch.manual_seed(0)
    frames, plain = moving_light(2.0), GuidedWarp()
    truth = shadowed(3.0, speed=2.0).color
    assert truth is not None
    images = []
    for method in (RefinedWarp(MATCHED), RefinedWarp()):
        state = followed(frames[1], method.start(frames[0]))
        with torch.no_grad():
            images.append(method(frames[2], state)[0])
    warped, _ = plain(frames[2], plain.start(frames[1]))
    before, after = (float((image - truth).square().mean()) for image in (warped, images[0]))
    assert after < 0.3 * before
    torch.testing.assert_close(*images)


def test_the_flow_found_is_the_flow_there_is() -> None:
    """Soft spots that move by (2, -1) pixels between the newer frame and now; holes and stillness give none."""
    y, x = torch.meshgrid(torch.arange(64.0), torch.arange(96.0), indexing="ij")

    def spots(ago: float) -> Tensor:
        u, v = x + 2 * ago, y - ago
        return (torch.sin(u * 0.11) + torch.cos(v * 0.13 + u * 0.04)).expand(1, 3, 64, 96).contiguous()

    known, ratio = torch.ones(1, 1, 64, 96), torch.tensor([3.0])
    found = matched(spots(1), spots(3), known, ratio)
    inner = found[..., 16:-16, 16:-16].flatten(2).median(2).values
    torch.testing.assert_close(inner, torch.tensor([[-2.0, 1.0]]), atol=0.35, rtol=0)
    assert float(matched(spots(1), spots(1), known, ratio).abs().max()) == 0
    assert float(matched(spots(1), spots(3), 0 * known, ratio).abs().max()) == 0


def test_the_right_flow_moves_the_shadow_and_leaves_the_tiles() -> None:
    past, now = shadowed(2.0), shadowed(3.0)
    assert now.color is not None
    state = GuidedWarp().start(past)
    light = GuidedWarp().start(now).light
    found = blended(state.light, flow(-4.0), guides(now)[:, :7])
    inner = (..., slice(6, -6))
    before = (state.light - light)[inner].abs().mean()
    assert float((found - light)[inner].abs().mean()) < 0.1 * float(before)


def test_light_is_not_taken_from_another_surface_nor_where_it_hardly_differs() -> None:
    light = torch.rand(1, 3, H, W)
    surfaces = torch.zeros(1, 7, H, W)
    surfaces[:, 5] = 1
    shown = blended(light, flow(3.0), surfaces)
    torch.testing.assert_close(shown[..., 8, 8], light[..., 8, 11])
    turned = surfaces.clone()
    turned[:, 3:6, :, 20:] = torch.tensor([1.0, 0.0, 0.0]).view(1, 3, 1, 1)
    torch.testing.assert_close(blended(light, flow(3.0), turned)[..., 17:20], light[..., 17:20])
    sky = torch.zeros_like(surfaces)
    assert torch.equal(blended(light, flow(3.0), sky), light)
    faint = 1 + 0.01 * light
    assert torch.equal(blended(faint, flow(3.0), surfaces), faint)


def test_reads_along_the_flow_are_those_of_warp() -> None:
    image, way = torch.rand(2, 5, H, W), 4 * torch.rand(2, 2, H, W) - 2
    torch.testing.assert_close(shifted(image, way), warp(image, way), atol=1e-5, rtol=0)
    wide = torch.rand(1, 2, 3, 320).bfloat16()  # whose bits are too few for 320 places
    image = shifted(wide, torch.zeros(1, 2, 3, 320)).float()
    torch.testing.assert_close(image, wide.float(), atol=1e-3, rtol=0)


def test_the_network_has_four_sizes_and_knows_how_long_ago() -> None:
    network = trained().network
    assert network is not None
    a, b = torch.rand(2, 1, 3, 32, 48)
    rough, start = torch.rand(1, 1, 32, 48), torch.full((1, 2, 32, 48), 1.5)
    found, features = network(a, b, rough, torch.tensor([3.0]), start)
    assert found.shape == (1, 2, 32, 48)
    assert [tuple(f.shape[1:]) for f in features] == [(32, 4, 6), (24, 8, 12), (16, 16, 24)]
    other, _ = network(a, b, rough, torch.tensor([2.0]), start)
    assert float((found - other).detach().abs().max()) > 1e-4
    assert parameters(network) == 438_288


def test_without_an_older_frame_of_the_shot_nothing_moves() -> None:
    method, plain = trained(), GuidedWarp()
    first, new = shot(2.0), unshaded(shot(3.0, span=1.0))
    cut = replace(first, reset=torch.tensor([True]))
    for state in (method.start(first), followed(cut, method.start(shot(0.0)))):
        with torch.no_grad():
            found, _ = method(new, state)
        torch.testing.assert_close(found, plain(new, plain.start(first))[0])


def test_a_batch_is_its_images() -> None:
    method = trained()
    shots = [moving_light(3.0), moving_light(-2.0)]

    def last(frames: list[Frame]) -> Tensor:
        state = method.start(frames[0])
        with torch.no_grad():
            for frame in frames:
                image, state = method(frame, state)
        return image

    both = last([concatenate(pair) for pair in zip(*shots, strict=True)])
    for k in (0, 1):
        torch.testing.assert_close(both[k : k + 1], last(shots[k]), atol=1e-4, rtol=1e-3)
    plain = GuidedWarp()
    assert not torch.allclose(both[:1], plain(shots[0][2], plain.start(shots[0][1]))[0], atol=1e-2)


def test_charbonnier_is_nearly_l1() -> None:
    difference = torch.tensor([0.0, 0.5, -0.25]).view(1, 1, 1, 3)
    torch.testing.assert_close(float(charbonnier(difference)), (0.001 + 0.5 + 0.25) / 3, atol=1e-5, rtol=0)


def test_census_is_its_brute_force_twin_and_blind_to_brightness() -> None:
    a, b = torch.rand(2, 1, 2, 9, 11)
    assert float(census(a, a + 0.3)) < 1e-9
    total, count = 0.0, 0
    for c in range(2):
        for y in range(1, 8):
            for x in range(1, 10):
                for dy in (-1, 0, 1):
                    for dx in (-1, 0, 1):
                        if dy or dx:
                            p, q = (float(i[0, c, y + dy, x + dx] - i[0, c, y, x]) for i in (a, b))
                            e = (p / (0.81 + p * p) ** 0.5 - q / (0.81 + q * q) ** 0.5) ** 2
                            total, count = total + e / (0.1 + e), count + 1
    torch.testing.assert_close(float(census(a, b, 3)), total / count, atol=1e-6, rtol=1e-4)


def test_shadows_move_evenly_and_are_drawn_from_the_sample() -> None:
    torch.manual_seed(6)
    sample = torch.rand(1, 1, 3, 64, 96)
    times = torch.tensor([[0.0], [1.0], [2.0]])
    found = shadows((64, 96), times, sample)
    assert 0.1 <= float(found.min()) < float(found.max()) <= 1
    assert torch.equal(found, shadows((64, 96), times, sample))
    assert not torch.allclose(found, shadows((64, 96), times, sample + 0.1), atol=0.1)

    def apart(k: int, x: int, y: int) -> float:
        return float((found[k].roll((y, x), (2, 3)) - found[k - 1])[..., 14:-14, 14:-14].abs().mean())

    moves = [min((apart(k, x, y), x, y) for x in range(-12, 13) for y in range(-12, 13)) for k in (1, 2)]
    assert moves[0][1:] == moves[1][1:] != (0, 0)
    assert moves[0][0] < 0.2 * apart(1, 0, 0)


def test_the_loss_is_of_light_that_moves_and_gradients_reach_every_layer(monkeypatch: pytest.MonkeyPatch) -> None:
    torch.manual_seed(4)
    method, frames, still = RefinedWarp(), moving_light(4.0), moving_light(0.0)
    targets = [shadowed(3.0, speed=s).color for s in (4.0, 0.0)]
    assert targets[0] is not None
    assert targets[1] is not None
    made = loss(method, still, targets[1][:, None])
    assert made["charbonnier"].item() > 0.01  # our own shadows
    monkeypatch.setattr(
        "framecast.methods.refine.shadows", lambda size, when, sample: torch.ones(len(when), 1, 1, *size)
    )
    moving, calm = loss(method, frames, targets[0][:, None]), loss(method, still, targets[1][:, None])
    assert calm["charbonnier"].item() < 0.002 < 0.01 < moving["charbonnier"].item()
    assert calm["census"].item() < 1e-4 < moving["census"].item()
    torch.stack(list(moving.values())).sum().backward()
    assert all(p.grad is not None for p in method.parameters())
    assert float(method.network.decoder[3][3].weight.grad.abs().sum()) > 0  # type: ignore[union-attr,operator]


@pytest.mark.parametrize("lacking", ["roughness", "albedo"])
def test_a_missing_buffer_is_named(lacking: str) -> None:
    method, frame = RefinedWarp(), shot(0.0)
    with pytest.raises(ValueError, match=f"no {lacking}"):
        method.start(replace(frame, **{lacking: None}))
    with pytest.raises(ValueError, match=f"time 1 was not shaded and has no {lacking}"):
        method(unshaded(replace(shot(1.0), **{lacking: None})), method.start(frame))
