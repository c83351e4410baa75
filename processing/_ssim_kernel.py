"""Structural similarity of two images, row by row."""

from __future__ import annotations

import cv2
import numba
import numpy as np
import numpy.typing as npt

Float = npt.NDArray[np.float32]
Double = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

_WINDOW, _SIGMA = 11, 1.5
_REACH = _WINDOW // 2
_QUANTITIES = 5  # x, y, x * x, y * y, x * y


def similarity_rows(a: Float, b: Float, mask: Mask, c1: float, c2: float) -> Double:
    """Return the sum of the similarity over each row of a mask, averaged over the channels.

    Statistics are those of ``n / 2 + 0.5`` over the pixels of the mask, in float64, weighted by a
    Gaussian window; the image is mirrored at its borders, without its outermost pixels (Wang et
    al., 2004).

    Parameters
    ----------
    a, b
        ``(H, W, 3)`` float32, contiguous.
    mask
        ``(H, W)`` bool.
    c1, c2
        The constants of the means and of the variances.
    """
    weights = np.asarray(cv2.getGaussianKernel(_WINDOW, _SIGMA, cv2.CV_64F), np.float64).ravel()
    return np.asarray(_similarity_rows(a, b, mask, weights, c1, c2), np.float64)


@numba.njit(cache=True)
def _mirrored(index: int, count: int) -> int:
    """Return the index of the pixel that continues an image of this length beyond its ends."""
    if count == 1:
        return 0
    period = 2 * (count - 1)
    index = abs(index) % period
    return index if index < count else period - index


@numba.njit(cache=True)
def _add_row(sums: Double, total: Double, a: Float, b: Float, inside: Mask, weight: float) -> None:
    """Add a row of the image to the sums over the rows of the window."""
    columns = inside.size
    for c in range(columns):
        w = weight if inside[c] else 0.0
        total[c + _REACH] += w
        for k in range(3):
            x = 0.5 + 0.5 * np.float64(a[c, k])
            y = 0.5 + 0.5 * np.float64(b[c, k])
            i = 3 * (c + _REACH) + k
            sums[0, i] += w * x
            sums[1, i] += w * y
            sums[2, i] += w * (x * x)
            sums[3, i] += w * (y * y)
            sums[4, i] += w * (x * y)


@numba.njit(cache=True)
def _mirror_ends(row: Double, columns: int, channels: int) -> None:
    for e in range(1, _REACH + 1):
        for k in range(channels):
            left = _mirrored(-e, columns) + _REACH
            right = _mirrored(columns - 1 + e, columns) + _REACH
            row[(_REACH - e) * channels + k] = row[left * channels + k]
            row[(_REACH + columns - 1 + e) * channels + k] = row[right * channels + k]


@numba.njit(cache=True)
def _blur(row: Double, out: Double, weights: Double, channels: int) -> None:
    out[:] = 0.0
    for j in range(_WINDOW):
        w = weights[j]
        shift = j * channels
        for i in range(out.size):
            out[i] += w * row[i + shift]


@numba.njit(parallel=True, cache=True)
def _similarity_rows(
    a: Float, b: Float, mask: Mask, weights: Double, c1: float, c2: float
) -> Double:
    rows, columns = mask.shape
    result = np.zeros(rows)
    for r in numba.prange(rows):
        if not mask[r].any():
            continue
        sums = np.zeros((_QUANTITIES, 3 * (columns + 2 * _REACH)))
        total = np.zeros(columns + 2 * _REACH)
        for j in range(_WINDOW):
            q = _mirrored(r + j - _REACH, rows)
            _add_row(sums, total, a[q], b[q], mask[q], weights[j])
        _mirror_ends(total, columns, 1)
        share = np.zeros(columns)
        _blur(total, share, weights, 1)
        means = np.zeros((_QUANTITIES, 3 * columns))
        for n in range(_QUANTITIES):
            _mirror_ends(sums[n], columns, 3)
            _blur(sums[n], means[n], weights, 3)
        found = 0.0
        for c in range(columns):
            if not mask[r, c]:
                continue
            for k in range(3):
                i = 3 * c + k
                mean_x, mean_y = means[0, i] / share[c], means[1, i] / share[c]
                variance_x = means[2, i] / share[c] - mean_x * mean_x
                variance_y = means[3, i] / share[c] - mean_y * mean_y
                covariance = means[4, i] / share[c] - mean_x * mean_y
                found += (
                    (2 * mean_x * mean_y + c1)
                    * (2 * covariance + c2)
                    / ((mean_x * mean_x + mean_y * mean_y + c1) * (variance_x + variance_y + c2))
                )
        result[r] = found / 3
    return result
