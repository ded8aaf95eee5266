"""Transfer curves: known values, inverses, and what the display transform promises."""

import pytest
import torch

from framecast import color


@pytest.mark.parametrize(
    ("encode", "decode", "top"),
    [
        (color.encode_srgb, color.decode_srgb, 1.0),
        (color.encode_log, color.decode_log, 500.0),
        (color.encode_mu, color.decode_mu, 500.0),
        (color.compress_highlights, color.expand_highlights, 2.0),
        (color.to_display, color.from_display, 2.0),
    ],
)
def test_curves_undo_each_other(encode, decode, top) -> None:
    x = torch.linspace(0, top, 501)
    torch.testing.assert_close(decode(encode(x)), x, rtol=2e-3, atol=1e-6)


def test_known_values() -> None:
    assert float(color.encode_srgb(torch.tensor([0.21404114]))) == pytest.approx(0.5, abs=1e-6)
    assert float(color.encode_log(torch.tensor([1.0]))) == pytest.approx(0.693147, abs=1e-6)
    assert color.encode_mu(torch.tensor([0.0, 1.0])).tolist() == [0, 1]
    assert color.luminance(torch.tensor([1.0, 0, 0]).view(1, 3, 1, 1)).item() == pytest.approx(0.2126)


def test_display_is_plain_srgb_below_the_shoulder_and_keeps_highlights_apart() -> None:
    x = torch.linspace(0, 0.8, 50)
    torch.testing.assert_close(color.to_display(x), color.encode_srgb(x))
    bright = color.to_display(torch.tensor([0.8, 0.81, 1.0, 1.5, 2.0]))
    assert (bright.diff() > 0).all()
    assert float(color.to_display(torch.tensor([1e4]))) <= 1
    assert float(color.to_display(torch.tensor([-1.0]))) == 0


def test_the_shoulder_leaves_the_identity_without_a_kink() -> None:
    x = torch.tensor([0.8 - 1e-3, 0.8, 0.8 + 1e-3], dtype=torch.float64)
    below, above = color.compress_highlights(x).diff()
    assert float(above / below) == pytest.approx(1, abs=0.01)


def test_tonemap_keeps_the_ratio_of_channels() -> None:
    x = torch.rand(1, 3, 4, 4) * 50
    y = color.tonemap(x)
    assert (y < 1).all()
    torch.testing.assert_close(y[:, 0] * x[:, 1], y[:, 1] * x[:, 0])
    torch.testing.assert_close(color.untonemap(y), x, rtol=1e-4, atol=1e-4)


def test_demodulation_is_undone_by_modulation_even_where_albedo_is_black() -> None:
    image, albedo = torch.rand(1, 3, 4, 4) * 10, torch.rand(1, 3, 4, 4)
    albedo[:, :, 0] = 0
    light = color.demodulate(image, albedo)
    torch.testing.assert_close(color.modulate(light, albedo), image)
    assert (light <= image / color.ALBEDO_FLOOR + 1e-3).all()


def test_exposure_counts_in_stops() -> None:
    assert color.expose(torch.tensor([1.0]), -2).item() == 0.25
