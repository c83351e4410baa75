"""Normal of one pixel under a family of isotropic reflectances, compiled."""

from __future__ import annotations

import math

import numba
import numpy as np

from processing.stereo.cauchy import FEW_SAMPLES
from processing.stereo.pixel_algebra import ANY_ORDER, IN_PLACE, ranked
from rig.arrays import Float32, Float64

# Compiled in: processing/stereo/cauchy.py 151ecc5dcb15
# Compiled in: processing/stereo/pixel_algebra.py f495374b06dc

# The family, from coarse to fine: the lobe (h . n)^2, GGX lobes by their width, and no lobe.
_SQUARE, _MATTE = 0.0, -1.0
_FAMILY = (_SQUARE, 0.5, 0.25, 0.1, _MATTE)
# The member with a coat that the light of the matte part passes. With coats on all GGX members,
# normals of a real object (DiLiGenT's bear) are 0.3 degree worse.
_COAT = 0.25
# Shares of the members before the samples are seen. Narrow lobes explain deviations of few samples.
_PRIOR = (2.0, 1.0, 0.15, 1.0, 2.0)
# Power of the reciprocal spread by which a member counts: the likelihood of 4 independent samples,
# because residuals of a reflectance that is not in the family are alike for neighbouring lights.
_POWER = 4
# With fewer samples no lobe is fitted.
_FEWEST = 8
_STEPS = 3
# The first member begins at a solution that may be far away.
_FIRST_STEPS = 4
# Samples up to this multiple of the spread of the given solution show the first member.
_CUT = 4.0
# Scale of the weights of Cauchy, as a multiple of the median deviation of many samples.
_CAUCHY = 2.0
# The spread of samples without noise, relative to the albedo.
_LEAST_SPREAD = 1e-4
# Nearly collinear strengths are drawn toward 0, steps of the normal shortened.
_RIDGE, _DAMPING = 1e-6, 1e-4
_LONGEST_STEP = 0.2  # rad
_LEAST_Z = 0.02


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
def _terms(
    count: int, usable: Float32, half: Float32, width: np.float32,
    n0: np.float32, n1: np.float32, n2: np.float32, terms: Float32,
) -> None:  # fmt: skip
    """Write the matte term, the lobe, its derivatives by l . n and h . n, and that of the matte."""
    lx, ly, lz = usable[1], usable[2], usable[3]
    hx, hy, hz = half[0], half[1], half[2]
    zero, one, two, four = np.float32(0), np.float32(1), np.float32(2), np.float32(4)
    for k in range(count):
        shading = lx[k] * n0 + ly[k] * n1 + lz[k] * n2
        terms[0, k] = max(shading, zero)
        terms[4, k] = one if shading > zero else zero
        terms[5, k] = max(hx[k] * n0 + hy[k] * n1 + hz[k] * n2, zero)
    if width == np.float32(_MATTE):
        for k in range(count):
            terms[1, k] = terms[2, k] = terms[3, k] = zero
    elif width == np.float32(_SQUARE):
        for k in range(count):
            shading, along = terms[0, k], terms[5, k]
            terms[1, k] = shading * along * along
            terms[2, k] = terms[4, k] * along * along
            terms[3, k] = two * along * shading
    else:
        a2 = width * width
        rest = one - a2
        for k in range(count):
            shading, along = terms[0, k], terms[5, k]
            root = np.sqrt(a2 + rest * shading * shading)
            per = one / ((shading + root) * (shading + root) * root)
            seen = two * shading * root * (shading + root) * per
            inverse = one / (one - rest * along * along)
            lobe = a2 * inverse
            lobe *= lobe
            terms[1, k] = seen * lobe
            terms[2, k] = two * terms[4, k] * a2 * per * lobe
            terms[3, k] = seen * lobe * four * rest * along * inverse
    if width == np.float32(_COAT):
        for k in range(count):
            shading = terms[0, k]
            beside = max(one - shading, zero)
            fourth = beside * beside
            fourth *= fourth
            terms[0, k] = shading * (one - fourth * beside)
            terms[4, k] *= one - fourth * (beside - np.float32(5) * shading)


@numba.njit(**IN_PLACE, error_model="numpy", fastmath=ANY_ORDER)
def _strengths(
    count: int, v: Float32, terms: Float32, weight: Float32, free: bool
) -> tuple[float, float]:
    """Return the strengths of the matte term and the lobe; not negative unless they are free."""
    a, b = terms[0], terms[1]
    aa = ab = bb = av = bv = 0.0
    for k in range(count):
        wa, wb = weight[k] * a[k], weight[k] * b[k]
        aa += wa * a[k]
        ab += wa * b[k]
        bb += wb * b[k]
        av += wa * v[k]
        bv += wb * v[k]
    aa += _RIDGE * aa
    bb += _RIDGE * aa
    determinant = aa * bb - ab * ab
    c0, c1 = (bb * av - ab * bv) / determinant, (aa * bv - ab * av) / determinant
    if free or (c0 >= 0 and c1 >= 0):
        return c0, c1
    c0, c1 = max(av / aa, 0.0), max(bv / bb, 0.0)
    return (c0, 0.0) if c0 * av > c1 * bv else (0.0, c1)


@numba.njit(**IN_PLACE, error_model="numpy", fastmath=ANY_ORDER)
def _linearized(
    count: int, usable: Float32, half: Float32, terms: Float32, c0: np.float32, c1: np.float32,
    t0: np.float32, t1: np.float32, t2: np.float32, s0: np.float32, s1: np.float32, s2: np.float32,
    model: Float32,
) -> None:  # fmt: skip
    """Write the derivatives by the steps along t and s, the residuals, and ``|r|``."""
    v, lx, ly, lz = usable[0], usable[1], usable[2], usable[3]
    hx, hy, hz = half[0], half[1], half[2]
    for k in range(count):
        by_shading = c0 * terms[4, k] + c1 * terms[2, k]
        by_along = c1 * terms[3, k]
        model[0, k] = by_shading * (lx[k] * t0 + ly[k] * t1 + lz[k] * t2)
        model[0, k] += by_along * (hx[k] * t0 + hy[k] * t1 + hz[k] * t2)
        model[1, k] = by_shading * (lx[k] * s0 + ly[k] * s1 + lz[k] * s2)
        model[1, k] += by_along * (hx[k] * s0 + hy[k] * s1 + hz[k] * s2)
        residual = v[k] - c0 * terms[0, k] - c1 * terms[1, k]
        model[2, k] = residual
        model[3, k] = abs(residual)


@numba.njit(**IN_PLACE, fastmath=ANY_ORDER)
def _normal_equations(
    count: int, terms: Float32, model: Float32, weight: Float32, gram: Float64
) -> None:
    """Write the lower triangle of the weighted 4 x 4 matrix, and the right-hand side as row 4."""
    a, b, c, d, r = terms[0], terms[1], model[0], model[1], model[2]
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
    count: int, usable: Float32, view: Float32, spread: np.float32, scratch: Float32,
    gram: Float64, m0: float, m1: float, m2: float,
) -> tuple[float, float, float]:  # fmt: skip
    """Return the mean normal of a family of reflectances, times the albedo that fits best.

    Each member is ``v = c0 max(l . n, 0) + c1 s(l . n) D(h . n)`` with the half vector h between
    light and camera: a matte part and a lobe. D is the distribution of GGX of one width, and s its
    shadowing by Smith, in the separable form, times l . n (Walter et al., 2007). The matte part of
    one member is below a coat, which less light passes that comes from the side:
    ``1 - (1 - l . n)^5`` of it (Schlick, 1994). What depends only on normal and camera is part of
    c0 and c1. A member begins at the normal of the one before; its steps
    are those of Gauss and Newton with robust weights, where c0 and c1 are eliminated. The normals
    are averaged with weights from the spreads of the residuals, so that noise, which would
    select among members that explain the samples alike, does not decide.

    Parameters
    ----------
    count, usable
        Samples that show light, see `usable_samples`, in a unit in which the albedo is about 1.
    view
        ``(3,)`` unit vector toward the camera.
    spread
        Spread of the residuals of the given solution.
    scratch
        ``(14, N)`` or more.
    gram
        ``(5, 4)``.
    m0, m1, m2
        A Lambertian solution, not 0.
    """
    weight, terms, model, half = scratch[0], scratch[1:7], scratch[7:11], scratch[11:14]
    v, residual = usable[0], model[3]
    one, zero, least = np.float32(1), np.float32(0), np.float32(_LEAST_SPREAD)
    _half_vectors(count, usable, view, half)
    length = math.sqrt(m0 * m0 + m1 * m1 + m2 * m2)
    n0, n1, n2 = m0 / length, m1 / length, m2 / length
    limit = np.float32(_CUT) * (spread + least)
    for k in range(count):
        shading = max(usable[1, k] * m0 + usable[2, k] * m1 + usable[3, k] * m2, 0.0)
        weight[k] = one if abs(v[k] - shading) <= limit else zero
    middle, guess = count // 2, max(spread, least)
    scale = np.float32(_CAUCHY * (1.0 + FEW_SAMPLES / max(count - 3, 1)))
    sum0 = sum1 = sum2 = c0 = 0.0
    first = 0 if count >= _FEWEST else len(_FAMILY) - 1
    for member in range(first, len(_FAMILY)):
        width = _FAMILY[member]
        k0, k1, k2 = n0, n1, n2
        if member > first:
            weight[:count] = one
        for _ in range(_FIRST_STEPS if member == first else _STEPS):
            # Two unit vectors that are perpendicular to the normal, which does not face away.
            turn = 1.0 / (1.0 + n2)
            t0, t1, t2 = 1.0 - n0 * n0 * turn, -n0 * n1 * turn, -n0
            s0, s1, s2 = t1, 1.0 - n1 * n1 * turn, -n1
            _terms(
                count, usable, half, np.float32(width),
                np.float32(n0), np.float32(n1), np.float32(n2), terms,
            )  # fmt: skip
            c0, c1 = _strengths(count, v, terms, weight, width <= 0)
            _linearized(
                count, usable, half, terms, np.float32(c0), np.float32(c1),
                np.float32(t0), np.float32(t1), np.float32(t2),
                np.float32(s0), np.float32(s1), np.float32(s2),
                model,
            )  # fmt: skip
            guess = ranked(residual, count, middle, max(guess, np.float32(1e-5)))
            per = one / (scale * (guess + least))
            for k in range(count):
                ratio = residual[k] * per
                weight[k] = one / (one + ratio * ratio)
            _normal_equations(count, terms, model, weight, gram)
            gram[1, 1] += _RIDGE * gram[0, 0]
            damping = _DAMPING * (gram[0, 0] + gram[2, 2] + gram[3, 3])
            gram[2, 2] += damping
            gram[3, 3] += damping
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
        if not math.isfinite(n0 + n1 + n2 + guess):
            n0, n1, n2, guess = k0, k1, k2, max(spread, least)
            continue
        share = _PRIOR[member] / float(guess + least) ** _POWER
        sum0 += share * n0
        sum1 += share * n1
        sum2 += share * n2
    length = math.sqrt(sum0 * sum0 + sum1 * sum1 + sum2 * sum2)
    n0, n1, n2 = sum0 / length, sum1 / length, sum2 / length
    # The last member is matte: samples above it are gloss.
    albedo, per = c0, one / (guess + least)
    for _ in range(_STEPS):
        along = across = 0.0
        for k in range(count):
            shading = max(usable[1, k] * n0 + usable[2, k] * n1 + usable[3, k] * n2, 0.0)
            ratio = (v[k] - albedo * shading) * per
            of_sample = shading / (1.0 + ratio * ratio)
            along += of_sample * v[k]
            across += of_sample * shading
        albedo = along / across
    if not (albedo > 0 and math.isfinite(n0 + n1 + n2 + albedo)):
        return m0, m1, m2
    return n0 * albedo, n1 * albedo, n2 * albedo
