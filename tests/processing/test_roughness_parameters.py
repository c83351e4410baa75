"""Parameters of areas and profiles, compared with closed forms and spectra."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import norm

from processing.roughness import (
    AREAL,
    PROFILE,
    Resolution,
    Scales,
    areal_parameters,
    profile_parameters,
    scale_limited_profile,
)

PIXEL = 0.01
AMPLITUDE = 0.002  # mm
WAVE = 0.25  # mm, 25 pixels


def grid(size=(200, 1000)):
    return np.meshgrid(*(np.arange(n) * PIXEL for n in size), indexing="ij")


def sine(turn=False):
    y, x = grid((5000, 60) if turn else (60, 5000))
    return AMPLITUDE * np.sin(2 * np.pi * (y if turn else x) / WAVE + 0.1)


def sawtooth():
    _, x = grid((60, 5000))
    return AMPLITUDE * (2 * ((x / 2.5 + 0.0002) % 1) - 1)


def triangle():
    _, x = grid((60, 5000))
    return AMPLITUDE * (4 * np.abs((x / 2.5 + 0.1) % 1 - 0.5) - 1)


UM = 1000 * AMPLITUDE
SINE = {
    "Sa": 2 * UM / np.pi,
    "Sq": UM / np.sqrt(2),
    "Sku": 1.5,
    "Sdq": np.sqrt(2) * np.pi * AMPLITUDE / WAVE,
    "Sdr": 100 * (np.pi * AMPLITUDE / WAVE) ** 2,
    "Sal": WAVE * np.arctan2(np.sqrt(1 - 0.2**2), 0.2) / (2 * np.pi),
}
EVEN = {"Sa": UM / 2, "Sq": UM / np.sqrt(3), "Sku": 1.8, "Sk": 2 * UM}
CASES = {
    "sine along x": (sine(), SINE),
    "sine along y": (sine(turn=True), SINE),
    "sawtooth": (sawtooth(), EVEN | {"Smr2": 100}),
    "triangle": (triangle(), EVEN | {"Sdq": 4 * AMPLITUDE / 2.5}),
}


@pytest.mark.parametrize("name", CASES)
def test_closed_forms(name):
    heights, expected = CASES[name]
    found = areal_parameters(heights, PIXEL)
    assert {key: found[key] for key in expected} == pytest.approx(expected, rel=1e-3)
    assert found["Ssk"] == pytest.approx(0, abs=2e-3)
    assert set(found) == set(AREAL)


@pytest.mark.parametrize(("turn", "direction"), [(False, 90), (True, 0)])
def test_the_direction_of_the_lay_is_along_the_crests(turn, direction):
    found = areal_parameters(sine(turn=turn), PIXEL)["Std"]
    assert (found - direction + 90) % 180 - 90 == pytest.approx(0, abs=0.5)


def test_up_is_up_in_directions():
    y, x = grid((300, 300))
    # Rows run down: crests at +30 degrees in X and Y.
    across = -np.sin(np.radians(30)) * x + np.cos(np.radians(30)) * (-y)
    found = areal_parameters(AMPLITUDE * np.sin(2 * np.pi * across / WAVE), PIXEL)
    assert found["Std"] == pytest.approx(30, abs=0.5)


def random_surface(seed, size=800, band=(16, 60), stretch=1.0):
    """Return a periodic Gaussian surface and its root mean square height and gradient."""
    rng = np.random.default_rng(seed)
    v, u = np.meshgrid(np.fft.fftfreq(size), np.fft.fftfreq(size), indexing="ij")
    frequency = np.hypot(u, stretch * v)
    kept = (frequency > 1 / band[1]) & (frequency < 1 / band[0])
    spectrum = np.fft.fft2(rng.standard_normal((size, size))) * kept
    heights = np.fft.ifft2(spectrum).real
    factor = AMPLITUDE / heights.std()
    power = np.abs(spectrum * factor / size**2) ** 2
    square = power.sum()
    slopes = (power * (2 * np.pi * np.hypot(u, v) / PIXEL) ** 2).sum()
    return factor * heights, 1000 * np.sqrt(square), np.sqrt(slopes)


@pytest.mark.parametrize("seed", [1, 2])
def test_random_surfaces_agree_with_their_spectrum(seed):
    heights, height, slope = random_surface(seed)
    found = areal_parameters(heights, PIXEL)
    assert found["Sq"] == pytest.approx(height, rel=1e-3)
    assert found["Sdq"] == pytest.approx(slope, rel=1e-3)


def test_the_material_ratio_of_normal_heights():
    ratio = (np.arange(400_000) + 0.5) / 400_000
    heights = AMPLITUDE * norm.ppf(ratio)[np.random.default_rng(0).permutation(400_000)]
    found = areal_parameters(heights.reshape(500, 800), PIXEL)
    # The line of least squares through the middle 40 % of the curve.
    part = np.linspace(0.3, 0.7, 100_001)
    slope, at_zero = np.polyfit(part, -norm.ppf(part), 1)
    beyond = norm.sf(at_zero)
    area = norm.pdf(at_zero) - at_zero * beyond
    expected = {
        "Sk": -slope * UM,
        "Spk": 2 * area / beyond * UM,
        "Svk": 2 * area / beyond * UM,
        "Smr1": 100 * beyond,
        "Smr2": 100 - 100 * beyond,
        "Sxp": norm.isf(0.025) * UM,
        "Smr": 100 * norm.sf(1 / UM),
    }
    assert {key: found[key] for key in expected} == pytest.approx(expected, rel=2e-3)


def test_texture_of_an_anisotropic_surface():
    heights, *_ = random_surface(5, size=512, band=(16, 40), stretch=2.0)
    wide, _, _ = random_surface(5, size=512, band=(16, 40))
    found, even = areal_parameters(heights, PIXEL), areal_parameters(wide, PIXEL)
    assert found["Str"] == pytest.approx(0.5, abs=0.1)
    assert even["Str"] > 0.8


@given(
    factor=st.floats(0.1, 100),
    turns=st.integers(0, 3),
    offset=st.floats(-50, 50),
)
def test_parameters_follow_the_surface(factor, turns, offset):
    heights, *_ = random_surface(3, size=96, band=(8, 24))
    before = areal_parameters(heights, PIXEL)
    after = areal_parameters(np.rot90(heights, turns) * factor + offset, PIXEL)
    for name, parameter in AREAL.items():
        if name in ("Std", "Smr", "Sdr"):
            continue
        gain = factor if parameter.kind in ("height", "slope") else 1
        assert after[name] == pytest.approx(gain * before[name], rel=1e-4), name


def test_holes_do_not_count():
    heights = sine()
    holes = heights.copy()
    holes[20:40, 300:400] = np.nan
    whole, part = areal_parameters(heights, PIXEL), areal_parameters(holes, PIXEL)
    for name in ("Sa", "Sq", "Sdq", "Sal"):
        assert part[name] == pytest.approx(whole[name], rel=5e-3), name


def test_a_level_surface_has_no_texture():
    found = areal_parameters(np.full((40, 40), 3.0), PIXEL)
    assert [found[name] for name in ("Sq", "Sz", "Sdq")] == pytest.approx([0, 0, 0], abs=1e-12)
    assert all(np.isnan(found[name]) for name in ("Ssk", "Sal", "Str", "Std", "Sk"))


def profile_of(heights, **options):
    scales = Scales("none", 0.05, **({"l_mm": 0.0} | options))
    return scale_limited_profile(heights, scales, Resolution(PIXEL, 10.0))


def test_closed_forms_of_profiles():
    # A blur as wide as the S-filter: it removes nothing more.
    found = profile_parameters(profile_of(sine()[0]))
    expected = {
        "Ra": 2 * UM / np.pi,
        "Rq": UM / np.sqrt(2),
        "Rt": 2 * UM,
        "Rz": 2 * UM,
        "Rku": 1.5,
        "RSm": WAVE,
        "Rdq": np.sqrt(2) * np.pi * AMPLITUDE / WAVE,
    }
    assert {key: found[key] for key in expected} == pytest.approx(expected, rel=0.011)
    assert {key: found[key] for key in ("Ra", "Rq", "RSm")} == pytest.approx(
        {key: expected[key] for key in ("Ra", "Rq", "RSm")}, rel=1e-3
    )
    assert set(found) == set(PROFILE)


def test_waviness_and_roughness_share_a_profile():
    at = np.arange(4000) * PIXEL
    short, long = 0.001 * np.sin(2 * np.pi * at / 0.25), 0.003 * np.sin(2 * np.pi * at / 8)
    found = profile_parameters(profile_of(short + long, l_mm=0.8))
    transmitted = np.exp(-np.log(2) * (0.8 / 8) ** 2)
    assert found["Wq"] == pytest.approx(3 / np.sqrt(2) * transmitted, rel=0.02)
    assert found["Rq"] == pytest.approx(1 / np.sqrt(2), rel=0.03)


def test_small_waves_are_no_profile_elements():
    at = np.arange(2000) * PIXEL
    ripple = 0.002 * np.sin(2 * np.pi * at / 2.5) + 0.0001 * np.sin(2 * np.pi * at / 0.15)
    assert profile_parameters(profile_of(ripple))["RSm"] == pytest.approx(2.5, rel=0.02)
