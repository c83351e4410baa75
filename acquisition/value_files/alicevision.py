"""Cameras in AliceVision's JSON of scenes (cameraInit.sfm, sfm.json).

The principal point is an offset in pixels from (width / 2, height / 2) since version 1.2.1, before
that a position. Both count from the centre of the first pixel, where AliceVision's features and
its sampling of images have their origin. The focal length is in millimetres of the sensor since
version 1.2.2, before that in pixels. Numbers may be texts.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from acquisition._errors import DataError
from acquisition.values.camera_model import CameraModel

# Coefficients of each distortion, in the order of the file. Names are those of OpenCV: the
# formulas are the same, with t1 and t2 for p1 and p2.
_DISTORTIONS: Final[dict[str, tuple[str, ...]]] = {
    "none": (),
    "pinhole": (),
    "radialk1": ("k1",),
    "radial1": ("k1",),
    "radialk3": ("k1", "k2", "k3"),
    "radial3": ("k1", "k2", "k3"),
    "brown": ("k1", "k2", "k3", "p1", "p2"),
}
_OFFSETS_SINCE: Final = (1, 2, 1)
_MILLIMETRES_SINCE: Final = (1, 2, 2)


def camera_of_scene(content: Mapping[str, Any], path: Path) -> CameraModel:
    """Return the only camera of a parsed scene.

    Raises
    ------
    DataError
        If the scene has no camera or several, or the camera has another model; the message names
        ``path``.
    """
    cameras = content.get("intrinsics")
    if not isinstance(cameras, list) or not all(isinstance(one, dict) for one in cameras):
        raise DataError(f"{path}: intrinsics is not a list of cameras: write it with AliceVision")
    if len(cameras) != 1:
        raise DataError(
            f"{path}: {len(cameras)} cameras: keep only the one that took the images"
            if cameras
            else f"{path}: intrinsics has no camera: run AliceVision's CameraInit"
        )
    camera: dict[str, Any] = cameras[0]
    version = tuple(int(_number(part, "version", path)) for part in content.get("version", ()))
    names = _coefficients(camera, path)
    values = camera.get("distortionParams") or []
    if not isinstance(values, list) or len(values) not in (0, len(names)):
        raise DataError(f"{path}: distortionParams must have {len(names)} numbers: correct them")
    given = {
        name: _number(value, "distortionParams", path)
        for name, value in zip(names, values, strict=False)
    }
    if camera.get("undistortionParams") or any(
        _number(value, "undistortionOffset", path)
        for value in camera.get("undistortionOffset") or ()
    ):
        raise DataError(f"{path}: an undistortion is not supported: give a camera without it")
    width, height = (_size(camera.get(side), side, path) for side in ("width", "height"))
    fx, fy = _focal_lengths(camera, version, width, path)
    point = camera.get("principalPoint")
    if not isinstance(point, list) or len(point) != 2:
        raise DataError(f"{path}: principalPoint must have two numbers: correct it")
    cx, cy = (_number(value, "principalPoint", path) for value in point)
    if version >= _OFFSETS_SINCE:
        cx, cy = cx + width / 2, cy + height / 2
    distortion = [given.get(name, 0.0) for name in ("k1", "k2", "p1", "p2", "k3")]
    K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    return CameraModel(K, width, height, None, np.array(distortion))


def _coefficients(camera: Mapping[str, Any], path: Path) -> tuple[str, ...]:
    """Return the names of the distortion coefficients, from the type of a camera."""
    kind = str(camera.get("type", "")).lower()
    # Newer versions keep the distortion apart from the projection.
    distortion = str(camera.get("distortionType") or kind).lower()
    if (kind != "pinhole" and "distortionType" in camera) or distortion not in _DISTORTIONS:
        named = kind if kind != "pinhole" else distortion
        raise DataError(
            f"{path}: a camera of the type {named[:40] or 'unknown'!r} is not supported: use "
            "a pinhole with one of none, radialk1, radialk3, brown"
        )
    return _DISTORTIONS[distortion]


def _focal_lengths(
    camera: Mapping[str, Any], version: tuple[int, ...], width: int, path: Path
) -> tuple[float, float]:
    if version >= _MILLIMETRES_SINCE or "pxFocalLength" not in camera:
        sensor_mm = _number(camera.get("sensorWidth"), "sensorWidth", path)
        ratio = _number(camera.get("pixelRatio", 1.0), "pixelRatio", path)
        if not (sensor_mm > 0 and ratio > 0):
            raise DataError(f"{path}: sensorWidth and pixelRatio must be positive: correct them")
        fx = _number(camera.get("focalLength"), "focalLength", path) * width / sensor_mm
        return fx, fx / ratio
    focal = camera["pxFocalLength"]
    values = focal if isinstance(focal, list) else [focal, focal]
    if len(values) != 2:
        raise DataError(f"{path}: pxFocalLength must have one or two numbers: correct it")
    fx, fy = (_number(value, "pxFocalLength", path) for value in values)
    return fx, fy


def _size(value: object, name: str, path: Path) -> int:
    number = _number(value, name, path)
    if not number.is_integer():
        raise DataError(f"{path}: {name} {number:g} is not a whole number: correct it")
    return int(number)


def _number(value: object, name: str, path: Path) -> float:
    try:
        number = float(value) if isinstance(value, (str, int, float)) else math.nan
    except (ValueError, OverflowError):
        number = math.nan
    if not math.isfinite(number):
        raise DataError(f"{path}: {name} is {str(value)[:40]!r}, not a finite number: correct it")
    return number
