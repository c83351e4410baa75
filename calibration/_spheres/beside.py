"""Calibration from mirror spheres beside the object, in the same images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
import numpy.typing as npt

from acquisition import DataError, Source
from calibration._radiance.linear_stack import linear_stack
from calibration._spheres.calibrate import calibrate_spheres
from calibration._spheres.ellipse import Ellipse
from calibration._spheres.marked import Mask
from calibration._spheres.sphere_calibration import SphereCalibration
from rig import Progress, check_type, no_progress

# The bright rim of an outline, blurred by the lens, and the contact shadow extend beyond it.
_MARGIN, _MARGIN_PX = 0.05, 3.0


def calibrate_beside(
    source: Source,
    *,
    radius_mm: float | Sequence[float] | None = None,
    circles: Sequence[tuple[float, float, float]] | None = None,
    masks: Sequence[Mask] | None = None,
    on_progress: Progress = no_progress,
) -> tuple[Source, SphereCalibration]:
    """Estimate the lights of a recording from mirror spheres beside its object.

    Parameters
    ----------
    source
        The complete recording, not a region of it.
    radius_mm, circles, masks
        Radius and outlines of the spheres, as for `calibrate_spheres`; the camera is that of the
        source.
    on_progress
        Receives the stage ``reading``, one step per light.

    Returns
    -------
    source
        The recording with these lights; its `Source.not_object` covers the spheres and a margin of
        5 % of their radius, at least 3 px. Intensities and angular falloff are those that the
        source had, since spheres do not determine them.
    calibration
        Quality of the lights.

    Raises
    ------
    DataError
        If the source is a region or at a lower resolution, besides the errors of
        `calibrate_spheres` and `linear_stack`.
    EstimateError
        As `calibrate_spheres`.

    Examples
    --------
    >>> from acquisition import read_source
    >>> from calibration import calibrate_beside
    >>> source, spheres = calibrate_beside(read_source("owl"), radius_mm=10.0)  # doctest: +SKIP
    """
    check_type("source", source, Source, "acquisition.read_source(path) returns one")
    if source.reduction is not None:
        raise DataError(
            f"{source.path}: spheres are searched for in complete images: calibrate before "
            "cropping or scaling"
        )
    # The intensities stay in the images: they do not matter for the places of the highlights.
    stack = linear_stack(replace(source, lights=None), on_progress=on_progress)
    estimate = calibrate_spheres(
        stack, masks=masks, circles=circles, camera=source.camera, radius_mm=radius_mm
    )
    lights, before = estimate.lights, source.lights
    if before is not None:
        lights = replace(lights, intensities=before.intensities)
        if lights.near and before.near:
            lights = replace(lights, axes=before.axes, mu=before.mu)
    covered = np.zeros(source.size, np.uint8)
    for sphere in estimate.spheres:
        _fill(covered, sphere.outline)
    beside = covered > 0
    if source.not_object is not None:
        beside |= source.not_object
    return replace(source, lights=lights, not_object=beside), estimate


def _fill(covered: npt.NDArray[np.uint8], outline: Ellipse) -> None:
    """Mark the pixels of a sphere and its margin."""
    margin = max(_MARGIN * outline.radius_px, _MARGIN_PX)
    angles = np.linspace(0, 2 * np.pi, 360, endpoint=False)
    edge = outline.point(angles, 1 + margin / outline.radius_px)
    cv2.fillPoly(covered, [np.rint(edge).astype(np.int32)], 1)
