"""Beginning and checks that all ways of a reconstruction share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from acquisition import DataError, Lights, Source
from calibration import BandedStack, EstimateError, Stack
from processing._mask import mask_of_images
from processing._reconstruction.examination import Examination
from processing._reconstruction.mosaic import blocks_of_sites
from processing._reconstruction.near_height import NearHeight, near_height
from processing._reconstruction.recorded_images import Images, RecordedImages
from processing._reconstruction.views import SurfacePoints, View, view_of
from processing._stereo.method import Method
from rig import Notice, Progress

Mask = npt.NDArray[np.bool_]

# A computed mask beyond these probably contains background.
_LARGEST_SHARE = 0.8
_MOST_BORDERS = 3


@dataclass(frozen=True, eq=False)
class Heights:
    """Where the surface is, from the images."""

    view: View | None
    mask: npt.NDArray[np.bool_]
    height_mm: float | None
    rests_on_plane: bool
    method: Method
    on_progress: Progress

    @property
    def stated(self) -> bool:
        """Whether the height does not have to be found."""
        return self.height_mm is not None or self.rests_on_plane

    def of(self, values: Images, lights: Lights) -> tuple[NearHeight | None, SurfacePoints | None]:
        """Return the height under near lights and the points; None under distant lights."""
        if self.view is None:
            return None, None
        near = near_height(
            values,
            lights,
            self.mask,
            self.view,
            method=self.method,
            height_mm=self.height_mm,
            rests_on_plane=self.rests_on_plane,
            on_step=lambda done, total: self.on_progress("height", done, total),
        )
        return near, SurfacePoints(self.view, near.depth, self.mask.shape)


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
    mask, of_mask = _object_of(images, stack.mask, source.not_object, stack.pattern)
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


def _object_of(
    images: RecordedImages, mask: Mask | None, elsewhere: Mask | None, pattern: str | None
) -> tuple[Mask, list[Notice]]:
    """Return the mask of the object, computed from the images if no mask is given, and notices.

    Parameters
    ----------
    images
        The N images.
    mask
        ``(H, W)`` bool, the mask of the source; None if it has no mask.
    elsewhere
        ``(H, W)`` bool, pixels that are something else, such as spheres; None without any.
    pattern
        Colours of the first 2 x 2 sites of a mosaic; None for other images.

    Raises
    ------
    EstimateError
        If no object stands out.
    """
    if mask is not None:
        return mask if elsewhere is None else mask & ~elsewhere, []
    seen = images if pattern is None else map(blocks_of_sites, images)
    computed = mask_of_images(seen, images.size, elsewhere)
    text = (
        "the images have no mask: one was computed; the object is "
        f"{computed.contrast:.0f} times as bright as the background"
    )
    return computed.mask, [Notice("mask-estimated", text), *_mask_warning(computed.mask)]


def _mask_warning(mask: Mask) -> list[Notice]:
    """Return a warning about a computed mask that probably contains background."""
    share = float(mask.mean())
    touched = sum(bool(border.any()) for border in (mask[0], mask[-1], mask[:, 0], mask[:, -1]))
    if share <= _LARGEST_SHARE and touched < _MOST_BORDERS:
        return []
    text = (
        f"the computed mask covers {share:.0%} of the image and touches {touched} of its borders: "
        "it probably contains background; give a mask"
    )
    return [Notice("mask-fills-frame", text)]
