"""Fit of the viewing cone of a sphere."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calibration._errors import EstimateError
from calibration.spheres.geometry.robust import (
    FINEST_PX,
    ROUNDS,
    check_enough,
    tukey_weights,
    weighted_solve,
)
from rig.arrays import Float64

# Systematic error of the position and of the radius of an outline, which no scatter shows: where
# the edge is within a blurred step.
OUTLINE_SIGMA_PX = 0.03


@dataclass(frozen=True, eq=False)
class Cone:
    """The cone of rays that touch a sphere.

    Parameters
    ----------
    axis
        ``(3,)`` unit vector from the centre of projection to the sphere's centre.
    sine
        Sine of the half angle: the sphere's radius divided by its distance.
    covariance
        ``(3, 3)`` covariance of ``axis / sine``, the sphere's centre in units of its radius.
    systematic_px
        Systematic error of place and radius of the outline, which the covariance does not contain.
    """

    axis: Float64
    sine: float
    covariance: Float64
    systematic_px: float = OUTLINE_SIGMA_PX


def fit_cone(rays: Float64, pixel_angle: float) -> tuple[Cone, Float64]:
    """Fit the cone of rays tangent to a sphere.

    A tangent ray r (unit) has ``r . c = cos(alpha)`` for the unit axis c, so ``v = c / cos(alpha)``
    solves the linear system ``r . v = 1``; Tukey weights make it robust.

    Parameters
    ----------
    rays
        ``(M, 3)`` rays through outline points, of any length.
    pixel_angle
        Angle of one pixel in radians.

    Returns
    -------
    cone
        The cone.
    weights
        ``(M,)`` weights in 0..1.

    Raises
    ------
    EstimateError
        If fewer than 3 rays remain or they do not form a cone.

    Examples
    --------
    >>> import numpy as np
    >>> from calibration.spheres import fit_cone
    >>> turn = np.linspace(0, 2 * np.pi, 60)
    >>> rays = np.stack([0.1 * np.cos(turn), 0.1 * np.sin(turn), np.ones(60)], 1)
    >>> cone, weights = fit_cone(rays, pixel_angle=0.001)
    >>> round(float(cone.sine), 4)
    0.0995
    """
    unit = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    weights = np.ones(len(unit))
    v = np.zeros(3)
    for _ in range(ROUNDS):
        check_enough(weights, 3, "a cone")
        v = weighted_solve(unit, np.ones(len(unit)), weights)
        if not v @ v > 1:
            raise EstimateError(
                "the outline points do not fit a cone: check the outline of the sphere"
            )
        # An angle e across the cone changes r . v by e tan(alpha).
        tangent = np.sqrt(v @ v - 1)
        weights = tukey_weights((unit @ v - 1) / tangent, FINEST_PX * pixel_angle)
    length = float(np.linalg.norm(v))
    axis = v / length
    # |v| = 1 / cos(alpha), so sin(alpha) = sqrt(1 - 1 / |v|^2).
    sine = float(np.sqrt((length - 1) * (length + 1)) / length)
    residual = unit @ v - 1
    variance = np.sum(weights * residual**2) / max(np.sum(weights) - 3, 1.0)
    finest = FINEST_PX * pixel_angle * np.sqrt(length**2 - 1)
    covariance = centre_covariance(unit, weights, v, max(variance, finest**2), length**2)
    return Cone(axis, sine, covariance), weights


def centre_covariance(
    unit: Float64, weights: Float64, v: Float64, variance: float, square: float
) -> Float64:
    """Return the covariance of a sphere's centre in radii from unit rays that touch it.

    The variance is that of ``r . v``; ``square`` is that of v.
    """
    of_v = variance * np.linalg.inv((unit * weights[:, None]).T @ unit)
    # The derivative of u = v / sqrt(|v|^2 - 1) transforms the covariance of v to that of u.
    root = np.sqrt(square - 1)
    slope = np.eye(3) / root - np.outer(v, v) / root**3
    return np.asarray(slope @ of_v @ slope.T)
