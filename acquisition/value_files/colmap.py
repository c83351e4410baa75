"""COLMAP's cameras.txt with one camera.

COLMAP measures the principal point from the corner of the first pixel, and we measure it from the
centre of that pixel: https://colmap.github.io/format.html, https://colmap.github.io/cameras.html.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np

from acquisition._errors import DataError
from acquisition.values.camera_model import CameraModel

_OPENCV: Final = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2")
# Parameters of each model of COLMAP that we have as well, in the order of its file.
_PARAMETERS: Final[dict[str, tuple[str, ...]]] = {
    "SIMPLE_PINHOLE": ("f", "cx", "cy"),
    "PINHOLE": ("fx", "fy", "cx", "cy"),
    "SIMPLE_RADIAL": ("f", "cx", "cy", "k1"),
    "RADIAL": ("f", "cx", "cy", "k1", "k2"),
    "OPENCV": _OPENCV,
    "FULL_OPENCV": (*_OPENCV, "k3", "k4", "k5", "k6"),
}
_PIXEL_CENTRE: Final = 0.5


def camera_of_lines(path: Path, lines: list[tuple[int, str]]) -> CameraModel:
    """Return the camera of the lines of a cameras.txt without its comments, with their numbers.

    Raises
    ------
    DataError
        If there is not exactly one camera, its model is not one of ours, or its line has other than
        its parameters; the message names ``path``.
    """
    if not lines or len(lines[0][1].split()) < 4 or not lines[0][1].split()[1].isidentifier():
        raise DataError(
            f"{path}: neither a 3 x 3 matrix nor COLMAP's cameras.txt: give one of the two"
        )
    if len(lines) > 1:
        raise DataError(f"{path}: {len(lines)} cameras: keep only the one that took the images")
    where = f"{path} line {lines[0][0]}"
    _, model, *words = lines[0][1].split()
    if model not in _PARAMETERS:
        known = ", ".join(_PARAMETERS)
        raise DataError(f"{where}: model {model} is not supported: use one of {known}")
    values = finite_numbers(words, where)
    names = _PARAMETERS[model]
    if len(values) != 2 + len(names):
        raise DataError(
            f"{where}: {model} must have {len(names)} parameters after the size, not "
            f"{len(values) - 2}"
        )
    width, height, *numbers = values
    if not (width.is_integer() and height.is_integer()):
        raise DataError(f"{where}: a size of {width:g} x {height:g} is not in whole pixels")
    given = dict(zip(names, numbers, strict=True))
    if any(given.get(name) for name in ("k4", "k5", "k6")):
        raise DataError(
            f"{where}: the coefficients k4 to k6 are not supported: calibrate with the model OPENCV"
        )
    fx, fy = (given.get(name, given.get("f", 0.0)) for name in ("fx", "fy"))
    cx, cy = given["cx"] - _PIXEL_CENTRE, given["cy"] - _PIXEL_CENTRE
    distortion = [given.get(name, 0.0) for name in ("k1", "k2", "p1", "p2", "k3")]
    K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    return CameraModel(K, int(width), int(height), None, np.array(distortion))


def colmap_text(camera: CameraModel) -> str:
    """Return the text of a cameras.txt; a working distance cannot be written.

    Raises
    ------
    DataError
        If the camera has a skew, which no model of COLMAP has.
    """
    if camera.K[0, 1]:
        raise DataError("COLMAP has no camera with a skew: write the camera as .json or .yml")
    k1, k2, p1, p2, k3 = camera.distortion
    model = "FULL_OPENCV" if k3 else "OPENCV" if camera.distortion.any() else "PINHOLE"
    centre = camera.K[:2, 2] + _PIXEL_CENTRE
    given = {"fx": camera.K[0, 0], "fy": camera.K[1, 1], "cx": centre[0], "cy": centre[1]}
    given |= {"k1": k1, "k2": k2, "p1": p1, "p2": p2, "k3": k3}
    numbers = " ".join(repr(float(given.get(name, 0.0))) for name in _PARAMETERS[model])
    return (
        "# Camera list with one line of data per camera:\n"
        "#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n"
        f"1 {model} {camera.width} {camera.height} {numbers}\n"
    )


def finite_numbers(words: list[str], where: str) -> list[float]:
    """Return words as finite numbers.

    Raises
    ------
    DataError
        If one of them is not a finite number; the message begins with ``where``.
    """
    try:
        values = [float(word) for word in words]
    except ValueError:
        values = [np.nan]
    if not np.isfinite(values).all():
        text = " ".join(words)[:40]
        raise DataError(f"{where}: '{text}' are not all finite numbers: correct the line")
    return values
