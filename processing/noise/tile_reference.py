"""Reference solutions of ordinary pixels, several at once, compiled.

A pixel is ordinary if all its samples are there and agree with the given solution, which is so near
to the reference that one step reaches it. The loops over the pixels of a tile have a constant
length, and all numbers of a light are in one row of one array, so that they vectorise: a pixel has
the same bits wherever in a tile it is.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from processing.noise.tangents import squared_angle, tangent_part
from processing.stereo.pixel_algebra import IN_PLACE
from rig.arrays import Float32, Float64, Intp

# Compiled in: processing/noise/tangents.py b051631d90b8
# Compiled in: processing/stereo/pixel_algebra.py f495374b06dc

# Pixels of a tile.
TILE = 32
# Pixels between neighbours whose residuals are compared: demosaicing makes the noise of closer ones
# similar.
APART = 4
# Elements of a row of one light: vector, sample, variance without light and per value, variance by
# the errors of the light, change by the height, normalised residuals, those of the pixels before
# the tile first.
BY_LIGHTS, HIGHER = 6, 7
ROW = 9 * TILE + APART
_RESIDUALS = 8 * TILE
# Parts of the state of the pixels: given solution, solution without dark samples, least variance,
# limit of dark samples, and whether all samples are there; sums of the matrix (6) and of its
# right-hand side (3); sum of squares and number of the residuals of lit samples, number of dark
# ones, largest square of all, sum of products with the residuals of a neighbour, and what the
# errors of the lights need (12).
_OTHER, LEAST, _DARK, _COMPLETE, _SUMS = 3, 6, 7, 8, 9
_CHI2, _LIT, _DIM, _WORST, _PRODUCTS, OF_ERRORS = 18, 19, 20, 21, 22, 23
STATE = 35 * TILE
# Samples below this share of the mean may be in a shadow; only the first step needs it.
DARK = 0.05
# Distances beyond this square do not agree, see `judged_samples`.
_CUT2 = np.float32(16)
# Least variance relative to the square of the albedo: exact data have no noise.
_LEAST_VARIANCE = 1e-12
# Squares of other albedos are not safe in float32.
_ALBEDOS2 = (1e-12, 1e12)
# Largest trace(A) trace(A^-1) of normal equations in float32; a dome has 20 to 70.
_MOST_CONDITION = 1000.0
# The solution is settled if the square of its change is below this share of its variance.
SETTLED = 0.01
# The errors of the lights are those at the given solution, or at one that is further away than 1
# degree from it.
MOVED2 = 3e-4
# Residuals beyond this many standard deviations of their sum of squares are not noise.
NOT_NOISE = 4.0

_FAST = {"contract", "nsz"}


@numba.njit(**IN_PLACE, error_model="numpy", fastmath=_FAST)
def _add_light(row: Float32, state: Float32) -> None:
    """Add the samples of one light to the sums, and write their residuals."""
    zero, one = np.float32(0), np.float32(1)
    for k in range(TILE):
        x, y, z, v = row[k], row[TILE + k], row[2 * TILE + k], row[3 * TILE + k]
        shading = x * state[k] + y * state[TILE + k] + z * state[2 * TILE + k]
        light = max(shading, zero)
        variance = row[4 * TILE + k] + row[5 * TILE + k] * light + state[LEAST * TILE + k]
        variance += row[BY_LIGHTS * TILE + k]
        per = one / np.sqrt(variance)
        difference = v - light
        distance = difference * per
        square = distance * distance
        lit = shading > zero
        weight = per * per if lit else zero
        wx, wy, wz, wd = weight * x, weight * y, weight * z, weight * difference
        state[_SUMS * TILE + k] += wx * x
        state[(_SUMS + 1) * TILE + k] += wx * y
        state[(_SUMS + 2) * TILE + k] += wx * z
        state[(_SUMS + 3) * TILE + k] += wy * y
        state[(_SUMS + 4) * TILE + k] += wy * z
        state[(_SUMS + 5) * TILE + k] += wz * z
        state[(_SUMS + 6) * TILE + k] += wd * x
        state[(_SUMS + 7) * TILE + k] += wd * y
        state[(_SUMS + 8) * TILE + k] += wd * z
        state[_CHI2 * TILE + k] += square if lit else zero
        state[_LIT * TILE + k] += one if lit else zero
        state[_DIM * TILE + k] += one if lit & (v <= state[_DARK * TILE + k]) else zero
        state[_WORST * TILE + k] = max(state[_WORST * TILE + k], square)
        row[_RESIDUALS + APART + k] = distance if lit else zero


@numba.njit(**IN_PLACE, error_model="numpy", fastmath=_FAST)
def _compare(row: Float32, state: Float32) -> None:
    """Compare the samples of one light with the solutions without dark samples.

    Samples that are lit by one solution only do not agree.
    """
    zero, one = np.float32(0), np.float32(1)
    for k in range(TILE):
        x, y, z = row[k], row[TILE + k], row[2 * TILE + k]
        shading = x * state[k] + y * state[TILE + k] + z * state[2 * TILE + k]
        other = x * state[_OTHER * TILE + k]
        other += y * state[(_OTHER + 1) * TILE + k] + z * state[(_OTHER + 2) * TILE + k]
        light = max(other, zero)
        variance = row[4 * TILE + k] + row[5 * TILE + k] * light + state[LEAST * TILE + k]
        variance += row[BY_LIGHTS * TILE + k]
        difference = row[3 * TILE + k] - light
        square = difference * difference / variance
        square += _CUT2 + one if (shading > zero) != (other > zero) else zero
        state[_WORST * TILE + k] = max(state[_WORST * TILE + k], square)


@numba.njit(**IN_PLACE, error_model="numpy", fastmath=_FAST)
def _add_products(row: Float32, state: Float32) -> None:
    for k in range(TILE):
        state[_PRODUCTS * TILE + k] += row[_RESIDUALS + APART + k] * row[_RESIDUALS + k]


@numba.njit(**IN_PLACE, error_model="numpy")
def write_shared(vectors: Float32, law: Float32, rows: Float32) -> None:
    """Write the light vectors and the law of the noise, if all pixels share them."""
    for i in range(len(rows)):
        for k in range(TILE):
            for c in range(3):
                rows[i, c * TILE + k] = vectors[0, c, i]
            rows[i, 4 * TILE + k], rows[i, 5 * TILE + k] = law[0, 0, i], law[0, 1, i]


@numba.njit(**IN_PLACE, error_model="numpy")
def load(
    first: int, count: int, values: Float32, vectors: Float32, law: Float32, normals: Float32,
    albedo: Float32, places: Intp, rows: Float32, state: Float32,
) -> None:  # fmt: skip
    """Write the pixels from ``first`` on into a tile; see `reference_solutions`."""
    state[:] = 0
    for k in range(count):
        p = first + k
        at = places[p]
        length2 = 0.0
        for c in range(3):
            part = normals[at, c] * albedo[at]
            state[c * TILE + k] = state[(_OTHER + c) * TILE + k] = part
            length2 += float(part) ** 2
        state[LEAST * TILE + k] = _LEAST_VARIANCE * length2
        mean = np.float32(0)
        complete = np.int32(length2 > _ALBEDOS2[0]) & np.int32(length2 < _ALBEDOS2[1])
        for i in range(len(rows)):
            sample = values[p, i]
            measured = np.int32(abs(sample) < np.float32(np.inf))
            complete &= measured
            rows[i, 3 * TILE + k] = sample if measured else np.float32(0)
            mean += max(rows[i, 3 * TILE + k], np.float32(0))
        state[_DARK * TILE + k] = DARK * mean / len(rows)
        state[_COMPLETE * TILE + k] = complete
    for i in range(len(rows)):
        for k in range(APART):
            rows[i, _RESIDUALS + k] = rows[i, _RESIDUALS + TILE + k]
        for c in range(3 if len(vectors) > 1 else 0):
            for k in range(count):
                rows[i, c * TILE + k] = vectors[first + k, c, i]
        for c in range(2 if len(law) > 1 else 0):
            for k in range(count):
                rows[i, (4 + c) * TILE + k] = law[first + k, c, i]


@numba.njit(**IN_PLACE, error_model="numpy")
def add_lights(count: int, rows: Float32, state: Float32, work: Float64) -> None:
    """Compute the sums and the residuals of the pixels of a tile at the given solutions.

    Where lit samples are dark, they must also agree with the solution without them: the given one
    may be wrong, and they are in shadow.
    """
    for i in range(len(rows)):
        _add_light(rows[i], state)
    again = False
    for k in range(count):
        if state[_DIM * TILE + k] > 0 and _agrees(state, k):
            again = True
            step, inverse, sums = work[0:3], work[3:9], work[9:18]
            _sums_without_dark(rows, state, k, sums)
            if _step(sums, step, inverse):
                for c in range(3):
                    state[(_OTHER + c) * TILE + k] += step[c]
            else:
                state[_COMPLETE * TILE + k] = 0
    for i in range(len(rows) if again else 0):
        _compare(rows[i], state)


@numba.njit(**IN_PLACE, error_model="numpy")
def _sums_of(state: Float32, k: int, sums: Float64) -> None:
    for s in range(9):
        sums[s] = state[(_SUMS + s) * TILE + k]


@numba.njit(**IN_PLACE, error_model="numpy")
def _sums_without_dark(rows: Float32, state: Float32, k: int, sums: Float64) -> None:
    """Write the sums of a pixel less those of its dark, lit samples."""
    _sums_of(state, k, sums)
    for i in range(len(rows)):
        v, distance = rows[i, 3 * TILE + k], rows[i, _RESIDUALS + APART + k]
        if v <= state[_DARK * TILE + k] and distance != 0:
            x, y, z = float(rows[i, k]), float(rows[i, TILE + k]), float(rows[i, 2 * TILE + k])
            light = x * state[k] + y * state[TILE + k] + z * state[2 * TILE + k]
            floor, slope = rows[i, 4 * TILE + k], rows[i, 5 * TILE + k]
            variance = floor + slope * light + state[LEAST * TILE + k]
            weight = 1.0 / (variance + rows[i, BY_LIGHTS * TILE + k])
            difference = v - light
            sums[0] -= weight * x * x
            sums[1] -= weight * x * y
            sums[2] -= weight * x * z
            sums[3] -= weight * y * y
            sums[4] -= weight * y * z
            sums[5] -= weight * z * z
            sums[6] -= weight * difference * x
            sums[7] -= weight * difference * y
            sums[8] -= weight * difference * z


@numba.njit(**IN_PLACE, error_model="numpy")
def _agrees(state: Float32, k: int) -> bool:
    """Return whether all samples of a pixel are there and agree; False for NaN."""
    usable = state[_LIT * TILE + k] >= 3 and state[_COMPLETE * TILE + k] > 0
    return bool(usable and state[_WORST * TILE + k] <= _CUT2)


@numba.njit(**IN_PLACE, error_model="numpy")
def _step(sums: Float64, step: Float64, inverse: Float64) -> bool:
    """Write the step to the solution of sums, and the inverse; False if it is not certain."""
    a00, a01, a02, a11, a12, a22 = sums[0], sums[1], sums[2], sums[3], sums[4], sums[5]
    b0, b1, b2 = sums[6], sums[7], sums[8]
    c00, c01, c02 = a11 * a22 - a12 * a12, a02 * a12 - a01 * a22, a01 * a12 - a02 * a11
    c11, c12, c22 = a00 * a22 - a02 * a02, a01 * a02 - a00 * a12, a00 * a11 - a01 * a01
    determinant = a00 * c00 + a01 * c01 + a02 * c02
    if not (a00 + a11 + a22) * (c00 + c11 + c22) < _MOST_CONDITION * determinant:
        return False
    per = 1.0 / determinant
    step[0] = (c00 * b0 + c01 * b1 + c02 * b2) * per
    step[1] = (c01 * b0 + c11 * b1 + c12 * b2) * per
    step[2] = (c02 * b0 + c12 * b1 + c22 * b2) * per
    inverse[0], inverse[1], inverse[2] = c00 * per, c01 * per, c02 * per
    inverse[3], inverse[4], inverse[5] = c11 * per, c12 * per, c22 * per
    return True


@numba.njit(**IN_PLACE, error_model="numpy")
def _settled(step: Float64, inverse: Float64) -> bool:
    change2 = step[0] ** 2 + step[1] ** 2 + step[2] ** 2
    return bool(change2 <= SETTLED * (inverse[0] + inverse[3] + inverse[5]))


@numba.njit(**IN_PLACE, error_model="numpy")
def move(count: int, state: Float32, work: Float64) -> bool:
    """Move pixels that are not settled by one step, and clear the sums; return whether any moved.

    A pixel that does not move has the same sums again.
    """
    step, inverse, sums = work[0:3], work[3:9], work[9:18]
    moved = False
    for k in range(count):
        if not _agrees(state, k):
            continue
        _sums_of(state, k, sums)
        if not _step(sums, step, inverse) or _settled(step, inverse):
            continue
        change2 = step[0] ** 2 + step[1] ** 2 + step[2] ** 2
        length2 = float(state[k]) ** 2 + state[TILE + k] ** 2 + state[2 * TILE + k] ** 2
        if change2 <= MOVED2 * length2:
            moved = True
            for c in range(3):
                state[c * TILE + k] += step[c]
                state[(_OTHER + c) * TILE + k] = state[c * TILE + k]
    if moved:
        state[_SUMS * TILE : _WORST * TILE] = 0
    return moved


@numba.njit(**IN_PLACE, error_model="numpy")
def add_products(rows: Float32, state: Float32) -> None:
    """Compute the products of the residuals with those of the pixel 4 places before."""
    for i in range(len(rows)):
        _add_products(rows[i], state)


@numba.njit(**IN_PLACE)
def product(state: Float32, k: int) -> float:
    """Return the sum of the products of a pixel of the tile."""
    return float(state[_PRODUCTS * TILE + k])


@numba.njit(**IN_PLACE)
def write_residuals(rows: Float32, k: int, residuals: Float32) -> None:
    """Replace the residuals of a pixel of the tile."""
    for i in range(len(rows)):
        rows[i, _RESIDUALS + APART + k] = residuals[i]


@numba.njit(**IN_PLACE, error_model="numpy")
def ordinary(
    state: Float32, k: int, given: Float64, work: Float64, reference: Float64, parts: Float32
) -> int:
    """Write the reference of a pixel of the tile and its variances, see `reference_solutions`.

    Return the number of lit samples, 0 if the pixel is not ordinary.
    """
    step, inverse, sums, m = work[0:3], work[3:9], work[9:18], work[21:24]
    if not _agrees(state, k):
        return 0
    _sums_of(state, k, sums)
    if not _step(sums, step, inverse) or not _settled(step, inverse):
        return 0
    for c in range(3):
        m[c] = state[c * TILE + k] + step[c]
    length2 = m[0] * m[0] + m[1] * m[1] + m[2] * m[2]
    total = tangent_part(inverse, m, length2) / length2
    lit = int(state[_LIT * TILE + k])
    chi2, free = float(state[_CHI2 * TILE + k]), lit - 3.0
    away2 = squared_angle(m, given, length2)
    if away2 > total and chi2 > free + NOT_NOISE * math.sqrt(2 * free):
        return 0
    reference[0], reference[1], reference[2] = m[0], m[1], m[2]
    parts[0], parts[3], parts[4], parts[5], parts[6] = total, away2, chi2, free, chi2
    return lit
