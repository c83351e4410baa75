"""Least squares over the samples of middle brightness."""

from __future__ import annotations

import numba
import numpy as np

from processing.stereo.pixel_algebra import (
    IN_PLACE,
    ranked,
    reweighted,
    rms_residual,
    solved_pixels,
    usable_samples,
    weighted_solution,
)
from rig.arrays import Float32, Float64

# Compiled in: processing/stereo/pixel_algebra.py f495374b06dc

# Share of the samples that is left out on either side.
_TRIMMED = 0.2
# With fewer samples none can be spared.
_FEWEST = 8


def trimmed(
    values: Float32, vectors: Float32, law: Float32 | None = None, view: Float32 | None = None
) -> tuple[Float64, Float64]:
    """Solve ``value = vector . m`` without the darkest and the brightest fifth of the samples.

    The darkest samples are shadows, and the brightest are highlights, if there are any. A pixel
    with fewer than 8 samples, or whose middle ones do not determine the normal, is solved from all
    of them. If the law of the noise
    is known, pixels whose residuals are noise end with weighted least squares, see `reweighted`.

    This is an `Estimator`; see there for the parameters and the result. The view has no effect.
    """
    return solved_pixels(_solve_pixels, values, vectors, law)


@numba.njit(**IN_PLACE)
def _keep_the_middle(count: int, values: Float32, above: Float32, weight: Float32) -> None:
    """Write the weight 1 for samples of middle brightness and 0 for others.

    The ranks are located to 1/64 of the range. Samples so close to the darkest are left out with
    them, also if they are more than a fifth: they are shadows.
    """
    left_out = int(_TRIMMED * count)
    darkest = values[0]
    for k in range(count):
        darkest = min(darkest, values[k])
    guess = np.float32(1e-30)
    for k in range(count):
        above[k] = values[k] - darkest
        guess = max(guess, above[k])
    low = ranked(above, count, left_out - 1, guess)
    high = ranked(above, count, count - left_out - 1, guess)
    for k in range(count):
        weight[k] = np.float32(1) if low < above[k] <= high else np.float32(0)


@numba.njit(inline="always")
def _trimmed_pixel(
    count: int, usable: Float32, known: bool, scratch: Float32
) -> tuple[bool, float, float, float]:
    solved, m0, m1, m2 = False, 0.0, 0.0, 0.0
    if count >= _FEWEST:
        _keep_the_middle(count, usable[0], scratch[0], scratch[1])
        solved, m0, m1, m2 = weighted_solution(count, usable, scratch[1])
    if not solved:
        scratch[1, :count] = 1.0
        solved, m0, m1, m2 = weighted_solution(count, usable, scratch[1])
    if solved and known:
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
        solved, m0, m1, m2 = _trimmed_pixel(count, usable, known, scratch)
        if solved:
            rms[p] = rms_residual(count, usable, m0, m1, m2)
        scaled[p, 0], scaled[p, 1], scaled[p, 2] = m0, m1, m2
