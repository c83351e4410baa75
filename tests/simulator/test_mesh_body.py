"""Meshes: comparison with the ray casting of other programs and closed forms; invalid files."""

import math
import os
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh

from acquisition import DataError, MissingPathError
from simulator.shapes import MeshBody
from simulator.shapes.mesh import read_triangles
from tests.quick_sample import quick

MESHES = ("stanford-bunny", "decimated-max", "skull")
H, W, FOCAL, EYE = 360, 400, 1000.0, np.array([0.0, 0.0, 600.0])


def _body(name, **more):
    if name == "torus":
        ring = trimesh.creation.torus(2.0, 0.8, major_sections=64, minor_sections=32)
        # Rotated and shifted, so that no edge passes through the centres of pixels.
        vertices = _moved(ring.vertices @ _turn(0.2), 25.0, (0.3, -0.7, 40.0))
        return MeshBody(vertices, np.asarray(ring.faces), **more)
    if "SGP_DATA" not in os.environ:
        pytest.skip("SGP_DATA is not set")
    path = Path(os.environ["SGP_DATA"]) / "meshes" / f"{name}.obj"
    if not path.exists():
        pytest.skip(f"{path} does not exist")
    return MeshBody.read(path, radius_mm=80.0, **more)


def _moved(vertices, scale, shift):
    return scale * np.asarray(vertices) + np.array(shift)


def _turn(angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ np.array(
        [[c, 0, s], [0, 1, 0], [-s, 0, c]]
    )


def _camera_rays():
    v, u = np.mgrid[:H, :W].astype(float)
    x, y = (u - (W - 1) / 2) / FOCAL, ((H - 1) / 2 - v) / FOCAL
    return np.stack([x, y, np.full_like(x, -1.0)], axis=-1)


def _angle_deg(a, b):
    cross = np.linalg.norm(np.cross(a, b), axis=-1)
    return np.degrees(np.arctan2(cross, (a * b).sum(axis=-1)))


def _rasterised(body, normals):
    """Draw normals of all triangle corners (3 F, 3) with OpenCV: hit, normals, depth."""
    corners = body.vertices_mm[body.faces].reshape(-1, 1, 3).astype(np.float32)
    numbers = np.arange(len(corners), dtype=np.int32).reshape(-1, 1, 3)
    to_camera = np.eye(4, dtype=np.float32)
    to_camera[2, 3] = -EYE[2]
    how = cv2.TriangleRasterizeSettings()
    how.setCullingMode(cv2.RASTERIZE_CULLING_NONE)
    how.setShadingType(cv2.RASTERIZE_SHADING_SHADED)
    far = 1000.0
    colours, depth = cv2.triangleRasterize(
        corners,
        numbers,
        normals.reshape(-1, 1, 3).astype(np.float32),
        np.zeros((H, W, 3), np.float32),
        np.full((H, W), far, np.float32),
        to_camera,
        2 * math.atan(H / 2 / FOCAL),
        100.0,
        far,
        how,
    )
    return depth < 0.99 * far, colours, depth


@pytest.mark.parametrize("name", quick(["torus", *MESHES], every=4))
@pytest.mark.parametrize("smooth", [False, True], ids=["flat", "smooth"])
def test_normal_map_agrees_with_a_rasteriser(name, smooth):
    body = _body(name, smooth=smooth)
    if smooth:
        normals = body.vertex_normals[body.faces]
    else:
        normals = np.repeat(body.face_normals[:, None], 3, axis=1)
    hit, expected, depth = _rasterised(body, normals)
    rays = _camera_rays()
    hits = body.trace(EYE, rays)
    assert hit.mean() > 0.2
    # With float32, a pixel may be on the other side of a silhouette or an edge.
    assert (hits.hit != hit).sum() <= 3
    seen = hits.hit & hit
    # The resolution of its depth buffer is about 0.03 mm at 600 mm.
    apart = np.abs(EYE[2] - hits.points_mm[..., 2] - depth)[seen]
    assert np.percentile(apart, 99.9) < 0.1
    expected = expected / np.maximum(np.linalg.norm(expected, axis=-1, keepdims=True), 1e-9)
    # A smooth normal that is flipped with its face may differ in sign.
    flipped = _angle_deg(hits.normals, -expected)
    error = np.minimum(_angle_deg(hits.normals, expected), flipped)[seen]
    assert (error < 0.01).mean() > 0.999
    # The remaining ones are on edges of triangles, where float32 may choose the other side.
    _, weights, _ = body.tree.closest(np.tile(EYE, (seen.sum(), 1)), rays[seen])
    assert error[weights.min(axis=1) > 0.01].max() < 0.01


class _Boxes:
    """Replaces trimesh's rtree: candidates are triangles whose box overlaps the ray's box."""

    def __init__(self, triangles):
        self.low, self.high = triangles.min(axis=1), triangles.max(axis=1)
        self.bounds = np.concatenate([self.low.min(axis=0), self.high.max(axis=0)])

    def intersection(self, box):
        return np.flatnonzero(((self.low <= box[3:]) & (self.high >= box[:3])).all(axis=1))


@pytest.mark.parametrize(
    "name", ["torus", *(pytest.param(name, marks=pytest.mark.slow) for name in MESHES)]
)
def test_normal_map_agrees_with_trimesh_ray_casting(name):
    body = _body(name, smooth=False)
    mesh = trimesh.Trimesh(body.vertices_mm, body.faces, process=False)
    rays = _camera_rays()[::10, ::10].reshape(-1, 3)
    hits = body.trace(EYE, rays)
    triangles = np.asarray(mesh.triangles)
    face, ray, places = trimesh.ray.ray_triangle.ray_triangle_id(
        triangles, np.tile(EYE, (len(rays), 1)), rays, tree=_Boxes(triangles)
    )
    order = np.lexsort((np.linalg.norm(places - EYE, axis=1), ray))
    nearest = order[np.unique(ray[order], return_index=True)[1]]
    assert len(nearest) > 200
    np.testing.assert_array_equal(np.flatnonzero(hits.hit), ray[nearest])
    np.testing.assert_allclose(hits.points_mm[hits.hit], places[nearest], atol=1e-6)
    error = _angle_deg(hits.normals[hits.hit], np.asarray(mesh.face_normals)[face[nearest]])
    assert np.minimum(error, 180 - error).max() < 0.01
    assert (hits.normals * rays).sum(axis=1)[hits.hit].max() < 0


def test_a_smooth_sphere_has_the_normals_of_a_sphere():
    ball = trimesh.creation.icosphere(subdivisions=4, radius=50.0)
    body = MeshBody(_moved(ball.vertices, 1.0, (0, 0, 50.0)), np.asarray(ball.faces))
    hits = body.trace(EYE, _camera_rays())
    centre = np.array([0, 0, 50.0])
    radial = hits.points_mm[hits.hit] - centre
    # Facets are 4 degrees wide; interpolated normals have much smaller errors.
    assert _angle_deg(hits.normals[hits.hit], radial).max() < 0.15
    # An edge of 4.4 degrees, seen from the centre, sags by r (1 - cos 2.6) within its face.
    assert np.linalg.norm(radial, axis=1).min() > 50 * math.cos(math.radians(2.8))
    np.testing.assert_allclose(np.linalg.norm(hits.normals[hits.hit], axis=1), 1.0, rtol=1e-12)
    sine = math.sin(math.atan2(50.0, math.sqrt(550.0**2 - 50.0**2)))
    covered = hits.hit.sum() / FOCAL**2
    assert covered == pytest.approx(math.pi * sine**2 / (1 - sine**2), rel=0.01)


def test_vertex_normals_agree_with_trimesh():
    ring = trimesh.creation.torus(2.0, 0.8)
    body = MeshBody(np.asarray(ring.vertices), np.asarray(ring.faces))
    np.testing.assert_allclose(body.vertex_normals, ring.vertex_normals, atol=1e-9)
    np.testing.assert_allclose(body.face_normals, ring.face_normals, atol=1e-9)


def test_cube_has_flat_sides_and_known_heights():
    box = trimesh.creation.box((40.0, 40.0, 30.0))
    body = MeshBody(_moved(box.vertices, 1.0, (0, 0, 15.0)), np.asarray(box.faces), smooth=False)
    assert body.top_mm == 30.0
    assert body.radius_mm == pytest.approx(20 * math.sqrt(2))
    x, y = np.array([0.0, 19.9, 20.1, 0.0]), np.array([0.0, -19.9, 0.0, 25.0])
    assert body.inside(x, y).tolist() == [True, True, False, False]
    origins = np.array([[5.0, 7.0, 100.0], [-60.0, 3.0, 10.0], [0.0, 60.0, 100.0]])
    directions = np.array([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    hits = body.trace(origins, directions)
    assert hits.hit.tolist() == [True, True, False]
    np.testing.assert_allclose(hits.points_mm, [[5, 7, 30], [-20, 3, 10], [0, 0, 0]], atol=1e-12)
    np.testing.assert_allclose(hits.normals, [[0, 0, 1], [-1, 0, 0], [0, 0, 0]], atol=1e-12)


@pytest.mark.parametrize("smooth", [False, True])
def test_a_mesh_with_opposite_winding_looks_the_same(smooth):
    body = _body("torus", smooth=smooth)
    turned = MeshBody(body.vertices_mm, body.faces[:, ::-1], smooth=smooth)
    rays = _camera_rays()[::5, ::5]
    a, b = body.trace(EYE, rays), turned.trace(EYE, rays)
    np.testing.assert_array_equal(a.hit, b.hit)
    np.testing.assert_allclose(a.normals, b.normals, atol=1e-12)


def test_shadow_caster_is_the_tree():
    body = _body("torus")
    lamp = np.array([0.0, 0.0, 400.0])
    points = np.array([[50.0, 0.0, 0.0], [0.0, 0.0, 0.0], [200.0, 0.0, 0.0]])
    blocked = body.shadow_caster(0.5).blocked(points, lamp - points)
    assert blocked.tolist() == [True, False, False]


PYRAMID = np.array([[0, 0, 0], [4, 0, 0], [4, 2, 0], [0, 2, 0], [2, 1, 3.0]])
SIDES = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])


def _file(folder, kind, vertices=PYRAMID, faces=SIDES):
    path = folder / f"pyramid.{kind}"
    trimesh.Trimesh(vertices, faces, process=False).export(path)
    return path


@pytest.mark.parametrize("kind", ["obj", "ply", "stl"])
def test_read_places_the_mesh_in_the_middle_of_the_board(tmp_path, kind):
    body = MeshBody.read(_file(tmp_path, kind), radius_mm=50.0)
    low, high = body.vertices_mm.min(axis=0), body.vertices_mm.max(axis=0)
    np.testing.assert_allclose(low[:2], -high[:2], atol=1e-5)
    assert low[2] == pytest.approx(0.0, abs=1e-6)
    assert body.radius_mm == pytest.approx(50.0)
    scale = 50.0 / math.sqrt(5)
    assert body.top_mm == pytest.approx(3 * scale, rel=1e-6)
    assert len(body.faces) == 4
    # STL vertices are merged, so that normals can be interpolated.
    assert len(body.vertices_mm) == 5


def test_read_rotates_the_mesh_before_scaling(tmp_path):
    path = _file(tmp_path, "ply")
    tipped = MeshBody.read(path, radius_mm=50.0, turn_deg=(90.0, 0.0, 0.0), smooth=False)
    # Its y axis now points up: it is on its long side, 2 high, with its tip at -Y.
    scale = 50.0 / math.hypot(2.0, 1.5)
    assert tipped.top_mm == pytest.approx(2 * scale, rel=1e-6)
    assert tipped.vertices_mm[4] == pytest.approx([0.0, -1.5 * scale, scale], rel=1e-6, abs=1e-4)
    around = MeshBody.read(path, radius_mm=50.0, turn_deg=(0.0, 0.0, 90.0))
    flat = MeshBody.read(path, radius_mm=50.0)
    x, y, z = flat.vertices_mm.T
    np.testing.assert_allclose(around.vertices_mm, np.stack([-y, x, z], axis=1), atol=1e-5)


def test_quads_are_triangulated(tmp_path):
    path = tmp_path / "quad.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n")
    vertices, faces = read_triangles(path)
    assert faces.shape == (2, 3)
    assert len(np.unique(faces)) == len(vertices) == 4


@pytest.mark.parametrize(
    ("name", "content"),
    [
        pytest.param("broken.ply", b"ply\nformat binary_little_endian 1.0\nelement", id="cut"),
        pytest.param("noise.stl", bytes(range(256)) * 3, id="noise"),
        pytest.param("empty.obj", b"", id="empty"),
        pytest.param("words.obj", b"v a b c\nf 1 2 3\n", id="words"),
        pytest.param("points.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\n", id="points-only"),
        pytest.param("nan.obj", b"v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", id="nan"),
        pytest.param("far.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", id="missing-vertex"),
        pytest.param("thin.obj", b"v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", id="no-area"),
        pytest.param("mesh.txt", b"v 0 0 0\n", id="suffix"),
    ],
)
def test_an_invalid_file_is_named_in_one_line(tmp_path, name, content):
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(DataError, match=name) as caught:
        MeshBody.read(path, radius_mm=10.0)
    assert "\n" not in str(caught.value)


def test_a_missing_file_is_reported(tmp_path):
    with pytest.raises(MissingPathError, match=r"none\.obj"):
        MeshBody.read(tmp_path / "none.obj", radius_mm=10.0)


@pytest.mark.parametrize("radius", [0.0, -1.0, math.nan])
def test_an_invalid_placement_is_reported_in_one_line(tmp_path, radius):
    path = _file(tmp_path, "obj")
    with pytest.raises(DataError, match="must be a positive length"):
        MeshBody.read(path, radius_mm=radius)
    with pytest.raises(DataError, match="three angles"):
        MeshBody.read(path, radius_mm=9.0, turn_deg=(0.0, math.nan, 0.0))
