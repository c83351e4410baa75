"""Point clouds drawn as normal maps."""

import os
from pathlib import Path

import numpy as np
import pytest
import trimesh

from acquisition import CameraModel
from calibration import EstimateError
from processing import Geometry, angle_deg, project, read_geometry
from processing._projection.point_cloud import fit_surfels
from processing._projection.point_cloud_orient import orient
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
    if name == "torus":
        ring = trimesh.creation.torus(20.0, 8.0, major_sections=256, minor_sections=128)
        mesh = Geometry(ring.vertices, ring.faces)
    else:
        if "SGP_DATA" not in os.environ:
            pytest.skip("SGP_DATA is not set")
        path = Path(os.environ["SGP_DATA"]) / "meshes" / f"{name}.obj"
        if not path.exists():
            pytest.skip(f"{path} is not there")
        mesh = read_geometry(path)
    middle = (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2
    whole = trimesh.Trimesh(mesh.vertices - middle, mesh.faces, process=False)
    points, _ = trimesh.sample.sample_surface(whole, 100_000, seed=1)
    truth = project(mesh, size=(600, 600))
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
