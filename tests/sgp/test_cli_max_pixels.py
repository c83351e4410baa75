"""`--max-pixels` of every command that reads images, and notes about NaN vectors."""

from __future__ import annotations

import numpy as np
import pytest

from acquisition import Lights, write_exr, write_lights, write_png
from tests.quick_sample import quick


@pytest.fixture
def normals(tmp_path):
    values = np.tile(np.float32([0, 0, 1]), (20, 20, 1))
    values[0, :3] = np.nan
    write_exr(tmp_path / "n.exr", values)
    return tmp_path / "n.exr"


@pytest.mark.parametrize(
    "command",
    quick(
        [
            "surface n.exr --out o",
            "compare n.exr n.exr",
            "detail separate n.exr --out o",
            "detail combine n.exr n.exr --out o",
            "detail transfer n.exr n.exr --out o",
            "detail properties n.exr --out o",
            "detail synthesize n.exr --size 20x20 --patch 6 --out o",
            "detail synthesize n.exr --onto n.exr --patch 6 --out o",
            "detail fill n.exr --holes n.exr --out o",
            "detail superres n.exr --scale 2 --method bicubic --out o",
            "normals images --out o",
            "run images --out o",
            "calibrate spheres images --out l.json",
            "calibrate intensities images --lights lights.json --out c.json",
            "capture import images --out o",
        ],
        every=3,
    ),
)
def test_larger_images_are_refused(sgp, tmp_path, monkeypatch, normals, command):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "images").mkdir()
    for i in range(3):
        write_png(tmp_path / "images" / f"a.{i}.png", np.zeros((20, 20), np.uint8))
    write_lights(tmp_path / "lights.json", Lights(np.eye(3)))
    line = sgp(*command.split(), "--max-pixels", 399).error_line(4)
    assert "20 x 20 pixels, 399 are allowed" in line
    assert not (tmp_path / "o").exists()
    assert "are allowed" not in sgp(*command.split(), "--max-pixels", 400).err


def test_invalid_vectors_are_reported(sgp, tmp_path, normals):
    answer = sgp("detail", "separate", normals, "--out", tmp_path / "o").ok()
    assert answer.err.startswith("warning: ")
    assert "3 pixels have a NaN or infinite vector" in answer.err
