"""`sgp normals --align`: images of a camera that moved."""

import cv2
import numpy as np
import pytest

from acquisition import angle_deg, read_image, read_lights, write_png
from sgp import read_record
from sgp.stages.result_source import find_normals, open_source_of
from tests.calibration.spheres_and_object import directions, printed

EVERY = [f"L{k:02d}.png" for k in range(8)]


@pytest.fixture
def moved(recording):
    """The ball with fine paint, of which the last three images are two pixels further right."""
    noise = np.random.default_rng(3).normal(size=(40, 48))
    paint = 0.7 + 0.2 * np.tanh(3 * cv2.GaussianBlur(noise, (0, 0), 1.2))
    for number in range(8):
        path = recording / f"ball.{number}.png"
        image = np.rint(read_image(path) * paint).astype(np.uint16)
        write_png(path, np.roll(image, 2 if number > 4 else 0, axis=1))
    return recording


def test_shifts_are_recorded_and_off_leaves_the_images(sgp, moved, tmp_path):
    words = ("normals", moved, "--lights", tmp_path / "lights.json", "--method", "ls")
    sgp(*words, "--out", tmp_path / "out").ok()
    record = read_record(tmp_path / "out" / "normals.json")
    shifts = record.metrics["shifts_px"]
    assert set(shifts) == {"ball.5", "ball.6", "ball.7"}
    for right, down in shifts.values():
        assert (right, down) == (pytest.approx(2, abs=0.1), pytest.approx(0, abs=0.1))
    assert "images-aligned" in [notice.code for notice in record.notices]
    # Commands that read the images of the result again move them back, too.
    again, _ = open_source_of(tmp_path / "out", find_normals(tmp_path / "out"), 10**6)
    assert {name: [*by] for name, by in again.source.shifts_px.items()} == shifts
    sgp(*words, "--out", tmp_path / "off", "--align", "off").ok()
    assert "shifts_px" not in read_record(tmp_path / "off" / "normals.json").metrics


@pytest.mark.slow
def test_the_camera_is_held_by_hand(sgp, tmp_path):
    """Lights are found although the ball moves, and the object is aligned better than that."""
    folder, out = tmp_path / "photographs", tmp_path / "out"
    folder.mkdir()
    by = np.linspace(-6, 6, 8).round().astype(int)
    for path, image, right in zip(EVERY, printed(folder), by, strict=True):
        write_png(folder / path, np.roll(image, right, axis=1))
    result = sgp("normals", folder, "--spheres", "--out", out, "--json").ok()
    assert "images-aligned" in result.codes()
    shifts = read_record(out / "normals.json").metrics["shifts_px"]
    measured = [shifts.get(path[:3], (0, 0))[0] for path in EVERY]
    error = measured - by
    assert np.abs(error - error.mean()).max() < 0.1
    lights = read_lights(out / "lights.json")
    assert angle_deg(lights.unit_directions, directions()).max() < 1.2
    message = sgp("normals", folder, "--spheres", "--align", "off", "--out", out, "--force")
    assert message.code != 0
