"""Structural similarity of two images, row by row."""

from __future__ import annotations

import numba
import numpy as np

from rig import in_threads
from rig.arrays import Bool, Float32, Float64
from rig.kernels import PART

# Compiled in: rig/kernels/parts.py 986f6e8c38a7

_WINDOW, _SIGMA = 11, 1.5
_REACH = _WINDOW // 2
_QUANTITIES = 5  # x, y, x * x, y * y, x * y
# Pixels of a tile: the rows of a window, with all quantities, fit into the second-level cache.
_ROWS, _COLUMNS = 64, 192


def similarity_rows(
    a: Float32, b: Float32, mask: Bool, c1: float, c2: float, drawn: tuple[Bool, Bool] | None = None
) -> Float64:
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
    drawn
        Masks of the pixels of ``a`` and of ``b`` outside which their vectors are z. Default: both
        are used as they are.
    """
    import cv2  # late: most commands compute no similarity

    weights = np.asarray(cv2.getGaussianKernel(_WINDOW, _SIGMA, cv2.CV_64F), np.float64).ravel()
    everywhere = np.ones((1, 1), np.bool_)
    drawn_a, drawn_b = (everywhere, everywhere) if drawn is None else drawn
    result = np.zeros(len(mask))
    bands = -(-len(mask) // _ROWS)
    in_threads(_similarity_rows, bands, a, b, drawn_a, drawn_b, mask, weights, c1, c2, result)
    return result


@numba.njit(**PART)
def _mirrored(index: int, count: int) -> int:
    """Return the index of the pixel that continues an image of this length beyond its ends."""
    if count == 1:
        return 0
    period = 2 * (count - 1)
    index = abs(index) % period
    return index if index < count else period - index


@numba.njit(**PART)
def _fill(
    a: Float32, b: Float32, drawn_a: Bool, drawn_b: Bool, inside: Bool, left: int, out: Float64
) -> None:
    """Write the quantities of a row from column `left` on, 0 outside the mask, and its mask."""
    columns = inside.size
    for j in range(out.shape[1] // 3):
        c = left + j
        if c < 0 or c >= columns:
            c = _mirrored(c, columns)
        w = 1.0 if inside[c] else 0.0
        known_a = drawn_a.size < columns or drawn_a[c]
        known_b = drawn_b.size < columns or drawn_b[c]
        for k in range(3):
            z = 1.0 if k == 2 else 0.0
            x = 0.5 + 0.5 * (np.float64(a[c, k]) if known_a else z)
            y = 0.5 + 0.5 * (np.float64(b[c, k]) if known_b else z)
            i = 3 * j + k
            out[0, i] = w * x
            out[1, i] = w * y
            out[2, i] = w * (x * x)
            out[3, i] = w * (y * y)
            out[4, i] = w * (x * y)
            out[5, i] = w


@numba.njit(**PART)
def _weighted(
    a: Float64,
    b: Float64,
    c: Float64,
    d: Float64,
    e: Float64,
    f: Float64,
    g: Float64,
    h: Float64,
    i: Float64,
    j: Float64,
    k: Float64,
    w: Float64,
    out: Float64,
) -> None:
    """Write the weighted sum of eleven rows, added one after the other."""
    w0, w1, w2, w3, w4, w5 = w[0], w[1], w[2], w[3], w[4], w[5]
    w6, w7, w8, w9, w10 = w[6], w[7], w[8], w[9], w[10]
    for n in range(out.size):
        half = w0 * a[n] + w1 * b[n] + w2 * c[n] + w3 * d[n] + w4 * e[n] + w5 * f[n]
        out[n] = half + w6 * g[n] + w7 * h[n] + w8 * i[n] + w9 * j[n] + w10 * k[n]


@numba.njit(**PART, error_model="numpy")
def _similarities(means: Float64, c1: float, c2: float, out: Float64) -> None:
    for i in range(out.size):
        share = means[5, i]
        mean_x, mean_y = means[0, i] / share, means[1, i] / share
        variance_x = means[2, i] / share - mean_x * mean_x
        variance_y = means[3, i] / share - mean_y * mean_y
        covariance = means[4, i] / share - mean_x * mean_y
        out[i] = (
            (2 * mean_x * mean_y + c1)
            * (2 * covariance + c2)
            / ((mean_x * mean_x + mean_y * mean_y + c1) * (variance_x + variance_y + c2))
        )


@numba.njit(nogil=True, cache=True)
def _similarity_rows(
    first: int,
    last: int,
    a: Float32,
    b: Float32,
    drawn_a: Bool,
    drawn_b: Bool,
    mask: Bool,
    weights: Float64,
    c1: float,
    c2: float,
    result: Float64,
) -> None:
    rows, columns = mask.shape
    for band in range(first, last):
        top = band * _ROWS
        bottom = min(top + _ROWS, rows)
        values = np.zeros((bottom - top + 2 * _REACH, 6, 3 * (_COLUMNS + 2 * _REACH)))
        sums = np.zeros((6, 3 * (_COLUMNS + 2 * _REACH)))
        means = np.zeros((6, 3 * _COLUMNS))
        similar = np.zeros(3 * _COLUMNS)
        # From left to right, so that the sum of a row does not depend on the tiles.
        for left in range(0, columns, _COLUMNS):
            right = min(left + _COLUMNS, columns)
            if not mask[top:bottom, left:right].any():
                continue
            for j in range(values.shape[0]):
                q = _mirrored(top + j - _REACH, rows)
                _fill(
                    a[q],
                    b[q],
                    drawn_a[q % len(drawn_a)],
                    drawn_b[q % len(drawn_b)],
                    mask[q],
                    left - _REACH,
                    values[j],
                )
            for r in range(top, bottom):
                if not mask[r, left:right].any():
                    continue
                for n in range(6):
                    v = values[r - top : r - top + _WINDOW, n]
                    _weighted(
                        v[0],
                        v[1],
                        v[2],
                        v[3],
                        v[4],
                        v[5],
                        v[6],
                        v[7],
                        v[8],
                        v[9],
                        v[10],
                        weights,
                        sums[n],
                    )
                    s = sums[n]
                    size = 3 * _COLUMNS
                    _weighted(
                        s[0:size],
                        s[3 : size + 3],
                        s[6 : size + 6],
                        s[9 : size + 9],
                        s[12 : size + 12],
                        s[15 : size + 15],
                        s[18 : size + 18],
                        s[21 : size + 21],
                        s[24 : size + 24],
                        s[27 : size + 27],
                        s[30 : size + 30],
                        weights,
                        means[n],
                    )
                _similarities(means, c1, c2, similar)
                found = result[r]
                for c in range(left, right):
                    if mask[r, c]:
                        i = 3 * (c - left)
                        found += similar[i]
                        found += similar[i + 1]
                        found += similar[i + 2]
                result[r] = found
        for r in range(top, bottom):
            result[r] /= 3
