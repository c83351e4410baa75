"""Exports for viewers of relightable images, on the images of a ball."""

import json
import shutil

import numpy as np
import pytest

from acquisition import read_image, write_png
from processing.relight import read_ptm
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
