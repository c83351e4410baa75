"""Outlines and highlights of spheres that are marked by masks or approximate circles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from acquisition import CameraModel, DataError
from calibration._errors import EstimateError, or_none
from calibration.radiance.stack import Images
from calibration.spheres.geometry.ellipse import ELLIPSE_COVERAGE, Ellipse, fit_circle, fit_ellipse
from calibration.spheres.geometry.robust import FINEST_PX, tukey_weights
from calibration.spheres.highlights.highlights import find_highlights
from calibration.spheres.highlights.spots import reduce_stack
from calibration.spheres.outline.near_circle import NearOutline, outline_near
from calibration.spheres.outline.outline import (
    OutlineImages,
    TracedOutline,
    mask_outlines,
    usual_reach_px,
)
from calibration.spheres.outline.outline_confirmation import ball_around, confirmed_near
from calibration.spheres.outline.outline_noise import (
    CHANCE,
    SAME_OUTLINE,
    chi_square,
    circle_covariance,
    scatter_covariance,
)
from calibration.spheres.outline.sphere_image import SphereImage
from calibration.spheres.outline.surroundings import MirroredPlane
from calibration.spheres.propose.edge_search import is_painted
from rig.arrays import Bool, Float64, Floating

Mask = Bool | Floating

# Largest ratio of the axes of a sphere's outline; perspective and non-square pixels cause less.
_LONGEST_RATIO = 1.5
_ROUGHEST_SHARE, _EXACT_SHARE = 0.05, 0.01
# How many standard deviations the largest errors of masks that are painted by hand are. A person
# who paints a small ball sees smaller errors: the limit in radii.
_REACH_SIGMAS, _PAINTED_SHARE = 3.0, 0.03
# The images confirm a mask if they reduce its standard deviation by this factor.
_CONFIRMED = 0.5
# Noise supports parts of smaller outlines.
_SMALL_PX = 25.0
# The pixels of a mask are accurate to half a pixel: a smaller difference does not contradict it.
_SAME_PX = 0.5


def masked_spheres(
    values: Images, masks: Sequence[Mask], camera: CameraModel | None = None
) -> list[SphereImage]:
    """Return outlines and highlights of the spheres in masks.

    A mask that contradicts the images is refined, see `sphere_in_mask`. Parameters and errors are
    those of `calibrate_spheres`.
    """
    given: list[TracedOutline] = []
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
            given.append(TracedOutline(outline, points, _coverage(outline, points)))
    pictures = OutlineImages(values)
    plane = MirroredPlane(values, reduce_stack(values), camera)
    circles = [Ellipse.circle(*one.outline.circle_px) for one in given]
    reaches = [usual_reach_px(circle.radius_px) for circle in circles]
    near = confirmed_near(values, plane, circles, reaches)
    return [
        sphere_in_mask(values, pictures, mirroring, one)
        for mirroring, one in zip(near, given, strict=True)
    ]


def circled_spheres(
    values: Images, circles: Sequence[tuple[float, float, float]], camera: CameraModel | None = None
) -> list[SphereImage]:
    """Return outlines and highlights of the spheres near approximate circles.

    If a ball near the circle mirrors the plane on which it rests, and the edges of all images do
    not contradict it, that determines its outline on any ground; else the edge near the circle
    does, see `outline_near`, or the ball that mirrors its horizon as this edge. Parameters and
    errors are those of `calibrate_spheres`.
    """
    guesses: list[Ellipse] = []
    for x, y, radius in circles:
        if not (np.isfinite([x, y, radius]).all() and radius > 0):
            raise DataError(
                f"a sphere circle at ({x:g}, {y:g}) px with radius {radius:g} px is invalid: give "
                "finite numbers and a radius above 0"
            )
        guesses.append(Ellipse.circle(x, y, radius))
    pictures = OutlineImages(values)
    plane = MirroredPlane(values, reduce_stack(values), camera)
    reaches = [max(4.0, 0.1 * guess.radius_px) for guess in guesses]
    near = confirmed_near(values, plane, guesses, reaches)
    spheres: list[SphereImage] = []
    for guess, reach, sphere in zip(guesses, reaches, near, strict=True):
        if sphere is None:
            edge = outline_near(pictures, guess, reach)
            sphere = ball_around(values, plane, edge.outline) or _sphere(values, edge)
        spheres.append(sphere)
    return spheres


def _sphere(values: Images, near: NearOutline) -> SphereImage:
    """Return the sphere with an outline that was found near a guess."""
    highlights = find_highlights(values, near.outline)
    return SphereImage(near.outline, near.points_px, near.coverage, highlights, near.covariance_px2)


def _coverage(outline: Ellipse, points: Float64) -> float:
    """Return the share 0..1 of a circumference that is covered by crossings of a mask."""
    # The rows cross a complete circle 4 r times, and so do the columns.
    return min(len(points) / (8 * outline.radius_px), 1.0)


def _check_disc(outline: Ellipse, points: Float64) -> None:
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


def sphere_in_mask(
    values: Images, pictures: OutlineImages, mirroring: SphereImage | None, mask: TracedOutline
) -> SphereImage:
    """Return the sphere in a mask, with the outline of the images if the mask contradicts them.

    The images show an outline if a ball that mirrors the plane is within 3 px or 3 % of the radius,
    or a sharp edge over 60 % of its length. A mask that differs from it by less than half a pixel,
    or by less than the errors of both, is kept, with the difference in its covariance if it is
    larger than the errors. If the edges of all images determine an outline less well, its mean with
    the mask is used, weighted by the inverse covariances; that of the mask is `painted_covariance`.
    A mask is also kept if the images show no outline there; then this is its covariance.

    Parameters
    ----------
    values
        ``(N, H, W)`` linear images, NaN where saturated.
    pictures
        The same images, in which edges are searched for.
    mirroring
        The sphere near the mask that mirrors the plane; None without one.
    mask
        Outline of the mask.
    """
    outline = mask.outline
    highlights = find_highlights(values, outline)
    seen, mirrors, is_sure = _seen_near(values, pictures, mirroring, outline)
    painted = not mirrors and is_painted(values, outline, highlights)
    given = SphereImage(outline, mask.points_px, mask.coverage, highlights, painted=painted)
    if seen is None:
        return replace(given, covariance_px2=painted_covariance(mask), unconfirmed=True)
    if not is_sure and seen.covariance_px2 is not None:
        return _between(values, given, seen, seen.covariance_px2)
    change = outline.change_to(seen.outline)
    of_seen = seen.covariance_px2
    both = circle_covariance(mask) + (circle_covariance(seen) if of_seen is None else of_seen)
    differ = chi_square(change, both)
    if differ < CHANCE:
        return given
    if differ < SAME_OUTLINE or np.abs(change).max() < _SAME_PX:
        covariance = scatter_covariance(mask) + np.outer(change, change)
        return replace(given, covariance_px2=covariance)
    return replace(seen, mask_off_px=float(np.abs(change).max()), painted=painted)


def painted_covariance(mask: TracedOutline) -> Float64:
    """Return the covariance ``(3, 3)`` of the outline of a mask that a person painted, in px^2.

    Of centre x, centre y and radius. A hand that is off along a part of the outline is off as a
    whole, too: the scatter about a circle counts as an error of each. It does not show that a mask
    is shifted or too large; 3 px or 3 % of the radius, the largest errors, are three standard
    deviations.
    """
    radius = mask.outline.radius_px
    residuals = np.hypot(*(mask.points_px - mask.outline.centre_px).T) - radius
    weights = tukey_weights(residuals, FINEST_PX)
    scatter = float(np.sum(weights * residuals**2) / np.sum(weights))
    own_px = min(usual_reach_px(radius) / _REACH_SIGMAS, _PAINTED_SHARE * radius)
    return np.eye(3) * (own_px**2 + scatter)


def _between(values: Images, given: SphereImage, seen: SphereImage, edges: Float64) -> SphereImage:
    """Return the mean of a mask and of an outline in the images, with the covariance ``edges``."""
    mask = painted_covariance(given)
    change = given.outline.change_to(seen.outline)
    both = mask + edges
    if chi_square(change, both) > SAME_OUTLINE:
        return replace(given, covariance_px2=mask + np.outer(change, change), unconfirmed=True)
    back = -edges @ np.linalg.solve(both, change)
    outline = seen.outline.moved(back)
    outward = (seen.points_px - seen.outline.centre_px) / seen.outline.radius_px
    points = seen.points_px + back[:2] + back[2] * outward
    covariance = mask - mask @ np.linalg.solve(both, mask)
    largest = np.linalg.eigvalsh(covariance)[-1]
    is_confirmed = largest < _CONFIRMED**2 * np.linalg.eigvalsh(mask)[-1]
    off_px = float(np.abs(change + back).max())
    return SphereImage(
        outline,
        points,
        seen.coverage,
        find_highlights(values, outline),
        covariance,
        mask_off_px=off_px if is_confirmed and off_px > _SAME_PX else 0.0,
        unconfirmed=not is_confirmed,
        painted=given.painted,
    )


def _seen_near(
    values: Images, pictures: OutlineImages, mirroring: SphereImage | None, outline: Ellipse
) -> tuple[SphereImage | None, bool, bool]:
    """Return the sphere that the images show near an outline, or None.

    The other results are whether it mirrors the plane, and whether its outline is without doubt.
    """
    radius = outline.radius_px
    reach = usual_reach_px(radius)
    seen, is_sure = mirroring, True
    if seen is None:
        near = or_none(outline_near, pictures, outline, reach)
        if near is None or (not near.is_sharp and radius < _SMALL_PX):
            return None, False, False
        is_sure = near.is_sharp
        seen = _sphere(values, near)
    off = outline.apart_px(seen.outline)
    far = max(off, abs(seen.outline.radius_px - radius)) > 1.5 * reach
    return None if far else seen, mirroring is not None and not far, is_sure
