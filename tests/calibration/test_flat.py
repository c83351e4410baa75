"""Flats from rendered cards, against the vignetting and the response that were simulated."""

import re
from dataclasses import replace

import numpy as np
import pytest

from acquisition import DataError, LightErrors, Lights, NoiseModel, crop
from calibration import (
    EstimateError,
    MatteSurface,
    calibrate_flat,
    calibrate_intensities,
    linear_stack,
)
from tests.calibration.card_recordings import SENSOR, card, gloss, recorded, response, rms
from tests.calibration.conftest import codes

pytestmark = pytest.mark.usefixtures("paths_exist")

WIDTH = 160


def small(leds=12, **options):
    return card(leds=leds, width=WIDTH, **options)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [101, 102])
def test_vignetting_of_30_percent_and_prnu_of_1_percent_are_found_to_a_fifth_of_a_percent(seed):
    """72 frames of 36 LEDs; positions to .6 mm, strengths and mu not known."""
    made = card(seed=seed)
    true = response(made.camera.size, seed)
    off = np.random.default_rng(seed).normal(0, 0.6, (36, 3))
    covariances = np.tile(0.36 * np.eye(3), (36, 1, 1))
    lights = Lights(
        positions_mm=made.lights.positions_mm + off, errors=LightErrors(covariances=covariances)
    )
    found = calibrate_flat(recorded(made, seed, repeats=2, sensor_seed=seed), lights)
    assert made.vignetting[0, 0] == pytest.approx(0.70, abs=0.005)
    assert rms(found.flat.smooth, made.vignetting) < 0.002
    assert rms(found.flat.pixel, true) < 0.002
    assert rms(found.flat.response, made.vignetting * true) < 0.002
    assert rms(found.flat.pixel, true) == pytest.approx(found.flat.pixel_std, rel=0.1)
    assert found.prnu == pytest.approx(0.01, rel=0.02)
    assert found.frames == 72
    assert found.flat.gradient_std < 5e-4
    assert codes(found) == ["flat-includes-card"]


@pytest.mark.parametrize("model", [True, False], ids=["sensor known", "sensor unknown"])
def test_the_predicted_noise_of_the_pixel_part_is_the_actual_one(model):
    made = small()
    found = calibrate_flat(recorded(made, 7, model=model), made.lights).flat
    assert rms(found.response, made.vignetting * response(made.camera.size, 5)) == pytest.approx(
        found.pixel_std, rel=0.06
    )
    assert rms(found.smooth, made.vignetting) < 0.001


def test_wrong_strengths_and_patterns_of_lights_do_not_reach_the_flat():
    made, random = small(), np.random.default_rng(0)
    source = recorded(made, 8)
    true = made.lights
    wrong = replace(
        true,
        intensities=np.asarray(true.intensities) * random.uniform(0.7, 1.4, (12, 1)),
        mu=np.asarray(true.mu) + random.uniform(0, 0.5, 12),
    )
    flats = [calibrate_flat(source, lights).flat.response for lights in (true, wrong)]
    assert rms(flats[1], flats[0]) < 2e-4


@pytest.mark.slow
def test_the_stated_gradient_is_that_of_wrong_positions():
    """Positions off by 2 mm; the gradient of the flat in units of its standard deviation."""
    made = small(leds=24)
    source = recorded(made, 9, sensor=replace(SENSOR, prnu=0.0))
    across = np.indices(made.camera.size)[1] / WIDTH - 0.5
    found = []
    for seed in range(8):
        off = np.random.default_rng(seed).normal(0, 2, (24, 3))
        errors = LightErrors(covariances=np.tile(4 * np.eye(3), (24, 1, 1)))
        lights = replace(made.lights, positions_mm=made.lights.positions_mm + off, errors=errors)
        flat = calibrate_flat(source, lights).flat
        ratio = flat.smooth / made.vignetting
        # From the middle to a corner is .64 of the width.
        slope = 0.64 * float(np.sum((ratio - ratio.mean()) * across) / np.sum(across**2))
        found.append(slope / flat.gradient_std)
    assert 0.4 < np.sqrt(np.mean(np.square(found))) < 1.5


def test_a_mosaic_has_a_flat_per_colour_that_keeps_the_white_balance():
    made = small(leds=16, cfa="RGGB")
    # Green is brightest, as of most sensors.
    tint = np.tile([[0.5, 1.0], [1.0, 0.7]], (made.camera.height // 2, made.camera.width // 2))
    found = calibrate_flat(recorded(made, 10, texture=tint), made.lights).flat
    assert found.cfa == "RGGB"
    true = made.vignetting * response(made.camera.size, 5)
    assert rms(found.response, true) == pytest.approx(found.pixel_std, rel=0.1)
    levels = [(found.response / true)[i // 2 :: 2, i % 2 :: 2].mean() for i in range(4)]
    assert np.ptp(levels) < 0.006


def test_two_positions_of_a_card_with_grain_and_a_stain():
    """The grain of each recording is another one, since the card was moved."""
    made = small(leds=16)
    grain = [np.random.default_rng(n).normal(1, 0.004, made.camera.size) for n in range(2)]
    grain[0][40:44, 50:54] *= 0.9
    sources = [recorded(made, 11 + n, texture=grain[n]) for n in range(2)]
    alone = calibrate_flat(sources[0], made.lights)
    both = calibrate_flat(sources, made.lights)
    true = response(made.camera.size, 5)
    assert alone.card_std is None
    assert codes(alone) == ["flat-includes-card"]
    assert codes(both) == []
    assert both.card_std == pytest.approx(0.004 / 2**0.5, rel=0.1)
    assert rms(both.flat.pixel, true) < 0.75 * rms(alone.flat.pixel, true)
    stain = slice(40, 44), slice(50, 54)
    assert abs((alone.flat.pixel / true)[stain].mean() - 0.9) < 0.01
    assert abs((both.flat.pixel / true)[stain].mean() - 1) < 0.01
    assert both.stains >= 16
    assert both.prnu == pytest.approx(0.01, rel=0.05)


def test_beyond_a_small_card_the_smooth_part_is_extrapolated():
    made = small(leds=16)
    rows, columns = made.camera.size
    area = np.full((rows, columns), 0.04)
    area[4:-12, 12:-4] = 1
    found = calibrate_flat(recorded(made, 12, texture=area), made.lights)
    assert codes(found) == ["flat-includes-card", "flat-extrapolated"]
    assert 0.7 < found.flat.covered < 0.82
    assert rms(found.flat.smooth, made.vignetting) < 0.002
    np.testing.assert_array_equal(found.flat.pixel[:, :10], 1)
    given = calibrate_flat(recorded(made, 12, texture=area), made.lights, mask=area > 0.5)
    assert given.flat.covered == pytest.approx((area > 0.5).mean())


def test_a_dead_pixel_is_listed_and_not_divided_by():
    made = small()
    area = np.ones(made.camera.size)
    area[30, 40] = 0.01
    found = calibrate_flat(recorded(made, 13, texture=area), made.lights)
    assert codes(found) == ["flat-includes-card", "flat-dead-pixels"]
    assert found.flat.pixel[30, 40] == 1


def shadow(k, light):
    shaded = light.copy()
    shaded[50:70, 90:110] *= 0.6 if k == 3 else 1.0
    return shaded


def highlight(k, light):
    rows, columns = np.indices(light.shape)
    spot = np.exp(-((rows - 40 - 3 * k) ** 2 + (columns - 30 - 8 * k) ** 2) / 200)
    return light * (1 + 0.5 * spot)


REFUSED = {
    "shadow": ({"change": shadow}, "near pixel 100,60, .* darker under light L03 .*remove it"),
    "reflection": (
        {"change": highlight, "level": 0.5},
        "brighter under light L.*use a matte, empty card",
    ),
    "clipped": ({"level": 1.3}, "% of the card are saturated under light L.*shorter exposure time"),
    "small": (
        {"texture": np.pad(np.ones((48, 60)), ((40, 40), (50, 50)), constant_values=0.05)},
        "the card covers .* of the image, at least 50% are required",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_card_that_would_spoil_the_flat_gets_one_line(name):
    options, message = REFUSED[name]
    made = small()
    with pytest.raises(EstimateError, match=f"^/nowhere: .*{message}") as caught:
        calibrate_flat(recorded(made, 14, **options), made.lights)
    assert "\n" not in str(caught.value)


def glossy(size):
    """Return a recording of a card with a coat, and its lights."""
    made = small(leds=16)
    coat = gloss(made, size)
    return recorded(made, 30, change=lambda k, light: light * (1 + coat[k])), made


def test_a_glossy_card_is_refused():
    source, made = glossy(0.1)
    message = "^/nowhere: the card is glossy: .*% brighter where it mirrors a light, .*matte card$"
    with pytest.raises(EstimateError, match=message):
        calibrate_flat(source, made.lights)


def test_a_slight_sheen_is_named():
    source, made = glossy(0.007)
    found = calibrate_flat(source, made.lights)
    (sheen,) = (notice.text for notice in found.warnings if notice.code == "flat-card-sheen")
    (size,) = (float(figure) / 100 for figure in re.findall(r"([\d.]+)%", sheen))
    assert size == pytest.approx(0.007, rel=0.3)
    assert rms(found.flat.smooth, made.vignetting) < 0.2 * size


def test_a_gradient_is_not_sure_if_errors_of_the_positions_are_not_known():
    made = small()
    assert calibrate_flat(recorded(made, 31), made.lights).flat.gradient_std is None


def test_a_small_card_counts_where_it_is():
    """Of two cards, each of which leaves another part of the image open."""
    made = small(leds=16)
    sources = []
    for n, open_part in enumerate((np.s_[:, :30], np.s_[:, -30:])):
        area = np.ones(made.camera.size)
        area[open_part] = 0.03
        sources.append(recorded(made, 32 + n, texture=area))
    found = calibrate_flat(sources, made.lights)
    assert found.flat.covered == 1
    assert rms(found.flat.smooth, made.vignetting) < 0.001
    assert found.prnu == pytest.approx(0.01, rel=0.05)


def test_a_large_card_is_averaged_before_the_fit(monkeypatch):
    """The lights are fitted to blocks of pixels, here of 3 x 3."""
    made = small()
    source = recorded(made, 34)
    whole = calibrate_flat(source, made.lights).flat
    monkeypatch.setattr("calibration.flat.card_means._SHORTER", 40)
    monkeypatch.setattr("calibration.flat.card_means._BAND", 100_000)
    blocks = calibrate_flat(source, made.lights).flat
    assert rms(blocks.response, whole.response) < 2e-4
    assert blocks.covered == 1


def test_recordings_that_cannot_be_used_are_named():
    made = small()
    source = recorded(made, 15)
    cases = [
        (replace(source, camera=None), made.lights, "the camera of these images is not calibrated"),
        (crop(source, 0, 0, 80, 80), made.lights, "in complete images, not in a region"),
        (source, made.lights.distant(), "lights with positions"),
        ([], made.lights, "no recording"),
        (source, made.lights.take(range(5)), "12 images for 5 lights|image names match"),
    ]
    for given, lights, message in cases:
        with pytest.raises(DataError, match=message):
            calibrate_flat(given, lights)


def test_intensities_of_a_card_with_vignetting_and_a_flat():
    """The flat takes the vignetting away; the intensities do not depend on it."""
    made = small(leds=16)
    flat = calibrate_flat(recorded(made, 16), made.lights).flat
    found = []
    for source in (recorded(made, 17), replace(recorded(made, 17), flat=flat)):
        values = linear_stack(source).values
        surface = MatteSurface.card(values, made.camera)
        found.append(calibrate_intensities(surface, made.lights, even=True))
    assert found[0].vignetting.corner == pytest.approx(0.70, abs=0.005)
    assert found[1].vignetting.corner == pytest.approx(1.0, abs=0.002)
    strengths = [np.asarray(one.lights.intensities) for one in found]
    assert np.abs(strengths[1] / strengths[0] - 1).max() < 5e-4


def test_the_result_does_not_depend_on_the_order_of_the_lights():
    made = small()
    source = recorded(made, 18)
    order = np.random.default_rng(1).permutation(12)
    mixed = calibrate_flat(source, made.lights.take(order))
    np.testing.assert_allclose(
        mixed.flat.response, calibrate_flat(source, made.lights).flat.response, rtol=1e-5
    )


def test_few_bits_do_not_bias_the_flat():
    """8 bits and little light: the mean of ratios would be biased by the noise."""
    made = small()
    sensor = NoiseModel(20.0, 8.0, 8.0, 8, prnu=0.0)
    source = recorded(made, 19, sensor=sensor, level=0.3, repeats=2)
    found = calibrate_flat(source, made.lights).flat
    assert rms(found.smooth, made.vignetting) < 0.003
