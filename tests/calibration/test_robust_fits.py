"""Robust fits: weights, cones and circles, compared with closed forms."""

import numpy as np
import pytest

from calibration import EstimateError
from calibration.spheres import Ellipse, fit_circle, fit_cone, fit_ellipse
from calibration.spheres.geometry.robust import (
    FINEST_PX,
    check_enough,
    tukey_weights,
    weighted_solve,
)

PIXEL = 1 / 5000.0


def test_tukey_weights_are_the_biweight_of_the_median_deviation():
    residual = np.array([0.0, 1.0, -1.0, 2.0, -2.0, 3.0, 5.0, 50.0, -50.0])
    scale = 4.685 * 1.4826 * 2.0  # the median of |residual| is 2
    expected = np.where(np.abs(residual) < scale, (1 - (residual / scale) ** 2) ** 2, 0.0)
    np.testing.assert_allclose(tukey_weights(residual, 0.1), expected, rtol=1e-12)
    # A scale below `finest` would reject good points.
    np.testing.assert_allclose(
        tukey_weights(np.array([0.0, 0.0, 0.0, 1.0]), 1.0),
        [1, 1, 1, (1 - 4.685**-2) ** 2],
        rtol=1e-12,
    )


@pytest.mark.parametrize(("left", "enough"), [(4, True), (3, True), (2, False), (0, False)])
def test_too_few_points_are_counted(left, enough):
    weights = np.array([0.5] * left + [0.0] * 7)
    if enough:
        check_enough(weights, 3, "a circle")
        return
    with pytest.raises(EstimateError, match=f"^{left} outline points do not determine a circle"):
        check_enough(weights, 3, "a circle")


def test_weights_multiply_the_squared_residuals():
    design, target = np.ones((3, 1)), np.array([1.0, 2.0, 6.0])
    weights = np.array([1.0, 4.0, 5.0])
    assert weighted_solve(design, target, weights) == pytest.approx([(1 + 8 + 30) / 10])


def cone_rays(sine, count=360, angle=0.0):
    """Return rays of any length on a cone about a tilted axis, widened by ``angle``."""
    around = np.arange(count) * 2 * np.pi / count
    half = np.arcsin(sine) + angle
    rays = np.stack([np.sin(half) * np.cos(around), np.sin(half) * np.sin(around)], axis=1)
    rays = np.column_stack([rays, -np.broadcast_to(np.cos(half), count)])
    turn = np.array([[0.8, 0, -0.6], [0, 1, 0], [0.6, 0, 0.8]])
    return rays @ turn.T * np.linspace(1, 5, count)[:, None], turn @ [0, 0, -1]


@pytest.mark.parametrize("off_px", [3.0, 30.0, -8.0])
def test_outliers_do_not_affect_the_cone(off_px):
    draw = np.random.default_rng(3)
    false = draw.choice(360, 90, replace=False)
    angle = draw.normal(0, 0.1 * PIXEL, 360)
    angle[false] = off_px * PIXEL
    rays, axis = cone_rays(0.05, angle=angle)
    cone, weights = fit_cone(rays, PIXEL)
    assert not weights[false].any()
    assert np.delete(weights, false).min() > 0.1
    # An error of 0.1 px of each of 270 points gives an error of 0.01 px of the centre.
    assert np.linalg.norm(cone.axis - axis) < 0.03 * PIXEL
    assert cone.sine == pytest.approx(0.05, abs=0.03 * PIXEL)


@pytest.mark.parametrize("sine", [0.01, 0.05, 0.4])
@pytest.mark.parametrize("count", [24, 500])
def test_the_covariance_of_an_exact_cone_is_that_of_the_finest_outline(sine, count):
    """For M points of sigma s: s sqrt(2 / M) / sine sideways, s cos / (sqrt(M) sine^2) in depth."""
    rays, axis = cone_rays(sine, count)
    cone, weights = fit_cone(rays, PIXEL)
    np.testing.assert_allclose(weights, 1.0, atol=1e-6)
    sigma = FINEST_PX * PIXEL
    sideways = sigma * np.sqrt(2 / count) / sine
    depth = sigma * np.sqrt((1 - sine**2) / count) / sine**2
    outer = np.outer(axis, axis)
    expected = sideways**2 * (np.eye(3) - outer) + depth**2 * outer
    np.testing.assert_allclose(cone.covariance, expected, atol=1e-6 * depth**2)
    np.testing.assert_allclose(
        [side @ cone.covariance @ side for side in ([0, 1, 0], np.cross(axis, [0, 1, 0]))],
        sideways**2,
        rtol=1e-4,
    )


def test_a_cone_requires_three_rays_that_form_a_cone():
    rays, _ = cone_rays(0.05, count=3)
    fit_cone(rays, PIXEL)
    with pytest.raises(EstimateError, match="2 outline points do not determine a cone"):
        fit_cone(rays[:2], PIXEL)
    around = np.random.default_rng(0).normal(size=(50, 3))
    with pytest.raises(EstimateError, match="do not fit a cone"):
        fit_cone(around, PIXEL)


def test_the_focal_length_of_oblong_pixels_is_the_geometric_mean(bench):
    K = bench.camera.K.copy()
    K[0, 0], K[1, 1] = 4000.0, 1000.0
    camera = type(bench.camera)(K, bench.width, bench.height, 600.0)
    assert camera.focal_px == pytest.approx(2000.0)


def arc(radius, begin, end, count, centre=(100.0, 80.0)):
    t = np.linspace(begin, end, count)
    return np.asarray(centre) + radius * np.column_stack([np.cos(t), np.sin(t)])


@pytest.mark.parametrize(
    ("fit", "off_px"),
    [
        *((fit_circle, off_px) for off_px in (3.0, 40.0, -10.0)),
        *((fit_ellipse, off_px) for off_px in (8.0, 40.0, -10.0)),
    ],
)
def test_an_arc_of_another_radius_does_not_affect_the_outline(fit, off_px):
    good = arc(60, 0, 4.2, 300)
    good = good + np.random.default_rng(1).normal(0, 0.1, good.shape)
    points = np.concatenate([good, arc(60 + off_px, 4.3, 6.1, 130)])
    outline, weights = fit(points)
    assert not weights[300:].any()
    assert outline.centre_px == pytest.approx((100, 80), abs=0.1)
    assert outline.semi_axes_px == pytest.approx((60, 60), abs=0.1)


@pytest.mark.parametrize(("fit", "least"), [(fit_circle, 3), (fit_ellipse, 5)])
def test_the_smallest_number_of_points(fit, least):
    points = arc(60, 0, 5.5, 40)
    outline, _ = fit(points[::8][:least], Ellipse.circle(100.0, 80.0, 60.0))
    assert outline.radius_px == pytest.approx(60, abs=1e-6)
    with pytest.raises(EstimateError, match=f"^{least - 1} outline points do not determine a"):
        fit(points[::8][: least - 1], Ellipse.circle(100.0, 80.0, 60.0))
    # Without a start value, samples of 8 points are fitted.
    fit(points[:8])
    with pytest.raises(EstimateError, match="7 outline points do not determine an outline"):
        fit(points[:7])


@pytest.mark.parametrize("degrees", [0.0, 30.0, -75.0])
def test_an_ellipse_is_the_unit_circle_in_its_frame(degrees):
    ellipse = Ellipse((12.0, -7.0), (30.0, 20.0), degrees)
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    ends = np.array([[12 + 30 * c, -7 + 30 * s], [12 - 20 * s, -7 + 20 * c]])
    np.testing.assert_allclose(np.linalg.norm(ellipse.unit(ends), axis=1), 1, rtol=1e-12)
    np.testing.assert_allclose(ellipse.distance_px(ends), 0, atol=1e-12)
    # On the axes the first-order distance is exact, half a pixel outside and inside.
    out = ends + 0.5 * np.array([[c, s], [-s, c]])
    np.testing.assert_allclose(ellipse.distance_px(out), 0.5, rtol=0.03)
    np.testing.assert_allclose(ellipse.distance_px(2 * ends - out), -0.5, rtol=0.03)
    angles = np.linspace(0, 6, 9)
    np.testing.assert_allclose(ellipse.unit(ellipse.point(angles, 1.5)), 1.5 * np.column_stack(
        [np.cos(angles), np.sin(angles)]
    ), atol=1e-12)  # fmt: skip
    assert ellipse.radius_px == pytest.approx(np.sqrt(600))
