"""Effect of a mounting on frames and their colour filter pattern."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from rig import Mounting

# The upright image A, B / C, D / E, F, and the frame that a camera with each mounting delivers.
UPRIGHT = ["AB", "CD", "EF"]
STORED = [
    pytest.param(0, False, ["AB", "CD", "EF"], id="upright"),
    pytest.param(90, False, ["BDF", "ACE"], id="turned by 90"),
    pytest.param(180, False, ["FE", "DC", "BA"], id="turned by 180"),
    pytest.param(270, False, ["ECA", "FDB"], id="turned by 270"),
    pytest.param(0, True, ["BA", "DC", "FE"], id="mirrored"),
    pytest.param(90, True, ["FDB", "ECA"], id="mirrored, turned by 90"),
    pytest.param(180, True, ["EF", "CD", "AB"], id="mirrored, turned by 180"),
    pytest.param(270, True, ["ACE", "BDF"], id="mirrored, turned by 270"),
]
MOUNTINGS = st.builds(
    Mounting, rotation_deg=st.sampled_from([0, 90, 180, 270]), mirror=st.booleans()
)
SIZES = st.tuples(st.integers(2, 7), st.integers(2, 7))


def letters(rows):
    return np.array([list(row) for row in rows])


@pytest.mark.parametrize(("rotation_deg", "mirror", "stored"), STORED)
def test_a_frame_is_turned_upright(rotation_deg, mirror, stored):
    mounting = Mounting(rotation_deg=rotation_deg, mirror=mirror)
    assert mounting.upright(letters(stored)).tolist() == letters(UPRIGHT).tolist()
    assert mounting.stored(letters(UPRIGHT)).tolist() == letters(stored).tolist()
    assert mounting.upright_shape(letters(stored).shape) == (3, 2)
    assert mounting.upright_shape((*letters(stored).shape, 3)) == (3, 2, 3)


@given(MOUNTINGS, SIZES, st.sampled_from(["RGGB", "GRBG", "GBRG", "BGGR"]))
def test_the_pattern_is_that_of_the_complete_mosaic(mounting, size, cfa):
    block = np.array(list(cfa)).reshape(2, 2)
    mosaic = np.tile(block, (4, 4))[: size[0], : size[1]]
    seen = mounting.upright(mosaic)
    pattern = mounting.upright_cfa(cfa, size)
    assert pattern == "".join(seen[:2, :2].ravel())
    assert mounting.stored_cfa(pattern, seen.shape) == cfa


@given(MOUNTINGS, SIZES)
def test_colour_images_turn_like_grey_ones(mounting, size):
    grey = np.arange(size[0] * size[1]).reshape(size)
    colour = np.stack([grey, grey + 100, grey + 200], axis=2)
    assert np.array_equal(mounting.upright(colour)[..., 1], mounting.upright(grey) + 100)
    assert np.array_equal(mounting.stored(mounting.upright(colour)), colour)


@pytest.mark.parametrize(
    "values", [{"rotation_deg": 45}, {"rotation_deg": "90"}, {"mirror": 1}, {"rotate_deg": 90}]
)
def test_invalid_mountings_are_refused(values):
    with pytest.raises(ValidationError):
        Mounting.model_validate(values)


def test_a_pattern_that_is_not_square_is_refused():
    with pytest.raises(ValueError, match="RGB is not a square"):
        Mounting(rotation_deg=90).upright_cfa("RGB", (4, 4))
