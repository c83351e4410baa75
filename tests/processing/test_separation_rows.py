"""Rows of a map that are separated on their own are equal to those of the complete map."""

import numpy as np
import pytest

from acquisition import DataError
from acquisition.files import ComputedRows
from processing import ShapeFilter, separate
from processing.detail import separate_rows
from tests.processing.scenes import waves


@pytest.fixture(scope="module")
def relief():
    """Waves with noise, with a hole, in a disc that leaves the first and last rows empty."""
    y, x = np.mgrid[0:330, 0:150]
    mask = ((x - 75) ** 2 + (y - 150) ** 2 < 140**2) & ~((abs(x - 60) < 15) & (abs(y - 200) < 60))
    return waves(x.shape, 3, (0.5, 0.4), (40, 30), mask=mask)


@pytest.mark.parametrize(
    ("shape_filter", "margin"),
    [
        pytest.param(ShapeFilter(), 120, id="gaussian"),
        pytest.param(ShapeFilter(order=1), 5, id="the paper's"),
        pytest.param(ShapeFilter(w=9, order=3), 63, id="wide"),
        pytest.param(ShapeFilter("box"), 5, id="box"),
        pytest.param(ShapeFilter("guided"), 21, id="guided"),
        pytest.param(ShapeFilter("bilateral"), 29, id="bilateral"),
    ],
)
def test_rows_are_equal_to_those_of_the_complete_map(relief, shape_filter, margin):
    whole = separate(relief, shape_filter=shape_filter)
    assert shape_filter.margin == margin
    normals = ComputedRows(relief.normals.shape, np.dtype(np.float32), lambda s: relief.normals[s])
    for rows in (slice(0, 1), slice(1, 131), slice(131, 200), slice(329, 330)):
        shape, detail = separate_rows(normals, relief.mask, rows, shape_filter=shape_filter)
        np.testing.assert_array_equal(shape, whole.shape.normals[rows])
        np.testing.assert_array_equal(detail, whole.detail.normals[rows])


def test_a_band_without_normals_is_empty_and_small_maps_are_refused(relief):
    shape, detail = separate_rows(relief.normals, relief.mask, slice(300, 320))
    assert not shape.any()
    assert not detail.any()
    assert shape.shape == (20, 150, 3)
    with pytest.raises(DataError, match="larger than the normal map"):
        separate_rows(relief.normals[:10], relief.mask[:10], slice(0, 5))
