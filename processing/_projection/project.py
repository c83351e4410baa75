"""Normal map, mask and height of a mesh or a point cloud, seen from one side."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from acquisition import CameraModel, DataError
from calibration import EstimateError
from processing._normal_map import NormalMap
from processing._projection.mesh_read import Geometry
from processing._projection.point_cloud import draw_points, fit_surfels, too_few_points
from processing._projection.rasterize import draw_mesh
from processing._projection.rasterize_kernels import bounds, turned
from processing._projection.view import Frame, fit_frame

Float = npt.NDArray[np.float32]
Double = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Projection:
    """What is seen of an object.

    Parameters
    ----------
    normal_map
        Normals in the house frame; its mask is where the object is seen.
    height
        ``(H, W)`` float32 mm along +Z toward the viewer, NaN outside the mask.
    depth
        ``(H, W)`` float32 mm from the camera along the optical axis, NaN outside the mask; None
        for an orthographic view.
    mm_per_px
        Distance of neighbouring pixels on the object; with a camera, at the working distance.
    warnings
        What the reader should know, a line each.
    """

    normal_map: NormalMap
    height: Float
    depth: Float | None
    mm_per_px: float
    warnings: tuple[str, ...]


def project(
    geometry: Geometry,
    rotation: npt.ArrayLike | None = None,
    *,
    unit_mm: float = 1.0,
    size: tuple[int, int] | None = None,
    mm_per_px: float | None = None,
    camera: CameraModel | None = None,
    centred: bool = True,
    smooth: bool = True,
    neighbours: int = 16,
) -> Projection:
    """Draw a mesh or a point cloud as a normal map.

    Parameters
    ----------
    geometry
        What is drawn.
    rotation
        ``(3, 3)`` from its axes to the house frame (X right, Y up, Z toward the viewer); see
        `view_rotation`. Default: they are the same.
    unit_mm
        Millimetres per unit of its coordinates.
    size
        (height, width) in pixels. Default: the camera's, or what fits the object.
    mm_per_px
        Pixel size of an orthographic view. Default: the object fills the image, 1024 pixels on its
        longer side where no size is given either.
    camera
        A perspective camera with a working distance. Default: orthographic.
    centred
        Put the middle of the object's extent onto the origin; else its coordinates stay.
    smooth
        Blend normals over the faces of a mesh; else each is flat.
    neighbours
        Points that a normal of a point cloud is fitted to, where it brings none.

    Returns
    -------
    Projection
        Of the nearest surface at each pixel's centre.

    Raises
    ------
    DataError
        If a scale is not positive, the image would be too large, or the camera has no working
        distance, or comes with another image size or a pixel size.
    EstimateError
        If nothing of the object falls into the image, or a cloud's points make no surface.
    """
    if not (math.isfinite(unit_mm) and unit_mm > 0):
        raise DataError(f"a unit of {unit_mm} mm is not a positive length")
    turn = np.eye(3) if rotation is None else np.asarray(rotation, np.float64)
    points = turned(geometry.vertices, unit_mm * turn)
    low, high = bounds(points)
    if geometry.faces is None and (low == high).all():
        raise too_few_points(1)
    if centred:
        middle = (low + high) / 2
        points -= middle
        low, high = low - middle, high - middle
    frame = _frame(low, high, size, mm_per_px, camera)
    if geometry.faces is not None:
        drawn = draw_mesh(points, geometry.faces, frame, smooth=smooth)
    else:
        known = None if geometry.normals is None else geometry.normals @ turn.T
        drawn = draw_points(fit_surfels(points, known, neighbours), frame)
    mask = np.isfinite(drawn.height)
    if not mask.any():
        raise EstimateError(
            f"nothing of the object falls on the centre of a pixel: the image of {frame.size[1]} x "
            f"{frame.size[0]} pixels covers {frame.size[1] * frame.mm_per_px:.3g} x "
            f"{frame.size[0] * frame.mm_per_px:.3g} mm, the object spans "
            + " x ".join(f"{span:.3g}" for span in (high - low)[:2])
            + " mm"
        )
    return Projection(
        normal_map=NormalMap(drawn.normals, mask),
        height=drawn.height,
        depth=None if camera is None else np.float32(frame.eye_mm) - drawn.height,
        mm_per_px=frame.mm_per_px,
        warnings=(*geometry.warnings, *drawn.warnings),
    )


def _frame(
    low_mm: Double,
    high_mm: Double,
    size: tuple[int, int] | None,
    mm_per_px: float | None,
    camera: CameraModel | None,
) -> Frame:
    if mm_per_px is not None and not (math.isfinite(mm_per_px) and mm_per_px > 0):
        raise DataError(f"a pixel of {mm_per_px} mm is not a positive length")
    if camera is None:
        return fit_frame(low_mm, high_mm, size, mm_per_px)
    if camera.working_distance_mm is None:
        raise DataError("this camera has no working distance: add working_distance_mm to it")
    if mm_per_px is not None:
        raise DataError(
            f"a pixel size of {mm_per_px} mm was given beside a camera at "
            f"{camera.working_distance_mm} mm: leave one of them out"
        )
    if size is not None and size != camera.size:
        raise DataError(
            f"an image of {size[1]} x {size[0]} pixels was asked of a camera of {camera.width} x "
            f"{camera.height}: leave the size out"
        )
    return Frame(camera.size, camera.working_distance_mm / camera.focal_px, camera)
