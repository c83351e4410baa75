"""Predicted and actual noise of stacks: simulated series of frames with many seeds."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from acquisition import LINEAR, SRGB, DataError, NoiseModel, crop, downscale
from calibration import StackNoise, linear_stack
from calibration.radiance.brackets import clear_of_white, grown
from tests.calibration.noisy_recordings import SENSOR, THREE, frame, recording, source
from tests.quick_sample import quick

pytestmark = pytest.mark.usefixtures("paths_exist")

SMALL_WELL = NoiseModel(0.5, 3.0, 64.0, 12)
WARM = NoiseModel(2.5, 2.5, 64.0, 12, dark_current_e_per_s=5000.0)

CASES = {
    "one exposure": (SENSOR, {}),
    "four repeats": (SENSOR, {"repeats": 4}),
    "three brackets": (SENSOR, {"shares": THREE}),
    "three brackets, small well": (SMALL_WELL, {"shares": THREE}),
    "two brackets of two, dark current": (WARM, {"shares": (1.0, 1 / 32), "repeats": 2}),
    "light of the room": (SENSOR, {"shares": (1.0, 1 / 4), "ambient": 0.05}),
    "sensor estimated from repeats": (SENSOR, {"repeats": 2, "model": False}),
}


@pytest.mark.parametrize("name", CASES)
def test_the_predicted_noise_is_the_actual_one_in_every_decile(name):
    """Ten deciles of a ramp up to nearly white in the shortest bracket."""
    sensor, options = CASES[name]
    top = (0.85 - options.get("ambient", 0.0)) / min(options.get("shares", (1.0,)))
    radiance = np.tile(np.geomspace(0.005, top, 160), (64, 1))
    stacks = [linear_stack(recording(sensor, radiance, seed=seed, **options)) for seed in range(16)]
    values = np.stack([stack.values[0] for stack in stacks]).astype(float)
    assert np.isfinite(values).all()
    actual = values.var(axis=0, ddof=1)
    predicted = np.mean([stack.noise.variance(0, radiance) for stack in stacks], axis=0)
    deciles = [slice(start, start + 16) for start in range(0, 160, 16)]
    ratio = [(predicted[:, s].mean() / actual[:, s].mean()) ** 0.5 for s in deciles]
    assert min(ratio) > 0.95
    assert max(ratio) < 1.05
    bias = [(values[..., s] - radiance[:, s]).mean() for s in deciles]
    scatter = [(actual[:, s].mean() / values[..., s].size) ** 0.5 for s in deciles]
    # A dark frame is common to the pixels of one stack only, so its noise averages out.
    assert np.all(np.abs(bias) < 5 * np.array(scatter) + 3e-5)


UNSTATED = {
    "one exposure": (SENSOR, {}),
    "two brackets of two, dark current": (WARM, {"shares": (1.0, 1 / 32), "repeats": 2}),
    "one exposure, from repeats": (SENSOR, {"repeats": 2, "model": False}),
    "light of the room, from repeats": (
        SENSOR,
        {"repeats": 2, "model": False, "shares": (1.0, 1 / 4), "ambient": 0.05},
    ),
}


@pytest.mark.parametrize("name", UNSTATED)
def test_a_black_level_that_is_not_stated_is_not_shot_noise(name):
    """Dark frames show the offset of the samples, which has no noise."""
    sensor, options = UNSTATED[name]
    top = (0.85 - options.get("ambient", 0.0)) / min(options.get("shares", (1.0,)))
    radiance = np.tile(np.geomspace(0.005, top, 80), (64, 1))
    stacks = []
    for seed in range(16):
        made = recording(sensor, radiance, seed=seed, **options)
        noise = None if made.noise is None else replace(made.noise, black_level_dn=0.0)
        stacks.append(linear_stack(replace(made, noise=noise, black_level=0.0)))
    values = np.stack([stack.values[0] for stack in stacks]).astype(float)
    actual = values.var(axis=0, ddof=1)
    signal = values.mean(axis=0)
    predicted = np.mean([stack.noise.variance(0, signal) for stack in stacks], axis=0)
    parts = [slice(start, start + 16) for start in range(0, 80, 16)]
    ratio = [(predicted[:, s].mean() / actual[:, s].mean()) ** 0.5 for s in parts]
    assert min(ratio) > 0.95
    assert max(ratio) < 1.05


@pytest.mark.parametrize(
    "sensor", quick([SENSOR, SMALL_WELL], every=2), ids=["12,000 e", "2,000 e"]
)
def test_the_mean_near_white_of_a_longer_bracket_is_right(sensor):
    """Even patches around the white level of the longest bracket, where samples are clipped."""
    sigma = 1 / ((sensor.white_level_dn - 64) * sensor.electrons_per_dn) ** 0.5
    for at in (-6, -5, -4, -3, -2, -1, 0, 1, 2):
        radiance = np.full((96, 96), 1 + at * sigma)
        values = [
            linear_stack(recording(sensor, radiance, THREE, seed=seed)).values for seed in range(8)
        ]
        assert np.isfinite(values).all()
        assert np.mean(values) / radiance[0, 0] == pytest.approx(1, abs=1e-3)


def test_no_clipped_sample_survives():
    radiance = np.random.default_rng(3).gamma(1.0, 8.0, (60, 80))
    made = recording(SMALL_WELL, radiance, THREE, repeats=2)
    stack = linear_stack(made)
    for b in range(3):
        frames = [one for one in made.frames if one.role == "light" and one.bracket == b]
        clipped = np.any([one.read() >= SMALL_WELL.white_level_dn for one in frames], axis=0)
        counts = stack.noise.used[0] & (1 << b) > 0
        assert clipped.any()
        assert not (clipped & counts).any()
    np.testing.assert_array_equal(np.isnan(stack.values[0]), stack.noise.used[0] == 0)


def test_samples_next_to_saturated_ones_are_from_a_shorter_bracket():
    radiance = np.full((15, 15), 0.4)
    radiance[7, 7] = 3.0
    used = linear_stack(recording(SENSOR, radiance, (1.0, 1 / 4))).noise.used[0]
    expected = np.full((15, 15), 3)
    expected[5:10, 5:10] = 2
    np.testing.assert_array_equal(used, expected)


def test_brackets_of_an_unknown_sensor_are_weighted_by_their_times():
    radiance = np.full((40, 40), 0.5)
    made = recording(SENSOR, radiance, (1.0, 1 / 4), model=False, dark=False)
    stack = linear_stack(made)
    long, short = ((one.read().astype(float) - 64) / (4095 - 64) for one in made.frames)
    assert stack.noise is None
    assert stack.values[0] == pytest.approx((long + short) / 1.25, abs=1e-6)


@pytest.mark.parametrize(("factor", "codes"), [(1.0, []), (0.95, ["brackets-contradict"])])
def test_brackets_that_contradict_their_exposures_are_reported(factor, codes):
    made = recording(SENSOR, np.full((40, 40), 0.5), (1.0, 1 / 4))
    frames = [
        replace(one, exposure_us=one.exposure_us * (1 / factor if one.bracket else 1))
        for one in made.frames
    ]
    warnings = linear_stack(replace(made, frames=tuple(frames))).warnings
    assert [notice.code for notice in warnings] == codes
    if codes:
        assert str(warnings[0]).startswith("images of 5263.16 us are 0.95 times as bright as those")


def test_hot_pixels_are_replaced_by_a_shorter_exposure():
    dark = np.full((30, 30), 64, np.uint16)
    hot = dark.copy()
    hot[4, 5] = 64 + 400
    lit = np.full((30, 30), 1064, np.uint16)
    short = np.full((30, 30), 314, np.uint16)
    frames = [
        frame(lit + hot - dark),
        frame(hot, "dark"),
        frame(short, exposure_us=5000.0, bracket=1),
        frame(dark, "dark", 5000.0, bracket=1),
    ]
    stack = linear_stack(source(frames, noise=SENSOR))
    used = np.full((30, 30), 3)
    used[4, 5] = 2
    np.testing.assert_array_equal(stack.noise.used[0], used)
    assert [notice.code for notice in stack.warnings] == ["hot-pixels"]
    assert stack.hot_pixels.tolist() == [[4, 5]]
    alone = linear_stack(source(frames[:2], noise=SENSOR))
    np.testing.assert_allclose(alone.values[0], 1000 / 4031, rtol=1e-6)
    assert alone.hot_pixels.tolist() == [[4, 5]]


def test_a_saturated_hot_pixel_does_not_disturb_its_neighbours():
    dark = np.full((20, 20), 64, np.uint16)
    dark[9, 9] = 4095
    lit = np.full((20, 20), 1064, np.uint16)
    lit[9, 9] = 4095
    short = np.full((20, 20), 314, np.uint16)
    frames = [frame(lit), frame(dark, "dark"), frame(short, exposure_us=5000.0, bracket=1)]
    used = np.full((20, 20), 3)
    used[9, 9] = 2
    np.testing.assert_array_equal(linear_stack(source(frames, noise=SENSOR)).noise.used[0], used)


def test_a_bracket_for_mirrored_lamps_replaces_only_what_is_saturated():
    """Of 1/500 of the time: next to the lamp, its noise would be that of a few electrons."""
    radiance = np.full((15, 15), 0.4)
    radiance[7, 7] = 300.0
    used = linear_stack(recording(SENSOR, radiance, (1.0, 1 / 500))).noise.used[0]
    expected = np.full((15, 15), 3)
    expected[7, 7] = 2
    np.testing.assert_array_equal(used, expected)


def test_a_sensor_with_offsets_has_no_hot_pixels():
    """Offsets of 5 electrons per pixel and a glow of the amplifier in a corner."""
    sensor = replace(SENSOR, dsnu_e=5.0)
    glow = 0.1 * np.exp(-np.hypot(*np.indices((80, 80))) / 30)
    dark = np.random.default_rng(1).normal(64, 2, (80, 80)) + glow * 4031
    frames = [frame(np.full((80, 80), 2000, np.uint16)), frame(dark.astype(np.uint16), "dark")]
    stack = linear_stack(source(frames, sensor))
    assert stack.warnings == ()
    assert stack.hot_pixels.shape == (0, 2)


def test_nothing_is_assumed_about_an_unknown_sensor():
    flat = np.full((40, 40), 0.5)
    assert linear_stack(recording(SENSOR, flat, model=False)).noise is None
    # Repeats of an even card do not separate shot noise from read noise.
    assert linear_stack(recording(SENSOR, flat, repeats=2, model=False)).noise is None
    ramp = np.tile(np.linspace(0.01, 0.9, 60), (60, 1))
    curved = replace(recording(SENSOR, ramp), transfer=SRGB)
    assert linear_stack(curved).noise is None
    assert linear_stack(replace(curved, transfer=LINEAR)).noise is not None


def test_brackets_without_exposure_times_are_refused():
    frames = [
        replace(one, exposure_us=None)
        for one in recording(SENSOR, np.full((9, 9), 0.5), THREE).frames
    ]
    with pytest.raises(
        DataError, match="brackets can be merged only if the exposure times are known"
    ):
        linear_stack(source(frames))


@pytest.mark.parametrize("channel", ["gray", "rgb"])
@pytest.mark.parametrize(("factor", "at"), [(1, (0, 0)), (1, (1, 2)), (2, (1, 0)), (3, (0, 1))])
def test_a_mosaic_of_a_neutral_surface(channel, factor, at):
    side = 36 * factor
    radiance = np.full((side + 4, side + 4), 0.4)
    stacks = []
    for seed in range(24):
        made = recording(SENSOR, radiance, seed=seed, cfa="RGGB", dark=False)
        made = downscale(crop(made, at[1], at[0], side, side), factor)
        stacks.append(linear_stack(made, channel=channel))
    values = np.stack([stack.values[0] for stack in stacks]).astype(float)[:, 3:-3, 3:-3]
    predicted = stacks[0].noise.variance(0, np.full(stacks[0].values[0].shape, 0.4))[3:-3, 3:-3]
    actual = values.var(axis=0, ddof=1)
    for row in range(2):
        for column in range(2):
            ratio = predicted[row::2, column::2].mean(axis=(0, 1)) / actual[row::2, column::2].mean(
                axis=(0, 1)
            )
            assert np.all(np.abs(ratio**0.5 - 1) < 0.05)


def test_rows_of_an_image_have_the_variance_of_the_whole():
    radiance = np.random.default_rng(3).gamma(1.0, 0.6, (40, 60))
    stack = linear_stack(recording(SENSOR, radiance, THREE))
    whole = stack.noise.variance(0, stack.values[0])
    rows = stack.noise.variance(0, stack.values[0][13:20], first_row=13)
    np.testing.assert_array_equal(rows, whole[13:20])
    again = pickle.loads(pickle.dumps(stack.take([0])))
    np.testing.assert_array_equal(again.noise.variance(0, stack.values[0]), whole)


def test_gain_multiplies_electrons_into_more_grey_values():
    assert SENSOR.at_gain(20).electrons_per_dn == pytest.approx(0.25)
    assert SENSOR.at_gain(0) is SENSOR


def test_how_far_white_is():
    assert clear_of_white(None) == 0.95
    near = np.zeros((7, 7), bool)
    assert grown(near) is near
    near[3, 3] = True
    assert grown(near).sum() == 25


def test_the_law_of_one_exposure():
    noise = StackNoise.of_one_exposure(1e-4, 1e-6, 2)
    assert noise.variance(1, [[0.5, -0.1, np.nan]])[0] == pytest.approx(
        [5.1e-5, 1e-6, np.nan], nan_ok=True
    )
