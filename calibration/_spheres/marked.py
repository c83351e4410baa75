"""Outlines and highlights of spheres that are marked by masks or approximate circles."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from acquisition import CameraModel, DataError
from calibration._errors import EstimateError
from calibration._radiance.raw_stack import Images
from calibration._spheres.confirmed import confirmed_near
from calibration._spheres.ellipse import ELLIPSE_COVERAGE, Ellipse, fit_circle, fit_ellipse
from calibration._spheres.highlights import find_highlights
from calibration._spheres.masked import mask_reach_px, sphere_in_mask
from calibration._spheres.near_circle import outline_near
from calibration._spheres.outline import OutlineImages, mask_outlines
from calibration._spheres.robust import Array
from calibration._spheres.sphere_image import SphereImage
from calibration._spheres.spots import reduce_stack
from calibration._spheres.surroundings import MirroredPlane

Mask = npt.NDArray[np.bool_] | npt.NDArray[np.floating]

# Largest ratio of the axes of a sphere's outline; perspective and non-square pixels cause less.
_LONGEST_RATIO = 1.5
_ROUGHEST_SHARE, _EXACT_SHARE = 0.05, 0.01


def masked_spheres(
    values: Images, masks: Sequence[Mask], camera: CameraModel | None = None
) -> list[SphereImage]:
    """Return outlines and highlights of the spheres in masks.

    A mask that contradicts the images is refined, see `sphere_in_mask`. Parameters and errors are
    those of `calibrate_spheres`.
    """
    given: list[tuple[Ellipse, Array, float]] = []
    for mask in masks:
        if mask.shape != values.shape[1:]:
            raise DataError(
                f"a sphere mask of {mask.shape} does not fit images of {values.shape[1:]}"
            )
        outlines = mask_outlines(mask)
        if not outlines:
            raise EstimateError("a sphere mask is empty: paint the sphere in it")
        for points in outlines:
            if not len(points):
                raise EstimateError(
                    "a sphere mask covers the complete image: paint only the sphere in it"
                )
            outline, _ = fit_ellipse(points)
            _check_disc(outline, points)
            if _coverage(outline, points) <= ELLIPSE_COVERAGE:
                outline, _ = fit_circle(points)
                _check_disc(outline, points)
            coverage = _coverage(outline, points)
            given.append((outline, points, coverage))
    pictures = OutlineImages(values)
    plane = MirroredPlane(values, reduce_stack(values), camera)
    circles = [
        Ellipse(outline.centre_px, (outline.radius_px, outline.radius_px))
        for outline, _, _ in given
    ]
    reaches = [mask_reach_px(circle.radius_px) for circle in circles]
    near = confirmed_near(values, plane, circles, reaches)
    return [
        sphere_in_mask(values, pictures, mirroring, *one)
        for mirroring, one in zip(near, given, strict=True)
    ]


def circled_spheres(
    values: Images,
    circles: Sequence[tuple[float, float, float]],
    camera: CameraModel | None = None,
) -> list[SphereImage]:
    """Return outlines and highlights of the spheres near approximate circles.

    If a ball near the circle mirrors the plane on which it rests, and the edges of all images do
    not contradict it, that determines its outline on any ground; else the edge near the circle
    does, see `outline_near`. Parameters and errors are those of `calibrate_spheres`.
    """
    guesses: list[Ellipse] = []
    for x, y, radius in circles:
        if not (np.isfinite([x, y, radius]).all() and radius > 0):
            raise DataError(
                f"a sphere circle at ({x:g}, {y:g}) px with radius {radius:g} px is invalid: give "
                "finite numbers and a radius above 0"
            )
        guesses.append(Ellipse((float(x), float(y)), (float(radius), float(radius))))
    pictures = OutlineImages(values)
    plane = MirroredPlane(values, reduce_stack(values), camera)
    reaches = [max(4.0, 0.1 * guess.radius_px) for guess in guesses]
    images = []
    for guess, reach, mirroring in zip(
        guesses, reaches, confirmed_near(values, plane, guesses, reaches), strict=True
    ):
        if mirroring is not None:
            images.append(mirroring)
            continue
        near = outline_near(pictures, guess, reach)
        highlights = find_highlights(values, near.outline)
        images.append(
            SphereImage(
                near.outline, near.points_px, near.coverage, highlights, near.covariance_px2
            )
        )
    return images


def _coverage(outline: Ellipse, points: Array) -> float:
    """Return the share 0..1 of a circumference that is covered by crossings of a mask."""
    # The rows cross a complete circle 4 r times, and so do the columns.
    return min(len(points) / (8 * outline.radius_px), 1.0)


def _check_disc(outline: Ellipse, points: Array) -> None:
    """Raise `EstimateError` if the outline of a mask is not that of a sphere."""
    axes = outline.semi_axes_px
    distances = np.sort(np.abs(outline.distance_px(points)))
    scatter = float(np.sqrt(np.mean(distances**2)))
    # A mask with a bite is exact elsewhere.
    bitten = distances[3 * len(distances) // 4] < 1 + _EXACT_SHARE * min(axes)
    rough = scatter > 1 + _ROUGHEST_SHARE * min(axes) and not bitten
    if max(axes) > _LONGEST_RATIO * min(axes) or rough:
        x, y = outline.centre_px
        raise EstimateError(
            f"the mask at ({x:.0f}, {y:.0f}) px is not the disc of a sphere: its ellipse has "
            f"semi-axes of {axes[0]:.0f} x {axes[1]:.0f} px, from which its edge deviates by "
            f"{scatter:.1f} px"
        )
