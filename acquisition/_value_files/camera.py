"""Files of camera models: our own format, OpenCV's, COLMAP's, and a plain 3 x 3 matrix."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import cv2
import numpy as np

from acquisition._errors import DataError
from acquisition._json import parse_json
from acquisition._session.value_records import CameraModelRecord
from acquisition._storage import write_durably
from acquisition._text_files import numbered_lines, read_text
from acquisition._value_files.mat_variables import read_variables
from acquisition._value_files.opencv_storage import matrix_of, number_of, read_storage
from acquisition._values.camera_model import CameraModel
from rig import check_type

# Indices of fx, fy, cx, cy, k1, k2, p1, p2 among the parameters of each COLMAP model.
_COLMAP = {
    "SIMPLE_PINHOLE": (0, 0, 1, 2),
    "PINHOLE": (0, 1, 2, 3),
    "SIMPLE_RADIAL": (0, 0, 1, 2, 3),
    "RADIAL": (0, 0, 1, 2, 3, 4),
    "OPENCV": (0, 1, 2, 3, 4, 5, 6, 7),
}
_COLMAP_PIXEL_CENTRE = 0.5
_MATLAB_FIRST_PIXEL = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]])
_OPENCV_SUFFIXES = {".yml", ".yaml", ".xml"}


class _CameraFile(CameraModelRecord):
    format: Literal["sgp-camera"] = "sgp-camera"
    version: Literal[1] = 1
    distortion: tuple[float, ...] = ()


def read_camera(path: str | Path, size: tuple[int, int] | None = None) -> CameraModel:
    """Read a camera model.

    Parameters
    ----------
    path
        ``.json`` of our own format; ``.yml``, ``.yaml`` or ``.xml`` of OpenCV with camera_matrix,
        distortion_coefficients, image_width, image_height and our addition working_distance_mm; a
        text file with a 3 x 3 matrix; or COLMAP's cameras.txt with one camera. COLMAP measures the
        principal point from the corner of the first pixel; it is shifted by half a pixel. Or a
        ``.mat`` of MATLAB with K, whose first pixel is (1, 1) and which may be transposed; it is
        shifted by one pixel.
    size
        (height, width) of the images, for files without an image size.

    Returns
    -------
    CameraModel
        Camera model; it has a working distance only if the file has one.

    Raises
    ------
    MissingPathError
        If the file does not exist.
    DataError
        If the file is invalid, has no image size and ``size`` is not given, or has another image
        size than ``size``.

    Examples
    --------
    >>> from acquisition import read_camera, write_camera
    >>> from simulator import bench_camera
    >>> write_camera("camera.json", bench_camera())
    >>> read_camera("camera.json")
    CameraModel(640 x 512 px, focal length 1307.2 px, working distance 600 mm)
    """
    path = Path(path)
    text = "" if path.suffix.lower() == ".mat" else read_text(path)
    try:
        if path.suffix.lower() == ".mat":
            camera = _parse_mat(path, size)
        elif path.suffix.lower() == ".json":
            camera = _parse_json(text, path)
        elif path.suffix.lower() in _OPENCV_SUFFIXES:
            camera = _parse_opencv(text, path, size)
        else:
            camera = _parse_text(text, path, size)
    except DataError as error:
        named = str(error).startswith(str(path))
        raise (error if named else DataError(f"{path}: {error}")) from error
    if size is not None and camera.size != size:
        raise DataError(
            f"{path}: a camera of {camera.width} x {camera.height} pixels, but the images have "
            f"{size[1]} x {size[0]}: give the camera that took them"
        )
    return camera


def write_camera(path: str | Path, camera: CameraModel) -> None:
    """Write a camera model as ``.json``, or as OpenCV's ``.yml`` or ``.yaml``; all are lossless.

    Raises
    ------
    DataError
        If the file has another suffix.
    StorageError
        If the file cannot be written.

    Examples
    --------
    >>> from acquisition import read_camera, write_camera
    >>> from simulator import bench_camera
    >>> write_camera("camera.yml", bench_camera())  # also .json
    >>> read_camera("camera.yml").working_distance_mm
    600.0
    """
    check_type("camera", camera, CameraModel, "CameraModel(K, width, height)")
    path = Path(path)
    match path.suffix.lower():
        case ".json":
            record = _CameraFile.model_validate(CameraModelRecord.of(camera).model_dump())
            text = record.model_dump_json(indent=1, exclude_none=True) + "\n"
        case ".yml" | ".yaml":
            text = _opencv_text(camera)
        case _:
            raise DataError(f"{path}: cameras are written as .json, .yml or .yaml: choose one")
    write_durably(path, text.encode())


def _parse_json(text: str, path: Path) -> CameraModel:
    return parse_json(_CameraFile, text, path).value()


def _parse_opencv(text: str, path: Path, size: tuple[int, int] | None) -> CameraModel:
    nodes = read_storage(text, path)
    K = matrix_of(nodes.get("camera_matrix"), "camera_matrix", path)
    if K is None:
        raise DataError(
            f"{path}: camera_matrix is missing: write the file with OpenCV's FileStorage"
        )
    name = "distortion_coefficients"
    distortion = matrix_of(nodes.get(name), name, path)
    sides = [number_of(nodes.get(side)) for side in ("image_height", "image_width")]
    whole = [int(side) for side in sides if side is not None and float(side).is_integer()]
    if len(whole) == 2:
        size = whole[0], whole[1]
    distance_mm = number_of(nodes.get("working_distance_mm"))
    coefficients = np.zeros(0) if distortion is None else distortion.ravel()
    if np.any(coefficients[5:]):
        raise DataError(f"{path}: more than five distortion coefficients: calibrate with five")
    height, width = _known(size, path)
    return CameraModel(K, width, height, distance_mm, coefficients[:5])


def _opencv_text(camera: CameraModel) -> str:
    storage = cv2.FileStorage(".yml", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    storage.write("image_width", camera.width)
    storage.write("image_height", camera.height)
    storage.write("camera_matrix", camera.K)
    storage.write("distortion_coefficients", camera.distortion[None])
    if camera.working_distance_mm is not None:
        storage.write("working_distance_mm", camera.working_distance_mm)
    return storage.releaseAndGetString()


def _parse_text(text: str, path: Path, size: tuple[int, int] | None) -> CameraModel:
    lines = [(number, line) for number, line in numbered_lines(text) if not line.startswith("#")]
    tokens = [line.replace(",", " ").split() for _, line in lines]
    if len(tokens) == 3 and all(len(row) == 3 for row in tokens):
        number = lines[0][0]
        K = np.reshape(_floats([word for row in tokens for word in row], path, number), (3, 3))
        height, width = _known(size, path)
        return CameraModel(K, width, height)
    if not lines or len(tokens[0]) < 4 or not tokens[0][1].isidentifier():
        raise DataError(
            f"{path}: neither a 3 x 3 matrix nor COLMAP's cameras.txt: give one of the two"
        )
    if len(lines) > 1:
        raise DataError(f"{path}: {len(lines)} cameras: keep only the one that took the images")
    (number, _), (_, model, *words) = lines[0], tokens[0]
    if model not in _COLMAP:
        raise DataError(
            f"{path} line {number}: model {model} is not supported: use one of "
            + ", ".join(_COLMAP)
        )
    values = _floats(words, path, number)
    places = _COLMAP[model]
    if len(values) != 2 + max(places) + 1:
        raise DataError(
            f"{path} line {number}: {model} must have {max(places) + 1} parameters after the "
            f"size, not {len(values) - 2}"
        )
    fx, fy, cx, cy, *distortion = (values[2 + place] for place in places)
    cx, cy = cx - _COLMAP_PIXEL_CENTRE, cy - _COLMAP_PIXEL_CENTRE
    K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    return CameraModel(K, int(values[0]), int(values[1]), None, np.array(distortion))


def _parse_mat(path: Path, size: tuple[int, int] | None) -> CameraModel:
    """Read K as MATLAB's toolbox and near_ps store it."""
    K = read_variables(path, ("K",)).get("K")
    if K is None:
        raise DataError(f"{path}: has no variable K: save the camera matrix under this name")
    if K.shape == (3, 3) and K[0, 2] == 0:
        K = K.T
    height, width = _known(size, path)
    camera = CameraModel(K, width, height)
    return CameraModel(camera.K - _MATLAB_FIRST_PIXEL, width, height)


def _floats(words: list[str], path: Path, number: int) -> list[float]:
    try:
        values = [float(word) for word in words]
    except ValueError:
        values = [np.nan]
    if not np.isfinite(values).all():
        text = " ".join(words)[:40]
        raise DataError(
            f"{path} line {number}: '{text}' are not all finite numbers: correct the line"
        )
    return values


def _known(size: tuple[int, int] | None, path: Path) -> tuple[int, int]:
    if size is None:
        raise DataError(f"{path}: the file has no image size: give the camera with its images")
    return size
