"""Power of a detail component in radial bands of frequency, and its correction."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt
from scipy.fft import rfft2

from processing._normal_map import NormalMap

Float = npt.NDArray[np.float32]
Double = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

BANDS = 16
_BLOCKS = (64, 32)
# More blocks do not make the mean more accurate than the exemplar's own is.
_MOST_BLOCKS = 400
# Standard deviations in pixels of the Gaussians that a correction is a sum of.
_SIGMAS = (0.7, 1.0, 2.0, 4.0, 8.0)
_REACH = 24
_LEAST_GAIN, _MOST_GAIN = 0.1, 1.5
_ROUNDS, _RIDGE = 8, 0.01
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
    window = np.hanning(block + 2)[1:-1].astype(np.float32)
    taper = (window[:, None] * window)[..., None]
    power = np.zeros((block, block // 2 + 1))
    for y, x in places:
        values = part.normals[y : y + block, x : x + block, :2]
        values = (values - values.mean(axis=(0, 1))) * taper
        power += np.square(np.abs(rfft2(values, axes=(0, 1)))).sum(axis=2)
    mean: Double = power / len(places)
    return mean


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


def match_spectrum(sheet: Float, exemplar: NormalMap, *, wrapped: bool) -> None:
    """Filter a detail component so that its power in each band becomes that of an exemplar.

    The cuts between patches add power at low frequencies, because patches no longer end where
    their slopes add up to 0, and at the highest. The filter is isotropic and close to 1 elsewhere.

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
    everywhere = np.ones(sheet.shape[:2], np.bool_)
    block = block_side(exemplar.mask, everywhere)
    if not block or min(sheet.shape[:2]) <= 2 * _REACH:
        return
    has = _power(NormalMap.of_unit_vectors(sheet, everywhere), block)
    _filter(sheet, _weights(has, band_power(exemplar, block)), wrapped=wrapped)


def _weights(has: Double, wanted: Double) -> Float:
    """Return the weights of the unfiltered copy and of the Gaussians, for an intended power."""
    spread = np.square(np.array([0.0, *_SIGMAS]))
    responses = [np.exp(-2 * np.pi**2 * s * np.square(_frequencies(has))) for s in spread]
    response = np.stack([_banded(one) for one in responses], axis=1)
    # The sheet stays as steep as it is: equal use of the exemplar decides that, not few blocks.
    counts = _band_counts(has)
    total = _banded(has) @ counts
    wanted = wanted * total / (wanted @ counts)
    # A filter this smooth cannot fit all bands of a narrow spectrum: those with power come first.
    important = 1 + wanted / wanted.max()
    wanted = np.maximum(wanted, _LEAST_POWER * wanted.max())
    ridge = _RIDGE * np.eye(len(spread))
    gain, weights = np.ones(BANDS), np.zeros(len(spread))
    for _ in range(_ROUNDS):
        # Errors count relative to the gain; the ridge keeps the filter close to 1.
        system = np.vstack([(important / gain)[:, None] * response, ridge])
        weights = np.linalg.lstsq(system, np.concatenate([important, ridge[0]]), rcond=None)[0]
        filtered = np.square(np.tensordot(weights, responses, axes=1)) * has
        # The power is not even inside a band: correct what one round leaves.
        gain *= np.sqrt(wanted / np.maximum(_banded(filtered), 1e-30))
        gain = np.clip(gain, _LEAST_GAIN, _MOST_GAIN)
    weights = weights * np.sqrt(total / (_banded(filtered) @ counts))
    return weights.astype(np.float32)


def _filter(sheet: Float, weights: Float, *, wrapped: bool) -> None:
    """Replace n_x and n_y by a sum of smoothed copies, in bands of rows, and normalise."""
    border = cv2.BORDER_WRAP if wrapped else cv2.BORDER_REFLECT_101
    # Copies of rows that are replaced before they are read.
    upper, lower = sheet[: _REACH + 1, :, :2].copy(), sheet[-_REACH - 1 :, :, :2].copy()
    above = lower[1:] if wrapped else upper[:0:-1]
    beyond = upper[:-1] if wrapped else lower[-2::-1]
    for first in range(0, len(sheet), _ROWS):
        part = sheet[first : first + _ROWS]
        below = sheet[first + len(part) :][:_REACH, :, :2]
        below = np.concatenate([below, beyond])[:_REACH]
        band = np.concatenate([above, part[..., :2], below])
        above = band[-2 * _REACH : -_REACH]
        band = cv2.copyMakeBorder(band, 0, 0, _REACH, _REACH, border)
        total = weights[0] * band
        for sigma, weight in zip(_SIGMAS, weights[1:], strict=True):
            side = 2 * min(int(np.ceil(3 * sigma)), _REACH) + 1
            total += weight * cv2.GaussianBlur(band, (side, side), sigma)
        part[..., :2] = total[_REACH:-_REACH, _REACH:-_REACH]
        part /= np.sqrt(np.square(part).sum(axis=2, keepdims=True))
