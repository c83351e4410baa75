"""Normal map, mask and height of a mesh or a point cloud in one view."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from acquisition import CameraModel, DataError
from calibration import EstimateError
from processing.maps.normal_map import NormalMap
from processing.projection.geometry_files import Geometry
from processing.projection.point_cloud import draw_points, fit_surfels, too_few_points
from processing.projection.rasterize import draw_mesh
from processing.projection.rasterize_kernels import bounds, turned
from processing.projection.view import fit_raster
from rig import Notice, Progress, figure, no_progress, short_repr
from rig.arrays import Float32


@dataclass(frozen=True, eq=False)
class Projection:
    """A view of an object.

    Parameters
    ----------
    normal_map
        Normals in the house frame; its mask contains the pixels of the object.
    height
        ``(H, W)`` float32 mm along +Z toward the viewer, NaN outside the mask.
    depth
        ``(H, W)`` float32 mm from the camera along the optical axis, NaN outside the mask; None
        for an orthographic view.
    pixel_mm
        Distance between neighbouring pixels on the object; with a camera, at the working distance.
    warnings
        Faces, points and normals that were changed or left out, sharp edges, back sides that are
        visible, and an outline that is not covered.
    """

    normal_map: NormalMap
    height: Float32
    depth: Float32 | None
    pixel_mm: float
    warnings: tuple[Notice, ...]

    __repr__ = short_repr


def project(
    geometry: Geometry,
    rotation: npt.ArrayLike | None = None,
    *,
    unit_mm: float = 1.0,
    size: tuple[int, int] | None = None,
    pixel_mm: float | None = None,
    camera: CameraModel | None = None,
    centred: bool = True,
    smooth: bool = True,
    neighbours: int = 16,
    on_progress: Progress = no_progress,
) -> Projection:
    """Draw a mesh or a point cloud as a normal map.

    Parameters
    ----------
    geometry
        The mesh or point cloud.
    rotation
        ``(3, 3)`` rotation from the axes of the geometry to the house frame (X right, Y up, Z
        toward the viewer); see `view_rotation`. Default: no rotation.
    unit_mm
        Millimetres per unit of the coordinates.
    size
        (height, width) in pixels. Default: the size of the camera's images, or the smallest size
        that contains the object.
    pixel_mm
        Pixel size of an orthographic view. Default: the object fills the image, which has 1024
        pixels on its longer side if the size is not given either.
    camera
        A perspective camera with a working distance. Default: orthographic.
    centred
        Move the centre of the object's extent to the origin; otherwise keep its coordinates.
    smooth
        Blend normals over the faces of a mesh, except across the sharp edges of a part, or use
        those of its file if they fit the faces; otherwise the faces are flat.
    neighbours
        Number of points to which a normal of a point cloud is fitted if the cloud has no normals.
    on_progress
        Receives the stages ``projecting``, for a mesh, or ``fitting normals`` and ``drawing
        points``, for
        points.

    Returns
    -------
    Projection
        The view of the nearest surface at each pixel's centre.

    Raises
    ------
    DataError
        If a scale is not positive, the image would be too large, the camera has no working
        distance, or a camera is given together with another image size or a pixel size.
    EstimateError
        If no part of the object is inside the image, or the points of a cloud do not determine a
        surface.

    Examples
    --------
    >>> import numpy as np
    >>> from processing import Geometry, project
    >>> corners = np.array([[0, 0, 0], [4, 0, 0], [4, 3, 0], [0, 3, 0]], float)
    >>> card = Geometry(corners, np.array([[0, 1, 2], [0, 2, 3]]))
    >>> project(card, pixel_mm=0.5).normal_map
    NormalMap(float32[10, 12, 3], 48 normals)
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
    normals = None if geometry.normals is None else geometry.normals @ turn.T
    if geometry.faces is not None:
        raster = fit_raster(low, high, size, pixel_mm, camera)
        drawn = draw_mesh(
            points, geometry.faces, raster, smooth=smooth, given=normals, on_progress=on_progress
        )
    else:
        surfels = fit_surfels(points, normals, neighbours, on_progress)
        left = bounds(surfels.points_mm)
        if not np.array_equal(left, (low, high)):
            # Points that were left out do not count for the extent.
            middle = (left[0] + left[1]) / 2 if centred else np.zeros(3)
            surfels = replace(surfels, points_mm=surfels.points_mm - middle)
            low, high = left[0] - middle, left[1] - middle
        raster = fit_raster(low, high, size, pixel_mm, camera)
        on_progress("drawing points", 0, 1)
        drawn = draw_points(surfels, raster)
        on_progress("drawing points", 1, 1)
    mask = np.isfinite(drawn.height)
    if not mask.any():
        raise EstimateError(
            f"no pixel centre shows the object: the image of {raster.size[1]} x "
            f"{raster.size[0]} pixels covers {figure(raster.size[1] * raster.pixel_mm, 3)} x "
            f"{figure(raster.size[0] * raster.pixel_mm, 3)} mm, the object is "
            + " x ".join(f"{figure(span, 3)}" for span in (high - low)[:2])
            + " mm in size"
        )
    normal_map = NormalMap(drawn.normals, mask)
    return Projection(
        normal_map=normal_map,
        height=drawn.height,
        depth=None if camera is None else np.float32(raster.eye_mm) - drawn.height,
        pixel_mm=raster.pixel_mm,
        warnings=(*geometry.warnings, *drawn.warnings),
    )
