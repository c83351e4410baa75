"""The normal equations of one pixel, compiled: 3 x 3, guarded against ill-conditioned lights."""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt

Float = npt.NDArray[np.float32]

# A row of lights whose directions are wrong by a degree has about 50, a cone of 3 degrees 30, a
# dome 2 to 5: what lies above multiplies every error of the images by as much.
MAX_CONDITION = 30.0
# trace(A) * trace(A^-1) is between the squared condition number and 9 times that: this refuses no
# pixel that sees all the lights of an accepted set.
_CONDITION2 = 9.0 * MAX_CONDITION**2
# Sums may be taken in any order, so that they vectorise; the order is the same in every run.
_ANY_ORDER = {"reassoc", "contract", "nsz"}


@numba.njit(cache=True)
def _solve(
    a00: float, a01: float, a02: float, a11: float, a12: float, a22: float,
    b0: float, b1: float, b2: float,
) -> tuple[bool, float, float, float]:  # fmt: skip
    """Solve a symmetric 3 x 3 system by cofactors; False where it is ill-conditioned."""
    c00 = a11 * a22 - a12 * a12
    c01 = a02 * a12 - a01 * a22
    c02 = a01 * a12 - a02 * a11
    c11 = a00 * a22 - a02 * a02
    c12 = a01 * a02 - a00 * a12
    c22 = a00 * a11 - a01 * a01
    determinant = a00 * c00 + a01 * c01 + a02 * c02
    if not (a00 + a11 + a22) * (c00 + c11 + c22) < _CONDITION2 * determinant:
        return False, 0.0, 0.0, 0.0
    return (
        True,
        (c00 * b0 + c01 * b1 + c02 * b2) / determinant,
        (c01 * b0 + c11 * b1 + c12 * b2) / determinant,
        (c02 * b0 + c12 * b1 + c22 * b2) / determinant,
    )


@numba.njit(cache=True, fastmath=_ANY_ORDER)
def weighted(
    count: int, v: Float, lx: Float, ly: Float, lz: Float, weight: Float
) -> tuple[bool, float, float, float]:
    """Weighted least squares of ``v = l . m`` over the first ``count`` samples, float64 sums."""
    a00 = a01 = a02 = a11 = a12 = a22 = b0 = b1 = b2 = 0.0
    for k in range(count):
        x, y, z = lx[k], ly[k], lz[k]
        wx, wy, wz = weight[k] * x, weight[k] * y, weight[k] * z
        a00 += wx * x
        a01 += wx * y
        a02 += wx * z
        a11 += wy * y
        a12 += wy * z
        a22 += wz * z
        b0 += wx * v[k]
        b1 += wy * v[k]
        b2 += wz * v[k]
    return _solve(a00, a01, a02, a11, a12, a22, b0, b1, b2)
