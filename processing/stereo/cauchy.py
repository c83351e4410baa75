"""Reweighted least squares with the Cauchy weight, robust to shadows and highlights."""

from __future__ import annotations

import math

import numba
import numpy as np

from processing.stereo.pixel_algebra import (
    IN_PLACE,
    MAD_TO_SIGMA,
    ranked,
    reweighted,
    rms_residual,
    solved_pixels,
    usable_samples,
    weighted_solution,
)
from rig.arrays import Float32, Float64

# Compiled in: processing/stereo/pixel_algebra.py f495374b06dc

_ITERATIONS = 10
# With n samples and 3 unknowns the median of |r| is too small; the factor is 1 + 5 / (n - 3)
# (Rousseeuw and Leroy, 1987).
FEW_SAMPLES = 5.0
# The iteration ends at a step of 1e-4 of the vector's length (0.006 degree).
_STEP2 = 1e-8
# Smallest scale of the weights, relative to the vector's length: exact data has no spread.
_SCALE_FLOOR = 1e-6


def cauchy(
    values: Float32, vectors: Float32, law: Float32 | None = None, view: Float32 | None = None
) -> tuple[Float64, Float64]:
    """Solve ``value = max(vector . m, 0)`` by reweighted least squares.

    The iteration starts at the least-squares solution. It takes up to 10 steps with the weight
    ``1 / (1 + (r / s)^2)``, where s is the median of ``|r|`` as a standard deviation (Holland and
    Welsch, 1977).
    If the law of the noise is known, pixels whose residuals are noise are solved by weighted least
    squares instead, see `reweighted`: this is tried first, and again after the iteration.

    This is an `Estimator`; see there for the parameters and the result. The view has no effect.
    """
    return solved_pixels(_solve_pixels, values, vectors, law)


@numba.njit(**IN_PLACE)
def _iterated(
    count: int,
    usable: Float32,
    shading: Float32,
    deviation: Float32,
    m0: float,
    m1: float,
    m2: float,
) -> tuple[float, float, float]:
    """Refine the least-squares solution (m0, m1, m2) of ``v = max(l . m, 0)``.

    For a light that the surface faces away from, the model predicts black and has no slope: the
    sample counts for the scale and has no weight. ``shading`` and ``deviation`` are scratch arrays
    of at least ``count`` elements.
    """
    v, lx, ly, lz = usable[0], usable[1], usable[2], usable[3]
    zero, one = np.float32(0), np.float32(1)
    guess = np.float32(0.01 * math.sqrt(m0 * m0 + m1 * m1 + m2 * m2))
    to_sigma = np.float32(MAD_TO_SIGMA * (1.0 + FEW_SAMPLES / max(count - 3, 1)))
    for _ in range(_ITERATIONS):
        length2 = m0 * m0 + m1 * m1 + m2 * m2
        floor = np.float32(_SCALE_FLOOR * math.sqrt(length2))
        if not floor > 0:
            break
        x, y, z = np.float32(m0), np.float32(m1), np.float32(m2)
        for k in range(count):
            shading[k] = lx[k] * x + ly[k] * y + lz[k] * z
            deviation[k] = abs(v[k] - max(shading[k], zero))
        guess = ranked(deviation, count, count // 2, max(guess, floor))
        per_scale = one / (to_sigma * guess + floor)
        weight = shading
        for k in range(count):
            ratio = deviation[k] * per_scale
            weight[k] = one / (one + ratio * ratio) if shading[k] > zero else zero
        solved, n0, n1, n2 = weighted_solution(count, usable, weight)
        if not solved:
            break
        step2 = (n0 - m0) ** 2 + (n1 - m1) ** 2 + (n2 - m2) ** 2
        m0, m1, m2 = n0, n1, n2
        if step2 <= _STEP2 * length2:
            break
    return m0, m1, m2


@numba.njit(**IN_PLACE)
def cauchy_pixel(
    count: int, usable: Float32, known: bool, scratch: Float32
) -> tuple[bool, float, float, float]:
    """Return whether the samples of one pixel determine the scaled normal, and its components.

    For the parameters see `reweighted`.
    """
    scratch[0, :count] = 1.0
    solved, m0, m1, m2 = weighted_solution(count, usable, scratch[0])
    if solved:
        if known:
            noise, n0, n1, n2 = reweighted(count, usable, scratch, m0, m1, m2)
            if noise:
                return True, n0, n1, n2
        m0, m1, m2 = _iterated(count, usable, scratch[0], scratch[1], m0, m1, m2)
        if known:
            _, m0, m1, m2 = reweighted(count, usable, scratch, m0, m1, m2)
    return solved, m0, m1, m2


@numba.njit(nogil=True, cache=True)
def _solve_pixels(
    first: int,
    last: int,
    values: Float32,
    vectors: Float32,
    law: Float32,
    known: bool,
    scaled: Float64,
    rms: Float64,
) -> None:
    lights = values.shape[1]
    usable = np.zeros((6, lights), np.float32)
    scratch = np.zeros((3, lights), np.float32)
    for p in range(first, last):
        of = p if len(vectors) > 1 else 0
        count = usable_samples(values[p], vectors[of], law[p if len(law) > 1 else 0], usable)
        solved, m0, m1, m2 = cauchy_pixel(count, usable, known, scratch)
        if solved:
            rms[p] = rms_residual(count, usable, m0, m1, m2)
        scaled[p, 0], scaled[p, 1], scaled[p, 2] = m0, m1, m2
