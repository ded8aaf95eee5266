"""Laws of resampling through the learned table."""

import pytest
import torch
from torch import Tensor

from framecast.resample import sharp_warp
from framecast.table import LEVELS, resample, shipped_table
from framecast.warp import warp

TABLE = shipped_table()
H, W = 20, 28


def texture(height: int = H, width: int = W) -> Tensor:
    """Waves of several lengths and a hard edge, between 0 and 1."""
    y, x = torch.meshgrid(torch.arange(height) + 0.0, torch.arange(width) + 0.0, indexing="ij")
    waves = 0.4 + 0.2 * torch.sin(0.9 * x + 0.3 * y) + 0.15 * torch.cos(1.7 * y - 0.4 * x)
    return torch.where(x + 0.4 * y > 0.7 * width, waves + 0.2, waves).expand(1, 3, -1, -1).contiguous()


def moved(image: Tensor, dx: float, dy: float, *, bounded: bool = False) -> Tensor:
    motion = torch.zeros(1, 2, *image.shape[-2:])
    motion[:, 0], motion[:, 1] = dx, dy
    return resample(image, motion, TABLE, bounded=bounded)


def test_weights_sum_to_one_and_whole_pixels_keep_their_value() -> None:
    torch.testing.assert_close(TABLE.sum(-1), torch.ones(LEVELS, LEVELS), atol=1e-5, rtol=0)
    assert TABLE[0, 0].tolist() == [0.0] * 5 + [1.0] + [0.0] * 10


def test_mirrored_and_transposed_positions_have_mirrored_and_transposed_weights() -> None:
    taps = TABLE.view(LEVELS, LEVELS, 4, 4)
    near = {"atol": 1e-6, "rtol": 0}
    torch.testing.assert_close(taps, taps.permute(1, 0, 3, 2), **near)
    torch.testing.assert_close(taps[:, 1:], taps[:, 1:].flip(1).flip(3), **near)
    torch.testing.assert_close(taps[1:], taps[1:].flip(0).flip(2), **near)
    torch.testing.assert_close(taps[:, 0, :, :3], taps[:, 0, :, :3].flip(2), **near)
    torch.testing.assert_close(taps[:, 0, :, 3], torch.zeros(LEVELS, 4), **near)


@pytest.mark.parametrize("bounded", [False, True])
def test_each_pixel_is_the_weighted_sum_of_sixteen(bounded: bool) -> None:
    """Against a loop over pixels, with positions between pixels, off the image and at its border."""
    image, motion = texture(6, 7), torch.empty(1, 2, 6, 7).uniform_(-4, 4)
    result = resample(image, motion, TABLE, bounded=bounded)
    for y in range(6):
        for x in range(7):
            at_x = round(min(max(x + motion[0, 0, y, x].item(), 0), 6) * LEVELS)
            at_y = round(min(max(y + motion[0, 1, y, x].item(), 0), 5) * LEVELS)
            rows = [min(max(at_y // LEVELS + k, 0), 5) for k in range(-1, 3)]
            columns = [min(max(at_x // LEVELS + k, 0), 6) for k in range(-1, 3)]
            taps = image[0][:, rows][:, :, columns]
            expected = (taps * TABLE[at_y % LEVELS, at_x % LEVELS].view(4, 4)).sum((1, 2))
            if bounded:
                inner = taps[:, 1:3, 1:3].flatten(1)
                expected = expected.clamp(inner.amin(1), inner.amax(1))
            torch.testing.assert_close(result[0, :, y, x], expected, atol=1e-5, rtol=1e-5)


def test_whole_pixels_move_bit_for_bit_and_constants_stay() -> None:
    image = texture()
    assert torch.equal(moved(image, 3, -2)[..., 4:-4, 4:-4], image.roll((2, -3), (2, 3))[..., 4:-4, 4:-4])
    flat = torch.full((1, 3, H, W), 0.7)
    torch.testing.assert_close(moved(flat, 0.37, -1.61), flat, atol=1e-5, rtol=0)


def test_a_mirrored_image_moves_the_other_way() -> None:
    image = texture()
    torch.testing.assert_close(moved(image.flip(3), -0.3, 0.7), moved(image, 0.3, 0.7).flip(3), atol=1e-5, rtol=0)
    swapped = moved(image.transpose(2, 3).contiguous(), 0.7, 0.3).transpose(2, 3)
    torch.testing.assert_close(swapped, moved(image, 0.3, 0.7), atol=1e-5, rtol=0)


def test_eight_moves_by_half_a_pixel_lose_less_than_catmull_rom_and_bilinear() -> None:
    """There and back along both axes; a hard edge and short waves."""
    image = texture(48, 64)

    def error(step: object) -> float:
        result = image
        for k in range(8):
            motion = torch.full((1, 2, 48, 64), 0.5 if k % 2 == 0 else -0.5)
            result = step(result, motion)  # type: ignore[operator]
        return float((result - image)[..., 8:-8, 8:-8].square().mean())

    learned = error(lambda i, m: resample(i, m, TABLE))
    cubic = error(lambda i, m: sharp_warp(i, m, bounded=False))
    assert learned < cubic < error(warp)
