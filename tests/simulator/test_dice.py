"""Counter-based random numbers: known values, and independence of streams."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simulator.camera.sensor import hashed, log_of, unit
from simulator.camera.sensor import normal_pair as pixel_pair
from simulator.noise.dice import bits, normal_pair, stream, uniform

WORDS = st.integers(0, 2**64 - 1)


@pytest.mark.parametrize(
    ("counter", "value"),
    [(0, 0xE220A8397B1DCDAF), (1, 0x6E789E6AA1B965F4), (2, 0x06C45D188009454F)],
)
def test_the_numbers_are_those_of_splitmix64(counter, value):
    assert bits(0, counter) == value


@given(state=WORDS, counter=WORDS)
def test_the_kernel_returns_the_same_bits(state, counter):
    assert int(hashed(np.uint64(state), np.uint64(counter))) == bits(state, counter)


def test_streams_of_similar_keys_are_independent():
    keys = [(), (0,), (0, 0), (1,), (0, 1), (1, 0), (2**63,), (1, 0, 0)]
    states = [stream(*key) for key in keys]
    assert len(set(states)) == len(keys)
    draws = np.array([[uniform(state, i) for i in range(2000)] for state in states[1:]])
    off = np.corrcoef(draws)[~np.eye(len(draws), dtype=bool)]
    assert np.abs(off).max() < 5 / np.sqrt(2000)


def test_uniform_and_normal_numbers_have_their_distributions():
    from scipy import stats

    state = stream(7, 8)
    even = [uniform(state, i) for i in range(20_000)]
    assert stats.kstest(even, stats.uniform.cdf).pvalue > 1e-3
    pairs = np.array([normal_pair(state, 2 * i) for i in range(20_000)])
    for column in pairs.T:
        assert stats.kstest(column, stats.norm.cdf).pvalue > 1e-3
    assert abs(np.corrcoef(pairs.T)[0, 1]) < 5 / np.sqrt(len(pairs))


@given(number=WORDS)
def test_the_polynomials_approximate_their_functions(number):
    high, low = number >> 33, (number & 0xFFFFFFFF) >> 1
    u, turn = (high + 0.5) / 2**31, 2 * np.pi * (low + 0.5) / 2**31
    assert float(unit(np.uint64(number))) == pytest.approx(u, rel=1e-7)
    single = np.float32(unit(np.uint64(number)))
    assert float(log_of(single)) == pytest.approx(np.log(np.float64(single)), abs=1e-9, rel=1e-6)
    radius = np.sqrt(-2 * np.log(np.float64(single)))
    expected = radius * np.cos(turn), radius * np.sin(turn)
    assert pixel_pair(np.uint64(number)) == pytest.approx(expected, abs=1e-5)
