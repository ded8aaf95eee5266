"""Single experiments of the doctor, on numbers alone."""

import numpy as np
import pytest

from framecast.doctor import probe
from framecast.doctor.jitter import halton, sequence_of
from framecast.doctor.surface import facets, rotations


@pytest.mark.parametrize("height", [60, 600])
def test_slopes_of_a_plane_are_its_normal_in_large_images_too(height: int) -> None:
    normal, tangent = np.array([0.48, 0.6, 0.64]), 0.5
    y, x = np.mgrid[0:height, 0:90] + 0.5
    ray = np.stack([(x - 45) * 2 * tangent / height, (height / 2 - y) * 2 * tangent / height, -np.ones_like(x)])
    z = -4 / np.einsum("c,chw->hw", normal, ray)
    slopes, where = facets(z, z > 0, tangent)
    np.testing.assert_allclose(slopes, np.broadcast_to(normal, slopes.shape), atol=1e-3)
    assert where.sum() == len(slopes) > 0.9 * 88 * (height - 2) / probe.thinned(height).step


def test_images_are_smoothed_by_1_2_1_and_hold_numbers_only() -> None:
    dot = np.zeros((3, 5, 6), np.float32)
    dot[:, 2, 3] = 16
    np.testing.assert_array_equal(probe.smooth(dot)[0, 1:4, 2:5], [[1, 2, 1], [2, 4, 2], [1, 2, 1]])
    np.testing.assert_array_equal(probe.smooth(np.ones_like(dot)), 1)
    bad = np.full((3, 4, 4), np.nan, np.float32)
    bad[0], bad[1] = np.inf, -np.inf
    expected = np.log(probe.DARK + np.array([65504 / 2, 0, 0]))
    np.testing.assert_allclose(probe.comparable(bad, 2.0)[:, 1, 1], expected, rtol=1e-6)


def test_a_spline_blurs_equally_wherever_it_is_asked() -> None:
    y, x = np.mgrid[0:7, 0:9].astype(np.float32)
    at = np.array([2.5, 3.1, 4.0, 4.8, 5.25], np.float32)
    got = probe.spline(np.stack([x, y, x * x]), at, np.full(5, 3.5, np.float32))
    np.testing.assert_allclose(got[0], at - 0.5, atol=1e-5)
    np.testing.assert_allclose(got[1], 3, atol=1e-5)
    np.testing.assert_allclose(got[2] - got[0] ** 2, 0.25, atol=1e-4)  # the width of the blur, squared


def test_the_best_rotation_and_the_best_reflection() -> None:
    rng = np.random.default_rng(2)
    a = rng.normal(size=(50, 3))
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    proper, mirrored = rotations(a, a @ turn)
    best = proper if np.linalg.det(turn) > 0 else mirrored
    np.testing.assert_allclose(best, turn, atol=1e-9)
    assert np.linalg.det(proper) == pytest.approx(1)
    assert np.linalg.det(mirrored) == pytest.approx(-1)


def test_halton_is_recognised_from_shifts_with_phase_and_sign() -> None:
    positions = halton(5, 16, 12) * (1, -1)
    shifts = np.diff(positions, axis=0) * 0.8
    found = sequence_of(range(1, 12), shifts)
    assert found is not None
    length, start, match = found
    assert (length, start) == (16, 5)
    assert match.slope[0] == pytest.approx(0.8)
    assert match.slope[1] == pytest.approx(-0.8)
    assert sequence_of(range(1, 12), np.random.default_rng(0).normal(size=(11, 2))) is None
