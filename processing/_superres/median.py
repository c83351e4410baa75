"""The median of a map that is larger than memory."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from acquisition import MapRows, rows_in_bands

# Pixels that are read at once.
_READ = 1 << 20
_HALF = 1 << 16


def median_of_rows(values: MapRows, mask: npt.NDArray[np.bool_]) -> float:
    """Return the median of a map over a mask, exactly, from bands of rows.

    The bits of positive numbers have the order of the numbers: the upper half of those of the
    median is counted first, then the lower half.

    Parameters
    ----------
    values
        ``(H, W)`` float32, 0 or above inside the mask.
    mask
        ``(H, W)`` bool, not empty.

    Examples
    --------
    >>> import numpy as np
    >>> from processing._superres.median import median_of_rows
    >>> median_of_rows(np.float32([[3, 1], [8, 2]]), np.ones((2, 2), bool))
    2.5
    """
    count = np.count_nonzero(mask)
    upper = np.zeros(_HALF, np.int64)
    for bits in _bits(values, mask):
        upper += np.bincount(bits >> 16, minlength=_HALF)
    below = np.cumsum(upper)
    middle = []
    # One value in the middle, or two whose mean is the median.
    for number in ((count - 1) // 2, count // 2):
        top = int(np.searchsorted(below, number, side="right"))
        lower = np.zeros(_HALF, np.int64)
        for bits in _bits(values, mask):
            lower += np.bincount(bits[bits >> 16 == top] & (_HALF - 1), minlength=_HALF)
        rest = number - (below[top] - upper[top])
        middle.append(top << 16 | int(np.searchsorted(np.cumsum(lower), rest, side="right")))
    return float(np.median(np.array(middle, np.uint32).view(np.float32)))


def _bits(values: MapRows, mask: npt.NDArray[np.bool_]) -> Iterator[npt.NDArray[np.uint32]]:
    height, width = mask.shape
    for rows in rows_in_bands(height, width, _READ):
        yield values[rows][mask[rows]].view(np.uint32)
