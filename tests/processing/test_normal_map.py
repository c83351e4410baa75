import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from acquisition import DataError
from processing import NormalMap


def _flat(height=4, width=5):
    normals = np.zeros((height, width, 3), np.float32)
    normals[..., 2] = 1
    return normals, np.ones((height, width), bool)


def _set(array, where, value):
    array[where] = value
    return array


INVALID = {
    "short": (lambda n, m: (_set(n, (1, 2), (0, 0, 0.99)), m), "row 1, column 2 inside"),
    "nan": (lambda n, m: (_set(n, (3, 0, 1), np.nan), m), "row 3, column 0 inside"),
    "zero": (lambda n, m: (_set(n, (0, 4), (0, 0, 0)), m), "row 0, column 4 inside"),
    "outside": (lambda n, m: (n, _set(m, (2, 2), False)), "row 2, column 2 outside"),
    "empty mask": (lambda n, m: (n * 0, m & False), "empty mask"),
    "two channels": (lambda n, m: (n[..., :2], m), r"\(H, W, 3\)"),
    "other size": (lambda n, m: (n, m[:-1]), r"mask must be bool of shape \(4, 5\), not bool of"),
    "mask of bytes": (lambda n, m: (n, m.astype(np.uint8)), "mask must be bool of"),
}


@pytest.mark.parametrize("name", INVALID)
def test_an_invalid_normal_map_is_refused(name):
    change, message = INVALID[name]
    with pytest.raises(DataError, match=message):
        NormalMap(*change(*_flat()))


def test_half_float_rounding_is_accepted():
    normals = np.random.default_rng(3).normal(size=(50, 50, 3))
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    stored = normals.astype(np.float16).astype(np.float32)
    assert NormalMap(stored, np.ones((50, 50), bool)).size == (50, 50)


def test_from_vectors_leaves_out_vectors_without_direction():
    vectors = np.full((2, 3, 3), 0.0)
    vectors[0, 0] = (3, 0, 4)
    vectors[0, 1] = (np.nan, 0, 1)
    vectors[0, 2] = (np.inf, 0, 1)
    vectors[1, 0] = (0, -1e-100, 0)
    vectors[1, 1] = (0, 0, 7)
    vectors[1, 2] = (0, 0, 1)
    given = np.ma.array(vectors)
    given[1, 2, 0] = np.ma.masked
    mask = np.array([[True, True, True], [True, False, True]])
    normal_map = NormalMap.from_vectors(given, mask)
    assert normal_map.mask.tolist() == [[True, False, False], [True, False, False]]
    np.testing.assert_allclose(normal_map.normals[0, 0], (0.6, 0, 0.8), atol=1e-7)
    np.testing.assert_array_equal(normal_map.normals[1, 0], (0, -1, 0))
    assert not normal_map.normals[~normal_map.mask].any()


@given(
    hnp.arrays(
        np.float64, (3, 4, 3), elements=st.floats(-1e6, 1e6, allow_subnormal=False, width=64)
    )
)
@settings(max_examples=50)
def test_from_vectors_keeps_directions(vectors):
    vectors[np.abs(vectors) < 1e-100] = 0
    if not vectors.any():
        vectors[0, 0, 0] = 1
    normal_map = NormalMap.from_vectors(vectors)
    length = np.linalg.norm(vectors, axis=2)
    np.testing.assert_array_equal(normal_map.mask, length > 0)
    expected = np.divide(
        vectors, length[..., None], where=normal_map.mask[..., None], out=vectors * 0
    )
    np.testing.assert_allclose(normal_map.normals, expected, atol=1e-6)


def test_from_vectors_without_any_direction_is_refused():
    with pytest.raises(DataError, match="empty mask"):
        NormalMap.from_vectors(np.zeros((3, 3, 3)))


def test_numpy_takes_a_map_as_its_array():
    made = NormalMap.from_vectors(np.dstack([np.ones((2, 3)), np.zeros((2, 3)), np.ones((2, 3))]))
    np.testing.assert_array_equal(np.asarray(made), made.normals)
    assert np.asarray(made, np.float64).dtype == np.float64
    assert not np.shares_memory(np.array(made, copy=True), made.normals)
    assert np.shares_memory(np.asarray(made), made.normals)


@pytest.mark.parametrize("width", [3, 2000])
def test_notebooks_show_a_map_as_a_picture(width):
    vectors = np.zeros((4, width, 3))
    vectors[..., 0] = vectors[..., 2] = 1  # to the right and towards the camera
    vectors[-1] = 0
    data = np.frombuffer(NormalMap.from_vectors(vectors)._repr_png_(), np.uint8)
    picture = cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
    assert max(picture.shape[:2]) <= 512
    blue, green, red, alpha = picture[0, 0]
    assert (red, green, blue, alpha) == (218, 128, 218, 255)
    if width == 3:
        assert picture[-1, 0, 3] == 0
