"""Random reliefs: fixed by their seed, of unit length, with the stated slopes and errors."""

import itertools

import numpy as np
import pytest

from acquisition import DataError
from simulator import random_normals
from simulator.reliefs import random_relief, rugged_normals

SIZE = 48


@pytest.fixture(scope="module")
def reliefs() -> list[np.ndarray]:
    return [random_relief(seed, SIZE) for seed in range(40)]


@pytest.fixture(scope="module")
def normals() -> list[np.ndarray]:
    return [random_normals(seed, SIZE) for seed in range(40)]


def test_a_seed_fixes_relief_and_normals(reliefs, normals):
    for seed in (0, 7, 2**63 - 1):
        np.testing.assert_array_equal(random_relief(seed, SIZE), random_relief(seed, SIZE))
    np.testing.assert_array_equal(random_normals(7, SIZE), normals[7])
    for first, second in itertools.pairwise(reliefs):
        assert np.abs(first - second).max() > 0.1


def test_normals_are_unit_vectors_that_face_the_camera(normals):
    for one in normals:
        assert one.dtype == np.float32
        np.testing.assert_allclose(np.linalg.norm(one, axis=2), 1, atol=2e-7)
    steep = np.mean([np.mean(one[..., 2] <= 0) for one in normals])
    assert steep < 0.01


def test_mean_slopes_are_spread_from_2_to_28_degrees(reliefs):
    means = [np.degrees(np.arctan(np.hypot(*np.gradient(one)).mean())) for one in reliefs]
    assert np.percentile(means, 20) < 6
    assert np.percentile(means, 80) > 10
    assert max(means) < 45


def test_maps_without_errors_are_the_slopes_of_the_relief(reliefs, normals):
    """Up to a tilt, which is constant; maps with errors and rounded ones differ."""
    exact = 0
    for relief, map_ in zip(reliefs, normals, strict=True):
        down, right = np.gradient(relief)
        x = (map_[..., 0] / map_[..., 2] + right)[1:-1, 1:-1]
        y = (map_[..., 1] / map_[..., 2] - down)[1:-1, 1:-1]
        exact += x.std() < 1e-5 and y.std() < 1e-5
    # Half have no errors; of these, 7 of 10 are not rounded.
    assert 7 <= exact <= 21


def test_rugged_normals_are_fixed_unit_and_steeper(normals):
    rugged = [rugged_normals(seed, SIZE) for seed in range(40)]
    np.testing.assert_array_equal(rugged_normals(7, SIZE), rugged[7])
    for first, second in itertools.pairwise(rugged):
        assert np.abs(first - second).max() > 0.1
    for one in rugged:
        assert (one.dtype, one.shape) == (np.float32, (SIZE, SIZE, 3))
        np.testing.assert_allclose(np.linalg.norm(one, axis=2), 1, atol=2e-7)
    # The angle to the mean normal does not depend on the tilt.
    spreads = [
        np.median([1 - np.linalg.norm(one.mean(axis=(0, 1))) for one in each])
        for each in (normals, rugged)
    ]
    assert spreads[1] > 1.2 * spreads[0]


@pytest.mark.parametrize(
    ("seed", "size", "words"),
    [(-1, 64, "seed of -1"), (2**63, 64, "seed"), (0, 15, "size of 15"), (0, 5000, "size of 5000")],
)
@pytest.mark.parametrize("make", [random_relief, random_normals, rugged_normals])
def test_numbers_out_of_range_are_refused(make, seed, size, words):
    with pytest.raises(DataError, match=words):
        make(seed, size)
