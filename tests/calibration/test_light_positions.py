"""Positions from exact and noisy geometry; the bounds are 1.5 x an independent calculation."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from calibration import EstimateError
from calibration.spheres import KnownSpheres, fit_cone
from calibration.spheres.solve.joint_refinement import Observation, linearise, refine
from calibration.spheres.solve.light_positions import locate_lights, pair_positions
from calibration.spheres.solve.lost_images import named
from calibration.spheres.solve.sphere_positions import off_the_plane, place

TWO_R10 = [((-90, 0, 10), 10.0), ((90, 0, 10), 10.0)]
TWO_R20 = [((-90, 0, 20), 20.0), ((90, 0, 20), 20.0)]
FOUR_R20 = [((x, y, 20), 20.0) for x in (-60, 60) for y in (-45, 45)]


def observe(bench, spheres, lights, outline_px=0.0, highlight_px=0.0, seed=0):
    """Return spheres and highlights as a camera observes them, with Gaussian errors."""
    rng = np.random.default_rng(seed)
    camera = bench.camera
    cones = []
    for centre, radius in spheres:
        points = bench.outline(centre, radius)
        points = points + rng.normal(0, outline_px, points.shape)
        cones.append(fit_cone(camera.rays(points), 1 / bench.focal_px)[0])
    placed = place(cones, np.array([radius for _, radius in spheres]), camera)
    highlights = np.array(
        [[bench.highlight(centre, radius, light) for centre, radius in spheres] for light in lights]
    )
    return placed, highlights + rng.normal(0, highlight_px, highlights.shape)


def locate(bench, placed, highlights, sigma_px=0.05):
    ids = tuple(f"L{i:02d}" for i in range(len(highlights)))
    sigma_px = np.broadcast_to(sigma_px, highlights.shape[:2])
    located = locate_lights(Observation(bench.camera, placed, highlights, sigma_px), ids)
    return located.refined.positions_mm, located.refined.centres_mm, located.used


@pytest.mark.parametrize("spheres", [TWO_R10, FOUR_R20], ids=["2xR10", "4xR20"])
def test_exact_observations_give_exact_positions(bench, dome_mm, spheres):
    placed, highlights = observe(bench, spheres, dome_mm)
    positions, centres, used = locate(bench, placed, highlights)
    assert np.linalg.norm(positions - dome_mm, axis=1).max() < 1e-3
    assert np.linalg.norm(centres - [c for c, _ in spheres], axis=1).max() < 1e-4
    assert used.all()


@pytest.mark.parametrize(
    ("points", "toward", "expected"),
    [
        pytest.param([(0, 0), (4, 0)], [(3, 4), (-1, 4)], [(3, 4)], id="they meet"),
        pytest.param([(0, 0), (4, 0)], [(-3, -4), (-1, 4)], [], id="behind the first"),
        pytest.param([(0, 0), (4, 0)], [(3, 4), (1, -4)], [], id="behind the second"),
        pytest.param([(0, 0), (4, 0)], [(0, 1), (0, 1)], [], id="parallel"),
        pytest.param([(0, 0), (0.4, 0)], [(3, 4), (-1, 4)], [(0.3, 0.4)], id="close to both"),
        pytest.param(
            [(0, 0), (4, 0), (8, 4)],
            [(0, 1), (0, 1), (-1, 0)],
            [(0, 4), (4, 4)],
            id="two of three are parallel",
        ),
    ],
)
def test_pairs_of_rays_meet_in_front_of_both_spheres(points, toward, expected):
    """The second ray is 2 mm above the others, so that a pair meets half-way, 1 mm above."""
    height = np.array([0.0, 2.0, 0.0])[: len(points)]
    directions = np.column_stack([toward, np.zeros(len(toward))])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    met = pair_positions(np.column_stack([points, height]), directions)
    assert met.shape == (len(expected), 3)
    if expected:
        np.testing.assert_allclose(met[:, :2], expected, atol=1e-12)
        assert met[-1, 2] == 1


def test_the_refinement_minimises_the_stated_errors(bench):
    """An independent minimisation over lights and centres gives the same result."""
    spheres = [*TWO_R20, ((10, 80, 20), 20.0)]
    lights = np.array([[120.0, 60.0, 400.0], [-200.0, 150.0, 350.0]])
    placed, highlights = observe(bench, spheres, lights, 0.3, 0.2, seed=4)
    sigma_px = np.array([[0.05, 0.5, 0.05], [0.05, 0.05, 0.05]])
    highlights[0, 1] += 0.4
    whiten = np.linalg.inv(np.linalg.cholesky(placed.covariance_mm2))

    def errors(values):
        points, centres = values[:6].reshape(2, 3), values[6:].reshape(3, 3)
        seen = np.array([[bench.highlight(c, 20.0, light) for c in centres] for light in points])
        off = whiten @ (centres - placed.centres_mm).ravel()
        return np.concatenate([((seen - highlights) / sigma_px[..., None]).ravel(), off])

    start = np.concatenate([lights.ravel(), placed.centres_mm.ravel()])
    least = least_squares(errors, start, x_scale=np.repeat([10.0, 0.1], [6, 9])).x
    positions, centres, used = locate(bench, placed, highlights, sigma_px)
    assert used.all()
    assert np.abs(start - least).max() > 1.0
    np.testing.assert_allclose(positions.ravel(), least[:6], atol=0.01)
    np.testing.assert_allclose(centres.ravel(), least[6:], atol=0.001)


@pytest.mark.parametrize(("error_px", "agrees"), [(1.2, True), (2.0, False)])
def test_a_highlight_agrees_to_one_and_a_half_pixels(bench, dome_mm, error_px, agrees):
    placed, highlights = observe(bench, FOUR_R20, dome_mm[::6])
    highlights[2, 1, 0] += error_px
    _, _, used = locate(bench, placed, highlights)
    assert used[2].tolist() == [True, agrees, True, True]
    assert used.sum() == used.size - (not agrees)


@pytest.mark.parametrize(("error_px", "agrees"), [(6.0, True), (20.0, False)])
def test_a_highlight_agrees_to_five_times_the_median_error(bench, dome_mm, error_px, agrees):
    """The other highlights of the light are wrong by 2 px."""
    placed, highlights = observe(bench, FOUR_R20, dome_mm[::6])
    highlights[2] += [(2, 0), (-2, 0), (0, error_px), (2, 0)]
    _, _, used = locate(bench, placed, highlights)
    assert used[2].tolist() == [True, True, agrees, True]


@pytest.mark.parametrize(("distance_mm", "determined"), [(45e3, True), (55e3, False)])
def test_a_position_is_uncertain_by_a_quarter_of_the_distance_at_most(
    bench, distance_mm, determined
):
    """The uncertainty is 0.5 % per metre with these two spheres; the near light is certain."""
    lights = np.array([[0.0, 100.0, 400.0], [0.26 * distance_mm, 0.19 * distance_mm, distance_mm]])
    placed, highlights = observe(bench, TWO_R20, lights)
    if determined:
        positions, _, _ = locate(bench, placed, highlights)
        np.testing.assert_allclose(positions, lights, rtol=0.01, atol=0.01)
        return
    with pytest.raises(EstimateError, match="the distance of light L01 is not determined"):
        locate(bench, placed, highlights)


def test_rays_that_do_not_meet_are_reported(bench):
    """Highlights on the opposite side of the centres: the rays diverge."""
    placed, highlights = observe(bench, TWO_R20, np.array([[0.0, 100.0, 200.0]]))
    centres_px = np.array([bench.project(np.array(centre)) for centre, _ in TWO_R20])
    with pytest.raises(EstimateError, match="rays of light L00 do not meet in front"):
        locate(bench, placed, 2 * centres_px - highlights)


@pytest.mark.parametrize(
    ("count", "says"),
    [
        (1, "light L0"),
        (2, "lights L0, L1"),
        (4, "lights L0, L1, L2, L3"),
        (5, "lights L0, L1, L2, L3 and 1 more"),
        (9, "lights L0, L1, L2, L3 and 5 more"),
    ],
)
def test_at_most_four_lights_are_named(count, says):
    assert named([f"L{i}" for i in range(count)], range(count)) == says


@pytest.mark.parametrize(
    ("spheres", "bound_mm", "bound_deg"),
    [
        pytest.param(TWO_R10, 1.5 * 4.9, 1.5 * 0.12, id="2xR10", marks=pytest.mark.slow),
        pytest.param(TWO_R20, 1.5 * 2.3, 1.5 * 0.065, id="2xR20"),
        pytest.param(FOUR_R20, 1.5 * 1.3, 1.5 * 0.042, id="4xR20", marks=pytest.mark.slow),
    ],
)
def test_noise_of_outlines_and_highlights(bench, dome_mm, spheres, bound_mm, bound_deg):
    errors_mm, errors_deg = [], []
    for seed in range(4):
        placed, highlights = observe(bench, spheres, dome_mm, 0.3, 0.1, seed)
        positions, _, _ = locate(bench, placed, highlights)
        errors_mm.append(np.linalg.norm(positions - dome_mm, axis=1).mean())
        cross = np.linalg.norm(np.cross(positions, dome_mm), axis=1)
        errors_deg.append(np.degrees(np.arctan2(cross, (positions * dome_mm).sum(axis=1))).mean())
    assert np.mean(errors_mm) < bound_mm
    assert np.mean(errors_deg) < bound_deg


def test_one_false_highlight_in_four_does_no_harm(bench, dome_mm):
    placed, highlights = observe(bench, FOUR_R20, dome_mm, 0.1, 0.03, seed=3)
    rng = np.random.default_rng(8)
    false = rng.integers(0, 4, len(dome_mm))
    highlights[np.arange(len(dome_mm)), false] += rng.choice([-25.0, 25.0], (len(dome_mm), 2))
    positions, _, used = locate(bench, placed, highlights)
    assert not used[np.arange(len(dome_mm)), false].any()
    assert used.sum() == 3 * len(dome_mm)
    assert np.linalg.norm(positions - dome_mm, axis=1).mean() < 1.0


def test_a_light_with_one_highlight_is_named(bench, dome_mm):
    placed, highlights = observe(bench, FOUR_R20, dome_mm)
    highlights[7, 1:] = np.nan
    with pytest.raises(EstimateError, match="light L07: highlights on fewer than 2 of 4 spheres"):
        locate(bench, placed, highlights)


def test_a_light_with_two_highlights_of_four_is_located(bench, dome_mm):
    placed, highlights = observe(bench, FOUR_R20, dome_mm)
    highlights[7, :2] = np.nan
    positions, _, _ = locate(bench, placed, highlights)
    assert np.linalg.norm(positions[7] - dome_mm[7]) < 1e-3


@pytest.mark.parametrize(
    ("foot_mm", "says"),
    [
        pytest.param(0.0, None, id="on the plane"),
        pytest.param(29.0, None, id="a little above"),
        pytest.param(-29.0, None, id="a little below"),
        pytest.param(31.0, "31 mm above the working plane", id="above"),
        pytest.param(-31.0, "31 mm below the working plane", id="below"),
    ],
)
def test_spheres_off_the_working_plane_are_reported(bench, foot_mm, says):
    """The limit is 5 % of the working distance of 600 mm, 30 mm on either side, for the median."""
    radii = np.array([20.0, 10.0, 15.0])
    feet = foot_mm + np.array([-8.0, 0.0, 8.0])
    centres = np.column_stack([[-50, 0, 50], [10, 0, -10], feet + radii])
    warnings = off_the_plane(KnownSpheres(centres, radii, np.eye(9)), bench.camera)
    assert (warnings == []) if says is None else (says in str(warnings[0]) and len(warnings) == 1)


def test_distant_light_has_no_distance(bench):
    lights = np.array([[3e6, 1e6, 4e6], [-2e6, 1e6, 4e6]])
    placed, highlights = observe(bench, TWO_R10, lights, 0.1, 0.05, seed=1)
    with pytest.raises(EstimateError, match="light L0"):
        locate(bench, placed, highlights)


@pytest.mark.parametrize(
    ("highlights", "outlines", "least", "most"),
    [
        pytest.param(1.0, 1.0, 0.7, 1.5, id="as stated"),
        pytest.param(1.0, 0.3, 0.4, 0.8, id="outlines three times better"),
        pytest.param(3.0, 1.0, 0.7, 2.0, id="highlights three times worse"),
        pytest.param(1.0, 4.0, 3.0, 16.0, id="outlines four times worse"),
    ],
)
def test_deviations_of_the_centres_show_errors_of_outlines(
    bench, dome_mm, highlights, outlines, least, most
):
    """Worse highlights hardly change what is stated for the outlines."""
    placed, seen = observe(bench, FOUR_R20, dome_mm, 0.0, 0.03 * highlights, seed=7)
    normal = np.random.default_rng(5).normal(size=12)
    off = outlines * (np.linalg.cholesky(placed.covariance_mm2) @ normal).reshape(4, 3)
    placed = replace(placed, centres_mm=placed.centres_mm + off)
    sigma_px = np.full(seen.shape[:2], 0.03)
    names = tuple(f"L{k:02}" for k in range(len(dome_mm)))
    given = Observation(bench.camera, placed, seen, sigma_px)
    found = refine(given, dome_mm, names)
    system = linearise(given, found.positions_mm, found.centres_mm)
    share = system.outlines_share((found.centres_mm - placed.centres_mm).ravel())
    assert least <= share <= most
    assert found.chi_square > 6 or highlights == 1
    stated = system.covariance(max(found.chi_square, 1.0), max(share, 1.0))
    np.testing.assert_allclose(found.covariance_mm2, stated)
    # Only unsaturated peaks show that outlines are better than stated.
    peaks = refine(given, dome_mm, names, peaks=True)
    smaller = np.trace(peaks.covariance_mm2 - system.covariance(1.0, 1.0), axis1=1, axis2=2) < 0
    assert smaller.all() == (share < 1 and highlights == 1)
