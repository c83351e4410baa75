"""How the pixels of an image see a surface: rays from a point, or parallel ones."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from acquisition import CameraModel, DataError, Lights, Source
from processing.maps.normal_map import NormalMap
from processing.surface.integration import integrate
from rig.arrays import Bool, Float32, Float64, Intp

Rows = slice | Intp

# Rays of a camera that is so far away are parallel.
_FAR_MM = 1e6


class SurfacePoints(NamedTuple):
    """Surface points ``(H, W, 3)`` in mm, of which only rows are in memory.

    Parameters
    ----------
    view
        How the pixels see points.
    depth
        ``(H, W)`` depths, or one of all pixels.
    size
        ``(H, W)``.
    """

    view: View
    depth: Float32 | float
    size: tuple[int, ...]

    def of(self, rows: Rows = slice(None)) -> Float64:
        """Return the points ``(R, W, 3)`` of some rows."""
        numbers = np.arange(self.size[0])[rows]
        depth = self.depth if isinstance(self.depth, float) else self.depth[rows]
        return self.view.points_of(numbers, depth)

    def at(self, pixels: Intp) -> Float64:
        """Return the points ``(P, 3)`` of pixels, indices into the flat image."""
        rows, columns = np.divmod(pixels, self.size[1])
        found = [self.of(np.array([row]))[0, columns[rows == row]] for row in np.unique(rows)]
        return np.concatenate(found)


@dataclass(frozen=True, eq=False)
class Perspective:
    """The view of a camera with a working distance. Depths are measured from its centre."""

    camera: CameraModel

    @property
    def seen_by(self) -> CameraModel:
        """The camera, for the direction of view."""
        return self.camera

    @property
    def distance_mm(self) -> float:
        """Depth of the working plane."""
        return float(self.camera.centre_mm[2])

    @property
    def highest_mm(self) -> float:
        """Height that all points are below."""
        return self.distance_mm

    def rays(self) -> tuple[Float64, Float64]:
        """Return origins and directions ``(H, W, 3)``: a point is ``origin + depth * ray``."""
        rays = self.camera.pixel_rays()
        return np.broadcast_to(self.camera.centre_mm, rays.shape), rays

    def points_at(self, depth_mm: npt.ArrayLike) -> Float64:
        """Return the points ``(H, W, 3)`` of all pixels."""
        return self.points_of(np.arange(self.camera.height), depth_mm)

    def points_of(self, rows: Intp, depth_mm: npt.ArrayLike) -> Float64:
        """Return the points ``(R, W, 3)`` of rows with depths ``(R, W)``."""
        x, y = np.meshgrid(np.arange(self.camera.width), rows)
        points = self.camera.rays(np.stack([x, y], axis=-1))
        points *= np.asarray(depth_mm)[..., None]
        points += self.camera.centre_mm
        return points

    def rise(self, points: Float64) -> Float64:
        """Return the change ``(P, 3)`` of points ``(P, 3)`` that rise by 1 mm in their pixels."""
        toward = self.camera.centre_mm - points
        return np.asarray(toward / toward[:, 2:], np.float64)

    def downscaled(self, factor: int) -> Perspective:
        """Return the view of an image whose pixels are blocks of these."""
        return replace(self, camera=self.camera.downscaled(factor))

    def moved(self, depth: Float64, before: float, after: float) -> Float64:
        """Return the surface of the same normals whose depth is ``after`` where it was before."""
        return np.asarray(depth * (after / before), np.float64)

    def surface(self, normal_map: NormalMap, mean_depth: float) -> tuple[Float64, Bool]:
        """Return the depths ``(P,)`` of a surface, and its pixels."""
        camera = replace(self.camera, working_distance_mm=mean_depth)
        found = integrate(normal_map, camera=camera)
        return mean_depth - found.height[found.mask].astype(np.float64), found.mask

    def depth_error(self, sigma_mm: float, mean_depth: float) -> tuple[CameraModel, float]:
        """Return a camera, and the relative standard deviation of the depths from it."""
        return self.camera, sigma_mm / mean_depth


@dataclass(frozen=True, eq=False)
class Parallel:
    """The view of a telecentric lens: parallel rays along -Z. Depths are minus heights.

    Parameters
    ----------
    pixel_mm
        Distance between neighbouring pixels on the object.
    size
        Shape of the image, (height, width).
    axis_px
        Position (x, y) of the optical axis, which meets the origin.
    """

    pixel_mm: float
    size: tuple[int, int]
    axis_px: tuple[float, float]

    seen_by = None
    distance_mm = 0.0
    highest_mm = math.inf

    def rays(self) -> tuple[Float64, Float64]:
        """Return origins and directions ``(H, W, 3)``: a point is ``origin + depth * ray``."""
        origins = self.points_at(0.0)
        return origins, np.broadcast_to([0.0, 0.0, -1.0], origins.shape)

    def points_at(self, depth_mm: npt.ArrayLike) -> Float64:
        """Return the points ``(H, W, 3)`` of all pixels."""
        return self.points_of(np.arange(self.size[0]), depth_mm)

    def points_of(self, rows: Intp, depth_mm: npt.ArrayLike) -> Float64:
        """Return the points ``(R, W, 3)`` of rows with depths ``(R, W)``."""
        across, down = np.meshgrid(np.arange(self.size[1]), rows)
        x, y = (across - self.axis_px[0]), (self.axis_px[1] - down)
        points = np.stack([x * self.pixel_mm, y * self.pixel_mm, np.zeros(x.shape)], axis=-1)
        points[..., 2] -= np.asarray(depth_mm)
        return points

    def rise(self, points: Float64) -> Float64:
        """Return the change ``(P, 3)`` of points ``(P, 3)`` that rise by 1 mm in their pixels."""
        return np.broadcast_to([0.0, 0.0, 1.0], points.shape)

    def downscaled(self, factor: int) -> Parallel:
        """Return the view of an image whose pixels are blocks of these."""
        height, width = self.size
        x, y = ((at - (factor - 1) / 2) / factor for at in self.axis_px)
        return Parallel(self.pixel_mm * factor, (height // factor, width // factor), (x, y))

    def moved(self, depth: Float64, before: float, after: float) -> Float64:
        """Return the surface of the same normals whose depth is ``after`` where it was before."""
        return np.asarray(depth + (after - before), np.float64)

    def surface(self, normal_map: NormalMap, mean_depth: float) -> tuple[Float64, Bool]:
        """Return the depths ``(P,)`` of a surface, and its pixels."""
        found = integrate(normal_map, pixel_mm=self.pixel_mm)
        return mean_depth - found.height[found.mask].astype(np.float64), found.mask

    def depth_error(self, sigma_mm: float, mean_depth: float) -> tuple[CameraModel, float]:
        """Return a camera, and the relative standard deviation of the depths from it."""
        height, width = self.size
        return CameraModel(np.eye(3), width, height, _FAR_MM), sigma_mm / _FAR_MM


View = Perspective | Parallel


def view_of(source: Source, pixel_mm: float | None) -> View:
    """Return how a source sees points in mm.

    Parameters
    ----------
    source
        The recording. Without a camera, rays are parallel, and the optical axis is in the middle of
        its complete images.
    pixel_mm
        Distance between neighbouring pixels of the source on the object; only if no working
        distance is known.

    Raises
    ------
    DataError
        If there is neither a working distance nor a size of a pixel, or both.
    """
    camera = source.camera
    if camera is not None and camera.working_distance_mm is not None:
        if pixel_mm is not None:
            raise DataError(
                f"{source.path}: a pixel size of {pixel_mm:g} mm and a camera at "
                f"{camera.working_distance_mm:g} mm exclude each other: give only one of them"
            )
        return Perspective(camera)
    if pixel_mm is None:
        missing = "a camera with a" if source.calibrated_camera is None else "the camera its"
        raise DataError(
            f"{source.path}: lights with positions require points in mm, but there is no scale: "
            f"give {missing} working distance, or the size of a pixel on the object, or "
            "treat the lights as distant"
        )
    if camera is not None:
        return Perspective(replace(camera, working_distance_mm=pixel_mm * camera.focal_px))
    return Parallel(pixel_mm, source.size, _middle_px(source))


def middle_mm(source: Source, view: View) -> Float64:
    """Return the point ``(3,)`` of the working plane in the middle of the complete images."""
    if isinstance(view, Parallel):
        return np.zeros(3)
    ray = view.camera.rays(np.array(_middle_px(source)))
    return np.asarray(view.camera.centre_mm + view.distance_mm * ray, np.float64)


def _middle_px(source: Source) -> tuple[float, float]:
    """Return the middle (x, y) of the complete images, in pixels of the source."""
    height, width = source.frames[0].shape[:2]
    reduction = source.reduction
    x, y, factor = (0, 0, 1) if reduction is None else (reduction.x, reduction.y, reduction.factor)
    return (width / 2 - x) / factor - 0.5, (height / 2 - y) / factor - 0.5


def lights_of(source: Source, *, distant: bool) -> Lights:
    """Return the lights of a source, or the same as distant lights.

    Raises
    ------
    DataError
        If it has none.
    """
    if source.lights is None:
        raise DataError(
            f"{source.path}: these images have no lights: give the lights.json of a calibration"
        )
    return source.lights.distant() if distant else source.lights
