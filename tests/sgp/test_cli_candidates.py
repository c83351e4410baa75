"""Without a sphere, a picture shows what may be one."""

import cv2
import numpy as np
import pytest

import calibration


def test_candidates_are_drawn_and_named(sgp, tmp_path):
    images = tmp_path / "images"
    images.mkdir()
    for k in range(4):
        image = np.full((120, 160), 30 + k, np.uint8)
        cv2.circle(image, (70, 60), 30, (150 + 10 * k,), -1, cv2.LINE_AA)
        cv2.imwrite(str(images / f"{k}.png"), image)
    picture = tmp_path / "l-candidates.png"
    line = sgp("calibrate", "spheres", images, "--out", tmp_path / "l.json").error_line(5)
    assert "no mirror sphere found" in line
    assert f"{picture} shows 1 candidate and why" in line
    drawn = cv2.imread(str(picture))
    assert drawn is not None
    assert not (tmp_path / "l.json").exists()


@pytest.mark.parametrize(
    ("marks", "proposed"),
    [
        pytest.param((), True, id="searched"),
        pytest.param(("--sphere", "70,60,45"), False, id="a circle was given"),
    ],
)
def test_a_circle_is_proposed_unless_one_was_given(sgp, tmp_path, monkeypatch, marks, proposed):
    """Before, a circle that was refused was proposed again."""

    def refuse(*args, **kwargs):
        raise calibration.EstimateError("refused")

    found = [calibration.spheres.SphereCandidate((70.0, 60.0, 45.0), 3, 0.1)]
    monkeypatch.setattr(calibration, "calibrate_spheres", refuse)
    monkeypatch.setattr(calibration.spheres, "sphere_candidates", lambda *args, **kwargs: found)
    images = tmp_path / "images"
    images.mkdir()
    for k in range(3):
        cv2.imwrite(str(images / f"{k}.png"), np.full((120, 160), 30 + k, np.uint8))
    out = "--out", tmp_path / "l.json"
    line = sgp("calibrate", "spheres", images, *marks, *out).error_line(5)
    assert "shows 1 candidate and why" in line
    assert ("add --sphere 70,60,45" in line) == proposed
