"""Metrics against independent implementations, known values, and the laws that averaging over regions obeys."""

from pathlib import Path

import flip_evaluator
import pytest
import torch
from torchmetrics.functional.image import lpips as torchmetrics_lpips
from torchmetrics.functional.image import peak_signal_noise_ratio, structural_similarity_index_measure

from framecast import metrics
from framecast.flip import PIXELS_PER_DEGREE, exposures, flip_map, hdr_flip_map
from framecast.metrics import METRICS, flip, lpips, lpips_missing, measure, psnr, ssim, ssim_map


def pair(height: int = 40, width: int = 56, noise: float = 0.1) -> tuple[torch.Tensor, torch.Tensor]:
    target = torch.nn.functional.interpolate(torch.rand(1, 3, height // 4, width // 4), (height, width), mode="bicubic")
    target = target.clamp(0, 1)
    return (target + noise * torch.randn_like(target)).clamp(0, 1), target


def left_half(image: torch.Tensor) -> torch.Tensor:
    mask = torch.zeros(1, 1, *image.shape[-2:], dtype=torch.bool)
    mask[..., : image.shape[-1] // 2] = True
    return mask


def test_a_tenth_everywhere_is_20_db() -> None:
    target = torch.full((1, 3, 8, 8), 0.5)
    torch.testing.assert_close(psnr(target + 0.1, target), torch.tensor([20.0]))


def test_psnr_agrees_with_torchmetrics() -> None:
    image, target = pair()
    torch.testing.assert_close(psnr(image, target)[0], peak_signal_noise_ratio(image, target, data_range=1.0))


@pytest.mark.parametrize("size", [(40, 56), (33, 24), (11, 12)])
def test_ssim_agrees_with_torchmetrics(size: tuple[int, int]) -> None:
    image, target = pair(*size)
    theirs, full = structural_similarity_index_measure(image, target, data_range=1.0, return_full_image=True)
    torch.testing.assert_close(ssim(image, target)[0], theirs, atol=1e-5, rtol=0)
    torch.testing.assert_close(ssim_map(image, target)[0, 0], full[0].mean(0), atol=1e-4, rtol=0)


def authors(image: torch.Tensor, target: torch.Tensor, kind: str) -> tuple[torch.Tensor, dict[str, float]]:
    """FLIP by the C++ of its authors: the map, and what it chose."""
    arrays = (x[0].permute(1, 2, 0).contiguous().numpy() for x in (target, image))
    settings = {"ppd": PIXELS_PER_DEGREE}
    made, _, chosen = flip_evaluator.evaluate(*arrays, kind, applyMagma=False, parameters=settings)
    return torch.from_numpy(made).permute(2, 0, 1)[None], chosen


@pytest.mark.parametrize("size", [(40, 56), (65, 130)])
def test_flip_is_the_authors_map(size: tuple[int, int]) -> None:
    image, target = pair(*size)
    theirs, _ = authors(image, target, "LDR")
    torch.testing.assert_close(flip_map(image, target), theirs, atol=2e-5, rtol=0)
    assert float(flip(image, target)) == pytest.approx(float(theirs.mean()), abs=1e-6)


@pytest.mark.parametrize("brightest", [0.4, 30.0, 1000.0])
def test_hdr_flip_is_the_authors_map_over_the_authors_exposures(brightest: float) -> None:
    target = brightest * pair()[1] ** 3
    image = target * (1 + 0.2 * torch.randn_like(target)).clamp(min=0)
    theirs, chosen = authors(image, target, "HDR")
    ours = exposures(target)
    assert [ours[0], ours[-1], len(ours)] == pytest.approx(
        [chosen["startExposure"], chosen["stopExposure"], chosen["numExposures"]], abs=1e-4
    )
    torch.testing.assert_close(hdr_flip_map(image, target), theirs, atol=5e-5, rtol=0)


def test_hdr_flip_sees_what_a_display_cannot_show_at_once() -> None:
    target = torch.full((1, 3, 40, 56), 0.05)
    target[..., :28] = 50.0
    image = target.clone()
    image[..., :28] *= 0.7  # both are white on a display
    assert float(flip_map(image.clamp(0, 1), target.clamp(0, 1)).max()) == 0
    assert float(hdr_flip_map(image, target)[..., :20].min()) > 0.1


@pytest.mark.parametrize("name", ["psnr", "ssim", "flip"])
def test_equal_images_have_the_perfect_value_and_noise_makes_it_worse(name: str) -> None:
    metric, score = METRICS[name], getattr(metrics, name)
    _, target = pair()
    values = [float(score(target, target))]
    for noise in (0.02, 0.1, 0.3):
        values.append(float(score((target + noise * torch.randn_like(target)).clamp(0, 1), target)))
    assert values[0] == pytest.approx(metric.perfect, abs=1e-6)
    assert values == sorted(values, reverse=metric.higher_is_better)
    assert len(set(values)) == 4


@pytest.mark.parametrize("name", ["psnr", "ssim", "flip"])
def test_a_region_sees_only_its_own_pixels(name: str) -> None:
    image, target = pair(40, 160)
    mask = left_half(image)
    broken = image.clone()
    broken[..., 140:] = 1 - target[..., 140:]  # beyond the reach of any window from the left half
    score = getattr(metrics, name)
    torch.testing.assert_close(score(broken, target, mask), score(image, target, mask))
    assert float(score(broken, target)) != pytest.approx(float(score(image, target)), abs=1e-3)


def test_regions_add_up() -> None:
    image, target = pair()
    mask = left_half(image)
    everything = torch.ones_like(mask)
    for name in ("ssim", "flip"):
        score = getattr(metrics, name)
        halves = (score(image, target, mask) + score(image, target, ~mask)) / 2
        torch.testing.assert_close(halves, score(image, target, everything))
    errors = [10 ** (-psnr(image, target, m) / 10) for m in (mask, ~mask)]
    torch.testing.assert_close(-10 * torch.log10(sum(errors) / 2), psnr(image, target))


def test_masked_psnr_is_from_the_error_in_the_region() -> None:
    target = torch.full((1, 3, 8, 8), 0.5)
    image = target.clone()
    image[..., :4] += 0.1
    image[..., 4:] += 0.01
    torch.testing.assert_close(psnr(image, target, left_half(image)), torch.tensor([20.0]), atol=1e-3, rtol=0)
    torch.testing.assert_close(psnr(image, target, ~left_half(image)), torch.tensor([40.0]), atol=1e-3, rtol=0)


def test_each_image_of_a_batch_has_its_own_value() -> None:
    first, second = pair(), pair(noise=0.3)
    image, target = (torch.cat(both) for both in zip(first, second, strict=True))
    mask = torch.cat((left_half(first[0]), ~left_half(first[0])))
    for name in ("psnr", "ssim", "flip"):
        score = getattr(metrics, name)
        alone = torch.cat([score(*first, mask[:1]), score(*second, mask[1:])])
        torch.testing.assert_close(score(image, target, mask), alone, atol=1e-5, rtol=1e-5)


def test_an_empty_region_has_no_value() -> None:
    image, target = pair()
    nothing = torch.zeros(1, 1, 40, 56, dtype=torch.bool)
    assert psnr(image, target, nothing).isnan().all()
    assert set(measure(image, target, ("psnr",), {"all": None, "none": nothing})) == {("all", "psnr")}


def test_measure_gives_what_the_single_metrics_give() -> None:
    image, target = pair()
    regions = {"all": None, "left": left_half(image)}
    values = measure(image, target, ("psnr", "ssim", "flip"), regions)
    for (region, name), value in values.items():
        assert value == pytest.approx(float(getattr(metrics, name)(image, target, regions[region])))
    assert len(values) == 6


def test_measure_of_equal_images_needs_no_maps(monkeypatch: pytest.MonkeyPatch) -> None:
    _, target = pair()
    expected = measure(target + 0, target, ("psnr", "ssim", "flip"), {"all": None})
    monkeypatch.setattr(metrics, "flip_map", None)
    assert measure(target + 0, target, ("psnr", "ssim", "flip"), {"all": None}) == expected
    assert expected == {("all", "psnr"): 100.0, ("all", "ssim"): 1.0, ("all", "flip"): 0.0}


def random_alexnet(hub: Path) -> torch.nn.Sequential:
    """AlexNet's convolutions with random weights, also written to where torchvision keeps its own."""
    layers = [torch.nn.Conv2d(3, 64, 11, 4, 2), torch.nn.ReLU(), torch.nn.MaxPool2d(3, 2)]
    layers += [torch.nn.Conv2d(64, 192, 5, 1, 2), torch.nn.ReLU(), torch.nn.MaxPool2d(3, 2)]
    layers += [torch.nn.Conv2d(192, 384, 3, 1, 1), torch.nn.ReLU(), torch.nn.Conv2d(384, 256, 3, 1, 1)]
    layers += [torch.nn.ReLU(), torch.nn.Conv2d(256, 256, 3, 1, 1), torch.nn.ReLU(), torch.nn.MaxPool2d(3, 2)]
    net = torch.nn.Sequential(*layers)
    (hub / "checkpoints").mkdir(parents=True)
    weights = {f"features.{k}": v for k, v in net.state_dict().items()}
    torch.save(weights, hub / "checkpoints" / "alexnet-owt-7be5be79.pth")
    return net


def test_lpips_agrees_with_torchmetrics_on_any_backbone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    net = random_alexnet(tmp_path)
    monkeypatch.setattr(torch.hub, "get_dir", lambda: str(tmp_path))
    monkeypatch.setattr(torchmetrics_lpips, "_get_tv_model_features", lambda name, pretrained: net)
    theirs = torchmetrics_lpips._LPIPS(net="alex")
    for size in ((40, 56), (96, 64)):
        image, target = pair(*size)
        expected = theirs(image, target, normalize=True).flatten()
        torch.testing.assert_close(lpips(image, target), expected)
        everything = torch.ones(1, 1, *size, dtype=torch.bool)
        torch.testing.assert_close(lpips(image, target, everything), expected)
        half = lpips(image, target, left_half(image))
        assert not torch.allclose(half, expected)
    with pytest.raises(ValueError, match="at least 31x31"):
        lpips(image[..., :20], target[..., :20])


def test_lpips_is_left_out_where_its_weights_are_not(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.hub, "get_dir", lambda: str(tmp_path))
    assert lpips(*pair()) is None
    assert "AlexNet weights" in str(lpips_missing())
