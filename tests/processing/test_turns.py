"""Weights of edges by the turn of the normals, against folds, bends and noise."""

from __future__ import annotations

import numpy as np
import pytest

from processing.surface.normal_turns import evenness
from rig.arrays import Bool, Float32, Float64

ROWS, COLUMNS = 20, 30


def bent(angles: Float64) -> Float32:
    """Return normals that are turned about the y axis by an angle for each column."""
    row = np.stack([np.sin(angles), 0 * angles, np.cos(angles)], axis=1)
    return np.broadcast_to(row, (ROWS, len(angles), 3)).astype(np.float32)


def weights(normals: Float32, mask: Bool | None = None) -> tuple[Float32, Float32]:
    rows, columns = normals.shape[:2]
    mask = np.ones((rows, columns), bool) if mask is None else mask
    right, down = np.zeros((2, rows + 2, columns + 2), np.float32)
    right[1:-1, 1:-2] = mask[:, 1:] & mask[:, :-1]
    down[1:-2, 1:-1] = mask[1:] & mask[:-1]
    return evenness(np.ascontiguousarray(normals), mask, (right, down))


@pytest.mark.parametrize("turn", [0.02, 0.15, 0.3, 1.0])
def test_a_fold_counts_less_at_its_edge_alone(turn: float) -> None:
    right, down = weights(bent(np.where(np.arange(COLUMNS) < 15, 0, turn)))
    # The chord between both sides is compared with .1; no turn is known 4 px away.
    expected = max((1 + (2 * np.sin(turn / 2) / 0.1) ** 2) ** -2, 0.01)
    np.testing.assert_allclose(right[1:-1, 15], expected, rtol=1e-4)
    np.testing.assert_allclose(right[1:-1, [*range(1, 13), *range(18, 30)]], 1)
    np.testing.assert_allclose(down[1:-1, 1:-1], 1)
    # Edges next to it see a part of the turn.
    assert np.all(right[1:-1, 14] >= right[1:-1, 15])


def test_a_surface_that_bends_evenly_counts_everywhere() -> None:
    right, down = weights(bent(np.linspace(-1, 1, COLUMNS)))
    assert right[1:-1, 7:-7].min() > 0.99
    np.testing.assert_array_equal(down[1:-1, 1:-1], 1)


def test_rows_and_columns_are_alike() -> None:
    rng = np.random.default_rng(0)
    normals = bent(np.where(np.arange(COLUMNS) < 15, 0, 0.4)) + 0.05 * rng.normal(size=(20, 30, 3))
    normals = (normals / np.linalg.norm(normals, axis=2, keepdims=True)).astype(np.float32)
    mask = rng.random((ROWS, COLUMNS)) < 0.95
    right, down = weights(normals, mask)
    turned = np.ascontiguousarray(normals.transpose(1, 0, 2))
    other_right, other_down = weights(turned, np.ascontiguousarray(mask.T))
    np.testing.assert_allclose(other_right, down.T, rtol=1e-5)
    np.testing.assert_allclose(other_down, right.T, rtol=1e-5)


def test_the_window_is_symmetric() -> None:
    normals = bent(np.where(np.arange(COLUMNS) < 15, 0, 0.4)).copy()
    normals[11:] = [0, 0, 1]
    normals[6, 20] = [0.6, 0, 0.8]
    right, down = weights(normals)
    mirrored = weights(normals[:, ::-1]), weights(normals[::-1])
    np.testing.assert_allclose(mirrored[0][0][:, 1:-2], right[:, 1:-2][:, ::-1], rtol=1e-4)
    np.testing.assert_allclose(mirrored[0][1], down[:, ::-1], rtol=1e-4)
    np.testing.assert_allclose(mirrored[1][0], right[::-1], rtol=1e-4)
    np.testing.assert_allclose(mirrored[1][1][1:-2], down[1:-2][::-1], rtol=1e-4)


def test_noise_is_no_fold() -> None:
    """The width grows with the noise: few edges count much less."""
    rng = np.random.default_rng(1)
    for scale in (0.02, 0.2):
        noisy = [0.0, 0.0, 1.0] + scale * rng.normal(size=(ROWS, COLUMNS, 3))
        normals = (noisy / np.linalg.norm(noisy, axis=2, keepdims=True)).astype(np.float32)
        for found in weights(normals):
            assert np.mean(found[1:-2, 1:-2] > 0.5) > 0.9
            assert found.min() >= np.float32(0.01)
            assert found.max() <= 1
