"""Weights of edges from the standard deviations of normals."""

from __future__ import annotations

import numpy as np

from acquisition import DataError, MapRows
from acquisition.files import ComputedRows, rows_in_bands
from rig.arrays import Bool, Float32

# Of normals whose deviations are not known, relative to a prior.
ASSUMED_SIGMA_DEG = 1.0
# Smaller deviations, relative to the median, count as this: the model has errors too.
LEAST_SIGMA = 0.1
_BAND = 256  # rows


def variances(
    sigma_deg: MapRows | None, mask: Bool, *, most: int | None = None
) -> tuple[MapRows | None, float]:
    """Return the variances of normals relative to their median, and the median.

    Parameters
    ----------
    sigma_deg
        ``(H, W)`` root mean square angle to the true normal, both tangent directions together. A
        normal whose deviation is NaN counts as the least certain one.
    mask
        ``(H, W)`` bool, the pixels with a normal.
    most
        About how many pixels the median is computed from, in some rows of the map; default: all.

    Returns
    -------
    relative
        ``(H, W)`` float32 whose rows are computed when they are read, 1 outside the mask; None if
        no deviation is known.
    median
        Variance in each tangent direction in rad^2; if no deviation is known, that of 1 degree.

    Raises
    ------
    DataError
        If the shapes differ, or a deviation is negative or infinite.
    """
    unknown = None, np.radians(ASSUMED_SIGMA_DEG) ** 2 / 2
    if sigma_deg is None:
        return unknown
    if sigma_deg.shape != mask.shape:
        raise DataError(
            f"deviations of shape {sigma_deg.shape} do not fit normals of shape {mask.shape}"
        )
    every = 1 if most is None else max(1, mask.size // most)
    largest, sample = 0.0, [np.zeros(0, np.float32)]
    for rows in rows_in_bands(len(mask), 1, _BAND):
        band, inside = sigma_deg[rows], mask[rows]
        values = band[inside]
        if (values < 0).any() or np.isinf(values).any():
            raise DataError("standard deviations of normals are negative or infinite: give degrees")
        largest = max(largest, float(np.nanmax(values, initial=0)))
        some = slice(-rows.start % every, None, every)
        sample.append(band[some][inside[some]])
    together = np.concatenate(sample)
    middle = float(np.nanmedian(together)) if np.isfinite(together).any() else 0.0
    if middle == 0:
        return unknown

    def relative(rows: slice) -> Float32:
        values = np.nan_to_num(sigma_deg[rows], nan=largest)
        found = np.square(np.maximum(values, LEAST_SIGMA * middle) / middle)
        return np.where(mask[rows], found, np.float32(1)).astype(np.float32)

    return ComputedRows(mask.shape, np.dtype(np.float32), relative), np.radians(middle) ** 2 / 2


def certainties(relative: Float32) -> tuple[Float32, Float32]:
    """Return the reciprocal of the root mean square deviation of both normals of each edge.

    Reciprocal variances are best for independent errors, equal weights for errors that neighbours
    have in common, such as those of a reflectance model. Deviations say nothing of the shares.

    Parameters
    ----------
    relative
        ``(H, W)`` float32 variances.

    Returns
    -------
    right, down
        ``(H+2, W+2)`` float32 factors for weights of edges, 1 at the border.
    """
    right, down = np.ones((2, relative.shape[0] + 2, relative.shape[1] + 2), np.float32)
    right[1:-1, 1:-2] = np.sqrt(2 / (relative[:, :-1] + relative[:, 1:]))
    down[1:-2, 1:-1] = np.sqrt(2 / (relative[:-1] + relative[1:]))
    return right, down
