"""Compiled loops over pixels that separate normal maps into shape and detail.

Rows are flat: in a row of W vectors, element 3 c + k is component k of pixel c. A shift by t pixels
is a shift by 3 t elements, and every loop runs over contiguous memory. Images are processed in
tiles that fit into the cache, one thread per tile. The rows of a tile are smoothed across, then
down, and each smoothed row is processed and written immediately.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from rig.arrays import Bool, Float32
from rig.kernels import INLINED, PART

# Compiled in: rig/kernels/parts.py 986f6e8c38a7

_ROWS, _COLUMNS = 128, 512
# Below this squared sine two vectors count as opposite: the rotation axis would be 0/0.
_OPPOSITE = 1e-30
# A shorter mean of unit vectors consists of rounding errors and has no direction.
_CANCELLED = 1e-7
# Allow fused multiply-add, but nothing that changes NaN, signs or the order of operations.
_FAST = {"contract"}


@numba.njit(**INLINED, fastmath=_FAST, error_model="numpy")
def _turn_row(vectors: Float32, poles: Float32, sign: float, out: Float32) -> None:
    """Rotate a flat row by the rotations from its poles to z (sign 1) or back (sign -1).

    The arithmetic is float64, so the only error of a round trip is the rounding of the
    intermediate result.
    """
    for c in range(out.size // 3):
        i = 3 * c
        sx, sy, sz = np.float64(poles[i]), np.float64(poles[i + 1]), np.float64(poles[i + 2])
        x, y, z = np.float64(vectors[i]), np.float64(vectors[i + 1]), np.float64(vectors[i + 2])
        length2 = sx * sx + sy * sy + sz * sz
        known = length2 > 0
        scale = 1 / math.sqrt(length2) if known else 0.0
        sx *= scale
        sy *= scale
        sz *= scale
        # 1 / (1 + sz) suffers from cancellation near the lower pole; (1 - sz) / sine2 is equal.
        sine2 = sx * sx + sy * sy
        opposite = sz < 0 and sine2 < _OPPOSITE
        above = 1.0 if sz >= 0 else 1 - sz
        below = 1 + sz if sz >= 0 else (1.0 if opposite else sine2)
        dot = sx * x + sy * y
        slide = above / below * dot + sign * z
        turned_x = x if opposite else x - sx * slide
        turned_y = -y if opposite else y - sy * slide
        turned_z = -z if opposite else sign * dot + sz * z
        out[i] = np.float32(turned_x if known else 0.0)
        out[i + 1] = np.float32(turned_y if known else 0.0)
        out[i + 2] = np.float32(turned_z if known else 0.0)


@numba.njit(nogil=True, cache=True)
def turn(
    first: int, last: int, vectors: Float32, poles: Float32, sign: float, out: Float32
) -> None:
    """Rotate ``(H, 3 W)`` vectors row by row; see `_turn_row`."""
    for r in range(first, last):
        _turn_row(vectors[r], poles[r], sign, out[r])


@numba.njit(**PART)
def _mirrored(i: int, length: int) -> int:
    """Return an index outside the frame, mirrored about the outermost pixels."""
    i = abs(i) % (2 * length - 2)
    return i if i < length else 2 * length - 2 - i


@numba.njit(**INLINED, fastmath=_FAST)
def _scaled(a: Float32, k: np.float32, out: Float32) -> None:
    for i in range(out.size):
        out[i] = k * a[i]


@numba.njit(**INLINED, fastmath=_FAST)
def _add_pair(a: Float32, b: Float32, k: float, out: Float32) -> None:
    for i in range(out.size):
        out[i] += k * (a[i] + b[i])


@numba.njit(**INLINED, fastmath=_FAST)
def _add_four_pairs(
    a: Float32,
    b: Float32,
    c: Float32,
    d: Float32,
    e: Float32,
    f: Float32,
    g: Float32,
    h: Float32,
    k: Float32,
    out: Float32,
) -> None:
    # Four pairs at a time reduce the number of reads and writes of the sum.
    k0, k1, k2, k3 = k[0], k[1], k[2], k[3]
    for i in range(out.size):
        out[i] += k0 * (a[i] + b[i]) + k1 * (c[i] + d[i]) + k2 * (e[i] + f[i]) + k3 * (g[i] + h[i])


@numba.njit(**INLINED)
def _convolve(values: Float32, middle: int, step: int, kernel: Float32, out: Float32) -> None:
    """Smooth the values from index `middle` onwards; neighbouring pixels are `step` apart."""
    n, radius = out.size, kernel.size - 1
    _scaled(values[middle : middle + n], kernel[0], out)
    for t in range(1, radius - 2, 4):
        a, b = middle - t * step, middle + t * step
        _add_four_pairs(
            values[a : a + n],
            values[b : b + n],
            values[a - step : a - step + n],
            values[b + step : b + step + n],
            values[a - 2 * step : a - 2 * step + n],
            values[b + 2 * step : b + 2 * step + n],
            values[a - 3 * step : a - 3 * step + n],
            values[b + 3 * step : b + 3 * step + n],
            kernel[t:],
            out,
        )
    for t in range(radius - radius % 4 + 1, radius + 1):
        a, b = middle - t * step, middle + t * step
        _add_pair(values[a : a + n], values[b : b + n], kernel[t], out)


@numba.njit(**INLINED)
def _across(
    image: Float32, width: int, kernel: Float32, top: int, bottom: int, left: int, right: int
) -> Float32:
    """Smooth across the rows of a tile and the rows above and below that its columns require."""
    radius = kernel.size - 1
    # Not a constant argument: numba would compile everything below once for each constant.
    rows, step = image.shape[0], image.shape[1] // width
    out = np.zeros((bottom - top + 2 * radius, (right - left) * step), np.float32)
    padded = np.zeros((right - left + 2 * radius) * step, np.float32)
    first, last = max(left - radius, 0), min(right + radius, width)
    for j in range(out.shape[0]):
        row = image[_mirrored(top - radius + j, rows)]
        for c in range(left - radius, first):
            for k in range(step):
                padded[(c - left + radius) * step + k] = row[_mirrored(c, width) * step + k]
        inside = padded[(first - left + radius) * step : (last - left + radius) * step]
        # The assignment of a slice takes much longer to compile.
        _scaled(row[first * step : last * step], np.float32(1), inside)
        for c in range(last, right + radius):
            for k in range(step):
                padded[(c - left + radius) * step + k] = row[_mirrored(c, width) * step + k]
        _convolve(padded, radius * step, step, kernel, out[j])
    return out


@numba.njit(**INLINED)
def _down(smooth: Float32, r: int, kernel: Float32, out: Float32) -> None:
    """Smooth down the columns at row r of a tile."""
    middle = (r + kernel.size - 1) * out.size
    _convolve(smooth.reshape(-1), middle, out.size, kernel, out)


@numba.njit(**INLINED, fastmath=_FAST, error_model="numpy")
def _direct_row(mean: Float32, normals: Float32, mask: Bool, out: Float32) -> None:
    """Normalise means to unit length; use the normal itself if the mean cancelled out."""
    for c in range(mask.size):
        i = 3 * c
        x, y, z = np.float64(mean[i]), np.float64(mean[i + 1]), np.float64(mean[i + 2])
        length = math.sqrt(x * x + y * y + z * z)
        directed = length > _CANCELLED
        scale = 1 / length if directed else 0.0
        x = x * scale if directed else np.float64(normals[i])
        y = y * scale if directed else np.float64(normals[i + 1])
        z = z * scale if directed else np.float64(normals[i + 2])
        out[i] = np.float32(x if mask[c] else 0.0)
        out[i + 1] = np.float32(y if mask[c] else 0.0)
        out[i + 2] = np.float32(z if mask[c] else 0.0)


def tiles(mask: Bool) -> int:
    """Return the number of tiles of an image."""
    rows, columns = mask.shape
    return int(-(-rows // _ROWS) * -(-columns // _COLUMNS))


@numba.njit(**PART)
def _tile(mask: Bool, number: int) -> tuple[int, int, int, int]:
    """Return the row and column limits of a tile, without rows if it is outside the mask."""
    over = -(-mask.shape[1] // _COLUMNS)
    top, left = number // over * _ROWS, number % over * _COLUMNS
    bottom, right = min(top + _ROWS, mask.shape[0]), min(left + _COLUMNS, mask.shape[1])
    if not mask[top:bottom, left:right].any():
        bottom = top
    return top, bottom, left, right


@numba.njit(nogil=True, cache=True)
def separate_once(
    first: int,
    last: int,
    normals: Float32,
    mask: Bool,
    kernel: Float32,
    shape: Float32,
    detail: Float32,
) -> None:
    """Write shape and detail of tiles in one pass for a filter that is applied once.

    Parameters
    ----------
    normals
        ``(H, 3 W)``, 0 outside the mask. No weights are required, because the mean is normalised.
    mask
        ``(H, W)``.
    kernel
        ``(R + 1,)`` right half of the symmetric kernel, the centre first.
    shape, detail
        ``(H, 3 W)`` zeros that are filled inside the mask.
    """
    for number in range(first, last):
        top, bottom, left, right = _tile(mask, number)
        if bottom == top:
            continue
        smooth = _across(normals, mask.shape[1], kernel, top, bottom, left, right)
        mean = np.zeros((right - left) * 3, np.float32)
        for r in range(top, bottom):
            _down(smooth, r - top, kernel, mean)
            row = normals[r, 3 * left : 3 * right]
            pole = shape[r, 3 * left : 3 * right]
            _direct_row(mean, row, mask[r, left:right], pole)
            _turn_row(row, pole, 1.0, detail[r, 3 * left : 3 * right])


@numba.njit(nogil=True, cache=True)
def gains(
    first: int, last: int, mask: Bool, weights: Float32, kernel: Float32, out: Float32
) -> None:
    """Write factors ``(H, W)`` of a smoothed image in tiles: 1 / weight, 0 outside the mask."""
    for number in range(first, last):
        top, bottom, left, right = _tile(mask, number)
        if bottom == top:
            continue
        smooth = _across(weights, mask.shape[1], kernel, top, bottom, left, right)
        weight = np.zeros(right - left, np.float32)
        for r in range(top, bottom):
            _down(smooth, r - top, kernel, weight)
            for c in range(left, right):
                out[r, c] = np.float32(1) / weight[c - left] if mask[r, c] else np.float32(0)


@numba.njit(**INLINED, fastmath=_FAST)
def _rest_row(rest: Float32, mean: Float32, gain: Float32, out: Float32) -> None:
    for c in range(gain.size):
        i = 3 * c
        out[i] = rest[i] - gain[c] * mean[i]
        out[i + 1] = rest[i + 1] - gain[c] * mean[i + 1]
        out[i + 2] = rest[i + 2] - gain[c] * mean[i + 2]


@numba.njit(nogil=True, cache=True)
def leave(
    first: int, last: int, mask: Bool, rest: Float32, gain: Float32, kernel: Float32, out: Float32
) -> None:
    """Write the ``(H, 3 W)`` rest of tiles minus its smooth part, with factors from `gains`."""
    for number in range(first, last):
        top, bottom, left, right = _tile(mask, number)
        if bottom == top:
            continue
        smooth = _across(rest, mask.shape[1], kernel, top, bottom, left, right)
        mean = np.zeros((right - left) * 3, np.float32)
        for r in range(top, bottom):
            _down(smooth, r - top, kernel, mean)
            part = slice(3 * left, 3 * right)
            _rest_row(rest[r, part], mean, gain[r, left:right], out[r, part])


@numba.njit(nogil=True, cache=True)
def finish(
    first: int, last: int, normals: Float32, mask: Bool, shape: Float32, detail: Float32
) -> None:
    """Write shape and detail of rows; `detail` contains the normals minus their smooth part."""
    for r in range(first, last):
        smooth = np.zeros(normals.shape[1], np.float32)
        for i in range(smooth.size):
            smooth[i] = normals[r, i] - detail[r, i]
        _direct_row(smooth, normals[r], mask[r], shape[r])
        _turn_row(normals[r], shape[r], 1.0, detail[r])
