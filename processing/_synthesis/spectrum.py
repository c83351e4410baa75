"""Power of a detail component in radial bands of frequency."""

from __future__ import annotations

from functools import cache

import numpy as np
import numpy.typing as npt
from scipy.fft import rfft2

from processing._normal_map import NormalMap

Float = npt.NDArray[np.float32]
Double = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

BANDS = 16
MOST_BLOCK = 64
_BLOCKS = (MOST_BLOCK, 32)
# Of a relief of 1024 x 1024 pixels, 400 blocks left an error of 4 %.
_MOST_BLOCKS = 1600


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
    """Return the mean power ``(bands,)`` of n_x and n_y in 16 radial bands of frequency.

    Parameters
    ----------
    part, block
        As for `band_powers`.
    """
    power: Double = band_powers(part, block, BANDS).mean(axis=0)
    return power


def band_powers(part: NormalMap, block: int, bands: int) -> Double:
    """Return the power of n_x and n_y in radial bands of frequency, for blocks all over a map.

    Parameters
    ----------
    part
        Detail component.
    block
        Side of the windowed blocks, of which some fit into the mask.
    bands
        Number of bands.

    Returns
    -------
    Double
        ``(blocks, bands)``; the bands have equal widths up to 0.5 cycles per pixel. The mean of a
        block is in no band.
    """
    places = _blocks(part.mask, block)
    places = places[:: -(-len(places) // _MOST_BLOCKS)]
    slopes = part.normals[..., :2]
    return np.stack([
        banded(windowed_power(slopes[y : y + block, x : x + block].transpose(2, 0, 1)), bands)
        for y, x in places
    ])  # fmt: skip


def windowed_power(slopes: Float) -> Float:
    """Return the power ``(block, block / 2 + 1)`` of blocks ``(..., 2, block, block)``, summed."""
    tapered = (slopes - slopes.mean(axis=(-2, -1), keepdims=True)) * _taper(slopes.shape[-1])
    waves = rfft2(tapered).reshape(-1, *slopes.shape[-2:-1], slopes.shape[-1] // 2 + 1)
    power: Float = (np.square(waves.real) + np.square(waves.imag)).sum(axis=0)
    return power


@cache
def _taper(block: int) -> Float:
    window = np.hanning(block + 2)[1:-1].astype(np.float32)
    return np.asarray(window[:, None] * window)


def frequencies(side: int) -> Double:
    """Return the frequencies ``(side, side / 2 + 1)`` of a transform in cycles per pixel."""
    found: Double = np.hypot(np.fft.fftfreq(side)[:, None], np.fft.rfftfreq(side))
    return found


def _numbers(block: int, bands: int) -> npt.NDArray[np.int64]:
    return np.ceil(frequencies(block) * 2 * bands).astype(np.int64).ravel()


def band_counts(block: int, bands: int) -> npt.NDArray[np.int64]:
    """Return the number of values of a power in each band."""
    return np.bincount(_numbers(block, bands))[1 : bands + 1]


def banded(power: npt.NDArray[np.floating], bands: int) -> Double:
    """Return the mean of a power in each band."""
    sums = np.bincount(_numbers(len(power), bands), power.ravel())[1 : bands + 1]
    means: Double = sums / band_counts(len(power), bands)
    return means
