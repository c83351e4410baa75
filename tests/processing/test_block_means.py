"""Cells of a small copy of a stack: their points are in their middle."""

from __future__ import annotations

import numpy as np
import pytest

from acquisition import Lights
from processing.images.block_means import cells_of
from processing.series import light_strengths
from tests.processing.scenes import dome


@pytest.mark.parametrize("side", [100, 180, 300, 400, 520])
def test_points_are_the_means_of_their_cells(side: int) -> None:
    y, x = np.indices((side, side)).astype(float)
    points = np.dstack([x, y, 0.1 * x + 0.2 * y])
    mask = np.ones((side, side), bool)
    cells = cells_of(np.stack([x, y]).astype(np.float32), mask, points)
    assert cells.points_mm is not None
    np.testing.assert_allclose(cells.points_mm[..., :2], cells.values.transpose(1, 2, 0), rtol=1e-5)
    assert (side == 100) == (cells.size == 1)


def test_strengths_of_near_lights_do_not_depend_on_the_size_of_cells() -> None:
    """Points that were half a pixel off had strengths of .4 % that no deviation contained."""
    lights = Lights(positions_mm=450 * dome(20, 0.9, 0.4), mu=np.ones(20))
    errors = []
    for side in (120, 240):
        y, x = np.mgrid[60 : -60 : side * 1j, -60 : 60 : side * 1j]
        relief = 2 * np.sin(x / 7) * np.cos(y / 9)
        across, down = np.gradient(relief, x[0], axis=1), np.gradient(relief, y[:, 0], axis=0)
        normals = np.dstack([-across, -down, np.ones_like(x)])
        normals /= np.linalg.norm(normals, axis=2, keepdims=True)
        points = np.dstack([x, y, relief])
        vectors = lights.vectors_at(points)
        values = np.einsum("nhwc,hwc->nhw", vectors, normals).clip(0).astype(np.float32)
        found = light_strengths(values, lights, np.ones((side, side), bool), points_mm=points)
        errors.append(np.abs(np.log(found.factors)).max())
    assert max(errors) < 1e-3, errors
