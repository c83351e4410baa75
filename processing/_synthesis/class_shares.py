"""Shares of the classes of patches in a sheet that is as steep as its exemplar."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt
from scipy.optimize import nnls

Float = npt.NDArray[np.float32]
Double = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

_ROUNDS = 20
# Rounding errors of the use of a pixel that is in no patch are smaller.
_UNUSED = 1e-5
_LEVELS = 32
# The mean angle counts more than a level of its distribution, even use less, the sum most.
_MEAN, _EVEN, _SUM = 3.0, 0.1, 100.0


def class_shares(angle: Float, classes: npt.NDArray[np.int32], mask: Mask, patch: int) -> Double:
    """Return the share of the patches that each class should have.

    Together, the pixels of the patches have nearly the distribution of angles that the exemplar
    has inside its mask, also where no patch fits. Otherwise the shares are those that use all
    pixels equally often.

    Parameters
    ----------
    angle
        ``(h, w)`` angles of the exemplar.
    classes
        ``(h, w)``: class of the patch that starts here, -1 where none fits.
    mask
        Where the exemplar has a normal.
    patch
        Side of the patches.
    """
    often = _even_use(classes >= 0, mask, patch)
    known = angle[mask]
    levels = np.quantile(known, np.arange(1, _LEVELS + 1) / (_LEVELS + 1))
    above = np.searchsorted(levels, angle)[mask]
    uses = [
        np.maximum(_use(np.where(classes == number, often, np.float32(0)), patch), 0)[mask]
        for number in range(classes.max() + 1)
    ]
    even = np.array([np.sum(use, dtype=np.float64) for use in uses])
    # Of each class, and of the exemplar: the shares of the pixels below each level.
    below = np.stack([_below(above, use) for use in uses], axis=1)
    wanted = _below(above, np.ones_like(known))
    means = np.array([np.average(known, weights=use) for use in uses])
    even /= even.sum()
    # Squared differences of the distributions, integrated over the angle, which the spread divides.
    spread = float(known.std(dtype=np.float64)) or 1.0
    width = np.sqrt(np.diff([*levels, known.max()]) / spread)
    rows = [
        width[:, None] * below,
        _MEAN * means[None] / spread,
        _EVEN * np.diag(1 / np.sqrt(even)),
        np.full((1, len(even)), _SUM),
    ]
    mean = float(np.mean(known, dtype=np.float64))
    goal = [width * wanted, [_MEAN * mean / spread], _EVEN * np.sqrt(even), [_SUM]]
    found = nnls(np.concatenate(rows), np.concatenate(goal))[0]
    shares: Double = found / found.sum()
    return shares


def _below(above: npt.NDArray[np.intp], use: Float) -> Double:
    """Return the share of the use of pixels below each level; ``above`` counts levels."""
    counts = np.bincount(above, use, minlength=_LEVELS + 1)
    shares: Double = np.cumsum(counts)[:-1] / counts.sum()
    return shares


def _even_use(places: Mask, mask: Mask, patch: int) -> Float:
    """Return how often to start a patch at each place, so that pixels are used equally often.

    A pixel at a border of the mask is in fewer patches than one inside. The frequencies that make
    up for it are found by the multiplicative iteration of Richardson and Lucy.
    """
    often = places.astype(np.float32)
    for _ in range(_ROUNDS):
        use = _use(often, patch)
        missing = np.where(mask & (use > _UNUSED), 1 / np.maximum(use, _UNUSED), 0)
        often *= patch_means(missing.astype(np.float32), patch)
    return often


def _use(often: Float, patch: int) -> Float:
    """Return how often each pixel is used if patches start at the places this often."""
    corner = (patch - 1, patch - 1)
    use = cv2.boxFilter(often, -1, (patch, patch), anchor=corner, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(use, np.float32)


def patch_means(values: Float, patch: int) -> Float:
    """Return the mean of the patch that starts at each pixel; pixels outside count as 0."""
    means = cv2.boxFilter(values, -1, (patch, patch), anchor=(0, 0), borderType=cv2.BORDER_CONSTANT)
    return np.asarray(means, np.float32)
