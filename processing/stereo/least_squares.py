"""Least squares over all usable samples of a pixel (Woodham, 1980)."""

from __future__ import annotations

import math

import numba
import numpy as np

from processing.stereo.pixel_algebra import (
    ANY_ORDER,
    IN_PLACE,
    reweighted,
    rms_residual,
    solved_pixels,
    usable_samples,
    weighted_solution,
)
from rig.arrays import Float32, Float64

# Compiled in: processing/stereo/pixel_algebra.py f495374b06dc


def least_squares(
    values: Float32, vectors: Float32, law: Float32 | None = None, view: Float32 | None = None
) -> tuple[Float64, Float64]:
    """Solve ``value = vector . m`` by least squares, attached shadows included.

    If the law of the noise is known, pixels whose residuals are noise are solved again with its
    weights, see `reweighted`.

    This is an `Estimator`; see there for the parameters and the result. The view has no effect.
    """
    # If all pixels share the lights, the inverse is the same for all pixels without a missing
    # sample.
    inverse = np.zeros((0, 3))
    if len(vectors) == 1:
        shared = vectors[0].astype(np.float64)
        inverse = np.ascontiguousarray(np.linalg.pinv(shared @ shared.T))
    return solved_pixels(_solve_pixels, values, vectors, law, inverse)


@numba.njit(**IN_PLACE, fastmath=ANY_ORDER)
def _sums(values: Float32, vectors: Float32) -> tuple[float, float, float, float]:
    """Return the sums of ``x v``, ``y v``, ``z v`` and ``v v``; NaN if a sample is missing."""
    bx = by = bz = vv = 0.0
    for i in range(len(values)):
        sample = np.float64(values[i])
        bx += vectors[0, i] * sample
        by += vectors[1, i] * sample
        bz += vectors[2, i] * sample
        vv += sample * sample
    return bx, by, bz, vv


@numba.njit(inline="always")
def _pixel(
    values: Float32, vectors: Float32, law: Float32, known: bool, inverse: Float64, usable: Float32,
    scratch: Float32,
) -> tuple[float, float, float, float]:  # fmt: skip
    """Return the scaled normal of one pixel and the rms residual."""
    if not known and len(inverse):
        b0, b1, b2, vv = _sums(values, vectors)
        if math.isfinite(vv):
            m0 = inverse[0, 0] * b0 + inverse[0, 1] * b1 + inverse[0, 2] * b2
            m1 = inverse[1, 0] * b0 + inverse[1, 1] * b1 + inverse[1, 2] * b2
            m2 = inverse[2, 0] * b0 + inverse[2, 1] * b1 + inverse[2, 2] * b2
            explained = m0 * b0 + m1 * b1 + m2 * b2
            return m0, m1, m2, math.sqrt(max(vv - explained, 0.0) / len(values))
    count = usable_samples(values, vectors, law, usable)
    scratch[0, :count] = 1.0
    solved, m0, m1, m2 = weighted_solution(count, usable, scratch[0])
    if not solved:
        return 0.0, 0.0, 0.0, 0.0
    if known:
        _, m0, m1, m2 = reweighted(count, usable, scratch, m0, m1, m2)
    return m0, m1, m2, rms_residual(count, usable, m0, m1, m2)


@numba.njit(nogil=True, cache=True)
def _solve_pixels(
    first: int, last: int,
    values: Float32, vectors: Float32, law: Float32, known: bool, inverse: Float64,
    scaled: Float64, rms: Float64,
) -> None:  # fmt: skip
    lights = values.shape[1]
    usable = np.zeros((6, lights), np.float32)
    scratch = np.zeros((3, lights), np.float32)
    for p in range(first, last):
        x, y, z, deviation = _pixel(
            values[p], vectors[p if len(vectors) > 1 else 0], law[p if len(law) > 1 else 0],
            known, inverse, usable, scratch,
        )  # fmt: skip
        scaled[p, 0], scaled[p, 1], scaled[p, 2] = x, y, z
        rms[p] = deviation
