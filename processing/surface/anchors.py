"""Surfaces that are held at known heights."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from acquisition import DataError
from processing.surface.drift import Drift
from processing.surface.grid_graph import apply_laplacian
from processing.surface.multigrid import Solution, diagonal_of, solve
from processing.surface.multigrid_kernels import add_anchors
from processing.surface.prior import HeightPrior
from processing.surface.prior_outliers import prior_outliers
from processing.surface.scale import Scale
from rig import Notice, figure, pluralize
from rig.arrays import Bool, Float32, Float64, Int32

# Heights that are known in fewer pixels do not show in which unit they are; few only if they are
# alike to this correlation, which 4 unrelated heights are once in 200 times.
_FEWEST = 4
_FEW = 10
_ALIKE = 0.8
_ALIKE_IF_FEW = 0.99
# A unit is doubtful if heights and surface are alike, but their ranges differ by this factor.
_OTHER_UNIT = 2.0
# The surface misses a known height by more than this many standard deviations.
_MISSED = 4.0
_NAMED = 5
# Largest weight of a pixel relative to that of a typical edge: the height is then fixed.
_FIXED = 1e5


@dataclass(frozen=True, eq=False)
class Anchors:
    """Known heights in the unit of the solver.

    Parameters
    ----------
    weights
        ``(H+2, W+2)`` float32, relative to those of edges; 0 where the height is not known.
    target
        ``(H+2, W+2)`` heights in the unit of the steps, 0 where they are not known.
    variance
        Variance of the step along a typical edge, which a weight of 1 means.
    """

    weights: Float32
    target: Float64
    variance: float = 1.0

    @property
    def spread(self) -> Float64:
        """``(H+2, W+2)`` standard deviations of the heights, infinite where they are not known."""
        with np.errstate(divide="ignore"):
            return np.asarray(np.sqrt(self.variance / self.weights.astype(np.float64)), np.float64)

    def misfit(self, u: Float64) -> float:
        """Return the sum of squares of the differences from a surface, in standard deviations."""
        return float((self.weights * np.square(self.target - u)).sum() / self.variance)

    @property
    def load(self) -> Float64:
        """What they add to the right-hand side."""
        return self.weights * self.target

    def moved(self, u: Float64, parts: Int32) -> Float64:
        """Return a surface that is moved to the mean of the heights in each part with any."""
        inside = parts >= 0
        members, weights = parts[inside], self.weights[inside].astype(np.float64)
        sums = np.bincount(members, weights * (self.target - u)[inside])
        totals = np.bincount(members, weights)
        found = u.copy()
        found[inside] += np.divide(sums, totals, out=np.zeros_like(sums), where=totals > 0)[members]
        return found

    def add(self, u: Float64, product: Float64) -> None:
        """Add what they add to the product of the Laplacian and ``u``."""
        add_anchors(self.weights, u, product)


def anchors(
    prior: HeightPrior,
    labels: Int32,
    window: tuple[slice, slice],
    variance: float,
    scale: Scale,
) -> Anchors:
    """Convert a prior to the unit of the solver.

    Parameters
    ----------
    prior
        The known heights.
    labels
        ``(h+2, w+2)`` parts of the window, -1 for a pixel without edges.
    window
        Where the window is.
    variance
        Variance of the step along a typical edge, in px^2.
    scale
        Scale of the surface.

    Raises
    ------
    DataError
        If no known height is on the surface, or one is behind the camera.
    """
    size = labels.shape
    height, sigma = np.full(size, np.nan), np.full(size, np.nan)
    height[1:-1, 1:-1] = prior.height[window]
    sigma[1:-1, 1:-1] = prior.sigma[window]
    known = np.isfinite(height) & (labels >= 0)
    if not known.any():
        raise DataError(
            f"none of the {prior.count} known heights is inside the mask: check positions, mask "
            "and crop"
        )
    weights, target = np.zeros(size, np.float32), np.zeros(size)
    spread = sigma[known] / scale.pixel_size
    if scale.distance is None:
        target[known] = height[known] / scale.pixel_size
    else:
        depth = scale.distance - height[known]
        if not depth.min() > 0:
            raise DataError(
                f"a known height of {height[known].max():.4g} is behind the camera, which is "
                f"{scale.distance:.4g} above the working plane: check its unit"
            )
        target[known] = np.log(depth)
        spread *= scale.distance / depth
    weights[known] = np.minimum(variance / np.square(spread), _FIXED)
    return Anchors(weights, target, variance)


def anchored(
    weights: tuple[Float32, Float32], first: Solution, parts: Int32, pieces: Int32, held: Anchors
) -> tuple[Solution, Float64, Anchors, tuple[Drift, Float64] | None]:
    """Return a surface that is held at known heights.

    The surface is moved to them, part by part; if they show that it drifts, it is tilted and bent.
    The change that remains is small and smooth.

    Parameters
    ----------
    weights
        ``(H+2, W+2)`` weights of the edges to the right and down.
    first
        The surface without known heights.
    parts, pieces
        ``(H+2, W+2)`` part of each pixel, and piece between jumps; -1 for a pixel without edges.
    held
        The known heights. Isolated gross errors in a piece are left out, see `prior_outliers`.

    Returns
    -------
    Solution
        The surface.
    free
        ``(H+2, W+2)`` surface without them, moved to their mean in each part that has any.
    held
        The known heights that were used.
    drift
        How the surface drifts from them, and the drift ``(H+2, W+2)``; None if it does not.
    """
    off = np.where(held.weights > 0, held.target - first.u, np.nan)
    outliers = prior_outliers(off, held.spread, pieces)
    held = replace(held, weights=np.where(outliers, np.float32(0), held.weights))
    off[outliers] = np.nan
    free = held.moved(first.u, parts)
    # Heights of another unit or sign are no evidence of a drift.
    drift = None if _doubtful(held, free) else Drift.found(off, held.weights, pieces)
    u = free
    if drift is not None:
        bend = drift.of(off)
        u = held.moved(first.u + bend, parts)
    # The residual of the change is not dominated by fixed heights.
    fixed = held.weights > 0
    left = held.weights * (held.target - u)
    start = np.zeros_like(u)
    start[fixed] = left[fixed] / diagonal_of(*weights, held.weights)[fixed]
    product = np.zeros_like(u)
    apply_laplacian(*weights, start, product)
    held.add(start, product)
    change = solve(*weights, left - product, anchors=held.weights)
    return (
        Solution(
            u + start + change.u,
            first.iterations + change.iterations,
            max(first.relative_residual, change.relative_residual),
            converged=first.converged and change.converged,
        ),
        free,
        held,
        None if drift is None else (drift, bend),
    )


def doubts_of_prior(
    prior: HeightPrior, height: Float32, unit: str, held: Anchors, used: Bool, free: Float64
) -> list[Notice]:
    """Return notices about known heights that do not belong to the surface.

    Parameters
    ----------
    prior, held
        The known heights.
    height, unit
        ``(H, W)`` heights of the surface, NaN outside.
    used
        ``(H, W)`` bool, the known heights that were used.
    free
        ``(H+2, W+2)`` solution without them.
    """
    notices = []
    known, mask = prior.known, np.isfinite(height)
    off = prior.height - height
    left_out = known & mask & ~used
    if left_out.any():
        count = int(np.count_nonzero(left_out))
        text = (
            f"{pluralize(count, 'height')} of the prior, of {prior.count}, "
            f"{'is' if count == 1 else 'are'} left out, because the others and the normals "
            f"contradict {'it' if count == 1 else 'them'}: {_named(off, left_out, unit)}"
        )
        notices.append(Notice("prior-outliers", text))
    outside = prior.outside + int(np.count_nonzero(known & ~mask))
    if outside:
        text = (
            f"{pluralize(outside, 'height')} of the prior, of {prior.count + prior.outside}, "
            f"{'is' if outside == 1 else 'are'} outside the mask and not used"
        )
        notices.append(Notice("prior-outside", text, "", "info"))
    doubts = _doubtful(held, free)
    missed = used & mask & (np.abs(off) > _MISSED * prior.sigma)
    count = int(np.count_nonzero(missed))
    # Of normal errors, fewer than one in ten thousand is as large.
    if not doubts and count > np.count_nonzero(used) / 1000:
        text = (
            f"the surface misses {pluralize(count, 'height')} of the prior, of {prior.count}, by "
            f"more than {_MISSED:g} standard deviations: {_named(off, missed, unit)}"
        )
        doubts.append(Notice("prior-missed", text, "", "info"))
    return [*notices, *doubts]


def drift_notice(drift: Float64, labels: Int32, scale: Scale) -> Notice:
    """Return the notice about a drift ``(H+2, W+2)`` that was removed from the surface."""
    inside = labels >= 0
    size = scale.pixel_size if scale.distance is None else scale.distance
    along = np.diff(drift, axis=1)[inside[:, 1:] & inside[:, :-1]]
    down = np.diff(drift, axis=0)[inside[1:] & inside[:-1]]
    slope = scale.step_px * np.sqrt(np.mean(along**2) + np.mean(down**2))
    text = (
        f"the known heights show that the surface drifts by up to "
        f"{figure(size * np.ptp(drift[inside]), 3)} {scale.unit}, as if all normals were turned by "
        f"{figure(np.degrees(np.arctan(slope)))} deg: this was removed"
    )
    return Notice("prior-drift", text, severity="info")


def _doubtful(held: Anchors, free: Float64) -> list[Notice]:
    """Return a notice if the heights have another sign or unit than the normals."""
    holds = held.weights > 0
    wanted, found = held.target[holds], free[holds]
    ranges = wanted.std(), found.std()
    if len(wanted) < _FEWEST or min(ranges) == 0:
        return []
    least = _ALIKE_IF_FEW if len(wanted) < _FEW else _ALIKE
    alike = float(np.corrcoef(wanted, found)[0, 1])
    factor = float(ranges[0] / ranges[1])
    if alike < -least:
        text = (
            "the heights of the prior fall where the normals rise: heights grow toward the camera; "
            "are these depths?"
        )
        return [Notice("prior-doubtful", text)]
    if alike > least and not 1 / _OTHER_UNIT < factor < _OTHER_UNIT:
        text = (
            f"the differences in height of the prior are {factor:.3g} times those of the normals: "
            "check the units of the prior and the size of a pixel"
        )
        return [Notice("prior-doubtful", text)]
    return []


def _named(off: Float32, chosen: Bool, unit: str) -> str:
    """Return the places and errors of the chosen heights, the largest first."""
    rows, columns = np.nonzero(chosen)
    order = np.argsort(-np.abs(off[chosen]), kind="stable")[:_NAMED]
    by = (figure(off[rows[i], columns[i]], 3) for i in order)
    places = [f"{columns[i]},{rows[i]} by {text} {unit}" for i, text in zip(order, by, strict=True)]
    more = len(rows) - len(places)
    return f"column,row {'; '.join(places)}{f'; and {more} more' if more else ''}"
