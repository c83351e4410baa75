"""Ellipses and viewing cones through noisy outline points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from calibration._errors import EstimateError

Array = npt.NDArray[np.float64]

_ROUNDS = 14
# The first rounds minimise absolute distances: Tukey's weights need a start near the truth.
_ABSOLUTE_ROUNDS = 7
# No outline is known better than this; a smaller scale would throw away good points.
_FINEST_PX = 0.15


@dataclass(frozen=True)
class Ellipse:
    """An ellipse in the image.

    Parameters
    ----------
    centre_px
        (x, y) in pixels; (0, 0) is the centre of the first pixel.
    semi_axes_px
        Half lengths of the axes.
    angle_deg
        From the image's x axis (to the right) to the first axis, positive toward y (down).
    """

    centre_px: tuple[float, float]
    semi_axes_px: tuple[float, float]
    angle_deg: float = 0.0

    @property
    def radius_px(self) -> float:
        """Radius of the circle of equal area."""
        return float(np.sqrt(self.semi_axes_px[0] * self.semi_axes_px[1]))

    @property
    def matrix(self) -> Array:
        """``(2, 2)`` symmetric matrix from the unit circle to the ellipse round its centre."""
        angle = np.radians(self.angle_deg)
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        matrix: Array = turn @ np.diag(self.semi_axes_px) @ turn.T
        return matrix

    def unit(self, pixels: npt.ArrayLike) -> Array:
        """Return pixels ``(..., 2)`` in the frame in which the ellipse is the unit circle."""
        offset = np.asarray(pixels, np.float64) - self.centre_px
        unit: Array = offset @ np.linalg.inv(self.matrix)  # symmetric: no transpose needed
        return unit

    def point(self, angle: npt.ArrayLike, scale: npt.ArrayLike = 1.0) -> Array:
        """Return the pixels ``(..., 2)`` at these angles (radians) and multiples of the radius."""
        angle, scale = np.broadcast_arrays(np.asarray(angle), np.asarray(scale))
        circle = np.stack([np.cos(angle), np.sin(angle)], axis=-1) * scale[..., None]
        pixels: Array = circle @ self.matrix + self.centre_px
        return pixels

    def distance_px(self, pixels: npt.ArrayLike) -> Array:
        """Return about how far points ``(..., 2)`` lie outside (+) or inside (-) the outline."""
        unit = self.unit(pixels)
        radius = np.linalg.norm(unit, axis=-1)
        # First order: the level 1 of |unit|, over the length of its gradient in the image.
        gradient = np.linalg.norm(unit @ np.linalg.inv(self.matrix), axis=-1)
        distance: Array = (radius - 1) * radius / np.maximum(gradient, 1e-12)
        return distance


def fit_circle(points_px: Array) -> tuple[Ellipse, Array]:
    """Fit a circle to outline points with Tukey weights.

    Parameters
    ----------
    points_px
        ``(M, 2)`` points.

    Returns
    -------
    circle
        The circle.
    weights
        ``(M,)`` in 0..1: 0 for points that do not belong to it.

    Raises
    ------
    EstimateError
        If fewer than 3 points remain.
    """
    origin = points_px.mean(axis=0)
    points = points_px - origin
    design = np.column_stack([2 * points, np.ones(len(points))])
    square = np.sum(points**2, axis=1)
    weights = np.ones(len(points))
    circle = Ellipse((0.0, 0.0), (1.0, 1.0))
    for index in range(_ROUNDS):
        _enough(weights, 3, "circle")
        x, y, c = _weighted_solve(design, square, weights)
        radius = np.sqrt(max(c + x * x + y * y, 1e-12))
        centre = (float(x + origin[0]), float(y + origin[1]))
        circle = Ellipse(centre, (float(radius), float(radius)))
        weights = _robust(np.hypot(points[:, 0] - x, points[:, 1] - y) - radius, _FINEST_PX, index)
    return circle, weights


def fit_ellipse(points_px: Array) -> tuple[Ellipse, Array]:
    """Fit an ellipse to outline points: Halir and Flusser's direct fit, reweighted.

    The weights are Sampson's (geometric distance to first order) times Tukey's.

    Parameters
    ----------
    points_px
        ``(M, 2)`` points.

    Returns
    -------
    ellipse
        The ellipse.
    weights
        ``(M,)`` Tukey weights in 0..1.

    Raises
    ------
    EstimateError
        If fewer than 5 points remain or they lie on no ellipse.
    """
    start, weights = fit_circle(points_px)
    # Centred and scaled: the conic's columns would differ by orders of magnitude otherwise.
    points = (points_px - start.centre_px) / start.radius_px
    ellipse = start
    sampson = np.ones(len(points))
    for index in range(_ROUNDS):
        _enough(weights, 5, "ellipse")
        conic = _direct_conic(points, weights * sampson)
        unit = _conic_to_ellipse(conic)
        gradient = np.column_stack(
            [
                2 * conic[0] * points[:, 0] + conic[1] * points[:, 1] + conic[3],
                conic[1] * points[:, 0] + 2 * conic[2] * points[:, 1] + conic[4],
            ]
        )
        sampson = 1.0 / np.maximum(np.sum(gradient**2, axis=1), 1e-12)
        scale = start.radius_px
        ellipse = Ellipse(
            (
                float(start.centre_px[0] + scale * unit.centre_px[0]),
                float(start.centre_px[1] + scale * unit.centre_px[1]),
            ),
            (scale * unit.semi_axes_px[0], scale * unit.semi_axes_px[1]),
            unit.angle_deg,
        )
        weights = _robust(ellipse.distance_px(points_px), _FINEST_PX, index)
    return ellipse, weights


@dataclass(frozen=True, eq=False)
class Cone:
    """The cone of rays that touch a sphere.

    Parameters
    ----------
    axis
        ``(3,)`` unit vector from the centre of projection to the sphere's centre.
    sine
        Sine of the half angle: the sphere's radius over its distance.
    covariance
        ``(3, 3)`` of ``axis / sine``, the sphere's centre in units of its radius.
    """

    axis: Array
    sine: float
    covariance: Array


def fit_cone(rays: Array, pixel_angle: float) -> tuple[Cone, Array]:
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
        ``(M,)`` in 0..1.

    Raises
    ------
    EstimateError
        If fewer than 3 rays remain or they lie on no cone.
    """
    unit = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    weights = np.ones(len(unit))
    v = np.zeros(3)
    for index in range(_ROUNDS):
        _enough(weights, 3, "cone")
        v = _weighted_solve(unit, np.ones(len(unit)), weights)
        if not v @ v > 1:
            raise EstimateError("the outline points lie on no cone: check the sphere's outline")
        # An angle e across the cone changes r . v by e tan(alpha).
        tangent = np.sqrt(v @ v - 1)
        weights = _robust((unit @ v - 1) / tangent, _FINEST_PX * pixel_angle, index)
    length = float(np.linalg.norm(v))
    axis = v / length
    # |v| = 1 / cos(alpha), hence sin(alpha) = sqrt(1 - 1 / |v|^2) and centre / radius:
    sine = float(np.sqrt((length - 1) * (length + 1)) / length)
    residual = unit @ v - 1
    variance = np.sum(weights * residual**2) / max(np.sum(weights) - 3, 1.0)
    finest = _FINEST_PX * pixel_angle * np.sqrt(length**2 - 1)
    of_v = max(variance, finest**2) * np.linalg.inv((unit * weights[:, None]).T @ unit)
    # u = v / sqrt(|v|^2 - 1): its derivative carries the covariance over.
    root = np.sqrt(length**2 - 1)
    slope = np.eye(3) / root - np.outer(v, v) / root**3
    return Cone(axis, sine, slope @ of_v @ slope.T), weights


def _enough(weights: Array, count: int, what: str) -> None:
    left = int(np.sum(weights > 0))
    if left < count:
        raise EstimateError(f"{left} outline points do not determine a {what}")


def _weighted_solve(design: Array, target: Array, weights: Array) -> Array:
    root = np.sqrt(weights)
    solution = np.linalg.lstsq(design * root[:, None], target * root, rcond=None)[0]
    return np.asarray(solution, np.float64)


def _robust(residual: Array, finest: float, index: int) -> Array:
    """Return the weights of a round: those of least absolute values, later Tukey's biweight.

    The biweight's scale is the median absolute residual, but not below the finest.
    """
    if index < _ABSOLUTE_ROUNDS:
        absolute: Array = finest / np.maximum(np.abs(residual), finest)
        return absolute
    scale = max(1.4826 * float(np.median(np.abs(residual))), finest)
    weights: Array = np.clip(1 - (residual / (4.685 * scale)) ** 2, 0, None) ** 2
    return weights


def _direct_conic(points: Array, weights: Array) -> Array:
    """Return the conic (a b c d e f) with 4ac > b^2 and least weighted algebraic error."""
    x, y = points.T
    root: Array = np.sqrt(weights / np.sum(weights))[:, None]
    quadratic = np.column_stack([x * x, x * y, y * y]) * root
    linear = np.column_stack([x, y, np.ones_like(x)]) * root
    eliminate = -np.linalg.lstsq(linear, quadratic, rcond=None)[0]
    reduced = quadratic.T @ (quadratic + linear @ eliminate)
    constraint = np.array([[0.0, 0.0, 0.5], [0.0, -1.0, 0.0], [0.5, 0.0, 0.0]])
    values, complex_vectors = np.linalg.eig(constraint @ reduced)
    vectors = np.asarray(np.real(complex_vectors), np.float64)
    elliptic = 4 * vectors[0] * vectors[2] - vectors[1] ** 2 > 0
    if not elliptic.any():
        raise EstimateError("the outline points lie on no ellipse: check the sphere's outline")
    index = int(np.argmin(np.where(elliptic, np.abs(values), np.inf)))
    return np.concatenate([vectors[:, index], eliminate @ vectors[:, index]])


def _conic_to_ellipse(conic: Array) -> Ellipse:
    a, b, c, d, e, f = conic
    quadratic = np.array([[a, b / 2], [b / 2, c]])
    centre = np.linalg.solve(2 * quadratic, [-d, -e])
    level = -(f + 0.5 * (d * centre[0] + e * centre[1]))
    values, vectors = np.linalg.eigh(quadratic / level)
    if not np.all(values > 0):
        raise EstimateError("the outline points lie on no ellipse: check the sphere's outline")
    axes = 1 / np.sqrt(values)
    angle = float(np.degrees(np.arctan2(vectors[1, 0], vectors[0, 0])))
    return Ellipse(
        (float(centre[0]), float(centre[1])),
        (float(axes[0]), float(axes[1])),
        (angle + 90) % 180 - 90,
    )
