"""Normal and an isotropic reflectance of two coefficients, fitted to the samples of one pixel."""

from __future__ import annotations

import math

import numba
import numpy as np

from processing.stereo.pixel_algebra import ANY_ORDER, IN_PLACE, ranked
from rig.arrays import Float32, Float64

# Compiled in: processing/stereo/pixel_algebra.py c45e51bec347

_ITERATIONS = 12
# In the first iterations samples up to this multiple of the spread have weight 1, others 0.
_FIRST = 2
_CUT = 4.0
# Afterwards the weight is that of Cauchy, with this multiple of the spread as scale.
_CAUCHY = 2.0
_LEAST_SPREAD = 1e-4
_RIDGE = 1e-6
_LONGEST_STEP = 0.3
_LEAST_Z = 0.02
# The iteration ends at a step of 3e-4 rad (0.02 degree).
_STEP = 3e-4


@numba.njit(**IN_PLACE, error_model="numpy", fastmath=ANY_ORDER)
def _half_vectors(count: int, usable: Float32, view: Float32, half: Float32) -> None:
    """Write the unit vectors between the lights and the direction of the camera."""
    vx, vy, vz = view[0], view[1], view[2]
    for k in range(count):
        x, y, z = usable[1, k], usable[2, k], usable[3, k]
        distance = np.sqrt(x * x + y * y + z * z)
        x, y, z = x + vx * distance, y + vy * distance, z + vz * distance
        per = np.float32(1) / np.sqrt(x * x + y * y + z * z)
        half[0, k], half[1, k], half[2, k] = x * per, y * per, z * per


@numba.njit(**IN_PLACE, error_model="numpy", fastmath=ANY_ORDER)
def _linearized(
    count: int, usable: Float32, half: Float32,
    n0: np.float32, n1: np.float32, n2: np.float32, c0: np.float32, c1: np.float32,
    t0: np.float32, t1: np.float32, t2: np.float32, s0: np.float32, s1: np.float32, s2: np.float32,
    model: Float32,
) -> None:  # fmt: skip
    """Write the derivatives by c0, c1 and the steps along t and s, the residuals, and ``|r|``."""
    v, lx, ly, lz = usable[0], usable[1], usable[2], usable[3]
    hx, hy, hz = half[0], half[1], half[2]
    zero, two = np.float32(0), np.float32(2)
    for k in range(count):
        shading = max(lx[k] * n0 + ly[k] * n1 + lz[k] * n2, zero)
        along = hx[k] * n0 + hy[k] * n1 + hz[k] * n2
        lobe = along * along
        gloss = c0 + c1 * lobe
        residual = v[k] - shading * gloss
        lit = gloss if shading > zero else zero
        slope = two * c1 * along * shading
        model[0, k] = shading
        model[1, k] = shading * lobe
        model[2, k] = lit * (lx[k] * t0 + ly[k] * t1 + lz[k] * t2)
        model[2, k] += slope * (hx[k] * t0 + hy[k] * t1 + hz[k] * t2)
        model[3, k] = lit * (lx[k] * s0 + ly[k] * s1 + lz[k] * s2)
        model[3, k] += slope * (hx[k] * s0 + hy[k] * s1 + hz[k] * s2)
        model[4, k] = residual
        model[5, k] = abs(residual)


@numba.njit(**IN_PLACE, fastmath=ANY_ORDER)
def _normal_equations(count: int, model: Float32, weight: Float32, gram: Float64) -> None:
    """Write the lower triangle of the weighted 4 x 4 matrix, and the right-hand side as row 4."""
    a, b, c, d, r = model[0], model[1], model[2], model[3], model[4]
    g00 = g10 = g20 = g30 = g11 = g21 = g31 = g22 = g32 = g33 = 0.0
    r0 = r1 = r2 = r3 = 0.0
    for k in range(count):
        wa, wb, wc, wd = weight[k] * a[k], weight[k] * b[k], weight[k] * c[k], weight[k] * d[k]
        g00 += wa * a[k]
        g10 += wa * b[k]
        g20 += wa * c[k]
        g30 += wa * d[k]
        g11 += wb * b[k]
        g21 += wb * c[k]
        g31 += wb * d[k]
        g22 += wc * c[k]
        g32 += wc * d[k]
        g33 += wd * d[k]
        r0 += wa * r[k]
        r1 += wb * r[k]
        r2 += wc * r[k]
        r3 += wd * r[k]
    gram[0, 0], gram[1, 0], gram[2, 0], gram[3, 0] = g00, g10, g20, g30
    gram[1, 1], gram[2, 1], gram[3, 1] = g11, g21, g31
    gram[2, 2], gram[3, 2], gram[3, 3] = g22, g32, g33
    gram[4, 0], gram[4, 1], gram[4, 2], gram[4, 3] = r0, r1, r2, r3


@numba.njit(**IN_PLACE, error_model="numpy")
def _solve_in_place(gram: Float64) -> bool:
    """Replace row 4 by the solution (Cholesky); return False if the matrix is not definite."""
    for i in range(5):
        for j in range(min(i + 1, 4)):
            entry = gram[i, j]
            for k in range(j):
                entry -= gram[i, k] * gram[j, k]
            if i == j:
                if not entry > 0:
                    return False
                gram[i, i] = math.sqrt(entry)
            else:
                gram[i, j] = entry / gram[j, j]
    for i in range(3, -1, -1):
        for k in range(i + 1, 4):
            gram[4, i] -= gram[k, i] * gram[4, k]
        gram[4, i] /= gram[i, i]
    return True


@numba.njit(**IN_PLACE, error_model="numpy")
def reflectance_fit(
    count: int, usable: Float32, view: Float32, rank: int, spread: np.float32, scratch: Float32,
    gram: Float64, m0: float, m1: float, m2: float,
) -> tuple[float, float, float]:  # fmt: skip
    """Fit ``v = max(l . n, 0) (c0 + c1 (h . n)^2)`` from a Lambertian solution; return a new one.

    h is the half vector between light and camera. Each step is one of Gauss and Newton with robust
    weights (compare Shi et al., 2014, who use two bivariate polynomials).

    Parameters
    ----------
    count, usable
        Samples of one pixel, see `usable_samples`, in a unit in which the albedo is about 1.
    view
        ``(3,)`` unit vector toward the camera.
    rank, spread
        Rank and value of the deviation that limits the scale of the weights.
    scratch
        ``(10, N)`` or more.
    gram
        ``(5, 4)``.
    m0, m1, m2
        The Lambertian solution, not 0.

    Returns
    -------
    tuple
        Normal times the albedo that fits best.
    """
    weight, model, half = scratch[0], scratch[1:7], scratch[7:10]
    residual = model[5]
    one, zero = np.float32(1), np.float32(0)
    _half_vectors(count, usable, view, half)
    c0 = math.sqrt(m0 * m0 + m1 * m1 + m2 * m2)
    n0, n1, n2, c1 = m0 / c0, m1 / c0, m2 / c0, 0.0
    guess = spread
    for iteration in range(_ITERATIONS):
        # Two unit vectors that are perpendicular to the normal, which does not face away.
        turn = 1.0 / (1.0 + n2)
        t0, t1, t2 = 1.0 - n0 * n0 * turn, -n0 * n1 * turn, -n0
        s0, s1, s2 = t1, 1.0 - n1 * n1 * turn, -n1
        _linearized(
            count, usable, half,
            np.float32(n0), np.float32(n1), np.float32(n2), np.float32(c0), np.float32(c1),
            np.float32(t0), np.float32(t1), np.float32(t2),
            np.float32(s0), np.float32(s1), np.float32(s2),
            model,
        )  # fmt: skip
        if iteration < _FIRST:
            limit = np.float32(_CUT) * (spread + np.float32(_LEAST_SPREAD))
            for k in range(count):
                weight[k] = one if residual[k] <= limit else zero
        else:
            guess = ranked(residual, count, rank, max(guess, np.float32(1e-5)))
            per = one / (np.float32(_CAUCHY) * (min(guess, spread) + np.float32(_LEAST_SPREAD)))
            for k in range(count):
                ratio = residual[k] * per
                weight[k] = one / (one + ratio * ratio)
        _normal_equations(count, model, weight, gram)
        ridge = _RIDGE * gram[0, 0]
        for i in range(4):
            gram[i, i] += ridge
        gram[4, 1] -= ridge * c1
        if not _solve_in_place(gram):
            break
        along_t, along_s = gram[4, 2], gram[4, 3]
        size = math.sqrt(along_t * along_t + along_s * along_s)
        if size > _LONGEST_STEP:
            along_t, along_s = along_t * _LONGEST_STEP / size, along_s * _LONGEST_STEP / size
        n0 += along_t * t0 + along_s * s0
        n1 += along_t * t1 + along_s * s1
        n2 = max(n2 + along_t * t2 + along_s * s2, _LEAST_Z)
        length = math.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
        n0, n1, n2 = n0 / length, n1 / length, n2 / length
        c0 += gram[4, 0]
        c1 += gram[4, 1]
        if iteration > _FIRST and size < _STEP:
            break
    along = across = 0.0
    for k in range(count):
        shading = max(usable[1, k] * n0 + usable[2, k] * n1 + usable[3, k] * n2, 0.0)
        along += weight[k] * shading * usable[0, k]
        across += weight[k] * shading * shading
    albedo = along / across
    if not (albedo > 0 and math.isfinite(n0 + n1 + n2 + albedo)):
        return m0, m1, m2
    return n0 * albedo, n1 * albedo, n2 * albedo
