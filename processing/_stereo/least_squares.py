"""Least squares over all usable samples of a pixel (Woodham, 1980)."""

from __future__ import annotations

import math

import numba
import numpy as np

from processing._stereo.pixel_algebra import (
    ANY_ORDER,
    Double,
    Float,
    rms_residual,
    usable_samples,
    weighted_solution,
)

# Compiled in: processing/_stereo/pixel_algebra.py 87fdffe001a6


def least_squares(values: Float, vectors: Float) -> tuple[Double, Double]:
    """Solve ``value = vector . m`` by least squares, attached shadows included.

    This is an `Estimator`; see there for the parameters and the result.
    """
    # If all pixels share the lights, the inverse is the same for all pixels without a missing
    # sample.
    shared = vectors[0].astype(np.float64)
    inverse = np.linalg.pinv(shared @ shared.T).astype(np.float64)
    scaled = np.zeros((len(values), 3))
    rms = np.zeros(len(values))
    _solve_pixels(values, vectors, inverse, scaled, rms)
    return scaled, rms


@numba.njit(cache=True, fastmath=ANY_ORDER)
def _sums(values: Float, vectors: Float) -> tuple[float, float, float, float]:
    """Return the sums of ``x v``, ``y v``, ``z v`` and ``v v``; NaN if a sample is missing."""
    bx = by = bz = vv = 0.0
    for i in range(len(values)):
        sample = np.float64(values[i])
        bx += vectors[0, i] * sample
        by += vectors[1, i] * sample
        bz += vectors[2, i] * sample
        vv += sample * sample
    return bx, by, bz, vv


@numba.njit(parallel=True, cache=True)
def _solve_pixels(
    values: Float, vectors: Float, inverse: Double, scaled: Double, rms: Double
) -> None:
    pixels, lights = values.shape
    for block in numba.prange((pixels + 255) // 256):
        usable = np.zeros((4, lights), np.float32)
        ones = np.ones(lights, np.float32)
        for p in range(256 * block, min(256 * (block + 1), pixels)):
            solved, m0, m1, m2, deviation = False, 0.0, 0.0, 0.0, 0.0
            complete = False
            if len(vectors) == 1:
                b0, b1, b2, vv = _sums(values[p], vectors[0])
                complete = math.isfinite(vv)
            if complete:
                m0 = inverse[0, 0] * b0 + inverse[0, 1] * b1 + inverse[0, 2] * b2
                m1 = inverse[1, 0] * b0 + inverse[1, 1] * b1 + inverse[1, 2] * b2
                m2 = inverse[2, 0] * b0 + inverse[2, 1] * b1 + inverse[2, 2] * b2
                deviation = math.sqrt(max(vv - (m0 * b0 + m1 * b1 + m2 * b2), 0.0) / lights)
            else:
                of = p if len(vectors) > 1 else 0
                count = usable_samples(values[p], vectors[of], usable)
                solved, m0, m1, m2 = weighted_solution(count, usable, ones)
                if solved:
                    deviation = rms_residual(count, usable, m0, m1, m2)
            scaled[p, 0], scaled[p, 1], scaled[p, 2] = m0, m1, m2
            rms[p] = deviation
