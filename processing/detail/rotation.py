"""Shortest-arc rotations between unit vectors, applied to whole maps in closed form.

The rotation that takes a shape component to z is the paper's 3 x 3 matrix (Rodrigues' formula).
It is applied row by row and never stored. The arithmetic is float64 and the pole is renormalised,
so the only error of a round trip is the rounding of the intermediate float32 map.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from processing.detail.separation_kernels import turn
from rig import in_threads
from rig.arrays import Float32


def _turned(vectors: Float32, poles: Float32, sign: float) -> Float32:
    flat = (vectors.shape[0], -1)
    out = np.zeros(vectors.shape, np.float32)
    in_threads(
        turn,
        len(out),
        np.ascontiguousarray(vectors, np.float32).reshape(flat),
        np.ascontiguousarray(poles, np.float32).reshape(flat),
        sign,
        out.reshape(flat),
    )
    return out


def rotate_to_z(vectors: Float32, poles: Float32) -> Float32:
    """Apply to each vector the shortest rotation that takes its pole to z = (0, 0, 1).

    With the shape component as the pole, the result is the detail component (eq. ``eq_detail_form``
    and ``eq_detail_rotCal`` of the paper), also known as reoriented normal mapping
    (Barre-Brisebois and Hill, 2012).

    Parameters
    ----------
    vectors
        ``(H, W, 3)`` float32.
    poles
        ``(H, W, 3)`` float32 unit vectors. The result is zero if the pole is zero. For a pole at
        (0, 0, -1), which has no unique shortest arc, the rotation is diag(1, -1, -1).

    Returns
    -------
    Normals
        ``(H, W, 3)`` float32, with the lengths of `vectors`.
    """
    return _turned(vectors, poles, 1.0)


def rotate_from_z(vectors: Float32, poles: Float32) -> Float32:
    """Apply to each vector the shortest rotation that takes z to its pole.

    This is the inverse of `rotate_to_z` (eq. ``eq_transfer``). The error of a round trip is below
    5e-5 degree for every pole, including (0, 0, -1).

    Parameters
    ----------
    vectors
        ``(H, W, 3)`` float32.
    poles
        ``(H, W, 3)`` float32 unit vectors. The result is zero if the pole is zero.

    Returns
    -------
    Normals
        ``(H, W, 3)`` float32, with the lengths of `vectors`.
    """
    return _turned(vectors, poles, -1.0)


@numba.njit(nogil=True, cache=True)
def _rotate_between(
    first: int, last: int, vectors: Float32, starts: Float32, ends: Float32, out: Float32
) -> None:
    for r in range(first, last):
        for c in range(out.shape[1]):
            ax, ay, az = float(starts[r, c, 0]), float(starts[r, c, 1]), float(starts[r, c, 2])
            bx, by, bz = float(ends[r, c, 0]), float(ends[r, c, 1]), float(ends[r, c, 2])
            lengths = math.sqrt(ax * ax + ay * ay + az * az) * math.sqrt(
                bx * bx + by * by + bz * bz
            )
            if lengths == 0:
                continue
            x, y, z = float(vectors[r, c, 0]), float(vectors[r, c, 1]), float(vectors[r, c, 2])
            vx = (ay * bz - az * by) / lengths
            vy = (az * bx - ax * bz) / lengths
            vz = (ax * by - ay * bx) / lengths
            cosine = (ax * bx + ay * by + az * bz) / lengths
            sine2 = vx * vx + vy * vy + vz * vz
            if cosine < 0 and sine2 < 1e-24:
                # Opposite vectors: a half turn about any perpendicular axis; build the axis from
                # the smallest component.
                if abs(ax) <= abs(ay) and abs(ax) <= abs(az):
                    vx, vy, vz = 0.0, az, -ay
                elif abs(ay) <= abs(az):
                    vx, vy, vz = -az, 0.0, ax
                else:
                    vx, vy, vz = ay, -ax, 0.0
                along = 2 * (vx * x + vy * y + vz * z) / (vx * vx + vy * vy + vz * vz)
                out[r, c, 0] = along * vx - x
                out[r, c, 1] = along * vy - y
                out[r, c, 2] = along * vz - z
                continue
            k = 1 / (1 + cosine) if cosine >= 0 else (1 - cosine) / sine2
            along = k * (vx * x + vy * y + vz * z)
            out[r, c, 0] = cosine * x + vy * z - vz * y + along * vx
            out[r, c, 1] = cosine * y + vz * x - vx * z + along * vy
            out[r, c, 2] = cosine * z + vx * y - vy * x + along * vz


def rotate_between(vectors: Float32, starts: Float32, ends: Float32) -> Float32:
    """Apply to each vector the shortest rotation that takes its start to its end.

    Parameters
    ----------
    vectors
        ``(H, W, 3)`` float32.
    starts, ends
        ``(H, W, 3)`` float32 unit vectors. The result is zero if one of them is zero. If they are
        opposite, the rotation is a half turn.

    Returns
    -------
    Normals
        ``(H, W, 3)`` float32, with the lengths of `vectors`.
    """
    out = np.zeros(vectors.shape, np.float32)
    in_threads(_rotate_between, len(out), vectors, starts, ends, out)
    return out
