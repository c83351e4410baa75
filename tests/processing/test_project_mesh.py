"""Meshes drawn as normal maps: closed forms, a ray caster, shared edges, odd meshes."""

from itertools import product

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import Delaunay

from acquisition import CameraModel, DataError, angle_deg
from calibration import EstimateError
from processing import Geometry, project
from processing.projection import rasterize_kernels as kernels
from processing.projection import view_rotation
from processing.projection.rasterize import crease_angle_deg
from rig import in_threads
from simulator.shapes.bvh import TriangleTree
from tests.processing.scenes import mesh_named, one_thread
from tests.quick_sample import quick

CAMERA = CameraModel(np.array([[900.0, 2.5, 150.3], [0, 880, 121.1], [0, 0, 1]]), 300, 240, 500.0)
BENT = CameraModel(CAMERA.K, 300, 240, 500.0, np.array([-0.2, 0.05, 0.001, -0.002, 0.0]))


def _drawn(screen, faces, rows, columns):
    """Return the visible face at each pixel."""
    faces = np.asarray(faces, np.int32)
    bands = kernels.face_bands(screen, faces, rows, columns)
    members, begin = kernels.sort_into_bands(*bands, -(-rows // kernels.BAND_ROWS))
    view = np.full((rows, columns), -1, np.int32)
    nearest = np.full(view.shape, -np.inf, np.float32)
    in_threads(kernels.draw, len(begin) - 1, screen, faces, members, begin, nearest, view)
    return view


def _screen(pixels):
    pixels = np.asarray(pixels, np.float64)
    return kernels.snap(pixels, np.zeros(len(pixels)))


@pytest.mark.slow
@settings(max_examples=40)
@given(
    st.lists(st.tuples(st.integers(0, 80), st.integers(0, 160)), max_size=30),
    st.sampled_from([2, 1, 4, 3.7]),
)
def test_shared_edges_leave_no_hole_and_cover_no_pixel_twice(inner, parts):
    # With corners at half, whole and quarter pixels, many edges and corners are at pixel centres.
    corners = [(0, 0), (80, 0), (0, 160), (80, 160)]
    points = np.unique(np.array([*corners, *inner]), axis=0) / parts
    faces = Delaunay(points).simplices
    screen = _screen(points)
    hits = sum((_drawn(screen, face[None], 90, 50) >= 0).astype(int) for face in faces)
    expected = np.zeros((90, 50), int)
    right, bottom = (int(np.ceil(np.float32(kernels.snap(
        np.array([[80 / parts, 160 / parts]]), np.zeros(1))[0, k]))) for k in (0, 1))  # fmt: skip
    expected[:bottom, :right] = 1
    np.testing.assert_array_equal(hits, expected)
    np.testing.assert_array_equal(_drawn(screen, faces, 90, 50) >= 0, expected > 0)


@pytest.mark.parametrize("turned", [False, True], ids=["clockwise", "counter-clockwise"])
def test_pixels_on_top_and_left_edges_are_covered_and_others_are_not(turned):
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    square = _screen([(2, 3), (7, 3), (7, 9), (2, 9)])
    view = _drawn(square, faces[:, ::-1] if turned else faces, 12, 12)
    rows, columns = np.nonzero(view >= 0)
    assert (columns.min(), columns.max(), rows.min(), rows.max()) == (2, 6, 3, 8)
    assert len(rows) == 5 * 6


def test_a_face_far_larger_than_the_image_fills_it():
    wide = _screen([(-3e5, -2e5), (4e5, -2e5), (0, 5e5)])
    assert (_drawn(wide, [[0, 1, 2]], 70, 50) == 0).all()


def _plane(slope_x, slope_y, half=60.0, lift=0.0):
    x, y = np.array([-half, half, half, -half]), np.array([-half, -half, half, half])
    vertices = np.stack([x, y, lift + slope_x * x + slope_y * y], axis=1)
    return Geometry(vertices, np.array([[0, 1, 2], [0, 2, 3]]))


@pytest.mark.parametrize("slopes", [(0.0, 0.0), (0.5, -0.2), (-3.0, 2.0)])
def test_a_tilted_plane_is_exact(slopes):
    view = project(_plane(*slopes), size=(41, 61), pixel_mm=0.7, centred=False)
    x = (np.arange(61) - 30) * 0.7
    y = (20 - np.arange(41)) * 0.7
    np.testing.assert_allclose(
        view.height, slopes[0] * x + slopes[1] * y[:, None], atol=1e-5, rtol=1e-6
    )
    assert angle_deg(view.normal_map.normals, [-slopes[0], -slopes[1], 1.0]).max() < 1e-5
    assert view.depth is None


@pytest.mark.parametrize("camera", [CAMERA, BENT], ids=["pinhole", "distorted"])
@pytest.mark.parametrize("slopes", [(0.0, 0.0), (0.4, -0.3)])
def test_the_depth_of_a_plane_in_perspective(camera, slopes):
    view = project(_plane(*slopes, half=200.0, lift=7.0), camera=camera, centred=False)
    rays = camera.pixel_rays()
    # z = 7 + sx x + sy y along (0, 0, 500) + depth * ray
    expected = (500.0 - 7.0) / (slopes[0] * rays[..., 0] + slopes[1] * rays[..., 1] + 1.0)
    assert view.normal_map.mask.all()
    # The diagonal between the two faces is drawn straight, although distortion bends it.
    tolerance = 1e-6 if camera is CAMERA else 2e-4
    np.testing.assert_allclose(view.depth, expected, rtol=tolerance)
    np.testing.assert_allclose(view.height, 500.0 - expected, atol=500 * tolerance)
    assert view.pixel_mm == pytest.approx(500 / np.sqrt(900 * 880))


def test_a_ball_in_closed_form():
    ball = trimesh.creation.icosphere(subdivisions=6, radius=10.0)
    view = project(Geometry(ball.vertices, ball.faces), size=(200, 200), pixel_mm=0.11)
    x, y = np.meshgrid((np.arange(200) - 99.5) * 0.11, (99.5 - np.arange(200)) * 0.11)
    z2 = 100 - x**2 - y**2
    assert not view.normal_map.mask[z2 < 0].any()
    inner = z2 > 2
    assert view.normal_map.mask[inner].all()
    z = np.sqrt(z2[inner])
    np.testing.assert_allclose(view.height[inner], z, atol=0.02)
    truth = np.stack([x[inner], y[inner], z], axis=1)
    assert angle_deg(view.normal_map.normals[inner], truth).max() < 0.1


def _area_weighted(vertices, faces):
    corners = vertices[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    total = np.zeros_like(vertices)
    for corner in range(3):
        np.add.at(total, faces[:, corner], cross)
    return total / np.linalg.norm(total, axis=1, keepdims=True), cross


CAMERAS = {"orthographic": None, "pinhole": CAMERA, "bent": BENT}
MESHES = ["torus", "stanford-bunny", "decimated-max", "skull"]


@pytest.mark.parametrize(
    ("name", "view", "smooth"), quick(product(MESHES, CAMERAS, (True, False)), every=12)
)
def test_agrees_with_a_ray_caster(name, view, smooth):
    camera = CAMERAS[view]
    mesh = mesh_named(name)
    # A small rotation prevents symmetric edges at pixel centres.
    turn = view_rotation(rotate_deg=(20.0, -31.0, 7.0))
    points = mesh.vertices @ turn.T
    points -= (points.min(axis=0) + points.max(axis=0)) / 2
    points *= 100 / np.ptp(points, axis=0).max()
    faces = mesh.faces
    if camera is None:
        view = project(Geometry(points, faces), size=(240, 300), pixel_mm=0.45, smooth=smooth)
        x, y = np.meshgrid((np.arange(300) - 149.5) * 0.45, (119.5 - np.arange(240)) * 0.45)
        origins = np.stack([x, y, np.full_like(x, 200.0)], axis=-1).reshape(-1, 3)
        rays = np.broadcast_to([0.0, 0.0, -1.0], origins.shape)
    else:
        view = project(Geometry(points, faces), camera=camera, smooth=smooth)
        rays = camera.pixel_rays().reshape(-1, 3)
        origins = np.broadcast_to(camera.centre_mm, rays.shape)
    t, weights, face = TriangleTree.grow(points[faces]).closest(origins, rays)
    mask = view.normal_map.mask.ravel()
    # Rasterisation uses straight images of the edges, ray casting the distorted ones.
    allowed = 40 if camera is BENT else 3
    assert np.count_nonzero(mask != (face >= 0)) <= allowed
    both = np.flatnonzero(mask & (face >= 0))
    assert len(both) > 10_000
    vertex_normals, cross = _area_weighted(points, faces)
    truth = cross[face[both]]
    facing = np.sign((truth * -rays[both]).sum(axis=1))
    if smooth:
        truth = (vertex_normals[faces[face[both]]] * weights[both][..., None]).sum(axis=1)
    error = angle_deg(view.normal_map.normals.reshape(-1, 3)[both], truth * facing[:, None])
    z = origins[both, 2] + t[both] * rays[both, 2]
    off = np.abs(view.height.ravel()[both] - z)
    # On an edge, and if the mesh intersects itself, the neighbouring face may be as near.
    clear = weights[both].min(axis=1) > (0.02 if camera is BENT else 1e-3)
    share = 0.998 if camera is BENT else 0.9995
    assert (error < 0.01).mean() > (share if smooth else share - 0.002)
    assert (error[clear] < 0.01).mean() > 0.9998
    assert (off[clear] < 1e-3).mean() > 0.9998


def test_the_result_depends_neither_on_threads_nor_on_the_order_of_faces():
    mesh = mesh_named("torus")
    first = project(mesh, view_rotation("left"), size=(150, 150))
    with one_thread():
        alone = project(mesh, view_rotation("left"), size=(150, 150))
    np.testing.assert_array_equal(first.normal_map.normals, alone.normal_map.normals)
    turned = project(Geometry(mesh.vertices, mesh.faces[::-1]), view_rotation("left"),
                     size=(150, 150))  # fmt: skip
    np.testing.assert_allclose(first.height, turned.height, atol=1e-5)


def test_faces_without_area_are_reported_and_left_out():
    plane = _plane(0.1, 0.2)
    faces = np.concatenate([plane.faces, [[0, 0, 1], [2, 2, 2]]])
    view = project(Geometry(plane.vertices, faces))
    assert "no area: 2 of 4" in str(view.warnings[0])
    np.testing.assert_array_equal(view.height, project(plane).height)


def test_a_mesh_of_only_degenerate_faces_is_refused():
    with pytest.raises(EstimateError, match=r"no face can be drawn: .*no area: 1 of 1"):
        project(Geometry([[0, 0, 0], [1, 1, 0], [2, 2, 0]], [[0, 1, 2]]), pixel_mm=0.1)


def test_the_back_of_a_face_has_an_inverted_normal_and_is_reported():
    plane = _plane(0.1, 0.2)
    view = project(Geometry(plane.vertices, plane.faces[:, ::-1]))
    np.testing.assert_allclose(view.normal_map.normals, project(plane).normal_map.normals)
    assert "100% of the pixels show the back" in str(view.warnings[0])


def test_three_faces_on_one_edge_are_fine():
    vertices = [[0, -1, 0], [0, 1, 0], [1, 0, 0], [-1, 0, 0], [0, 0, 1]]
    view = project(Geometry(vertices, [[0, 2, 1], [0, 1, 3], [0, 1, 4]]), size=(50, 50))
    assert view.normal_map.mask.sum() > 500


def test_faces_behind_the_camera_are_reported_and_left_out():
    plane = _plane(0.0, 0.0)
    vertices = np.concatenate([plane.vertices, [[0, 0, 600], [10, 0, 450], [0, 10, 450]]])
    faces = np.concatenate([plane.faces, [[4, 5, 6]]])
    view = project(Geometry(vertices, faces), camera=CAMERA, centred=False)
    assert "faces left out because they are behind the camera: 1" in str(view.warnings[0])
    assert np.nanmax(np.abs(view.height)) < 1e-3


REFUSED = {
    "unit": ({"unit_mm": 0.0}, DataError, "unit of 0.0 mm"),
    "pixel": ({"pixel_mm": np.nan}, DataError, "pixel of nan mm"),
    "huge": ({"pixel_mm": 1e-4}, DataError, "too large"),
    "long": ({"size": (70_000, 1)}, DataError, "too large"),
    "two scales": ({"camera": CAMERA, "pixel_mm": 1.0}, DataError, "only one"),
    "two sizes": ({"camera": CAMERA, "size": (9, 9)}, DataError, "9 x 9"),
    "no distance": ({"camera": CameraModel(CAMERA.K, 300, 240)}, DataError, "working"),
    "nothing seen": ({"size": (1, 2), "pixel_mm": 300.0}, EstimateError, "120 x 120 mm"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_invalid_projections_are_refused(name):
    options, kind, words = REFUSED[name]
    with pytest.raises(kind, match=words):
        project(_plane(0.0, 0.0), **options)


# The axes of the file that point to the right, up, and toward the viewer.
VIEWS = {
    "front": ({}, (1, 0, 0), (0, 1, 0), (0, 0, 1)),
    "back": ({"view": "back"}, (-1, 0, 0), (0, 1, 0), (0, 0, -1)),
    "left": ({"view": "left"}, (0, 0, 1), (0, 1, 0), (-1, 0, 0)),
    "right": ({"view": "right"}, (0, 0, -1), (0, 1, 0), (1, 0, 0)),
    "top": ({"view": "top"}, (1, 0, 0), (0, 0, -1), (0, 1, 0)),
    "bottom": ({"view": "bottom"}, (1, 0, 0), (0, 0, 1), (0, -1, 0)),
    "z up, front": ({"up": "z"}, (1, 0, 0), (0, 0, 1), (0, -1, 0)),
    "z up, top": ({"up": "z", "view": "top"}, (1, 0, 0), (0, 1, 0), (0, 0, 1)),
    "look": ({"look": (-5, 0, 0)}, (0, 0, -1), (0, 1, 0), (1, 0, 0)),
    "look, z up": ({"look": (0, 3, 0), "up": "z"}, (1, 0, 0), (0, 0, 1), (0, -1, 0)),
    "turned": ({"rotate_deg": (90, 0, 0)}, (1, 0, 0), (0, 0, -1), (0, 1, 0)),
    "x before y": ({"rotate_deg": (90, 90, 0)}, (0, 1, 0), (0, 0, -1), (-1, 0, 0)),
}


@pytest.mark.parametrize("name", VIEWS)
def test_views_show_the_named_side(name):
    options, right, up, toward = VIEWS[name]
    turn = view_rotation(**options)
    np.testing.assert_allclose(turn, np.array([right, up, toward], float), atol=1e-12)


@given(st.lists(st.floats(-180, 180), min_size=3, max_size=3))
def test_views_are_rotations(look):
    if np.linalg.norm(look) < 1e-3:
        return
    turn = view_rotation(look=look, rotate_deg=look)
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-9)
    assert np.linalg.det(turn) > 0


@pytest.mark.parametrize("look", [(0, 0, 0), (np.nan, 0, 1)])
def test_a_viewing_direction_of_length_zero_is_refused(look):
    with pytest.raises(DataError, match="no view along"):
        view_rotation(look=look)


def _prism(sides, half=10.0):
    """Return a prism of many sides, the sides in the order of their angles, then two caps."""
    turn = np.arange(sides) / sides * 2 * np.pi
    ring = 10 * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    vertices = np.concatenate([np.insert(ring, 2, z, axis=1) for z in (-half, half)])
    i = np.arange(sides)
    j = (i + 1) % sides
    k = np.arange(1, sides - 1)
    faces = [np.stack([i, j, sides + j], 1), np.stack([i, sides + j, sides + i], 1)]
    faces += [
        np.stack([0 * k, k + 1, k], 1),
        np.stack([sides + 0 * k, sides + k, sides + k + 1], 1),
    ]
    return Geometry(vertices, np.concatenate(faces))


@pytest.mark.parametrize(
    ("sides", "crease", "sharp"),
    [
        pytest.param(4, 40, 12, id="box"),
        pytest.param(8, 36, 24, id="octagon"),
        pytest.param(12, 40, 24, id="coarse cylinder"),
        pytest.param(64, 40, 128, id="cylinder"),
    ],
)
def test_edges_of_parts_stay_sharp(sides, crease, sharp):
    part = _prism(sides)
    view = project(part, view_rotation(rotate_deg=(40, 20, 0)), size=(200, 200))
    (notice,) = view.warnings
    assert notice.code == "creases-kept"
    assert f"more than {crease} degrees stay sharp: {sharp};" in notice.text
    # In the axes of the file the normal is that of a cap, or at right angles to the axis.
    z = (view.normal_map.normals @ view_rotation(rotate_deg=(40, 20, 0)))[..., 2]
    z = np.abs(z[view.normal_map.mask])
    assert (np.minimum(z, np.abs(1 - z)) < 1e-6).all()


def test_the_mantle_of_a_cylinder_is_smooth():
    view = project(_prism(48), size=(120, 120), pixel_mm=0.15)
    flat = project(_prism(48), size=(120, 120), pixel_mm=0.15, smooth=False)
    tilted = view_rotation(rotate_deg=(90, 0, 0))
    smooth = project(_prism(48), tilted, size=(120, 120), pixel_mm=0.15).normal_map.normals
    x = np.broadcast_to((np.arange(120) - 59.5) * 0.15, (120, 120))
    truth = np.stack([x, 0 * x, np.sqrt(np.maximum(100 - x**2, 0))], axis=-1)
    # Weighted by area, the two triangles of a side count twice at one of its corners.
    assert angle_deg(smooth, truth)[:, 10:-10].max() < 7.5 / 6 + 0.1
    np.testing.assert_array_equal(view.normal_map.normals, flat.normal_map.normals)


@pytest.mark.parametrize("name", ["torus", "stanford-bunny", "decimated-max", "skull"])
def test_smooth_meshes_have_no_creases(name):
    mesh = mesh_named(name)
    assert crease_angle_deg(mesh.vertices, mesh.faces) is None


def _with_normals(subdivisions, normals):
    ball = trimesh.creation.icosphere(subdivisions=subdivisions, radius=10.0)
    given = normals(ball.vertices / 10.0)[ball.faces].astype(np.float32)
    return Geometry(ball.vertices, ball.faces, given), Geometry(ball.vertices, ball.faces)


@pytest.mark.parametrize(
    ("normals", "code"),
    [
        pytest.param(lambda n: n, None, id="right"),
        pytest.param(lambda n: -n, None, id="inward"),
        pytest.param(lambda n: n[:, [1, 2, 0]], "vertex-normals-doubtful", id="axes"),
        pytest.param(lambda n: n * np.nan, None, id="unknown"),
    ],
)
def test_normals_of_a_mesh_are_used_if_they_fit(normals, code):
    given, without = _with_normals(2, normals)
    turn = view_rotation(rotate_deg=(20, 30, 40))
    view, blended = (project(each, turn, size=(90, 90)) for each in (given, without))
    assert [notice.code for notice in view.warnings] == ([code] if code else [])
    np.testing.assert_allclose(view.normal_map.normals, blended.normal_map.normals, atol=3e-2)


def test_a_coarse_mesh_with_blended_normals_is_named():
    """Every face of an octahedron turns by 55 degrees from the normals at its corners."""
    eye = np.eye(3)
    faces = [[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]]
    points = np.stack([eye[0], eye[1], eye[2], -eye[0], -eye[1], -eye[2]])
    dice = np.random.default_rng(0)
    bumpy = points + dice.normal(0, 0.25, points.shape)
    view = project(Geometry(bumpy, faces), size=(90, 90))
    assert {notice.code for notice in view.warnings} & {"creases-kept", "normals-blended"}
