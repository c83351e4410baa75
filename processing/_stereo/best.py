"""Least trimmed squares, then a reflectance of two coefficients: the most accurate estimator."""

from __future__ import annotations

import math

import numba
import numpy as np

from processing._stereo.cauchy import cauchy_pixel
from processing._stereo.least_trimmed import (
    Triples,
    bright_samples,
    least_trimmed,
    light_triples,
    rank_of_spread,
)
from processing._stereo.pixel_algebra import (
    IN_PLACE,
    Double,
    Float,
    law_or_alike,
    rms_residual,
    usable_samples,
    weighted_solution,
)
from processing._stereo.reflectance_fit import reflectance_fit
from processing._stereo.reweighted import reweighted
from rig import in_threads

# Compiled in: processing/_stereo/cauchy.py bb47c9b9b097
# Compiled in: processing/_stereo/least_trimmed.py ae49da2b2a08
# Compiled in: processing/_stereo/pixel_algebra.py d36a51d0daee
# Compiled in: processing/_stereo/reflectance_fit.py c800caf84fcf
# Compiled in: processing/_stereo/reweighted.py eb8405535879

# With fewer samples the subsets that agree are too small, and noise decides between them.
_FEWEST = 16


def best(
    values: Float, vectors: Float, law: Float | None = None, view: Float | None = None
) -> tuple[Double, Double]:
    """Solve by least trimmed squares, then fit ``v = max(l . n, 0) (c0 + c1 (h . n)^2)``.

    Pixels whose residuals are noise keep the Lambertian model; those with fewer than 16 samples are
    solved by `cauchy`.

    This is an `Estimator`; see there for the parameters and the result.
    """
    scaled = np.zeros((len(values), 3))
    rms = np.zeros(len(values))
    triples = light_triples(values.shape[1])
    toward = np.array([[0, 0, 1]], np.float32) if view is None else view
    of_noise = law_or_alike(law, values.shape[1])
    in_threads(_solve_pixels, len(values), values, vectors, *of_noise, toward, triples, scaled, rms)
    return scaled, rms


@numba.njit(**IN_PLACE, error_model="numpy")
def _best_pixel(
    count: int, usable: Float, known: bool, view: Float, triples: Triples, bright: Float,
    scratch: Float, gram: Double,
) -> tuple[bool, float, float, float]:  # fmt: skip
    if count < _FEWEST:
        solved, m0, m1, m2 = cauchy_pixel(count, usable, known, scratch)
        return solved, m0, m1, m2
    scratch[0, :count] = 1.0
    solved, m0, m1, m2 = weighted_solution(count, usable, scratch[0])
    length = math.sqrt(m0 * m0 + m1 * m1 + m2 * m2)
    if not (solved and 0 < length < np.inf):
        return solved, m0, m1, m2
    found = bright_samples(count, usable, bright)
    if found < 4:
        solved, m0, m1, m2 = cauchy_pixel(count, usable, known, scratch)
        return solved, m0, m1, m2
    if known:
        noise, n0, n1, n2 = reweighted(count, usable, scratch, m0, m1, m2)
        if noise:
            return True, n0, n1, n2
    per = np.float32(1 / length)
    for k in range(found):
        bright[0, k] *= per
    x, y, z, spread = least_trimmed(
        found, bright, triples, scratch, m0 / length, m1 / length, m2 / length
    )
    m0, m1, m2 = x * length, y * length, z * length
    if known:
        noise, m0, m1, m2 = reweighted(count, usable, scratch, m0, m1, m2)
        if noise:
            return True, m0, m1, m2
    if not x * x + y * y + z * z > 0:
        return True, m0, m1, m2
    for k in range(count):
        usable[0, k] *= per
    x, y, z = reflectance_fit(
        count, usable, view, rank_of_spread(found), spread, scratch, gram, x, y, z
    )
    for k in range(count):
        usable[0, k] /= per
    return True, x * length, y * length, z * length


@numba.njit(nogil=True, cache=True)
def _solve_pixels(
    first: int, last: int,
    values: Float, vectors: Float, law: Float, known: bool, view: Float, triples: Triples,
    scaled: Double, rms: Double,
) -> None:  # fmt: skip
    lights = values.shape[1]
    usable = np.zeros((6, lights), np.float32)
    bright = np.zeros((4, lights), np.float32)
    scratch = np.zeros((10, lights), np.float32)
    gram = np.zeros((5, 4))
    for p in range(first, last):
        of = p if len(vectors) > 1 else 0
        count = usable_samples(values[p], vectors[of], law[p if len(law) > 1 else 0], usable)
        solved, m0, m1, m2 = _best_pixel(
            count, usable, known, view[p if len(view) > 1 else 0], triples, bright, scratch,
            gram,
        )  # fmt: skip
        if solved:
            rms[p] = rms_residual(count, usable, m0, m1, m2)
        scaled[p, 0], scaled[p, 1], scaled[p, 2] = m0, m1, m2
