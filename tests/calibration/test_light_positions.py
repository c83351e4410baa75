"""Positions from exact and noisy geometry; the bounds are 1.5 x an independent calculation."""

import numpy as np
import pytest

from calibration import EstimateError
from calibration._spheres.cone import fit_cone
from calibration._spheres.light_positions import KnownSpheres, locate_lights
from calibration._spheres.placed import off_the_plane, place

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


def locate(bench, placed, highlights):
    ids = tuple(f"L{i:02d}" for i in range(len(highlights)))
    saturated = np.zeros(highlights.shape[:2], bool)
    return locate_lights(bench.camera, placed, highlights, saturated, ids)


@pytest.mark.parametrize("spheres", [TWO_R10, FOUR_R20], ids=["2xR10", "4xR20"])
def test_exact_observations_give_exact_positions(bench, dome_mm, spheres):
    placed, highlights = observe(bench, spheres, dome_mm)
    positions, centres, used = locate(bench, placed, highlights)
    assert np.linalg.norm(positions - dome_mm, axis=1).max() < 1e-3
    assert np.linalg.norm(centres - [c for c, _ in spheres], axis=1).max() < 1e-4
    assert used.all()


@pytest.mark.parametrize(
    ("spheres", "bound_mm", "bound_deg"),
    [
        pytest.param(TWO_R10, 1.5 * 4.9, 1.5 * 0.12, id="2xR10"),
        pytest.param(TWO_R20, 1.5 * 2.3, 1.5 * 0.065, id="2xR20"),
        pytest.param(FOUR_R20, 1.5 * 1.3, 1.5 * 0.042, id="4xR20"),
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
