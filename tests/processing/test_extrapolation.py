"""Steps from four normals in a row, against closed forms of smooth surfaces and of folds."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from acquisition import CameraModel
from processing.surface.chord_rule import ChordRule
from rig.arrays import Float64

ROWS, COLUMNS = 9, 40
WINDOW = slice(0, ROWS), slice(0, COLUMNS)


def largest_errors(normals: Float64, truth: Float64, camera: CameraModel | None = None) -> Float64:
    """Return the largest error of a step by the chord rule, and by extrapolation, in pixels."""
    mask = np.ones(truth.shape, bool)
    window = slice(0, truth.shape[0]), slice(0, truth.shape[1])
    errors = []
    for smooth in (False, True):
        rule = ChordRule(window, camera, smooth=smooth)
        right, down = rule.edges(normals.astype(np.float32), mask)[2:]
        # Steps at the rim have no normals before or after them.
        off_right = (right[1:-1, 1:-2] - np.diff(truth, axis=1))[:, 1:-1]
        off_down = (down[1:-2, 1:-1] - np.diff(truth, axis=0))[1:-1]
        errors.append(rule.step_px * max(np.abs(off_right).max(), np.abs(off_down).max()))
    return np.array(errors)


def waves(length: float) -> tuple[Float64, Float64]:
    """Return normals and heights of waves with slopes up to 1, of a length in pixels."""
    y, x = np.mgrid[:ROWS, :COLUMNS] / length
    heights = 0.7 * length * np.sin(x) * np.cos(y + 0.3)
    slopes = 0.7 * np.cos(x) * np.cos(y + 0.3), 0.7 * np.sin(x) * np.sin(y + 0.3)
    normals = np.dstack([-slopes[0], -slopes[1], np.ones_like(x)])
    return normals / np.linalg.norm(normals, axis=2, keepdims=True), heights


def waves_in_perspective(length: float) -> tuple[Float64, Float64, CameraModel]:
    """Return normals, logarithms of depths, and a camera whose focal length grows with the waves.

    A point is d r, with the depth d = exp(g) and the ray r: its derivatives are d (g' r + r').
    """
    focal = 20 * length
    K = np.array([[focal, 0, 11], [0, focal, 3], [0, 0, 1]])
    camera = CameraModel(K, COLUMNS, ROWS)
    rays = camera.rays(np.dstack(np.meshgrid(np.arange(COLUMNS), np.arange(ROWS))))
    y, x = np.mgrid[:ROWS, :COLUMNS] / length
    g = 0.035 * np.sin(x) * np.cos(y + 0.3)
    to_right = 0.035 / length * np.cos(x) * np.cos(y + 0.3)
    to_down = -0.035 / length * np.sin(x) * np.sin(y + 0.3)
    along_row = to_right[..., None] * rays + np.array([1 / focal, 0, 0])
    along_column = to_down[..., None] * rays - np.array([0, 1 / focal, 0])
    normals = np.cross(along_column, along_row)
    return normals / np.linalg.norm(normals, axis=2, keepdims=True), g, camera


@pytest.mark.parametrize("scene", [waves, waves_in_perspective])
def test_errors_fall_with_the_fifth_power_of_the_pixel(
    scene: Callable[[float], tuple[Float64, Float64] | tuple[Float64, Float64, CameraModel]],
) -> None:
    coarse, fine = (largest_errors(*scene(length)) for length in (6.0, 12.0))
    # In pixels, which are half as large: the second power, and the fourth.
    assert 3 < (coarse / fine)[0] < 5
    assert 11 < (coarse / fine)[1] < 25
    assert fine[1] < 0.05 * fine[0]


@pytest.mark.parametrize("focal_px", [None, 120.0])
def test_spheres_stay_exact(focal_px: float | None) -> None:
    radius, size = 40.0, 41
    y, x = np.mgrid[20:-20:41j, -20:20:41j]
    if focal_px is None:
        z = np.sqrt(radius**2 - x**2 - y**2)
        normals, truth, camera = np.dstack([x, y, z]) / radius, z, None
    else:
        K = np.array([[focal_px, 0, 20], [0, focal_px, 20], [0, 0, 1]])
        camera = CameraModel(K, size, size)
        rays = camera.rays(np.dstack(np.meshgrid(np.arange(size), np.arange(size))))
        # Nearer intersection of the rays with a sphere at a depth of 160.
        a, b = (rays**2).sum(axis=2), 160 * rays[..., 2]
        depth = (-b - np.sqrt(b**2 - a * (160**2 - radius**2))) / a
        normals, truth = (depth[..., None] * rays + [0, 0, 160]) / radius, np.log(depth)
    assert largest_errors(normals, truth, camera).max() < 2e-5


def test_steps_at_the_rim_and_at_folds_are_those_of_two_normals() -> None:
    vectors = np.tile([0.0, 0.0, 1.0], (ROWS, COLUMNS, 1))
    # A steep wall: its chords are nonlinear in the slopes.
    vectors[:, 20:24] = [0.98, 0.0, 0.2]
    vectors[:, 30:] = waves(6.0)[0][:, 30:]
    normals = (vectors / np.linalg.norm(vectors, axis=2, keepdims=True)).astype(np.float32)
    mask = np.ones((ROWS, COLUMNS), bool)
    mask[4, 35] = False
    plain, fine = (ChordRule(WINDOW, None, smooth=smooth).edges(normals, mask) for smooth in (0, 1))
    for before, after in zip(plain[:2], fine[:2], strict=True):
        np.testing.assert_array_equal(before, after)
    changed = plain[2] != fine[2]
    # The first and last edge of a row, those of the wall, and those next to a hole.
    assert not changed[:, [1, COLUMNS - 1]].any()
    assert not changed[:, 20].any()
    assert changed[1:-1, 33:39].sum() == ROWS * 6 - 4
    assert not (plain[3] != fine[3])[[1, ROWS - 1]].any()
