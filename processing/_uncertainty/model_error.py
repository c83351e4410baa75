"""Errors of normals where the surface is not matte, from what the noise does not explain."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

Float = npt.NDArray[np.float32]
Double = npt.NDArray[np.float64]

# Sums over this many pixels across, drawn toward 1 by a few degrees of freedom.
_ACROSS = 5
_PRIOR = 50.0
# Residuals are not noise beyond this many standard deviations of their mean square; they count
# completely from twice as many on, so that the error has no step at the limit.
_SIGMAS = 4.0
# Variance of the normal relative to N times that of independent residuals, and share of the mean
# deviation of the object that every pixel has besides its own: from simulated materials.
_COHERENT = 1.6
_COMMON = 0.7
# Power of the share that a reflectance leaves.
_LEFT = 3


def agreement(chi2: Float, free: Float) -> Float:
    """Return the mean square of normalised residuals around each pixel, ``(H, W)``.

    Parameters
    ----------
    chi2, free
        ``(H, W)`` sums of squares and their degrees of freedom, 0 without residuals.
    """
    return np.asarray((_around(chi2) + _PRIOR) / (_around(free) + _PRIOR), np.float32)


def model_errors(
    noise: Float,
    lights: Float,
    chi2: Float,
    free: Float,
    left: Float,
    products: Float,
    paired: Float,
) -> tuple[Float, Float]:
    """Return variances by the model, and the share of differences that are errors.

    Noise is independent from pixel to pixel and from light to light, and N lights average it. Where
    the surface is not matte, residuals of neighbouring pixels are alike: the mean of their products
    is the variance of the deviation from a matte surface. Such deviations are also alike for
    neighbouring lights, and many lights do not average them: their effect on the normal is about N
    times that of independent residuals of this size. Normals that a reflectance explains better
    than the reference have a smaller error; it falls with what the reflectance leaves. The factors
    are measured on simulated materials.

    Parameters
    ----------
    noise, lights
        ``(H, W)`` variances by noise and lights, 0 where there is no solution.
    chi2, free
        Sums of squares of the normalised residuals of the reference, and degrees of freedom.
    left
        Sums of squares that a reflectance at the given normal leaves.
    products, paired
        Sums of products of the residuals with those of a neighbour, and their degrees of freedom, 0
        without a neighbour.
    """
    total = noise + lights
    solved = total > 0
    share = np.divide(lights, total, out=np.zeros_like(total), where=solved)
    pairs = _around(paired)
    # Errors of the lights are the same in all pixels.
    spread = 1 / np.sqrt(np.maximum(pairs, 1)) + share * np.sqrt(2 / np.maximum(free, 1))
    alike = np.divide(_around(products), pairs, out=np.zeros_like(total), where=pairs > 0)
    excess = alike - share
    excess *= np.clip(excess / (_SIGMAS * spread) - 1, np.float32(0), np.float32(1))
    explained = np.minimum(agreement(left, free) / agreement(chi2, free), 1)
    kept = np.where(excess > 0, explained, np.float32(1)) ** _LEFT
    own = np.sqrt(_COHERENT * kept * excess * total * (free + 3))
    return np.asarray(own**2, np.float32), np.asarray(kept, np.float32)


def deviations(model: Float, total: Float) -> tuple[Double, npt.NDArray[np.intp]]:
    """Return sums ``(H,)`` of deviations over rows, and numbers ``(H,)`` of pixels with a solution.

    Parameters
    ----------
    model
        ``(H, W)`` variances of `model_errors`.
    total
        ``(H, W)`` variances by noise and lights, 0 where there is no solution.
    """
    return np.sqrt(model).sum(axis=1, dtype=np.float64), np.count_nonzero(total > 0, axis=1)


def common_error(sums: Double, solved: npt.NDArray[np.intp]) -> float:
    """Return the variance that every pixel has besides its own, from all rows of `deviations`.

    It is from the mean deviation of the object, because the part of a broad highlight that is
    linear in the direction of the light turns normals and leaves no residual.
    """
    pixels = int(solved.sum())
    return (_COMMON * float(sums.sum()) / pixels) ** 2 if pixels else 0.0


def _around(part: Float) -> Float:
    found = cv2.boxFilter(
        part, -1, (_ACROSS, _ACROSS), normalize=False, borderType=cv2.BORDER_CONSTANT
    )
    return np.asarray(found)
