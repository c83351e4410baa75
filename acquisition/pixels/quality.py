"""Measurement of clipping, percentiles, sharpness and mean of raw frames."""

from __future__ import annotations

import numba
import numpy as np

from acquisition.pixels.frame_quality import FrameQuality
from rig.arrays import Int64, UInt16

# In per mille, so that ranks are computed with integers.
_PERCENTILES = {"1": 10, "50": 500, "99": 990, "99.9": 999}


def measure_quality(
    pixels: UInt16, *, white_level_dn: float, black_level_dn: float = 0.0
) -> FrameQuality:
    """Measure a raw frame.

    Parameters
    ----------
    pixels
        ``(H, W)`` or ``(H, W, 3)`` raw values.
    white_level_dn
        Grey value from which a sample is clipped.
    black_level_dn
        Grey value without light.

    Returns
    -------
    FrameQuality
        Exact counts; the sharpness to six significant digits, the mean to four decimals.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition.pixels import measure_quality
    >>> measure_quality(np.full((4, 6), 4095, np.uint16), white_level_dn=4095).clipped_fraction
    1.0
    """
    step = 1 if pixels.ndim == 2 else pixels.shape[2]
    rows = np.ascontiguousarray(pixels).reshape(len(pixels), -1)
    counts, squares = _scan(rows, int(rows.max()) + 1, 2 * step)
    ranks = np.cumsum(counts)
    total = int(ranks[-1])
    occupied = np.flatnonzero(counts)
    percentiles = {"0": int(occupied[0])}
    for name, per_mille in _PERCENTILES.items():
        percentiles[name] = int(np.searchsorted(ranks, -(-per_mille * total // 1000)))
    percentiles["100"] = int(occupied[-1])
    clipped = counts[int(np.ceil(max(white_level_dn, 0))) :].sum()
    mean_dn = float(counts @ np.arange(len(counts))) / total
    mean = mean_dn - black_level_dn
    height, width = rows.shape
    pairs = height * max(0, width - 2 * step) + max(0, height - 2) * width
    energy = int(squares) / pairs if pairs else 0.0
    sharpness = energy / mean**2 if mean > 0 else 0.0
    sharpness = float(f"{sharpness:.6g}")
    return FrameQuality(float(clipped / total), percentiles, sharpness, round(mean_dn, 4))


# Without the GIL, because the thread that controls the light must not wait for this; on one core,
# because parallel loops of several threads would slow each other down.
@numba.njit(cache=True, nogil=True)
def _scan(rows: UInt16, levels: int, step: int) -> tuple[Int64, np.uint64]:
    """Return how often each value below ``levels`` occurs, and the summed squares of differences.

    Pairs are ``step`` apart along the rows and two apart down the columns.
    """
    height, width = rows.shape
    # Two histograms in turn: equal neighbours would wait for each other's count.
    counts = np.zeros((2, levels), np.int64)
    squares = np.uint64(0)
    for y in range(height):
        row = rows[y]
        for x in range(width // 2):
            counts[0, row[2 * x]] += 1
            counts[1, row[2 * x + 1]] += 1
        if width % 2:
            counts[0, row[width - 1]] += 1
        for x in range(width - step):
            along = np.int64(row[x + step]) - np.int64(row[x])
            squares += np.uint64(along * along)
        if y >= 2:
            above = rows[y - 2]
            for x in range(width):
                down = np.int64(row[x]) - np.int64(above[x])
                squares += np.uint64(down * down)
    return counts[0] + counts[1], squares
