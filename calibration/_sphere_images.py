"""What the images show of the spheres that masks or rough circles mark."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from acquisition import DataError
from calibration._conic import Array, Ellipse, fit_ellipse
from calibration._errors import EstimateError
from calibration._find_spheres import SphereImage
from calibration._highlights import find_highlights
from calibration._outline import mask_outlines, outline_image, refine_outline

Mask = npt.NDArray[np.bool_] | npt.NDArray[np.floating]


# An ellipse this long is no sphere: perspective and pixels that are not square do less.
_LONGEST_RATIO = 1.5
_ROUGHEST_SHARE = 0.05


def masked_spheres(values: npt.NDArray[np.float32], masks: Sequence[Mask]) -> list[SphereImage]:
    """Return outlines and highlights of the spheres in masks.

    Parameters and errors are those of `calibrate_spheres`.
    """
    images = []
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
            images.append(SphereImage(outline, points, coverage, find_highlights(values, outline)))
    return images


def circled_spheres(
    values: npt.NDArray[np.float32], circles: Sequence[tuple[float, float, float]]
) -> list[SphereImage]:
    """Return outlines and highlights of the spheres near rough circles.

    Parameters and errors are those of `calibrate_spheres`.
    """
    images = []
    picture = outline_image(values)
    for x, y, radius in circles:
        if not radius > 0:
            raise DataError(f"a sphere circle of radius {radius:g} px is not a circle")
        guess = Ellipse((float(x), float(y)), (float(radius), float(radius)))
        outline, points, coverage = refine_outline(picture, guess, max(4.0, 0.1 * radius))
        images.append(SphereImage(outline, points, coverage, find_highlights(values, outline)))
    return images


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
