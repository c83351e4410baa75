"""Beginning and checks that all ways of a reconstruction share."""

from __future__ import annotations

from typing import NamedTuple

from acquisition import DataError, Lights, Source
from calibration import BandedStack, EstimateError, Stack
from processing._reconstruction.examination import Examination
from processing._reconstruction.heights import Heights
from processing._reconstruction.object_of_images import object_of
from processing._reconstruction.recorded_images import RecordedImages
from processing._reconstruction.surface_points import SurfacePoints
from processing._reconstruction.views import View, view_of
from processing._stereo.method import Method
from rig import Notice, Progress


class Geometry(NamedTuple):
    """Lights to use, how pixels see points under near ones, and what is known of the height."""

    lights: Lights
    view: View | None
    height_mm: float | None
    rests_on_plane: bool


def examination_of(
    source: Source,
    stack: Stack | BandedStack,
    geometry: Geometry,
    method: Method,
    on_progress: Progress,
) -> tuple[Examination, list[Notice]]:
    """Return the examination of the images of a source, and notices about the mask.

    Raises
    ------
    EstimateError
        If no object stands out.
    """
    lights, view, height_mm, rests_on_plane = geometry
    images = RecordedImages(stack)
    on_progress("normals", 0, 1)  # the images are examined first
    mask, of_mask = object_of(images, stack.mask, source.not_object, stack.pattern)
    heights = Heights(view, mask, height_mm, rests_on_plane, method, on_progress)
    points = None if view is None else SurfacePoints(view, view.distance_mm, mask.shape)
    return Examination(source, images, lights, mask, heights, points), of_mask


def geometry_of(
    source: Source,
    pixel_mm: float | None,
    height_mm: float | None,
    *,
    rests_on_plane: bool,
    distant: bool,
) -> Geometry:
    """Return the geometry of a source, before any image is read.

    Raises
    ------
    DataError
        If there are no lights, near lights have no scale, or a height is stated for distant ones.
    """
    if source.lights is None:
        raise DataError(
            f"{source.path}: these images have no lights: give the lights.json of a calibration"
        )
    lights = source.lights.distant() if distant else source.lights
    view = view_of(source, pixel_mm) if lights.near else None
    if view is None and (height_mm is not None or rests_on_plane):
        raise DataError(
            f"{source.path}: a height matters only under lights with positions: leave it out"
        )
    return Geometry(lights, view, height_mm, rests_on_plane)


def check_facing(source: Source, mean_z: float) -> None:
    """Raise `EstimateError` if most normals face away from the camera."""
    if mean_z < 0:
        raise EstimateError(
            f"{source.path}: the normals face away from the camera: check that the light "
            "directions point from the object toward the lights, with z toward the camera"
        )
