"""Weights of highlights by their photons: which law the residuals show, and what it is worth."""

import numpy as np
import pytest

from calibration.spheres import fit_cone
from calibration.spheres.solve.joint_refinement import Observation
from calibration.spheres.solve.light_positions import locate_lights
from calibration.spheres.solve.sphere_positions import place

MIXED = [((-70, -40, 25), 25.0), ((80, 40, 25), 25.0), ((-60, 60, 8), 8.0), ((70, -60, 8), 8.0)]
STATED_PX = 0.01


@pytest.fixture
def simulated(bench, dome_mm):
    """Return highlights on two large and two small spheres, with errors of any size."""

    def observe(sigma_px, seed, lights=dome_mm):
        rng = np.random.default_rng(seed)
        radii = np.array([radius for _, radius in MIXED])
        cones = []
        for centre, radius in MIXED:
            points = bench.outline(centre, radius)
            points = points + rng.normal(0, 0.05, 2) + rng.normal(0, 0.1, points.shape)
            cones.append(fit_cone(bench.camera.rays(points), 1 / bench.focal_px)[0])
        seen = np.array(
            [
                [bench.highlight(centre, radius, light) for centre, radius in MIXED]
                for light in lights
            ]
        )
        noise = rng.normal(0, 1, seen.shape) * np.broadcast_to(sigma_px, seen.shape[:2])[..., None]
        return place(cones, radii, bench.camera), seen + noise

    return observe


def located(bench, placed, seen, photon_px2):
    ids = tuple(f"L{k:02}" for k in range(len(seen)))
    stated = np.full(seen.shape[:2], STATED_PX)
    photons = None if photon_px2 is None else np.broadcast_to(photon_px2, stated.shape)
    given = Observation(bench.camera, placed, seen, stated)
    return locate_lights(given, ids, peaks=True, photon_px2=photons)


@pytest.mark.parametrize(
    ("actual_px", "by_photons"),
    [
        pytest.param([0.008, 0.008, 0.025, 0.025], True, id="small spheres reflect less"),
        pytest.param([0.003, 0.003, 0.008, 0.008], True, id="all are better than stated"),
        pytest.param([0.03, 0.03, 0.03, 0.03], False, id="all are equally wrong"),
        pytest.param([0.025, 0.025, 0.008, 0.008], False, id="the large ones are worse"),
        pytest.param([0.3, 0.3, 0.9, 0.9], False, id="too large for photons"),
    ],
)
def test_residuals_choose_the_law_of_the_errors(bench, simulated, actual_px, by_photons):
    """Photons grow with the square of the radius; one of them has an unknown brightness."""
    photon_px2 = 7e5 / np.array([25.0, 25.0, 8.0, 8.0]) ** 2
    placed, seen = simulated(actual_px, seed=3)
    found = located(bench, placed, seen, photon_px2)
    if by_photons:
        np.testing.assert_allclose(np.median(found.sigma_px, axis=0), actual_px, rtol=0.4)
        assert found.refined.chi_square == pytest.approx(1, abs=0.15)
    else:
        assert np.all(found.sigma_px[found.used] == STATED_PX)


@pytest.mark.slow
def test_errors_agree_with_covariances_by_photons(bench, dome_mm, simulated):
    """Weights by photons make positions better, and state what they are."""
    actual_px = np.array([0.008, 0.008, 0.025, 0.025])
    off, stated, squares = [], [], []
    for photon_px2 in (actual_px**2, None):
        results = []
        for seed in range(6):
            placed, seen = simulated(actual_px, seed)
            results.append(located(bench, placed, seen, photon_px2).refined)
        errors = [one.positions_mm - dome_mm for one in results]
        variances = np.array([one.covariance_mm2 for one in results])
        squares.append(np.mean(np.square(errors) / np.diagonal(variances, axis1=2, axis2=3)))
        off.append(np.sqrt(np.mean(np.square(errors))))
        stated.append(np.sqrt(np.mean(np.diagonal(variances, axis1=2, axis2=3))))
    assert off[0] < 0.85 * off[1]
    assert stated[0] < 0.75 * stated[1]
    assert 0.6 < squares[0] < 1.5
    assert squares[1] < 0.6


def test_few_residuals_change_little(bench, dome_mm, simulated):
    """Two lights have ten residuals; that these happen to be zero does not show much."""
    some = dome_mm[::18]
    placed, seen = simulated(0.0, seed=1, lights=some)
    found = located(bench, placed, seen, 1e-4)
    assert found.sigma_px.min() > 0.5 * STATED_PX


@pytest.mark.parametrize("photon_px2", [0.0, np.nan, [[1.0, 1.0, np.nan, 1.0]]])
def test_unknown_photons_leave_what_is_stated(bench, simulated, photon_px2):
    placed, seen = simulated(0.02, seed=2)
    assert np.all(located(bench, placed, seen, photon_px2).sigma_px == STATED_PX)
