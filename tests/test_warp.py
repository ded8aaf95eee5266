"""Laws of warps, splats and motion algebra, each beside its brute-force twin."""

import pytest
import torch

from framecast.frame import SKY
from framecast.warp import (
    EMPTY,
    FITS,
    _searched_at,
    _unlike,
    chain,
    disoccluded,
    fetch,
    inside,
    key_depth,
    key_index,
    landing,
    nearest_neighbour,
    pick,
    scale_motion,
    search_around,
    splat,
    trajectory,
    warp,
)


def brute_warp(image: torch.Tensor, motion: torch.Tensor) -> torch.Tensor:
    b, _, h, w = image.shape
    out = torch.zeros_like(image)
    for n in range(b):
        for j in range(h):
            for i in range(w):
                x = min(max(i + float(motion[n, 0, j, i]), 0), w - 1)
                y = min(max(j + float(motion[n, 1, j, i]), 0), h - 1)
                x0, y0 = min(int(x), max(w - 2, 0)), min(int(y), max(h - 2, 0))
                x1, y1 = min(x0 + 1, w - 1), min(y0 + 1, h - 1)
                fx, fy = x - x0, y - y0
                top = image[n, :, y0, x0] * (1 - fx) + image[n, :, y0, x1] * fx
                low = image[n, :, y1, x0] * (1 - fx) + image[n, :, y1, x1] * fx
                out[n, :, j, i] = top * (1 - fy) + low * fy
    return out


@pytest.mark.parametrize("compiling", [False, True])
@pytest.mark.parametrize("size", [(9, 13), (1, 7), (6, 1)])
def test_warp_equals_its_brute_force_twin(
    compiling: bool, size: tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(torch.compiler, "is_compiling", lambda: compiling)
    image, motion = torch.rand(2, 3, *size), torch.randn(2, 2, *size) * 4
    torch.testing.assert_close(warp(image, motion), brute_warp(image, motion), atol=2e-5, rtol=0)


def test_warp_without_motion_is_the_identity(monkeypatch: pytest.MonkeyPatch) -> None:
    image = torch.rand(1, 3, 20, 30) * 100
    still = torch.zeros(1, 2, 20, 30)
    torch.testing.assert_close(warp(image, still), image, atol=2e-3, rtol=0)
    monkeypatch.setattr(torch.compiler, "is_compiling", lambda: True)
    assert torch.equal(warp(image, still), image)


def test_warp_has_gradients() -> None:
    image = torch.rand(1, 1, 5, 6, dtype=torch.float64, requires_grad=True)
    motion = (torch.rand(1, 2, 5, 6) * 0.8 + 0.1).double()
    assert torch.autograd.gradcheck(lambda i: torch.nn.functional.mse_loss(warp(i, motion), i * 0), (image,))


def test_fetch_takes_the_pixel_that_contains_the_position() -> None:
    image = torch.arange(12.0).view(1, 1, 3, 4)
    motion = torch.zeros(1, 2, 3, 4)
    motion[0, 0] = 0.49
    assert torch.equal(fetch(image, motion), image)
    motion[0, 0] = 0.51
    assert fetch(image, motion)[0, 0, 0].tolist() == [1, 2, 3, 3]


def test_inside_includes_the_outer_edge_of_the_image() -> None:
    motion = torch.zeros(1, 2, 1, 2)
    motion[0, 0, 0] = torch.tensor([-0.5, 0.6])
    assert inside(motion)[0, 0, 0].tolist() == [True, False]


def test_chaining_two_translations_is_their_sum() -> None:
    a = torch.tensor([3.0, -2.0]).view(1, 2, 1, 1).expand(1, 2, 8, 8)
    b = torch.tensor([-1.25, 0.5]).view(1, 2, 1, 1).expand(1, 2, 8, 8)
    torch.testing.assert_close(chain([a, b]), a + b)


def test_chaining_reads_the_older_field_where_the_younger_one_leads() -> None:
    younger, older = torch.zeros(1, 2, 1, 6), torch.zeros(1, 2, 1, 6)
    younger[0, 0, 0, 4] = -3
    older[0, 0, 0, 1] = -1
    assert chain([younger, older])[0, 0, 0].tolist() == [0, -1, 0, 0, -4, 0]


def test_chaining_with_depth_stays_on_the_surface() -> None:
    """The wall was hidden behind something near that ran across: it must not take its vector."""
    still, crossing = torch.zeros(1, 2, 8, 8), torch.zeros(1, 2, 8, 8)
    wall, covered = torch.full((1, 1, 8, 8), 5.0), torch.full((1, 1, 8, 8), 5.0)
    crossing[:, 0, 2:6, 2:6] = -4
    covered[..., 2:6, 2:6] = 1
    assert (chain([still, crossing]) != 0).any()
    assert (chain([still, crossing], [wall, covered]) == 0).all()


def test_trajectory_is_exact_for_constant_acceleration() -> None:
    def x(t: float) -> float:
        return 2 * t + 0.75 * t * t

    t, s = 1.5, 0.5
    motion = torch.full((1, 2, 2, 2), x(t - s) - x(t))
    ahead = torch.full((1, 2, 2, 2), x(t + s) - x(t))
    path = trajectory(motion, ahead, torch.tensor([s]))
    for dt in (-3.0, -0.5, 0.0, 0.7, 2.0):
        expected = torch.full((1, 2, 2, 2), x(t + dt) - x(t))
        torch.testing.assert_close(path.displacement(torch.tensor([dt])), expected)


def brute_splat(depth: torch.Tensor, displacement: torch.Tensor) -> dict[tuple[int, int], tuple[float, int]]:
    _, _, h, w = depth.shape
    landed: dict[tuple[int, int], tuple[float, int]] = {}
    for j in range(h):
        for i in range(w):
            column = int(torch.floor(torch.tensor(i) + displacement[0, 0, j, i] + 0.5))
            row = int(torch.floor(torch.tensor(j) + displacement[0, 1, j, i] + 0.5))
            if 0 <= column < w and 0 <= row < h:
                key = (float(depth[0, 0, j, i]), j * w + i)
                landed[row, column] = min(landed.get((row, column), key), key)
    return landed


def test_splat_keeps_the_nearest_like_its_brute_force_twin() -> None:
    depth = torch.rand(1, 1, 11, 17).mul(4).round() + 1  # many ties
    depth[0, 0, 3, 3:6] = SKY
    displacement = torch.randn(1, 2, 11, 17) * 3
    keys = splat(depth, displacement)
    landed = brute_splat(depth, displacement)
    for j in range(11):
        for i in range(17):
            if (j, i) in landed:
                assert (float(key_depth(keys)[0, 0, j, i]), int(key_index(keys)[0, j, i])) == landed[j, i]
            else:
                assert keys[0, j, i] == EMPTY


def test_splats_reach_farther_than_packed_vectors_could() -> None:
    """More than 1023 columns and 511 rows, where vectors packed into 11 and 10 bits would be cut off."""
    depth, displacement = torch.full((1, 1, 540, 1100), 2.0), torch.zeros(1, 2, 540, 1100)
    depth[..., 3, 2] = 1.0
    displacement[0, :, 3, 2] = torch.tensor([1090.0, 530.0])
    keys = splat(depth, displacement)
    assert int(key_index(keys)[0, 533, 1092]) == 3 * 1100 + 2
    assert keys[0, 3, 2] == EMPTY


def test_splat_of_a_batch_is_the_batch_of_splats() -> None:
    depth, displacement = torch.rand(2, 1, 8, 9), torch.randn(2, 2, 8, 9) * 2
    both = splat(depth, displacement)
    for n in range(2):
        assert torch.equal(both[n : n + 1], splat(depth[n : n + 1], displacement[n : n + 1]))
    assert torch.equal(pick(depth, key_index(both))[1:], pick(depth[1:], key_index(both[1:])))


def test_nearest_neighbour_finds_the_smallest_depth_around() -> None:
    depth = torch.rand(2, 1, 7, 6)
    smallest = -torch.nn.functional.max_pool2d(-depth, 3, 1, 1)
    assert torch.equal(pick(depth, nearest_neighbour(depth)), smallest)


def test_scaled_motion_moves_large_pixels_by_as_many_large_pixels() -> None:
    motion = torch.randn(1, 2, 3, 4)
    large = scale_motion(motion, 2)
    assert large.shape == (1, 2, 6, 8)
    assert torch.equal(large[0, :, 4, 7], motion[0, :, 2, 3] * 2)
    assert scale_motion(motion, 1.5).shape == (1, 2, 4, 6)


def test_disoccluded_is_what_the_disc_hid() -> None:
    """A near disc moves right by 5: what it leaves behind is new, itself and the untouched wall are not."""
    x = torch.arange(32).expand(16, 32)
    y = torch.arange(16)[:, None].expand(16, 32)
    now = ((x - 20) ** 2 + (y - 8) ** 2 < 16)[None, None]
    before = ((x - 15) ** 2 + (y - 8) ** 2 < 16)[None, None]
    depth_now, depth_before = torch.where(now, 2.0, 5.0), torch.where(before, 2.0, 5.0)
    motion = torch.zeros(1, 2, 16, 32)
    motion[:, :1] = torch.where(now, -5.0, 0.0)
    new = disoccluded(depth_now, depth_before, motion)
    core = before & ~now
    shrunk = -torch.nn.functional.max_pool2d(-before.float(), 3, 1, 1) > 0
    assert torch.equal(new, core & shrunk)
    assert new.sum() > 5


def test_like_surfaces_are_searched_where_the_middle_does_not_fit_as_they_are_everywhere() -> None:
    """What few cores do at some pixels is what a GPU does at all of them; mostly something better is found."""
    generator = torch.Generator().manual_seed(2)
    depth, other = (1 + torch.rand(2, 1, 9, 13, generator=generator) for _ in range(2))
    motion = 4 * torch.rand(2, 2, 9, 13, generator=generator) - 2
    centre = landing(motion)
    misfit = _unlike(pick(other, centre), depth)
    index, least = search_around(centre, misfit, depth, other)
    everywhere = _searched_at(torch.arange(centre.numel()), centre, misfit, depth, other)
    assert torch.equal(index, everywhere[0])
    assert torch.equal(least, everywhere[1])
    torch.testing.assert_close(least, _unlike(pick(other, index), depth))
    fits = misfit < FITS
    assert torch.equal(index[fits[:, 0]], centre[fits[:, 0]])
    assert float((least < misfit)[~fits].float().mean()) > 0.8
