"""Camera files of OpenCV: the nodes of a calibration in YAML, XML or JSON."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np

from acquisition._errors import DataError
from acquisition._value_files.opencv_storage import matrix_of, number_of, read_storage
from acquisition._values.camera_model import CameraModel

# Names of the nodes in OpenCV's samples, and in files of other programs that write the same format.
_MATRIX: Final = ("camera_matrix", "Camera_Matrix", "K", "M", "M1")
_DISTORTION: Final = ("distortion_coefficients", "Distortion_Coefficients", "dist_coeffs", "D")
_FISHEYE: Final = ("fisheye_model", "fisheye")
_MODEL: Final = ("distortion_model",)
# ROS calls the five coefficients of OpenCV plumb_bob.
_BROWN: Final = ("plumb_bob", "rational_polynomial", "radtan", "brown", "none", "")

Nodes = Mapping[str, str | dict[str, str]]


def camera_of_storage(text: str, path: Path, size: tuple[int, int] | None) -> CameraModel:
    """Return the camera of a YAML or XML file; ``size`` is used if it has none."""
    return _camera_of(read_storage(text, path), path, size)


def camera_of_json(content: Mapping[str, Any], path: Path) -> CameraModel:
    """Return the camera of a parsed JSON file of OpenCV's FileStorage."""
    return _camera_of({name: _node(value) for name, value in content.items()}, path, None)


def has_camera(content: Mapping[str, Any]) -> bool:
    """Return whether a parsed JSON file has a camera matrix under a name of OpenCV."""
    return any(name in content for name in _MATRIX)


def opencv_text(camera: CameraModel) -> str:
    """Return a camera as the text of a YAML file, with our addition working_distance_mm."""
    storage = cv2.FileStorage(".yml", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    storage.write("image_width", camera.width)
    storage.write("image_height", camera.height)
    storage.write("camera_matrix", camera.K)
    storage.write("distortion_coefficients", camera.distortion[None])
    if camera.working_distance_mm is not None:
        storage.write("working_distance_mm", camera.working_distance_mm)
    return storage.releaseAndGetString()


def _camera_of(nodes: Nodes, path: Path, size: tuple[int, int] | None) -> CameraModel:
    name = next((name for name in _MATRIX if name in nodes), _MATRIX[0])
    K = matrix_of(nodes.get(name), name, path)
    if K is None:
        raise DataError(
            f"{path}: camera_matrix is missing: write the file with OpenCV's FileStorage"
        )
    _check_model(nodes, path)
    name = next((name for name in _DISTORTION if name in nodes), _DISTORTION[0])
    distortion = matrix_of(nodes.get(name), name, path)
    sides = [number_of(nodes.get(side)) for side in ("image_height", "image_width")]
    whole = [int(side) for side in sides if side is not None and float(side).is_integer()]
    if len(whole) == 2:
        size = whole[0], whole[1]
    distance_mm = number_of(nodes.get("working_distance_mm"))
    coefficients = np.zeros(0) if distortion is None else distortion.ravel()
    if np.any(coefficients[5:]):
        raise DataError(f"{path}: more than five distortion coefficients: calibrate with five")
    height, width = known_size(size, path)
    return CameraModel(K, width, height, distance_mm, coefficients[:5])


def _check_model(nodes: Nodes, path: Path) -> None:
    """Refuse a distortion model whose coefficients have another meaning."""
    for name in _MODEL:
        model = str(nodes.get(name, "")).strip().strip('"').lower()
        if model not in _BROWN:
            raise DataError(
                f"{path}: {name} {model[:40]} is not supported: calibrate with OpenCV's five "
                "coefficients (plumb_bob)"
            )
    for name in _FISHEYE:
        if number_of(nodes.get(name)):
            raise DataError(
                f"{path}: the fisheye model is not supported: calibrate with OpenCV's five "
                "coefficients"
            )


def known_size(size: tuple[int, int] | None, path: Path) -> tuple[int, int]:
    """Return a size that must be known, (height, width).

    Raises
    ------
    DataError
        If it is None; the message names ``path``.
    """
    if size is None:
        raise DataError(f"{path}: the file has no image size: give the camera with its images")
    return size


def _node(value: object) -> str | dict[str, str]:
    """Return a value of a JSON file as `read_storage` returns one of a YAML file."""
    if not isinstance(value, dict):
        return str(value)
    parts = {str(name): str(part) for name, part in value.items() if not isinstance(part, list)}
    data = value.get("data")
    if isinstance(data, list):
        parts["data"] = " ".join(str(number) for number in data)
    return parts
