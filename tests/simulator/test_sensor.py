"""The sensor, compared with closed forms of its noise."""

import time

import numba
import numpy as np
import pytest

from acquisition import NoiseModel
from simulator.camera import fixed_pattern, sensor_image
from simulator.camera.sensor import EXACT_BELOW_E
from tests.quick_sample import quick

SHAPE = (1000, 1000)


def flat(mean, shape=SHAPE):
    return np.full(shape, mean, np.float32)


@pytest.mark.parametrize(
    ("electrons", "gain_db", "grey"),
    [
        pytest.param(0, 0, 64, id="dark"),
        pytest.param(1000, 0, 464, id="linear"),
        pytest.param(1000, 6.0205999, 864, id="6 dB doubles only the signal"),
        pytest.param(1001.2, 0, 464, id="rounds down"),
        pytest.param(1001.3, 0, 465, id="rounds up"),
        pytest.param(10_077.4, 0, 4095, id="just white"),
        pytest.param(1e9, 0, 4095, id="saturated"),
    ],
)
def test_without_noise_the_grey_value_is_the_rounded_linear_value(electrons, gain_db, grey):
    noise = NoiseModel(2.5, 3.0, 64.0, 12)
    image = sensor_image(flat(electrons, (2, 3)), noise, gain_db=gain_db, key=None)
    assert image.dtype == np.uint16
    assert (image == grey).all()


@pytest.mark.parametrize("mean", [0.0, 0.3, 2.0, 11.9, 12.0, 40.0, 1000.0, 15_000.0])
@pytest.mark.parametrize("read_noise_e", [0.0, 4.0])
def test_mean_and_variance_are_those_of_the_noise_model(mean, read_noise_e):
    noise = NoiseModel(0.5, read_noise_e, 500.0, 16)
    grey = sensor_image(flat(mean), noise, key=(1, 7)).astype(np.float64)
    variance = (mean + read_noise_e**2) / 0.25
    if read_noise_e or mean >= EXACT_BELOW_E:
        # Quantisation adds its variance if the value is not an integer.
        variance = float(noise.variance_dn(500.0 + 2 * mean))
    count = grey.size
    assert grey.mean() - 500 == pytest.approx(2 * mean, abs=5 * np.sqrt((variance + 1) / count))
    kurtosis = 3 + 1 / max(mean, 0.1)
    tolerance = 5 * np.sqrt((kurtosis - 1) / count)
    assert grey.var() == pytest.approx(variance, rel=tolerance + 2e-3, abs=1e-9)


@pytest.mark.parametrize("mean", [0.5, 4.0, 11.99, 12.0, 25.0, 200.0])
def test_shot_noise_is_poisson_distributed(mean):
    from scipy import stats

    # One electron per grey value without read noise: the grey values are the electrons.
    image = sensor_image(flat(mean), NoiseModel(1.0, 0.0, 100.0, 16), key=(2, 3))
    values, counts = np.unique(image, return_counts=True)
    measured = np.cumsum(counts) / image.size
    error = np.abs(measured - stats.poisson.cdf(values - 100.0, mean)).max()
    # Sampling alone exceeds the distance 2 / sqrt(n) once in 1500 times.
    assert error < 0.0015 * (mean >= EXACT_BELOW_E) + 2 / np.sqrt(image.size)


def test_read_noise_is_gaussian_and_reaches_below_the_black_level():
    from scipy import stats

    image = sensor_image(flat(0), NoiseModel(1.0, 10.0, 100.0, 12), key=(4,)).astype(float)
    distance = stats.kstest(
        image.ravel() + np.random.default_rng(0).uniform(-0.5, 0.5, image.size),
        stats.norm(100, np.sqrt(100 + 1 / 12)).cdf,
    ).statistic
    assert distance < 2 / np.sqrt(image.size)


def test_grey_values_are_clipped_at_zero():
    from scipy import stats

    image = sensor_image(flat(0), NoiseModel(1.0, 10.0, 0.0, 12), key=(4,))
    # Half of the distribution, and values that are rounded to zero.
    expected = stats.norm(0, 10).cdf(0.5)
    assert np.mean(image == 0) == pytest.approx(expected, abs=0.003)


def test_pixels_and_shots_are_independent():
    noise = NoiseModel(1.0, 2.0, 100.0, 16)
    one = sensor_image(flat(500), noise, key=(1, 0)).astype(float)
    other = sensor_image(flat(500), noise, key=(1, 1)).astype(float)
    for a, b in ((one, other), (one[1:], one[:-1]), (one[:, 1:], one[:, :-1])):
        correlation = np.corrcoef(a.ravel(), b.ravel())[0, 1]
        assert abs(correlation) < 5 / np.sqrt(a.size)


def test_the_same_key_gives_the_same_bytes_on_any_number_of_threads():
    noise = NoiseModel(1.0, 2.0, 100.0, 16)
    electrons = np.random.default_rng(0).uniform(0, 40, SHAPE).astype(np.float32)
    one = sensor_image(electrons, noise, key=(9, 9))
    threads = numba.get_num_threads()
    numba.set_num_threads(1)
    other = sensor_image(electrons, noise, key=(9, 9))
    numba.set_num_threads(threads)
    assert np.array_equal(one, other)
    assert not np.array_equal(one, sensor_image(electrons, noise, key=(9, 8)))


@pytest.mark.parametrize("uneven", [{}, {"dsnu_e": 2.0, "prnu": 0.01}])
def test_a_frame_of_a_third_of_a_megapixel_is_fast(uneven):
    noise = NoiseModel(2.5, 2.0, 64.0, 12, **uneven)
    photons, pattern = flat(3000, (512, 640)), fixed_pattern(noise, (512, 640))
    sensor_image(photons, noise, key=(1,), pattern=pattern)
    seconds = []
    for _ in range(10):
        start = time.process_time()
        sensor_image(photons, noise, key=(1,), pattern=pattern)
        seconds.append(time.process_time() - start)
    # Processor time does not depend on other programs: 15 ms on two cores.
    assert min(seconds) < 0.03


def frames(photons, noise, count=2, pattern=None, **options):
    """Return grey values of frames in uniform light, ``(count, H, W)`` float64."""
    images = [
        sensor_image(flat(photons), noise, key=(21, i), pattern=pattern, **options)
        for i in range(count)
    ]
    return np.array(images, np.float64)


@pytest.mark.parametrize(
    ("noise", "gain_db"),
    quick([
        pytest.param(NoiseModel(2.5, 4.0, 64.0, 12), 0.0, id="plain"),
        pytest.param(NoiseModel(2.5, 4.0, 64.0, 12), 12.0, id="analogue gain"),
        pytest.param(NoiseModel(0.6, 3.0, 200.0, 16), 0.0, id="16 bits"),
        pytest.param(
            NoiseModel(
                2.5, 8.0, 100.0, 12, quantum_efficiency=0.5, prnu=0.02, dsnu_e=6.0,
                dark_current_e_per_s=2000.0, hot_pixel_fraction=1e-3, hot_pixel_e_per_s=1e4,
            ),
            0.0,
            id="uneven",
        ),
    ], every=4),
)  # fmt: skip
def test_the_photon_transfer_curve_yields_gain_and_read_noise(noise, gain_db):
    """As in EMVA 1288: two frames at each of 15 levels; the difference has no fixed pattern."""
    pattern = fixed_pattern(noise, SHAPE, seed=8)
    gain = 10 ** (gain_db / 20) / noise.electrons_per_dn
    full = (noise.white_level_dn - noise.black_level_dn) / gain / noise.quantum_efficiency
    exposure_us = 20_000.0
    mean, variance = [], []
    for level in np.linspace(0, 0.7 * full, 15):
        one, other = frames(level, noise, pattern=pattern, exposure_us=exposure_us, gain_db=gain_db)
        mean.append((one + other).mean() / 2)
        variance.append(((one - other) ** 2).mean() / 2)
    # The relative error of a variance is the same at all levels.
    weights = 1 / np.array(variance)
    slope, dark = np.polyfit(np.array(mean) - mean[0], variance, 1, w=weights)
    assert slope == pytest.approx(gain, rel=0.02)
    dark_e = noise.dark_current_e_per_s + noise.hot_pixel_fraction * noise.hot_pixel_e_per_s
    shot = dark_e * exposure_us / 1e6
    read = np.sqrt((dark - 1 / 12) / slope**2 - shot)
    assert read == pytest.approx(noise.read_noise_e, rel=0.02)


def test_twice_the_exposure_is_twice_the_signal():
    noise = NoiseModel(2.5, 4.0, 64.0, 12, quantum_efficiency=0.6, prnu=0.01, dsnu_e=3.0)
    pattern = fixed_pattern(noise, SHAPE)
    dark = frames(0, noise, pattern=pattern)
    signal = [
        (frames(1000.0 * e, noise, pattern=pattern, exposure_us=1000.0 * e) - dark).mean()
        for e in (1, 2, 4, 8)
    ]
    np.testing.assert_allclose(np.divide(signal[1:], signal[:-1]), 2.0, rtol=1e-3)
    assert signal[0] == pytest.approx(1000 * 0.6 / 2.5, rel=2e-3)


@pytest.mark.slow
def test_the_fixed_pattern_is_recovered_from_means_of_frames():
    from scipy import stats

    noise = NoiseModel(1.0, 3.0, 200.0, 16, prnu=0.015, dsnu_e=8.0)
    pattern = fixed_pattern(noise, SHAPE, seed=3)
    count, photons = 16, 20_000.0
    dark = frames(0, noise, count, pattern).mean(axis=0)
    light = frames(photons, noise, count, pattern).mean(axis=0)
    temporal = (9 + 1 / 12) / count
    assert np.sqrt(dark.var() - temporal) == pytest.approx(8.0, rel=0.02)
    both = photons / count + 2 * temporal
    assert np.sqrt((light - dark).var() - both) / photons == pytest.approx(0.015, rel=0.02)
    # The same pixels deviate in every frame, within the noise of a mean of 16.
    np.testing.assert_allclose(light - dark, photons * pattern.maps[0], atol=6 * np.sqrt(both))
    response, offset = pattern.maps[:2].astype(float)
    assert abs(np.corrcoef(response.ravel(), offset.ravel())[0, 1]) < 5e-3
    assert stats.kstest(offset.ravel()[::7], stats.norm(0, 8).cdf).pvalue > 1e-4


def test_the_fixed_pattern_belongs_to_the_sensor_and_not_to_the_shot():
    noise = NoiseModel(1.0, 0.0, 200.0, 16, prnu=0.01, dsnu_e=8.0)
    size = (50, 60)
    maps = fixed_pattern(noise, size, seed=3).maps
    assert np.array_equal(fixed_pattern(noise, size, seed=3).maps, maps)
    assert not np.array_equal(fixed_pattern(noise, size, seed=4).maps, maps)
    assert fixed_pattern(NoiseModel(1.0, 5.0, 200.0, 16), size) is None


def test_number_and_currents_of_hot_pixels():
    noise = NoiseModel(
        1.0, 2.0, 100.0, 16, dark_current_e_per_s=50.0, hot_pixel_fraction=0.004,
        hot_pixel_e_per_s=3000.0,
    )  # fmt: skip
    pattern = fixed_pattern(noise, SHAPE, seed=2)
    dark = frames(0, noise, 1, pattern, exposure_us=1e6)[0] - 100
    # Exponential currents: exp(-200 / 3000) of the hot pixels have more than 200 electrons above
    # the 50 of all pixels; this is 20 standard deviations of the noise of the others.
    hot = np.mean(dark > 250)
    expected = 0.004 * np.exp(-200 / 3000)
    assert hot == pytest.approx(expected, rel=5 / np.sqrt(4000 * 0.94))
    assert np.median(dark) == pytest.approx(50, abs=1)
    assert dark[dark > 250].mean() == pytest.approx(50 + 200 + 3000, rel=5 / np.sqrt(4000))
    assert (frames(0, noise, 1, pattern, exposure_us=10.0) < 120).all()


def test_dark_current_has_shot_noise():
    noise = NoiseModel(1.0, 3.0, 100.0, 12, dark_current_e_per_s=400.0)
    one, other = frames(0, noise, exposure_us=500_000.0)
    assert one.mean() == pytest.approx(300, abs=0.1)
    assert (one - other).var() / 2 == pytest.approx(200 + 9 + 1 / 12, rel=0.01)


@pytest.mark.parametrize("bits", [8, 10, 12, 16])
def test_every_bit_depth_uses_its_full_range(bits):
    end = 2**bits - 1
    noise = NoiseModel(1.0, 0.0, 4.0, bits)
    ramp = np.arange(-4.0, end + 50, dtype=np.float32).clip(0)[None]
    grey = sensor_image(ramp, noise, key=None)[0]
    np.testing.assert_array_equal(grey, np.minimum(ramp[0] + 4, end))
    assert noise.white_level_dn == end
    assert sensor_image(flat(10.0 * end, (20, 20)), noise, key=(1,)).min() == end


def test_a_full_pixel_saturates_before_the_converter_and_counts_as_saturated():
    noise = NoiseModel(2.0, 6.0, 100.0, 12, full_well_e=6000.0, dsnu_e=3.0)
    pattern = fixed_pattern(noise, SHAPE)
    grey = frames(50_000.0, noise, 1, pattern)[0]
    # There is no shot noise left: 6000 / 2 + 100 with read noise, offsets and rounding.
    assert grey.mean() == pytest.approx(3100, abs=0.05)
    assert grey.var() == pytest.approx((36 + 9) / 4 + 1 / 12, rel=0.01)
    # Four standard deviations: 3 in 100 000 are below.
    assert np.mean(grey < noise.white_level_dn) < 1e-4
    half = frames(3000.0, noise, 1, pattern)[0]
    assert half.mean() == pytest.approx(1600, abs=0.2)
    assert (half < noise.white_level_dn).all()
    assert (sensor_image(flat(1e6, (3, 3)), noise, key=None) == 3100).all()
    # With gain, the converter may saturate first.
    assert (sensor_image(flat(1e6, (3, 3)), noise, gain_db=20.0, key=None) == 4095).all()


def test_without_noise_the_fixed_pattern_and_the_dark_current_remain():
    noise = NoiseModel(
        1.0, 9.0, 100.0, 16, quantum_efficiency=0.5, prnu=0.1, dsnu_e=5.0,
        dark_current_e_per_s=1000.0,
    )  # fmt: skip
    pattern = fixed_pattern(noise, (40, 50))
    grey = sensor_image(
        flat(8000, (40, 50)), noise, exposure_us=2e5, key=None, pattern=pattern
    ).astype(float)
    response, offset, _ = pattern.maps.astype(float)
    np.testing.assert_allclose(grey, 100 + 4000 * response + 200 + offset, atol=0.51)
