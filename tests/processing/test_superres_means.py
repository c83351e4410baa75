"""Pixels as means over their area: kept by a result, and made of points."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from acquisition import angle_deg
from processing import NormalMap, angular_error, super_resolve
from processing.superres import low_resolution
from processing.superres.enlarge import (
    averaged,
    means_of_points,
    units,
    with_given,
    without_averaging,
)


def relief(height: int = 64, width: int = 96, blur: float = 2.0) -> NormalMap:
    """Return a relief with details of a few pixels."""
    noise = np.random.default_rng(5).normal(size=(height, width))
    down, right = np.gradient(gaussian_filter(noise, blur) * 3 * blur)
    return NormalMap.from_vectors(np.dstack([-right, down, np.ones((height, width))]))


def central(truth: NormalMap) -> NormalMap:
    """Return the normals in the middle of squares of 4 x 4 pixels: the means of the inner 2 x 2."""
    n = truth.normals
    return NormalMap.from_vectors(sum(n[1 + i :: 4, 1 + j :: 4] for i in (0, 1) for j in (0, 1)))


@pytest.mark.parametrize("scale", [2, 4])
def test_the_means_of_a_result_are_the_given_normals(scale):
    truth = relief()
    low = low_resolution(truth, scale)
    means = {
        method: low_resolution(super_resolve(low, scale, method=method).normal_map, scale)
        for method in ("bicubic", None)
    }
    away = {method: angular_error(one, low).mae_deg for method, one in means.items()}
    assert away[None] < 0.05 * away["bicubic"]


def test_pixels_that_are_not_complete_stay_as_they_are():
    high, low = relief(8, 12), relief(2, 3, 0.5)
    mask = np.ones((8, 12), np.bool_)
    mask[5, 6] = False
    made = with_given(high.normals, low.normals, mask, 4)
    np.testing.assert_allclose(np.linalg.norm(made, axis=2), 1, atol=1e-6)
    np.testing.assert_allclose(made[4:, 4:8], high.normals[4:, 4:8], atol=1e-6)
    means = [units(one.reshape(2, 4, 3, 4, 3).mean(axis=(1, 3))) for one in (high.normals, made)]
    before, after = (angle_deg(one, low.normals) for one in means)
    rest = np.array([[True, True, True], [True, False, True]])
    assert (after[rest] < 0.35 * before[rest]).all()
    assert after[1, 1] == pytest.approx(before[1, 1], abs=1e-3)


@pytest.mark.parametrize("scale", [2, 4])
def test_the_mean_of_a_parabola(scale):
    y, x = np.mgrid[:11, :13].astype(np.float32)
    values = np.dstack([x**2 - x, 3 * y**2, x - 2 * y])
    # The places of the smaller pixels have the mean square (1 - s^-2) / 12.
    spread = (1 - scale**-2) / 12
    inner = slice(3, -3), slice(3, -3)
    made = averaged(values, scale)
    wanted = values + spread * np.array([1, 3, 0])
    np.testing.assert_allclose(made[inner], wanted[inner], rtol=1e-4, atol=1e-4)
    back = without_averaging(made, scale)
    inner = slice(4, -4), slice(4, -4)
    np.testing.assert_allclose(back[inner], values[inner], rtol=1e-4, atol=1e-4)


def test_points_are_averaged_first():
    truth = relief()
    points = central(truth)
    known = means_of_points(points, 4)
    # They are closer to the means than the points are.
    means = low_resolution(truth, 4)
    assert angular_error(known, means).mae_deg < 0.5 * angular_error(points, means).mae_deg
    made = super_resolve(points, 4, sampling="points").normal_map
    # The result keeps the points, not the means that were made of them.
    assert (
        angular_error(central(made), points).mae_deg < 0.05 * angular_error(known, points).mae_deg
    )
    error = angular_error(made, truth).mae_deg
    assert error < 0.95 * angular_error(super_resolve(points, 4).normal_map, truth).mae_deg
    bicubic = super_resolve(points, 4, method="bicubic", sampling="points").normal_map
    assert error < 0.9 * angular_error(bicubic, truth).mae_deg


def test_points_at_the_border_of_a_mask_do_not_see_the_background():
    truth = relief()
    mask = np.zeros((16, 24), np.bool_)
    mask[3:12, 5:20] = True
    points = central(truth)
    inside = NormalMap(np.where(mask[..., None], points.normals, np.float32(0)), mask)
    made = means_of_points(inside, 4)
    np.testing.assert_array_equal(made.mask, mask)
    whole = means_of_points(points, 4)
    np.testing.assert_allclose(made.normals[6:9, 8:17], whole.normals[6:9, 8:17], atol=1e-6)
    tilted = NormalMap.from_vectors(np.tile([0.5, 0.3, 1.0], (9, 8, 1)), mask[:9, :8])
    plane = means_of_points(tilted, 4)
    np.testing.assert_allclose(plane.normals, tilted.normals, atol=1e-6)
