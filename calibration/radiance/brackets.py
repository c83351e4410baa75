"""Brackets of one light, merged by their variances."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np

from acquisition import Frame
from rig import Notice
from rig.arrays import Bool, Float32, Float64, UInt8

# Charge may flow into pixels this far from a saturated one.
BLOOMING_PX = 2
# A sample this many standard deviations below white is clipped in one of 30,000 cases.
_CLEAR_OF_WHITE_SD = 4.0
# The share of the range that counts without a law of the noise; above it, a sensor with more than
# 6,400 electrons has no clipped noise.
_CLEAR_OF_WHITE = 0.95
# Brackets are compared where the longer one has between a tenth and four fifths of its range, in
# every fourth group of rows.
_COMPARED = (0.1, 0.8)
_GROUP = 32
_EVERY_GROUP = 4
_LEAST_COMPARED_PX = 500
_CONTRADICTION = 0.02


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


def grown(near_white: Bool) -> Bool:
    """Return the samples near others that are close to white: ``(H, W)`` or ``(H, W, 3)``."""
    if not near_white.any():
        return near_white
    size = 2 * BLOOMING_PX + 1
    wide = cv2.dilate(near_white.view(np.uint8), np.ones((size, size), np.uint8))
    return np.asarray(wide, np.uint8).astype(np.bool_)


def merge(
    radiance: Sequence[Float32],
    usable: Sequence[Bool],
    exposure: Sequence[float],
    laws: Sequence[Law] | None,
) -> Float32:
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


def bits(usable: Sequence[Bool]) -> UInt8:
    """Return the brackets that count at each sample: bit b is set if bracket b does."""
    used = np.zeros(usable[0].shape, np.uint8)
    for b, on in enumerate(usable):
        used |= on.view(np.uint8) << np.uint8(b)
    return used


def _mean(images: Sequence[Float32], weights: Sequence[Float32]) -> Float32:
    """Return the weighted mean of finite images, NaN where all weights are 0."""
    total: Float32 = images[0] * weights[0]
    weight = weights[0].copy()
    for image, of_one in zip(images[1:], weights[1:], strict=True):
        total += image * of_one
        weight += of_one
    with np.errstate(invalid="ignore"):
        total /= weight
    return total


class BracketRatios:
    """Compares each bracket of a light with the next shorter one, also in several threads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        # For each light and pair of exposure times, shorter and longer: per row the sums of the
        # radiance of both, and the number of pixels. Rows may be added again.
        self._sums: dict[tuple[str, float, float], Float64] = {}

    def add(
        self,
        frames: Sequence[Frame],
        shares: Sequence[float],
        radiance: Sequence[Float32],
        usable: Sequence[Bool],
        merged: Float32,
        top: int,
    ) -> None:
        """Add some rows of the B brackets of a light.

        Parameters
        ----------
        frames
            A frame of each bracket, the longest exposure first.
        shares
            Their exposure times relative to the longest of the source.
        radiance, usable
            Image of each bracket, and where it counts.
        merged
            The merged image.
        top
            First row in the frames.
        """
        rows = np.arange(len(merged)) + top
        rows = rows[rows // _GROUP % _EVERY_GROUP == 0]
        if not len(rows):
            return
        part = rows - top
        for b, (longer, shorter) in enumerate(pairwise(frames)):
            low, high = (limit / shares[b] for limit in _COMPARED)
            level = merged[part]
            both = usable[b][part] & usable[b + 1][part] & (level > low) & (level < high)
            across = tuple(range(1, both.ndim))
            sums = np.stack(
                [
                    radiance[b + 1][part].sum(axis=across, where=both, dtype=np.float64),
                    radiance[b][part].sum(axis=across, where=both, dtype=np.float64),
                    both.sum(axis=across),
                ],
                axis=1,
            )
            key = (longer.light_id, shorter.exposure_us or 0.0, longer.exposure_us or 0.0)
            with self._lock:
                of_rows = self._sums.setdefault(key, np.zeros((longer.shape[0], 3)))
                of_rows[rows] = sums

    @property
    def notices(self) -> list[Notice]:
        """Return a notice for each pair of exposure times whose images contradict them."""
        pairs: dict[tuple[int, int], list[tuple[float, float, float]]] = {}
        with self._lock:
            compared = [(key, *of_rows.sum(axis=0)) for key, of_rows in sorted(self._sums.items())]
        for (_, shorter_us, longer_us), of_shorter, of_longer, pixels in compared:
            if pixels >= _LEAST_COMPARED_PX:
                found = pairs.setdefault((round(shorter_us), round(longer_us)), [])
                found.append((of_shorter / of_longer, shorter_us, longer_us))
        notices = []
        for found in pairs.values():
            ratio = float(np.median([of_one[0] for of_one in found]))
            if abs(ratio - 1) > _CONTRADICTION:
                _, shorter_us, longer_us = found[0]
                text = (
                    f"images of {shorter_us:g} us are {ratio:.2f} times as bright as those of "
                    f"{longer_us:g} us let expect: check the exposure times, the black level and "
                    "the linearity of the camera"
                )
                notices.append(Notice("brackets-contradict", text))
        return notices
