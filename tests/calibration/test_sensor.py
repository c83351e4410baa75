"""Calibration of sensors: the simulator's sensor, the reference package, and input that fails."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

import calibration.sensor.series_points as series_points_module
from acquisition import SRGB, DataError, NoiseModel, Setup
from calibration import EstimateError, calibrate_sensor
from tests.calibration.emva_peer import reference_figures
from tests.calibration.sensor_series import LONGEST_US, card, frame, source

PLAIN = NoiseModel(
    2.5, 3.0, 64.0, 12, prnu=0.01, dsnu_e=2.0, dark_current_e_per_s=100.0, full_well_e=9000.0
)
CASES = {
    "the corners get 40 % less light": (PLAIN, {"fall": 0.4}),
    "colour mosaic": (PLAIN, {"filters": (0.5, 1.0, 1.0, 0.4), "levels": 30, "top": 2.0}),
    "a lamp that flickers by 1 %": (PLAIN, {"flicker": 0.01}),
    "12 bit": (PLAIN, {}),
    "the converter ends first": (replace(PLAIN, full_well_e=None), {"fall": 0.2}),
    "hot pixels": (
        replace(PLAIN, hot_pixel_fraction=0.003, hot_pixel_e_per_s=30_000.0),
        {"fall": 0.2},
    ),
    "four repeats": (replace(PLAIN, electrons_per_dn=0.8, full_well_e=2500.0), {"repeats": 4}),
    "10 bit": (NoiseModel(12.0, 20.0, 20.0, 10, prnu=0.008, dsnu_e=15.0), {"fall": 0.3}),
}
# Relative errors that are allowed.
BARS = {
    "electrons_per_dn": 0.01,
    "read_noise_e": 0.02,
    "full_well_e": 0.02,
    "prnu": 0.05,
    "dsnu_e": 0.02,
}


def measured(sensor, seed, **options):
    recording = card(sensor, seed, **options)
    if "filters" in options:
        recording = replace(recording, cfa="RGGB")
    return calibrate_sensor([recording])


def truth(sensor, name):
    if name == "full_well_e" and sensor.full_well_e is None:
        return (sensor.converter_end_dn - sensor.black_level_dn) * sensor.electrons_per_dn
    return getattr(sensor, name)


# The first three show most; the others take time.
@pytest.mark.parametrize(
    "name",
    [name if k < 3 else pytest.param(name, marks=pytest.mark.slow) for k, name in enumerate(CASES)],
)
def test_the_figures_of_simulated_sensors_are_found(name):
    sensor, options = CASES[name]
    estimate = measured(sensor, 401, **options)
    found = estimate.sensor
    for figure, bar in BARS.items():
        value, true = getattr(found, figure).value, truth(sensor, figure)
        assert abs(value / true - 1) < bar, (figure, value, true)
    assert found.linearity_error.value < (0.008 if "flicker" in options else 0.001)
    assert abs(found.black_level_dn.value - sensor.black_level_dn) < 0.05
    current = found.dark_current_e_per_s
    assert abs(current.value - sensor.dark_current_e_per_s) < 6 * current.sigma
    assert found.full_well_limit == ("pixel" if sensor.full_well_e else "converter")
    assert found.saturation_capacity_e.value < found.full_well_e.value
    codes = [notice.code for notice in estimate.warnings]
    assert codes == (["lamp-flickers"] if "flicker" in options else [])


def test_hot_pixels_are_counted():
    found = measured(CASES["hot pixels"][0], 402).sensor
    # Those with little dark current are not hot.
    assert 0.002 < found.hot_pixel_fraction < 0.0031
    assert found.hot_pixel_e_per_s == pytest.approx(30_000, rel=0.2)


@pytest.mark.slow
@pytest.mark.parametrize("fall", [0.0, 0.4])
def test_standard_deviations_are_those_of_many_recordings(fall):
    seeds = range(500, 540)
    found = [measured(PLAIN, seed, fall=fall, size=(128, 160)).sensor for seed in seeds]
    for name in (*BARS, "dark_current_e_per_s"):
        true = truth(PLAIN, name)
        deviations = [(getattr(one, name).value - true) / getattr(one, name).sigma for one in found]
        assert 0.65 < np.mean(np.square(deviations)) ** 0.5 < 1.4, name


def with_stack(sensor, seed):
    """Return a series with pairs of frames, and 16 frames at about half of saturation."""
    pairs = card(sensor, seed, top=1.05, darks=2)
    half = {"levels": 1, "top": 0.505, "longest_us": LONGEST_US * 0.505 / 1.05}
    stack = card(sensor, seed, repeats=16, darks=16, **half)
    frames = [replace(one, bracket=99) for one in stack.frames]
    return source([*pairs.frames, *frames], sensor)


@pytest.mark.slow
def test_the_reference_package_finds_the_same_on_the_same_images(tmp_path):
    recording = with_stack(replace(PLAIN, dark_current_e_per_s=2000.0), 403)
    estimate, reference = calibrate_sensor([recording]), reference_figures(tmp_path, 12, recording)
    found = estimate.sensor
    ours = {
        "K": 1 / found.electrons_per_dn.value,
        "sigma_y_dark": estimate.dark_variance_dn2**0.5,
        "sigma_d": found.read_noise_e.value,
        "u_e_sat": found.saturation_capacity_e.value,
        "SNR_max": found.snr_max.value,
        "DR": found.dynamic_range.value,
        "u_I_mean": found.dark_current_e_per_s.value,
        "DSNU1288": found.dsnu_e.value,
        "PRNU1288": 100 * found.prnu.value,
    }
    for name, value in ours.items():
        assert value == pytest.approx(reference[name], rel=0.01), name
    extremes = 100 * estimate.line_deviation.min(), 100 * estimate.line_deviation.max()
    assert extremes == pytest.approx((reference["LE_min"], reference["LE_max"]), abs=0.02)


def test_a_bent_response_is_the_linearity_error():
    """A response s - c s^2 deviates from its straight line by amounts known in closed form."""
    bend = 0.04
    sensor = replace(PLAIN, full_well_e=None, prnu=0.0, dsnu_e=0.0)
    estimate = measured(sensor, 405, levels=40, top=1.3, respond=lambda x: x - bend * x**2)
    # The same fit to noise-free signals.
    top = estimate.sensor.saturation_capacity_e.value / truth(sensor, "full_well_e")
    light = 1.3 * np.arange(1, 41) / 40
    signal = light - bend * light**2
    use = (signal > 0.05 * top) & (signal < 0.95 * top)
    light, signal = light[use], signal[use]
    design = np.stack([np.ones_like(light), light], axis=1)
    line, *_ = np.linalg.lstsq(design / signal[:, None], np.ones_like(light), rcond=None)
    expected = np.mean(np.abs(signal / (design @ line) - 1))
    assert estimate.sensor.linearity_error.value == pytest.approx(expected, abs=0.0005)


def test_a_gamma_is_reported():
    estimate = measured(PLAIN, 406, respond=lambda x: np.minimum(x, 1) ** 0.6)
    assert "sensor-not-linear" in [notice.code for notice in estimate.warnings]


def test_without_saturation_its_figures_are_unknown():
    estimate = measured(PLAIN, 407, top=0.6)
    found = estimate.sensor
    assert found.full_well_e is found.saturation_capacity_e is found.snr_max is None
    assert found.electrons_per_dn.value == pytest.approx(2.5, rel=0.01)
    assert [notice.code for notice in estimate.warnings] == ["saturation-not-reached"]
    assert found.noise_model().full_well_e is None


def one_dark_time(recording):
    lights = [one for one in recording.frames if one.role == "light"]
    darks = [one for one in recording.frames if one.role == "dark"]
    return replace(recording, frames=(*lights, *(replace(d, exposure_us=9000.0) for d in darks)))


def test_dark_frames_of_one_exposure_time_leave_the_dark_current_unknown():
    sensor = replace(PLAIN, dark_current_e_per_s=0.0)
    estimate = calibrate_sensor([one_dark_time(card(sensor, 408))])
    assert estimate.sensor.dark_current_e_per_s is None
    assert estimate.sensor.read_noise_e.value == pytest.approx(3.0, rel=0.02)
    assert [notice.code for notice in estimate.warnings] == ["dark-current-unknown"]


def test_two_recordings_are_used_together():
    one, other = (card(PLAIN, 409, size=(128, 160), fall=fall) for fall in (0.1, 0.3))
    alone, both = calibrate_sensor([one]).sensor, calibrate_sensor([one, other]).sensor
    assert both.electrons_per_dn.sigma < 0.85 * alone.electrons_per_dn.sigma
    assert both.electrons_per_dn.value == pytest.approx(2.5, rel=0.01)


@pytest.mark.parametrize("cfa", [None, "RGGB"])
def test_the_pattern_of_large_frames_is_taken_from_bands_of_rows(monkeypatch, cfa):
    recording = replace(small(levels=12), cfa=cfa)
    whole = calibrate_sensor([recording]).sensor.prnu
    monkeypatch.setattr(series_points_module, "_PATTERN_ROWS", 14)
    assert calibrate_sensor([recording]).sensor.prnu.value == pytest.approx(whole.value, rel=1e-6)


def test_frames_of_many_rows_are_sampled_by_rows():
    sensor = replace(PLAIN, dark_current_e_per_s=1000.0)
    found = calibrate_sensor([card(sensor, 413, size=(1100, 64), levels=14)]).sensor
    for figure, bar in BARS.items():
        assert getattr(found, figure).value == pytest.approx(truth(sensor, figure), rel=2 * bar)


def small(**options):
    return card(PLAIN, 410, size=(64, 80), **({"levels": 8} | options))


def with_gain(recording, gain_db, role="light"):
    frames = [replace(f, gain_db=gain_db) if f.role == role else f for f in recording.frames]
    return replace(recording, frames=tuple(frames))


def without(recording, role):
    return replace(recording, frames=tuple(f for f in recording.frames if f.role != role))


def swapped(recording):
    roles = {"light": "dark", "dark": "light"}
    frames = [replace(f, role=roles[f.role]) for f in recording.frames]
    # One dark frame of each exposure has no repeat.
    return replace(recording, frames=(*frames, *(f for f in frames if f.role == "light")))


def of_camera(recording, serial):
    return replace(recording, setup=Setup(camera_serial=serial))


def in_colour(recording):
    frames = [frame(np.stack([f.read()] * 3, 2), f.role, 1e3, 0) for f in recording.frames]
    return replace(recording, frames=tuple(frames))


def smoothed(recording):
    """Return frames as of a camera that removes noise; before, the gain was 8 times too large."""

    def blurred(one):
        pixels = cv2.GaussianBlur(one.read(), (0, 0), 0.5)
        return replace(one, load=lambda: pixels)

    return replace(recording, frames=tuple(map(blurred, recording.frames)))


def copied(recording):
    """Return repeats that are copies of the first frame, as of a folder that was copied."""
    first = {(f.role, f.bracket): f for f in reversed(recording.frames)}
    return replace(recording, frames=tuple(first[f.role, f.bracket] for f in recording.frames))


BAD = {
    "nothing": (list, EstimateError, "no recording"),
    "four exposures": (lambda: [small(levels=4)], EstimateError, "4 exposures, at least 5"),
    "single frames": (lambda: [small(repeats=1)], EstimateError, "a single frame per exposure"),
    "no dark frames": (lambda: [without(small(), "dark")], EstimateError, "0 dark frames"),
    "no light": (lambda: [without(small(), "light")], EstimateError, "no frames with light"),
    "swapped": (lambda: [swapped(small())], DataError, "dark frames are brighter"),
    "all saturated": (
        lambda: [replace(r := small(top=40.0, levels=40), frames=r.frames[3 * 8 :])],
        EstimateError,
        "record shorter exposure times",
    ),
    "mixed gains": (lambda: [with_gain(small(), 6.0)], DataError, "gains of 0 and 6 dB"),
    "two cameras": (
        lambda: [of_camera(small(), "A"), of_camera(small(), "B")],
        DataError,
        "serial number B",
    ),
    "two sizes": (lambda: [small(), card(PLAIN, 1, levels=1)], DataError, "size"),
    "sRGB": (lambda: [replace(small(), transfer=SRGB)], DataError, "transfer curve"),
    "three channels": (lambda: [in_colour(small())], DataError, "three channels"),
    "float": (lambda: [replace(small(), white_level=np.inf)], DataError, "float images"),
    "no exposure time": (
        lambda: [
            replace(r := small(), frames=tuple(replace(f, exposure_us=None) for f in r.frames))
        ],
        DataError,
        "exposure time is not known",
    ),
    "flicker": (lambda: [small(flicker=0.3)], EstimateError, "does not flicker"),
    "black level 0": (
        lambda: [card(replace(PLAIN, black_level_dn=0.0), 411, size=(64, 80), levels=8)],
        EstimateError,
        "raise the black level",
    ),
    "smoothed": (lambda: [smoothed(small(levels=16))], EstimateError, "smoothed or scaled"),
    "copies": (lambda: [copied(small(levels=16))], EstimateError, "does not grow with the light"),
    "tiny": (lambda: [card(PLAIN, 412, size=(40, 80), levels=8)], EstimateError, "too small"),
}


@pytest.mark.parametrize("name", BAD)
def test_recordings_that_do_not_show_the_sensor_are_refused_in_one_line(name):
    make, error, text = BAD[name]
    with pytest.raises(error, match=text) as caught:
        calibrate_sensor(make())
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 220
