import numpy as np
import pytest

from calibration._spheres.ellipse import Ellipse
from calibration._spheres.highlights import find_highlights

OUTLINE = Ellipse((60.0, 50.0), (40.0, 40.0))


def spot(x, y, peak, sigma=0.8, shape=(100, 120)):
    """Return a Gaussian spot integrated over pixels by supersampling."""
    sub = (np.arange(9) + 0.5) / 9 - 0.5
    rows = (np.arange(shape[0])[:, None] + sub).ravel()
    columns = (np.arange(shape[1])[:, None] + sub).ravel()
    g = np.exp(-((rows[:, None] - y) ** 2 + (columns[None] - x) ** 2) / (2 * sigma**2))
    return peak * g.reshape(shape[0], 9, shape[1], 9).mean(axis=(1, 3))


def stack(places, peak=200.0, seed=0):
    rng = np.random.default_rng(seed)
    images = [spot(x, y, peak) + 0.2 + rng.normal(0, 0.01, (100, 120)) for x, y in places]
    return np.array(images, np.float32)


PLACES = np.array([[50.3, 44.1], [66.77, 38.42], [71.5, 57.25], [58.0, 66.9], [45.2, 55.6]])


def test_centroid_of_unsaturated_spots():
    result = find_highlights(stack(PLACES), OUTLINE)
    assert np.abs(result.pixels - PLACES).max() < 0.01
    assert not result.saturated.any()


def test_static_reflection_is_ignored():
    values = stack(PLACES) + spot(75.0, 40.0, 400.0).astype(np.float32)
    assert np.abs(find_highlights(values, OUTLINE).pixels - PLACES).max() < 0.02


def test_a_saturated_blob_is_located_at_its_centre():
    values = np.stack([spot(x, y, 50.0, sigma=2.0) for x, y in PLACES]).astype(np.float32)
    values[values >= 1] = np.nan
    result = find_highlights(values, OUTLINE)
    assert result.saturated.all()
    assert np.abs(result.pixels - PLACES).max() < 0.15


def test_a_saturated_blob_on_a_reflection_next_to_a_brighter_area():
    """A brighter area outside the outline does not affect the position of the blob."""
    values = np.stack([spot(x, y, 10.0, sigma=2.0) for x, y in PLACES]).astype(np.float32)
    y, x = np.mgrid[:100, :120]
    values[:, np.hypot(x - 60, y - 50) < 40] += 0.6
    values[0, 8:12, 18:22] = 2.0
    values[values >= 1] = np.nan
    result = find_highlights(values, OUTLINE)
    assert result.saturated.all()
    assert np.abs(result.pixels - PLACES).max() < 0.2


def test_secondary_reflection_near_the_rim_is_rejected():
    values = stack(PLACES)
    values[2] = stack([(60 + 40 * 0.93, 50.0)])[0]  # the light is hidden
    result = find_highlights(values, OUTLINE).found
    assert result.tolist() == [True, True, False, True, True]


def test_faint_secondary_inside_is_rejected_by_its_flux():
    values = stack(PLACES)
    values[1] = stack([(52.0, 60.0)], peak=2.0, seed=5)[0]
    result = find_highlights(values, OUTLINE).found
    assert result.tolist() == [True, False, True, True, True]


def test_two_equal_spots_are_ambiguous():
    values = stack(PLACES)
    values[3] += spot(70.0, 45.0, 180.0).astype(np.float32)
    result = find_highlights(values, OUTLINE).found
    assert result.tolist() == [True, True, True, False, True]


def test_a_spot_cut_off_by_the_frame_is_ignored():
    """The centre of the remaining part is wrong by up to 1.4 px, here 4 degrees of the light."""
    places = np.array([[50.3, 20.1], [66.8, 8.4], [71.5, 0.2], [58.0, -0.4], [45.2, -0.9]])
    values = np.stack([spot(x, y, 200.0, sigma=1.5) + 0.2 for x, y in places]).astype(np.float32)
    result = find_highlights(values, Ellipse((60.0, 10.0), (40.0, 40.0)))
    assert result.found.tolist() == [True, True, False, False, False]
    assert np.abs(result.pixels[:2] - places[:2]).max() < 0.01


@pytest.mark.parametrize("kind", ["dark", "noise", "wide"])
def test_no_highlight(kind):
    rng = np.random.default_rng(4)
    values = {
        "dark": np.zeros((4, 100, 120)),
        "noise": rng.normal(0.2, 0.01, (4, 100, 120)),
        "wide": np.stack([spot(x, y, 1.0, sigma=15.0) for x, y in PLACES[:4]]),
    }[kind]
    assert not find_highlights(values.astype(np.float32), OUTLINE).found.any()
