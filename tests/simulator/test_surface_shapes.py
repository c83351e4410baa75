"""Surfaces, compared with numerical differentiation and closed forms."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simulator.shapes import (
    BandNoise,
    Coin,
    CrackedLeather,
    LizardScales,
    Plane,
    Ripples,
    SphericalCap,
    StepGauge,
    Textile,
    WoodCarving,
)
from tests.quick_sample import quick

CARVED = (LizardScales, Textile, CrackedLeather, WoodCarving)

SURFACES = [
    pytest.param(Plane(60.0, 2.0, 0.2, -0.1), id="tilted-plane"),
    pytest.param(SphericalCap(60.0, 12.0), id="cap"),
    pytest.param(Ripples(60.0, 0.4, 9.0), id="ripples"),
    pytest.param(BandNoise(60.0, 0.2, 5.0, seed=4), id="band-noise"),
    pytest.param(LizardScales(60.0, 2.0, seed=5), id="scales"),
    pytest.param(Textile(60.0, 1.5, seed=5), id="textile"),
    pytest.param(CrackedLeather(60.0, 1.0, seed=5), id="leather"),
    pytest.param(WoodCarving(60.0, 2.0, seed=5), id="wood-carving"),
    pytest.param(StepGauge(60.0, edge_mm=3.0), id="step-gauge"),
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

    error = np.hypot(fourth_order(h, 0) - zx, fourth_order(0, h) - zy)
    if isinstance(surface, Coin):
        # Its strokes end in semicircles, where the second derivative is discontinuous.
        assert np.percentile(error, 99) < 1e-7
        assert error.max() < 1e-3
    else:
        assert error.max() < 1e-6


@pytest.mark.parametrize("kind", CARVED)
def test_carved_surface_is_smooth_across_its_lattice(kind):
    """Dense samples along a line: there is no jump between cells."""
    surface = kind(60.0, 1.0, seed=7)
    along = np.linspace(-40, 40, 400_001)
    z, zx, zy = surface.evaluate(along, 0.37 * along + 3.0)
    rise = np.diff(z)
    # The trapezoid rule between neighbours; its error is of third order in the step.
    predicted = np.diff(along) * (0.5 * (zx[1:] + zx[:-1]) + 0.37 * 0.5 * (zy[1:] + zy[:-1]))
    assert np.abs(rise - predicted).max() < 1e-9


@pytest.mark.parametrize("kind", CARVED)
@pytest.mark.parametrize("seed", quick([11, 12], every=2))
def test_carved_surface_keeps_its_amplitude(kind, seed):
    x, y = _points(200_000, radius=60.0, seed=1)
    z = kind(60.0, 0.7, seed=seed).evaluate(x, y)[0]
    low, high = z.min(), z.max()
    assert 0 <= low < 0.3 * 0.7
    assert 0.9 * 0.7 < high <= 0.7
    twice = kind(60.0, 1.4, seed=seed).evaluate(x, y)
    np.testing.assert_allclose(twice[0], 2 * z, rtol=1e-12)


@pytest.mark.parametrize("kind", CARVED)
def test_carved_surface_depends_on_its_seed(kind):
    x, y = _points(5000)
    a, again, b = (kind(60.0, 1.0, seed=s).evaluate(x, y)[0] for s in (3, 3, 4))
    np.testing.assert_array_equal(a, again)
    assert np.abs(a - b).max() > 0.02


def test_weave_alternates_over_and_under():
    """At crossings, the upper yarn alternates like a checkerboard."""
    cloth = Textile(60.0, 1.0, seed=2, yarn_mm=6.0)
    i, j = np.meshgrid(np.arange(-6, 7), np.arange(-6, 7))
    x, y = 6.0 * i, 6.0 * j
    _, right, _ = cloth.evaluate(x + 1.5, y)
    _, left, _ = cloth.evaluate(x - 1.5, y)
    _, _, above = cloth.evaluate(x, y + 1.5)
    _, _, below = cloth.evaluate(x, y - 1.5)
    # On the upper yarn, the surface is curved much more across the yarn than along it.
    across_x, across_y = left - right, below - above
    warp_on_top = across_x > across_y
    np.testing.assert_array_equal(warp_on_top, (i + j) % 2 == 1)


def test_scales_overlap_the_row_below():
    """Toward +Y, the surface rises quickly and falls slowly: the steep side faces down."""
    x, y = _points(50_000)
    _, _, zy = LizardScales(60.0, 1.0, seed=2).evaluate(x, y)
    low, middle, high = np.percentile(zy, [1, 50, 99])
    assert middle < 0
    assert high > 1.3 * -low


def test_step_gauge_has_its_heights():
    gauge = StepGauge(50.0, (0.5, 1.0, 3.0), edge_mm=0.2)
    treads = gauge.tread_mm * np.array([-1.0, 0.0, 1.0])
    near = gauge.edges_mm[:, None] + 0.1001 * np.array([-1, 1])
    z, zx, zy = gauge.evaluate(treads, np.array([10.0, 0.0, -20.0]))
    np.testing.assert_array_equal(z, [0.5, 1.0, 3.0])
    np.testing.assert_array_equal(np.concatenate([zx, zy]), 0.0)
    np.testing.assert_array_equal(
        gauge.evaluate(near, np.zeros((2, 2)))[0], [[0.5, 1.0], [1.0, 3.0]]
    )
    np.testing.assert_allclose(gauge.evaluate(gauge.edges_mm, np.zeros(2))[0], [0.75, 2.0])
    assert gauge.tread_mm == pytest.approx(100 / math.sqrt(2) / 3)


@pytest.mark.parametrize("surface", quick(SURFACES, every=3))
def test_bounds_hold(surface):
    x, y = _points(400_000, radius=surface.radius_mm, seed=9)
    z, zx, zy = surface.evaluate(x, y)
    bounds = surface.bounds
    # A surface may reach its bounds, to rounding error.
    assert bounds.bottom_mm - 1e-12 <= z.min()
    assert z.max() <= bounds.top_mm + 1e-12
    assert np.hypot(zx, zy).max() <= bounds.steepest + 1e-12
    assert surface.top_mm == bounds.top_mm


def test_the_bounds_of_a_coin_are_sampled_once(monkeypatch):
    coin = Coin(41.0, seed=5)
    bounds = coin.bounds
    monkeypatch.setattr(Coin, "evaluate", lambda *_: pytest.fail("sampled again"))
    assert Coin(41.0, seed=5).bounds == bounds
    monkeypatch.undo()
    assert Coin(41.0, seed=6).bounds != bounds


def test_gradient_at_the_centre_is_finite():
    origin = np.zeros(1)
    for surface in (Ripples(60.0), Coin(60.0), SphericalCap(60.0, 12.0)):
        assert np.isfinite(np.concatenate(surface.evaluate(origin, origin))).all()


def test_cap_is_on_its_sphere():
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


def test_outline_includes_its_edge():
    plane = Plane(10.0)
    x = np.array([0.0, 10.0, 10.001, 7.0])
    y = np.array([0.0, 0.0, 0.0, 7.2])
    assert plane.inside(x, y).tolist() == [True, True, False, False]


def test_square_outline_is_inside_the_circle():
    plane = Plane(10.0, outline="square")
    half = 10.0 / math.sqrt(2)
    x = np.array([0.999, 0.999, 1.001, 0.0, 0.0]) * half
    y = np.array([0.0, -0.999, 0.0, 1.001, 0.999]) * half
    assert plane.inside(x, y).tolist() == [True, True, False, False, True]


def test_coin_scales_with_its_radius():
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


@settings(max_examples=25)
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
