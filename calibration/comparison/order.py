"""The simplest explanation of two calibrations: order, mirror image, common motion."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial.transform import Rotation

from rig import short_repr
from rig.arrays import Float64, Intp

Mirror = Literal["", "x", "y"]

# A common motion is named if it leaves at most this share of the differences.
_EXPLAINS = 0.5
_MORE = 3
_ROUNDS = 4
_FEWEST_TO_REVERSE = 3
_SIDES = {"": (1, 1, 1), "x": (-1, 1, 1), "y": (1, -1, 1)}
# Orders and sides that are tried besides that of the files: reversed, mirrored in x, in y.
_OTHER_TRIALS = 3
MotionKind = Literal["none", "shift", "turn", "both"]
# Free parameters of each kind of motion.
PARAMETERS: dict[MotionKind, int] = {"none": 0, "shift": 3, "turn": 3, "both": 6}
# Degrees of freedom of the t distribution. With fewer, the most likely motion would be one that
# moves one of a few lights exactly to its place; with more, outliers would count too much.
_TAILS = 4
_FIT_ROUNDS = 100
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

    rotation: Float64
    shift_mm: Float64

    __repr__ = short_repr

    @property
    def angle_deg(self) -> float:
        """Angle of the rotation, 0..180."""
        return float(np.degrees(np.linalg.norm(Rotation.from_matrix(self.rotation).as_rotvec())))

    @property
    def axis(self) -> Float64:
        """``(3,)`` unit axis of the rotation; zero without a rotation."""
        turn = Rotation.from_matrix(self.rotation).as_rotvec()
        length = np.linalg.norm(turn)
        return np.asarray(turn / length if length > 0 else np.zeros(3))

    def apply(self, points: Float64) -> Float64:
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


def fit_motion(
    before: Float64, after: Float64, kind: MotionKind, *, freedom: int, floor: float
) -> Fit:
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


def robust_cost(square: Float64, scale: float, freedom: int) -> Float64:
    """Return what a squared distance adds to the cost at a known scale, 0 for 0."""
    return (_TAILS + freedom) * np.log1p(square / (_TAILS * scale**2))


def _settled(
    before: Float64, after: Float64, kind: MotionKind, motion: Motion, freedom: int, floor: float
) -> Fit:
    """Alternate between weights, scale and motion until the scale settles."""

    def squares() -> Float64:
        return np.asarray(np.sum((after - motion.apply(before)) ** 2, axis=1))

    square = squares()
    variance = max(floor**2, float(np.median(square)) / freedom)
    for _ in range(_FIT_ROUNDS):
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


def _kabsch(before: Float64, after: Float64, weights: Float64, kind: MotionKind) -> Motion:
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


@dataclass(frozen=True, eq=False)
class Explanation:
    """How the lights of B follow from those of A.

    Light n of B is at the place of light ``order[n]`` of A after mirroring and moving A. The
    cycles of ``order`` relative to the plain or reversed order are ``exchanged``, as indices.
    """

    order: Intp
    exchanged: tuple[tuple[int, ...], ...]
    is_reversed: bool
    mirror: Mirror
    kind: MotionKind
    motion: Motion
    cost: float

    def moved(self, before: Float64) -> Float64:
        """Return where the lights of B should be, in their order, for vectors ``(N, 3)`` of A."""
        return self.motion.apply(before * np.array(_SIDES[self.mirror]))[self.order]

    def carried(self, covariances: Float64) -> Float64:
        """Return the covariances ``(N, 3, 3)`` of the vectors that `moved` returns."""
        turn = self.motion.rotation * np.array(_SIDES[self.mirror])
        return np.asarray((turn @ covariances @ turn.T)[self.order])


def explain(before: Float64, after: Float64, *, freedom: int, floor: float) -> Explanation:
    """Return the explanation with the shortest description of the differences.

    The description has three parts: the differences that remain (minus twice the logarithm of
    their likelihood), the parameters of the motion (Schwarz, Estimating the dimension of a model,
    1978), and the choice of the order among all orders with as many exchanged lights. The plain
    order costs nothing, so that another one is named only if the data require it.

    Parameters
    ----------
    before, after
        ``(N, 3)`` positions in mm or unit directions.
    freedom
        Coordinates of a light: 3 for a position, 2 for a direction.
    floor
        Smallest standard deviation of a coordinate: smaller differences do not count.
    """
    still = fit_motion(before, after, "none", freedom=freedom, floor=floor)
    plain = np.arange(len(before))
    if np.all(np.linalg.norm(after - before, axis=1) <= floor):
        return Explanation(plain, (), False, "", "none", still.motion, still.cost)
    candidates: list[Explanation] = []
    for is_reversed, mirror in _trials(len(before)):
        flipped = before * np.array(_SIDES[mirror])
        chosen = 0.0 if not (is_reversed or mirror) else 2 * math.log(_OTHER_TRIALS)
        start = plain[:: -1 if is_reversed else 1]
        starts = [start]
        for kind in _kinds(len(before), freedom):
            tried = [_assigned(flipped, after, start, kind, freedom, floor, o) for o in starts]
            order, fit = min(tried, key=lambda one: one[1].cost + _moved_cost(one[0], start))
            if kind == "none" and not np.array_equal(order, start):
                starts.append(order)
            still = fit_motion(flipped[order], after, "none", freedom=freedom, floor=floor)
            if kind != "none" and fit.scale > _EXPLAINS * still.scale:
                continue
            exchanged = _cycles(order, start)
            if chosen and sum(map(len, exchanged)) > len(before) / 2:
                continue  # of symmetric lights, a mirror image would shorten any other order
            cost = fit.cost + chosen + _moved_cost(order, start)
            cost += PARAMETERS[kind] * math.log(freedom * len(before)) + _size(fit.motion)
            candidates.append(
                Explanation(order, exchanged, is_reversed, mirror, kind, fit.motion, cost)
            )
    return min(candidates, key=lambda one: one.cost)


def _size(motion: Motion) -> float:
    """Return the cost of a large motion: small ones are more frequent."""
    shift = float(np.linalg.norm(motion.shift_mm))
    return 2 * (math.log1p(motion.angle_deg) + math.log1p(shift))


def _trials(count: int) -> Iterator[tuple[bool, Mirror]]:
    yield False, ""
    if count >= _FEWEST_TO_REVERSE:
        yield True, ""
        yield False, "x"
        yield False, "y"


def _kinds(count: int, freedom: int) -> Iterator[MotionKind]:
    """Yield the motions that leave more numbers to contradict them than they have parameters."""
    yield "none"
    kinds: tuple[MotionKind, ...] = ("turn",) if freedom == 2 else ("shift", "turn", "both")
    for kind in kinds:
        if freedom * count >= 2 * PARAMETERS[kind] + _MORE:
            yield kind


def _moved_cost(order: Intp, plain: Intp) -> float:
    """Return the cost of choosing one of the orders with as many exchanged lights."""
    count, moved = len(order), int(np.count_nonzero(order != plain))
    return 2 * (math.lgamma(count + 1) - math.lgamma(count - moved + 1))


def _assigned(
    before: Float64,
    after: Float64,
    plain: Intp,
    kind: MotionKind,
    freedom: int,
    floor: float,
    start: Intp,
) -> tuple[Intp, Fit]:
    """Alternate between the motion and the order, as long as the description gets shorter."""
    order, fit = start, fit_motion(before[start], after, kind, freedom=freedom, floor=floor)
    least = fit.cost + _moved_cost(order, plain)
    for _ in range(_ROUNDS):
        _, best = linear_sum_assignment(_costs(before, after, fit, freedom))
        if np.array_equal(best, order):
            break
        tried = fit_motion(before[best], after, kind, freedom=freedom, floor=floor)
        kept = _required(_costs(before, after, tried, freedom), best, plain)
        if not np.array_equal(kept, best):
            best = kept
            tried = fit_motion(before[best], after, kind, freedom=freedom, floor=floor)
        cost = tried.cost + _moved_cost(best, plain)
        if cost >= least:
            break
        order, fit, least = best, tried, cost
    return order, fit


def _costs(before: Float64, after: Float64, fit: Fit, freedom: int) -> Float64:
    """Return the cost ``(N, N)`` of light n of B at the place of light m of A."""
    moved = fit.motion.apply(before)
    square = np.sum((after[:, None] - moved[None]) ** 2, axis=2)
    return robust_cost(square, fit.scale, freedom)


def _required(cost: Float64, order: Intp, plain: Intp) -> Intp:
    """Return ``plain`` with those cycles of ``order`` that shorten the description."""
    kept = plain.copy()
    for cycle in _cycles(order, plain):
        rows = np.array(cycle)
        gain = float(np.sum(cost[rows, plain[rows]] - cost[rows, order[rows]]))
        if gain > 2 * len(rows) * math.log(len(plain)):
            kept[rows] = order[rows]
    return kept


def _cycles(order: Intp, plain: Intp) -> tuple[tuple[int, ...], ...]:
    """Return the cycles of exchanged lights of ``order`` relative to ``plain``."""
    place = {int(light): n for n, light in enumerate(plain)}
    following = [place[int(light)] for light in order]
    seen: set[int] = set()
    found: list[tuple[int, ...]] = []
    for start in range(len(order)):
        cycle: list[int] = []
        now = start
        while now not in seen:
            seen.add(now)
            cycle.append(now)
            now = following[now]
        if len(cycle) > 1:
            found.append(tuple(cycle))
    return tuple(found)
