from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from acquisition.pixels import measure_quality
from rig.arrays import UInt16


@settings(max_examples=50)
@given(
    seed=st.integers(0, 2**32 - 1),
    height=st.integers(1, 150),
    width=st.integers(1, 9),
    colour=st.booleans(),
    white_dn=st.integers(1, 65535),
)
def test_counts_are_exact(seed: int, height: int, width: int, colour: bool, white_dn: int) -> None:
    shape = (height, width, 3) if colour else (height, width)
    pixels = np.random.default_rng(seed).integers(0, 65536, shape).astype(np.uint16)
    found = measure_quality(pixels, white_level_dn=white_dn)
    assert found.clipped_fraction == np.mean(pixels >= white_dn)
    ordered = np.sort(pixels.ravel())
    for name, value in found.percentiles_dn.items():
        rank = math.ceil(Fraction(name) / 100 * ordered.size)
        assert value == ordered[max(rank, 1) - 1], name
    if height < 3 and width < 3:
        assert found.sharpness == 0.0


def sine(period_px: float, amplitude: float, height: int = 200) -> UInt16:
    x = np.arange(240)
    row = 10000 + amplitude * np.sin(2 * np.pi * x / period_px)
    return np.broadcast_to(np.round(row), (height, 240)).astype(np.uint16)


@pytest.mark.parametrize("period_px", [8.0, 12.0, 40.0])
@pytest.mark.parametrize("black_dn", [0.0, 2000.0])
def test_sharpness_of_a_sine(period_px: float, black_dn: float) -> None:
    # Two apart, a sine of amplitude a differs by 2 a sin(2 pi / p) cos(...): mean square
    # 2 a^2 sin^2(2 pi / p) along the rows, 0 down the columns.
    pixels = sine(period_px, 3000.0)
    found = measure_quality(pixels, white_level_dn=65535, black_level_dn=black_dn)
    pairs_along, pairs_down = 200 * 238, 198 * 240
    energy = 2 * 3000.0**2 * np.sin(2 * np.pi / period_px) ** 2
    wanted = energy * pairs_along / (pairs_along + pairs_down) / (10000 - black_dn) ** 2
    assert found.sharpness == pytest.approx(wanted, rel=0.02)


def test_rows_and_columns_count_alike() -> None:
    pixels = sine(9.0, 2000.0, height=240)
    along = measure_quality(pixels, white_level_dn=65535)
    down = measure_quality(pixels.T, white_level_dn=65535)
    assert along.sharpness == down.sharpness


def test_a_bayer_pattern_does_not_count_as_sharpness() -> None:
    pixels = np.tile(np.array([[100, 900], [900, 300]], np.uint16), (80, 80))
    assert measure_quality(pixels, white_level_dn=4095).sharpness == 0.0


def test_exposure_does_not_change_sharpness() -> None:
    pixels = sine(9.0, 2000.0)
    dark = measure_quality(pixels, white_level_dn=65535).sharpness
    bright = measure_quality(pixels * np.uint16(3), white_level_dn=65535).sharpness
    assert bright == pytest.approx(dark, rel=1e-5)


def test_a_black_frame() -> None:
    found = measure_quality(np.full((5, 5), 60, np.uint16), white_level_dn=4095, black_level_dn=64)
    assert (found.clipped_fraction, found.sharpness) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("white_dn", "fraction"),
    [(99.0, 1.0), (100.0, 1.0), (100.5, 0.5), (200.0, 0.5), (200.5, 0.0), (65535.0, 0.0)],
)
def test_clipping_at_levels_between_values(white_dn: float, fraction: float) -> None:
    pixels = np.array([[100, 200]], np.uint16)
    assert measure_quality(pixels, white_level_dn=white_dn).clipped_fraction == fraction
