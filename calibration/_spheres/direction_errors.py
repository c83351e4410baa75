"""Covariances of light directions from the errors of highlights and outlines."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from acquisition import tangent_basis
from calibration._spheres.robust import Array

_STEP_PX = 1e-3
# Step of an outline relative to its error.
_STEP_SIGMAS = 0.01


def direction_covariances(
    rays_of: Callable[[Array, Array], Array],
    highlights_px: Array,
    sigma_px: Array,
    outline_covariances: Array,
    outlines_common: Array,
) -> Array:
    """Return the covariances of the mean directions of N lights, ``(N, 2, 2)`` in rad^2.

    Parameters
    ----------
    rays_of
        Function of highlights ``(N, K, 2)`` and changes ``(K, 3)`` of the parameters of the
        outlines that returns the directions ``(N, K, 3)``; NaN if there is no highlight.
    highlights_px
        ``(N, K, 2)``.
    sigma_px
        ``(N, K)`` standard deviations of each coordinate of a highlight.
    outline_covariances
        ``(K, 3, 3)`` covariances of the parameters of the outlines.
    outlines_common
        ``(K, 3)`` changes of the parameters by one standard deviation of an error that all outlines
        have in common, which the covariances do not contain.

    Returns
    -------
    Array
        In the basis of `acquisition.tangent_basis`. NaN where a change hides the highlight: there
        the light is seen at the rim.
    """
    none = np.zeros((highlights_px.shape[1], 3))
    rays = rays_of(highlights_px, none)
    seen = np.isfinite(rays[..., 0])
    total = np.where(seen[..., None], rays, 0.0).sum(axis=1)
    covariance = np.zeros((len(rays), 3, 3))

    def add(step: Array, scale: Array) -> None:
        slope = np.where(seen[..., None], step * scale, 0.0)
        covariance[:] += np.einsum("nka,nkb->nab", slope, slope)

    for shift in np.eye(2) * _STEP_PX:
        step = rays_of(highlights_px + shift, none) - rays_of(highlights_px - shift, none)
        add(step / (2 * _STEP_PX), sigma_px[..., None])
    values, vectors = np.linalg.eigh(outline_covariances)
    for axis in range(3):
        # One independent error of each outline: they change all at once, and add up separately.
        size = np.sqrt(np.maximum(values[:, axis], 0.0))
        change = _STEP_SIGMAS * size[:, None] * vectors[:, :, axis]
        step = rays_of(highlights_px, change) - rays_of(highlights_px, -change)
        add(step / (2 * _STEP_SIGMAS), np.ones(1))
    # The error that all outlines share adds up before it is squared.
    change = _STEP_SIGMAS * outlines_common
    step = rays_of(highlights_px, change) - rays_of(highlights_px, -change)
    slope = np.where(seen[..., None], step / (2 * _STEP_SIGMAS), 0.0).sum(axis=1)
    covariance += slope[:, :, None] * slope[:, None, :]
    basis = tangent_basis(total) / np.linalg.norm(total, axis=1)[:, None, None]
    return np.asarray(basis @ covariance @ basis.transpose(0, 2, 1), np.float64)
