"""Loops over the pixels of a tile, compiled.

Each has the constant length of a tile and one array that it writes, so that it vectorises, and a
pixel has the same bits wherever in a tile it is. They are compiled into their callers, and each
call adds to the compile time: callers have few calls in loops.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from processing.stereo.frames import TILE
from rig.arrays import Float32
from rig.kernels import INLINED, PART

# Compiled in: processing/stereo/frames.py f61390f77b18
# Compiled in: rig/kernels/parts.py 986f6e8c38a7

_FAST = {"contract", "nsz"}
# Least determinant of normal equations, relative to the cubed trace, that sums in float32 solve: a
# dome has 0.005 to 0.03. Other pixels are left to the solver of single pixels.
_LEAST_DETERMINANT = 1e-4


@numba.njit(**PART, error_model="numpy")
def row(flat: Float32, first: int) -> Float32:
    """Return the row that begins at an index."""
    return flat[first : first + TILE]


@numba.njit(**INLINED, fastmath=_FAST, error_model="numpy")
def add_six(out: Float32, flat: Float32, first: int, step: int, p: Float32) -> None:
    """Add six rows times the factors p; they begin at ``first``, each ``step`` after the last."""
    p0, p1, p2, p3, p4, p5 = p[0], p[1], p[2], p[3], p[4], p[5]
    v0, v1, v2 = row(flat, first), row(flat, first + step), row(flat, first + 2 * step)
    first += 3 * step
    v3, v4, v5 = row(flat, first), row(flat, first + step), row(flat, first + 2 * step)
    for k in range(TILE):
        out[k] += p0 * v0[k] + p1 * v1[k] + p2 * v2[k] + p3 * v3[k] + p4 * v4[k] + p5 * v5[k]


@numba.njit(**INLINED, fastmath=_FAST, error_model="numpy")
def add_one(out: Float32, v: Float32, p: np.float32) -> None:
    """Add a row times a factor."""
    for k in range(TILE):
        out[k] += p * v[k]


@numba.njit(**INLINED, fastmath=_FAST, error_model="numpy")
def add_four_squares(
    out: Float32,
    flat: Float32,
    first: int,
    step: int,
    x: Float32,
    y: Float32,
    z: Float32,
    of: Float32,
) -> None:
    """Add the squared residuals of four rows, see `add_six`; ``of`` is ``(3, 4)``, their lights."""
    v0, v1 = row(flat, first), row(flat, first + step)
    v2, v3 = row(flat, first + 2 * step), row(flat, first + 3 * step)
    a0, b0, c0, a1, b1, c1 = of[0, 0], of[1, 0], of[2, 0], of[0, 1], of[1, 1], of[2, 1]
    a2, b2, c2, a3, b3, c3 = of[0, 2], of[1, 2], of[2, 2], of[0, 3], of[1, 3], of[2, 3]
    for k in range(TILE):
        r0 = v0[k] - (a0 * x[k] + b0 * y[k] + c0 * z[k])
        r1 = v1[k] - (a1 * x[k] + b1 * y[k] + c1 * z[k])
        r2 = v2[k] - (a2 * x[k] + b2 * y[k] + c2 * z[k])
        r3 = v3[k] - (a3 * x[k] + b3 * y[k] + c3 * z[k])
        out[k] += r0 * r0 + r1 * r1 + r2 * r2 + r3 * r3


@numba.njit(**INLINED, fastmath=_FAST, error_model="numpy")
def add_square(out: Float32, v: Float32, x: Float32, y: Float32, z: Float32, of: Float32) -> None:
    """Add the squared residuals of a row under the light vector ``of``."""
    a, b, c = of[0], of[1], of[2]
    for k in range(TILE):
        r = v[k] - (a * x[k] + b * y[k] + c * z[k])
        out[k] += r * r


@numba.njit(**PART, error_model="numpy")
def clear(out: Float32) -> None:
    """Write 0."""
    for k in range(TILE):
        out[k] = 0


@numba.njit(**PART, error_model="numpy")
def multiply(out: Float32, by: Float32) -> None:
    """Multiply two rows."""
    for k in range(TILE):
        out[k] *= by[k]


@numba.njit(**INLINED, fastmath=_FAST, error_model="numpy")
def add_products(out: Float32, a: Float32, b: Float32) -> None:
    """Add the products of two rows."""
    for k in range(TILE):
        out[k] += a[k] * b[k]


@numba.njit(**INLINED, fastmath=_FAST, error_model="numpy")
def add_two_products(out: Float32, a: Float32, b: Float32, c: Float32, d: Float32) -> None:
    """Add the products of two pairs of rows."""
    for k in range(TILE):
        out[k] += a[k] * b[k] + c[k] * d[k]


@numba.njit(**INLINED, fastmath=_FAST, error_model="numpy")
def subtract_scalar_product(
    out: Float32, a: Float32, b: Float32, c: Float32, x: Float32, y: Float32, z: Float32
) -> None:
    """Subtract ``(a, b, c) . (x, y, z)``."""
    for k in range(TILE):
        out[k] -= a[k] * x[k] + b[k] * y[k] + c[k] * z[k]


@numba.njit(**INLINED, fastmath=_FAST, error_model="numpy")
def add_scalar_product(
    out: Float32, a: Float32, b: Float32, c: Float32, x: Float32, y: Float32, z: Float32
) -> None:
    """Add ``(a, b, c) . (x, y, z)``."""
    for k in range(TILE):
        out[k] += a[k] * x[k] + b[k] * y[k] + c[k] * z[k]


@numba.njit(**PART, error_model="numpy")
def keep_measured(v: Float32, gain: Float32) -> None:
    """Set samples that are not finite, or without light, to 0, and their gain to 0, else to 1."""
    for k in range(TILE):
        measured = gain[k] > 0 and abs(v[k]) < np.float32(np.inf)
        v[k] = v[k] if measured else np.float32(0)
        gain[k] = np.float32(1) if measured else np.float32(0)


@numba.njit(**INLINED, fastmath=_FAST, error_model="numpy")
def irradiance(
    out: Float32, px: Float32, py: Float32, pz: Float32, position: Float32, axis: Float32,
    reference: float, mu: float,
) -> None:  # fmt: skip
    """Write the factor of the vectors from points to an LED, as `LightModel` does; 0 if dark."""
    qx, qy, qz, ax, ay, az = position[0], position[1], position[2], axis[0], axis[1], axis[2]
    full, zero = np.float32(reference), np.float32(0)
    for k in range(TILE):
        x, y, z = qx - px[k], qy - py[k], qz - pz[k]
        distance2 = x * x + y * y + z * z
        cosine = -(x * ax + y * ay + z * az) / np.sqrt(distance2)
        out[k] = max(cosine, zero)
    if mu == 0.0:
        for k in range(TILE):
            out[k] = np.float32(1) if out[k] > zero else zero
    elif mu != 1.0:
        for k in range(TILE):
            out[k] = np.float32(float(out[k]) ** mu)
    for k in range(TILE):
        x, y, z = qx - px[k], qy - py[k], qz - pz[k]
        distance2 = x * x + y * y + z * z
        out[k] *= full / (distance2 * np.sqrt(distance2))


@numba.njit(**INLINED, fastmath=_FAST, error_model="numpy")
def toward(out: Float32, p: Float32, q: np.float32, gain: Float32) -> None:
    """Write one component of light vectors."""
    for k in range(TILE):
        out[k] = (q - p[k]) * gain[k]


@numba.njit(**PART, error_model="numpy")
def invert(sums: Float32) -> None:
    """Replace the sums a00, a01, a02, a11, a12, a22 by the inverse; NaN if ill-conditioned."""
    for k in range(TILE):
        a00, a01, a02 = float(sums[0, k]), float(sums[1, k]), float(sums[2, k])
        a11, a12, a22 = float(sums[3, k]), float(sums[4, k]), float(sums[5, k])
        c00, c01, c02 = a11 * a22 - a12 * a12, a02 * a12 - a01 * a22, a01 * a12 - a02 * a11
        c11, c12, c22 = a00 * a22 - a02 * a02, a01 * a02 - a00 * a12, a00 * a11 - a01 * a01
        determinant = a00 * c00 + a01 * c01 + a02 * c02
        trace = a00 + a11 + a22
        per = 1.0 / determinant if determinant > _LEAST_DETERMINANT * trace**3 else math.nan
        sums[0, k], sums[1, k], sums[2, k] = c00 * per, c01 * per, c02 * per
        sums[3, k], sums[4, k], sums[5, k] = c11 * per, c12 * per, c22 * per
