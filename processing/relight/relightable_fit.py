"""Relightable images from samples, in bands of rows."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Literal, NamedTuple

import numba
import numpy as np

from acquisition import SRGB
from calibration import EstimateError
from calibration.radiance import luma
from processing.relight.relightable_image import TERMS, LightBasis, RelightableImage
from rig import Progress, in_threads
from rig.arrays import Float32, Float64, Intp

RelightColours = Literal["lrgb", "rgb"]
RelightValues = Literal["display", "linear"]

# Weight of the penalty on the size of the coefficients, relative to the number of samples.
PENALTY = 1e-4
# Bytes of the samples of a band, and pixels from which white is taken.
_BAND = 48_000_000
_SAMPLE = 400_000
_GROUP = 8
# Share of the pixels that may be brighter than white under some light.
_CLIPPED = 0.001
# A pixel that is darker under all lights is divided by this share of white, so that its noise does
# not give large coefficients.
_DARKEST = 8 / 255
# The curve is a table of the square root of light, up to 4 times white.
_LEVELS = 4096
_BRIGHTEST = 4.0


class Samples(NamedTuple):
    """Samples of some rows under N lights.

    Parameters
    ----------
    values
        ``(N, P, C)`` linear light of P pixels in 1 or 3 colours; not finite if not measured.
    weights
        ``(1, N, K)`` values of the basis that all pixels share, or ``(P, N, K)``.
    """

    values: Float32
    weights: Float64


class RelightFit(NamedTuple):
    """A fit and its figures.

    Parameters
    ----------
    image
        The relightable image.
    residual
        ``(H, W)`` float32 root mean square deviation of the image from the values that it was
        fitted to, over lights and colours; NaN where no sample was measured.
    directions
        ``(N, 3)`` unit vectors toward the lights, from the origin.
    white
        Linear light of the value 1.
    without_samples
        Number of pixels without any sample, which are black.
    """

    image: RelightableImage
    residual: Float32
    directions: Float64
    white: float
    without_samples: int


def fit_rows(
    rows: Callable[[int, int], Samples],
    size: tuple[int, int],
    directions: Float64,
    channels: int,
    *,
    basis: LightBasis,
    colours: RelightColours,
    values: RelightValues,
    on_progress: Progress,
) -> RelightFit:
    """Fit a relightable image to samples.

    Parameters
    ----------
    rows
        Returns the samples of the rows from the first to before the last.
    size
        Height and width of the image.
    directions
        ``(N, 3)`` unit vectors toward the lights.
    channels
        Number of colours.
    basis, colours, values
        As in `relightable_image`.
    on_progress
        Receives the stage ``fitting``.

    Raises
    ------
    EstimateError
        If no sample is brighter than 0.
    """
    height, width = size
    white = _white(rows, size)
    terms = TERMS[basis]
    shared = colours == "lrgb"
    coefficients = np.zeros((height, width, terms) if shared else (height, width, terms, 3), "f4")
    colour = np.zeros((height, width, 3), np.float32) if shared else None
    residual = np.full((height, width), np.nan, np.float32)
    step = max(1, _BAND // (4 * len(directions) * width * (channels + 2)))
    table = None if values == "linear" else _curve()
    for first in range(0, height, step):
        last = min(first + step, height)
        on_progress("fitting", first, height)
        linear, weights = rows(first, last)
        linear = linear / np.float32(white)
        shape = (last - first, width)
        shown = _encoded(linear, table)
        if colour is not None:
            gray = shown[..., 0] if channels == 1 else _encoded(luma(linear), table)
            found, tint = _one_function(gray, shown, weights)
            left = shown - _predicted(found, weights)[..., None] * tint
            coefficients[first:last] = found.reshape(*shape, terms)
            colour[first:last] = tint.reshape(*shape, -1)
        else:
            each = [fitted(shown[..., c], weights) for c in range(channels)]
            left = shown - np.stack([_predicted(c, weights) for c in each], axis=-1)
            coefficients[first:last] = np.stack(each, axis=-1).reshape(*shape, terms, -1)
        residual[first:last] = _rms(left).reshape(shape)
    on_progress("fitting", height, height)
    image = RelightableImage(basis, coefficients, colour)
    missing = int(np.count_nonzero(np.isnan(residual)))
    return RelightFit(image, residual, directions, white, missing)


def _one_function(gray: Float32, shown: Float32, weights: Float64) -> tuple[Float32, Float32]:
    """Return coefficients of the gray values, scaled to about 1, and the colour of each pixel."""
    found = fitted(gray, weights)
    known = np.isfinite(gray) & np.isfinite(shown).all(axis=-1)
    level = np.where(known, gray, np.float32(0))
    power = np.sum(level * level, axis=0)
    product = np.einsum("np,npc->pc", level, np.where(known[..., None], shown, np.float32(0)))
    tint = np.divide(product, power[:, None], out=np.ones_like(product), where=power[:, None] > 0)
    peak = np.maximum(level.max(axis=0), np.float32(_DARKEST))[:, None]
    return found / peak, tint * peak


def _rms(left: Float32) -> Float32:
    """Return the rms over lights and colours of ``(N, P, C)``; NaN without a finite value."""
    known = np.isfinite(left)
    count = np.sum(known, axis=(0, 2))
    total = np.sum(np.where(known, left, np.float32(0)) ** 2, axis=(0, 2))
    empty = np.full(len(count), np.nan, np.float32)
    np.divide(total, count, out=empty, where=count > 0)
    return np.sqrt(empty)


def _white(rows: Callable[[int, int], Samples], size: tuple[int, int]) -> float:
    """Return the light that a small share of the pixels exceed under their brightest light."""
    height, width = size
    groups = max(1, min(_SAMPLE // (_GROUP * width), -(-height // _GROUP)))
    starts = {int(at) for at in np.linspace(0, max(height - _GROUP, 0), groups)}
    brightest = []
    for first in sorted(starts):
        values = rows(first, min(first + _GROUP, height)).values
        brightest.append(np.where(np.isfinite(values), values, np.float32(0)).max(axis=(0, 2)))
    found = np.concatenate(brightest)
    found = found[found > 0]
    if not len(found):
        raise EstimateError("the images are black: there is nothing to relight")
    return float(np.quantile(found, 1 - _CLIPPED, method="lower"))


def _curve() -> Float32:
    roots = np.linspace(0, np.sqrt(_BRIGHTEST), _LEVELS + 1)
    return np.asarray(SRGB.samples(roots**2), np.float32)


def _encoded(linear: Float32, table: Float32 | None) -> Float32:
    """Return light relative to white as samples of a curve; light below 0 becomes 0."""
    if table is None:
        return linear
    known = np.isfinite(linear)
    light = np.clip(np.where(known, linear, np.float32(0)), 0, _BRIGHTEST)
    place = np.sqrt(light) * np.float32(_LEVELS / np.sqrt(_BRIGHTEST))
    index = np.minimum(place.astype(np.int32), _LEVELS - 1)
    lower = table[index]
    samples: Float32 = lower + (place - index).astype(np.float32) * (table[index + 1] - lower)
    samples[~known] = np.nan
    return samples


def fitted(values: Float32, weights: Float64) -> Float32:
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


def _predicted(coefficients: Float32, weights: Float64) -> Float32:
    """Return the ``(N, P)`` samples that coefficients give."""
    if len(weights) == 1:
        return np.asarray(weights[0].astype(np.float32) @ coefficients.T)
    return np.asarray(np.einsum("pnk,pk->np", weights.astype(np.float32), coefficients))


@numba.njit(nogil=True, cache=True)
def _fit(
    first: int, last: int, pixels: Intp, values: Float32, weights: Float64, coefficients: Float32
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
