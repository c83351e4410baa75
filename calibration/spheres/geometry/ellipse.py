"""Robust fits of ellipses and circles to noisy outline points."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import cv2
import numpy as np
import numpy.typing as npt

from calibration._errors import EstimateError, or_none
from calibration.spheres.geometry.robust import FINEST_PX, ROUNDS, check_enough, tukey_weights
from rig import short_repr
from rig.arrays import Float64, Intp

# A smaller part of the circumference does not determine an ellipse, only a circle.
ELLIPSE_COVERAGE = 0.75
_TRIALS = 100
_SAMPLE = 8
# Neighbouring points agree alike: so many decide between trials.
_JUDGES = 400
_CONVERGED_PX = 1e-5
_NO_ELLIPSE = "the outline points do not fit an ellipse: check the outline of the sphere"


@dataclass(frozen=True)
class Ellipse:
    """An ellipse in the image.

    Parameters
    ----------
    centre_px
        (x, y) in pixels; (0, 0) is the centre of the first pixel.
    semi_axes_px
        Lengths of the semi-axes.
    angle_deg
        Angle from the image's x axis (right) to the first axis, positive toward y (down).
    """

    centre_px: tuple[float, float]
    semi_axes_px: tuple[float, float]
    angle_deg: float = 0.0

    __repr__ = short_repr

    @classmethod
    def circle(cls, x: float, y: float, radius: float) -> Ellipse:
        """Return a circle."""
        return cls((float(x), float(y)), (float(radius), float(radius)))

    @property
    def circle_px(self) -> tuple[float, float, float]:
        """Centre x, centre y, and radius of the circle of equal area."""
        return (*self.centre_px, self.radius_px)

    @property
    def radius_px(self) -> float:
        """Radius of the circle of equal area."""
        return float(np.sqrt(self.semi_axes_px[0] * self.semi_axes_px[1]))

    @property
    def is_circle(self) -> bool:
        """Whether both semi-axes are equal."""
        return self.semi_axes_px[0] == self.semi_axes_px[1]

    @property
    def matrix(self) -> Float64:
        """``(2, 2)`` symmetric matrix from the unit circle to the ellipse around its centre."""
        if self.is_circle:
            return np.array([[self.semi_axes_px[0], 0.0], [0.0, self.semi_axes_px[0]]])
        angle = np.radians(self.angle_deg)
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        return np.asarray(turn @ np.diag(self.semi_axes_px) @ turn.T)

    def moved(self, change: Float64) -> Ellipse:
        """Return the ellipse with changed centre x, centre y and radius, in pixels."""
        (x, y), (a, b) = self.centre_px, self.semi_axes_px
        scale = 1 + float(change[2]) / self.radius_px
        centre = (x + float(change[0]), y + float(change[1]))
        return Ellipse(centre, (a * scale, b * scale), self.angle_deg)

    def change_to(self, other: Ellipse) -> Float64:
        """Return the change to another ellipse in centre x, centre y and radius."""
        return np.subtract(other.circle_px, self.circle_px)

    def apart_px(self, other: Ellipse) -> float:
        """Return the distance of both centres."""
        return float(np.hypot(*np.subtract(other.centre_px, self.centre_px)))

    def scaled(self, by: float, start: Float64) -> Ellipse:
        """Return the ellipse after the pixels are multiplied by a factor, and then shifted."""
        (x, y), (a, b) = self.centre_px, self.semi_axes_px
        centre = (x * by + float(start[0]), y * by + float(start[1]))
        return replace(self, centre_px=centre, semi_axes_px=(a * by, b * by))

    def unit(self, pixels: npt.ArrayLike) -> Float64:
        """Return pixels ``(..., 2)`` in the frame in which the ellipse is the unit circle."""
        offset = np.asarray(pixels, np.float64) - self.centre_px
        return offset @ np.linalg.inv(self.matrix)  # symmetric: no transpose required

    def point(self, angle: npt.ArrayLike, scale: npt.ArrayLike = 1.0) -> Float64:
        """Return the pixels ``(..., 2)`` at these angles (radians) and multiples of the radius."""
        angle, scale = np.broadcast_arrays(np.asarray(angle), np.asarray(scale))
        circle = np.stack([np.cos(angle), np.sin(angle)], axis=-1) * scale[..., None]
        return np.asarray(circle @ self.matrix + self.centre_px)

    def distance_px(self, pixels: npt.ArrayLike) -> Float64:
        """Return the approximate distance of points ``(..., 2)`` outside (+) or inside (-).

        That from a circle is exact.
        """
        if self.is_circle:
            offset = np.asarray(pixels, np.float64) - self.centre_px
            return np.asarray(np.hypot(offset[..., 0], offset[..., 1]) - self.semi_axes_px[0])
        unit = self.unit(pixels)
        radius = np.linalg.norm(unit, axis=-1)
        # First order: deviation of |unit| from 1, divided by the length of its gradient.
        gradient = np.linalg.norm(unit @ np.linalg.inv(self.matrix), axis=-1)
        return np.asarray((radius - 1) * radius / np.maximum(gradient, 1e-12))


def fit_circle(points_px: Float64, start: Ellipse | None = None) -> tuple[Ellipse, Float64]:
    """Fit a circle to outline points with Tukey weights.

    Parameters
    ----------
    points_px
        ``(M, 2)`` points.
    start
        Start value. Default: the fit to a few points with which most others agree.

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

    Examples
    --------
    >>> import numpy as np
    >>> from calibration.spheres import fit_circle
    >>> turn = np.linspace(0, np.pi, 40)
    >>> points_px = np.stack([80 + 30 * np.cos(turn), 50 + 30 * np.sin(turn)], 1)
    >>> circle, weights = fit_circle(points_px)
    >>> round(circle.radius_px, 3)
    30.0
    """
    circle = start or _least_median_circle(points_px)
    weights = tukey_weights(circle.distance_px(points_px), FINEST_PX)
    equations = _CircleEquations(points_px)
    for _ in range(ROUNDS):
        check_enough(weights, 3, "a circle")
        last, circle = circle, equations.solved(weights)
        weights = tukey_weights(circle.distance_px(points_px), FINEST_PX)
        if np.abs(last.change_to(circle)).max() < _CONVERGED_PX:
            break
    return circle, weights


def fit_ellipse(points_px: Float64, start: Ellipse | None = None) -> tuple[Ellipse, Float64]:
    """Fit an ellipse to outline points with the reweighted direct fit of Halir and Flusser.

    The weights are Sampson weights (geometric distance to first order) times Tukey weights.

    Parameters
    ----------
    points_px
        ``(M, 2)`` points.
    start
        Start value. Default: the fit to a few points with which most others agree.

    Returns
    -------
    ellipse
        The ellipse.
    weights
        ``(M,)`` Tukey weights in 0..1.

    Raises
    ------
    EstimateError
        If fewer than 5 points remain or they do not form an ellipse.

    Examples
    --------
    >>> import numpy as np
    >>> from calibration.spheres import fit_ellipse
    >>> turn = np.linspace(0, 2 * np.pi, 60)
    >>> points_px = np.stack([80 + 30 * np.cos(turn), 50 + 20 * np.sin(turn)], 1)
    >>> ellipse, weights = fit_ellipse(points_px)
    >>> sorted(round(axis, 3) for axis in ellipse.semi_axes_px)
    [20.0, 30.0]
    """
    ellipse = start or _least_median_ellipse(points_px)
    weights = tukey_weights(ellipse.distance_px(points_px), FINEST_PX)
    for _ in range(ROUNDS):
        check_enough(weights, 5, "an ellipse")
        unit = ellipse.unit(points_px)
        # The algebraic distance is proportional to the gradient; Sampson's weight divides it out.
        gradient = np.linalg.norm(unit @ np.linalg.inv(ellipse.matrix), axis=1)
        ellipse = _plain_ellipse(points_px, weights / np.maximum(gradient, 1e-12) ** 2)
        weights = tukey_weights(ellipse.distance_px(points_px), FINEST_PX)
    return ellipse, weights


def _samples(points: Float64) -> tuple[Float64, Float64]:
    """Return samples ``(T, S, 2)`` of points, and points that judge the fits to them.

    Outliers often form a complete arc (a mount, a shadow), which a least-squares start would
    follow. The fit to a few points that has the least median distance from all points does not.
    """
    check_enough(np.ones(len(points)), _SAMPLE, "an outline")
    return points[_picks(len(points))], points[:: -(-len(points) // _JUDGES)]


@cache
def _picks(count: int) -> Intp:
    """Return the points of each sample, out of so many."""
    random = np.random.default_rng(0)
    return np.array([random.choice(count, _SAMPLE, replace=False) for _ in range(_TRIALS)])


def _least_median_circle(points: Float64) -> Ellipse:
    """Return the circle through a few points with the least median distance from all points."""
    samples, judges = _samples(points)
    origins = samples.mean(axis=1)
    offsets = samples - origins[:, None]
    # About the mean of a sample, the equations of a circle decouple: two rows remain.
    square = np.sum(offsets**2, axis=2)
    (xx, xy), (_, yy) = np.einsum("tsa,tsb->abt", offsets, offsets)
    x, y = 0.5 * np.einsum("tsa,ts->at", offsets, square)
    determinant = xx * yy - xy * xy
    with np.errstate(divide="ignore", invalid="ignore"):
        centres = np.stack([yy * x - xy * y, xx * y - xy * x]) / determinant
    radii = np.sqrt(square.mean(axis=1) + np.sum(centres**2, axis=0))
    centres += origins.T
    distances = np.hypot(*(judges.T[:, None] - centres[..., None])) - radii[:, None]
    medians = np.median(np.abs(distances), axis=1)
    best = int(np.argmin(np.where(np.isfinite(medians), medians, np.inf)))
    if not np.isfinite(medians[best]):
        raise EstimateError(_NO_ELLIPSE)
    x, y = centres[:, best]
    return Ellipse.circle(x, y, radii[best])


def _least_median_ellipse(points: Float64) -> Ellipse:
    """Return the ellipse through a few points with the least median distance from all points."""
    samples, judges = _samples(points)
    best: tuple[float, Ellipse] | None = None
    for sample in samples:
        trial = or_none(_plain_ellipse, sample, np.ones(_SAMPLE))
        if trial is None:
            continue
        median = float(np.median(np.abs(trial.distance_px(judges))))
        if best is None or median < best[0]:
            best = median, trial
    if best is None:
        raise EstimateError(_NO_ELLIPSE)
    return best[1]


class _CircleEquations:
    """Linear equations of a circle through points, for several weights of the points."""

    def __init__(self, points: Float64) -> None:
        self._origin = points.mean(axis=0)
        offset = points - self._origin
        # In units of the largest offset, the squares of the columns are alike.
        self._scale = max(float(np.abs(offset).max()), 1e-12)
        offset = offset / self._scale
        self._design = np.column_stack([2 * offset, np.ones(len(offset))])
        self._target = np.sum(offset**2, axis=1)

    def solved(self, weights: Float64) -> Ellipse:
        """Return the circle of the weighted linear least squares."""
        weighted = self._design.T * weights
        normal = np.column_stack([weighted @ self._design, weighted @ self._target])
        # For so few equations, OpenCV is faster than NumPy.
        x, y, c = cv2.solve(normal[:, :3], normal[:, 3:], flags=cv2.DECOMP_SVD)[1][:, 0]
        radius = self._scale * float(np.sqrt(max(c + x * x + y * y, 1e-24)))
        x, y = self._origin + self._scale * np.array([x, y])
        return Ellipse.circle(x, y, radius)


def _plain_ellipse(points: Float64, weights: Float64) -> Ellipse:
    """Fit an ellipse by weighted direct least squares."""
    # Centre and scale the points: otherwise the conic's columns differ by orders of magnitude.
    origin = points.mean(axis=0)
    scale = max(float(np.abs(points - origin).max()), 1e-12)
    conic = _direct_conic((points - origin) / scale, weights)
    return _conic_to_ellipse(conic).scaled(scale, origin)


def _direct_conic(points: Float64, weights: Float64) -> Float64:
    """Return the conic (a b c d e f) with 4ac > b^2 and least weighted algebraic error."""
    x, y = points.T
    root: Float64 = np.sqrt(weights / np.sum(weights))[:, None]
    quadratic = np.column_stack([x * x, x * y, y * y]) * root
    linear = np.column_stack([x, y, np.ones_like(x)]) * root
    eliminate = -np.linalg.lstsq(linear, quadratic, rcond=None)[0]
    reduced = quadratic.T @ (quadratic + linear @ eliminate)
    constraint = np.array([[0.0, 0.0, 0.5], [0.0, -1.0, 0.0], [0.5, 0.0, 0.0]])
    values, complex_vectors = np.linalg.eig(constraint @ reduced)
    vectors = np.asarray(np.real(complex_vectors), np.float64)
    elliptic = 4 * vectors[0] * vectors[2] - vectors[1] ** 2 > 0
    if not elliptic.any():
        raise EstimateError(_NO_ELLIPSE)
    index = int(np.argmin(np.where(elliptic, np.abs(values), np.inf)))
    return np.concatenate([vectors[:, index], eliminate @ vectors[:, index]])


def _conic_to_ellipse(conic: Float64) -> Ellipse:
    a, b, c, d, e, f = conic
    quadratic = np.array([[a, b / 2], [b / 2, c]])
    if not abs(np.linalg.det(quadratic)) > 1e-12:
        raise EstimateError(_NO_ELLIPSE)
    centre = np.linalg.solve(2 * quadratic, [-d, -e])
    level = -(f + 0.5 * (d * centre[0] + e * centre[1]))
    values, vectors = np.linalg.eigh(quadratic * level)
    if not np.all(values > 0):
        raise EstimateError(_NO_ELLIPSE)
    axes = abs(level) / np.sqrt(values)
    angle = float(np.degrees(np.arctan2(vectors[1, 0], vectors[0, 0])))
    return Ellipse(
        (float(centre[0]), float(centre[1])),
        (float(axes[0]), float(axes[1])),
        (angle + 90) % 180 - 90,
    )
