"""``sgp calibrate spheres`` with several recordings, between which the spheres were moved."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from acquisition import read_lights, write_png
from sgp.calibrate import Marks, marks_of
from tests.calibration.moved import masks, rendered, write_folder
from tests.cases import cases


@pytest.fixture(scope="module")
def two(tmp_path_factory):
    folder = tmp_path_factory.mktemp("moved")
    return [write_folder(folder / name, k) for k, name in enumerate(("first", "moved"))]


def words(two, *more):
    return ("calibrate", "spheres", *two, "--camera", two[0].parent / "camera.json", *more)


@pytest.mark.slow
def test_two_recordings_give_one_calibration(sgp, two, tmp_path):
    found, given = tmp_path / "l.json", []
    for k in (0, 1):
        for ball in (0, 1):
            path = tmp_path / f"{k}{ball}.png"
            write_png(path, np.rint(255 * np.clip(masks(k)[ball], 0, 1)).astype(np.uint8))
            given += ["--mask", f"{k + 1}:{path}"]
    options = ("--radius-mm", 20, "--radius-mm", 16, *given, "--out", found, "--json")
    figures = sgp(*words(two, *options)).figures()["spheres"]
    assert [figure["recording"] for figure in figures] == [str(two[0])] * 2 + [str(two[1])] * 2
    lights = read_lights(found)
    truth = rendered(0).truth.lights.positions_mm
    assert np.linalg.norm(lights.positions_mm - truth, axis=1).mean() < 3
    record = json.loads(found.read_text())
    # Two folders of six images, the camera, and four masks.
    assert len(record["provenance"]["inputs"]) == 17
    assert record["provenance"]["parameters"]["source"] == [str(path) for path in two]
    recordings = [sphere["recording"] for sphere in record["calibrated"]["spheres"]]
    assert recordings == [str(two[0])] * 2 + [str(two[1])] * 2
    assert cv2.imread(str(tmp_path / "l.png")).shape[0] > 900  # three rows of panels


@pytest.mark.parametrize("command", ["spheres", "intensities"])
def test_one_recording_does_not_count_twice(sgp, two, tmp_path, monkeypatch, command):
    """It would be two measurements, with standard deviations that are too small."""
    monkeypatch.chdir(two[0].parent)
    lights = ("--lights", two[0].parent / "camera.json") if command == "intensities" else ()
    for again in (two[0], "first/", "./moved/../first"):
        asked = ("calibrate", command, two[0], two[1], again, *lights, "--out", tmp_path / "l.json")
        assert "is given twice" in sgp(*asked).error_line(2)


def test_a_circle_belongs_to_the_recording_with_its_number():
    marks = marks_of(["1:a:b.png"], ["2:80,90,20.5", "2:1,2,3"], 2)
    assert marks[0] == Marks([Path("a:b.png")])
    assert marks[1] == Marks([], [(80, 90, 20.5), (1, 2, 3)])
    assert marks_of(["2:a.png"], [], 1) == [Marks([Path("2:a.png")])]


@cases(
    ("options", "says"),
    {
        "circle": (("--sphere", "80,90,20"), "which of the 2 recordings shows this sphere?"),
        "mask": (("--mask", "ball.png"), "which of the 2 recordings"),
        "number": (("--sphere", "3:80,90,20"), "there is no recording 3"),
        "from 1": (("--sphere", "0:80,90,20"), "there is no recording 0"),
        "numbers": (("--sphere", "2:80,90"), "give 3 numbers"),
        "both": (
            ("--sphere", "2:8,9,2", "--mask", "2:a.png"),
            "both give the outlines of the spheres of recording 2",
        ),
    },
)
def test_a_mark_without_a_recording_is_refused(sgp, two, tmp_path, options, says):
    assert says in sgp(*words(two, *options, "--out", tmp_path / "l.json")).error_line(2)
    assert not (tmp_path / "l.json").exists()
