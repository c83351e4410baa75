"""The smooth part of a flat: a polynomial of the image in the logarithm."""

from __future__ import annotations

from itertools import product

import numpy as np

from calibration.flat.sites import Sites, block_means
from rig.arrays import Bool, Float32, Float64

_DEGREE = 6
_BLOCKS = 3000
_ROUNDS = 20
_CAUCHY = 2.385
# Less of the image than this does not determine a free polynomial up to its corners.
_WHOLE = 0.98


def smooth_part(values: Float32, measured: Bool, sites: Sites) -> Float32:
    """Fit the logarithm of the smooth part of a flat field.

    Parameters
    ----------
    values
        Response of each pixel, the shape of the frames; its scale is free.
    measured
        The pixels to fit, same shape.
    sites
        Colours of the pixels.

    Returns
    -------
    NDArray
        Logarithm of the smooth part, float32 of the same shape, 0 in the middle of the image in
        each colour: a polynomial of degree 6, or if the card does not fill the image, a gradient
        and ``r^2`` and ``r^4``. Blocks that differ from their surroundings have a low weight
        (Cauchy).
    """
    height, width = sites.shape[:2]
    side = max(2, 2 * int(np.ceil(np.sqrt(height * width / _BLOCKS) / 2)))
    basis = _free() if measured.mean() > _WHOLE else _radial()
    u, v = _places(width, height)
    rows, columns = height // side, width // side
    at_u, at_v = (
        places[: count * side].reshape(count, side).mean(axis=1)
        for places, count in ((u, columns), (v, rows))
    )
    across, down = np.meshgrid(at_u, at_v)
    design = _design(basis, across.ravel(), down.ravel())
    found = np.zeros(sites.shape, np.float32)
    for c in range(sites.colours):
        plane = sites.colour(values, c)
        usable = sites.colour(measured, c) & sites.has(c)
        means = block_means(plane, usable, side).reshape(rows * columns)
        known = np.isfinite(means) & (means > 0)
        coefficients = _robust(design[known], np.log(means[known]))
        # The constant is the first: without it, the logarithm is 0 in the middle.
        matrix = np.tensordot(coefficients[1:], basis[1:], axes=1)
        of_colour = (_powers(v) @ matrix.T).astype(np.float32) @ _powers(u).T.astype(np.float32)
        np.copyto(sites.colour(found, c), of_colour, where=sites.has(c))
    return found


def _places(width: int, height: int) -> tuple[Float64, Float64]:
    """Return columns and rows relative to the middle; a corner is at the distance 1."""
    half = np.hypot(width, height) / 2
    u: Float64 = (np.arange(width) - (width - 1) / 2) / half
    v: Float64 = (np.arange(height) - (height - 1) / 2) / half
    return u, v


def _free() -> Float64:
    """Return coefficients ``(M, 7, 7)`` of u^i v^j: one monomial each, the constant first."""
    orders = [pair for pair in product(range(_DEGREE + 1), repeat=2) if sum(pair) <= _DEGREE]
    basis = np.zeros((len(orders), _DEGREE + 1, _DEGREE + 1))
    for m, (i, j) in enumerate(orders):
        basis[m, i, j] = 1.0
    return basis


def _radial() -> Float64:
    """Return coefficients ``(5, 7, 7)`` of u^i v^j: 1, u, v, r^2 and r^4."""
    basis = np.zeros((5, _DEGREE + 1, _DEGREE + 1))
    basis[0, 0, 0] = basis[1, 1, 0] = basis[2, 0, 1] = 1.0
    basis[3, 2, 0] = basis[3, 0, 2] = 1.0
    basis[4, 4, 0] = basis[4, 0, 4] = 1.0
    basis[4, 2, 2] = 2.0
    return basis


def _powers(places: Float64) -> Float64:
    return np.vander(places, _DEGREE + 1, increasing=True)


def _design(basis: Float64, u: Float64, v: Float64) -> Float64:
    return np.asarray(np.einsum("pi,mij,pj->pm", _powers(u), basis, _powers(v), optimize=True))


def _robust(design: Float64, target: Float64) -> Float64:
    """Return coefficients by iteratively reweighted least squares with Cauchy's weights."""
    weights = np.ones(len(target))
    for _ in range(_ROUNDS):
        root = np.sqrt(weights)
        found = np.asarray(
            np.linalg.lstsq(design * root[:, None], target * root, rcond=None)[0], np.float64
        )
        rest = target - design @ found
        scale = max(1.4826 * float(np.median(np.abs(rest))), 1e-9)
        weights = 1 / (1 + (rest / (_CAUCHY * scale)) ** 2)
    return found
