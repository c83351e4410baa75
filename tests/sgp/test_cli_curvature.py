"""The command for curvature, on the normals of a ball."""

import numpy as np
import pytest

from acquisition import read_image, write_mask
from benchmarks.relief_fields import View, relief, seen, write_field
from processing import NormalMap, write_normals
from sgp.results import read_record


@pytest.fixture
def ball(tmp_path):
    y, x = np.mgrid[20:-21:-1, -20:21] / 50
    normal_map = NormalMap.from_vectors(np.dstack([x, y, np.sqrt(1 - x**2 - y**2)]), x < 0.3)
    write_normals(tmp_path / "ball", normal_map)
    return tmp_path / "ball"


def test_a_ball(sgp, ball, tmp_path):
    out = tmp_path / "out"
    metrics = sgp("curvature", ball, "--pixel-mm", "0.1", "--out", out, "--json").figures()
    assert metrics["unit"] == "mm"
    assert metrics["pixels"] == 41 * 35
    assert metrics["scale"] == pytest.approx(0.2)
    assert metrics["mean_median"] == pytest.approx(0.2, rel=1e-3)
    assert metrics["gaussian_median"] == pytest.approx(0.04, rel=1e-3)
    mean = read_image(out / "curvature_mean.exr")
    assert np.isnan(mean[:, 35:]).all()
    np.testing.assert_allclose(mean[:, :35], 0.2, rtol=5e-3)
    slope = read_image(out / "gradient_y.exr")
    assert slope[2, 10] < 0 < slope[-2, 10]  # the ball falls away upward above its top
    assert {path.name for path in out.iterdir()} == {
        "curvature.json",
        "curvature.png",
        "curvature_direction_deg.exr",
        "curvature_gaussian.exr",
        "curvature_mean.exr",
        "gradient_x.exr",
        "gradient_y.exr",
    }


def test_a_mask_and_pixels(sgp, ball, tmp_path):
    mask = np.zeros((41, 41), bool)
    mask[5:30, 5:30] = True
    write_mask(tmp_path / "part.png", mask)
    words = ("curvature", ball, "--mask", tmp_path / "part.png", "--scale", "1.5")
    answer = sgp(*words, "--out", tmp_path / "out").ok()
    assert "1/px" in answer.out
    assert "625 of 625 pixels" in answer.out


@pytest.mark.parametrize("name", ["", "normals.exr"])
def test_the_scale_of_a_result_is_that_of_its_record(sgp, tmp_path, name):
    field, _ = seen(relief((120, 120), 5), View(60, 60, 0.0), (50, 60), 1)
    normals = write_field(tmp_path / "n", field, pixel_mm=0.05, downscale=2) / name
    folders = [tmp_path / part for part in ("c", "s", "other")]
    curvature = sgp("curvature", normals, "--out", folders[0], "--json").figures()
    assert (curvature["unit"], curvature["scale"]) == ("mm", pytest.approx(0.2))
    surface = sgp("surface", normals, "--out", folders[1], "--json").figures()
    other = sgp("surface", normals, "--out", folders[2], "--pixel-mm", "0.2", "--json").figures()
    assert surface["unit"] == other["unit"] == "mm"
    assert other["height_range"] == pytest.approx(2 * surface["height_range"], rel=1e-3)
    assert read_record(folders[1] / "surface.json").parameters["pixel_mm"] == 0.1


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (("--scale", "0.1"), 2, "0.3"),
        (("--depth", "ball/normals.png"), 4, "camera with a working distance"),
        (("--mask", "line.png"), 5, "neighbours that are not on a line"),
    ],
)
def test_bad_input(sgp, ball, tmp_path, monkeypatch, words, code, message):
    monkeypatch.chdir(tmp_path)
    line = np.zeros((41, 41), bool)
    line[:, 7] = True
    write_mask(tmp_path / "line.png", line)
    assert message in sgp("curvature", ball, *words, "--out", "out").error_line(code)
    assert not (tmp_path / "out").exists()
