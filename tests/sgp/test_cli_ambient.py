"""`--ambient estimate` on the command line."""

import json

import numpy as np
import pytest

from acquisition import Lights, angle_deg, write_lights, write_png
from processing import read_normals

Y, X = np.mgrid[0.75:-0.75:50j, -0.75:0.75:50j]
MASK = X**2 + Y**2 < 0.5
NORMALS = np.dstack([X, Y, np.sqrt(np.maximum(1 - X**2 - Y**2, 0.1))])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return images of a cap in a room that gives a tenth of the light, and two lists of lights."""
    place, rng = tmp_path_factory.mktemp("room"), np.random.default_rng(1)
    high, turn = np.radians(np.resize([35.0, 55, 75], 12)), np.arange(12) * 2.4
    toward = [np.cos(high) * np.cos(turn), np.cos(high) * np.sin(turn), np.sin(high)]
    lights = Lights(
        directions=np.stack(toward, 1), ids=tuple(f"cap.{i:02d}" for i in range(len(high)))
    )
    write_lights(place / "lights.json", lights)
    (place / "images").mkdir()
    for name, direction in zip(lights.ids, lights.unit_directions, strict=True):
        image = np.maximum(NORMALS @ direction, 0) + 0.1 * (1 + NORMALS[..., 2]) / 2
        image = np.where(MASK, 0.6 * image * rng.normal(1, 0.002, MASK.shape), 0)
        write_png(place / "images" / f"{name}.png", np.rint(65535 * image).astype(np.uint16))
    write_png(place / "images" / "mask.png", (255 * MASK).astype(np.uint8))
    return place


def words(folder):
    return ("normals", folder / "images", "--lights", folder / "lights.json", "--method", "cauchy")


def test_the_light_of_the_room_is_found_subtracted_and_recorded(sgp, folder, tmp_path):
    out = tmp_path / "out"
    answer = sgp(*words(folder), "--ambient", "estimate", "--out", out).ok()
    assert "constant light of 10" in answer.out
    record = json.loads((out / "normals.json").read_text(encoding="utf-8"))
    assert record["parameters"]["ambient"] == "estimate"
    metrics = record["metrics"]
    assert metrics["ambient_level"] == pytest.approx(0.1, abs=0.003)
    assert 0 < metrics["ambient_sigma"] < 0.01
    assert angle_deg(read_normals(out).normal_map.normals, NORMALS)[MASK].mean() < 0.3


def test_three_lights_do_not_determine_it(sgp, folder, tmp_path):
    given = ("--ambient", "estimate", "--exclude", "3-11", "--out", tmp_path / "out")
    assert "at least 5 are required" in sgp(*words(folder), *given).error_line(5)
    assert not (tmp_path / "out").exists()
