"""G-buffer guided warping: exact on like surfaces, background where it was uncovered, holes where nothing fits."""

from dataclasses import replace

import pytest
import torch
import torch.nn.functional as F
from passing import H, W, shot
from torch import Tensor

from framecast.color import decode_log, modulate
from framecast.frame import SKY, Frame, unshaded
from framecast.methods.guided import (
    HEAVIEST,
    OFFSETS,
    Config,
    GuidedWarp,
    Seen,
    _searched_everywhere,
    extrapolated,
    guided_warp,
    guides,
    search_elsewhere,
)
from framecast.methods.reproject import light, surface
from framecast.warp import warp

GENERATOR = torch.Generator().manual_seed(5)


def noise(channels: int) -> Tensor:
    return torch.rand(1, channels, H, W, generator=GENERATOR)


def seen(image: Tensor, surfaces: Tensor) -> Seen:
    return Seen(image, surfaces, torch.zeros(1, 2), torch.zeros(1))


def moving(x: float, y: float = 0.0) -> Tensor:
    return torch.tensor([x, y]).view(1, 2, 1, 1).expand(1, 2, H, W).contiguous()


def test_candidates_are_those_of_the_paper_each_once() -> None:
    assert len(OFFSETS) == len(set(OFFSETS)) == 33
    assert {max(abs(x), abs(y)) for x, y in OFFSETS} == {0, 1, 3, 5, 9}


def test_noise_that_stands_still_is_returned_as_it_is() -> None:
    """The candidates of the paper without its four copies of the middle one blur here."""
    image, surfaces = noise(3), noise(8)
    found, known = guided_warp(seen(image, surfaces), surfaces, moving(0))
    torch.testing.assert_close(found, image, atol=1e-4, rtol=0)
    assert bool(known.all())


@pytest.mark.parametrize("shift", [(3.0, -2.0), (0.4, 0.0), (-1.3, 2.7)])
def test_like_surfaces_move_as_bilinear_reads_do_parts_of_pixels_too(shift: tuple[float, float]) -> None:
    image, plain = noise(3), torch.full((1, 8, H, W), 0.5)
    motion = moving(*shift)
    found, known = guided_warp(seen(image, plain), plain, motion)
    middle = (..., slice(4, -4), slice(4, -4))
    torch.testing.assert_close(found[middle], warp(image, motion)[middle])
    assert bool(known[middle].all())


def test_uncovered_background_is_read_from_background() -> None:
    """Behind a dark square that moves over a plain wall the wall's light is found, wherever it was covered."""

    def painted(time: float) -> Frame:
        frame = shot(time, speed=0, square=3.0, span=1.0)
        assert frame.object is not None
        ours = (frame.object == 7).expand(-1, 3, -1, -1)
        return replace(
            frame, albedo=torch.where(ours, 0.1, 0.6), color=torch.where(ours, torch.tensor(0.01), torch.tensor(0.9))
        )

    past, now = painted(4.0), painted(5.0)
    image, _ = GuidedWarp()(unshaded(now), GuidedWarp().start(past))
    assert now.color is not None
    torch.testing.assert_close(image, now.color, atol=1e-4, rtol=0)


def test_the_search_is_its_brute_force_twin_everywhere_and_where_it_is_asked() -> None:
    image, there, here = noise(3), 2 * noise(8), 2 * noise(8)
    motion = 6 * noise(2) - 3
    everywhere = _searched_everywhere(image, there, here, motion, 4.0)
    kept = noise(1) > 0.3
    some = search_elsewhere(kept, image, there, here, motion, 4.0)
    torch.testing.assert_close(some, everywhere * ~kept)
    pairs = [torch.cat((each, each.flip(3))) for each in (image, there, here, motion)]
    torch.testing.assert_close(_searched_everywhere(*pairs, 4.0)[:1], everywhere)
    mirrored = torch.ones(2, 1, 1, 1, dtype=torch.bool).expand(2, 1, H, W)
    torch.testing.assert_close(search_elsewhere(~mirrored, *pairs, 4.0), _searched_everywhere(*pairs, 4.0))
    for row, column in ((0, 0), (5, 7), (12, 39), (23, 20), (11, 3)):
        x, y = column + float(motion[0, 0, row, column]), row + float(motion[0, 1, row, column])
        i, j = min(max(round(x), 0), W - 1), min(max(round(y), 0), H - 1)
        found = []
        for dx, dy in OFFSETS:
            if 0 <= i + dx < W and 0 <= j + dy < H:
                unlike = (there[0, :, j + dy, i + dx] - here[0, :, row, column]).square().sum()
                away = torch.tensor((i + dx - x) ** 2 + (j + dy - y) ** 2)
                weight = torch.exp(-away / 32) * (torch.exp(-unlike / 2) + 1e-6)
                found.append((float(weight), image[0, :, j + dy, i + dx]))
        best = sorted(found, key=lambda pair: -pair[0])[:HEAVIEST]
        total = sum(weight for weight, _ in best)
        mean = torch.stack([weight / total * value for weight, value in best]).sum(0)
        torch.testing.assert_close(everywhere[0, :3, row, column], mean, rtol=1e-4, atol=1e-5)
        torch.testing.assert_close(float(everywhere[0, 3, row, column]), best[0][0], rtol=1e-4, atol=1e-9)


def test_ties_do_not_shift_the_image() -> None:
    """Where nothing is alike a point becomes a symmetric spot, and the pixels are holes."""
    image = torch.zeros(1, 3, H, W)
    image[..., 12, 20] = 1
    there, here = torch.zeros(1, 8, H, W), torch.full((1, 8, H, W), 50.0)
    found, known = guided_warp(seen(image, there), here, moving(0))
    assert not bool(known.any())
    spot = found[..., 2:23, 10:31]
    for axes in ((-1,), (-2,), (-1, -2)):
        torch.testing.assert_close(spot, spot.flip(axes), atol=1e-6, rtol=0)
    assert float(found[..., 12, 20].min()) > 0.1


def test_what_leads_off_the_screen_finds_nothing_beyond_nine_pixels() -> None:
    image, surfaces = noise(3), torch.full((1, 8, H, W), 0.5)
    found, known = guided_warp(seen(image, surfaces), surfaces, moving(-15.0))
    assert bool(known[..., 15:].all())
    torch.testing.assert_close(found[..., 15:], image[..., :-15])
    assert bool(torch.isfinite(found).all())


def test_holes_are_filled_from_like_surfaces_around() -> None:
    """A wall of a colour that the last frame did not show, but for a strip of it, is lit as the strip is."""
    past, now = shot(4.0, speed=0), shot(5.0, speed=0, span=1.0)
    assert past.color is not None
    assert past.albedo is not None
    shown = torch.zeros(1, 1, H, W)
    shown[..., 10:12, :] = 1
    before = replace(past, albedo=past.albedo * (0.5 + 0.5 * shown), color=past.color * 0 + 0.2 * shown + 0.01)
    image, known = extrapolated(unshaded(now), GuidedWarp().start(before))
    assert not bool(known[..., 0, :].any())
    lit = float(light(before)[..., 10:12, :].mean())
    near = decode_log(image)[..., 22, 4:-4]  # eleven pixels below: beyond the warp's nine
    torch.testing.assert_close(near, decode_log(torch.full_like(near, lit)), rtol=2e-2, atol=0)


def test_the_sky_is_a_surface_of_its_own() -> None:
    frame = shot(0.0)
    assert frame.depth is not None
    depth = frame.depth.clone()
    depth[..., :6, :] = SKY
    split = guides(replace(frame, depth=depth))
    assert float(split[:, :6, :6].abs().max()) == 0
    assert float(split[:, 6:7, :6].min()) == 1
    image, wall = noise(3), guides(frame)
    _, known = guided_warp(seen(image, split), wall, moving(0))
    assert bool(known[..., 6:, :].all())
    heaven = guides(replace(frame, depth=torch.full_like(depth, SKY)))
    _, known = guided_warp(seen(image, heaven), wall, moving(0))
    assert not bool(known.any())


def test_no_object_takes_the_light_of_another_though_they_look_alike() -> None:
    """Beside a thing that moved off a wall like it the wall's own light is found, not the thing's; frames of which one
    has no objects are compared without them."""
    past, now = shot(4.0, speed=0), shot(5.0, speed=0, span=1.0)
    assert past.color is not None
    assert past.object is not None
    there, here = torch.zeros_like(past.object), torch.zeros_like(past.object)
    there[..., 8:16], here[..., 20:28] = 7, 7
    bright = torch.where(there > 0, 4 * past.color, past.color)
    before, after = replace(past, color=bright, object=there), unshaded(replace(now, object=here))
    plain, told = guides(after), GuidedWarp().start(before)
    still = moving(0)
    image, known = guided_warp(told, plain, still)
    wall, shown = (here == 0)[0, 0] & known[0, 0], (there == 0)[0, 0]
    assert bool((wall & ~shown).any())  # uncovered, and found beside it
    assert float(image[..., wall].max()) <= float(told.light[..., shown].max()) + 1e-4
    for first, second in ((before, replace(after, object=None)), (replace(before, object=None), after)):
        image, known = guided_warp(GuidedWarp().start(first), guides(second), still)
        torch.testing.assert_close(image, told.light)
        assert bool(known.all())


def test_light_is_warped_and_the_new_surface_shaded_with_it() -> None:
    """A base colour that changes from frame to frame by less than its width changes the image by as much."""
    past, now = shot(4.0, speed=0), shot(5.0, speed=0, span=1.0)
    assert now.albedo is not None
    now = replace(now, albedo=now.albedo * 1.02)
    image, _ = GuidedWarp()(unshaded(now), GuidedWarp().start(past))
    torch.testing.assert_close(image, modulate(decode_log(light(past)), surface(now)), atol=1e-4, rtol=1e-3)


def test_jitter_of_both_frames_is_part_of_the_motion() -> None:
    frames = shot(4.0, speed=2.0, jitter=(0.3, -0.2)), shot(5.0, speed=2.0, jitter=(-0.25, 0.1), span=1.0)
    image, _ = GuidedWarp()(unshaded(frames[1]), GuidedWarp().start(frames[0]))
    assert frames[1].color is not None
    inner = (..., slice(2, -2), slice(4, -4))
    straight, _ = GuidedWarp()(unshaded(replace(frames[1], jitter=torch.zeros(1, 2))), GuidedWarp().start(frames[0]))
    wrong, right = (F.mse_loss(found[inner], frames[1].color[inner]) for found in (straight, image))
    assert float(right) < 0.7 * float(wrong)


def test_widths_decide_what_is_alike() -> None:
    image, there = noise(3), torch.zeros(1, 8, H, W)
    here = there.clone()
    here[:, 0] = 0.12
    _, known = guided_warp(seen(image, there), here, moving(0), Config(albedo=0.5))
    assert bool(known.all())
    _, known = guided_warp(seen(image, there), here, moving(0), Config(albedo=0.02))
    assert not bool(known.any())
