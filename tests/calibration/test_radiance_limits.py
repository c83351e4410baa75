"""Limits of the decisions about a sample, an exposure time and a stack."""

from dataclasses import replace

import numpy as np
import pytest

from acquisition import SRGB, DataError, Lights
from calibration import EstimateError, linear_stack
from tests.calibration.test_radiance import BLACK, WHITE, frame, source

pytestmark = pytest.mark.usefixtures("paths_exist")


def even(value, dtype=np.uint16, size=(2, 2)):
    return np.full(size, value, dtype)


@pytest.mark.parametrize(
    ("value", "known"), [(4094, True), (4095, False), (4200, False)], ids=["below", "white", "over"]
)
def test_a_sample_at_the_white_level_is_saturated(value, known):
    frames = [frame("a", even(value)), frame("b", even(1000))]
    assert np.isfinite(linear_stack(source(frames)).values[0]).all() == known


@pytest.mark.parametrize(
    ("dark_us", "used"),
    [
        pytest.param(1000.9, True, id="slightly longer"),
        pytest.param(999.1, True, id="slightly shorter"),
        pytest.param(1001.1, False, id="longer"),
        pytest.param(998.9, False, id="shorter"),
    ],
)
def test_a_dark_frame_is_used_within_a_thousandth_of_the_exposure(dark_us, used):
    frames = [
        frame("L00", even(1000), exposure_us=1000.0),
        frame("D", even(500), "dark", dark_us),
    ]
    expected = (1000 - (500 if used else BLACK)) / (WHITE - BLACK)
    stack = linear_stack(source(frames))
    assert stack.values == pytest.approx(expected, rel=1e-6)
    assert (stack.warnings == ()) == used
    if not used:
        assert "no dark or ambient frame with an exposure of 1000 us" in str(stack.warnings[0])


def test_every_exposure_without_a_dark_frame_is_reported_once():
    frames = [
        *(frame(f"a{k}", even(900), exposure_us=100.0, light_id="L00") for k in range(3)),
        *(frame(f"b{k}", even(900), exposure_us=400.0, light_id="L01") for k in range(2)),
        frame("c", even(900), exposure_us=200.0, light_id="L02"),
        frame("D", even(70), "dark", 200.0),
    ]
    warnings = linear_stack(source(frames)).warnings
    assert [notice.text.partition(":")[0] for notice in warnings] == [
        "no dark or ambient frame with an exposure of 100 us",
        "no dark or ambient frame with an exposure of 400 us",
    ]


def test_each_exposure_has_its_own_dark_frame():
    frames = [
        frame("a", even(1000), exposure_us=100.0, light_id="L00"),
        frame("b", even(1000), exposure_us=400.0, light_id="L01"),
        frame("D1", even(100), "dark", 100.0),
        frame("D4", even(400), "dark", 400.0),
        frame("A4", even(300), "ambient", 400.0),
    ]
    values = linear_stack(source(frames)).values[:, 0, 0]
    np.testing.assert_allclose(
        values, np.array([4 * (1000 - 100), 1000 - 300]) / (WHITE - BLACK), rtol=1e-6
    )


def test_the_longest_exposure_of_all_frames_is_the_unit():
    """Dark frames do not count; of the three lights the second has the longest exposure."""
    exposures = (100.0, 800.0, 400.0)
    frames = [frame(f"L{i:02d}", even(1000), exposure_us=t) for i, t in enumerate(exposures)]
    values = linear_stack(source(frames)).values[:, 0, 0]
    np.testing.assert_allclose(
        values, (1000 - BLACK) / (WHITE - BLACK) * 800 / np.array(exposures), rtol=1e-6
    )


def test_of_three_brackets_those_clear_of_white_count():
    """Five pixels apart, samples do not disturb each other; their weights are the times."""
    times = {
        4000.0: [4095, 4095, 4095, 2000],
        400.0: [4095, 4095, 1800, 1800],
        40.0: [4095, 1600, 1600, 1600],
    }
    frames = [
        frame(f"b{b}", _apart(grey), exposure_us=time, bracket=b, light_id="L00")
        for b, (time, grey) in enumerate(times.items())
    ]
    for order in (frames, frames[::-1]):
        values = linear_stack(source(order)).values[0, 2, 2::5] * (WHITE - BLACK)
        assert np.isnan(values[0])
        short, middle, long = 1600 - BLACK, 1800 - BLACK, 2000 - BLACK
        expected = [100 * short, 100 * (short + middle) / 11, 100 * (short + middle + long) / 111]
        np.testing.assert_allclose(values[1:], expected, rtol=1e-6)


def _apart(grey):
    """Return an image with these samples in row 2, each surrounded by dark ones."""
    image = np.full((5, 5 * len(grey)), 100, np.uint16)
    image[2, 2::5] = grey
    return image


def test_rgb_frames_and_mosaics_are_divided_channel_by_channel():
    lights = Lights(directions=[[0, 0, 1]], intensities=[[1.0, 2.0, 4.0]], ids=("a",))
    one = source([frame("a", even(0.4, np.float32, (4, 4)))], lights, 0.0, 1.0, cfa="RGGB")
    values = linear_stack(one, channel="rgb").values[0]
    np.testing.assert_allclose(values, np.broadcast_to([0.4, 0.2, 0.1], (4, 4, 3)), rtol=1e-6)


@pytest.mark.parametrize(
    ("values", "levels", "black"),
    [
        # Rounding can leave two grey values above the black level.
        pytest.param([66, 64], (64.0, 4095.0), True, id="two grey values"),
        pytest.param([67, 64], (64.0, 4095.0), False, id="three grey values"),
        pytest.param([2, 0], (0.0, 100.0), True, id="two of a hundred"),
        pytest.param([1, 0], (0.0, 99.0), False, id="too few grey values for the limit"),
        pytest.param([0, 0], (0.0, 99.0), True, id="zero"),
    ],
)
def test_the_limit_of_black_images(values, levels, black):
    one = source([frame("a", np.array([values], np.uint16))], None, *levels)
    if not black:
        linear_stack(one)
        return
    with pytest.raises(EstimateError, match="the image is black"):
        linear_stack(one)


def test_the_limit_of_black_images_follows_the_curve():
    """Ten grey values of 255 are light, but only .003 of white in sRGB."""
    one = source([frame("a", np.array([[10, 0]], np.uint8))], None, 0.0, 255.0, transfer=SRGB)
    assert linear_stack(one).values[0, 0, 0] == pytest.approx(0.003035, rel=1e-3)


@pytest.mark.parametrize(
    ("black", "white", "right"),
    [(0.0, 4095.0, True), (-1.0, 4095.0, False), (4095.0, 4095.0, False), (4094.0, 4095.0, True)],
)
def test_the_white_level_must_be_above_the_black_level(black, white, right):
    one = source([frame("a", np.array([[4094, 200]], np.uint16))], None, black, white)
    if right and black < 4000:
        linear_stack(one)
        return
    with pytest.raises(EstimateError if right else DataError):
        linear_stack(one)


def test_a_curve_maps_negative_samples_to_zero():
    """Noise below the black level gives 0 and not NaN if a curve is applied."""
    image = np.array([[60.0, 1000.0]], np.float32)
    one = source([frame("a", image)])
    assert linear_stack(replace(one, transfer=SRGB)).values[0, 0, 0] == 0
    assert linear_stack(one).values[0, 0, 0] == pytest.approx((60 - BLACK) / (WHITE - BLACK))


@pytest.mark.parametrize("wrong", [None, 0.0, -5.0])
def test_an_image_without_exposure_time_among_others_is_named(wrong):
    frames = [frame("a", even(99), exposure_us=10.0), frame("b", even(99), exposure_us=wrong)]
    with pytest.raises(DataError, match=r"b\.tif: no valid exposure time"):
        linear_stack(source(frames))


def test_without_a_light_there_is_no_stack():
    with pytest.raises(DataError, match="no image with a light"):
        linear_stack(source([frame("D", even(70), "dark", 10.0)]))


def test_without_any_dark_frames_there_is_no_warning():
    frames = [frame("a", even(1000), exposure_us=100.0), frame("b", even(900), exposure_us=200.0)]
    assert linear_stack(source(frames)).warnings == ()
