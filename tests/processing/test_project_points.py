"""Point clouds drawn as normal maps."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from acquisition import CameraModel, angle_deg
from calibration import EstimateError
from processing import Geometry, project
from processing.projection.point_cloud import draw_points, fit_surfels, orient
from processing.projection.view import fit_raster
from tests.processing.scenes import mesh_named
from tests.quick_sample import quick

CAMERA = CameraModel(np.array([[900.0, 0, 150.3], [0, 880, 121.1], [0, 0, 1]]), 300, 240, 500.0)


def _sphere(count, radius=20.0, seed=0):
    points = np.random.default_rng(seed).normal(size=(count, 3))
    return radius * points / np.linalg.norm(points, axis=1, keepdims=True)


def test_normals_of_a_ball_are_fitted():
    points = _sphere(20_000)
    surfels = fit_surfels(points)
    error = angle_deg(surfels.normals, surfels.points_mm)
    error = np.minimum(error, 180 - error)
    assert error.mean() < 0.02
    assert error.max() < 1
    # On a ball of radius R the normal changes by 1 / R per mm along the surface.
    sign = np.sign((surfels.normals * surfels.points_mm).sum(axis=1))
    turn = sign[:, None, None] * surfels.bends_per_mm
    assert np.median(np.trace(turn, axis1=1, axis2=2)) == pytest.approx(2 / 20.0, rel=0.02)


def test_orientations_are_propagated_from_the_front():
    points = _sphere(5000)
    signs = np.random.default_rng(1).choice([-1.0, 1.0], size=(5000, 1))
    front = points[:, 2] > 17
    normals = points / 20.0 * np.where(front[:, None], 1.0, signs)
    lone = np.array([[0.0, 0.0, 99.0], [1.0, 0.0, 99.0], [0.0, 1.0, 99.0]])
    far = np.concatenate([lone + np.array([0, 0, 3 * k]) for k in range(3)])
    both = np.concatenate([points, far]), np.concatenate([normals, np.tile([0, 0, -1.0], (9, 1))])
    oriented = orient(*both, np.concatenate([front, np.zeros(9, np.bool_)]))
    np.testing.assert_allclose(oriented[:5000], points / 20.0)
    # No path leads to these points, so they do not change.
    np.testing.assert_array_equal(oriented[5000:], both[1][5000:])


def test_the_rim_of_a_ball_does_not_show_its_inside():
    view = project(Geometry(_sphere(30_000)), size=(200, 200), pixel_mm=0.21, centred=False)
    mask = view.normal_map.mask
    x, y = np.meshgrid((np.arange(200) - 99.5), (99.5 - np.arange(200)))
    rim = mask & (np.hypot(x, y) * 0.21 > 19.3)
    assert rim.sum() > 1000
    outward = view.normal_map.normals[..., 0] * x + view.normal_map.normals[..., 1] * y
    assert (outward[rim] > 0).all()


@pytest.mark.parametrize("given", [False, True], ids=["fitted", "normals of the file"])
@pytest.mark.parametrize(
    "camera", quick([None, CAMERA], every=2), ids=["orthographic", "perspective"]
)
def test_a_ball_of_points_in_closed_form(camera, given):
    points = _sphere(30_000)
    cloud = Geometry(points, normals=-points / 20.0 if given else None)
    if camera is None:
        view = project(cloud, size=(200, 200), pixel_mm=0.21, centred=False)
        x, y = np.meshgrid((np.arange(200) - 99.5) * 0.21, (99.5 - np.arange(200)) * 0.21)
        z = np.sqrt(np.maximum(400 - x**2 - y**2, 0))
        inner = x**2 + y**2 < 380
    else:
        view = project(cloud, camera=camera, centred=False)
        rays = camera.pixel_rays()
        # |(0, 0, 500) + s ray| = 20
        a, b, c = (rays**2).sum(axis=-1), -500.0, 500.0**2 - 400
        inner = b**2 - a * c > 20
        s = (-b - np.sqrt(np.maximum(b**2 - a * c, 0))) / a
        x, y, z = np.moveaxis(np.array([0, 0, 500.0]) + s[..., None] * rays, -1, 0)
    assert view.normal_map.mask[inner].all()
    truth = np.stack([x, y, z], axis=-1)[inner]
    error = angle_deg(view.normal_map.normals[inner], truth)
    assert error.mean() < 0.1
    assert error.max() < 3
    assert np.abs(view.height[inner] - z[inner]).mean() < 0.02


@pytest.mark.slow
@pytest.mark.parametrize("name", quick(["torus", "stanford-bunny", "skull"], every=3))
def test_points_on_a_mesh_give_its_normal_map(name):
    solid = mesh_named(name, 256)
    middle = (solid.vertices.min(axis=0) + solid.vertices.max(axis=0)) / 2
    whole = trimesh.Trimesh(solid.vertices - middle, solid.faces, process=False)
    points, _ = trimesh.sample.sample_surface(whole, 100_000, seed=1)
    truth = project(solid, size=(600, 600))
    view = project(
        Geometry(np.asarray(points)), size=(600, 600), pixel_mm=truth.pixel_mm, centred=False
    )
    mask = truth.normal_map.mask
    # Discs extend beyond the outline by about the distance between two points and leave no hole.
    assert (mask & ~view.normal_map.mask).sum() <= 2e-4 * mask.sum()
    assert (view.normal_map.mask & ~mask).sum() < 0.02 * mask.sum()
    both = mask & view.normal_map.mask
    error = angle_deg(view.normal_map.normals[both], truth.normal_map.normals[both])
    assert error.mean() < (0.3 if name == "torus" else 1.8)


def test_duplicates_are_reported_and_change_nothing():
    points = _sphere(3000)
    view = project(Geometry(np.concatenate([points, points[:500]])), size=(80, 80))
    (notice,) = view.warnings
    assert str(notice) == "points left out because they are duplicates: 500"
    np.testing.assert_array_equal(
        view.normal_map.normals, project(Geometry(points), size=(80, 80)).normal_map.normals
    )


def test_three_points_make_a_surface():
    view = project(Geometry([[0, 0, 0], [1, 0, 0], [0, 1, 0.5]]), size=(50, 50))
    normal = view.normal_map.normals[view.normal_map.mask]
    assert angle_deg(normal, [0.0, -0.5, 1.0]).max() < 0.1


def test_isolated_lines_of_points_are_reported():
    line = np.stack([np.arange(100.0), np.zeros(100), np.full(100, 500.0)], axis=1)
    view = project(Geometry(np.concatenate([_sphere(3000), line])), size=(80, 80))
    assert "on a line: 100" in str(view.warnings[0])


@pytest.mark.parametrize(
    ("points", "words"),
    [
        pytest.param([[0, 0, 0], [1, 0, 0]], r"points \(2\)", id="two"),
        pytest.param([[0, 0, 0], [1, 0, 0], [1, 0, 0]], r"points \(2\)", id="two, one twice"),
        pytest.param([[0, 0, 0], [1, 1, 1], [3, 3, 3]], "points are on a line", id="line"),
    ],
)
def test_points_without_a_surface_are_refused(points, words):
    with pytest.raises(EstimateError, match=words):
        project(Geometry(points), pixel_mm=0.1)


def test_points_behind_the_camera_are_reported():
    ball = _sphere(3000)
    away = ball + np.array([0.0, 0.0, 700.0])
    view = project(Geometry(np.concatenate([ball, away])), camera=CAMERA, centred=False)
    assert "behind the camera: 3000" in str(view.warnings[0])
    with pytest.raises(EstimateError, match="all points are behind"):
        project(Geometry(away), camera=CAMERA, centred=False)


def _waves(x, y):
    return np.stack([x, y, np.sin(x / 3)], axis=1), np.stack(
        [-np.cos(x / 3) / 3, 0 * x, 1 + 0 * x], 1
    )


def _error(view, pixel_mm):
    height, width = view.normal_map.mask.shape
    x = np.broadcast_to((np.arange(width) - (width - 1) / 2) * pixel_mm, (height, width))
    inner = np.s_[8:-8, 8:-8]
    truth = np.stack([-np.cos(x / 3) / 3, 0 * x, 1 + 0 * x], axis=-1)
    return np.where(view.normal_map.mask, angle_deg(view.normal_map.normals, truth), 90)[inner]


@pytest.mark.parametrize(("step", "gap"), [(0.1, 1.0), (0.05, 0.7)])
def test_lines_of_a_scanner_become_a_surface(step, gap):
    x, y = (each.ravel() for each in np.meshgrid(np.arange(-9, 9.01, step), np.arange(-9, 9, gap)))
    x = x + np.random.default_rng(0).normal(0, 0.02 * step, x.shape)
    view = project(Geometry(_waves(x, y)[0]), pixel_mm=0.2)
    assert [notice.code for notice in view.warnings] == ["points-in-lines"]
    assert _error(view, 0.2).mean() < 0.5


def test_isolated_points_do_not_count_for_the_extent():
    points = _sphere(4000)
    far = np.array([[900.0, 0, 0], [0, 905, 0], [400, 400, 400], [-700, 0, 0]])
    view = project(Geometry(np.concatenate([points, far])), pixel_mm=0.4)
    assert [str(notice) for notice in view.warnings] == [
        "points left out because they are far from all others: 4"
    ]
    assert max(view.normal_map.mask.shape) < 120


def test_an_uneven_cloud_loses_no_point():
    """The density falls from the middle to the rim, as that of a scanner on a tripod."""
    dice = np.random.default_rng(0)
    r, turn = np.exp(dice.uniform(0, 4, 6000)), dice.uniform(0, 2 * np.pi, 6000)
    x, y = r * np.cos(turn), r * np.sin(turn)
    assert len(fit_surfels(np.stack([x, y, 0.02 * x], axis=1)).points_mm) == 6000


def test_outliers_in_a_room_are_left_out():
    """Some of them are close to the surface, and form a chain to the others."""
    room = np.random.default_rng(1).uniform(-60, 60, (60, 3))
    surfels = fit_surfels(np.concatenate([_sphere(6000), room]))
    assert (np.linalg.norm(surfels.points_mm, axis=1) > 25).sum() < 3


def test_normals_of_two_decimals():
    points = _sphere(6000)
    view = project(Geometry(points, normals=np.round(points / 20.0, 2)), pixel_mm=0.5)
    assert view.normal_map.mask.any()


@pytest.mark.parametrize(
    ("vectors", "doubtful"),
    [
        pytest.param(lambda n: n, False, id="normals"),
        pytest.param(lambda n: -n, False, id="inward"),
        pytest.param(lambda n: np.tile([1.0, 0, 0], (len(n), 1)), True, id="red"),
        pytest.param(lambda n: np.tile([0, 0, 1.0], (len(n), 1)), True, id="blue"),
        pytest.param(lambda n: n[::-1], True, id="of other points"),
    ],
)
def test_vectors_that_are_no_normals_are_not_used(vectors, doubtful):
    points = _sphere(3000)
    surfels = fit_surfels(points, vectors(points / 20.0))
    assert [notice.code for notice in surfels.warnings] == ["point-normals-doubtful"] * doubtful
    index = np.unique(points, axis=0, return_index=True)[1]
    crossed = np.linalg.norm(np.cross(surfels.normals, points[index] / 20.0), axis=1)
    assert np.median(crossed) < 0.02


def test_discs_that_do_not_cover_the_outline_are_named():
    points = np.random.default_rng(0).random((3000, 3)) * [40, 40, 0]
    surfels = fit_surfels(points)
    full = draw_points(surfels, fit_raster(points.min(0), points.max(0), None, 0.05))
    assert not full.warnings
    small = replace(surfels, radii_mm=surfels.radii_mm / 3)
    (notice,) = draw_points(small, fit_raster(points.min(0), points.max(0), None, 0.05)).warnings
    assert notice.code == "outline-not-covered"
