"""Exports: relightable images of a ball, and heights as X3P."""

import json
import shutil
from datetime import datetime

import numpy as np
import pytest

from acquisition import CameraModel, read_image, read_mask, write_camera, write_exr, write_png
from processing import NormalMap, write_normals
from processing.relight import read_ptm
from processing.surface import read_x3p
from sgp import read_record


@pytest.fixture
def result(sgp, recording, tmp_path, monkeypatch):
    """Normals of the ball; paths in the record are relative to the working directory."""
    monkeypatch.chdir(tmp_path)
    words = ("normals", "ball", "--lights", "lights.json", "--method", "ls", "--out", "result")
    assert sgp(*words).code == 0
    return tmp_path / "result"


def exported(sgp, *words):
    return sgp("export", "result", *words, "--json").report()


def test_images_of_a_recording(sgp, result, tmp_path):
    metrics = exported(sgp, "--out", "rti")["metrics"]
    assert metrics["fitted_to"] == "images"
    assert (metrics["directions"], metrics["lights"], metrics["coefficients"]) == ("distant", 8, 6)
    assert metrics["pixels_without_samples"] == 0
    assert metrics["fit_rms"] < 0.1
    assert 0 < metrics["ptm_rms"] < 0.5 < metrics["ptm_largest"] <= 1
    assert metrics["planes_rms"] < 3
    assert {path.name for path in (tmp_path / "rti").iterdir()} == {
        *("plane_0.jpg", "plane_1.jpg", "plane_2.jpg", "info.json", "relight.ptm"),
        *("fit_rms.exr", "relit.png", "export.json"),
    }
    record = read_record("rti/export.json")
    assert {"ball/ball.0.png", "lights.json", "result/normals.json"} <= set(record.inputs)
    assert record.parameters["basis"] == "ptm"
    assert read_image("rti/fit_rms.exr").shape == (40, 48)
    # Under a recorded light, the image is that frame; the ball is brighter at its upper end.
    seen = read_ptm("rti/relight.ptm").relit([0, 1, 1.5])[..., 1]
    assert seen[8, 23] > 2 * seen[31, 23]
    answer = sgp("relight", "rti/relight.ptm", "--light", "0,2,3", "--out", "up.png").ok()
    assert "48 x 40 pixels, LRGB, light from (0.00, 0.55, 0.83)" in answer.out
    picture = read_image("up.png")
    np.testing.assert_allclose(picture[..., 1], np.clip(255 * seen, 0, 255), atol=0.51)
    assert "already exists" in sgp(
        "relight", "rti/relight.ptm", "--light", "0,2,3", "--out", "up.png"
    ).error_line(2)


def test_other_bases_and_options(sgp, result, tmp_path):
    made = exported(sgp, "--basis", "hsh9", "--colours", "rgb", "--out", "rti")
    assert made["metrics"]["coefficients"] == 9
    assert "ptm_rms" not in made["metrics"]
    assert not (tmp_path / "rti" / "relight.ptm").exists()
    assert json.loads((tmp_path / "rti" / "info.json").read_text())["nplanes"] == 27
    words = ("--basis", "hsh4", "--values", "linear", "--quality", "80", "--out", "rti", "--force")
    assert exported(sgp, *words)["metrics"]["coefficients"] == 4
    # The files of the earlier export are gone.
    assert len(list((tmp_path / "rti").glob("plane_*.jpg"))) == 3


def test_images_that_are_gone_or_have_changed(sgp, result, tmp_path):
    write_png(tmp_path / "ball" / "ball.3.png", np.zeros((40, 48), np.uint16))
    line = sgp("export", "result", "--out", "rti").error_line(4)
    assert line.startswith("error: ball/ball.3.png: has changed since result was computed")
    assert not (tmp_path / "rti").exists()
    shutil.rmtree(tmp_path / "ball")
    said = sgp("export", "result", "--out", "rti", "--json").report()
    assert said["metrics"]["fitted_to"] == "normals"
    assert [notice["code"] for notice in said["notices"]] == ["relit-from-normals"]
    seen = read_ptm("rti/relight.ptm").relit([0, 1, 1.5])[..., 1]
    assert seen[8, 23] > 2 * seen[31, 23]


def test_bad_input(sgp, result, tmp_path):
    assert "give a folder that sgp run" in sgp("export", "ball", "--out", "r").error_line(2)
    for light in ("0,0,0", "0,1,-1", "0,1", "1.7e308,1.7e308,0"):
        (tmp_path / "a.ptm").write_bytes(b"PTM_1.2\n")
        words = ("relight", "a.ptm", "--light", light, "--out", "a.png")
        assert "--light" in sgp(*words).error_line(2)
    words = ("relight", "a.ptm", "--light", "0,0,1", "--out", "a.png")
    assert "not a readable polynomial texture map" in sgp(*words).error_line(4)
    record = tmp_path / "result" / "normals.json"
    record.write_text(record.read_text().replace("sgp-result", "other"))
    assert "is not the record of a result" in sgp("export", "result", "--out", "r").error_line(4)
    assert not (tmp_path / "r").exists()


@pytest.fixture
def surface(sgp, tmp_path, monkeypatch):
    """A surface of a slope that rises upward, in mm; normals in a folder next to it."""
    monkeypatch.chdir(tmp_path)
    mask = np.ones((9, 12), bool)
    mask[0, :3] = False
    write_normals("normals", NormalMap.from_vectors(np.tile([0, -0.2, 1.0], (9, 12, 1)), mask))
    sgp("surface", "normals", "--pixel-mm", "0.05", "--out", "run/surface").ok()
    return tmp_path / "run" / "surface"


def test_heights_as_x3p(sgp, surface, tmp_path):
    made = sgp("export", "run", "--format", "x3p", "--out", "x3p", "--json").report()
    height, mask = read_image(surface / "height.exr"), read_mask(surface / "mask.png")
    found = read_x3p("x3p/surface.x3p")
    np.testing.assert_array_equal(found.height, height)
    assert found.height[0, 5] > found.height[8, 5]
    assert (np.isfinite(found.height) == mask).all()
    assert found.pixel_mm == made["metrics"]["pixel_mm"] == 0.05
    assert made["metrics"]["points"] == mask.sum()
    assert made["metrics"]["height_range_mm"] == pytest.approx(8 * 0.2 * 0.05, rel=1e-5)
    assert "width_error_percent" not in made["metrics"]
    assert {path.name for path in (tmp_path / "x3p").iterdir()} == {"surface.x3p", "export.json"}
    record = read_record("run/surface/surface.json")
    for text in (record.record_sha256, record.files["height.exr"].sha256, "sgp surface"):
        assert text in found.origin.comment
    assert found.origin.version == record.software.version
    assert {*read_record("x3p/export.json").inputs} == {
        "run/surface/surface.json", "run/surface/height.exr",
    }  # fmt: skip
    sgp("export", surface, "--format", "x3p", "--out", "again").ok()
    sgp("verify", "x3p").ok()


def test_the_recording_in_an_x3p_file(sgp, surface):
    """The record is one of `sgp run` on a simulated recording with object and operator."""
    path = surface / "surface.json"
    stated = json.loads(path.read_text())
    del stated["record_sha256"]
    started = "2026-11-22T14:41:34Z"
    about = {"object": "owl", "operator": "A. B.", "rights": "CC0", "simulated": True}
    rest = {"place": "", "notes": "two\nlines", "started_utc": started}
    path.write_text(json.dumps(stated | {"recordings": [about | rest]}))
    sgp("export", "run", "--format", "x3p", "--out", "x3p").ok()
    origin = read_x3p("x3p/surface.x3p").origin
    assert (origin.creator, origin.probing) == ("A. B.", "software")
    assert origin.date == datetime.fromisoformat(started)
    assert origin.comment.startswith("SIMULATED\nobject: owl\nnotes: two lines\nrights: CC0\n")


def test_a_perspective_surface_as_x3p(sgp, surface):
    camera = CameraModel(np.diag([90.0, 90, 1]), 12, 9, working_distance_mm=300)
    write_camera("camera.json", camera)
    sgp("surface", "normals", "--camera", "camera.json", "--out", "s").ok()
    made = sgp("export", "s", "--format", "x3p", "--out", "x3p", "--json").report()
    assert [notice["code"] for notice in made["notices"]] == ["x3p-in-perspective"]
    height = read_image("s/height.exr")
    expected = 100 * np.nanmax(np.abs(height)) / 300
    assert made["metrics"]["width_error_percent"] == pytest.approx(expected, rel=1e-5)


def test_surfaces_that_are_not_exported_as_x3p(sgp, surface):
    words = ("--format", "x3p", "--out", "x3p")
    for option in (("--quality", "80"), ("--basis", "hsh9"), ("--values", "linear")):
        line = sgp("export", "run", *words, *option).error_line(2)
        assert line == f"error: {option[0]} is for --format rti, x3p has no images"
    assert "has neither surface.json nor surface/" in sgp("export", "normals", *words).error_line(2)
    sgp("surface", "normals", "--out", "s").ok()
    line = sgp("export", "s", *words).error_line(2)
    assert "the heights are in pixels" in line
    assert "--pixel-mm, or with a camera that states its working distance" in line
    write_exr(surface / "height.exr", read_image(surface / "height.exr") * np.float32(2))
    line = sgp("export", "run", *words).error_line(4)
    assert line == "error: run/surface/height.exr: was changed: run `sgp surface` again"
    (surface / "height.exr").unlink()
    assert "height.exr: is missing" in sgp("export", "run", *words).error_line(4)
    assert not (surface.parents[1] / "x3p").exists()
