"""Files of camera models: golden texts of each format, COLMAP's half pixel, refusals."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from acquisition import CameraModel, DataError, MissingPathError, read_camera, write_camera
from tests.cases import cases
from tests.real_data import DATA, needs_data

K = np.array([[1000.5, 0.25, 320.25], [0, 1001, 239.5], [0, 0, 1]])
CAMERA = CameraModel(K, 640, 480, 350.0, np.array([-0.1, 0.01, 1e-3, -2e-3, 1e-4]))
OURS = """\
{
 "K": [[1000.5, 0.25, 320.25], [0, 1001, 239.5], [0, 0, 1]],
 "width": 640, "height": 480,
 "format": "sgp-camera", "version": 1
}
"""
OPENCV = """\
%YAML:1.0
---
calibration_time: "Tue Jan  6 2026"
image_width: 640
image_height: 480
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 1000.5, 0., 320.25, 0., 1001., 239.5, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ -0.1, 0.01, 0., 0., 0.2 ]
"""


def put(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


@pytest.mark.parametrize("suffix", [".json", ".yml", ".yaml"])
@pytest.mark.parametrize("distance_mm", [350.0, None])
def test_written_and_read_back_exactly(
    tmp_path: Path, suffix: str, distance_mm: float | None
) -> None:
    camera = CameraModel(K, 640, 480, distance_mm, CAMERA.distortion)
    write_camera(tmp_path / f"camera{suffix}", camera)
    back = read_camera(tmp_path / f"camera{suffix}", (480, 640))
    np.testing.assert_array_equal(back.K, K)
    np.testing.assert_array_equal(back.distortion, CAMERA.distortion)
    assert back.size == (480, 640)
    assert back.working_distance_mm == distance_mm


def test_opencv_reads_the_written_file(tmp_path: Path) -> None:
    write_camera(tmp_path / "camera.yml", CAMERA)
    storage = cv2.FileStorage(str(tmp_path / "camera.yml"), cv2.FILE_STORAGE_READ)
    np.testing.assert_array_equal(storage.getNode("camera_matrix").mat(), K)
    assert storage.getNode("image_height").real() == 480


def test_hand_written_json(tmp_path: Path) -> None:
    camera = read_camera(put(tmp_path / "c.json", OURS))
    np.testing.assert_array_equal(camera.K, K)
    assert camera.working_distance_mm is None
    assert not camera.distortion.any()


def test_hand_written_opencv_file(tmp_path: Path) -> None:
    camera = read_camera(put(tmp_path / "c.yaml", OPENCV))
    np.testing.assert_array_equal(camera.distortion, [-0.1, 0.01, 0, 0, 0.2])
    assert (camera.width, camera.height, camera.K[0, 2]) == (640, 480, 320.25)


@pytest.mark.parametrize(
    ("line", "focal", "distortion"),
    [
        ("SIMPLE_PINHOLE 640 480 1000 320 240", (1000, 1000), [0, 0, 0, 0]),
        ("PINHOLE 640 480 1000 1001 320 240", (1000, 1001), [0, 0, 0, 0]),
        ("SIMPLE_RADIAL 640 480 1000 320 240 -0.1", (1000, 1000), [-0.1, 0, 0, 0]),
        ("RADIAL 640 480 1000 320 240 -0.1 0.02", (1000, 1000), [-0.1, 0.02, 0, 0]),
        ("OPENCV 640 480 1000 1001 320 240 1 2 3 4", (1000, 1001), [1, 2, 3, 4]),
    ],
)
def test_colmap(
    tmp_path: Path, line: str, focal: tuple[float, float], distortion: list[float]
) -> None:
    text = f"# Camera list with one line of data per camera:\n# Number of cameras: 1\n1 {line}\n"
    camera = read_camera(put(tmp_path / "cameras.txt", text))
    assert (camera.K[0, 0], camera.K[1, 1]) == focal
    # The middle of a 640 x 480 image is at 320, 240 from the corner of the first pixel, and at
    # 319.5, 239.5 from its centre.
    assert (camera.K[0, 2], camera.K[1, 2]) == (319.5, 239.5)
    assert camera.size == (480, 640)
    np.testing.assert_array_equal(camera.distortion[:4], distortion)


def test_matrix_needs_the_size(tmp_path: Path) -> None:
    path = put(tmp_path / "K.txt", "1e3 0 320\r\n0 1e3 240\r\n0 0 1\r\n")
    camera = read_camera(path, (480, 640))
    assert camera.K[0, 0] == 1000
    assert camera.size == (480, 640)
    assert camera.working_distance_mm is None
    with pytest.raises(DataError, match="no image size"):
        read_camera(path)


@cases(
    ("name", "text", "match"),
    {
        "empty json": ("c.json", "", "JSON"),
        "unknown key": ("c.json", OURS.replace('"width"', '"w"'), "w"),
        "version": ("c.json", OURS.replace('version": 1', 'version": 9'), "version"),
        "negative focal length": ("c.json", OURS.replace("1001", "-1"), "focal"),
        "no pixels": ("c.json", OURS.replace("640", "0"), "width"),
        "empty yaml": ("c.yml", "", "OpenCV"),
        "yaml list": ("c.yml", "- 1\n- 2\n", "OpenCV"),
        "yaml cut short": ("c.yml", "%YAML:1.0\n---\na: [1,", "OpenCV"),
        "no K": ("c.yml", OPENCV.replace("camera_matrix", "k"), "camera_matrix"),
        "no size": ("c.yml", OPENCV.replace("image_width", "iw"), "no image size"),
        "rational distortion": (
            "c.yml",
            OPENCV.replace("rows: 5", "rows: 8").replace("0.2 ]", "0.2, 1., 2., 3. ]"),
            "five distortion",
        ),
        "NaN": ("c.yml", OPENCV.replace("1001.", ".nan"), "finite"),
        "two rows": ("K.txt", "1 0 0\n0 1 0\n", "neither"),
        "empty text": ("K.txt", "", "neither"),
        "text in K": ("K.txt", "1 0 0\n0 x 0\n0 0 1\n", "not all finite numbers"),
        "fisheye": ("cameras.txt", "1 FISHEYE 6 4 1 1 1\n", "line 1: model FISHEYE"),
        "count": ("cameras.txt", "1 PINHOLE 6 4 1 1 1\n", "PINHOLE must have 4"),
        "NaN size": ("cameras.txt", "1 PINHOLE nan 4 1 1 1 1\n", "finite"),
        "two": ("cameras.txt", "1 PINHOLE 6 4 1 1 1 1\n2 PINHOLE 6 4 1 1 1 1\n", "2 cameras"),
    },
)
def test_refused(tmp_path: Path, name: str, text: str, match: str) -> None:
    path = put(tmp_path / name, text)
    size = None if match == "no image size" else (480, 640)
    with pytest.raises(DataError, match=match) as caught:
        read_camera(path, size)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_another_size_than_the_images(tmp_path: Path) -> None:
    path = put(tmp_path / "c.yml", OPENCV)
    with pytest.raises(DataError, match="640 x 480 pixels, but the images have 320 x 240"):
        read_camera(path, (240, 320))


def test_paths(tmp_path: Path) -> None:
    with pytest.raises(MissingPathError, match="no such file"):
        read_camera(tmp_path / "c.json")
    with pytest.raises(DataError, match="a folder"):
        read_camera(tmp_path)
    with pytest.raises(DataError, match="choose one"):
        write_camera(tmp_path / "c.xml", CAMERA)


@needs_data
def test_real_matrix() -> None:
    path = DATA / "normals" / "diligent" / "bear" / "K.txt"
    camera = read_camera(path, (512, 612))
    np.testing.assert_allclose(camera.K[0], [3772.07747, 0, 305.875], rtol=1e-8)
