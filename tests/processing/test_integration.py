from __future__ import annotations

import cv2
import numpy as np
import pytest

from acquisition import CameraModel, DataError
from calibration import EstimateError
from processing import HeightMap, NormalMap, integrate
from rig.arrays import Float64
from tests.quick_sample import quick
from tests.real_data import DATA, needs_data


def grid(rows: int, columns: int) -> tuple[Float64, Float64]:
    """Return X (right) and Y (up) of every pixel, in pixels from the image centre."""
    r, c = np.mgrid[:rows, :columns].astype(np.float64)
    return c - (columns - 1) / 2, (rows - 1) / 2 - r


def camera(rows: int = 90, columns: int = 120, distance: float | None = 400.0) -> CameraModel:
    K = np.array([[310.0, 0.7, 63.2], [0, 295.0, 41.9], [0, 0, 1]])
    return CameraModel(K, columns, rows, distance, np.array([-0.1, 0.05, 1e-3, -2e-3, 0]))


def off(surface: HeightMap, truth: Float64) -> float:
    """Return the largest deviation from the truth, up to a constant, relative to its range."""
    error = (surface.height.astype(np.float64) - truth)[surface.mask]
    return float(np.ptp(error) / 2 / np.ptp(truth[surface.mask]))


def bump(rows: int = 160, columns: int = 200) -> tuple[NormalMap, Float64]:
    """Return a Gaussian hill to the right of and above the centre."""
    x, y = grid(rows, columns)
    z = 25 * np.exp(-((x - 30) ** 2 + (y - 20) ** 2) / 1000)
    slopes = [(x - 30) / 500 * z, (y - 20) / 500 * z, np.ones_like(z)]
    return NormalMap.from_vectors(np.stack(slopes, axis=2)), z


def test_a_hill_is_raised_at_its_position() -> None:
    normal_map, truth = bump()
    surface = integrate(normal_map)
    assert off(surface, truth) < 1e-3
    row, column = np.unravel_index(np.nanargmax(surface.height), truth.shape)
    assert (row, column) == np.unravel_index(truth.argmax(), truth.shape)
    assert row < 80
    assert column > 100
    assert surface.unit == "px"
    assert surface.depth is None
    assert surface.warnings == ()
    assert abs(surface.height.mean()) < 1e-4


@pytest.mark.parametrize(
    "normal", [(0, 0, 1), (0.36, 0.48, 0.8), (-0.8, 0.1, 0.59), (0, 0.99, 0.14)]
)
def test_orthographic_planes_are_exact(normal: tuple[float, float, float]) -> None:
    rng = np.random.default_rng(1)
    n = np.array(normal) / np.linalg.norm(normal)
    x, y = grid(60, 80)
    normal_map = NormalMap.from_vectors(np.broadcast_to(n, (60, 80, 3)), rng.random((60, 80)) < 0.9)
    surface = integrate(normal_map, pixel_mm=0.25)
    truth = -0.25 * (n[0] * x + n[1] * y) / n[2]
    main = surface.parts == np.bincount(surface.parts[surface.mask]).argmax()
    error = (surface.height - truth)[main]
    assert np.ptp(error) <= 1e-5 * max(float(np.ptp(truth)), 1.0)
    assert surface.unit == "mm"
    assert surface.pixel_size == 0.25


@pytest.mark.parametrize("normal", [(0.05, -0.1, 1), (0.5, 0.3, 0.7), (-0.6, 0.2, 0.6)])
def test_perspective_planes_are_exact(normal: tuple[float, float, float]) -> None:
    cam = camera()
    n = np.array(normal) / np.linalg.norm(normal)
    rays = cam.pixel_rays()
    depth = -n[2] / (rays @ n)  # n . (P - centre) = -n_z: a plane that intersects the axis
    surface = integrate(NormalMap.from_vectors(np.broadcast_to(n, rays.shape)), camera=cam)
    assert surface.depth is not None
    truth = depth * (400 / depth.mean())
    np.testing.assert_allclose(surface.depth, truth, rtol=1e-5)
    np.testing.assert_allclose(surface.height, 400 - truth, atol=1e-5 * 400)
    points = surface.points()
    np.testing.assert_allclose(points, cam.centre_mm + truth[..., None] * rays, atol=5e-3)
    np.testing.assert_allclose((points - points[0, 0]) @ n, 0, atol=5e-3)


def test_orthographic_spheres_are_exact() -> None:
    x, y = grid(121, 121)
    inside = x**2 + y**2 < 58**2
    z = np.sqrt(np.where(inside, 60**2 - x**2 - y**2, 1))
    surface = integrate(NormalMap.from_vectors(np.stack([x, y, z], axis=2), inside))
    assert off(surface, z) < 1e-5


def test_perspective_spheres_are_exact() -> None:
    cam = camera()
    rays, centre = cam.pixel_rays(), cam.centre_mm
    sphere, radius = np.array([5.0, -8.0, 10.0]), 50.0
    # |centre + d ray - sphere| = radius, the nearer of the two solutions.
    a = np.einsum("ijk,ijk->ij", rays, rays)
    h = rays @ (centre - sphere)
    inside = h**2 - a * ((centre - sphere) @ (centre - sphere) - radius**2)
    mask = inside > 0.02 * inside.max()
    depth = (-h - np.sqrt(np.where(mask, inside, 0))) / a
    normals = (centre + depth[..., None] * rays - sphere) / radius
    surface = integrate(NormalMap.from_vectors(normals, mask), camera=cam)
    assert surface.depth is not None
    truth = depth * (400 / depth[mask].mean())
    np.testing.assert_allclose(surface.depth[mask], truth[mask], rtol=2e-6)
    assert np.isnan(surface.depth[~mask]).all()
    assert np.isnan(surface.height[~mask]).all()


def test_a_smooth_surface_in_perspective() -> None:
    cam = camera(rows=180, columns=240)
    x, y = grid(180, 240)
    log_depth = 0.05 * np.sin(x / 40) * np.cos(y / 30) + x / 2000
    depth = 400 * np.exp(log_depth)
    points = cam.centre_mm + depth[..., None] * cam.pixel_rays()
    # Columns increase to the right and rows downwards: the normal toward the camera is right x up.
    right, down = np.gradient(points, axis=1), np.gradient(points, axis=0)
    normals = np.cross(right, -down)
    assert (normals[..., 2] > 0).all()
    surface = integrate(NormalMap.from_vectors(normals), camera=cam)
    assert surface.depth is not None
    truth = depth * (400 / depth.mean())
    assert np.abs(surface.depth - truth).max() < 2e-3 * np.ptp(truth)


@pytest.mark.parametrize(
    ("distance", "pixel_mm", "unit", "pixel_size", "mean_depth"),
    [
        pytest.param(400.0, None, "mm", 400 / np.sqrt(310 * 295), 400.0, id="working distance"),
        pytest.param(None, 0.5, "mm", 0.5, 0.5 * np.sqrt(310 * 295), id="pixel size"),
        pytest.param(None, None, "px", 1.0, np.sqrt(310 * 295), id="no scale"),
    ],
)
def test_perspective_scale(
    distance: float | None, pixel_mm: float | None, unit: str, pixel_size: float, mean_depth: float
) -> None:
    normal_map = NormalMap.from_vectors(np.broadcast_to((0.3, 0.1, 0.95), (90, 120, 3)))
    surface = integrate(normal_map, camera=camera(distance=distance), pixel_mm=pixel_mm)
    assert surface.unit == unit
    assert surface.pixel_size == pytest.approx(pixel_size)
    assert surface.depth is not None
    assert surface.depth.mean(dtype=np.float64) == pytest.approx(mean_depth, rel=1e-6)
    # The distance of neighbouring points near the axis is about a pixel size (the plane is tilted).
    points = surface.points()
    assert points[42, 64, 0] - points[42, 63, 0] == pytest.approx(pixel_size, rel=0.1)


def test_orthographic_points_are_centred_on_the_axis() -> None:
    normal_map, _ = bump()
    surface = integrate(normal_map, pixel_mm=0.5)
    points = surface.points()
    np.testing.assert_allclose(points[0, 0, :2], [-99.5 * 0.5, 79.5 * 0.5])
    np.testing.assert_allclose(points[159, 199, :2], [99.5 * 0.5, -79.5 * 0.5])
    np.testing.assert_array_equal(points[..., 2], surface.height)


def test_parts_and_isolated_pixels_are_reported() -> None:
    normal_map, truth = bump()
    mask = np.zeros(truth.shape, bool)
    mask[10:150, 10:90] = mask[10:150, 110:190] = True
    mask[5, 5] = mask[3, 100] = True
    surface = integrate(NormalMap.from_vectors(normal_map.normals, mask))
    assert len(surface.warnings) == 2
    assert "2 parts" in str(surface.warnings[0])
    assert "2 pixels of the mask are isolated" in str(surface.warnings[1])
    assert not surface.mask[5, 5]
    assert np.isnan(surface.height[5, 5])
    assert set(np.unique(surface.parts)) == {-1, 0, 1}
    for part in (0, 1):
        inside = surface.parts == part
        assert abs(surface.height[inside].mean(dtype=np.float64)) < 1e-5
        assert np.ptp((surface.height - truth)[inside]) < 0.02


def test_pixels_that_face_away_are_left_out() -> None:
    normal_map, truth = bump()
    normals = normal_map.normals.copy()
    normals[40:60, 40:60] *= -1
    surface = integrate(NormalMap.from_vectors(normals))
    assert not surface.mask[41:59, 41:59].any()
    assert "face away from the camera" in str(surface.warnings[-1])
    assert off(surface, truth) < 0.01


@pytest.mark.parametrize("with_camera", [False, True])
def test_errors_from_noise_and_steep_edges_remain_local(with_camera: bool) -> None:
    rng = np.random.default_rng(5)
    x, y = grid(160, 200)
    # A dome on a plate with a nearly vertical wall: the normals of the wall are the least certain.
    radius2 = x**2 + y**2
    z = np.sqrt(np.maximum(70.0**2 - radius2, 4.0))
    vectors = np.stack([x, y, z], axis=2) / np.sqrt(x**2 + y**2 + z**2)[..., None]
    mask = radius2 < 69.9**2
    noisy = NormalMap.from_vectors(vectors + 0.02 * rng.normal(size=vectors.shape), mask)
    # A distant camera has practically the same view.
    far = CameraModel(np.array([[1e5, 0, 99.5], [0, 1e5, 79.5], [0, 0, 1]]), 200, 160)
    surface = integrate(noisy, camera=far if with_camera else None)
    error = (surface.height - z)[surface.mask]
    assert np.abs(error - np.median(error)).mean() < 0.01 * 70


REFUSED: dict[str, tuple[dict[str, object], str]] = {
    "pixel zero": ({"pixel_mm": 0.0}, "not a positive length"),
    "pixel nan": ({"pixel_mm": float("nan")}, "not a positive"),
    "size": ({"camera": camera(91)}, "120 x 91 pixels does not fit"),
    "two scales": ({"camera": camera(), "pixel_mm": 0.1}, "give only one"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_integrate_refuses(name: str) -> None:
    options, text = REFUSED[name]
    normal_map = NormalMap.from_vectors(np.broadcast_to((0.0, 0.0, 1.0), (90, 120, 3)))
    with pytest.raises(DataError, match=text):
        integrate(normal_map, **options)  # type: ignore[arg-type]


@pytest.mark.parametrize("with_camera", [False, True])
def test_a_map_that_faces_away_has_no_surface(with_camera: bool) -> None:
    normal_map = NormalMap.from_vectors(np.broadcast_to((0.0, 0.6, -0.8), (90, 120, 3)))
    with pytest.raises(EstimateError, match="no two neighbouring pixels"):
        integrate(normal_map, camera=camera() if with_camera else None)


def test_implausible_depths_are_refused() -> None:
    wide = CameraModel(np.array([[300.0, 0, 2000], [0, 300.0, 1], [0, 0, 1]]), 4000, 3)
    # A surface nearly parallel to every ray: the depth grows like a logarithmic spiral.
    rays = wide.pixel_rays()
    along = np.stack([np.ones((3, 4000)), np.zeros((3, 4000)), rays[..., 0]], axis=2)
    with pytest.raises(EstimateError, match="camera matrix does not belong"):
        integrate(NormalMap.from_vectors(10 * along - rays), camera=wide)


# Large limits: least squares cannot recover depth steps at occlusions.
# The depths of all objects are compared in tests/benchmarks/test_paper_tables.py.
LIMITS_MM = {"bear": 1.2, "cow": 0.89}


@needs_data
@pytest.mark.parametrize("name", quick(LIMITS_MM, every=2))
def test_real_depth(name: str) -> None:
    folder = DATA / "normals" / "diligent" / name
    image = cv2.imread(str(folder / "normal_map.png"), cv2.IMREAD_UNCHANGED)
    mask = cv2.imread(str(folder / "mask.png"), cv2.IMREAD_GRAYSCALE) > 127
    normal_map = NormalMap.from_vectors(image[..., 2::-1].astype(np.float64) / 65535 * 2 - 1, mask)
    truth = np.load(folder / "depth_gt.npz")["depth_gt"].astype(np.float64)
    surface = integrate(normal_map, camera=CameraModel(np.loadtxt(folder / "K.txt"), 612, 512))
    np.testing.assert_array_equal(surface.mask, mask)
    assert surface.depth is not None
    valid = mask & np.isfinite(truth)
    depth, true = surface.depth[valid].astype(np.float64), truth[valid]
    depth *= np.median(true / depth)
    assert np.abs(depth - true).mean() <= LIMITS_MM[name]
    # The part nearest to the camera is also nearest in the truth, so the relief is not inverted.
    assert np.corrcoef(depth, true)[0, 1] > 0.75
