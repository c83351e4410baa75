"""Colour from photographs to albedo, meshes and their records."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh

from acquisition import SRGB, read_image, read_mask, write_png
from tests.sgp.conftest import photographed

ALBEDO = np.array([0.6, 0.4, 0.2])


@pytest.fixture
def photographs(tmp_path: Path) -> Path:
    return photographed(tmp_path / "ball", [0.6, 0.4, 0.2])


def parameters(path: Path) -> dict:
    return json.loads(path.read_text(encoding="utf-8"))["parameters"]


def test_photographs_in_colour_give_coloured_results(sgp, photographs, tmp_path) -> None:
    out = tmp_path / "out"
    lights = ["--lights", tmp_path / "lights.json"]
    answer = sgp("run", photographs, *lights, "--glb", "--obj", "--out", out, "--json").ok()
    mask = read_mask(out / "normals" / "mask.png")
    albedo = read_image(out / "normals" / "albedo.exr")
    assert albedo.shape == (*mask.shape, 3)
    np.testing.assert_allclose(np.median(albedo[mask], axis=0), ALBEDO, atol=0.01)
    picture = read_image(out / "normals" / "albedo.png")
    white = parameters(out / "normals" / "normals.json")["albedo_png"]["white"]
    assert parameters(out / "summary.json")["albedo_png"]["white"] == white
    np.testing.assert_allclose(
        np.median(white * SRGB.light(picture[mask] / 255), axis=0), ALBEDO, atol=0.01
    )
    vertices = trimesh.load(out / "surface" / "surface.ply").visual.vertex_colors[:, :3]
    inside = read_mask(out / "surface" / "mask.png")
    np.testing.assert_array_equal(vertices, picture[inside])
    outputs = json.loads(answer.out)["outputs"]
    for name in ("normals.albedo_png", "surface.height_png", "surface.obj_mtl", "surface.obj_png"):
        assert Path(outputs[name]).is_file()
    assert parameters(out / "surface" / "surface.json")["height_png"]["unit"] == "px"
    # A new run with fewer formats removes the files of the earlier one.
    sgp("run", photographs, *lights, "--out", out, "--force").ok()
    left = {path.name for path in (out / "surface").iterdir()}
    assert not left & {"surface.glb", "surface.obj", "surface.mtl", "surface_albedo.png"}


@pytest.mark.parametrize("name", ["albedo.exr", "albedo.png"])
def test_a_surface_takes_colours_from_a_file(sgp, photographs, tmp_path, name) -> None:
    made, out = tmp_path / "made", tmp_path / "out"
    lights = ["--lights", tmp_path / "lights.json"]
    assert sgp("normals", photographs, *lights, "--out", made).code == 0
    sgp("surface", made, "--albedo", made / name, "--out", out).ok()
    vertices = trimesh.load(out / "surface.ply").visual.vertex_colors[:, :3]
    picture = read_image(made / "albedo.png")[read_mask(out / "mask.png")]
    assert np.abs(vertices.astype(int) - picture).max() <= 1
    inputs = json.loads((out / "surface.json").read_text())["inputs"]
    assert str(made / name) in inputs


def test_wrong_colours_of_a_surface_are_refused(sgp, photographs, tmp_path) -> None:
    made, out = tmp_path / "made", tmp_path / "out"
    sgp("normals", photographs, "--lights", tmp_path / "lights.json", "--out", made)
    write_png(tmp_path / "small.png", np.zeros((3, 4), np.uint8))
    for path, code, text in (
        (tmp_path / "small.png", 4, "4 x 3 pixels, but the normals have 48 x 40"),
        (tmp_path / "none.png", 2, "no such file"),
    ):
        assert text in sgp("surface", made, "--albedo", path, "--out", out).error_line(code)
        assert not out.exists()


def test_gray_images_have_a_gray_albedo(sgp, recording, tmp_path) -> None:
    out = tmp_path / "out"
    sgp("normals", recording, "--lights", tmp_path / "lights.json", "--out", out).ok()
    assert read_image(out / "albedo.exr").ndim == 2
    assert read_image(out / "albedo.png").ndim == 2
