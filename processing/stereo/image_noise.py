"""The noise of images whose sensor is unknown, from the differences between neighbouring pixels."""

from __future__ import annotations

import numpy as np

from acquisition import DataError
from calibration import StackNoise
from processing.stereo.cauchy import FEW_SAMPLES, cauchy
from processing.stereo.frames import Frames
from processing.stereo.least_squares import least_squares
from processing.stereo.light_model import LightModel
from processing.stereo.pixel_algebra import MAD_TO_SIGMA
from rig import pluralize
from rig.arrays import Bool, Float32, Float64, Intp

# Pairs of neighbours that are compared, and the fewest that show the noise.
_PAIRS = 3000
_FEWEST_PAIRS = 100
# Fewest samples of a pair: three explain the change of albedo and normal.
_FEWEST_LIT = 5
# Samples above this share of the mean are lit.
_DARK = 0.05
_BINS = 8
# Least squares of few samples explain a part of their noise, too. A difference of whose variance
# they leave less than this share does not show it.
_LEAST_LEFT = 0.3
# Share of the smallest deviations of a bin that determines its spread, and the quantile of the
# normal distribution: edges and highlights change from pixel to pixel, too.
_QUANTILE = 0.25
_QUANTILE_TO_SIGMA = 1 / 0.31864
# Largest standard deviation in those that the residuals of a robust fit show.
_LARGEST = 2.0
# Least variance without light, relative to the least variance of the bins. The samples may not show
# it, and too small a one makes outliers of all samples in shadow.
_LEAST_FLOOR = 0.03
# Least standard deviation, relative to the median signal: images without noise have no law.
_LEAST = 1e-5


class NoiseLaw:
    """The law of the noise of a stack, in the form that an `Estimator` uses.

    Parameters
    ----------
    noise
        Law of the N images.
    shape
        ``(N, H, W)`` of the stack.

    Raises
    ------
    DataError
        If the law belongs to another number of images.
    """

    def __init__(self, noise: StackNoise, shape: tuple[int, int, int]) -> None:
        images, _, self._width = shape
        if len(noise.slope) != images:
            raise DataError(
                f"a law of the noise of {pluralize(len(noise.slope), 'image')} does not fit "
                f"{pluralize(images, 'image')}"
            )
        self._noise = noise
        self._linear: Float64 | None = None
        if noise.linear:
            tile = np.zeros((2, 2))
            floor, unit = (
                np.stack([noise.variance(i, tile + v) for i in range(images)]) for v in (0.0, 1.0)
            )
            self._linear = np.stack([floor, unit - floor]).astype(np.float32)
        self._alike = self._linear is not None and bool(
            np.all(self._linear == self._linear[..., :1, :1])
        )

    def of(self, pixels: Intp, values: Float32, vectors: Float32) -> Float32:
        """Return the law of some samples, ``(1, 2, N)`` or ``(P, 2, N)``, see `Estimator`.

        The law of merged exposures or colours is not linear: its variance at the signal that least
        squares predict is used.

        Parameters
        ----------
        pixels
            ``(P,)`` increasing indices into the flat image.
        values, vectors
            The samples, see `LightModel.samples`.
        """
        if self._alike and self._linear is not None:
            return np.ascontiguousarray(self._linear[None, :, :, 0, 0])
        rows, columns = np.divmod(pixels, self._width)
        if self._linear is not None:
            return np.ascontiguousarray(
                np.moveaxis(self._linear[:, :, rows % 2, columns % 2], 2, 0)
            )
        scaled, _ = least_squares(values, vectors)
        law = np.zeros((len(pixels), 2, values.shape[1]), np.float32)
        first, last = int(rows[0]), int(rows[-1])
        band = np.zeros((last - first + 1, self._width))
        for i in range(values.shape[1]):
            of_image = vectors[:, :, i].astype(np.float64)
            band[rows - first, columns] = np.einsum(
                "pc,pc->p", scaled, np.broadcast_to(of_image, scaled.shape)
            )
            law[:, 0, i] = self._noise.variance(i, band, first)[rows - first, columns]
        return law


def law_of_images(frames: Frames, model: LightModel, mask: Bool) -> Float32 | None:
    """Estimate the law of the noise from the images, None if they do not show it.

    The samples of two neighbours differ by their albedo and their normal, which is linear in the
    light vectors if the reflectance is smooth, and by noise. The noise is what least squares leave
    of the difference. It is that of one sensor at one exposure time: the variance of the samples
    before their division by the intensities is linear in the signal (EMVA 1288).

    Parameters
    ----------
    frames, model
        N images and lights.
    mask
        ``(H, W)`` bool.

    Returns
    -------
    NDArray or None
        ``(1, 2, N)`` variance without light and per value, see `Estimator`.
    """
    intensities = model.intensities
    pairs = np.flatnonzero(mask[:, 1:] & mask[:, :-1])
    if len(frames) < _FEWEST_LIT or len(pairs) < _FEWEST_PAIRS:
        return None
    pairs = pairs[:: 1 + len(pairs) // _PAIRS]
    rows, columns = np.divmod(pairs, mask.shape[1] - 1)
    left = rows * mask.shape[1] + columns
    first, vectors = model.samples(frames, left)
    second, _ = model.samples(frames, left + 1)
    measured = np.isfinite(first) & np.isfinite(second)
    first, second = np.where(measured, first, 0), np.where(measured, second, 0)
    signal = 0.5 * (first.astype(np.float64) + second)
    mean = signal.sum(axis=1, keepdims=True) / np.maximum(measured.sum(axis=1, keepdims=True), 1)
    lit = measured & (np.minimum(first, second) > _DARK * mean)
    difference = np.where(lit, second - first, np.float32(np.nan))
    change, _ = least_squares(difference, vectors)
    usable = lit.sum(axis=1)
    kept = (usable >= _FEWEST_LIT) & change.any(axis=1)
    if np.count_nonzero(kept) < _FEWEST_PAIRS:
        return None
    lit, usable, signal = lit[kept], usable[kept, None], signal[kept]
    of_kept = vectors[kept if len(vectors) > 1 else [0]]
    noise = difference[kept] - np.einsum("pc,pcn->pn", change[kept], of_kept)
    share, level = _parts(of_kept, lit, signal, intensities)
    shows = lit & (share > _LEAST_LEFT)
    noise /= np.sqrt(2 * np.where(shows, share, 1))
    law = _fitted(level[shows], (noise * intensities)[shows], intensities)
    if law is None:
        return None
    # Where many samples are outliers, they spoil the differences more than a robust fit.
    values = np.where(lit, first[kept], np.float32(np.nan))
    scaled, _ = cauchy(values, of_kept)
    residual = values - np.einsum("pc,pcn->pn", scaled, of_kept)
    variance = law[:, 0] + law[:, 1] * np.where(lit, signal, 0)
    # In extreme units the law underflows to 0.
    spread = np.sqrt((1 - 3 / usable) * variance)
    ratio = np.abs(np.divide(residual, spread, out=np.zeros_like(spread), where=spread > 0))
    ratio *= 1 + FEW_SAMPLES / (usable - 3)
    largest = _LARGEST * MAD_TO_SIGMA * float(np.median(ratio[lit]))
    return np.asarray(law * min(largest, 1.0) ** 2, np.float32)


def _parts(
    vectors: Float32, lit: Bool, signal: Float64, intensities: Float64
) -> tuple[Float64, Float64]:
    """Return what the residuals of least squares show of the noise of one sensor.

    With the hat matrix H, the residual of sample i has ``(1 - H)_ij^2`` of the variance of each
    sample j. Before the division by the intensities, this is a share of the variance that a sample
    of another signal has, because the law is linear.

    Returns
    -------
    shares, levels
        ``(P, N)``: the shares, which are 1 minus the leverages if all intensities are equal, and
        the signals before the division by the intensities.
    """
    of_lit = np.where(lit[:, None], vectors, 0).astype(np.float64)
    transposed = of_lit.transpose(0, 2, 1)
    solving = np.linalg.inv(of_lit @ transposed) @ of_lit
    leverage = np.einsum("pin,pin->pn", of_lit, solving)

    def mixed(variances: Float64) -> Float64:
        of_all = (of_lit * variances[:, None]) @ transposed
        others = np.einsum("pin,pin->pn", solving, of_all @ solving)
        return np.asarray(((1 - 2 * leverage) * variances + others) * intensities**2)

    shares = mixed(np.broadcast_to(1 / intensities**2, lit.shape))
    levels = mixed(np.where(lit, signal, 0) / intensities)
    return shares, np.divide(levels, shares, out=np.zeros_like(levels), where=shares > 0)


def _fitted(signal: Float64, noise: Float64, intensities: Float64) -> Float32 | None:
    """Return the law from samples of signal and noise."""
    order = np.argsort(signal, kind="stable")
    bins = np.array_split(order, _BINS)
    level = np.array([np.median(signal[one]) for one in bins])
    spread = [np.quantile(np.abs(noise[one]), _QUANTILE) for one in bins]
    variance = (_QUANTILE_TO_SIGMA * np.array(spread)) ** 2
    least = (_LEAST * float(np.median(signal))) ** 2
    if not (variance > least).all():
        return None
    terms = np.stack([np.ones(_BINS), level], axis=1) / variance[:, None]
    floor, slope = _not_negative(terms, np.ones(_BINS))
    floor = max(floor, _LEAST_FLOOR * float(variance.min()))
    return np.stack([floor / intensities**2, slope / intensities])[None].astype(np.float32)


def _not_negative(terms: Float64, values: Float64) -> tuple[float, float]:
    """Return the least-squares solution ``(2,)`` that is not negative; terms are ``(N, 2)``."""
    both = np.linalg.lstsq(terms, values, rcond=None)[0]
    if (both >= 0).all():
        return float(both[0]), float(both[1])
    # One of them is 0.
    along = terms.T @ values
    alone = np.maximum(along, 0) / np.sum(terms**2, axis=0)
    first = along[0] * alone[0] > along[1] * alone[1]
    return (float(alone[0]), 0.0) if first else (0.0, float(alone[1]))
