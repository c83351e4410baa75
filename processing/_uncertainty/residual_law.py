"""Law of the noise from the residuals, where neither sensor nor repeats show it."""

from __future__ import annotations

import numpy as np
from scipy.optimize import nnls

from processing._uncertainty.light_table import Double
from processing._uncertainty.reference import FREE, LIT, REFERENCE, Float, Kinds

_BINS = 12
_FEWEST = 100
# Median of the square of a normal variable.
_MEDIAN_SQUARE = 0.4549


def residual_law(
    values: Float, vectors: Float, kinds: Kinds, results: Double, of_lights: Float
) -> Float | None:
    """Return a law ``(1, 2, 1)`` of the noise, see `Estimator`; None if there is too little to see.

    In bins of the predicted signal the median of the squared residuals shows their variance, which
    is a line above the signal. A median, because some pixels are not Lambertian.

    Parameters
    ----------
    values, vectors
        Samples of P pixels, see `LightModel.samples`.
    kinds, results
        See `reference_solutions`.
    of_lights
        ``(P, N)`` variances of the samples by the errors of their lights, which are not noise.
    """
    free = results[:, FREE]
    usable = free >= 1
    if not usable.any():
        return None
    solution = np.where(usable[:, None], results[:, REFERENCE], 0.0)
    of_pixel = np.broadcast_to(vectors, (len(values), *vectors.shape[1:]))
    predicted = np.einsum("pc,pcn->pn", solution, of_pixel)
    lit = (kinds == LIT) & usable[:, None]
    # A fit with d degrees of freedom leaves d / n of the variance.
    larger = np.where(usable, (free + 3) / np.maximum(free, 1), 0.0)[:, None]
    squares = (np.nan_to_num(values) - predicted) ** 2 * larger
    signal, squares, known = predicted[lit], squares[lit], of_lights[lit]
    if len(signal) < _FEWEST:
        return None
    edges = np.quantile(signal, np.linspace(0, 1, _BINS + 1)[1:-1])
    places = np.digitize(signal, edges)
    bins = [places == b for b in range(_BINS) if np.count_nonzero(places == b) >= _FEWEST / _BINS]
    at = np.array([signal[b].mean() for b in bins])
    seen = np.array([np.median(squares[b]) / _MEDIAN_SQUARE for b in bins])
    left = np.maximum(seen - [known[b].mean() for b in bins], 0.05 * seen)
    if not np.all(left > 0):
        return np.zeros((1, 2, 1), np.float32)
    line = np.stack([np.ones_like(at), at], axis=1)
    (floor, slope), _ = nnls(line / left[:, None], np.ones_like(at))
    return np.array([floor, slope], np.float32).reshape(1, 2, 1)
