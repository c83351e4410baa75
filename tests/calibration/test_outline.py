import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calibration import EstimateError
from calibration.spheres import Ellipse, fit_circle, fit_cone, fit_ellipse, mask_outlines
from calibration.spheres.outline.limb import edge_offsets, estimate_blur, profile_offsets
from calibration.spheres.outline.outline import refine_outline


def on_ellipse(cx, cy, a, b, degrees, t):
    """Return points of an ellipse, from its parametric definition."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    x, y = a * np.cos(t), b * np.sin(t)
    return np.column_stack([cx + c * x - s * y, cy + s * x + c * y])


@settings(max_examples=25)
@given(
    st.floats(-50, 2000),
    st.floats(-50, 2000),
    st.floats(20, 400),
    st.floats(0.6, 1.6),
    st.floats(-80, 80),
)
def test_ellipse_is_recovered_exactly(cx, cy, a, ratio, degrees):
    points = on_ellipse(cx, cy, a, a * ratio, degrees, np.linspace(0, 2 * np.pi, 90)[:-1])
    ellipse, weights = fit_ellipse(points)
    again = on_ellipse(cx, cy, a, a * ratio, degrees, np.linspace(0.1, 6.3, 37))
    assert np.abs(ellipse.distance_px(again)).max() < 1e-6 * a
    assert ellipse.centre_px == pytest.approx((cx, cy), abs=1e-6 * a)
    assert sorted(ellipse.semi_axes_px) == pytest.approx(sorted((a, a * ratio)), rel=1e-6)
    assert weights.min() > 0.99


def test_ellipse_withstands_a_fifth_of_outliers():
    rng = np.random.default_rng(11)
    t = np.linspace(0, 2 * np.pi, 401)[:-1]
    points = on_ellipse(100, 80, 60, 57, 20, t) + rng.normal(0, 0.1, (400, 2))
    points[40:120] = on_ellipse(100, 80, 66, 63, 20, t[40:120])
    ellipse, weights = fit_ellipse(points)
    assert ellipse.centre_px == pytest.approx((100, 80), abs=0.05)
    assert sorted(ellipse.semi_axes_px) == pytest.approx([57, 60], abs=0.05)
    assert np.all(weights[40:120] == 0)


def test_circle_from_an_arc():
    points = on_ellipse(253, 147, 119, 119, 0, np.linspace(2.6, 6.6, 300))
    circle, _ = fit_circle(points)
    assert circle.circle_px == pytest.approx((253, 147, 119), abs=1e-6)


@pytest.mark.parametrize("centre", [(0, 0, 20), (90, -70, 15), (-120, 95, 10)])
def test_cone_from_exact_outline(bench, centre):
    radius = 18.0
    rays = bench.camera.rays(bench.outline(centre, radius))
    cone, _ = fit_cone(rays, 1 / bench.focal_px)
    computed = bench.eye + radius / cone.sine * cone.axis
    assert np.linalg.norm(computed - centre) < 1e-6


@pytest.mark.parametrize(
    ("centre", "noise_px"),
    [
        pytest.param((0, 0, 18), 0.5, id="on the axis"),
        pytest.param((110, -80, 18), 0.5, id="in a corner"),
        pytest.param((110, -80, 18), 1.5, id="three times the noise"),
    ],
)
def test_the_covariance_of_a_cone(bench, centre, noise_px):
    """The covariance agrees with the scatter of 300 noisy outlines, sideways and in depth.

    The two differ by a factor of 30.
    """
    radius, rng = 18.0, np.random.default_rng(4)
    outline = bench.outline(centre, radius, count=120)
    fits = [
        fit_cone(
            bench.camera.rays(outline + rng.normal(0, noise_px, outline.shape)), 1 / bench.focal_px
        )[0]
        for _ in range(300)
    ]
    places = np.array([cone.axis / cone.sine for cone in fits])
    scatter = np.cov(places.T)
    stated = np.mean([cone.covariance for cone in fits], axis=0)
    toward = (np.asarray(centre, float) - bench.eye) / np.linalg.norm(centre - bench.eye)
    for direction in (toward, *np.linalg.svd(toward[None])[2][1:]):
        assert direction @ stated @ direction == pytest.approx(
            direction @ scatter @ direction, rel=0.3
        )
    # The mean squared Mahalanobis distance of three coordinates is 3.
    off = places - (np.asarray(centre, float) - bench.eye) / radius
    assert np.einsum("na,ab,nb->n", off, np.linalg.inv(stated), off).mean() == pytest.approx(
        3, rel=0.25
    )


def test_points_on_a_line_are_not_an_ellipse():
    points = np.column_stack([np.arange(40.0), np.arange(40.0)])
    with pytest.raises(EstimateError):
        fit_ellipse(points)


def disc(height, width, cx, cy, radius, fine=16):
    """Return the coverage of every pixel by a disc, by supersampling."""
    sub = (np.arange(fine) + 0.5) / fine - 0.5
    y = (np.arange(height)[:, None] + sub).ravel()[:, None]
    x = (np.arange(width)[:, None] + sub).ravel()[None]
    inside = (x - cx) ** 2 + (y - cy) ** 2 < radius**2
    return inside.reshape(height, fine, width, fine).mean(axis=(1, 3))


@pytest.mark.parametrize(
    ("binary", "tolerance"),
    [pytest.param(False, 0.01, id="anti-aliased"), pytest.param(True, 0.06, id="binary")],
)
def test_mask_outline(binary, tolerance):
    mask = disc(90, 110, 52.3, 41.7, 30.4)
    (points,) = mask_outlines(mask > 0.5 if binary else mask)
    ellipse, _ = fit_ellipse(points)
    assert ellipse.circle_px == pytest.approx((52.3, 41.7, 30.4), abs=tolerance)


def test_mask_regions_are_separate_and_specks_dropped():
    mask = np.maximum(disc(80, 160, 40, 40, 25), disc(80, 160, 110, 35, 20))
    mask[2:5, 2:5] = 1
    outlines = mask_outlines(mask)
    radii = sorted(fit_ellipse(points)[0].radius_px for points in outlines)
    assert radii == pytest.approx([20, 25], abs=0.02)


def test_a_sphere_cut_off_by_the_frame_keeps_its_circle():
    mask = disc(80, 100, 10.0, 40.0, 25.0)
    (points,) = mask_outlines(mask)
    circle, _ = fit_circle(points)
    assert circle.circle_px == pytest.approx((10, 40, 25), abs=0.02)


@pytest.mark.parametrize("true_offset", [-0.35, -0.1, 0.0, 0.15, 0.35])
@pytest.mark.parametrize("limb", [-0.3, 0.0, 0.25])
def test_limb_position(true_offset, limb):
    """The edge is located correctly in limb profiles that are integrated and interpolated."""
    offsets = profile_offsets()
    rng = np.random.default_rng(7)
    # A pixel integrates over a box; linear interpolation is a convolution with a triangle.
    sub = rng.uniform(-0.5, 0.5, (3, 20000)).sum(axis=0)
    depth = true_offset - (offsets[:, None] + sub[None])
    inside = 0.3 + limb * np.sqrt(np.clip(depth, 0, None))
    values = np.where(depth > 0, inside, 1.0 - 0.02 * depth).mean(axis=1)
    profile = values[:, None].astype(np.float32)
    blur = estimate_blur(profile)
    assert edge_offsets(profile, blur)[0] == pytest.approx(true_offset, abs=0.06)


@pytest.mark.parametrize("blur", [0.45, 0.8, 1.15])
def test_the_blur_of_a_limb_is_measured(blur):
    rng = np.random.default_rng(3)
    offsets = np.linspace(-0.4, 0.4, 9)
    depth = offsets[:, None, None] - (profile_offsets()[:, None] + rng.normal(0, blur, 20000))
    inside = 0.2 + 0.2 * np.sqrt(np.clip(depth, 0, None))
    profiles = np.where(depth > 0, inside, 0.9).mean(axis=2, dtype=np.float32).T
    assert estimate_blur(profiles) == blur
    np.testing.assert_allclose(edge_offsets(profiles, blur), offsets, atol=0.04)


def test_profiles_cover_the_search_range():
    np.testing.assert_allclose(profile_offsets(), np.arange(-2.5, 2.51, 0.25), atol=1e-12)


@pytest.mark.parametrize(("inside", "outside"), [(0.1, 0.6), (0.7, 0.2)], ids=["dark", "bright"])
def test_refined_outline_of_a_disc(inside, outside):
    rng = np.random.default_rng(5)
    cover = disc(160, 180, 88.37, 79.61, 47.2)
    image = (outside + (inside - outside) * cover + rng.normal(0, 0.004, cover.shape)) + 0.2
    found = refine_outline(image.astype(np.float32), Ellipse.circle(90, 78, 45), 6.0)
    assert found.coverage > 0.95
    assert found.outline.circle_px == pytest.approx((88.37, 79.61, 47.2), abs=0.03)


def test_no_outline_is_an_estimate_error():
    image = np.random.default_rng(2).normal(1, 1e-6, (80, 80)).astype(np.float32)
    image[:] = 1.0
    with pytest.raises(EstimateError, match=r"no sphere outline at \(40, 40\) px"):
        refine_outline(image, Ellipse.circle(40.0, 40.0, 20.0), 4.0)
