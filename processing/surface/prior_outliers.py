"""Known heights that the other known heights and the normals contradict."""

from __future__ import annotations

from typing import Final

import numpy as np

from rig.arrays import Bool, Float64, Int32, Int64

# A surface drifts smoothly from known heights; these terms of a polynomial follow it. Each requires
# three points.
_POINTS_PER_TERM: Final = 3
# With fewer points, a majority says little.
_FEWEST: Final = 4
# Gross errors are this many standard deviations of the point, and of the median of the others: of 4
# and more points with normal errors, about one in a thousand sets has such a point.
_DEVIATIONS: Final = 5.0
_GROSS: Final = 10.0
_ROUNDS: Final = 30
# Dense maps of heights have errors in areas, not at single points.
_MOST: Final = 100_000


def prior_outliers(off: Float64, spread: Float64, labels: Int32) -> Bool:
    """Return known heights that are isolated gross errors.

    The others show how the surface without known heights drifts. A point far from it is an outlier
    unless the known height nearest to it is, too: then the surface has a step there.

    Parameters
    ----------
    off
        ``(H, W)`` known height minus that of the surface without known heights, NaN elsewhere.
    spread
        ``(H, W)`` its standard deviation.
    labels
        ``(H, W)`` part of each pixel; heights of different parts have no relation.
    """
    found = np.zeros(off.shape, np.bool_)
    rows, columns = np.nonzero(np.isfinite(off))
    if not _FEWEST <= len(rows) <= _MOST:
        return found
    parts = labels[rows, columns]
    for part in np.unique(parts):
        chosen = parts == part
        if np.count_nonzero(chosen) < _FEWEST:
            continue
        places = np.stack([columns[chosen], rows[chosen]], 1)
        at = places[:, 1], places[:, 0]
        far = _far(places, off[at], spread[at])
        if far.any():
            # Imported here: it takes 0.2 s, and few surfaces have a prior.
            from scipy.spatial import KDTree

            nearest = np.asarray(KDTree(places).query(places[far], 2)[1])
            far[far] = ~far[nearest[:, 1]]
        found[at] = far
    return found


def _far(places: Int64, off: Float64, spread: Float64) -> Bool:
    x, y = ((places - places.mean(0)) / max(np.ptp(places), 1)).T
    terms = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], 1)
    count = next(n for n in (6, 3, 1) if n == 1 or len(off) >= _POINTS_PER_TERM * n)
    terms = terms[:, :count]
    # The least sum of absolute differences: outliers hardly change it.
    weights = np.ones(len(off))
    for _ in range(_ROUNDS):
        scaled = terms * weights[:, None]
        left = np.abs(off - terms @ np.linalg.lstsq(scaled, off * weights, rcond=None)[0])
        weights = 1 / np.sqrt(np.maximum(left, 1e-6 * max(left.max(), 1e-30)))
    # It passes through as many points as it has terms.
    usual = 1.4826 * np.median(np.sort(left)[count:])
    return np.asarray(left > np.maximum(_DEVIATIONS * spread, _GROSS * usual))
