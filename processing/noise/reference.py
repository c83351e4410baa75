"""The reference solution of a pixel: weighted least squares over its lit samples, compiled."""

from __future__ import annotations

import math

import numba
import numpy as np

from processing.noise.light_table import distant_variances, near_variances
from processing.noise.reflectance_residual import reflectance_left
from processing.noise.sample_judgement import (
    ATTACHED,
    CAST,
    LIT,
    SATURATED,
    all_agree,
    count_kinds,
    judged,
    normalised_residuals,
    predicted,
    usable_parts,
)
from processing.noise.tangents import (
    squared_angle,
    tangent_change,
    tangent_part,
    tangent_trace,
)
from processing.noise.tile_light_errors import (
    add_light_errors,
    write_light_errors,
    write_parts,
)
from processing.noise.tile_reference import (
    APART,
    DARK,
    MOVED2,
    NOT_NOISE,
    ROW,
    SETTLED,
    STATE,
    TILE,
    add_lights,
    add_products,
    load,
    move,
    ordinary,
    product,
    write_residuals,
    write_shared,
)
from processing.stereo.pixel_algebra import IN_PLACE, MAX_CONDITION, normal_equations
from rig.arrays import Float32, Float64, Int64, Intp, UInt8, UInt16

# Compiled in: processing/noise/light_table.py 8ba33af6bb6d
# Compiled in: processing/noise/reflectance_residual.py a2f7b5920652
# Compiled in: processing/noise/sample_judgement.py 3c5168b67e78
# Compiled in: processing/noise/tangents.py b051631d90b8
# Compiled in: processing/noise/tile_light_errors.py 58a6b26845da
# Compiled in: processing/noise/tile_reference.py 32f37d79f34b
# Compiled in: processing/stereo/pixel_algebra.py f495374b06dc

_STEPS = 4
# As in `pixel_algebra`: trace(A) trace(A^-1) is at most 9 times the squared condition number.
_CONDITION2 = 9.0 * MAX_CONDITION**2
_LEAST_DETERMINANT = 1 / (3**3 * _CONDITION2**2)
# Variances by noise, lights and height, squared angle to the given solution, sum of squares of the
# normalised residuals, their degrees of freedom, what a reflectance leaves of the sum, sum of the
# products with the residuals of a neighbour, and their degrees of freedom.
PARTS = 9


@numba.njit(**IN_PLACE, error_model="numpy")
def _inverted(sums: Float64, inverse: Float64) -> bool:
    """Write the inverse of a symmetric matrix; return False if it is ill-conditioned."""
    a00, a01, a02, a11, a12, a22 = sums[0], sums[1], sums[2], sums[3], sums[4], sums[5]
    c00 = a11 * a22 - a12 * a12
    c01 = a02 * a12 - a01 * a22
    c02 = a01 * a12 - a02 * a11
    c11 = a00 * a22 - a02 * a02
    c12 = a01 * a02 - a00 * a12
    c22 = a00 * a11 - a01 * a01
    determinant = a00 * c00 + a01 * c01 + a02 * c02
    trace = a00 + a11 + a22
    if not (
        trace * (c00 + c11 + c22) < _CONDITION2 * determinant
        and determinant > _LEAST_DETERMINANT * trace**3
    ):
        return False
    inverse[0], inverse[1], inverse[2] = c00 / determinant, c01 / determinant, c02 / determinant
    inverse[3], inverse[4], inverse[5] = c11 / determinant, c12 / determinant, c22 / determinant
    return True


@numba.njit(**IN_PLACE, error_model="numpy")
def _light_errors(
    count: int, samples: Float32, index: Int64, vectors: Float32, table: Float32,
    near: bool, point: Float64, view: Float64, m: Float64, scratch: Float32,
) -> None:  # fmt: skip
    """Write the variances by the errors of the lights, and the changes by a rise of the object."""
    if near:
        near_variances(table, vectors, point, view, m, scratch[0], scratch[1])
        for k in range(count):
            samples[7, k] = scratch[1, index[k]]
    else:
        distant_variances(table, vectors, m, scratch[0])
    for k in range(count):
        samples[6, k] = scratch[0, index[k]]


@numba.njit(inline="always")
def _pixel(
    values: Float32, vectors: Float32, law: Float32, start: Float64, least: np.float32,
    table: Float32, errors: bool, near: bool, point: Float64, view: Float64,
    samples: Float32, scratch: Float32, index: Int64, work: Float64, kinds: UInt8,
    residuals: Float32, reference: Float64, parts: Float32,
) -> bool:  # fmt: skip
    """Solve one pixel, see `reference_solutions`; return whether its lit lights determine it."""
    m, sums, inverse, inner = work[0:3], work[3:12], work[12:18], work[18:24]
    length = math.sqrt(start[0] ** 2 + start[1] ** 2 + start[2] ** 2)
    per = 1.0 / length
    m[0], m[1], m[2] = start[0] * per, start[1] * per, start[2] * per
    count, mean = usable_parts(values, vectors, law, per, samples, index, kinds)
    v = samples[0]
    shading, variance, distance, weight = scratch[0], scratch[1], scratch[2], scratch[3]
    dark = np.float32(DARK * mean)
    one = np.float32(1)
    scale, lit, moved = one, 0, False
    for step in range(_STEPS):
        if errors and (step == 0 or (step == 1 and moved)):
            _light_errors(count, samples, index, vectors, table, near, point, view, m, scratch)
        agreeing = predicted(count, samples, m, shading, variance, distance)
        if agreeing == count and least == one:
            # Whatever the scale is.
            limit = dark if step == 0 else np.float32(-np.inf)
            lit, dim = all_agree(count, v, limit, scratch, index, kinds)
        else:
            scale, lit, dim = judged(count, v, dark, step, least, scale, scratch, index, kinds)
        if lit < 3:
            return False
        sums[:] = normal_equations(count, samples, weight)
        if not _inverted(sums, inverse):
            for k in range(count):
                if kinds[index[k]] == LIT and v[k] <= dark:
                    kinds[index[k]] = CAST
            return False
        x = inverse[0] * sums[6] + inverse[1] * sums[7] + inverse[2] * sums[8]
        y = inverse[1] * sums[6] + inverse[3] * sums[7] + inverse[4] * sums[8]
        z = inverse[2] * sums[6] + inverse[4] * sums[7] + inverse[5] * sums[8]
        change2 = (x - m[0]) ** 2 + (y - m[1]) ** 2 + (z - m[2]) ** 2
        m[0], m[1], m[2] = x, y, z
        moved = change2 > MOVED2
        size2 = SETTLED * (inverse[0] + inverse[3] + inverse[5])
        if dim == 0 and change2 <= size2:
            break
    length2 = m[0] * m[0] + m[1] * m[1] + m[2] * m[2]
    if not length2 > 0:
        return False
    total = tangent_part(inverse, m, length2) / length2
    of_lights = of_height = 0.0
    if errors and near:
        b0 = b1 = b2 = 0.0
        for k in range(count):
            b0 += weight[k] * samples[1, k] * samples[7, k]
            b1 += weight[k] * samples[2, k] * samples[7, k]
            b2 += weight[k] * samples[3, k] * samples[7, k]
        of_height = tangent_change(inverse, m, b0, b1, b2) / length2
    chi2 = normalised_residuals(count, v, scratch, index, residuals)
    if errors:
        for k in range(count):
            weight[k] *= weight[k] * samples[6, k]
        sums[:] = normal_equations(count, samples, weight)
        for i in range(6):
            inner[i] = sums[i]
        of_lights = min(tangent_trace(inverse, m, inner) / length2, total)
    reference[0], reference[1], reference[2] = m[0] * length, m[1] * length, m[2] * length
    parts[0], parts[1], parts[2] = total - of_lights, of_lights, of_height
    free, away2 = lit - 3.0, squared_angle(m, start, length2)
    parts[3], parts[4], parts[5], parts[6] = away2, chi2, free, chi2
    if away2 > total and chi2 > free + NOT_NOISE * math.sqrt(2 * free):
        left = reflectance_left(count, samples, kinds, index, start, point, view, near, scratch)
        parts[6] = min(chi2, left * free)
    return True


@numba.njit(inline="always")
def _solve_row(
    first: int, last: int,
    values: Float32, vectors: Float32, law: Float32, normals: Float32, albedo: Float32,
    least: np.float32, table: Float32, errors: bool, near: bool, points: Float64, view: Float64,
    places: Intp, samples: Float32, scratch: Float32, index: Int64,
    work: Float64, start: Float64, rows: Float32, state: Float32, residuals: Float32,
    own_kinds: UInt8, kinds: UInt8, counts: UInt16, reference: Float64, parts: Float32,
) -> None:  # fmt: skip
    """Solve the pixels of a row of the image, tile by tile."""
    lights = values.shape[1]
    quick = least == np.float32(1) and len(kinds) == 0
    for begin in range(first, last, TILE):
        count = min(TILE, last - begin)
        load(begin, count, values, vectors, law, normals, albedo, places, rows, state)
        if quick and errors:
            write_light_errors(begin, count, near, table, points, view, places, rows, state)
        if quick:
            add_lights(count, rows, state, work)
        if quick and errors:
            if move(count, state, work):
                add_lights(count, rows, state, work)
            add_light_errors(rows, state)
        for k in range(count):
            p = begin + k
            at = places[p]
            for c in range(3):
                start[c] = normals[at, c] * albedo[at]
            lit = ordinary(state, k, start, work, reference[p], parts[p]) if quick else 0
            if lit:
                if errors:
                    write_parts(state, k, work, parts[p])
                counts[p, LIT], counts[p, ATTACHED] = lit, lights - lit
                continue
            of_pixel = kinds[p] if len(kinds) else own_kinds
            good = False
            residuals[:] = 0
            if start[0] != 0.0 or start[1] != 0.0 or start[2] != 0.0:
                good = _pixel(
                    values[p], vectors[p if len(vectors) > 1 else 0],
                    law[p if len(law) > 1 else 0], start, least, table, errors, near,
                    points[at if near else 0], view, samples, scratch, index, work, of_pixel,
                    residuals, reference[p], parts[p],
                )  # fmt: skip
            else:
                for i in range(lights):
                    measured = math.isfinite(values[p, i])
                    of_pixel[i] = CAST if measured else SATURATED
            count_kinds(of_pixel, counts[p])
            if not good:
                reference[p] = np.nan
                residuals[:] = 0
            write_residuals(rows, k, residuals)
        add_products(rows, state)
        for p in range(max(begin, first + APART), begin + count):
            if places[p - APART] == places[p] - APART and not math.isnan(reference[p, 0]):
                parts[p, 7] = product(state, p - begin)
                parts[p, 8] = parts[p, 5]


@numba.njit(nogil=True, cache=True, error_model="numpy")
def reference_solutions(
    first_row: int, last_row: int,
    values: Float32, vectors: Float32, law: Float32, normals: Float32, albedo: Float32,
    least: np.float32, table: Float32, errors: bool, near: bool, points: Float64, view: Float64,
    places: Intp, rows: Intp, kinds: UInt8,
    counts: UInt16, reference: Float64, parts: Float32,
) -> None:  # fmt: skip
    """Solve pixels from given solutions, and classify their samples.

    Parameters
    ----------
    first_row, last_row
        The rows of pixels to solve, without the last one.
    values, vectors, law
        As for an `Estimator`.
    normals, albedo
        The given solutions of all pixels of the image, ``(M, 3)`` and ``(M,)``; 0 for pixels that
        are not solved.
    least
        Least scale of the deviations: 1 if the law is that of the noise.
    table
        `light_table` of the N lights.
    errors
        Whether lights or height have errors.
    near, points
        Whether lights are near, and the points ``(M, 3)`` of all pixels.
    view
        Centre of the camera, 0 if it is far away in direction z, and the relative standard
        deviation of the depths.
    places
        ``(P,)`` flat indices of the pixels in the image, which show neighbours.
    rows
        ``(R + 1,)`` where each row of the image begins in the list of pixels, and its length.
    kinds
        ``(P, N)``, receives the values of `SampleKind`; ``(0, N)`` if only their numbers are
        wanted, and ordinary pixels are solved several at once then.
    counts
        ``(P, 6)``, receives their numbers.
    reference
        ``(P, 3)``, receives the scaled normals; NaN if the lit lights do not determine the pixel.
    parts
        ``(P, 9)``, receives what `PARTS` lists, variances and angles in rad^2; 0 in that case.
    """
    lights = values.shape[1]
    samples, scratch = np.zeros((8, lights), np.float32), np.zeros((4, lights), np.float32)
    residuals, own_kinds = np.zeros(lights, np.float32), np.zeros(lights, np.uint8)
    index = np.zeros(lights, np.int64)
    work, start = np.zeros(24), np.zeros(3)
    of_lights, state = np.zeros((lights, ROW), np.float32), np.zeros(STATE, np.float32)
    write_shared(vectors, law, of_lights)
    for row in range(first_row, last_row):
        _solve_row(
            rows[row], rows[row + 1], values, vectors, law, normals, albedo, least, table, errors,
            near, points, view, places, samples, scratch, index, work, start, of_lights, state,
            residuals, own_kinds, kinds, counts, reference, parts,
        )  # fmt: skip
