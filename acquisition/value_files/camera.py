"""Files of camera models: our own format, and those of other programs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import model_validator

from acquisition._errors import DataError
from acquisition.files.storage import write_durably
from acquisition.files.text_files import numbered_lines, parse_json, read_text
from acquisition.session.value_records import CameraModelRecord
from acquisition.value_files.alicevision import camera_of_scene
from acquisition.value_files.colmap import camera_of_lines, colmap_text, finite_numbers
from acquisition.value_files.mat5 import read_variables
from acquisition.value_files.opencv_camera import (
    camera_of_json,
    camera_of_storage,
    has_camera,
    known_size,
    opencv_text,
)
from acquisition.values.camera_model import CameraModel
from rig import UnreadableError, check_type
from rig.files import parse_json as parse_any_json

_MATLAB_FIRST_PIXEL = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]])
_JSON_SUFFIXES = {".json", ".sfm"}
_OPENCV_SUFFIXES = {".yml", ".yaml", ".xml"}


# What version 2 of our format added.
_ADDED = frozenset({"lens", "focus_mm", "provenance"})


class _CameraFile(CameraModelRecord):
    format: Literal["sgp-camera"] = "sgp-camera"
    version: Literal[1, 2] = 1
    distortion: tuple[float, ...] = ()
    provenance: dict[str, Any] | None = None

    @model_validator(mode="after")
    def _keys_of_the_version(self) -> _CameraFile:
        added = _ADDED & self.model_fields_set
        if self.version == 1 and added:
            raise ValueError(f"unknown key {min(added)!r}: version 1 does not have it")
        return self


def read_camera(path: str | Path, size: tuple[int, int] | None = None) -> CameraModel:
    """Read a camera model.

    Parameters
    ----------
    path
        ``.json`` of our own format; ``.yml``, ``.yaml``, ``.xml`` or ``.json`` of OpenCV with
        camera_matrix, distortion_coefficients, image_width, image_height and our addition
        working_distance_mm; ``.json`` or ``.sfm`` of AliceVision with one camera, whose principal
        point is an offset from the middle of the image; a text file with a 3 x 3 matrix; or
        COLMAP's cameras.txt with one camera. COLMAP measures the principal point from the corner of
        the first pixel; it is shifted by half a pixel. Or a ``.mat`` of MATLAB with K, whose first
        pixel is (1, 1) and which may be transposed; it is shifted by one pixel.
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
        elif path.suffix.lower() in _JSON_SUFFIXES:
            camera = _parse_json(text, path)
        elif path.suffix.lower() in _OPENCV_SUFFIXES:
            camera = camera_of_storage(text, path, size)
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


def write_camera(
    path: str | Path, camera: CameraModel, provenance: dict[str, Any] | None = None
) -> None:
    """Write a camera model.

    Parameters
    ----------
    path
        Output file; its suffix selects the format. ``.json`` is lossless. OpenCV's ``.yml`` or
        ``.yaml`` has no lens and no focus. ``.txt`` is COLMAP's cameras.txt, which has no working
        distance either.
    camera
        Camera to write.
    provenance
        Origin of the camera, for ``.json`` only: names with finite values that JSON can hold.

    Raises
    ------
    DataError
        If the file has another suffix, or its format has no skew and the camera has one.
    StorageError
        If the file cannot be written.

    Examples
    --------
    >>> from acquisition import read_camera, write_camera
    >>> from simulator import bench_camera
    >>> write_camera("camera.yml", bench_camera())  # also .json, and .txt for COLMAP
    >>> read_camera("camera.yml").working_distance_mm
    600.0
    """
    check_type("camera", camera, CameraModel, "CameraModel(K, width, height)")
    path = Path(path)
    match path.suffix.lower():
        case ".json":
            text = _json_text(camera, provenance)
        case ".yml" | ".yaml":
            text = opencv_text(camera)
        case ".txt":
            text = colmap_text(camera)
        case _:
            raise DataError(
                f"{path}: cameras are written as .json, .yml, .yaml or .txt: choose one"
            )
    write_durably(path, text.encode())


def _json_text(camera: CameraModel, provenance: dict[str, Any] | None) -> str:
    values = CameraModelRecord.of(camera).model_dump(exclude_none=True)
    if provenance:
        values["provenance"] = provenance
    record = _CameraFile(version=2 if _ADDED & values.keys() else 1, **values)
    order = ("format", "version", *values)  # the provenance, which is long, is last
    content = record.model_dump(mode="json", exclude_none=True)
    return json.dumps({name: content[name] for name in order}, indent=1, allow_nan=False) + "\n"


def _parse_json(text: str, path: Path) -> CameraModel:
    try:
        content = parse_any_json(text)
    except UnreadableError as error:
        raise DataError(f"{path}: {error}: give a camera file") from error
    if isinstance(content, dict) and "intrinsics" in content:
        return camera_of_scene(content, path)
    if isinstance(content, dict) and "format" not in content and has_camera(content):
        return camera_of_json(content, path)
    return parse_json(_CameraFile, text, path).value()


def _parse_text(text: str, path: Path, size: tuple[int, int] | None) -> CameraModel:
    lines = [(number, line) for number, line in numbered_lines(text) if not line.startswith("#")]
    rows = [line.replace(",", " ").split() for _, line in lines]
    if len(rows) != 3 or any(len(row) != 3 for row in rows):
        return camera_of_lines(path, lines)
    words = [word for row in rows for word in row]
    K = np.reshape(finite_numbers(words, f"{path} line {lines[0][0]}"), (3, 3))
    height, width = known_size(size, path)
    return CameraModel(K, width, height)


def _parse_mat(path: Path, size: tuple[int, int] | None) -> CameraModel:
    """Read K as MATLAB's toolbox and near_ps store it."""
    K = read_variables(path, ("K",)).get("K")
    if K is None:
        raise DataError(f"{path}: has no variable K: save the camera matrix under this name")
    if K.shape == (3, 3) and K[0, 2] == 0:
        K = K.T
    height, width = known_size(size, path)
    camera = CameraModel(K, width, height)
    return CameraModel(camera.K - _MATLAB_FIRST_PIXEL, width, height)
