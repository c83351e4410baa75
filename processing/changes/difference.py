"""Difference of two fields on the same pixels, without what lights and registration do to it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import cv2
import numpy as np
from scipy.optimize import nnls

from acquisition import DataError
from processing.registration.field import Field
from rig import short_repr
from rig.arrays import Bool, Float32, Float64, Floating

# Side of a block of pixels, and the standard deviation, in blocks, of the window around it.
BLOCK: Final = 16
_WINDOW: Final = 2.0
# Prior standard deviations of what is fitted in a window: slopes by wrong lights, shifts in pixels
# that the registration left, and difference of blur in square pixels.
_LIGHTS, _SHIFT, _BLUR = 0.2, 0.3, 0.3
# Degrees of freedom of the distribution of differences, whose tails are those of edges of shadows.
_FREEDOM: Final = 4.0
_ROUNDS: Final = 4
# Squares beyond this times the expected ones are changes; most pixels that show what is expected.
_CHANGED, _MOST_SEEN = 10.0, 200_000
# Slopes that are steeper are not compared.
_STEEPEST: Final = 2.0
# Pixels at the border of the common area.
_BORDER: Final = 4


@dataclass(frozen=True, eq=False)
class Difference:
    """AFTER - BEFORE, what is common to a neighbourhood of about 100 pixels removed.

    Parameters
    ----------
    slopes
        ``(2, H, W)`` difference of the slopes dz/dcolumn and dz/drow; 0 where it is not known.
    log_albedo
        ``(H, W)`` difference of the logarithm of the albedo; None if one is not known.
    weight, albedo_weight
        ``(H, W)`` reciprocal variances, of one slope and of the logarithm; 0 where not known.
    albedo_edge
        ``(H, W)`` steepness of edges of paint, change of the logarithm per pixel.
    """

    slopes: Float32
    weight: Float32
    log_albedo: Float32 | None
    albedo_weight: Float32 | None
    albedo_edge: Float32 | None

    __repr__ = short_repr

    @property
    def known(self) -> Bool:
        """``(H, W)`` bool, where the fields are compared."""
        return np.asarray(self.weight > 0)


class _Slopes(NamedTuple):
    column: Float32
    row: Float32
    variance: Float32
    known: Bool


def field_difference(before: Field, after: Field, holds: Bool) -> Difference:
    """Return the difference of two fields with error bars on the same pixels.

    In every neighbourhood, what a smoothly varying linear map of the normals, a shift and a
    difference of blur explain is removed.

    Parameters
    ----------
    before, after
        Fields of one size.
    holds
        ``(H, W)`` bool, where their registration holds.

    Raises
    ------
    DataError
        If they have no pixel in common.
    """
    first, second = _slopes(before), _slopes(after)
    known = first.known & second.known & holds
    inner = cv2.erode(
        known.astype(np.uint8), np.ones((2 * _BORDER + 1,) * 2, np.uint8), borderValue=0
    )
    known = inner > 0
    if not known.any():
        raise DataError(
            f"the fields have no pixel with error bars in common that is {_BORDER} pixels away "
            "from the border"
        )
    variance = first.variance + second.variance
    p, q = (np.where(known, (a + b) / 2, 0) for a, b in zip(first[:2], second[:2], strict=True))
    slopes = np.stack([second.column - first.column, second.row - first.row])
    slopes = np.where(known, slopes, 0).astype(np.float32)
    one, none = np.ones_like(p), np.zeros_like(p)
    bends = (_derivatives(p), _derivatives(q))
    regressors = [
        ((one, none), _LIGHTS),
        ((none, one), _LIGHTS),
        ((p, none), _LIGHTS),
        ((q, none), _LIGHTS),
        ((none, p), _LIGHTS),
        ((none, q), _LIGHTS),
        ((p * p, p * q), _LIGHTS),
        ((p * q, q * q), _LIGHTS),
        *(((of_p, of_q), _SHIFT) for of_p, of_q in zip(bends[0][:2], bends[1][:2], strict=True)),
        ((bends[0][2], bends[1][2]), _BLUR),
    ]
    log_albedo, albedo_weight, albedo_edge, dark = None, None, None, []
    if before.albedo is not None and after.albedo is not None:
        # Errors along and across the normal are about equal.
        a, b = (_logarithm(one.albedo) for one in (before, after))
        lit = known & np.isfinite(a) & np.isfinite(b)
        change = np.where(lit, b - a, 0)[None].astype(np.float32)
        mean = np.where(lit, (a + b) / 2, np.mean((a + b)[lit]) / 2 if lit.any() else 0)
        bend = _derivatives(mean.astype(np.float32))
        # Noise of photons and of the sensor, relative to the signal.
        shade = np.exp(np.median(mean[known]) - mean).astype(np.float32)
        dark = [variance * shade, variance * shade**2]
        of_albedo = [
            *(((of,), _LIGHTS) for of in (one, p, q)),
            *(((of,), _SHIFT) for of in bend[:2]),
            ((bend[2],), _BLUR),
        ]
        edges = _edges(bend)
        albedo_edge = np.sqrt(edges[0])
        change, albedo_weight = _without(change, of_albedo, [variance, *dark, *edges], lit)
        log_albedo = change[0]
    slopes, weight = _without(slopes, regressors, [variance, *dark, *_edges(*bends)], known)
    return Difference(slopes, weight, log_albedo, albedo_weight, albedo_edge)


def _logarithm(albedo: Float32 | None) -> Float32:
    values = np.asarray(albedo)
    return np.asarray(np.log(np.where(values > 0, values, np.nan)), np.float32)


def _slopes(field: Field) -> _Slopes:
    """Return slopes and the variance of one, without errors that neighbours share."""
    x, y, z = np.moveaxis(field.normal_map.normals, 2, 0)
    steep = np.hypot(x, y) > _STEEPEST * z
    sigma = np.asarray(field.sigma_deg)
    known = field.mask & (z > 0) & ~steep & np.isfinite(sigma)
    facing = np.where(known, z, 1)
    square = np.square(np.radians(sigma))
    if field.common_sigma_deg is not None:
        square = square - np.square(np.radians(field.common_sigma_deg))
    # A turn by an angle changes a slope s by 1 + s^2 along it, and by its root across.
    stretch = facing**-3
    variance = np.where(known, np.maximum(square, 1e-8) / 2 * stretch, 1)
    return _Slopes(
        np.asarray(np.where(known, -x / facing, 0), np.float32),
        np.asarray(np.where(known, y / facing, 0), np.float32),
        np.asarray(variance, np.float32),
        np.asarray(known),
    )


def _derivatives(values: Float32) -> tuple[Float32, Float32, Float32]:
    """Return derivatives along columns and rows, and the Laplacian."""
    smooth = np.asarray(cv2.GaussianBlur(values.astype(np.float32), (0, 0), 0.7), np.float32)
    along = np.array([[-0.5, 0, 0.5]])
    found = (
        cv2.filter2D(smooth, -1, along),
        cv2.filter2D(smooth, -1, along.T),
        cv2.Laplacian(smooth, cv2.CV_32F),
    )
    column, row, bend = (np.asarray(of, np.float32) for of in found)
    return column, row, bend


def _edges(*bends: tuple[Float32, Float32, Float32]) -> list[Float32]:
    """Return squares of first and second derivatives, where shifts and resampling leave errors."""
    first = sum(column**2 + row**2 for column, row, _ in bends) / len(bends)
    second = sum(laplacian**2 for *_, laplacian in bends) / len(bends)
    return [
        np.asarray(cv2.GaussianBlur(np.asarray(of, np.float32), (0, 0), 1.0), np.float32)
        for of in (first, second)
    ]


def _without(
    values: Float32,
    regressors: Sequence[tuple[tuple[Float32, ...], float]],
    parts: list[Float32],
    known: Bool,
) -> tuple[Float32, Float32]:
    """Return values ``(C, H, W)`` without what regressors explain nearby, and their weights.

    Their variance is a sum of shares of ``parts``, of which the first is that of the error bars.
    """
    priors = np.array([prior for _, prior in regressors])
    left = values
    expected = np.asarray(parts[0] * _scale(values, parts[0], known), np.float32)
    robust = np.ones_like(values)
    for _ in range(_ROUNDS):
        weights = np.where(known, robust / expected, 0)
        fitted = _fitted(values, [of for of, _ in regressors], weights, priors)
        left = np.where(known, values - fitted, 0).astype(np.float32)
        square = np.mean(np.square(left), axis=0)
        expected = _expected(square, parts, known)
        robust = np.asarray((_FREEDOM + 1) / (_FREEDOM + np.square(left) / expected), np.float32)
    return left, np.asarray(np.where(known, 1 / expected, 0), np.float32)


def _scale(values: Float32, variance: Float32, known: Bool) -> float:
    """Return the factor of the variances that the median of the values shows."""
    square = np.square(values[:, known]) / variance[known]
    return float(np.median(square)) / 0.455 + 1e-12


def _expected(square: Float32, parts: list[Float32], known: Bool) -> Float32:
    """Return the expected squares: the sum of shares of the parts that fits best."""
    seen = square[known].astype(np.float64)
    every = 1 + seen.size // _MOST_SEEN
    columns = np.stack([of[known][::every].astype(np.float64) for of in parts])
    seen = seen[::every]
    gains = np.maximum(columns.mean(axis=1), 1e-30)
    columns /= gains[:, None]
    shares = np.array([np.median(seen), *[0.0] * (len(parts) - 1)])
    for _ in range(_ROUNDS):
        now = shares @ columns + 1e-30
        # Squares far beyond the expectation are changes.
        bounded = np.minimum(seen, _CHANGED * now)
        shares = nnls((columns / now).T, bounded / now)[0]
    total = sum(share * of for share, of in zip(shares / gains, parts, strict=True))
    return np.asarray(np.maximum(total, 1e-12), np.float32)


def _fitted(
    values: Float32, regressors: list[tuple[Float32, ...]], weights: Float32, priors: Float64
) -> Float32:
    """Return what regressors explain, with coefficients that vary smoothly."""
    height, width = values.shape[1:]
    count = len(regressors)
    rows, columns = -(-height // BLOCK), -(-width // BLOCK)
    normal = np.zeros((rows, columns, count, count))
    right = np.zeros((rows, columns, count))
    pad = ((0, rows * BLOCK - height), (0, columns * BLOCK - width))
    for channel, value in enumerate(values):
        basis = np.stack([np.pad(of[channel], pad).astype(np.float32) for of in regressors])
        blocks = _blocks(basis, rows, columns)
        weight = _blocks(np.pad(weights[channel], pad)[None], rows, columns)
        weighted = blocks * weight
        normal += np.einsum("rckn,rcln->rckl", weighted, blocks, optimize=True)
        seen = _blocks(np.pad(value, pad)[None], rows, columns)
        right += np.einsum("rckn,rcn->rck", weighted, seen[:, :, 0], optimize=True)
    smooth = _smoothed(np.concatenate([normal.reshape(rows, columns, -1), right], axis=2))
    normal = smooth[..., : count * count].reshape(rows, columns, count, count)
    normal = normal + np.diag(priors**-2)
    found = np.linalg.solve(normal, smooth[..., count * count :, None])[..., 0]
    fitted = np.zeros(values.shape, np.float32)
    for k, of in enumerate(regressors):
        coefficient = enlarged(found[..., k], (height, width), BLOCK)
        for channel in range(len(values)):
            fitted[channel] += coefficient * of[channel]
    return fitted


def enlarged(values: Floating, shape: tuple[int, int], block: int) -> Float32:
    """Return values of blocks ``(rows, columns)``, interpolated between their middles."""
    rows, columns = (((np.arange(n) + 0.5) / block - 0.5).astype(np.float32) for n in shape)
    made = cv2.remap(
        np.ascontiguousarray(values, np.float32),
        *np.meshgrid(columns, rows),
        interpolation=cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    )
    return np.asarray(made, np.float32)


def _blocks(maps: Float32, rows: int, columns: int) -> Float32:
    """Return ``(rows, columns, maps, pixels)``."""
    parts = maps.reshape(len(maps), rows, BLOCK, columns, BLOCK)
    return np.asarray(parts.transpose(1, 3, 0, 2, 4).reshape(rows, columns, len(maps), -1))


def _smoothed(sums: Float64) -> Float64:
    """Return sums over windows around each block."""
    made = np.zeros_like(sums)
    for k in range(sums.shape[2]):
        # A Gaussian with 1 in its middle.
        made[..., k] = cv2.GaussianBlur(
            sums[..., k], (0, 0), _WINDOW, borderType=cv2.BORDER_CONSTANT
        ) * (2 * np.pi * _WINDOW**2)
    return made
