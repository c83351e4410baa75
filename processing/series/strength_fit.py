"""Robust fit of normals, albedo and the strength of each light to the same samples."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from acquisition import Lights
from rig import short_repr
from rig.arrays import Bool, Float64, Intp

_STEPS = 40
_SETTLED = 1e-5
# Darker samples, relative to the bright ones of their pixel, are probably in shadow.
_DARK = 0.1
_BRIGHT = 0.9
# Samples below this share of what is predicted are in cast shadow.
_SHADOWED = 0.3
# Residuals, in standard deviations, at which a sample has half of its weight.
_HALF_WEIGHT = 2.5
_MAD_TO_SIGMA = 1.4826
# Least spread of the residuals of a pixel, relative to its signal: rounding and compression.
_LEAST_SPREAD = 1e-4
_POOLED = 20.0
# Strengths that the samples do not determine keep the values of the start.
_PRIOR_SD = 3.0
_LARGEST_STEP = 1.0
_FEWEST_SAMPLES = 4


@dataclass(frozen=True, eq=False)
class StrengthFit:
    """Strengths of N lights, and the P pixels that show them.

    Parameters
    ----------
    logarithms
        ``(N,)`` natural logarithms of the strengths, relative to those that the samples were
        divided by; their mean is 0.
    information
        ``(N, N)`` reciprocal variances of `logarithms`, after normals and albedo are eliminated,
        if the residuals were independent.
    scores
        ``(P, N)`` derivatives of the cost of each pixel by the logarithms.
    scaled_normals
        ``(P, 3)``.
    samples
        ``(P, N)`` divided by strengths and by the signal of their pixel, 0 where not measured.
    vectors
        ``(P, N, 3)`` or ``(1, N, 3)`` light vectors.
    weights
        ``(P, N)`` weights 0..1 of the samples.
    residuals
        ``(P, N)`` of the samples.
    spread
        ``(P,)`` robust standard deviations of the residuals.
    kept
        Indices of the P pixels among those given.
    """

    logarithms: Float64
    information: Float64
    scores: Float64
    scaled_normals: Float64
    samples: Float64
    vectors: Float64
    weights: Float64
    residuals: Float64
    spread: Float64
    kept: Intp

    __repr__ = short_repr

    def covariance(self, scores: Float64 | None = None) -> Float64:
        """Return the covariance of the logarithms, from the scatter of scores between pixels.

        A sandwich estimate (White, 1982), for strengths whose logarithms have the mean 0.
        ``scores`` are sums over groups of pixels, if pixels of a group deviate alike.
        """
        scores = self.scores if scores is None else scores
        count = len(self.logarithms)
        basis = np.linalg.qr(np.column_stack([np.ones(count), np.eye(count)[:, 1:]]))[0][:, 1:]
        inverse = basis @ np.linalg.pinv(basis.T @ self.information @ basis) @ basis.T
        return np.asarray(inverse @ (scores.T @ scores) @ inverse)


def light_vectors(lights: Lights, points_mm: Float64 | None, places: Intp) -> Float64:
    """Return the light vectors ``(P, N, 3)`` at some pixels, ``(1, N, 3)`` of distant lights."""
    if not lights.near or points_mm is None:
        return lights.unit_directions[None]
    points = np.asarray(points_mm).reshape(-1, 3)[places]
    return np.ascontiguousarray(lights.vectors_at(points).transpose(1, 0, 2))


def fit_strengths(
    values: Float64, vectors: Float64, *, prior_sd: float = _PRIOR_SD
) -> StrengthFit | None:
    """Fit ``value = strength * (light vector . scaled normal)`` with Cauchy weights.

    The logarithms of the strengths are found by Gauss-Newton steps from which the scaled normals
    are eliminated (Schur complement), so that their number does not grow with the pixels.

    Parameters
    ----------
    values
        ``(P, N)`` linear radiance, not finite or not positive where a sample was not measured.
    vectors
        ``(P, N, 3)`` or ``(1, N, 3)`` light vectors; 0 where a light does not reach a pixel.

    Returns
    -------
    StrengthFit or None
        None if no pixel has 4 samples, and half of all.
    """
    with np.errstate(invalid="ignore"):
        measured = np.isfinite(values) & (values > 0) & vectors.any(axis=2)
    values = np.where(measured, values, 0.0)
    count = values.shape[1]
    start = _brightness(values, measured)
    level = _bright(values / start)
    usable = measured & (values / start > _DARK * level[:, None])
    kept = np.flatnonzero(usable.sum(axis=1) >= max(_FEWEST_SAMPLES, count / 2))
    if not len(kept):
        return None
    values, measured, usable = values[kept] / level[kept, None], measured[kept], usable[kept]
    if len(vectors) > 1:
        vectors = vectors[kept]
    logarithms = np.log(start)
    weights = usable.astype(np.float64)
    of_pixel = np.ones(len(kept))
    for step in range(_STEPS):
        samples = values * np.exp(-logarithms)
        normals, inverse = solve_normals(samples, weights, vectors)
        predicted = project(vectors, normals)
        residuals = samples - predicted
        weighted = of_pixel[:, None] * weights
        information = strength_information(
            weighted, predicted, vectors, inverse / of_pixel[:, None, None]
        )
        scores = weighted * predicted * residuals
        change = _step(information, scores.sum(axis=0), logarithms - np.log(start), prior_sd)
        if step > 3 and np.abs(change).max() < _SETTLED:
            break
        logarithms = logarithms + change
        lit = predicted > _DARK * _bright(predicted)[:, None]
        usable = measured & lit & (samples > _SHADOWED * predicted)
        spread = _spread(residuals, usable)
        weights = usable / (1 + (residuals / (_HALF_WEIGHT * spread[:, None])) ** 2)
        of_pixel = 1 / (spread**2 + float(np.median(spread)) ** 2)
    # The curvature of the cost is less than its weights say.
    ratio = (residuals / (_HALF_WEIGHT * spread[:, None])) ** 2
    curvature = usable * np.maximum(1 - ratio, 0) / (1 + ratio) ** 2
    _, inverse = solve_normals(samples, curvature, vectors)
    information = strength_information(
        of_pixel[:, None] * curvature, predicted, vectors, inverse / of_pixel[:, None, None]
    )
    return StrengthFit(
        logarithms=logarithms,
        information=information,
        scores=scores,
        scaled_normals=normals,
        samples=samples,
        vectors=vectors,
        weights=weights,
        residuals=residuals,
        spread=spread,
        kept=kept,
    )


def project(vectors: Float64, normals: Float64) -> Float64:
    """Return ``(P, N)`` products of light vectors and normals."""
    product: Float64 = (
        (vectors @ normals[:, :, None])[..., 0] if len(vectors) > 1 else (normals @ vectors[0].T)
    )
    return product


def solve_normals(samples: Float64, weights: Float64, vectors: Float64) -> tuple[Float64, Float64]:
    """Return the weighted least squares normals ``(P, 3)`` and the inverse matrices."""
    if len(vectors) > 1:
        rows = weights[..., None] * vectors
        matrix = rows.transpose(0, 2, 1) @ vectors
        target = (rows.transpose(0, 2, 1) @ samples[..., None])[..., 0]
    else:
        one = vectors[0]
        matrix = (weights @ (one[:, :, None] * one[:, None, :]).reshape(-1, 9)).reshape(-1, 3, 3)
        target = (weights * samples) @ one
    ridge = 1e-9 * np.trace(matrix, axis1=1, axis2=2)[:, None, None] + 1e-12
    inverse = np.linalg.inv(matrix + ridge * np.eye(3))
    return (inverse @ target[..., None])[..., 0], inverse


def strength_information(
    weights: Float64, predicted: Float64, vectors: Float64, inverse: Float64
) -> Float64:
    """Return the information about the strengths that is left by unknown normals."""
    slope = weights * predicted
    rows = slope[..., None] * vectors
    # Where lights that remain are nearly in one plane, rounding makes the inverse indefinite.
    size, axes = np.linalg.eigh(inverse)
    root = axes * np.sqrt(np.maximum(size, 0))[:, None, :]
    reduced = (rows @ root).transpose(1, 0, 2).reshape(rows.shape[1], -1)
    return np.asarray(np.diag(np.sum(slope * predicted, axis=0)) - reduced @ reduced.T)


def _step(
    information: Float64, gradient: Float64, since_start: Float64, prior_sd: float
) -> Float64:
    """Return the step of the logarithms whose sum is 0."""
    count = len(gradient)
    prior = 1 / prior_sd**2
    matrix = information + prior * np.eye(count)
    both = np.linalg.solve(matrix, np.stack([gradient - prior * since_start, np.ones(count)], 1))
    step = both[:, 0] - both[:, 1] * both[:, 0].sum() / both[:, 1].sum()
    clipped: Float64 = np.clip(step, -_LARGEST_STEP, _LARGEST_STEP)
    return np.asarray(clipped - clipped.mean())


def _brightness(values: Float64, measured: Bool) -> Float64:
    """Return strengths for a start: brightness of the images relative to the mean of a pixel."""
    strength = np.ones(values.shape[1])
    for _ in range(5):
        scaled = np.where(measured, values / strength, np.nan)
        pixel = _median(scaled, axis=1)[:, None]
        with np.errstate(divide="ignore", invalid="ignore"):
            strength = np.maximum(_median(np.where(measured, values / pixel, np.nan), axis=0), 1e-9)
        strength /= np.exp(np.log(strength).mean())
    return strength


def _median(values: Float64, axis: int) -> Float64:
    """Return medians of what is not NaN, 1 where there is nothing."""
    known = np.isfinite(values)
    order = np.sort(np.where(known, values, np.inf), axis=axis)
    place = np.expand_dims(np.maximum(known.sum(axis=axis) - 1, 0) // 2, axis)
    middle = np.take_along_axis(order, place, axis=axis).squeeze(axis)
    return np.asarray(np.where(np.isfinite(middle), middle, 1.0))


def _bright(samples: Float64) -> Float64:
    return np.maximum(np.quantile(samples, _BRIGHT, axis=1), 1e-12)


def _spread(residuals: Float64, usable: Bool) -> Float64:
    """Return the standard deviations ``(P,)``, with the degrees of freedom of 3 unknowns."""
    middle = _median(np.where(usable, np.abs(residuals), np.nan), axis=1)
    count = usable.sum(axis=1)
    own = np.maximum(count - 3, 0)
    # Medians of few residuals scatter: all pixels count as some more of them.
    variance = (_MAD_TO_SIGMA * middle) ** 2 * count / np.maximum(own, 1)
    typical = float(np.median(variance))
    pooled = (own * variance + _POOLED * typical) / (own + _POOLED)
    return np.asarray(np.maximum(np.sqrt(pooled), _LEAST_SPREAD))
