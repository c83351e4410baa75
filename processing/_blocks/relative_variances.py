"""Variances of normals relative to their median, in rows."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from acquisition import ComputedRows, DataError, MapRows
from processing._surface.certainty import LEAST_SIGMA

Float = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]

# The median is that of some rows with about this number of pixels.
_SAMPLE = 4_000_000
_BAND = 256  # rows


def relative_variances(sigma_deg: MapRows, mask: Mask) -> MapRows | None:
    """Return the variances of normals relative to their median.

    Parameters
    ----------
    sigma_deg
        ``(H, W)`` root mean square angle to the true normal. A normal whose deviation is NaN counts
        as the least certain one.
    mask
        ``(H, W)`` bool, the pixels with a normal.

    Returns
    -------
    MapRows
        ``(H, W)`` float32, 1 outside the mask; None if no deviation is known.

    Raises
    ------
    DataError
        If the shapes differ, or a deviation is negative or infinite.
    """
    if sigma_deg.shape != mask.shape:
        raise DataError(
            f"deviations of shape {sigma_deg.shape} do not fit normals of shape {mask.shape}"
        )
    every = max(1, mask.size // _SAMPLE)
    largest, sample = 0.0, [np.zeros(0, np.float32)]
    for top in range(0, len(mask), _BAND):
        rows = slice(top, min(top + _BAND, len(mask)))
        band, inside = sigma_deg[rows], mask[rows]
        values = band[inside]
        if (values < 0).any() or np.isinf(values).any():
            raise DataError("standard deviations of normals are negative or infinite: give degrees")
        largest = max(largest, float(np.nanmax(values, initial=0)))
        some = slice(-top % every, None, every)
        sample.append(band[some][inside[some]])
    together = np.concatenate(sample)
    middle = float(np.nanmedian(together)) if np.isfinite(together).any() else 0.0
    if middle == 0:
        return None

    def variances(rows: slice) -> Float:
        values = np.nan_to_num(sigma_deg[rows], nan=largest)
        relative = np.square(np.maximum(values, LEAST_SIGMA * middle) / middle)
        return np.where(mask[rows], relative, np.float32(1)).astype(np.float32)

    return ComputedRows(mask.shape, np.dtype(np.float32), variances)
