"""Least squares of samples under several lights, pixel by pixel."""

from __future__ import annotations

import math

import numba
import numpy as np
import numpy.typing as npt

from rig import in_threads

Float = npt.NDArray[np.float32]
Double = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]

# Weight of the penalty on the size of the coefficients, relative to the number of samples.
PENALTY = 1e-4


def fitted(values: Float, weights: Double) -> Float:
    """Return the coefficients that reproduce samples best.

    They minimise ``sum (v - w . c)^2 + 1e-4 n |c|^2`` over the n finite samples of a pixel.

    Parameters
    ----------
    values
        ``(N, P)`` samples of P pixels under N lights; not finite if they were not measured.
    weights
        ``(1, N, K)`` values of the basis that all pixels share, or ``(P, N, K)``.

    Returns
    -------
    Float
        ``(P, K)`` coefficients; 0 for a pixel without samples.
    """
    values = np.ascontiguousarray(values)
    known = np.isfinite(values)
    coefficients = np.zeros((values.shape[1], weights.shape[2]), np.float32)
    pending = np.arange(values.shape[1])
    if len(weights) == 1:
        # Without gaps, all pixels have the same normal equations.
        shared = weights[0]
        size = len(shared) * PENALTY * np.eye(shared.shape[1])
        projection = np.linalg.solve(shared.T @ shared + size, shared.T).astype(np.float32)
        coefficients[...] = (projection @ np.where(known, values, np.float32(0))).T
        pending = np.flatnonzero(~known.all(axis=0))
    if len(pending):
        solved = np.ascontiguousarray(weights)
        in_threads(_fit, len(pending), pending, values, solved, coefficients)
    return coefficients


def predicted(coefficients: Float, weights: Double) -> Float:
    """Return the ``(N, P)`` samples that coefficients give."""
    if len(weights) == 1:
        return np.asarray(weights[0].astype(np.float32) @ coefficients.T)
    return np.asarray(np.einsum("pnk,pk->np", weights.astype(np.float32), coefficients))


@numba.njit(nogil=True, cache=True)
def _fit(
    first: int, last: int, pixels: Index, values: Float, weights: Double, coefficients: Float
) -> None:
    """Solve the normal equations of each pixel by a Cholesky decomposition."""
    lights, terms = weights.shape[1], weights.shape[2]
    matrix = np.zeros((terms, terms))
    right = np.zeros(terms)
    for at in range(first, last):
        p = pixels[at]
        of_pixel = weights[p if len(weights) > 1 else 0]
        matrix[:] = 0.0
        right[:] = 0.0
        count = 0
        for i in range(lights):
            value = float(values[i, p])
            if not math.isfinite(value):
                continue
            count += 1
            for j in range(terms):
                right[j] += of_pixel[i, j] * value
                for k in range(j + 1):
                    matrix[j, k] += of_pixel[i, j] * of_pixel[i, k]
        if count == 0:
            coefficients[p] = 0
            continue
        for j in range(terms):
            matrix[j, j] += PENALTY * count
        for j in range(terms):
            for k in range(j + 1):
                total = matrix[j, k]
                for m in range(k):
                    total -= matrix[j, m] * matrix[k, m]
                matrix[j, k] = math.sqrt(total) if j == k else total / matrix[k, k]
        for j in range(terms):
            for k in range(j):
                right[j] -= matrix[j, k] * right[k]
            right[j] /= matrix[j, j]
        for j in range(terms - 1, -1, -1):
            for k in range(j + 1, terms):
                right[j] -= matrix[k, j] * right[k]
            right[j] /= matrix[j, j]
            coefficients[p, j] = right[j]
