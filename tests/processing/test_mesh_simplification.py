"""Meshes with fewer triangles stay on the surface; solids are watertight."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from acquisition import CameraModel, DataError
from processing import (
    Geometry,
    HeightMap,
    NormalMap,
    height_mesh,
    integrate,
    project,
    solid_mesh,
    write_mesh,
)
from processing.meshes import Mesh
from processing.meshes.rim import rim
from processing.meshes.simplification import pixels_of
from processing.surface import Jumps
from rig.arrays import Bool
from tests.processing.test_mesh_files import dome, flat, read


def relief(camera: CameraModel | None = None) -> tuple[NormalMap, HeightMap]:
    """Waves on one half of a disc, a plane on the other."""
    y, x = np.mgrid[1:-1:160j, -1:1:180j]
    waves = np.where(x > 0, np.sin(14 * x) * np.cos(11 * y) * x, 0)
    down, right = np.gradient(12 * waves)
    normal_map = NormalMap.from_vectors(
        np.dstack([-right, down, np.ones_like(x)]), np.hypot(x, y) < 0.97
    )
    if camera is None:
        return normal_map, integrate(normal_map, pixel_mm=0.5)
    return normal_map, integrate(normal_map, camera=camera)


def pinhole(distance: float | None) -> CameraModel:
    k = np.array([[900.0, 3, 91], [0, 880, 78], [0, 0, 1]])
    return CameraModel(k, 180, 160, distance, np.array([-0.05, 0, 0, 0, 0]))


def as_trimesh(mesh: Mesh) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)


def signed_volume(mesh: Mesh) -> float:
    corners = mesh.vertices[mesh.faces].astype(np.float64)
    return float(np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6)


@pytest.mark.parametrize("distance", [None, 400.0])
def test_points_are_seen_at_their_pixels(distance: float | None) -> None:
    _, surface = relief(pinhole(distance))
    mesh = height_mesh(surface)
    rows, columns = np.nonzero(surface.mask)
    np.testing.assert_allclose(
        pixels_of(mesh.vertices, surface), np.stack([columns, rows], axis=1), atol=2e-3
    )


def test_fewer_triangles_stay_on_the_surface_and_go_where_it_curves() -> None:
    normal_map, surface = relief()
    complete = height_mesh(surface)
    count = len(complete.faces) // 10
    mesh = height_mesh(surface, normals=normal_map, triangles=count)
    assert 0.9 * count <= len(mesh.faces) <= count
    drawn = project(
        Geometry(mesh.vertices.astype(float), mesh.faces),
        size=surface.mask.shape,
        pixel_mm=0.5,
        centred=False,
    )
    both = surface.mask & drawn.normal_map.mask
    apart = np.abs(drawn.height - surface.height)[both]
    height = np.ptp(surface.height[surface.mask])
    # Every tenth triangle of the grid, each 3.2 pixels wide, would be ten times as far away.
    assert apart.max() < 0.01 * height
    # Points of the rim of a disc are lost between its new, longer edges.
    assert np.count_nonzero(both) > 0.98 * np.count_nonzero(surface.mask)
    curved = mesh.vertices[:, 0] > 0
    assert np.count_nonzero(curved) > 2 * np.count_nonzero(~curved)


def test_vertices_keep_the_normals_colours_and_places_of_the_image(tmp_path: Path) -> None:
    normal_map, surface = dome(60, 80, hole=False)
    ramp = np.broadcast_to(np.arange(80, dtype=np.uint8) * 3, (60, 80)).copy()
    mesh = height_mesh(surface, normals=normal_map, colours=ramp, triangles=800)
    assert mesh.normals is not None
    assert mesh.colours is not None
    assert mesh.places is not None
    # A sphere of radius 64 pixels of .5 mm: normals are parallel to the vertices from its centre.
    column = mesh.vertices[:, 0] / 0.5 + 39.5
    np.testing.assert_allclose(mesh.normals[:, 0], (column - 39.5) / 64, atol=0.01)
    np.testing.assert_allclose(mesh.colours[:, 0], 3 * column, atol=1)
    np.testing.assert_allclose(mesh.places[:, 0], (column + 0.5) / 80, atol=1e-4)
    for suffix in ("ply", "glb", "obj", "stl"):
        write_mesh(tmp_path / f"a.{suffix}", surface, colours=ramp, mesh=mesh)
        assert len(read(tmp_path / f"a.{suffix}").faces) == len(mesh.faces)


def test_a_mesh_with_few_triangles_is_not_changed() -> None:
    _, surface = dome()
    complete, kept = height_mesh(surface), height_mesh(surface, triangles=10**6)
    np.testing.assert_array_equal(kept.faces, complete.faces)
    with pytest.raises(DataError, match="3 triangles are not a surface: keep at least 4"):
        height_mesh(surface, triangles=3)


@pytest.mark.parametrize("distance", [None, 400.0, "orthographic"])
def test_a_solid_is_watertight_and_has_its_volume(distance: float | str | None) -> None:
    camera = None if isinstance(distance, str) else pinhole(distance)
    _, surface = relief(camera)
    for mesh in (height_mesh(surface), height_mesh(surface, triangles=2000)):
        solid = as_trimesh(solid_mesh(mesh, base=3.0))
        assert solid.is_watertight
        assert solid.is_winding_consistent
        flat_z = mesh.vertices[:, 2].min() - 3
        corners = mesh.vertices[mesh.faces].astype(np.float64)
        sides = corners[:, 1:, :2] - corners[:, :1, :2]
        areas = np.linalg.det(sides) / 2
        below = (areas * (corners[..., 2].mean(axis=1) - flat_z)).sum()
        assert solid.volume == pytest.approx(below, rel=1e-5)


@given(
    st.integers(2, 7),
    st.integers(2, 7),
    st.lists(st.booleans(), min_size=49, max_size=49),
    st.booleans(),
)
@settings(max_examples=60)
def test_any_mask_gives_a_watertight_solid(
    rows: int, columns: int, inside: list[bool], fewer: bool
) -> None:
    mask: Bool = np.array(inside[: rows * columns]).reshape(rows, columns)
    mask[:2, :2] = True
    mesh = height_mesh(flat(mask), triangles=max(4, rows * columns // 3) if fewer else None)
    solid = solid_mesh(mesh, base=1.0)
    # trimesh joins equal vertices only if it processes the mesh.
    closed = as_trimesh(solid)
    assert closed.is_watertight
    assert closed.is_winding_consistent
    assert signed_volume(solid) > 0


def test_parts_that_touch_at_one_vertex_get_their_own() -> None:
    corners = np.array([[0, 0, 0], [-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float32)
    mesh = Mesh(corners, np.array([[0, 1, 2], [0, 3, 4]], np.int32))
    solid = solid_mesh(mesh, base=2.0)
    assert len(solid.vertices) == 2 * 6
    assert as_trimesh(solid).is_watertight
    # The parts move apart by 1 % of an edge.
    assert signed_volume(solid) == pytest.approx(2 * 2.0, rel=0.01)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("triangles", [None, 60])
def test_cut_meshes_give_watertight_solids(
    seed: int, triangles: int | None, tmp_path: Path
) -> None:
    surface = flat(np.ones((9, 11), bool))
    right, down = np.random.default_rng(seed).random((2, 9, 11)) < 0.2
    inside = np.zeros((9, 11), np.int32)
    jumps = Jumps(right, down, inside.astype(np.float32), inside, 1, 0.0, settled=True)
    mesh = height_mesh(replace(surface, jumps=jumps), triangles=triangles)
    assert triangles is None or len(mesh.faces) <= triangles
    edges = rim(mesh.faces, len(mesh.vertices))
    assert triangles or np.bincount(edges[:, 0]).max() > 1  # of several fans
    solid = solid_mesh(mesh, base=1.0)
    write_mesh(tmp_path / "solid.stl", surface, mesh=solid)
    joined = read(tmp_path / "solid.stl")
    joined.merge_vertices()
    for closed in (as_trimesh(solid), joined):
        assert closed.is_watertight
        assert closed.is_winding_consistent
        assert closed.volume == pytest.approx(signed_volume(solid), rel=1e-4)


@pytest.mark.parametrize("base", [0.0, -1.0, np.nan, np.inf])
def test_a_base_needs_a_thickness(base: float) -> None:
    with pytest.raises(DataError, match=r"a base of .* mm is not a positive thickness"):
        solid_mesh(height_mesh(dome()[1]), base)


def test_an_edge_of_three_triangles_is_refused() -> None:
    fan = Mesh(
        np.eye(5, 3, dtype=np.float32), np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4]], np.int32)
    )
    with pytest.raises(DataError, match="belongs to more than two triangles"):
        solid_mesh(fan)
