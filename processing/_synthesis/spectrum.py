"""Power of a detail component in radial bands of frequency, and its correction."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
import numpy.typing as npt
from scipy.fft import rfft2
from scipy.optimize import least_squares

from processing._normal_map import NormalMap
from processing._synthesis.strips import SheetRows

Float = npt.NDArray[np.float32]
Double = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

BANDS = 16
_BLOCKS = (64, 32)
# More blocks do not make the mean more accurate than the exemplar's own is.
_MOST_BLOCKS = 400
# Standard deviations in pixels of the Gaussians that a correction is a sum of.
_SIGMAS = (0.7, 1.0, 2.0, 4.0, 8.0)
_COPIES = 1 + len(_SIGMAS)
_MOST_COPIED = 100
_REACH = 24
_LEAST_GAIN, _MOST_GAIN = 0.1, 1.5
_RIDGE = 0.003
# The mean angle of a sheet is measured on every eighth row.
_SAMPLED, _ANGLE_ERROR, _MOST_STEEPER = 8, 0.04, 1.25
# Power below this share of the largest is not corrected further.
_LEAST_POWER = 1e-4
_ROWS = 512


def block_side(*masks: Mask) -> int:
    """Return the largest side of blocks of which some fit into each mask; 0 if none do."""
    return next((b for b in _BLOCKS if all(len(_blocks(mask, b)) for mask in masks)), 0)


def _blocks(mask: Mask, block: int) -> npt.NDArray[np.int64]:
    """Return the first pixels ``(n, 2)`` of the overlapping blocks that lie inside a mask."""
    rows, columns = mask.shape
    if min(rows, columns) < block:
        return np.zeros((0, 2), np.int64)
    holes = np.zeros((rows + 1, columns + 1), np.int32)
    np.cumsum(np.cumsum(~mask, axis=0, dtype=np.int32), axis=1, out=holes[1:, 1:])
    inside = holes[block:, block:] - holes[:-block, block:]
    inside += holes[:-block, :-block] - holes[block:, :-block]
    step = block // 4
    return np.argwhere(inside[::step, ::step] == 0) * step


def band_power(part: NormalMap, block: int) -> Double:
    """Return the mean power of n_x and n_y in radial bands of frequency.

    Parameters
    ----------
    part
        Detail component.
    block
        Side of the windowed blocks that are averaged, of which some fit into the mask.

    Returns
    -------
    Double
        ``(16,)``; the bands have equal widths up to 0.5 cycles per pixel. The mean of a block is
        in no band.
    """
    return _banded(_power(part, block))


def _power(part: NormalMap, block: int) -> Double:
    """Return the mean power ``(block, block / 2 + 1)`` of n_x and n_y in windowed blocks."""
    places = _blocks(part.mask, block)
    places = places[:: -(-len(places) // _MOST_BLOCKS)]
    taper = _taper(block)
    power = np.zeros((block, block // 2 + 1))
    for y, x in places:
        values = part.normals[y : y + block, x : x + block, :2]
        values = (values - values.mean(axis=(0, 1))) * taper
        power += np.square(np.abs(rfft2(values, axes=(0, 1)))).sum(axis=2)
    mean: Double = power / len(places)
    return mean


def _taper(block: int) -> Float:
    window = np.hanning(block + 2)[1:-1].astype(np.float32)
    return (window[:, None] * window)[..., None]


def _frequencies(power: Double) -> Double:
    """Return the frequency of each value of a power in cycles per pixel."""
    found: Double = np.hypot(np.fft.fftfreq(len(power))[:, None], np.fft.rfftfreq(len(power)))
    return found


def _bands(power: Double) -> npt.NDArray[np.int64]:
    return np.ceil(_frequencies(power) * 2 * BANDS).astype(np.int64).ravel()


def _band_counts(power: Double) -> npt.NDArray[np.int64]:
    return np.bincount(_bands(power))[1 : BANDS + 1]


def _banded(power: Double) -> Double:
    """Return the mean of a power in each band."""
    sums = np.bincount(_bands(power), power.ravel())[1 : BANDS + 1]
    means: Double = sums / _band_counts(power)
    return means


def match_spectrum(sheet: SheetRows, exemplar: NormalMap, *, wrapped: bool) -> None:
    """Filter a detail component so that its power in each band becomes that of an exemplar.

    The cuts between patches add power at low frequencies, because patches no longer end where
    their slopes add up to 0, and at the highest. The filter is isotropic and close to 1 elsewhere.
    One factor on all slopes, at most 1.25, gives the sheet the power of the exemplar, as far as its
    mean angle differs from that of the exemplar by at most 4 %.

    Parameters
    ----------
    sheet
        ``(H, W, 3)`` unit vectors, corrected in place. Nothing is changed if sheet or exemplar are
        too small to measure their power.
    exemplar
        Detail component with the intended power.
    wrapped
        Whether the last column and row continue at the first.
    """
    block = block_side(exemplar.mask, _inner(sheet))
    if not block:
        return
    powers, wanted = _powers_of_copies(sheet, block), band_power(exemplar, block)
    sampled = [_mean_angle(sheet[row : row + 1]) for row in range(0, sheet.shape[0], _SAMPLED)]
    steeper = _mean_angle(exemplar.normals[exemplar.mask]) / float(np.mean(sampled))
    stronger = np.sqrt(_total(wanted, block) / _total(powers[:, 0, 0], block))
    # The angle is that of the complete mask, the power only that of blocks inside.
    factor = np.clip(stronger, (1 - _ANGLE_ERROR) * steeper, (1 + _ANGLE_ERROR) * steeper)
    factor = np.clip(factor, 1 / _MOST_STEEPER, _MOST_STEEPER)
    _filter(sheet, (factor * _weights(powers, wanted, block)).astype(np.float32), wrapped=wrapped)


def _total(powers: Double, block: int) -> float:
    """Return the power of all bands."""
    return float(powers @ _band_counts(np.zeros((block, block // 2 + 1))))


def _mean_angle(vectors: Float) -> float:
    slopes = np.hypot(vectors[..., 0], vectors[..., 1])
    return float(np.mean(np.arctan2(slopes, vectors[..., 2]), dtype=np.float64))


def _inner(sheet: SheetRows) -> Mask:
    """Return a mask of the sheet without its margins."""
    height, width = sheet.shape[:2]
    return np.ones((max(height - 2 * _REACH, 0), max(width - 2 * _REACH, 0)), np.bool_)


def _powers_of_copies(sheet: SheetRows, block: int) -> Double:
    """Return how the power of a weighted sum of smoothed copies depends on their weights.

    Parameters
    ----------
    sheet
        ``(H, W, 3)`` vectors.
    block
        Side of the blocks in which the power is measured.

    Returns
    -------
    Double
        ``(16, copies, copies)``, one matrix C for each band: a sum of the copies, weighted by w,
        has the power ``w C w``. The first copy is the sheet, the others are smoothed by the
        Gaussians. All are measured: the response of a Gaussian at the frequency of a band would
        not do, because the window of a block spreads power over neighbouring bands.
    """
    places = _blocks(_inner(sheet), block)
    places = places[:: -(-len(places) // _MOST_COPIED)]
    taper, whole = _taper(block), block + 2 * _REACH
    products = np.zeros((block * (block // 2 + 1), _COPIES, _COPIES))
    for y, x in places:
        window = np.ascontiguousarray(sheet[y : y + whole][:, x : x + whole, :2])
        copies = np.stack([one[_REACH:-_REACH, _REACH:-_REACH] for one in _copies(window)])
        copies = (copies - copies.mean(axis=(1, 2), keepdims=True)) * taper
        waves = rfft2(copies, axes=(1, 2)).reshape(_COPIES, -1, 2).transpose(1, 0, 2)
        products += (waves @ waves.conj().transpose(0, 2, 1)).real
    number = _bands(np.zeros((block, block // 2 + 1)))
    return np.stack([products[number == b].mean(axis=0) for b in range(1, BANDS + 1)]) / len(places)


def _copies(window: Float) -> Iterator[Float]:
    """Yield ``(h, w, 2)`` slopes, unfiltered and smoothed by each Gaussian."""
    yield window
    for sigma in _SIGMAS:
        side = 2 * min(int(np.ceil(3 * sigma)), _REACH) + 1
        yield np.asarray(cv2.GaussianBlur(window, (side, side), sigma), np.float32)


def _weights(powers: Double, wanted: Double, block: int) -> Double:
    """Return the weights of the copies that give a sheet an intended power in each band.

    The total power stays as it is.
    """
    has, first = powers[:, 0, 0], np.eye(_COPIES)[0]
    wanted = wanted * _total(has, block) / _total(wanted, block)
    # A filter this smooth cannot fit all bands of a narrow spectrum: those with power come first.
    important = 1 + wanted / wanted.max()
    wanted = np.maximum(wanted, _LEAST_POWER * wanted.max())
    wanted = np.clip(wanted, _LEAST_GAIN**2 * has, _MOST_GAIN**2 * has)

    def misfit(weights: Double) -> Double:
        power = np.einsum("bij,i,j->b", powers, weights, weights)
        ratio = np.maximum(power, 1e-12 * wanted) / wanted
        # The ridge keeps the filter close to 1.
        return np.concatenate([important * np.log(ratio) / 2, _RIDGE * (weights - first)])

    weights = least_squares(misfit, first, method="lm").x
    power = np.einsum("bij,i,j->b", powers, weights, weights)
    scaled: Double = weights * np.sqrt(_total(has, block) / _total(power, block))
    return scaled


def _filter(sheet: SheetRows, weights: Float, *, wrapped: bool) -> None:
    """Replace n_x and n_y by a sum of smoothed copies, in bands of rows, and normalise."""
    border, height = cv2.BORDER_WRAP if wrapped else cv2.BORDER_REFLECT_101, sheet.shape[0]
    # Copies of rows that are replaced before they are read.
    upper = sheet[: _REACH + 1][..., :2].copy()
    lower = sheet[height - _REACH - 1 : height][..., :2].copy()
    above = lower[1:] if wrapped else upper[:0:-1]
    beyond = upper[:-1] if wrapped else lower[-2::-1]
    for first in range(0, height, _ROWS):
        last = min(first + _ROWS, height)
        part = sheet[first:last].copy()
        below = sheet[last : min(last + _REACH, height)][..., :2]
        below = np.concatenate([below, beyond])[:_REACH]
        band = np.concatenate([above, part[..., :2], below])
        above = band[-2 * _REACH : -_REACH]
        band = np.asarray(cv2.copyMakeBorder(band, 0, 0, _REACH, _REACH, border), np.float32)
        total = np.zeros_like(band)
        for weight, copy in zip(weights, _copies(band), strict=True):
            total += weight * copy
        part[..., :2] = total[_REACH:-_REACH, _REACH:-_REACH]
        part /= np.sqrt(np.square(part).sum(axis=2, keepdims=True))
        sheet[first:last] = part
