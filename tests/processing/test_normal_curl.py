"""The curl of normal maps: closed forms, noise, and what is reported."""

from __future__ import annotations

import numpy as np
import pytest

from acquisition import CameraModel, DataError
from processing import NormalMap, normal_curl
from processing.surface import curl_notices
from rig.arrays import Float64

CAMERA = CameraModel(np.array([[300.0, 0, 60], [0, 300.0, 50], [0, 0, 1]]), 120, 100, 400.0)


def of_slopes(p: Float64, q: Float64) -> NormalMap:
    """Return normals of slopes to the right and up."""
    return NormalMap.from_vectors(np.dstack([-p, -q, np.ones_like(p)]))


def test_a_rotation_has_the_curl_of_its_slopes() -> None:
    """Slopes p = -a y, q = a x with small a: dq/dx - dp/dy = 2 a."""
    row, column = np.mgrid[:30, :40].astype(np.float64)
    a = 1e-3
    found = normal_curl(of_slopes(a * row, a * column))
    inner = found.curl_deg[:-1, :-1]
    np.testing.assert_allclose(inner, np.degrees(2 * a), rtol=0.01)
    assert np.isnan(found.curl_deg[-1]).all()
    assert np.isnan(found.curl_deg[:, -1]).all()
    assert np.isnan(found.excess)


def test_spheres_and_planes_have_none() -> None:
    y, x = np.mgrid[40:-40:81j, -40:40:81j]
    inside = np.hypot(x, y) < 38
    ball = NormalMap.from_vectors(
        np.dstack([x, y, np.sqrt(np.maximum(1600 - x**2 - y**2, 1))]), inside
    )
    assert np.nanmax(np.abs(normal_curl(ball).curl_deg)) < 1e-3
    tilted = NormalMap.from_vectors(np.tile([0.5, -0.3, 0.8], (100, 120, 1)))
    assert np.nanmax(np.abs(normal_curl(tilted, camera=CAMERA).curl_deg)) < 1e-3


@pytest.mark.parametrize("camera", [None, CAMERA], ids=["orthographic", "perspective"])
@pytest.mark.parametrize("normal", [(0, 0, 1), (0.6, 0.3, 0.74)], ids=["flat", "steep"])
def test_noise_has_the_curl_of_its_deviation(
    camera: CameraModel | None, normal: tuple[float, float, float]
) -> None:
    rng = np.random.default_rng(4)
    sigma = np.full((100, 120), 1.5, np.float32)
    sigma[:, 60:] = 3
    noise = np.radians(sigma)[..., None] / np.sqrt(2) * rng.normal(size=(100, 120, 3))
    unit = np.array(normal) / np.linalg.norm(normal)
    found = normal_curl(NormalMap.from_vectors(unit + noise), camera=camera, sigma_deg=sigma)
    assert found.excess == pytest.approx(1, abs=0.06)
    assert np.nanstd(found.curl_deg[:, :59]) == pytest.approx(1.5, rel=0.08)
    # Deviations that are much too small do not explain it.
    doubted = normal_curl(NormalMap.from_vectors(unit + noise), camera=camera, sigma_deg=sigma / 9)
    assert curl_notices(found) == []
    assert [notice.code for notice in curl_notices(doubted)] == ["curl-not-explained"]


def test_other_sizes_are_refused() -> None:
    normals = of_slopes(np.zeros((9, 9)), np.zeros((9, 9)))
    with pytest.raises(DataError, match="camera"):
        normal_curl(normals, camera=CAMERA)
    with pytest.raises(DataError, match="deviations"):
        normal_curl(normals, sigma_deg=np.ones((9, 8), np.float32))
