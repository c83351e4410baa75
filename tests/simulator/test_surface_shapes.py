"""Surfaces against numeric differentiation and closed forms."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from acquisition import DataError
from simulator import BandNoise, Coin, Plane, Ripples, SphericalCap

SURFACES = [
    pytest.param(Plane(60.0, 2.0, 0.2, -0.1), id="tilted-plane"),
    pytest.param(SphericalCap(60.0, 12.0), id="cap"),
    pytest.param(Ripples(60.0, 0.4, 9.0), id="ripples"),
    pytest.param(BandNoise(60.0, 0.2, 5.0, seed=4), id="band-noise"),
    pytest.param(Coin(60.0, seed=2), id="coin"),
    pytest.param(Coin(80.0, dome_mm=3.0, relief_mm=1.0, seed=2), id="steep-coin"),
]


def _points(count=4000, radius=59.0, seed=0):
    rng = np.random.default_rng(seed)
    r, angle = radius * np.sqrt(rng.uniform(0, 1, count)), rng.uniform(0, 2 * np.pi, count)
    return r * np.cos(angle), r * np.sin(angle)


@pytest.mark.parametrize("surface", SURFACES)
def test_gradient_is_the_derivative_of_the_height(surface):
    x, y = _points()
    h = 1e-3
    _, zx, zy = surface.evaluate(x, y)

    def fourth_order(dx, dy):
        near = surface.evaluate(x + dx, y + dy)[0] - surface.evaluate(x - dx, y - dy)[0]
        far = (
            surface.evaluate(x + 2 * dx, y + 2 * dy)[0]
            - surface.evaluate(x - 2 * dx, y - 2 * dy)[0]
        )
        return (8 * near - far) / (12 * h)

    # Strokes end in half discs: the second derivative jumps there, so a few points are worse.
    error = np.hypot(fourth_order(h, 0) - zx, fourth_order(0, h) - zy)
    assert np.percentile(error, 99) < 1e-7
    assert error.max() < 1e-3


def test_gradient_at_the_centre_is_finite():
    origin = np.zeros(1)
    for surface in (Ripples(60.0), Coin(60.0), SphericalCap(60.0, 12.0)):
        assert np.isfinite(np.concatenate(surface.evaluate(origin, origin))).all()


def test_cap_lies_on_its_sphere():
    cap = SphericalCap(40.0, 10.0)
    x, y = _points(radius=40.0)
    z, _, _ = cap.evaluate(x, y)
    sphere = (40.0**2 + 10.0**2) / 20.0
    np.testing.assert_allclose(x**2 + y**2 + (z + sphere - 10.0) ** 2, sphere**2, rtol=1e-12)
    assert cap.evaluate(np.zeros(1), np.zeros(1))[0][0] == pytest.approx(10.0)
    assert cap.evaluate(np.array([40.0]), np.zeros(1))[0][0] == pytest.approx(0.0, abs=1e-12)


def test_ripples_crest_at_whole_wavelengths():
    ripples = Ripples(50.0, 0.3, 8.0)
    crests = ripples.evaluate(np.array([0.0, 8.0, -16.0]), np.zeros(3))[0]
    troughs = ripples.evaluate(np.zeros(2), np.array([4.0, -12.0]))[0]
    np.testing.assert_allclose(crests, 0.6, atol=1e-12)
    np.testing.assert_allclose(troughs, 0.0, atol=1e-12)


def test_band_noise_has_its_rms_and_its_wavelength():
    size, step, wavelength = 512, 0.5, 6.0
    x, y = np.meshgrid(np.arange(size) * step, np.arange(size) * step)
    z = BandNoise(100.0, 0.2, wavelength, height_mm=1.0, seed=7).evaluate(x, y)[0] - 1.0
    assert z.std() == pytest.approx(0.2, rel=0.03)
    power = np.abs(np.fft.fft2(z * np.outer(np.hanning(size), np.hanning(size)))) ** 2
    frequency = np.fft.fftfreq(size, step)
    radius = np.hypot(*np.meshgrid(frequency, frequency))
    in_band = np.abs(radius * wavelength - 1) < 0.1
    assert power[in_band].sum() > 0.99 * power.sum()


def test_outline_holds_its_edge():
    plane = Plane(10.0)
    x = np.array([0.0, 10.0, 10.001, 7.0])
    y = np.array([0.0, 0.0, 0.0, 7.2])
    assert plane.inside(x, y).tolist() == [True, True, False, False]


def test_coin_grows_with_its_radius():
    x, y = _points(500, radius=70.0)
    large = Coin(80.0, dome_mm=8.0, relief_mm=0.4, seed=3).evaluate(x, y)[0]
    small = Coin(40.0, dome_mm=4.0, relief_mm=0.2, grain_mm=0.0075, seed=3).evaluate(x / 2, y / 2)[
        0
    ]
    np.testing.assert_allclose(small, large / 2, atol=1e-12)


@pytest.mark.parametrize(
    "change",
    [
        pytest.param(lambda z: z[:, ::-1], id="mirrored"),
        pytest.param(lambda z: z[::-1], id="upside-down"),
        pytest.param(lambda z: z[::-1, ::-1], id="half-turn"),
        pytest.param(lambda z: z.T, id="transposed"),
        pytest.param(lambda z: np.rot90(z), id="quarter-turn"),
    ],
)
def test_coin_is_not_symmetric(change):
    span = np.linspace(-60, 60, 241)
    x, y = np.meshgrid(span, -span)
    coin = Coin(80.0)
    relief = coin.evaluate(x, y)[0] - SphericalCap(80.0, coin.dome_mm).evaluate(x, y)[0]
    relief = relief - relief.mean()
    assert np.mean(relief * change(relief)) < 0.75 * np.mean(relief**2)


def test_coin_seed_changes_the_grain_only():
    x, y = _points(2000)
    a, b, again = (Coin(80.0, seed=s).evaluate(x, y)[0] for s in (1, 2, 1))
    np.testing.assert_array_equal(a, again)
    assert 0.01 < np.std(a - b) < 0.03


@settings(max_examples=25, deadline=None)
@given(
    radius=st.floats(5, 200),
    part=st.floats(0.01, 0.95),
    angle=st.floats(0, 2 * math.pi),
    at=st.floats(0, 0.99),
)
def test_cap_normal_points_from_its_centre(radius, part, angle, at):
    cap = SphericalCap(radius, part * radius)
    x, y = np.array([at * radius * math.cos(angle)]), np.array([at * radius * math.sin(angle)])
    z, zx, zy = cap.evaluate(x, y)
    from_centre = np.array([x[0], y[0], z[0] + cap.sphere_radius_mm - cap.height_mm])
    np.testing.assert_allclose(
        np.cross([-zx[0], -zy[0], 1.0], from_centre), 0.0, atol=1e-8 * cap.sphere_radius_mm
    )


@pytest.mark.parametrize(
    ("make", "message"),
    [
        pytest.param(lambda: Plane(-1.0), "radius_mm is -1.0", id="negative-radius"),
        pytest.param(lambda: Plane(10.0, math.nan), "height_mm is nan", id="nan-height"),
        pytest.param(lambda: Ripples(10.0, 0.1, 0.0), "wavelength_mm is 0.0", id="no-wavelength"),
        pytest.param(lambda: SphericalCap(10.0, 10.0), "less than radius_mm", id="half-sphere"),
        pytest.param(lambda: BandNoise(10.0, -0.1), "rms_mm is -0.1", id="negative-rms"),
        pytest.param(lambda: Coin(80.0, relief_mm=-1), "relief_mm is -1", id="negative-relief"),
    ],
)
def test_bad_surface_is_one_line(make, message):
    with pytest.raises(DataError, match=message) as caught:
        make()
    assert "\n" not in str(caught.value)
