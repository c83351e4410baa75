"""`sgp normals --align`: images of a camera that moved."""

import cv2
import numpy as np
import pytest

from acquisition import read_image, write_png
from sgp import read_record


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
    sgp(*words, "--out", tmp_path / "off", "--align", "off").ok()
    assert "shifts_px" not in read_record(tmp_path / "off" / "normals.json").metrics
