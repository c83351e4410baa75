"""Colours of meshes, read back with another program, and heights as 16-bit pictures."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh

from acquisition import DataError, read_image
from processing import NormalMap, integrate, write_mesh
from processing.surface import height_picture
from tests.processing.test_mesh_files import read

HEIGHT, WIDTH = 13, 17


def surface():
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    vectors = np.stack([(x - 8) / 20, (6 - y) / 20, np.ones((HEIGHT, WIDTH))], axis=2)
    mask = (x - 8) ** 2 + (y - 6) ** 2 < 30
    normal_map = NormalMap.from_vectors(vectors, mask)
    return normal_map, integrate(normal_map, pixel_mm=0.5)


@pytest.fixture
def colours() -> np.ndarray:
    return np.random.default_rng(3).integers(0, 256, (HEIGHT, WIDTH, 3)).astype(np.uint8)


def texels(mesh: trimesh.Trimesh, image: np.ndarray) -> np.ndarray:
    """Return the colours of the pixels that contain the texture coordinates of the vertices."""
    height, width = image.shape[:2]
    across, up = (mesh.visual.uv * (width, height)).T  # trimesh counts upward for every format
    column, row = across - 0.5, height - up - 0.5
    np.testing.assert_allclose([column, row], np.rint([column, row]), atol=1e-4)
    return image[np.rint(row).astype(int), np.rint(column).astype(int)]


@pytest.mark.parametrize("with_normals", [False, True])
@pytest.mark.parametrize("suffix", ["ply", "glb", "obj"])
def test_another_program_finds_the_colours_at_the_vertices(
    tmp_path: Path, colours, suffix, with_normals
) -> None:
    normal_map, height_map = surface()
    path = tmp_path / f"bowl.{suffix}"
    given = normal_map if with_normals else None
    files = write_mesh(path, height_map, normals=given, colours=colours)
    mesh = read(path)
    points = height_map.points()[height_map.mask] * (1e-3 if suffix == "glb" else 1)
    np.testing.assert_allclose(mesh.vertices, points, atol=1e-5)
    expected = colours[height_map.mask]
    if suffix == "ply":
        found = mesh.visual.vertex_colors[:, :3]
    else:
        material = mesh.visual.material
        image = material.baseColorTexture if suffix == "glb" else material.image
        found = texels(mesh, np.asarray(image))
    np.testing.assert_array_equal(found, expected)
    if with_normals:
        np.testing.assert_allclose(
            mesh.vertex_normals, normal_map.normals[height_map.mask], atol=1e-4
        )
    assert files[0] == path
    assert sorted(files) == sorted(tmp_path.iterdir())
    assert len(files) == (3 if suffix == "obj" else 1)


@pytest.mark.parametrize("painted", [False, True])
def test_normals_as_a_texture(tmp_path: Path, colours, painted) -> None:
    """The tangent space of the texture is the frame of the mesh, by normals and tangents."""
    normal_map, height_map = surface()
    path = tmp_path / "a.glb"
    paint = colours if painted else None
    write_mesh(path, height_map, normals=normal_map, colours=paint, normal_texture=True)
    mesh = read(path)
    np.testing.assert_array_equal(
        mesh.vertex_normals, np.tile([0, 0, 1.0], (len(mesh.vertices), 1))
    )
    data = path.read_bytes()
    document = json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])
    assert all(view["byteOffset"] % 4 == 0 for view in document["bufferViews"])
    accessor = document["meshes"][0]["primitives"][0]["attributes"]["TANGENT"]
    view = document["bufferViews"][document["accessors"][accessor]["bufferView"]]
    begin = 28 + int.from_bytes(data[12:16], "little") + view["byteOffset"]
    tangents = np.frombuffer(data[begin : begin + view["byteLength"]], "<f4").reshape(-1, 4)
    np.testing.assert_array_equal(tangents, np.tile([1, 0, 0, 1.0], (len(mesh.vertices), 1)))
    material = mesh.visual.material
    found = texels(mesh, np.asarray(material.normalTexture)) / 255 * 2 - 1
    np.testing.assert_allclose(found, normal_map.normals[height_map.mask], atol=0.5 / 127)
    assert (material.baseColorTexture is not None) == painted
    if painted:
        image = np.asarray(material.baseColorTexture)
        np.testing.assert_array_equal(texels(mesh, image), colours[height_map.mask])


def test_a_texture_of_normals_requires_normals(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="requires normals"):
        write_mesh(tmp_path / "a.glb", surface()[1], normal_texture=True)


def test_the_texture_is_the_mean_colour_outside(tmp_path: Path, colours) -> None:
    _, height_map = surface()
    _, material, image = write_mesh(tmp_path / "a.obj", height_map, colours=colours)
    assert f"map_Kd {image.name}\n" in material.read_text()
    texture = read_image(image)
    mean = colours[height_map.mask].mean(axis=0)
    assert np.abs(texture[~height_map.mask] - mean).max() <= 0.5


def test_gray_colours_and_files_without_colour(tmp_path: Path, colours) -> None:
    _, height_map = surface()
    write_mesh(tmp_path / "a.ply", height_map, colours=colours[..., 0])
    found = read(tmp_path / "a.ply").visual.vertex_colors[:, :3]
    np.testing.assert_array_equal(found, np.repeat(colours[..., :1], 3, 2)[height_map.mask])
    write_mesh(tmp_path / "a.glb", height_map, colours=colours[..., 0])
    assert trimesh.load(tmp_path / "a.glb", force="mesh").visual.uv.shape[1] == 2
    assert write_mesh(tmp_path / "a.stl", height_map, colours=colours) == (tmp_path / "a.stl",)
    assert b"TEXCOORD" in (tmp_path / "a.glb").read_bytes()
    write_mesh(tmp_path / "b.glb", height_map)
    assert b"material" not in (tmp_path / "b.glb").read_bytes()


@pytest.mark.parametrize(
    ("shape", "kind"),
    [((5, 5, 3), "u1"), ((HEIGHT, WIDTH, 3), "f4"), ((HEIGHT, WIDTH, 4), "u1")],
    ids=["size", "type", "channels"],
)
def test_wrong_colours_are_refused(tmp_path: Path, shape, kind) -> None:
    wrong = np.zeros(shape, kind)
    with pytest.raises(DataError, match="do not fit a height map"):
        write_mesh(tmp_path / "a.ply", surface()[1], colours=wrong)
    assert not list(tmp_path.iterdir())


def test_a_height_picture_gives_the_height_back() -> None:
    _, height_map = surface()
    picture = height_picture(height_map)
    pixels = picture.pixels[:]
    np.testing.assert_array_equal(pixels > 0, height_map.mask)
    assert (pixels[height_map.mask].min(), pixels.max()) == (1, 65535)
    found = picture.base + picture.step * pixels[height_map.mask].astype(float)
    assert np.abs(found - height_map.height[height_map.mask]).max() <= picture.step * 0.51


def test_a_flat_height_has_a_picture() -> None:
    flat = integrate(NormalMap.from_vectors(np.tile([0.0, 0, 1], (4, 5, 1))))
    picture = height_picture(flat)
    assert (picture.pixels[:] == 1).all()
    assert picture.base + picture.step == pytest.approx(0)


def test_a_written_height_states_its_scale(tmp_path: Path) -> None:
    from sgp.stages.write_surface import write_surface

    normal_map, height_map = surface()
    result = write_surface(tmp_path, height_map, normal_map)
    stored = cv2.imread(str(tmp_path / "height.png"), cv2.IMREAD_UNCHANGED)
    assert (stored.dtype, stored.shape) == (np.uint16, (HEIGHT, WIDTH))
    scale = result.parameters["height_png"]
    inside = height_map.mask
    found = scale["base"] + scale["step"] * stored[inside].astype(float)
    assert np.abs(found - height_map.height[inside]).max() <= scale["step"]
    text = f"height in mm = {scale['base']:.9g} + {scale['step']:.9g} * sample"
    assert text.encode() in (tmp_path / "height.png").read_bytes()
