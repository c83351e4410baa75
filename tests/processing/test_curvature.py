"""Curvature from normals, compared with closed forms of spheres, cylinders, saddles and tori."""

import numpy as np
import pytest

from acquisition import CameraModel, DataError
from calibration import EstimateError
from processing import NormalMap
from processing.curvatures import curvature

SIZE = (90, 110)
# X right, Y up, in pixels from the middle.
Y, X = np.meshgrid(np.arange(SIZE[0])[::-1] - 44.5, np.arange(SIZE[1]) - 54.5, indexing="ij")


def monge(p, q, xx, xy, yy):
    """Return normals, mean and Gaussian curvature of a height map from its derivatives."""
    area2 = 1 + p * p + q * q
    normals = np.stack([-p, -q, np.ones_like(p)], axis=-1) / np.sqrt(area2)[..., None]
    mean = -((1 + q * q) * xx - 2 * p * q * xy + (1 + p * p) * yy) / (2 * area2**1.5)
    return normals, mean, (xx * yy - xy * xy) / area2**2


def sphere(radius=100.0):
    z = np.sqrt(radius**2 - X**2 - Y**2)
    return monge(-X / z, -Y / z, -(z**2 + X**2) / z**3, -X * Y / z**3, -(z**2 + Y**2) / z**3)


def bowl():
    normals, mean, gaussian = sphere()
    return normals * [-1, -1, 1], -mean, gaussian


def cylinder(radius=120.0, turn_deg=30.0):
    c, s = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    across = c * X + s * Y
    slope = -across / np.sqrt(radius**2 - across**2)
    bend = -(radius**2) / (radius**2 - across**2) ** 1.5
    return monge(c * slope, s * slope, c * c * bend, c * s * bend, s * s * bend)


def saddle(length=150.0):
    one = np.ones(SIZE) / length
    return monge(X / length, -Y / length, one, 0 * one, -one)


def torus(wide=30.0, tube=14.0):
    """Return the upper half of a torus on a table; its mask leaves out the steep rims."""
    r = np.hypot(X, Y)
    out = r - wide
    inside = np.abs(out) < 0.9 * tube
    out = np.where(inside, out, 0)
    z = np.sqrt(tube**2 - out**2)
    normals = np.stack([out * X / r, out * Y / r, z], axis=-1) / tube
    along = out / tube / (wide + out)
    return normals, (1 / tube + along) / 2, along / tube, inside


# Largest errors relative to the largest curvature: of all pixels, and in the median. Where the
# normals do not change linearly, one-sided windows at the border are less accurate.
SURFACES = {
    "sphere": (sphere, 1e-5, 1e-6),
    "bowl": (bowl, 1e-5, 1e-6),
    "cylinder": (cylinder, 1e-5, 1e-6),
    "saddle": (saddle, 0.015, 5e-4),
    "torus": (torus, 0.12, 2e-3),
}


@pytest.mark.parametrize("name", SURFACES)
def test_closed_forms_up_to_the_border(name):
    made, worst, typical = SURFACES[name]
    normals, mean, gaussian, *inside = made()
    mask = inside[0] if inside else np.ones(SIZE, bool)
    found = curvature(NormalMap.from_vectors(normals, mask), pixel_mm=0.5, scale_px=1.5)
    assert found.unit == "mm"
    assert not (found.mask & ~mask).any()
    assert found.mask.sum() > 0.995 * mask.sum()
    mean, gaussian = mean[found.mask], gaussian[found.mask]
    largest = np.max(np.abs(mean) + np.sqrt(np.maximum(mean**2 - gaussian, 0)))
    for error in (
        np.abs(0.5 * found.mean[found.mask] - mean) / largest,
        np.abs(0.25 * found.gaussian[found.mask] - gaussian) / largest**2,
    ):
        assert error.max() < worst
        assert np.median(error) < typical
    slopes = -normals[..., :2] / normals[..., 2:]
    np.testing.assert_allclose(found.gradient[found.mask], slopes[found.mask], rtol=0.05, atol=0.02)
    for values in (found.mean, found.gaussian, found.direction_deg, found.gradient[..., 0]):
        assert np.isnan(values[~mask]).all()


def test_the_directions_of_a_cylinder_and_a_saddle():
    found = curvature(NormalMap.from_vectors(cylinder()[0]))
    np.testing.assert_allclose(found.direction_deg, 30, atol=0.1)
    largest, least = found.principal
    np.testing.assert_allclose(largest, 1 / 120, rtol=1e-3)
    np.testing.assert_allclose(least, 0, atol=1e-5)
    # The saddle rises along X and falls along Y, so it is convex along Y.
    middle = curvature(NormalMap.from_vectors(saddle()[0])).direction_deg[40:50, 50:60]
    np.testing.assert_allclose(middle, 90, atol=1)


@pytest.mark.parametrize("scale", [0.3, 1.0, 2.0, 6.0])
def test_what_is_outside_the_mask_takes_no_part(scale):
    normals, mean, _ = sphere()
    mask = np.hypot(X - 10, Y + 5) < 35
    mask[40:44, 20:] = False
    mask[:, 60] = False
    leaking = np.where(mask[..., None], normals, [0.8, 0.0, 0.6])
    found = curvature(NormalMap.from_vectors(leaking, mask), scale_px=scale)
    assert found.mask.sum() > 0.99 * mask.sum()
    np.testing.assert_allclose(found.mean[found.mask], mean[found.mask], rtol=1e-4)


def test_pixels_on_a_line_have_no_curvature():
    mask = np.zeros(SIZE, bool)
    mask[20, 10:60] = True  # a row
    mask[range(40, 70), range(10, 40)] = True  # a diagonal
    mask[60:64, 80:84] = True
    found = curvature(NormalMap.from_vectors(sphere()[0], mask), scale_px=1.0)
    assert found.mask.sum() == 16
    mask[60:64, 80:84] = False
    with pytest.raises(EstimateError, match="not on a line"):
        curvature(NormalMap.from_vectors(sphere()[0], mask), scale_px=1.0)


@pytest.mark.parametrize("scale", [1.0, 2.0, 4.0])
def test_noise_is_that_of_the_law(scale):
    sigma = np.radians(0.5)
    rng = np.random.default_rng(5)
    normals = np.tile([0.0, 0.0, 1.0], (256, 256, 1))
    normals[..., :2] += sigma * rng.normal(size=(256, 256, 2))
    found = curvature(NormalMap.from_vectors(normals), scale_px=scale)
    inner = found.mean[30:-30, 30:-30]
    expected = sigma / (np.sqrt(16 * np.pi) * scale**2)
    assert inner.std() == pytest.approx(expected, rel=0.1)
    # The Gaussian curvature of noise has the mean 0: it is a sum of products of independent errors.
    assert abs(found.gaussian[30:-30, 30:-30].mean()) < 0.2 * expected**2


def test_waves_are_damped_by_the_scale():
    length = 20.0
    steep = 0.02 * np.cos(2 * np.pi * X / length)
    normals = np.stack([-steep, 0 * X, np.sqrt(1 - steep**2)], axis=-1)
    amplitudes = [
        np.nanmax(curvature(NormalMap.from_vectors(normals), scale_px=s).mean[30:60, 30:80])
        for s in (0.3, 4.0)
    ]
    assert amplitudes[1] / amplitudes[0] == pytest.approx(np.exp(-19.7 * (4 / 20) ** 2), rel=0.05)


def camera(distortion=None):
    K = np.array([[400.0, 0.5, 53.0], [0, 410.0, 46.0], [0, 0, 1]])
    return CameraModel(
        K, SIZE[1], SIZE[0], distortion=distortion or (0,) * 5, working_distance_mm=300.0
    )


@pytest.mark.parametrize("distortion", [None, (-0.2, 0.1)])
@pytest.mark.parametrize("height", [0.0, 40.0])
def test_a_ball_in_a_perspective_view(distortion, height):
    """Seen from 300 mm, with its centre off the axis; without the depth the scale is wrong."""
    eye = camera(distortion)
    radius, centre = 90.0, np.array([8.0, -5.0, height - 90.0])
    rays, toward = eye.pixel_rays(), eye.centre_mm - centre
    along, square = rays @ toward, np.sum(rays**2, axis=-1)
    depth = (-along - np.sqrt(along**2 - square * (toward @ toward - radius**2))) / square
    normals = (eye.points_at(depth) - centre) / radius
    found = curvature(NormalMap.from_vectors(normals), camera=eye, depth_mm=depth, scale_px=1.0)
    for inside, tolerance in ((slice(None), 0.01), (slice(5, -5), 1e-3)):
        part = inside, inside
        np.testing.assert_allclose(found.mean[part], 1 / radius, rtol=tolerance)
        np.testing.assert_allclose(found.gaussian[part], 1 / radius**2, rtol=2 * tolerance)
    slopes = -normals[..., :2] / normals[..., 2:]
    np.testing.assert_allclose(found.gradient, slopes, atol=2e-3)
    on_plane = curvature(NormalMap.from_vectors(normals), camera=eye, scale_px=1.0)
    np.testing.assert_allclose(on_plane.mean, found.mean * depth / 300, rtol=1e-5)


def test_a_tilted_plane_in_a_perspective_view_is_flat():
    normals = np.tile([0.6, -0.2, 0.7], (*SIZE, 1))
    found = curvature(NormalMap.from_vectors(normals), camera=camera())
    assert np.abs(found.mean).max() < 1e-7


def test_rows_of_large_maps_fit_together():
    y, x = np.mgrid[:600, :40].astype(float)
    normals = np.stack([np.sin(x / 9) / 4, np.cos(y / 8) / 4, np.ones_like(x)], axis=-1)
    whole = curvature(NormalMap.from_vectors(normals), scale_px=3.0)
    part = curvature(NormalMap.from_vectors(normals[200:330]), scale_px=3.0)
    np.testing.assert_allclose(part.mean[17:-17], whole.mean[217:313], atol=1e-9)


def test_units():
    normal_map = NormalMap.from_vectors(sphere()[0])
    assert curvature(normal_map).unit == "px"
    assert np.median(curvature(normal_map).mean) == pytest.approx(0.01, rel=1e-4)
    assert np.median(curvature(normal_map, pixel_mm=0.1).mean) == pytest.approx(0.1, rel=1e-4)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"scale_px": 0.0}, "a scale of 0.0 pixels is not within 0.3 to 100"),
        ({"scale_px": float("nan")}, "a scale of nan pixels"),
        ({"pixel_mm": 0.1, "camera": camera()}, "exclude each other"),
        ({"pixel_mm": -1.0}, "not a positive length"),
        ({"camera": camera().cropped(0, 0, 20, 30)}, "20 x 30 pixels does not fit"),
        ({"camera": camera(), "depth_mm": np.ones((3, 3))}, "depths of shape"),
        ({"camera": camera(), "depth_mm": -np.ones(SIZE)}, "must be positive"),
        ({"depth_mm": np.ones(SIZE)}, "require a camera with a working distance"),
    ],
)
def test_bad_input(options, message):
    with pytest.raises(DataError, match=message):
        curvature(NormalMap.from_vectors(sphere()[0]), **options)
