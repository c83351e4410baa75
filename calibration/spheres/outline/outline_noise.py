"""How well the outline of a sphere is known, from the errors of its edge points."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from acquisition import CameraModel
from calibration.spheres.geometry.cone import OUTLINE_SIGMA_PX, Cone, centre_covariance, fit_cone
from calibration.spheres.geometry.robust import FINEST_PX, tukey_weights
from calibration.spheres.outline.outline import TracedOutline
from calibration.spheres.outline.sphere_image import SphereImage
from rig.arrays import Float64

# Edge points are smoothed along the outline by a Gaussian of 4 px: harmonics up to a number of an
# eighth of the radius in pixels keep their power.
_RADIUS_PER_HARMONIC_PX = 8.0
_FEWEST, _MOST = 5, 16
# The 95 % and 99.9 % quantiles of chi-square with 3 degrees of freedom: larger differences are not
# chance, and show that the errors are larger than stated.
CHANCE, SAME_OUTLINE = 7.8, 16.3
_DEPENDENT = 1e-3
_FINEST_PX = 0.02
_SMALL_PX = 0.01


def viewing_cone(rays: Float64, pixel_angle: float) -> Cone:
    """Fit the cone of rays tangent to a sphere, see `fit_cone`, with an honest covariance.

    Parameters
    ----------
    rays
        ``(M, 3)`` rays through outline points, of any length.
    pixel_angle
        Angle of one pixel in radians.

    Raises
    ------
    EstimateError
        If fewer than 3 rays remain or they do not form a cone.
    """
    cone, weights = fit_cone(rays, pixel_angle)
    unit = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    cosine = np.sqrt(1 - cone.sine**2)
    tangent = cone.sine / cosine
    v = cone.axis / cosine
    first = np.cross(cone.axis, np.eye(3)[np.argmin(np.abs(cone.axis))])
    second = np.cross(cone.axis, first)
    angles = np.arctan2(unit @ second, unit @ first)
    residuals_px = (unit @ v - 1) / (tangent * pixel_angle)
    variance = slow_variance(angles, residuals_px, weights, tangent / pixel_angle, fitted=1)
    variance *= (tangent * pixel_angle) ** 2
    return replace(cone, covariance=centre_covariance(unit, weights, v, variance, v @ v))


def cone_of(camera: CameraModel, image: SphereImage) -> Cone:
    """Return the viewing cone of a sphere, with the covariance of its outline.

    Parameters
    ----------
    camera
        Camera of the image.
    image
        The sphere.

    Raises
    ------
    EstimateError
        As `viewing_cone`.
    """
    points = image.points_px
    if image.covariance_px2 is None:
        return viewing_cone(camera.rays(points), 1 / camera.focal_px)
    cone, _ = fit_cone(camera.rays(points), 1 / camera.focal_px)
    outward = (points - image.outline.centre_px) / image.outline.radius_px
    slopes = []
    for change in (np.array([1.0, 0.0]), np.array([0.0, 1.0]), outward):
        moved, _ = fit_cone(camera.rays(points + _SMALL_PX * change), 1 / camera.focal_px)
        slopes.append((moved.axis / moved.sine - cone.axis / cone.sine) / _SMALL_PX)
    slope = np.stack(slopes, axis=1)
    covariance = slope @ image.covariance_px2 @ slope.T
    return replace(cone, covariance=covariance, systematic_px=image.systematic_px)


def outline_covariance(image: SphereImage) -> Float64:
    """Return the covariance ``(3, 3)`` of centre x, centre y and radius of a sphere's outline.

    It includes the systematic error of each.
    """
    if image.covariance_px2 is not None:
        return image.covariance_px2 + np.eye(3) * image.systematic_px**2
    return circle_covariance(image)


def circle_covariance(traced: TracedOutline) -> Float64:
    """Return the covariance ``(3, 3)`` of centre x, centre y and radius of an outline, in px^2.

    It is shown by the scatter of the points, and includes the systematic error of each,
    `OUTLINE_SIGMA_PX`.
    """
    outline = traced.outline
    residuals = outline.distance_px(traced.points_px)
    weights = tukey_weights(residuals, FINEST_PX)
    x, y = outline.unit(traced.points_px).T
    angles = np.arctan2(y, x)
    variance = slow_variance(angles, residuals, weights, outline.radius_px, fitted=2)
    design = np.column_stack([np.cos(angles), np.sin(angles), np.ones_like(angles)])
    covariance: Float64 = variance * np.linalg.pinv((design * weights[:, None]).T @ design)
    return covariance + np.eye(3) * OUTLINE_SIGMA_PX**2


def chi_square(change: Float64, covariance: Float64) -> float:
    """Return how far a change of centre x, centre y and radius is from chance."""
    return float(change @ np.linalg.solve(covariance, change))


def scatter_covariance(traced: TracedOutline) -> Float64:
    """Return `circle_covariance` without the systematic errors."""
    return circle_covariance(traced) - np.eye(3) * OUTLINE_SIGMA_PX**2


def slow_variance(
    angles: Float64, residuals: Float64, weights: Float64, radius_px: float, *, fitted: int
) -> float:
    """Return the variance per edge point of the slow errors along an outline.

    Position and size of an outline depend on the harmonics 0 and 1 of the errors along it, which
    the fit removes from the residuals. The power of the next harmonics is that of independent
    points if the errors are independent, and larger if neighbouring errors are correlated. Their
    mean power, with the factor n / (n - 2) for its own uncertainty from n values, is returned, or
    the plain variance if that is larger.

    Parameters
    ----------
    angles
        ``(M,)`` positions of the points on the outline, radians.
    residuals
        ``(M,)`` deviations from the outline.
    weights
        ``(M,)`` weights of the points in the fit.
    radius_px
        Radius of the outline in pixels.
    fitted
        Largest harmonic that the fit removed.

    Returns
    -------
    float
        In the square of the unit of the residuals, at least 0.02^2.
    """
    count = float(np.sum(weights))
    plain = float(np.sum(weights * residuals**2)) / max(count - 2 * fitted - 1, 1.0)
    highest = fitted + int(np.clip(radius_px / _RADIUS_PER_HARMONIC_PX, _FEWEST, _MOST))
    highest = min(highest, (len(angles) - 1) // 2)
    columns = [np.ones_like(angles)]
    for h in range(1, highest + 1):
        columns += [np.cos(h * angles), np.sin(h * angles)]
    root = np.sqrt(weights)
    basis, triangle = np.linalg.qr(np.column_stack(columns) * root[:, None])
    # On a part of the circumference, high harmonics are sums of others.
    length = np.linalg.norm(triangle, axis=0)
    independent = np.abs(np.diag(triangle)) > _DEPENDENT * length
    independent[: 2 * fitted + 1] = False
    values = basis[:, independent].T @ (root * residuals)
    # Weights below 1 reduce the power of noise by their weighted mean.
    norm = float(np.sum(weights**2)) / count
    slow = float(np.sum(values**2)) / (norm * max(len(values) - 2, 1)) if len(values) else 0.0
    return max(plain, slow, _FINEST_PX**2)
