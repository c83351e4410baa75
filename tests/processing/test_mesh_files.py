from __future__ import annotations

import json
import time
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import dblquad as integrate_twice

from acquisition import CameraModel, DataError, StorageError
from processing import HeightMap, NormalMap, height_mesh, integrate, write_mesh
from processing.meshes.face_kernels import faces_of
from rig.arrays import Bool

FORMATS = ("ply", "obj", "stl", "glb")


def dome(rows: int = 40, columns: int = 50, hole: bool = True) -> tuple[NormalMap, HeightMap]:
    r, c = np.mgrid[:rows, :columns].astype(np.float64)
    x, y = c - (columns - 1) / 2, (rows - 1) / 2 - r
    radius = 0.8 * max(rows, columns)
    normals = np.stack([x, y, np.sqrt(radius**2 - x**2 - y**2)], axis=2)
    mask = np.ones((rows, columns), bool)
    if hole:
        mask[10:14, 20:23] = mask[30, 30] = False
    normal_map = NormalMap.from_vectors(normals, mask)
    return normal_map, integrate(normal_map, pixel_mm=0.5)


def flat(mask: Bool) -> HeightMap:
    return integrate(NormalMap.from_vectors(np.broadcast_to((0.0, 0, 1), (*mask.shape, 3)), mask))


def read(path: Path) -> trimesh.Trimesh:
    # force="mesh" would drop the normals of the file.
    mesh = trimesh.load(path, process=False)
    if isinstance(mesh, trimesh.Scene):
        (mesh,) = mesh.geometry.values()
    assert isinstance(mesh, trimesh.Trimesh)
    return mesh


@pytest.mark.parametrize("suffix", FORMATS)
@pytest.mark.parametrize("with_normals", [False, True])
def test_other_programs_read_the_surface(tmp_path: Path, suffix: str, with_normals: bool) -> None:
    normal_map, surface = dome()
    path = tmp_path / f"surface.{suffix}"
    write_mesh(path, surface, normals=normal_map if with_normals else None)
    mesh = read(path)
    scale = 1e-3 if suffix == "glb" else 1.0
    # 39 x 49 squares without those that touch the hole of 4 x 3 pixels (5 x 4 squares) and the hole
    # of one pixel (4); the corner squares of a hole have three pixels and therefore one triangle.
    squares = 39 * 49 - 5 * 4 - 4
    assert len(mesh.faces) == 2 * squares + 4 + 4
    if suffix != "stl":
        assert len(mesh.vertices) == surface.mask.sum()
        points = surface.points()[surface.mask] * scale
        np.testing.assert_allclose(mesh.vertices, points, rtol=1e-6, atol=1e-9)
    low, high = mesh.bounds / scale
    np.testing.assert_allclose(high[:2] - low[:2], [49 * 0.5, 39 * 0.5], rtol=1e-6)
    assert (mesh.face_normals[:, 2] > 0).all()
    if with_normals and suffix != "stl":
        given_normals = normal_map.normals[surface.mask]
        np.testing.assert_allclose(mesh.vertex_normals, given_normals, atol=2e-5)


@pytest.mark.parametrize("suffix", FORMATS)
def test_the_area_is_the_spheres(tmp_path: Path, suffix: str) -> None:
    r, c = np.mgrid[-40:41, -60:61].astype(np.float64)
    normal_map = NormalMap.from_vectors(np.stack([c, -r, np.sqrt(100.0**2 - r**2 - c**2)], axis=2))
    surface = integrate(normal_map)
    path = tmp_path / f"patch.{suffix}"
    write_mesh(path, surface, normals=normal_map)
    mesh = read(path)
    scale = 1e-3 if suffix == "glb" else 1.0
    area, _ = integrate_twice(lambda y, x: 100 / np.sqrt(100**2 - x * x - y * y), -60, 60, -40, 40)
    assert mesh.area / scale**2 == pytest.approx(area, rel=1e-3)
    # Faces point away from the centre of the sphere, toward the camera.
    centre = np.array([0, 0, surface.height[40, 60] - 100]) * scale
    outward = np.einsum("ij,ij->i", mesh.face_normals, mesh.triangles_center - centre)
    assert outward.min() > 0


@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1), st.integers(2, 9), st.integers(2, 9), st.floats(0.5, 1))
def test_faces_fill_the_mask_and_nothing_else(
    seed: int, rows: int, columns: int, full: float
) -> None:
    mask = np.random.default_rng(seed).random((rows, columns)) < full
    mask[:2, :2] = True
    surface = flat(mask)
    mesh = height_mesh(surface)
    corners = np.stack([mask[:-1, :-1], mask[:-1, 1:], mask[1:, :-1], mask[1:, 1:]])
    count = corners.sum(axis=0)
    assert len(mesh.faces) == 2 * np.count_nonzero(count == 4) + np.count_nonzero(count == 3)
    triangles = mesh.vertices[mesh.faces]
    edge, other = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    doubled = edge[:, 0] * other[:, 1] - edge[:, 1] * other[:, 0]
    np.testing.assert_allclose(doubled, 1.0)  # half a pixel each, counter-clockwise
    assert len(np.unique(np.sort(mesh.faces, axis=1), axis=0)) == len(mesh.faces)


def test_squares_are_split_along_the_shorter_diagonal() -> None:
    surface = flat(np.ones((2, 2), bool))
    lifted = surface.height
    lifted[0, 0] += 5
    # The split is along b d and leaves the raised corner to one triangle: a b d and b d e.
    assert {frozenset(f) for f in height_mesh(surface).faces.tolist()} == {
        frozenset({0, 1, 2}),
        frozenset({1, 2, 3}),
    }
    lifted[0, 0] -= 5
    lifted[0, 1] += 5
    assert {frozenset(f) for f in height_mesh(surface).faces.tolist()} == {
        frozenset({0, 2, 3}),
        frozenset({0, 1, 3}),
    }


@pytest.mark.parametrize("seed", range(6))
def test_the_order_and_the_choice_of_triangles(seed: int) -> None:
    """The kernel gives the triangles of a plain loop, kind by kind in reading order."""
    rng = np.random.default_rng(seed)
    parts = rng.integers(-1, 2, (9, 13)).astype(np.int32) if seed < 3 else np.zeros((8, 7), "i4")
    number = np.cumsum(parts.ravel() >= 0).reshape(parts.shape) - 1
    x, y = np.meshgrid(np.arange(parts.shape[1]), np.arange(parts.shape[0]))
    # Few heights, so that many diagonals are equally long.
    points = np.stack([x, -y, rng.integers(0, 3, parts.shape)], axis=2).astype(np.float32)
    kinds: list[list[list[int]]] = [[], [], [], []]
    for r in range(parts.shape[0] - 1):
        for c in range(parts.shape[1] - 1):
            a, b, d, e = (r, c), (r, c + 1), (r + 1, c), (r + 1, c + 1)
            corners = (a, d, b), (b, d, e), (a, d, e), (a, e, b)
            whole = [len({int(parts[p]) for p in three}) == 1 for three in corners]
            whole = [
                one and parts[three[0]] >= 0 for one, three in zip(whole, corners, strict=True)
            ]
            if all(whole):
                bd = np.sum((points[b] - points[d]) ** 2) <= np.sum((points[a] - points[e]) ** 2)
                whole = [bd, bd, not bd, not bd]
            for kind, one, three in zip(kinds, whole, corners, strict=True):
                kind += [[int(number[p]) for p in three]] * bool(one)
    faces = faces_of(parts, points[parts >= 0])
    np.testing.assert_array_equal(faces, np.concatenate([np.reshape(k, (-1, 3)) for k in kinds]))


def test_points_of_some_rows_are_those_of_all() -> None:
    camera = CameraModel(
        np.array([[90.0, 0, 25], [0, 92.0, 20], [0, 0, 1]]), 50, 40, distortion=np.array([0.1])
    )
    for surface in (dome()[1], integrate(dome()[0], camera=camera)):
        np.testing.assert_array_equal(surface.points(slice(11, 23)), surface.points()[11:23])


def test_no_face_connects_two_parts() -> None:
    normals = np.zeros((20, 20, 3))
    normals[..., 2] = 1
    # A vertical wall between two floors: its edges are grazing and are dropped.
    normals[:, 10] = (1, 0, 0.001)
    normals[:, 11] = (-1, 0, 0.001)
    surface = integrate(NormalMap.from_vectors(normals))
    assert surface.parts.max() == 1
    mesh = height_mesh(surface)
    part = surface.parts[surface.mask][mesh.faces]
    assert (part == part[:, :1]).all()
    assert set(part.ravel()) == {0, 1}


def test_a_perspective_mesh_widens_with_depth(tmp_path: Path) -> None:
    camera = CameraModel(np.array([[100.0, 0, 24.5], [0, 100, 19.5], [0, 0, 1]]), 50, 40, 200.0)
    normal_map = NormalMap.from_vectors(np.broadcast_to((0.0, 0.0, 1.0), (40, 50, 3)))
    write_mesh(tmp_path / "plane.ply", integrate(normal_map, camera=camera))
    mesh = read(tmp_path / "plane.ply")
    np.testing.assert_allclose(mesh.bounds, [[-49, -39, 0], [49, 39, 0]], atol=1e-3)
    assert (mesh.face_normals[:, 2] > 0.999).all()


@pytest.mark.parametrize("suffix", FORMATS)
def test_the_same_surface_gives_the_same_bytes(tmp_path: Path, suffix: str) -> None:
    for name in ("a", "b"):
        normal_map, surface = dome()
        path = tmp_path / f"{name}.{suffix}"
        write_mesh(path, surface, normals=normal_map)
    assert (tmp_path / f"a.{suffix}").read_bytes() == (tmp_path / f"b.{suffix}").read_bytes()


def test_ply_bytes(tmp_path: Path) -> None:
    surface = flat(np.ones((2, 2), bool))
    header = (
        b"ply\nformat binary_little_endian 1.0\ncomment unit px\nelement vertex 4\n"
        b"property float x\n"
        b"property float y\nproperty float z\nelement face 2\n"
        b"property list uchar int vertex_indices\nend_header\n"
    )
    vertices = np.array([[-0.5, 0.5, 0], [0.5, 0.5, 0], [-0.5, -0.5, 0], [0.5, -0.5, 0]], "<f4")
    faces = b"".join(b"\x03" + np.array(f, "<i4").tobytes() for f in ((0, 2, 1), (1, 2, 3)))
    write_mesh(tmp_path / "square.ply", surface)
    assert (tmp_path / "square.ply").read_bytes() == header + vertices.tobytes() + faces


def test_obj_text(tmp_path: Path) -> None:
    mask = np.ones((2, 2), bool)
    write_mesh(tmp_path / "square.obj", flat(mask))
    assert (tmp_path / "square.obj").read_text() == (
        "# unit px\nv -0.5 0.5 0\nv 0.5 0.5 0\nv -0.5 -0.5 0\nv 0.5 -0.5 0\nf 1 3 2\nf 2 3 4\n"
    )


def test_the_layout_of_glb_follows_gltf(tmp_path: Path) -> None:
    normal_map, surface = dome(3, 5, hole=False)
    write_mesh(tmp_path / "a.glb", surface, normals=normal_map)
    data = (tmp_path / "a.glb").read_bytes()
    magic, version, total, json_bytes = np.frombuffer(data, "<u4", 4)
    assert (magic, version, total) == (0x46546C67, 2, len(data))
    assert json_bytes % 4 == 0
    document = json.loads(data[20 : 20 + json_bytes])
    assert np.frombuffer(data, "<u4", 1, 20 + json_bytes)[0] == len(data) - 28 - json_bytes
    assert all(view["byteOffset"] % 4 == 0 for view in document["bufferViews"])
    position = document["accessors"][0]
    points = surface.points().reshape(-1, 3) / 1000
    np.testing.assert_allclose(position["min"], points.min(axis=0), rtol=1e-6)
    np.testing.assert_allclose(position["max"], points.max(axis=0), rtol=1e-6)


def test_write_mesh_refuses(tmp_path: Path) -> None:
    normal_map, surface = dome()
    with pytest.raises(DataError, match=r"unknown mesh format '\.off'"):
        write_mesh(tmp_path / "surface.off", surface)
    with pytest.raises(StorageError, match=r"surface\.ply: cannot write"):
        write_mesh(tmp_path / "missing" / "surface.ply", surface)
    small = NormalMap(normal_map.normals[:-1].copy(), normal_map.mask[:-1].copy())
    with pytest.raises(DataError, match="do not cover the height map"):
        write_mesh(tmp_path / "surface.ply", surface, normals=small)
    line = np.zeros((5, 5), bool)
    line[2] = True
    with pytest.raises(DataError, match="contains no triangle"):
        write_mesh(tmp_path / "surface.ply", flat(line))
    assert list(tmp_path.iterdir()) == []


def test_a_million_vertices_take_about_a_second(tmp_path: Path) -> None:
    surface = flat(np.ones((1000, 1000), bool))
    start = time.process_time()
    write_mesh(tmp_path / "big.ply", surface)
    # The measured time is 0.4 s; the margin is for a busy or slower computer.
    assert time.process_time() - start < 2.0
    assert (tmp_path / "big.ply").stat().st_size > 12_000_000 + 13 * 1_990_000
