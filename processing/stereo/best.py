"""A robust start, then a family of reflectances: the most accurate estimator."""

from __future__ import annotations

import math
from functools import lru_cache

import numba
import numpy as np

from processing.stereo.cauchy import cauchy_pixel
from processing.stereo.pixel_algebra import (
    ANY_ORDER,
    IN_PLACE,
    count_up_to,
    ranked,
    reweighted,
    rms_residual,
    solved_pixels,
    usable_samples,
    weighted_solution,
)
from processing.stereo.reflectance_fit import reflectance_fit
from rig.arrays import Float32, Float64, Int64

# Compiled in: processing/stereo/cauchy.py 151ecc5dcb15
# Compiled in: processing/stereo/pixel_algebra.py f495374b06dc
# Compiled in: processing/stereo/reflectance_fit.py cb8658968650

# Candidates per pixel, and the number of triples that are drawn to find as many.
_CANDIDATES = 20
_DRAWN = 60
# Least determinant of the unit vectors of a triple.
_DETERMINANT = 0.05
# Share of the samples that determine the spread, and their least number.
_SHARE = 0.4
_LEAST_RANK = 5
# Samples below this share of the mean are shadows, and light from elsewhere in them.
_DARK = 0.125

# With fewer samples the subsets that agree are too small, and noise decides between them.
_FEWEST = 16


def best(
    values: Float32, vectors: Float32, law: Float32 | None = None, view: Float32 | None = None
) -> tuple[Float64, Float64]:
    """Solve by least trimmed squares, then by the mean of a family of reflectances.

    Pixels whose residuals are noise keep the Lambertian model; those with fewer than 16 samples are
    solved by `cauchy`.

    This is an `Estimator`; see there for the parameters and the result.
    """
    triples = _light_triples(values.shape[1])
    toward = np.array([[0, 0, 1]], np.float32) if view is None else view
    return solved_pixels(_solve_pixels, values, vectors, law, toward, triples)


@numba.njit(inline="always")
def _best_pixel(
    count: int, usable: Float32, known: bool, view: Float32, triples: Int64, bright: Float32,
    scratch: Float32, gram: Float64,
) -> tuple[bool, float, float, float]:  # fmt: skip
    if count < _FEWEST:
        solved, m0, m1, m2 = cauchy_pixel(count, usable, known, scratch)
        return solved, m0, m1, m2
    scratch[0, :count] = 1.0
    solved, m0, m1, m2 = weighted_solution(count, usable, scratch[0])
    length = math.sqrt(m0 * m0 + m1 * m1 + m2 * m2)
    if not (solved and 0 < length < np.inf):
        return solved, m0, m1, m2
    found = _bright_samples(count, usable, bright)
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
    x, y, z, spread = _least_trimmed(
        found, bright, triples, scratch, m0 / length, m1 / length, m2 / length
    )
    m0, m1, m2 = x * length, y * length, z * length
    if known:
        noise, m0, m1, m2 = reweighted(count, usable, scratch, m0, m1, m2)
        if noise:
            return True, m0, m1, m2
    if not x * x + y * y + z * z > 0:
        return True, m0, m1, m2
    x, y, z = reflectance_fit(found, bright, view, spread, scratch, gram, x, y, z)
    return True, x * length, y * length, z * length


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _solve_pixels(
    first: int, last: int,
    values: Float32, vectors: Float32, law: Float32, known: bool, view: Float32, triples: Int64,
    scaled: Float64, rms: Float64,
) -> None:  # fmt: skip
    lights = values.shape[1]
    usable = np.zeros((6, lights), np.float32)
    bright = np.zeros((4, lights), np.float32)
    scratch = np.zeros((14, lights), np.float32)
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


@lru_cache(maxsize=8)
def _light_triples(lights: int) -> Int64:
    """Return ``(T, 3)`` fixed random triples of different lights."""
    rng = np.random.default_rng(0)
    return np.argsort(rng.uniform(size=(_DRAWN, lights)), axis=1)[:, :3].astype(np.int64)


@numba.njit(**IN_PLACE)
def _bright_samples(count: int, usable: Float32, bright: Float32) -> int:
    """Copy the samples that show light, in the form of `usable_samples`; return their number.

    A dark sample would agree with every normal that faces away from its light, so that a normal
    could be found that explains only shadows.
    """
    total = 0.0
    for k in range(count):
        total += max(usable[0, k], np.float32(0))
    limit = np.float32(_DARK * total / count)
    found = 0
    for k in range(count):
        for i in range(4):
            bright[i, found] = usable[i, k]
        found += int(usable[0, k] > limit)
    return found


@numba.njit(**IN_PLACE)
def _rank_of_spread(count: int) -> int:
    """Return the rank, from 0, of the deviation that is the spread of ``count`` samples."""
    return min(max(int(_SHARE * count), _LEAST_RANK), count - 1)


@numba.njit(**IN_PLACE, fastmath=ANY_ORDER)
def _deviations(
    count: int, usable: Float32, m0: float, m1: float, m2: float, deviation: Float32
) -> None:
    x, y, z, zero = np.float32(m0), np.float32(m1), np.float32(m2), np.float32(0)
    v, lx, ly, lz = usable[0], usable[1], usable[2], usable[3]
    for k in range(count):
        deviation[k] = abs(v[k] - max(lx[k] * x + ly[k] * y + lz[k] * z, zero))


@numba.njit(**IN_PLACE, error_model="numpy")
def _least_trimmed(
    count: int, usable: Float32, triples: Int64, scratch: Float32, m0: float, m1: float, m2: float
) -> tuple[float, float, float, np.float32]:
    """Return the solution with the smallest spread of the residuals, and this spread.

    The candidates are the start (m0, m1, m2) and the solutions of random triples of lights
    (Rousseeuw, 1984).

    Parameters
    ----------
    count, usable
        Samples that show light, see `_bright_samples`, in a unit in which the albedo is about 1.
    triples
        Triples of indices of all N lights; those of this pixel are in proportion.
    scratch
        At least 1 row of ``count`` elements.
    m0, m1, m2
        A first solution.
    """
    v, lx, ly, lz = usable[0], usable[1], usable[2], usable[3]
    deviation = scratch[0]
    lights = usable.shape[1]
    rank = _rank_of_spread(count)
    _deviations(count, usable, m0, m1, m2, deviation)
    spread = ranked(deviation, count, rank, np.float32(0.1))
    tried = 0
    for t in range(len(triples)):
        a, b, c = triples[t]
        if count < lights:
            a, b, c = a * count // lights, b * count // lights, c * count // lights
        ax, ay, az, bx, by, bz = lx[a], ly[a], lz[a], lx[b], ly[b], lz[b]
        cx, cy, cz = lx[c], ly[c], lz[c]
        # Cramer's rule with the cross products of the vectors.
        px, py, pz = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
        det = ax * px + ay * py + az * pz
        size2 = (ax * ax + ay * ay + az * az) * (bx * bx + by * by + bz * bz)
        size2 *= cx * cx + cy * cy + cz * cz
        if not det * det >= np.float32(_DETERMINANT**2) * size2:
            continue
        tried += 1
        if tried > _CANDIDATES:
            break
        fa, fb, fc = v[a] / det, v[b] / det, v[c] / det
        z = fa * pz + fb * (cx * ay - cy * ax) + fc * (ax * by - ay * bx)
        if not z > 0:
            continue
        x = fa * px + fb * (cy * az - cz * ay) + fc * (ay * bz - az * by)
        y = fa * py + fb * (cz * ax - cx * az) + fc * (az * bx - ax * bz)
        _deviations(count, usable, x, y, z, deviation)
        if count_up_to(deviation, count, spread) > rank:
            spread = ranked(deviation, count, rank, spread)
            m0, m1, m2 = float(x), float(y), float(z)
    return m0, m1, m2, spread
