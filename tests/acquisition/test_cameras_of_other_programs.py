"""Cameras in files of OpenCV, COLMAP and AliceVision."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from acquisition import CameraModel, DataError, read_camera, write_camera
from tests.cases import cases

K = np.array([[1000.5, 0.0, 320.25], [0.0, 1001.0, 239.5], [0.0, 0.0, 1.0]])
FIVE = np.array([-0.1, 0.01, 1e-3, -2e-3, 1e-4])

# A pinhole of 36 mm on 640 px: 1000 px are 56.25 mm.
SCENE: dict[str, Any] = {
    "version": ["1", "2", "6"],
    "intrinsics": [
        {
            "width": "640", "height": "480", "sensorWidth": "36", "sensorHeight": "27",
            "type": "pinhole", "focalLength": "56.25", "pixelRatio": "1",
            "principalPoint": ["3.5", "-2.25"], "distortionType": "radialk3",
            "distortionParams": ["-0.1", "0.02", "0.003"], "undistortionOffset": ["0", "0"],
            "undistortionParams": [],
        }
    ],
}  # fmt: skip


def scene(path: Path, **changes: Any) -> Path:
    version = changes.pop("version", SCENE["version"])
    camera = {**SCENE["intrinsics"][0], **changes}
    path.write_text(json.dumps({"version": version, "intrinsics": [camera]}))
    return path


@cases(
    ("changes", "K", "distortion"),
    {
        "an offset from half the size, with k1 k2 k3": (
            {},
            [[1000, 0, 323.5], [0, 1000, 237.75], [0, 0, 1]],
            [-0.1, 0.02, 0, 0, 0.003],
        ),
        "before 1.2.1 a position, and a focal length in pixels": (
            {
                "version": ["1", "2", "0"],
                "pxFocalLength": "1200",
                "principalPoint": ["323.5", "237.75"],
            },
            [[1200, 0, 323.5], [0, 1200, 237.75], [0, 0, 1]],
            [-0.1, 0.02, 0, 0, 0.003],
        ),
        "1.2.1: an offset, and two focal lengths in pixels": (
            {"version": ["1", "2", "1"], "pxFocalLength": ["1200", "1210"]},
            [[1200, 0, 323.5], [0, 1210, 237.75], [0, 0, 1]],
            [-0.1, 0.02, 0, 0, 0.003],
        ),
        "brown: k1 k2 k3 t1 t2": (
            {"distortionType": "brown", "distortionParams": [1, 2, 3, 4, 5]},
            [[1000, 0, 323.5], [0, 1000, 237.75], [0, 0, 1]],
            [1, 2, 4, 5, 3],
        ),
        "no distortion, and pixels that are not square": (
            {"distortionType": "none", "distortionParams": [], "pixelRatio": 1.25},
            [[1000, 0, 323.5], [0, 800, 237.75], [0, 0, 1]],
            [0, 0, 0, 0, 0],
        ),
    },
)
@pytest.mark.parametrize("name", ["cameraInit.sfm", "sfm.json"])
def test_alicevision(tmp_path: Path, name: str, changes: Any, K: Any, distortion: Any) -> None:
    camera = read_camera(scene(tmp_path / name, **changes))
    np.testing.assert_allclose(camera.K, K, rtol=1e-12)
    np.testing.assert_allclose(camera.distortion, distortion, rtol=1e-12)
    assert camera.size == (480, 640)


@cases(
    ("changes", "match"),
    {
        "fisheye": ({"type": "equidistant"}, "'equidistant' is not supported"),
        "anamorphic": ({"distortionType": "3deanamorphic4"}, "3deanamorphic4"),
        "count": ({"distortionParams": ["1"]}, "must have 3 numbers"),
        "text": ({"distortionParams": ["1", "x", "2"]}, "not a finite number"),
        "nan": ({"focalLength": "nan"}, "focalLength is 'nan'"),
        "negative": ({"focalLength": "-5"}, "focal"),
        "width": ({"width": "640.5"}, "not a whole number"),
        "sensor": ({"sensorWidth": 0}, "must be positive"),
        "point": ({"principalPoint": ["1"]}, "must have two numbers"),
        "undistortion": ({"undistortionOffset": ["1", "0"]}, "undistortion"),
        "version": ({"version": ["a"]}, "version"),
    },
)
def test_alicevision_is_refused(tmp_path: Path, changes: Any, match: str) -> None:
    path = scene(tmp_path / "c.sfm", **changes)
    with pytest.raises(DataError, match=match) as caught:
        read_camera(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("count", [0, 2])
def test_alicevision_with_another_number_of_cameras(tmp_path: Path, count: int) -> None:
    path = tmp_path / "c.sfm"
    path.write_text(json.dumps({**SCENE, "intrinsics": SCENE["intrinsics"] * count}))
    with pytest.raises(DataError, match="no camera" if count == 0 else "2 cameras"):
        read_camera(path)


@pytest.mark.parametrize("suffix", [".json", ".yml", ".xml"])
def test_files_that_opencv_wrote(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"opencv{suffix}"
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("image_width", 640)
    storage.write("image_height", 480)
    storage.write("camera_matrix", K)
    storage.write("distortion_coefficients", FIVE[None])
    storage.release()
    camera = read_camera(path)
    np.testing.assert_array_equal(camera.K, K)
    np.testing.assert_array_equal(camera.distortion, FIVE)
    assert camera.size == (480, 640)


def test_full_opencv(tmp_path: Path) -> None:
    path = tmp_path / "cameras.txt"
    line = "1 FULL_OPENCV 640 480 1000 1001 320 240 1 2 3 4 5 {} 0 0\n"
    path.write_text(line.format(0))
    np.testing.assert_array_equal(read_camera(path).distortion, [1, 2, 3, 4, 5])
    path.write_text(line.format(0.1))
    with pytest.raises(DataError, match="k4 to k6 are not supported"):
        read_camera(path)


@cases(
    ("distortion", "model"),
    {
        "with k3": (FIVE, "FULL_OPENCV"),
        "without k3": (FIVE * [1, 1, 1, 1, 0], "OPENCV"),
        "none": (np.zeros(5), "PINHOLE"),
    },
)
def test_cameras_txt_is_read_back(tmp_path: Path, distortion: Any, model: str) -> None:
    path = tmp_path / "cameras.txt"
    write_camera(path, CameraModel(K, 640, 480, None, distortion))
    words = path.read_text().splitlines()[-1].split()
    assert words[1] == model
    centre = (4, 5) if len(words) < 8 else (6, 7)
    assert [float(words[k]) for k in centre] == [320.75, 240.0]
    back = read_camera(path)
    np.testing.assert_allclose(back.K, K, rtol=1e-15)
    np.testing.assert_array_equal(back.distortion, distortion)


def test_cameras_txt_has_no_skew(tmp_path: Path) -> None:
    skewed = K.copy()
    skewed[0, 1] = 0.5
    with pytest.raises(DataError, match="skew"):
        write_camera(tmp_path / "cameras.txt", CameraModel(skewed, 640, 480))
    assert not (tmp_path / "cameras.txt").exists()
