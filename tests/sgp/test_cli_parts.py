"""``--exclude``, ``--crop`` and ``--downscale`` of the commands that process a recording."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from acquisition import angle_deg, read_image, read_mask
from processing import read_normals
from tests.cases import cases
from tests.sgp.conftest import ball


def record(path: Path) -> dict:
    return json.loads(path.read_text(encoding="utf-8"))


@pytest.fixture
def given(recording, tmp_path) -> list:
    return [recording, "--lights", tmp_path / "lights.json"]


def test_parts_of_a_recording_keep_their_lights(sgp, given, tmp_path) -> None:
    options = [
        "--exclude",
        "ball.7",
        "--exclude",
        "0-1",
        "--crop",
        "10,3,30,34",
        "--downscale",
        "2",
    ]
    scale = ["--pixel-mm", "0.5"]
    sgp("run", *given, *options, *scale, "--out", tmp_path / "out").ok()
    summary = record(tmp_path / "out" / "summary.json")
    assert summary["metrics"]["normals"]["images"] == 5
    assert summary["parameters"]["exclude"] == ["ball.7", "0-1"]
    assert summary["parameters"]["crop"] == [10, 3, 30, 34]
    assert summary["parameters"]["downscale"] == 2
    folder = tmp_path / "out"
    assert read_mask(folder / "normals" / "mask.png").shape == (17, 15)
    found = read_normals(folder / "normals").normal_map
    normals, mask = ball()
    blocks = normals[3:37, 10:40].reshape(17, 2, 15, 2, 3).mean(axis=(1, 3))
    whole = mask[3:37, 10:40].reshape(17, 2, 15, 2).all(axis=(1, 3)) & found.mask
    steep = blocks[..., 2] < 0.8  # where some lights do not reach a pixel
    error = angle_deg(found.normals, blocks)[whole & ~steep]
    assert error.size > 40
    assert error.max() < 1.0
    # The mesh is in mm of the object, whatever the resolution: two pixels of the recording apart.
    height = read_image(folder / "surface" / "height.exr")
    sgp("run", *given, *scale, "--out", tmp_path / "full").ok()
    first = np.ptp(height[np.isfinite(height)])
    second = read_image(tmp_path / "full" / "surface" / "height.exr")
    assert first == pytest.approx(np.ptp(second[np.isfinite(second)]), rel=0.35)


@cases(
    ("options", "code", "text"),
    {
        "name": (["--exclude", "L07"], 4, "there are ball.0, ball.1"),
        "too many": (["--exclude", "2-7"], 2, "--exclude leaves 2 images"),
        "comma": (["--exclude", "1,,2"], 2, "--exclude: a name is empty"),
        "three": (["--crop", "1,2,3"], 2, "1,2,3 is not a number for each of x,y,w,h"),
        "twice": (["--crop", "1,2,3,4", "--crop", "1,2,3,4"], 2, "specified multiple times"),
        "negative": (["--crop=-1,2,3,4"], 4, "from -1,2 is not inside"),
        "fraction": (["--crop", "1,2,3,4.5"], 2, "4.5 is not a whole number"),
        "outside": (["--crop", "40,0,20,20"], 4, "not inside the images of 48 x 40"),
        "zero": (["--downscale", "0"], 2, "--downscale"),
        "factor": (["--downscale", "50"], 4, "by a factor of 50: give 1 to 40"),
    },
)
def test_wrong_parts_are_refused_before_anything_is_written(
    sgp, given, tmp_path, options, code, text
) -> None:
    assert text in sgp("normals", *given, *options, "--out", tmp_path / "out").error_line(code)
    assert not (tmp_path / "out").exists()
