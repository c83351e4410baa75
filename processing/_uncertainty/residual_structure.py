"""Whether the residuals are noise, or have a structure that no law of noise explains."""

from __future__ import annotations

import math

import numpy as np

from processing._uncertainty.judged_samples import LIT, Kinds
from processing._uncertainty.light_table import Double, Float

# With fewer lights the nearest one is far away, and a highlight is in one image only.
_FEWEST_LIGHTS = 8
_FEWEST_PIXELS = 100


def neighbour_correlation(values: Float, vectors: Float, kinds: Kinds, reference: Double) -> float:
    """Return the correlation between the residuals of each light and of the one nearest to it.

    Noise and errors of lights are independent from light to light; the fit makes their correlation
    slightly negative. A surface that is not matte reflects neighbouring lights in a similar
    way, and the correlation is positive, whatever the strength of the noise. NaN if there are too
    few lights or pixels.

    Parameters
    ----------
    values, vectors
        Samples of P pixels, see `LightModel.samples`.
    kinds, reference
        See `reference_solutions`.
    """
    solved = np.isfinite(reference).all(axis=1)
    of_pixel = np.broadcast_to(vectors, (len(values), *vectors.shape[1:]))[solved]
    predicted = np.einsum("pc,pcn->pn", reference[solved], of_pixel)
    residuals = np.where(kinds[solved] == LIT, np.nan_to_num(values[solved]) - predicted, 0.0)
    return correlation_of_neighbours(residuals, vectors.mean(axis=0).T)


def correlation_of_neighbours(residuals: Double, vectors: Double) -> float:
    """Return the correlation between the residuals of each light and of the one nearest to it.

    Parameters
    ----------
    residuals
        ``(P, N)``, 0 where a sample is missing.
    vectors
        ``(N, 3)`` light vectors in the middle of the object.

    Returns
    -------
    float
        NaN if there are too few lights or pixels.
    """
    if len(vectors) < _FEWEST_LIGHTS or len(residuals) < _FEWEST_PIXELS:
        return math.nan
    units = vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-30)
    cosines = units @ units.T
    np.fill_diagonal(cosines, -2)
    nearest = np.argmax(cosines, axis=1)
    squares = (residuals**2).sum(axis=1)
    products = (residuals * residuals[:, nearest]).sum(axis=1)
    structured = squares > 0
    if not structured.any():
        return math.nan
    return float(np.mean(products[structured] / squares[structured]))
