"""Brackets of one light, merged by their variances."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

FloatImage = npt.NDArray[np.float32]
Bools = npt.NDArray[np.bool_]

# Charge may flow into pixels this far from a saturated one.
BLOOMING_PX = 2
# A sample this many standard deviations below white is clipped in one of 30,000 cases.
_CLEAR_OF_WHITE_SD = 4.0
# The share of the range that counts without a law of the noise; above it, a sensor with more than
# 6,400 electrons has no clipped noise.
_CLEAR_OF_WHITE = 0.95


@dataclass(frozen=True)
class Law:
    """Variance of a bracket at radiance x: ``slope * x + floor``."""

    slope: float
    floor: float


def clear_of_white(white: Law | None) -> float:
    """Return the signal, 1 at white, below which noise reaches white in no sample.

    ``white`` is the law of a single frame in units of its own signal.
    """
    if white is None:
        return _CLEAR_OF_WHITE
    return float(max(1 - _CLEAR_OF_WHITE_SD * (white.slope + white.floor) ** 0.5, 0.5))


def grown(near_white: Bools) -> Bools:
    """Return the samples near others that are close to white: ``(H, W)`` or ``(H, W, 3)``."""
    if not near_white.any():
        return near_white
    size = 2 * BLOOMING_PX + 1
    wide = cv2.dilate(near_white.view(np.uint8), np.ones((size, size), np.uint8))
    return np.asarray(wide, np.uint8).astype(np.bool_)


def merge(
    radiance: Sequence[FloatImage],
    usable: Sequence[Bools],
    exposure: Sequence[float],
    laws: Sequence[Law] | None,
) -> FloatImage:
    """Merge B brackets of one light.

    Parameters
    ----------
    radiance
        B images in one unit, each the mean of its repeats.
    usable
        B masks of the samples that count.
    exposure
        B exposure times in any unit, times the number of repeats.
    laws
        Variance of each bracket in the unit of the images; None if it is not known: the weights are
        then the exposure times, which is best if all noise is shot noise.

    Returns
    -------
    NDArray
        float32, NaN where no bracket is usable.
    """
    if len(radiance) == 1:
        return np.where(usable[0], radiance[0], np.float32(np.nan))
    merged = _mean(radiance, [on * np.float32(t) for on, t in zip(usable, exposure, strict=True)])
    if laws is None:
        return merged
    lit = np.fmax(merged, np.float32(0))
    weights = []
    for on, law in zip(usable, laws, strict=True):
        variance = lit * np.float32(law.slope)
        variance += np.float32(law.floor)
        weights.append(np.divide(on, variance, dtype=np.float32))
    return _mean(radiance, weights)


def bits(usable: Sequence[Bools]) -> npt.NDArray[np.uint8]:
    """Return the brackets that count at each sample: bit b is set if bracket b does."""
    used = np.zeros(usable[0].shape, np.uint8)
    for b, on in enumerate(usable):
        used |= on.view(np.uint8) << np.uint8(b)
    return used


def _mean(images: Sequence[FloatImage], weights: Sequence[FloatImage]) -> FloatImage:
    """Return the weighted mean of finite images, NaN where all weights are 0."""
    total: FloatImage = images[0] * weights[0]
    weight = weights[0].copy()
    for image, of_one in zip(images[1:], weights[1:], strict=True):
        total += image * of_one
        weight += of_one
    with np.errstate(invalid="ignore"):
        total /= weight
    return total
