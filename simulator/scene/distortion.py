"""Brown's lens distortion and its inverse, on the plane at distance 1 with y down.

D. C. Brown, Decentering distortion of lenses, 1966; coefficients k1, k2, p1, p2, k3 as in OpenCV.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from rig import in_threads
from rig.arrays import Float64
from rig.kernels import PART

# Compiled in: rig/kernels/parts.py 986f6e8c38a7

_NEWTON_STEPS = 60
_HALVINGS = 20
_TOLERANCE = 1e-12


def distorted(x: Float64, y: Float64, coefficients: Float64) -> tuple[Float64, Float64]:
    """Return the distorted positions of ``x`` and ``y``, arrays of one shape."""
    out = np.zeros((x.size, 2))
    _distort(x.ravel(), y.ravel(), coefficients, out)
    return out[:, 0].reshape(x.shape), out[:, 1].reshape(x.shape)


def undistorted(x: Float64, y: Float64, coefficients: Float64) -> tuple[Float64, Float64]:
    """Return the undistorted positions, to 1e-12; NaN where no solution is inside the fold."""
    out = np.zeros((x.size, 2))
    fold = _fold(coefficients)
    in_threads(_undistort, x.size, x.ravel(), y.ravel(), coefficients, fold, out)
    return out[:, 0].reshape(x.shape), out[:, 1].reshape(x.shape)


def _fold(coefficients: Float64) -> float:
    """Return the squared radius at which the radial distortion folds over, or infinity.

    It is the first root of the derivative ``1 + 3 k1 r^2 + 5 k2 r^4 + 7 k3 r^6``. The polynomial is
    solved for ``1 / r^2``, whose leading coefficient is never small; the largest root counts.
    """
    k1, k2, _, _, k3 = coefficients
    roots = np.roots([1.0, 3 * k1, 5 * k2, 7 * k3])
    real = roots[np.abs(roots.imag) < 1e-7 * np.abs(roots)].real
    largest = float(max(real, default=0.0))
    return 1 / largest if largest > 1e-12 else math.inf


@numba.njit(**PART)
def _brown(x: float, y: float, k: Float64) -> tuple[float, float, float, float, float]:
    """Return the distorted position and its derivatives xx, xy = yx, yy."""
    r2 = x * x + y * y
    radial = 1 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))
    slope = 2 * (k[0] + r2 * (2 * k[1] + 3 * r2 * k[4]))
    return (
        x * radial + 2 * k[2] * x * y + k[3] * (r2 + 2 * x * x),
        y * radial + k[2] * (r2 + 2 * y * y) + 2 * k[3] * x * y,
        radial + slope * x * x + 2 * k[2] * y + 6 * k[3] * x,
        slope * x * y + 2 * k[2] * x + 2 * k[3] * y,
        radial + slope * y * y + 6 * k[2] * y + 2 * k[3] * x,
    )


@numba.njit(cache=True)
def _distort(x: Float64, y: Float64, k: Float64, out: Float64) -> None:
    for i in range(len(x)):
        out[i, 0], out[i, 1] = _brown(x[i], y[i], k)[:2]


@numba.njit(nogil=True, cache=True)
def _undistort(
    first: int, last: int, x: Float64, y: Float64, k: Float64, fold: float, out: Float64
) -> None:
    """Invert the model by Newton's method; NaN if there is no solution inside the fold.

    Steps that cross the fold or do not reduce the error are halved.
    """
    for i in range(first, last):
        u, v = x[i], y[i]
        shrink = math.sqrt(min(1.0, 0.9 * fold / max(u * u + v * v, 1e-300)))
        u, v = u * shrink, v * shrink
        gx, gy, xx, xy, yy = _brown(u, v, k)
        ex, ey = x[i] - gx, y[i] - gy
        det = xx * yy - xy * xy
        for _ in range(_NEWTON_STEPS):
            miss = ex * ex + ey * ey
            if miss == 0.0 or not det > 0.0:
                break
            du, dv = (yy * ex - xy * ey) / det, (xx * ey - xy * ex) / det
            better = False
            for _ in range(_HALVINGS):
                tu, tv = u + du, v + dv
                gx, gy, xx, xy, yy = _brown(tu, tv, k)
                ex, ey = x[i] - gx, y[i] - gy
                det = xx * yy - xy * xy
                if tu * tu + tv * tv < fold and det > 0.0 and ex * ex + ey * ey < miss:
                    better = True
                    break
                du, dv = du / 2, dv / 2
            if not better:
                break
            u, v = tu, tv
        gx, gy, xx, xy, yy = _brown(u, v, k)
        ex, ey = x[i] - gx, y[i] - gy
        good = ex * ex + ey * ey <= (_TOLERANCE * (1 + abs(u) + abs(v))) ** 2
        if good and xx * yy - xy * xy > 0.0:
            out[i, 0], out[i, 1] = u, v
        else:
            out[i, 0], out[i, 1] = math.nan, math.nan
