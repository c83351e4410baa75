"""First hits of rays on a height field, including fields that are steep and hide themselves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from acquisition import DataError
from rig.arrays import Float64, Intp

Evaluate = Callable[[Float64, Float64], tuple[Float64, Float64, Float64]]

# If the field rises by less than this share of the ray's descent, the ray crosses it only once.
_MONOTONE = 0.9
_NEWTON_ROUNDS = 12
_NEWTON_ENOUGH_MM = 1e-8  # from there, one step is exact to rounding
# Shortest stride of the march, as a share of the ray's path from top to bottom of the field. A
# grazing hit between two strides is missed only if it is shallower than curvature * stride^2 / 8.
_STRIDE = 1e-3
_CLOSING_ROUNDS = 90


@dataclass(frozen=True)
class FieldBounds:
    """Bounds of a height field: lowest and highest point, and steepest gradient."""

    bottom_mm: float
    top_mm: float
    steepest: float


def meet_field(
    evaluate: Evaluate,
    radius_mm: float,
    bounds: FieldBounds,
    origins: Float64,
    directions: Float64,
    *,
    square: bool = False,
) -> tuple[Float64, Float64, Float64]:
    """Find the first hits of rays on ``z = height(x, y)`` within an outline.

    Rays that descend faster than the field can rise hit it once and are solved by Newton's method.
    All other rays advance from the top of the field in strides that cannot cross the field, as the
    steepest gradient guarantees; the hit is then bracketed. A ray that enters below the field has
    passed its wall and hits nothing.

    Parameters
    ----------
    evaluate
        Function that returns height and gradient at positions x and y of one shape, also outside
        the outline.
    radius_mm
        Radius of the circle around the origin.
    bounds
        Bounds of the field within the outline; wide bounds cost time, narrow bounds lose hits.
    origins, directions
        ``(n, 3)`` rays.
    square
        If True, the outline is not the circle but the square in it, with sides along x and y.

    Returns
    -------
    t, slope_x, slope_y
        ``(n,)``: the hit is ``origin + t * direction``; t is inf if there is no hit.

    Raises
    ------
    DataError
        If the bounds are not finite: rays cannot advance over a field with vertical parts.
    """
    if not np.isfinite([bounds.bottom_mm, bounds.top_mm, bounds.steepest]).all():
        raise DataError("a height field without finite bounds cannot be traced")
    rays = _Rays(evaluate, origins, directions)
    start, stop = _reach(radius_mm, square, bounds, origins, directions)
    t, zx, zy = (np.full(len(origins), fill) for fill in (np.inf, 0.0, 0.0))
    across = np.hypot(directions[:, 0], directions[:, 1])
    open_ = (start <= stop) & (stop < np.inf)
    monotone = open_ & (bounds.steepest * across < -_MONOTONE * directions[:, 2])
    todo = np.flatnonzero(monotone)
    left = _newton(rays, todo, 0.5 * (start[todo] + stop[todo]), (t, zx, zy))
    lost = (t < start) | (t > stop)
    t[lost & monotone] = np.inf
    todo = np.concatenate([np.flatnonzero(open_ & ~monotone), left])
    if todo.size:
        rate = bounds.steepest * across - directions[:, 2]
        _march(rays, todo, start, stop, np.maximum(rate, 1e-12), (t, zx, zy))
    return t, zx, zy


class _Rays:
    """Rays and the field under them."""

    def __init__(self, evaluate: Evaluate, origins: Float64, directions: Float64) -> None:
        self._evaluate, self._origins, self._directions = evaluate, origins, directions

    def gap(self, which: Intp, t: Float64) -> tuple[Float64, Float64, Float64, Float64]:
        """Return height above the field, its change with t, and the field's gradient."""
        ox, oy, oz = self._origins[which].T
        dx, dy, dz = self._directions[which].T
        z, zx, zy = self._evaluate(ox + t * dx, oy + t * dy)
        return oz + t * dz - z, dz - zx * dx - zy * dy, zx, zy


Out = tuple[Float64, Float64, Float64]


def _reach(
    radius: float, square: bool, bounds: FieldBounds, origins: Float64, directions: Float64
) -> tuple[Float64, Float64]:
    """Return t at which rays enter and leave the space inside the outline from bottom to top."""
    start, stop = _slab(origins[:, 2], directions[:, 2], bounds.bottom_mm, bounds.top_mm)
    if square:
        half = radius / np.sqrt(2)
        sides = [_slab(origins[:, axis], directions[:, axis], -half, half) for axis in (0, 1)]
    else:
        sides = [_circle(radius, origins[:, :2], directions[:, :2])]
    for enter, leave in sides:
        start, stop = np.maximum(start, enter), np.minimum(stop, leave)
    return np.maximum(start, 0.0), stop


def _slab(origin: Float64, way: Float64, low: float, high: float) -> tuple[Float64, Float64]:
    """Return t at which rays enter and leave a slab, which is widened by rounding errors."""
    slack = 1e-9 * (1 + high - low)
    moves = way != 0
    safe = np.where(moves, way, 1.0)
    a, b = (low - slack - origin) / safe, (high + slack - origin) / safe
    within = (origin >= low - slack) & (origin <= high + slack)
    enter = np.where(moves, np.minimum(a, b), np.where(within, -np.inf, np.inf))
    return enter, np.where(moves, np.maximum(a, b), np.inf)


def _circle(radius: float, origin: Float64, way: Float64) -> tuple[Float64, Float64]:
    """Return t at which rays enter and leave a vertical cylinder, widened by rounding errors."""
    square = (radius * (1 + 1e-9)) ** 2
    a, b = (way**2).sum(axis=1), (origin * way).sum(axis=1)
    c = (origin**2).sum(axis=1) - square
    moves = a > 0
    root = b * b - a * c
    safe, half = np.where(moves, a, 1.0), np.sqrt(np.clip(root, 0.0, None))
    meets = np.where(moves, root >= 0, c <= 0)
    enter = np.where(meets, np.where(moves, (-b - half) / safe, -np.inf), np.inf)
    return enter, np.where(moves, (-b + half) / safe, np.inf)


def _newton(rays: _Rays, todo: Intp, now: Float64, out: Out) -> Intp:
    """Solve rays that hit the field once; return those that did not converge."""
    for _ in range(_NEWTON_ROUNDS):
        if not todo.size:
            break
        gap, slope, zx, zy = rays.gap(todo, now)
        now = now - gap / slope
        done = np.abs(gap) < _NEWTON_ENOUGH_MM
        for target, value in zip(out, (now, zx, zy), strict=True):
            target[todo[done]] = value[done]
        todo, now = todo[~done], now[~done]
    return todo


def _march(rays: _Rays, todo: Intp, start: Float64, stop: Float64, rate: Float64, out: Out) -> None:
    """Advance along each ray to its first crossing, then refine it."""
    stride = _STRIDE * (stop - start)
    gap = rays.gap(todo, start[todo])[0]
    # Rays that start below the field have passed its wall.
    todo, gap = todo[gap >= 0], gap[gap >= 0]
    now = start[todo]
    while todo.size:
        last = now
        now = np.minimum(now + np.maximum(gap / rate[todo], stride[todo]), stop[todo])
        gap = rays.gap(todo, now)[0]
        below = gap < 0
        if below.any():
            _close_in(rays, todo[below], last[below], now[below], out)
        keep = ~below & (now < stop[todo])
        todo, now, gap = todo[keep], now[keep], gap[keep]


def _close_in(rays: _Rays, todo: Intp, above: Float64, below: Float64, out: Out) -> None:
    """Narrow brackets by Newton steps that stay inside, otherwise and every third time by half."""
    now = below
    for turn in range(_CLOSING_ROUNDS):
        gap, slope, zx, zy = rays.gap(todo, now)
        above, below = np.where(gap >= 0, now, above), np.where(gap < 0, now, below)
        level = slope == 0
        newton = now - np.where(level, np.inf, gap) / np.where(level, 1.0, slope)
        inside = (newton >= above) & (newton <= below)
        done = inside & (np.abs(gap) < _NEWTON_ENOUGH_MM)
        done |= (below - above <= 4e-16 * below) | (turn == _CLOSING_ROUNDS - 1)
        best = np.where(inside, newton, now)
        for target, value in zip(out, (best, zx, zy), strict=True):
            target[todo[done]] = value[done]
        todo, above, below = todo[~done], above[~done], below[~done]
        if not todo.size:
            return
        halve = ~inside | (turn % 3 == 2)
        now = np.where(halve[~done], 0.5 * (above + below), newton[~done])
