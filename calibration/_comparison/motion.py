"""The rotation and shift that all lights have in common, estimated robustly."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from rig import short_repr

Array = npt.NDArray[np.float64]
MotionKind = Literal["none", "shift", "turn", "both"]

# Free parameters of each kind of motion.
PARAMETERS: dict[MotionKind, int] = {"none": 0, "shift": 3, "turn": 3, "both": 6}
# Degrees of freedom of the t distribution. With fewer, the most likely motion would be one that
# moves one of a few lights exactly to its place; with more, outliers would count too much.
_TAILS = 4
_ROUNDS = 100
_SETTLED = 1e-4


@dataclass(frozen=True, eq=False)
class Motion:
    """A rotation about the origin of the house frame, and then a shift.

    Parameters
    ----------
    rotation
        ``(3, 3)`` rotation matrix.
    shift_mm
        ``(3,)`` shift in mm; zero for directions.
    """

    rotation: Array
    shift_mm: Array

    __repr__ = short_repr

    @property
    def angle_deg(self) -> float:
        """Angle of the rotation, 0..180."""
        return float(np.degrees(np.linalg.norm(Rotation.from_matrix(self.rotation).as_rotvec())))

    @property
    def axis(self) -> Array:
        """``(3,)`` unit axis of the rotation; zero without a rotation."""
        turn = Rotation.from_matrix(self.rotation).as_rotvec()
        length = np.linalg.norm(turn)
        return np.asarray(turn / length if length > 0 else np.zeros(3))

    def apply(self, points: Array) -> Array:
        """Return points ``(N, 3)`` after the motion."""
        return points @ self.rotation.T + self.shift_mm


STILL = Motion(np.eye(3), np.zeros(3))


@dataclass(frozen=True, eq=False)
class Fit:
    """A motion, and how well it explains the differences.

    ``scale`` is the robust standard deviation per coordinate, and ``cost`` is minus twice the
    logarithm of the likelihood, without constants.
    """

    motion: Motion
    scale: float
    cost: float


def fit_motion(before: Array, after: Array, kind: MotionKind, *, freedom: int, floor: float) -> Fit:
    """Fit a motion to N pairs of points, few of which may be outliers.

    Differences follow a multivariate t distribution, whose likelihood is maximised by iteratively
    reweighted least squares (Lange, Little and Taylor, Robust statistical modeling using the t
    distribution, 1989), each step by the method of Kabsch (1976).

    Parameters
    ----------
    before, after
        ``(N, 3)`` positions in mm or unit directions.
    kind
        Which motion.
    freedom
        Coordinates of a light: 3 for a position, 2 for a direction.
    floor
        Smallest scale: smaller differences do not count.
    """
    if kind == "none":
        return _settled(before, after, kind, STILL, freedom, floor)
    starts = (STILL, _kabsch(before, after, np.ones(len(before)), kind))
    fits = [_settled(before, after, kind, start, freedom, floor) for start in starts]
    return min(fits, key=lambda fit: fit.cost)


def robust_cost(square: Array, scale: float, freedom: int) -> Array:
    """Return what a squared distance adds to the cost at a known scale, 0 for 0."""
    return (_TAILS + freedom) * np.log1p(square / (_TAILS * scale**2))


def _settled(
    before: Array, after: Array, kind: MotionKind, motion: Motion, freedom: int, floor: float
) -> Fit:
    """Alternate between weights, scale and motion until the scale settles."""

    def squares() -> Array:
        square: Array = np.sum((after - motion.apply(before)) ** 2, axis=1)
        return square

    square = squares()
    variance = max(floor**2, float(np.median(square)) / freedom)
    for _ in range(_ROUNDS):
        weights = (_TAILS + freedom) / (_TAILS + square / variance)
        if kind != "none":
            motion = _kabsch(before, after, weights, kind)
            square = squares()
        new = max(floor**2, float(np.mean(weights * square)) / freedom)
        settled = abs(new - variance) <= _SETTLED * variance
        variance = new
        if settled:
            break
    scale = float(np.sqrt(variance))
    cost = float(np.sum(robust_cost(square, scale, freedom)))
    cost += freedom * len(before) * float(np.log(variance))
    return Fit(motion, scale, cost)


def _kabsch(before: Array, after: Array, weights: Array, kind: MotionKind) -> Motion:
    """Return the motion of this kind with the least weighted sum of squared distances."""
    first = second = np.zeros(3)
    if kind != "turn":
        first, second = (np.average(points, axis=0, weights=weights) for points in (before, after))
    if kind == "shift":
        return Motion(np.eye(3), second - first)
    u, _, vt = np.linalg.svd((weights[:, None] * (before - first)).T @ (after - second))
    mirror = np.diag([1.0, 1.0, np.sign(np.linalg.det(vt.T @ u.T))])
    rotation = vt.T @ mirror @ u.T
    return Motion(rotation, second - rotation @ first)
