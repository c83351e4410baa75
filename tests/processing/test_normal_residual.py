"""Angles between a surface and the normals that it was computed from."""

from __future__ import annotations

import numpy as np
import pytest

from acquisition import DataError
from processing import NormalMap, integrate, normal_residual
from simulator import bench_camera
from tests.processing.test_jumps import horn


def test_residual_of_a_surface_and_of_turned_normals() -> None:
    y, x = np.mgrid[1:-1:300j, -1:1:80j]  # more rows than are computed at a time
    vectors = np.dstack([np.sin(3 * x), np.cos(2 * y), 0 * x + 2])
    normals = NormalMap.from_vectors(vectors, np.hypot(x, y) < 0.9)
    surface = integrate(normals)
    angles = normal_residual(surface, normals)
    assert np.array_equal(np.isfinite(angles), surface.mask)
    assert np.nanmax(angles) < 2
    assert np.nanmean(angles) < 0.1
    turned = NormalMap.from_vectors(-vectors, np.hypot(x, y) < 0.9)
    np.testing.assert_allclose(normal_residual(surface, turned), 180 - angles, atol=1e-3)
    with pytest.raises(DataError, match="does not fit a normal map"):
        normal_residual(surface, horn(20)[0])


def test_perspective_planes_have_no_residual() -> None:
    camera = bench_camera()
    plane = NormalMap.from_vectors(np.full((*camera.size, 3), [0.3, -0.2, 0.9]))
    angles = normal_residual(integrate(plane, camera=camera), plane)
    assert angles.max() < 0.05


def test_jumps_do_not_count() -> None:
    normals, truth = horn()
    smooth, jumps = integrate(normals, discontinuity=False), integrate(normals)
    plain, cut = (normal_residual(surface, normals) for surface in (smooth, jumps))
    assert np.nanmean(cut) < 0.25 * np.nanmean(plain)
    step = np.zeros(truth.shape, bool)
    step[:-1] = np.abs(np.diff(truth, axis=0)) > 6
    assert np.nanmedian(plain[step]) > 20  # where the smooth surface is wrong
