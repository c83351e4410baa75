"""Without a sphere, a picture shows what may be one."""

import cv2
import numpy as np


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
