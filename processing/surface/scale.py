"""Heights and depths in their unit from the solution of the integration."""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

import numpy as np

from acquisition import CameraModel, DataError, MapRows
from acquisition.files import rows_in_bands
from calibration import EstimateError
from rig import check_type
from rig.arrays import Bool, Float64, Int32

# A depth that varies by more than this factor cannot be a surface in front of a camera.
_DEPTH_RANGE = 1e6
# Values that are read at once.
_READ = 4_000_000


class Scale(NamedTuple):
    """The scale of a surface.

    Parameters
    ----------
    unit
        Unit of heights and depths.
    pixel_size
        Distance between neighbouring pixels in `unit`; with a camera, at the working distance.
    distance
        With a camera, the working distance in `unit`; None without one.
    step_px
        Pixels for a step of 1 of the solution: 1, or with a camera the focal length in pixels,
        since the solution is the logarithm of the depth.
    """

    unit: Literal["mm", "px"]
    pixel_size: float
    distance: float | None
    step_px: float


def surface_scale(
    camera: CameraModel | None, pixel_mm: float | None
) -> tuple[Literal["mm", "px"], float]:
    """Return unit and pixel size of the height map that `integrate` would return.

    Parameters
    ----------
    camera, pixel_mm
        As for `integrate`.

    Raises
    ------
    DataError
        If the pixel size is not a positive length, or a pixel size and a camera with a working
        distance are given: each states the scale.

    Examples
    --------
    >>> from processing.surface import surface_scale
    >>> from simulator import bench_camera
    >>> surface_scale(None, 0.1)
    ('mm', 0.1)
    >>> surface_scale(bench_camera(), 0.1)
    Traceback (most recent call last):
        ...
    acquisition.DataError: a pixel size of 0.1 mm and a camera at 600.0 mm exclude each other: ...
    """
    return scale_of(camera, pixel_mm)[:2]


def check_view(
    mask: Bool,
    camera: CameraModel | None,
    pixel_mm: float | None,
    depth_mm: MapRows | None,
) -> None:
    """Raise `DataError` if a camera or approximate depths do not fit a normal map."""
    rows, columns = mask.shape
    if camera is not None and camera.size != mask.shape:
        raise DataError(
            f"a camera of {camera.width} x {camera.height} pixels does not fit a normal map of "
            f"{columns} x {rows}: crop or replace the camera"
        )
    if depth_mm is None:
        return
    is_telecentric = camera is None and pixel_mm is not None
    if not is_telecentric and (camera is None or camera.working_distance_mm is None):
        raise DataError("approximate depths require a camera with a working distance")
    fits = depth_mm.shape == mask.shape
    for band in rows_in_bands(rows, columns, _READ) if fits else ():
        values = depth_mm[band][mask[band]]
        fits &= bool((np.isfinite(values) if is_telecentric else values > 0).all())
    if not fits:
        raise DataError(
            f"approximate depths of shape {depth_mm.shape} must be "
            f"{'finite' if is_telecentric else 'positive'} at all pixels of a normal map of shape "
            f"{mask.shape}"
        )


def scale_of(camera: CameraModel | None, pixel_mm: float | None) -> Scale:
    """Return the scale of a surface; errors are those of `surface_scale`."""
    if pixel_mm is not None and not (math.isfinite(pixel_mm) and pixel_mm > 0):
        raise DataError(f"a pixel size of {pixel_mm} mm is not a positive length")
    unit: Literal["mm", "px"] = "px" if pixel_mm is None else "mm"
    size = 1.0 if pixel_mm is None else pixel_mm
    if camera is None:
        return Scale(unit, size, None, 1.0)
    check_type("camera", camera, CameraModel, "acquisition.read_camera(path) returns one")
    focal_px, distance = camera.focal_px, camera.working_distance_mm
    if distance is None:
        return Scale(unit, size, size * focal_px, focal_px)
    if pixel_mm is not None:
        raise DataError(
            f"a pixel size of {pixel_mm} mm and a camera at {distance} mm exclude each other: give "
            "only one of them"
        )
    return Scale("mm", distance / focal_px, distance, focal_px)


def placed(u: Float64, members: Int32, near: Float64 | None, held: Bool, scale: Scale) -> Float64:
    """Return heights without a camera, or depths with one.

    Parameters
    ----------
    u
        ``(N,)`` solution.
    members
        ``(N,)`` part of each pixel.
    near
        ``(N,)`` depths whose mean over each part is that of the surface; default: the working
        distance, or without a camera a height of 0. Without a camera, depths are minus heights.
    held
        For each part, whether a prior determines its height.
    scale
        Scale of the surface.

    Raises
    ------
    EstimateError
        If the range of depths is implausible.
    """
    mean = part_means(u, members)
    if scale.distance is None:
        raised = 0 if near is None else -part_means(near, members)
        own = np.where(held, 0, raised - scale.pixel_size * mean)
        return np.asarray(scale.pixel_size * u + own[members], np.float64)
    check_depth_range(u - mean[members])
    depths = np.exp(u - np.where(held, 0, mean)[members])
    wanted = scale.distance if near is None else part_means(near, members)
    return np.asarray(depths * np.where(held, 1, wanted / part_means(depths, members))[members])


def check_depth_range(u: Float64) -> None:
    """Refuse logarithms of depths, relative to their mean, that vary too much."""
    if np.abs(u).max(initial=0) > math.log(_DEPTH_RANGE):
        raise EstimateError(
            f"the depth would vary by more than a factor of {_DEPTH_RANGE:g}: the camera matrix "
            "does not belong to this normal map, or the axes of the map are wrong"
        )


def nothing_faces() -> EstimateError:
    """Return the error about a map whose normals give no step."""
    return EstimateError(
        "no two neighbouring pixels of the normal map face the camera, so there is nothing to "
        "integrate: check the axes of the map (Z toward the camera) and its mask"
    )


def part_means(values: Float64, members: Int32) -> Float64:
    """Return the mean of the values of each part."""
    return np.asarray(np.bincount(members, values) / np.bincount(members), np.float64)
