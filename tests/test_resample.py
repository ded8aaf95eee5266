"""Laws of enlarging, sharp warps and clamps, each beside its brute-force twin."""

import math
from collections.abc import Callable

import pytest
import torch

from framecast.resample import (
    Box,
    catmull_rom,
    enlarge,
    enlarged_motion,
    foreground,
    from_ycocg,
    gaussian,
    jitter,
    lanczos,
    moments,
    nearest_sample,
    neighbourhood,
    phases,
    sharp_warp,
    spread,
    tent,
    to_ycocg,
)
from framecast.warp import warp

KERNELS = [(tent, 2), (gaussian, 3), (lanczos, 4), (catmull_rom, 4)]

TWINS: dict[Callable, Callable[[float], float]] = {
    tent: lambda x: max(1 - abs(x), 0.0),
    gaussian: lambda x: math.exp(-2.29 * x * x),
    lanczos: lambda x: (
        1.0
        if x == 0
        else 2 * math.sin(math.pi * x) * math.sin(math.pi * x / 2) / (math.pi * x) ** 2
        if abs(x) < 2
        else 0.0
    ),
    catmull_rom: lambda x: (
        1.5 * abs(x) ** 3 - 2.5 * x * x + 1
        if abs(x) < 1
        else -0.5 * abs(x) ** 3 + 2.5 * x * x - 4 * abs(x) + 2
        if abs(x) < 2
        else 0.0
    ),
}


def brute_enlarge(
    image: torch.Tensor, size: tuple[int, int], at: torch.Tensor, kernel: Callable[[float], float], taps: int
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Every pixel by itself: the taps x taps samples nearest to its centre."""
    b, c, h, w = image.shape
    result, total, peak = torch.zeros(b, c, *size), torch.zeros(b, 1, *size), torch.zeros(b, 1, *size)
    for n in range(b):
        jx, jy = at[n].tolist()
        for row in range(size[0]):
            for column in range(size[1]):
                x, y = (column + 0.5) * w / size[1], (row + 0.5) * h / size[0]
                near_i = sorted(range(-3, w + 3), key=lambda i: abs(i + 0.5 + jx - x))[:taps]
                near_j = sorted(range(-3, h + 3), key=lambda j: abs(j + 0.5 + jy - y))[:taps]
                weights = {(i, j): kernel(i + 0.5 + jx - x) * kernel(j + 0.5 + jy - y) for i in near_i for j in near_j}
                for (i, j), weight in weights.items():
                    result[n, :, row, column] += weight * image[n, :, min(max(j, 0), h - 1), min(max(i, 0), w - 1)]
                total[n, 0, row, column] = sum(weights.values())
                peak[n, 0, row, column] = max(weights.values())
    return result / total, total, peak


def plane(height: int, width: int, at: torch.Tensor | None = None, step: float = 1.0) -> torch.Tensor:
    """0.3 x + 0.7 y at pixel centres `step` apart, or at their samples."""
    x, y = (torch.arange(width) + 0.5) * step, (torch.arange(height) + 0.5) * step
    jx, jy = (0.0, 0.0) if at is None else at[0].tolist()
    return (0.3 * (x + jx) + 0.7 * (y + jy)[:, None])[None, None]


def test_jitter_sequence() -> None:
    """Halton(2, 3), 8 scale^2 phases, well spread around the centre."""
    assert [phases(s) for s in (1, 1.5, 1.7, 2, 3)] == [8, 18, 24, 32, 72]
    points = torch.tensor([jitter(k, 32) for k in range(32)])
    torch.testing.assert_close(points[:3], torch.tensor([[0, -1 / 6], [-0.25, 1 / 6], [0.25, -7 / 18]]))
    assert points.abs().max() < 0.5
    assert points.mean(0).abs().max() < 0.04
    assert jitter(33, 32) == jitter(1, 32)
    assert jitter(5, 0) == (0.0, 0.0)


def test_kernels_have_their_known_values() -> None:
    at = torch.tensor([0.0, 0.5, -0.5, 1.0, 1.5, 2.0])
    known = {
        tent: [1, 0.5, 0.5, 0, 0, 0],
        gaussian: [1, 0.5641, 0.5641, 0.1013, 0.0058, 0.0001],
        lanczos: [1, 0.5732, 0.5732, 0, -0.0637, 0],
        catmull_rom: [1, 0.5625, 0.5625, 0, -0.0625, 0],
    }
    for kernel, values in known.items():
        torch.testing.assert_close(kernel(at), torch.tensor(values), atol=1e-4, rtol=0)


@pytest.mark.parametrize(("kernel", "taps"), KERNELS)
@pytest.mark.parametrize("size", [(8, 10), (6, 7), (12, 15), (4, 5)])
def test_enlarging_equals_its_brute_force_twin(kernel: Callable, taps: int, size: tuple[int, int]) -> None:
    image, at = torch.rand(2, 1, 4, 5), torch.tensor([[0.31, -0.42], [-0.11, 0.24]])
    made = enlarge(image, size, at, kernel, taps)
    image, total, peak = brute_enlarge(image, size, at, TWINS[kernel], taps)
    torch.testing.assert_close(made.image, image, atol=2e-5, rtol=1e-5)
    torch.testing.assert_close(made.total, total, atol=2e-5, rtol=1e-5)
    torch.testing.assert_close(made.peak, peak, atol=2e-5, rtol=1e-5)


@pytest.mark.parametrize(("kernel", "taps"), KERNELS)
def test_a_constant_stays_constant(kernel: Callable, taps: int) -> None:
    made = enlarge(torch.full((1, 2, 6, 5), 0.7), (9, 8), torch.tensor([[0.4, -0.3]]), kernel, taps)
    torch.testing.assert_close(made.image, torch.full((1, 2, 9, 8), 0.7), atol=1e-6, rtol=0)


@pytest.mark.parametrize(("kernel", "taps"), [(tent, 2), (catmull_rom, 4)])
@pytest.mark.parametrize("scale", [1.0, 1.5, 2.0, 3.0])
def test_nothing_shifts_with_jitter(kernel: Callable, taps: int, scale: float) -> None:
    """What rises evenly is reproduced exactly wherever it was sampled, away from the border."""
    for k in range(6):
        at = torch.tensor([jitter(k, 32)])
        made = enlarge(plane(12, 16, at), (round(12 * scale), round(16 * scale)), at, kernel, taps).image
        edge = math.ceil(3 * scale)
        right = plane(*made.shape[-2:], step=1 / scale)[..., edge:-edge, edge:-edge]
        torch.testing.assert_close(made[..., edge:-edge, edge:-edge], right, atol=1e-4, rtol=0)


def test_samples_keep_their_values_and_say_so() -> None:
    """At three times the size and no jitter the centres of every third pixel are samples."""
    image = torch.rand(1, 3, 4, 5)
    for kernel, taps in KERNELS:
        made = enlarge(image, (12, 15), torch.zeros(1, 2), kernel, taps)
        torch.testing.assert_close(made.peak[..., 1::3, 1::3], torch.ones(1, 1, 4, 5), atol=1e-5, rtol=0)
        assert made.peak[..., 0::3, 0::3].max() < 0.9
        if kernel is not gaussian:
            torch.testing.assert_close(made.image[..., 1::3, 1::3], image, atol=1e-5, rtol=0)


def test_nearest_sample_is_the_nearest() -> None:
    at = torch.tensor([[0.3, -0.45], [-0.2, 0.1]])
    index = nearest_sample((3, 4), (6, 8), at)
    for n in range(2):
        for row in range(6):
            for column in range(8):
                x, y = (column + 0.5) / 2 - at[n, 0], (row + 0.5) / 2 - at[n, 1]
                distance = [(i + 0.5 - x) ** 2 + (j + 0.5 - y) ** 2 for j in range(3) for i in range(4)]
                assert distance[int(index[n, row, column])] == min(distance)


def test_motion_of_a_larger_image_is_longer() -> None:
    motion = torch.tensor([1.0, -2.0]).view(1, 2, 1, 1).expand(1, 2, 4, 6)
    made = enlarged_motion(motion, (6, 12), torch.tensor([[0.2, 0.4]]))
    assert made.shape == (1, 2, 6, 12)
    assert torch.equal(made[0, :, 0, 0], torch.tensor([2.0, -3.0]))
    assert bool((made == made[:, :, :1, :1]).all())


def test_the_foreground_carries_its_motion_one_pixel_outwards() -> None:
    depth, motion = torch.full((1, 1, 5, 5), 9.0), torch.zeros(1, 2, 5, 5)
    depth[0, 0, 2, 2], motion[0, 0, 2, 2] = 1.0, 4.0
    near, moved = foreground(depth, motion)
    expected = torch.full((5, 5), 9.0)
    expected[1:4, 1:4] = 1.0
    assert torch.equal(near[0, 0], expected)
    assert torch.equal(moved[0, 0], (expected == 1) * 4.0)


# Sharp warps.


def brute_sharp(image: torch.Tensor, motion: torch.Tensor, kernel: Callable[[float], float]) -> torch.Tensor:
    b, _, h, w = image.shape
    out = torch.zeros_like(image)
    for n in range(b):
        for j in range(h):
            for i in range(w):
                x, y = i + float(motion[n, 0, j, i]), j + float(motion[n, 1, j, i])
                left, top, total = math.floor(x), math.floor(y), 0.0
                for q in range(top - 1, top + 3):
                    for p in range(left - 1, left + 3):
                        weight = kernel(p - x) * kernel(q - y)
                        out[n, :, j, i] += weight * image[n, :, min(max(q, 0), h - 1), min(max(p, 0), w - 1)]
                        total += weight
                out[n, :, j, i] /= total
    return out


@pytest.mark.parametrize("compiling", [False, True])
@pytest.mark.parametrize("kernel", [catmull_rom, lanczos])
def test_sharp_warp_equals_its_brute_force_twin(
    kernel: Callable, compiling: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(torch.compiler, "is_compiling", lambda: compiling)
    image, motion = torch.rand(2, 2, 7, 9), torch.randn(2, 2, 7, 9) * 3
    made = sharp_warp(image, motion, kernel, bounded=False)
    motion = motion.clone()
    # Positions more than a pixel outside show the edge, like those nearer.
    inner_x = (torch.arange(9) + motion[:, 0]).clamp(-1, 9) - torch.arange(9)
    inner_y = (torch.arange(7)[:, None] + motion[:, 1]).clamp(-1, 7) - torch.arange(7)[:, None]
    right = brute_sharp(image, torch.stack((inner_x, inner_y), 1), TWINS[kernel])
    torch.testing.assert_close(made, right, atol=1e-4, rtol=0)


def test_sharp_warp_by_whole_pixels_is_exact() -> None:
    image, motion = torch.rand(1, 3, 8, 10), torch.zeros(1, 2, 8, 10)
    motion[:, 0] = 2
    torch.testing.assert_close(sharp_warp(image, motion)[..., :-2], image[..., 2:], atol=1e-6, rtol=0)


def test_far_outside_is_the_edge() -> None:
    image = torch.rand(1, 1, 6, 6)
    far = torch.full((1, 2, 6, 6), -50.0)
    torch.testing.assert_close(sharp_warp(image, far), image[..., :1, :1].expand(1, 1, 6, 6), atol=1e-6, rtol=0)


def test_repeated_sharp_warps_blur_less_than_bilinear_ones() -> None:
    x = torch.arange(64.0)
    wave = (0.5 + 0.4 * torch.sin(x * 0.7)).view(1, 1, 1, 64).expand(1, 1, 4, 64)
    soft = sharp = wave
    half = torch.full((1, 2, 4, 64), 0.5)
    half[:, 1] = 0
    for _ in range(4):
        soft, sharp = warp(soft, half), sharp_warp(sharp, half)
    right = (0.5 + 0.4 * torch.sin((x + 2) * 0.7)).expand(1, 1, 4, 64)
    inner = slice(8, -8)
    errors = [(made[..., inner] - right[..., inner]).abs().max() for made in (sharp, soft)]
    assert errors[0] < 0.4 * errors[1]


@pytest.mark.parametrize("compiling", [False, True])
def test_bounded_warps_do_not_ring(compiling: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.compiler, "is_compiling", lambda: compiling)
    step = (torch.arange(12.0) >= 6).float().view(1, 1, 1, 12).expand(1, 1, 3, 12)
    motion = torch.full((1, 2, 3, 12), 0.3)
    assert sharp_warp(step, motion, bounded=False).max() > 1.01
    made = sharp_warp(step, motion)
    assert made.min() >= 0
    assert made.max() <= 1


def test_bounds_are_those_of_the_four_nearest_pixels(monkeypatch: pytest.MonkeyPatch) -> None:
    """Both ways of reading, borders included."""
    image, motion = torch.rand(2, 2, 6, 8), torch.randn(2, 2, 6, 8) * 3
    eager = sharp_warp(image, motion)
    monkeypatch.setattr(torch.compiler, "is_compiling", lambda: True)
    torch.testing.assert_close(sharp_warp(image, motion), eager, atol=1e-5, rtol=0)
    assert not torch.allclose(sharp_warp(image, motion, bounded=False), eager, atol=1e-2)


# Clamps.


def test_ycocg_has_its_known_values_and_inverse() -> None:
    rgb = torch.tensor([[1.0, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]]).T[None]
    expected = torch.tensor([[0.25, 0.5, -0.25], [0.5, 0, 0.5], [0.25, -0.5, -0.25], [1, 0, 0]]).T[None]
    torch.testing.assert_close(to_ycocg(rgb), expected)
    image = torch.rand(2, 3, 4, 5) * 10
    torch.testing.assert_close(from_ycocg(to_ycocg(image)), image)


def windows(image: torch.Tensor) -> dict[tuple[int, int], torch.Tensor]:
    """Values of plane (0, 0) in the 3 x 3 around each pixel, those on the image."""
    height, width = image.shape[-2:]
    return {
        (j, i): image[0, 0, max(j - 1, 0) : j + 2, max(i - 1, 0) : i + 2].flatten()
        for j in range(height)
        for i in range(width)
    }


def test_neighbourhoods_equal_their_brute_force_twins() -> None:
    image = torch.rand(1, 1, 5, 6)
    box, (mean, deviation), tight = neighbourhood(image), moments(image), spread(image, 0.7)
    for (j, i), values in windows(image).items():
        middle, off = values.mean(), values.std(correction=0)
        assert box.low[0, 0, j, i] == values.min()
        assert box.high[0, 0, j, i] == values.max()
        torch.testing.assert_close(mean[0, 0, j, i], middle)
        torch.testing.assert_close(deviation[0, 0, j, i], off)
        torch.testing.assert_close(tight.low[0, 0, j, i], torch.maximum(middle - 0.7 * off, values.min()))
        torch.testing.assert_close(tight.high[0, 0, j, i], torch.minimum(middle + 0.7 * off, values.max()))


def test_what_lies_inside_a_box_is_not_touched() -> None:
    image = torch.rand(1, 3, 6, 7)
    box = neighbourhood(image)
    torch.testing.assert_close(box.clamp(image), image)
    torch.testing.assert_close(box.clip(image), image, atol=1e-6, rtol=0)


def test_clamps_bring_to_the_box_and_clips_keep_the_hue() -> None:
    shape = (1, 3, 1, 1)
    box = Box(torch.tensor([0.0, -1, -1]).view(shape), torch.tensor([2.0, 1, 1]).view(shape))
    outside = torch.tensor([1.0, 4.0, 2.0]).view(shape)
    assert box.clamp(outside).flatten().tolist() == [1, 1, 1]
    assert box.clip(outside).flatten().tolist() == [1, 1, 0.5]
