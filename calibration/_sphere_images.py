"""What the images show of the spheres: given by masks, given by rough circles, or found."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from acquisition import CameraModel, DataError
from calibration._conic import Array, Ellipse, fit_ellipse
from calibration._errors import EstimateError
from calibration._find_spheres import SphereImage, find_spheres
from calibration._highlights import find_highlights
from calibration._outline import mask_outlines, outline_image, refine_outline

# Outlines of spheres scatter by 0.02 to 0.15 px; those of what only looks round, by 0.4 and more.
_SHARP_OUTLINE_PX = 0.25
_SHARP_OUTLINE_RATIO = 3.0

Mask = npt.NDArray[np.bool_] | npt.NDArray[np.floating]


# An ellipse this long is no sphere: perspective and pixels that are not square do less.
_LONGEST_RATIO = 1.5
_ROUGHEST_SHARE = 0.05


def sphere_images(
    values: npt.NDArray[np.float32],
    masks: Sequence[Mask] | None,
    circles: Sequence[tuple[float, float, float]] | None,
    radii_px: list[float],
) -> list[SphereImage]:
    """Return outlines and highlights of the spheres: from masks, near circles, or found.

    Parameters and errors are those of `calibrate_spheres`; ``radii_px`` is for `find_spheres`.
    """
    images = []
    if masks is not None:
        for mask in masks:
            if mask.shape != values.shape[1:]:
                raise DataError(
                    f"a sphere mask of {mask.shape} does not fit images of {values.shape[1:]}"
                )
            outlines = mask_outlines(mask)
            if not outlines:
                raise EstimateError("a sphere mask is empty: mark the sphere in it")
            for points in outlines:
                outline, _ = fit_ellipse(points)
                _check_disc(outline, points)
                coverage = min(len(points) / (8 * outline.radius_px), 1.0)
                images.append(
                    SphereImage(outline, points, coverage, find_highlights(values, outline))
                )
        return images
    if circles is None:
        return find_spheres(values, radii_px)
    picture = outline_image(values)
    for x, y, radius in circles:
        if not radius > 0:
            raise DataError(f"a sphere circle of radius {radius:g} px is not a circle")
        guess = Ellipse((float(x), float(y)), (float(radius), float(radius)))
        outline, points, coverage = refine_outline(picture, guess, max(4.0, 0.1 * radius))
        images.append(SphereImage(outline, points, coverage, find_highlights(values, outline)))
    return images


def expected_radii_px(
    camera: CameraModel | None, radius_mm: float | Sequence[float] | None
) -> list[float]:
    """Return how large spheres that lie on the working plane appear."""
    if camera is None or camera.working_distance_mm is None or radius_mm is None:
        return []
    focal = float(np.sqrt(camera.K[0, 0] * camera.K[1, 1]))
    radii = np.atleast_1d(np.asarray(radius_mm, np.float64))
    distances = np.maximum(camera.working_distance_mm - radii, radii)
    return [float(size) for size in focal * radii / distances]


def drop_blurred(images: list[SphereImage]) -> tuple[list[SphereImage], list[str]]:
    """Drop what was found with an outline far less sharp than the sharpest one.

    Returns
    -------
    images
        The others, at least one.
    warnings
        One line for each that was dropped.
    """
    limit_px = max(_SHARP_OUTLINE_PX, _SHARP_OUTLINE_RATIO * min(i.rms_px for i in images))
    warnings = [
        f"{places([image])} was left out: its outline scatters by {image.rms_px:.1f} px, too much "
        "for a mirror sphere"
        for image in images
        if image.rms_px > limit_px
    ]
    return [image for image in images if image.rms_px <= limit_px], warnings


def saturation_warning(images: list[SphereImage]) -> list[str]:
    """Tell of saturated highlights, if there are any."""
    share = np.mean(
        np.concatenate([image.highlights.saturated[image.highlights.found] for image in images])
    )
    if share == 0:
        return []
    return [
        f"{100 * share:.0f} % of the highlights are saturated, their middle may be a degree off: "
        "add a short exposure"
    ]


def places(images: list[SphereImage]) -> str:
    """Name spheres by where they are."""
    where = [f"({i.outline.centre_px[0]:.0f}, {i.outline.centre_px[1]:.0f})" for i in images]
    return ("the sphere at " if len(where) == 1 else "the spheres at ") + ", ".join(where) + " px"


def _check_disc(outline: Ellipse, points: Array) -> None:
    """Refuse a mask whose outline is not that of a sphere."""
    axes = outline.semi_axes_px
    scatter = float(np.sqrt(np.mean(outline.distance_px(points) ** 2)))
    if max(axes) > _LONGEST_RATIO * min(axes) or scatter > 1 + _ROUGHEST_SHARE * min(axes):
        x, y = outline.centre_px
        raise EstimateError(
            f"the mask at ({x:.0f}, {y:.0f}) px is no disc of a sphere: its ellipse has semi-axes "
            f"{axes[0]:.0f} x {axes[1]:.0f} px, from which its edge strays by {scatter:.1f} px"
        )
