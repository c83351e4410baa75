"""Differences of lights in combined standard deviations."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from acquisition import Lights, tangent_basis

Array = npt.NDArray[np.float64]

# Eigenvalues of a covariance below this share of the largest one count as zero.
_SINGULAR = 1e-9


def covariances_3d(lights: Lights) -> Array | None:
    """Return covariances ``(N, 3, 3)`` in the house frame, of positions or of unit directions."""
    if lights.errors is None or lights.errors.covariances is None:
        return None
    if lights.near:
        return lights.errors.covariances
    basis = tangent_basis(lights.unit_directions)
    covariances: Array = basis.transpose(0, 2, 1) @ lights.errors.covariances @ basis
    return covariances


def deviations(difference: Array, covariances: Array, across: Array | None) -> Array:
    """Return Mahalanobis distances ``(N,)`` of differences ``(N, 3)``; NaN without a covariance.

    ``sqrt(d^T C^-1 d)``: with d coordinates, its square has the mean d if the covariance is right.
    A difference that the covariance excludes is infinitely many standard deviations long.

    Parameters
    ----------
    difference, covariances
        Differences, and the sums of the covariances of both calibrations.
    across
        ``(N, 3)`` unit directions at right angles to which directions differ; None for positions.
    """
    if across is not None:
        basis = tangent_basis(across)
        difference = np.einsum("nij,nj->ni", basis, difference)
        covariances = basis @ covariances @ basis.transpose(0, 2, 1)
    found = np.full(len(difference), np.nan)
    for n, (vector, matrix) in enumerate(zip(difference, covariances, strict=True)):
        if np.isnan(matrix).any():
            continue
        values, vectors = np.linalg.eigh(matrix)
        along = vectors.T @ vector
        regular = values > _SINGULAR * float(values.max())
        excluded = np.abs(along[~regular]) > _SINGULAR * float(np.linalg.norm(vector))
        total = np.sum(along[regular] ** 2 / values[regular])
        found[n] = np.inf if excluded.any() else np.sqrt(total)
    return found
