"""A camera from the focal length that images state, where no calibrated one is known."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from acquisition.pixels.stated_facts import ImageFacts
from acquisition.pixels.stated_lens import FILM_DIAGONAL_MM
from acquisition.source.source import Source
from acquisition.values.camera_model import CameraModel
from rig import Notice, Severity, figure

_CODES = ("camera-from-exif", "camera-not-from-exif")
# Focal lengths that differ by less are equal: those of a lens that the camera focuses differ by
# rounding, another zoom by more.
_SAME = 0.002
# Equivalent focal lengths are whole millimetres, and sizes of sensors are rounded too; a cropped
# image that states its size after cropping differs by more.
_AGREE = 0.1
# Diagonals of sensors, from those of telephones to those of scanning backs.
_SMALLEST_MM, _LARGEST_MM = 3, 150
# The image that a camera writes is smaller than its RAW data by a few rows and columns.
_BORDER = 0.05


class _Focal(NamedTuple):
    """A focal length in pixels, how it was found, and the scale of the image since then."""

    px: float
    origin: str
    scale: float


def nominal_camera(
    images: Sequence[ImageFacts], size: tuple[int, int], where: Path
) -> tuple[CameraModel | None, tuple[Notice, ...]]:
    """Return the camera of the focal length that all images of a recording state, if they do.

    Parameters
    ----------
    images
        Facts about its images.
    size
        Their (height, width).
    where
        The recording.

    Returns
    -------
    camera
        Square pixels, the principal point in the middle, no distortion and no working distance;
        None if an image states no focal length, was cropped, or differs from the first.
    notices
        The focal length, or why that of the metadata is not used; empty if they state nothing.
    """
    lenses = [image.shot.lens for image in images]
    if not any(lens.focal_35_mm or (lens.focal_mm and lens.pixels_per_mm) for lens in lenses):
        return None, ()
    found: list[_Focal] = []
    for image in images:
        focal = _focal_of(image, size)
        if isinstance(focal, str):
            return None, (_not_from(f"{image.path.name} {focal}", where),)
        found.append(focal)
    first = found[0]
    for image, focal in zip(images, found, strict=True):
        if abs(focal.px / first.px - 1) > _SAME:
            text = (
                f"{image.path.name} states a focal length of {focal.px:.0f} px ({focal.origin}), "
                f"but {images[0].path.name} one of {first.px:.0f} px ({first.origin})"
            )
            return None, (_not_from(text, where, differs=True),)
    origin = first.origin
    if first.scale != 1:
        origin += f", for images scaled by {first.scale:.4g}"
    elif any(lens.changed and not (lens.pixels_per_mm and lens.focal_35_mm) for lens in lenses):
        origin += ", if the program that changed the files did not crop or scale them"
    return of_focal_length(first.px, size, origin, where)


def of_focal_length(
    focal_px: float, size: tuple[int, int], origin: str, where: Path
) -> tuple[CameraModel, tuple[Notice, ...]]:
    """Return a camera with a focal length in pixels, and the notice that names its origin."""
    height, width = size
    K = np.array([[focal_px, 0, (width - 1) / 2], [0, focal_px, (height - 1) / 2], [0, 0, 1]])
    text = (
        f"the camera is that of the metadata: a focal length of {focal_px:.0f} px ({origin}), the "
        "axis in the middle of the image, no distortion; a calibrated camera is more accurate, "
        "above all near the object"
    )
    return CameraModel(K, width, height), (Notice("camera-from-exif", text, str(where), "info"),)


def with_camera(source: Source, camera: CameraModel) -> Source:
    """Return a recording with a camera instead of its own, without notices about that of metadata.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import CameraModel, read_source, write_png
    >>> from acquisition.source import with_camera
    >>> write_png("card.png", np.full((40, 50), 700, np.uint16))
    >>> camera = CameraModel([[90, 0, 25], [0, 90, 20], [0, 0, 1]], 50, 40)
    >>> with_camera(read_source("card.png"), camera).camera
    CameraModel(50 x 40 px, focal length 90.0 px)
    """
    kept = tuple(one for one in source.warnings if one.code not in _CODES)
    return replace(source, camera=camera, camera_nominal=False, warnings=kept)


def _not_from(why: str, where: Path, *, differs: bool = False) -> Notice:
    text = f"no camera is taken from the metadata: {why}"
    severity: Severity = "warning" if differs else "info"
    return Notice("camera-not-from-exif", text, str(where), severity)


def _focal_of(image: ImageFacts, size: tuple[int, int]) -> _Focal | str:
    """Return the focal length in pixels of an image of (height, width), or why it is not known."""
    lens, is_raw = image.shot.lens, not image.shape
    if lens.digital_zoom and lens.digital_zoom > 1.001:
        return f"was enlarged {lens.digital_zoom:g} times (DigitalZoomRatio)"
    if lens.size is None and not is_raw:
        return "does not state the size with which it was taken (PixelXDimension)"
    taken = lens.size or size[::-1]
    found: list[_Focal] = []
    diagonal_mm = math.hypot(*taken) / (lens.pixels_per_mm or math.inf)
    if lens.focal_mm and lens.pixels_per_mm and _SMALLEST_MM < diagonal_mm < _LARGEST_MM:
        origin = f"{lens.focal_mm:g} mm, pixels of {1000 / lens.pixels_per_mm:.4g} um, Exif"
        found.append(_Focal(lens.focal_mm * lens.pixels_per_mm, origin, 1))
    if lens.focal_35_mm:
        # The field of view is that of the diagonal.
        px = lens.focal_35_mm * math.hypot(*taken) / FILM_DIAGONAL_MM
        found.append(_Focal(px, f"{lens.focal_35_mm:g} mm on 35 mm film, Exif", 1))
    if not found and lens.focal_mm and lens.pixels_per_mm:
        return (
            f"states a sensor with a diagonal of {figure(diagonal_mm, 3)} mm "
            "(FocalPlaneXResolution): it was probably cropped or scaled"
        )
    if not found:
        return "states no focal length with the size of its pixels, as others do"
    if len(found) == 2 and abs(found[0].px / found[1].px - 1) > _AGREE:
        return (
            f"contradicts itself, as after cropping: {found[0].px:.0f} px ({found[0].origin}) and "
            f"{found[1].px:.0f} px ({found[1].origin})"
        )
    scale = _raw_scale(taken, size) if is_raw else _scale(taken, size)
    if scale is None:
        return (
            f"was taken with {taken[0]} x {taken[1]} pixels and has {size[1]} x {size[0]}, as "
            "after cropping"
        )
    return _Focal(found[0].px * scale, found[0].origin, scale)


def _scale(taken: tuple[int, int], size: tuple[int, int]) -> float | None:
    """Return the scale of an image, which may have been turned; None if it was cropped."""
    (short, long), (low, high) = sorted(size), sorted(taken)
    # Each side is a whole number of pixels.
    if abs(short * high - long * low) > high + low:
        return None
    return math.sqrt(short * long / (low * high)) if (short, long) != (low, high) else 1.0


def _raw_scale(taken: tuple[int, int], size: tuple[int, int]) -> float | None:
    """Return 1 if RAW data differ from the image of the camera in their borders only."""
    sides = zip(sorted(size), sorted(taken), strict=True)
    return 1.0 if all(abs(one / other - 1) < _BORDER for one, other in sides) else None
