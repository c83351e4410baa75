"""Errors of lights against their covariances, from simulated outlines and highlights."""

from functools import partial

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from acquisition.values import tangent_basis
from calibration.spheres import Ellipse, TracedOutline, orthographic_directions
from calibration.spheres.outline.outline_noise import circle_covariance, slow_variance, viewing_cone
from calibration.spheres.solve.average_directions import direction_covariances

BENCHMARK = "light_uncertainty"
TURN = np.arange(800) * (2 * np.pi / 800)
ONES = np.ones(800)


@pytest.mark.slow
def test_a_few_seeds_agree_with_their_covariances(benchmark):
    """The centres are shared by 36 lights, so a few seeds vary much."""
    (layout,) = (layout for layout in benchmark.LAYOUTS if layout.name == "2 x R20")
    result = benchmark.figures(partial(benchmark.simulated, layout), range(8))
    assert 0.4 < result.together < 1.9
    assert result.beyond <= 1


@pytest.mark.slow
def test_residuals_show_that_highlights_are_better_than_stated(benchmark):
    """With the stated errors, the mean square would be a fifth."""
    (layout,) = (layout for layout in benchmark.LAYOUTS if layout.name == "4 x R20")
    trial = partial(benchmark.simulated, layout, stated=2.5)
    assert 0.6 < benchmark.figures(trial, range(8)).together < 1.6


def test_residuals_of_saturated_highlights_do_not_shrink_their_errors(benchmark, monkeypatch):
    (layout,) = (layout for layout in benchmark.LAYOUTS if layout.name == "4 x R20")
    locate = benchmark.locate_lights
    monkeypatch.setattr(benchmark, "locate_lights", lambda *of, peaks: locate(*of, peaks=False))
    trial = partial(benchmark.simulated, layout, stated=2.5)
    assert benchmark.figures(trial, range(4)).together < 0.35


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("index", range(4))
def test_errors_agree_with_their_covariances(benchmark, index):
    trial = partial(benchmark.simulated, benchmark.LAYOUTS[index])
    result = benchmark.figures(trial, range(5000, 5200))
    assert np.all((result.by_axis > 0.8) & (result.by_axis < 1.25))
    # 0.2 seeds are expected; more than 2 have a probability of 0.1 %.
    assert result.beyond <= 2


@pytest.mark.slow
@pytest.mark.parametrize("along_px", [0.0, 2.0, 4.0])
def test_the_variance_of_slow_errors_includes_their_correlation(along_px):
    """The mean of M errors has the variance 1 / M times the value that is estimated."""
    rng = np.random.default_rng(1)
    estimates, means = [], []
    for _ in range(100):
        error = rng.normal(0, 1, 800)
        if along_px:
            error = gaussian_filter1d(error, along_px, mode="wrap")
        waves = [ONES, np.cos(TURN), np.sin(TURN)]
        left = error - sum(w * (w @ error) / (w @ w) for w in waves)
        estimates.append(slow_variance(TURN, left, ONES, 130.0, fitted=1))
        means.append(error.mean())
    actual = 800 * np.mean(np.square(means))
    assert np.mean(estimates) == pytest.approx(actual, rel=0.35)


def test_an_arc_and_a_few_points_have_a_variance():
    rng = np.random.default_rng(5)
    arc = TURN[:250]
    error = rng.normal(0, 0.1, 250)
    assert 0.005 < slow_variance(arc, error, np.ones(250), 127.0, fitted=1) < 0.04
    assert slow_variance(TURN[:5], error[:5], np.ones(5), 1.0, fitted=1) > 0
    assert slow_variance(TURN, 0 * ONES, ONES, 127.0, fitted=1) == pytest.approx(0.02**2)


def test_the_covariance_of_a_cone_is_that_of_repeated_fits(benchmark):
    model = benchmark.camera()
    rng = np.random.default_rng(3)
    centre = np.array([60.0, -40.0, 20.0])
    cones = [
        viewing_cone(
            model.rays(benchmark.outline_points(model, centre, 20.0, rng)), 1 / model.focal_px
        )
        for _ in range(60)
    ]
    found = np.array([cone.axis / cone.sine for cone in cones])
    # The scatter of the edge points does not contain the systematic part.
    systematic = np.eye(3) * (benchmark.SYSTEMATIC_PX / 5000 * 580 / 20) ** 2
    depth = (centre - model.centre_mm) / np.linalg.norm(centre - model.centre_mm)
    predicted = np.mean([cone.covariance for cone in cones], axis=0)
    sideways = np.eye(3) - np.outer(depth, depth)
    actual = np.cov(found.T)
    share = np.trace(sideways @ actual) / np.trace(sideways @ (predicted + systematic))
    assert 0.6 < share < 1.6
    in_depth = (benchmark.SYSTEMATIC_PX / 5000 * (580 / 20) ** 2) ** 2
    share = (depth @ actual @ depth) / (depth @ predicted @ depth + in_depth)
    assert 0.6 < share < 1.6


def test_the_covariance_of_a_direction_is_that_of_repeated_observations():
    rng = np.random.default_rng(7)
    outline = Ellipse.circle(100.0, 100.0, 60.0)
    pixels = np.array([[[100.0, 100.0]], [[130.0, 90.0]], [[88.0, 62.0]]])
    sigma_px = np.array([[0.3], [0.1], [0.4]])
    of_outline = np.diag([0.2, 0.1, 0.15]) ** 2

    def rays_of(at, change):
        x, y = outline.centre_px
        size = 60.0 + change[0, 2]
        moved = Ellipse((x + change[0, 0], y + change[0, 1]), (size, size))
        return orthographic_directions(moved, at)

    mean = rays_of(pixels, np.zeros((1, 3)))[:, 0]
    none = np.zeros((1, 3))
    predicted = direction_covariances(rays_of, pixels, sigma_px, of_outline[None], none)
    drawn = []
    for _ in range(3000):
        at = pixels + rng.normal(0, 1, pixels.shape) * sigma_px[..., None]
        drawn.append(rays_of(at, rng.normal(0, 1, (1, 3)) * [0.2, 0.1, 0.15])[:, 0])
    basis = tangent_basis(mean)
    for i in range(3):
        actual = np.cov(basis[i] @ (np.array(drawn)[:, i] - mean[i]).T)
        assert np.linalg.norm(actual - predicted[i]) < 0.12 * np.linalg.norm(actual)


def test_errors_that_outlines_share_do_not_average():
    """Two equal spheres halve the variance of own errors, and keep that of the shared one."""
    outline = Ellipse.circle(100.0, 100.0, 60.0)
    pixels = np.array([[[130.0, 90.0]]])
    sigma_px = np.full((1, 1), 1e-6)

    def rays_of(at, change):
        sizes = 60.0 + change[:, 2]
        rays = [
            orthographic_directions(Ellipse(outline.centre_px, (size, size)), at[:, k])
            for k, size in enumerate(sizes)
        ]
        return np.stack(rays, axis=1)

    radius = np.array([0.0, 0.0, 0.1])

    def variance(count, own, common):
        return np.trace(
            direction_covariances(
                rays_of,
                np.repeat(pixels, count, axis=1),
                np.repeat(sigma_px, count, axis=1),
                np.tile(own * np.diag(radius**2), (count, 1, 1)),
                np.tile(common * radius, (count, 1)),
            )[0]
        )

    alone = variance(1, 1.0, 0.0)
    assert variance(1, 0.0, 1.0) == pytest.approx(alone)
    assert variance(2, 1.0, 0.0) == pytest.approx(alone / 2, rel=1e-3)
    assert variance(2, 0.0, 1.0) == pytest.approx(alone, rel=1e-3)


def test_the_covariance_of_a_circle_includes_correlated_errors():
    rng = np.random.default_rng(9)
    circle = Ellipse.circle(100.0, 80.0, 127.0)
    error = gaussian_filter1d(rng.normal(0, 1, 800), 4.0, mode="wrap")
    points = circle.point(TURN, 1 + error / 127.0)
    # Without correlation, the variance of a centre is twice that of the points over their number.
    plain = 2 * error.var() / 800
    sigma_px = np.sqrt(np.diag(circle_covariance(TracedOutline(circle, points, 1.0))) - 0.03**2)
    assert np.all(sigma_px[:2] > 2 * np.sqrt(plain))
