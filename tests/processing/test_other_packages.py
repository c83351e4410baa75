"""Maps and meshes as values of xarray and trimesh, and back."""

import subprocess
import sys

import numpy as np
import pytest
import trimesh

from acquisition import CameraModel, DataError
from processing import NormalMap, height_mesh, integrate
from processing.meshes import Mesh, height_dataset

MASK = np.ones((4, 6), bool)
MASK[0, :2] = False


@pytest.fixture
def normal_map():
    y, x = np.mgrid[1:-1:4j, -1:1:6j]
    return NormalMap.from_vectors(np.dstack([x, y, 0 * x + 2]), MASK)


def test_a_normal_map_and_its_dataset(normal_map):
    pytest.importorskip("xarray")
    dataset = normal_map.to_xarray()
    assert dict(dataset.sizes) == {"row": 4, "column": 6, "component": 3}
    facing = dataset["normals"].sel(row=2, column=5, component="z")
    assert float(facing) == normal_map.normals[2, 5, 2]
    # A part that other programs transposed and sorted otherwise.
    part = dataset.isel(row=slice(1, 3)).transpose("component", ...)
    again = NormalMap.from_xarray(part.sel(component=["z", "y", "x"]))
    np.testing.assert_array_equal(again.normals, normal_map.normals[1:3])
    np.testing.assert_array_equal(again.mask, MASK[1:3])
    dataset["normals"][:] = 0
    assert normal_map.normals[2, 5].any()


@pytest.mark.parametrize("name", ["normals", "mask"])
def test_a_dataset_without_a_map(normal_map, name):
    pytest.importorskip("xarray")
    dataset = normal_map.to_xarray()
    with pytest.raises(DataError, match=r"it needs normals \(row, column, component\) and mask"):
        NormalMap.from_xarray(dataset.drop_vars(name))
    with pytest.raises(DataError, match="is not a normal map"):
        NormalMap.from_xarray(dataset.rename(row="y"))


def test_heights_have_the_places_of_their_points(normal_map):
    pytest.importorskip("xarray")
    surface = integrate(normal_map, pixel_mm=0.5)
    dataset = height_dataset(surface)
    assert dataset.attrs == {"unit": "mm", "pixel_size": 0.5}
    assert {*dataset.data_vars} == {"height", "mask", "parts"}
    assert float(dataset["height"].sel(row=1, column=5).x) == 0.5 * 2.5
    assert float(dataset["height"].sel(row=1, column=5).y) == 0.5 * 0.5
    assert np.isnan(dataset["x"][0, 0])
    camera = CameraModel(np.diag([90.0, 90, 1]), 6, 4, working_distance_mm=300)
    seen = height_dataset(integrate(normal_map, camera=camera))
    np.testing.assert_allclose(seen["depth"] + seen["height"], np.where(MASK, 300, np.nan))


def test_without_xarray_the_error_names_it():
    code = (
        "import sys; sys.modules['xarray'] = None; import numpy as np, processing; "
        "processing.NormalMap.from_vectors(np.ones((2, 2, 3))).to_xarray()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stderr.splitlines()[-1] == "ImportError: this needs xarray: pip install xarray"


def test_a_mesh_of_trimesh(normal_map):
    colours = np.arange(24 * 3, dtype=np.uint8).reshape(4, 6, 3)
    surface = integrate(normal_map, pixel_mm=0.5)
    mesh = height_mesh(surface, normals=normal_map, colours=colours)
    other = mesh.to_trimesh()
    assert other.units == "mm"
    again = Mesh.from_trimesh(other)
    for name in ("vertices", "faces", "normals", "colours"):
        np.testing.assert_allclose(getattr(again, name), getattr(mesh, name), atol=1e-6)
    # Colours are those of the vertices: pixels of the mask, in reading order.
    np.testing.assert_array_equal(other.visual.vertex_colors[:, :3], colours[MASK])


def test_texture_coordinates_grow_upwards_in_trimesh(normal_map):
    mesh = height_mesh(integrate(normal_map, pixel_mm=0.5))
    uv = mesh.to_trimesh().visual.uv
    np.testing.assert_allclose(uv[0], [2.5 / 6, 1 - 0.5 / 4])
    np.testing.assert_allclose(uv[-1], [5.5 / 6, 0.5 / 4], atol=1e-6)


def test_a_mesh_that_trimesh_made():
    mesh = Mesh.from_trimesh(trimesh.creation.icosphere(subdivisions=3, radius=5.0))
    assert (mesh.vertices.dtype, mesh.faces.dtype, mesh.unit) == (np.float32, np.int32, "mm")
    assert mesh.colours is None
    np.testing.assert_allclose(mesh.normals, mesh.vertices / 5, atol=0.01)
