"""The sensor against the closed forms of its noise."""

import time

import numba
import numpy as np
import pytest
from scipy import stats

from acquisition import NoiseModel
from simulator._sensor import EXACT_BELOW_E, sensor_image

SHAPE = (1000, 1000)


def flat(mean, shape=SHAPE):
    return np.full(shape, mean, np.float32)


@pytest.mark.parametrize(
    ("electrons", "gain_db", "grey"),
    [
        pytest.param(0, 0, 64, id="dark"),
        pytest.param(1000, 0, 464, id="linear"),
        pytest.param(1000, 6.0205999, 864, id="6 dB doubles the signal alone"),
        pytest.param(1001.2, 0, 464, id="rounds down"),
        pytest.param(1001.3, 0, 465, id="rounds up"),
        pytest.param(10_077.4, 0, 4095, id="just white"),
        pytest.param(1e9, 0, 4095, id="saturated"),
    ],
)
def test_without_noise_grey_is_the_linear_value_rounded(electrons, gain_db, grey):
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
        # Where the value is not already a whole number, quantisation adds its part.
        variance = float(noise.variance_dn(500.0 + 2 * mean))
    count = grey.size
    assert grey.mean() - 500 == pytest.approx(2 * mean, abs=5 * np.sqrt((variance + 1) / count))
    kurtosis = 3 + 1 / max(mean, 0.1)
    tolerance = 5 * np.sqrt((kurtosis - 1) / count)
    assert grey.var() == pytest.approx(variance, rel=tolerance + 2e-3, abs=1e-9)


@pytest.mark.parametrize("mean", [0.5, 4.0, 11.99, 12.0, 25.0, 200.0])
def test_shot_noise_is_poisson_distributed(mean):
    # One electron per grey value without read noise: the grey values are the electrons.
    image = sensor_image(flat(mean), NoiseModel(1.0, 0.0, 100.0, 16), key=(2, 3))
    values, counts = np.unique(image, return_counts=True)
    measured = np.cumsum(counts) / image.size
    error = np.abs(measured - stats.poisson.cdf(values - 100.0, mean)).max()
    # 2 / sqrt(n) is the distance that sampling alone exceeds once in 1500 times.
    assert error < 0.0015 * (mean >= EXACT_BELOW_E) + 2 / np.sqrt(image.size)


def test_read_noise_is_gaussian_and_reaches_below_the_black_level():
    image = sensor_image(flat(0), NoiseModel(1.0, 10.0, 100.0, 12), key=(4,)).astype(float)
    distance = stats.kstest(
        image.ravel() + np.random.default_rng(0).uniform(-0.5, 0.5, image.size),
        stats.norm(100, np.sqrt(100 + 1 / 12)).cdf,
    ).statistic
    assert distance < 2 / np.sqrt(image.size)


def test_grey_stops_at_zero():
    image = sensor_image(flat(0), NoiseModel(1.0, 10.0, 0.0, 12), key=(4,))
    # Half of the distribution and what rounds to zero.
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


def test_a_frame_of_a_third_of_a_megapixel_is_quick():
    noise = NoiseModel(2.5, 2.0, 64.0, 12)
    electrons = flat(3000, (512, 640))
    sensor_image(electrons, noise, key=(1,))
    seconds = []
    for _ in range(10):
        start = time.process_time()
        sensor_image(electrons, noise, key=(1,))
        seconds.append(time.process_time() - start)
    # Processor time, which other work does not touch: 15 ms on two cores.
    assert min(seconds) < 0.03
