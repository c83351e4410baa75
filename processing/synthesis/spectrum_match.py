"""Filter that gives a synthesised detail component the spectrum of its exemplar."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache

import cv2
import numpy as np
from scipy.fft import fftshift, irfft2, rfft2

from acquisition import MapRows
from processing.maps.normal_map import NormalMap
from processing.synthesis.exemplar import mean_angle, places_of
from rig.arrays import Bool, Complex64, Float32, Float64, Floating, Int64

BANDS = 16
MOST_BLOCK = 64
_BLOCKS = (MOST_BLOCK, 32)
# Of a relief of 1024 x 1024 pixels, 400 blocks left an error of 4 %.
_MOST_BLOCKS = 1600
# A filter is a kernel of 2 x reach + 1 pixels.
_REACH = 32
# Smaller sheets are hardly larger than the filter.
_LEAST_SIDE = 3 * _REACH
# Rows and columns of windows in which the power of a sheet is measured; of every twentieth, also
# the power of the filtered window.
_GRID, _FILTERED = 40, 20
_ROUNDS, _LEAST_POWER = 16, 1e-30
# Smooth materials have 1e-8 of their power at high frequencies, where cuts have much more.
_LEAST_GAIN, _MOST_GAIN = 0.003, 1.5
# The mean angle of a sheet is measured on every eighth row.
_SAMPLED, _ANGLE_ERROR, _MOST_STEEPER = 8, 0.04, 1.25
# Rows of a sheet that are corrected at once.
CORRECTED_ROWS = 512
# Rows and columns of a filter.
KERNEL = (2 * _REACH + 1, 2 * _REACH + 1)


def matching_kernel(sheet: MapRows, exemplar: NormalMap) -> Float32 | None:
    """Return the filter that gives a sheet the power of an exemplar in each band.

    The cuts between patches add power at low frequencies, because patches no longer end where
    their slopes add up to 0, and at the highest. The filter is isotropic and has one gain for each
    band, 0.003 to 1.5. A difference is corrected less, the more it may be chance: a small sheet
    contains few parts of the exemplar, whose power differs from part to part. One factor on all
    slopes, at most 1.25, gives the sheet the power of the exemplar, as far as its mean angle
    differs from that of the exemplar by at most 4 %.

    Parameters
    ----------
    sheet
        ``(H, W, 3)`` unit vectors.
    exemplar
        Detail component with the intended power.

    Returns
    -------
    Float or None
        ``KERNEL`` pixels; None if sheet or exemplar are too small to measure their power.
    """
    block, (height, width) = block_side(exemplar.mask), sheet.shape[:2]
    if not block or min(height, width) < _LEAST_SIDE:
        return None
    # Bands as narrow as the frequencies of a block.
    powers = np.maximum(band_powers(exemplar, block, block // 2), _LEAST_POWER)
    wanted, spread = powers.mean(axis=0), powers.std(axis=0) / powers.mean(axis=0)
    has, waves, upright = _measured(sheet, block)
    sampled = [mean_angle(sheet[row : row + 1]) for row in range(0, sheet.shape[0], _SAMPLED)]
    steeper = mean_angle(exemplar.normals[exemplar.mask]) / float(np.mean(sampled))
    stronger = np.sqrt(_total(wanted, block) / _total(has, block))
    # The angle is that of the complete mask, the power only that of blocks inside.
    factor = np.clip(stronger, (1 - _ANGLE_ERROR) * steeper, (1 + _ANGLE_ERROR) * steeper)
    factor = np.clip(factor, 1 / _MOST_STEEPER, _MOST_STEEPER)
    differs = np.log(wanted / stronger**2 / has)
    chance = np.square(spread) * block**2 / (height * width)
    differs *= np.square(differs) / (np.square(differs) + chance + 1e-12)
    gains = _gains(has, waves, upright, has * np.exp(differs))
    kernel = fftshift(_kernel(factor * gains, block + 2 * _REACH))
    middle = slice(block // 2, block // 2 + 2 * _REACH + 1)
    return np.ascontiguousarray(kernel[middle, middle])


def _total(powers: Float64, block: int) -> float:
    """Return the power of all bands."""
    return float(powers @ _band_counts(block, len(powers)))


def _measured(sheet: MapRows, block: int) -> tuple[Float64, Complex64, Float32]:
    """Return the power of a sheet in each band, and some of its windows.

    These are larger than a block by the reach on each side, where a sheet ends by its reflection.
    Returned are the transforms of n_x and n_y, ``(n, 2, h, w / 2 + 1)``, and n_z in the blocks,
    ``(n, block, block)``.
    """
    height, side = sheet.shape[0], block + 2 * _REACH
    tops, lefts = (
        np.linspace(0, length - block, min(_GRID, 1 + 2 * (length - block) // block)).astype(int)
        for length in sheet.shape[:2]
    )
    count = len(tops) * len(lefts)
    inner = (slice(None), *[slice(_REACH, -_REACH)] * 2)
    # Not every twentieth, which could be in few columns.
    chosen = set(np.linspace(0, count - 1, -(-count // _FILTERED)).astype(np.int64).tolist())
    power, waves, upright = np.zeros((block, block // 2 + 1)), [], []
    for i, top in enumerate(tops):
        first, last = max(top - _REACH, 0), min(top + block + _REACH, height)
        beyond = first - (top - _REACH), top + block + _REACH - last
        margins = *beyond, _REACH, _REACH
        rows = np.asarray(
            cv2.copyMakeBorder(sheet[first:last], *margins, cv2.BORDER_REFLECT_101), np.float32
        )
        for j, left in enumerate(lefts):
            window = np.ascontiguousarray(rows[:, left : left + side].transpose(2, 0, 1))
            power += _windowed_power(window[:2][inner])
            if i * len(lefts) + j in chosen:
                waves.append(rfft2(window[:2]))
                upright.append(window[2][inner[1:]])
    has = np.maximum(_banded(power / count, block // 2), _LEAST_POWER)
    return has, np.stack(waves), np.stack(upright)


def _gains(has: Float64, waves: Complex64, upright: Float32, wanted: Float64) -> Float64:
    """Return the gain of each band that gives a sheet an intended power in each band.

    The total power stays as it is. The filtered power is measured: the squared gain would not do,
    because the window of a block spreads power over neighbouring bands, and unit length over all.
    It is measured in few windows.
    """
    block = upright.shape[1]
    side = block + 2 * _REACH

    def filtered(gains: Float64) -> Float64:
        """Return the power of the filtered windows in each band."""
        response = rfft2(_kernel(gains, side)).real
        slopes = irfft2(waves * response, s=(side, side))
        slopes = slopes[..., _REACH:-_REACH, _REACH:-_REACH]
        slopes /= np.sqrt(np.square(slopes).sum(axis=1) + np.square(upright))[:, None]
        return _banded(_windowed_power(slopes), block // 2)

    gains = np.ones(block // 2)
    alone = filtered(gains)
    scale = _total(has, block) / _total(alone, block)
    # What all windows have more than the few: the gains apply to it without spreading.
    rest = has - scale * alone

    def expected(gains: Float64) -> Float64:
        return np.maximum(scale * filtered(gains) + np.square(gains) * rest, _LEAST_POWER)

    for _ in range(_ROUNDS):
        gains *= np.exp(_smoothed(np.log(wanted / expected(gains))) / 2)
        gains = np.clip(gains, _LEAST_GAIN, _MOST_GAIN)
    return np.asarray(gains * np.sqrt(_total(has, block) / _total(expected(gains), block)))


def _smoothed(values: Float64) -> Float64:
    """Return means over neighbouring bands.

    The window of a block spreads power over them, so gains that alternate from band to band hardly
    change the power; their filter is long, and its waves are seen in flat parts.
    """
    return np.convolve(np.pad(values, 1, "edge"), (0.25, 0.5, 0.25), "valid")


def _kernel(gains: Float64, side: int) -> Float32:
    """Return a kernel ``(side, side)`` with a gain for each band; its centre is at (0, 0)."""
    centres = (np.arange(len(gains)) + 0.5) / (2 * len(gains))
    response = np.interp(_frequencies(side), centres, gains)
    away = np.minimum(np.arange(side), side - np.arange(side))
    radius = np.hypot(away[:, None], away)
    # Constant up to half the reach: a window that tapers from the centre blurs the lowest bands.
    outer = np.clip(2 * radius / (_REACH + 1) - 1, 0, 1)
    window = np.where(radius <= _REACH, 0.5 + 0.5 * np.cos(np.pi * outer), 0)
    return np.asarray(irfft2(response, s=(side, side)) * window, np.float32)


def filtered_bands(
    sheet: MapRows, kernel: Float32, *, wrapped: bool, begin: int = 0
) -> Iterator[tuple[slice, Float32]]:
    """Yield bands of rows with n_x and n_y filtered, and unit length, beginning with a band."""
    border = cv2.BORDER_WRAP if wrapped else cv2.BORDER_REFLECT_101
    for rows, band in bands_with_margins(sheet, _REACH, wrapped=wrapped, begin=begin):
        part = band[_REACH:-_REACH].copy()
        slopes = np.ascontiguousarray(band[..., :2])
        del band
        slopes = np.asarray(cv2.copyMakeBorder(slopes, 0, 0, _REACH, _REACH, border), np.float32)
        part[..., :2] = cv2.filter2D(slopes, -1, kernel)[_REACH:-_REACH, _REACH:-_REACH]
        del slopes
        part /= np.sqrt(np.square(part).sum(axis=2, keepdims=True))
        yield rows, part


def bands_with_margins(
    sheet: MapRows, reach: int, *, wrapped: bool, begin: int = 0
) -> Iterator[tuple[slice, Float32]]:
    """Yield bands of rows, with the rows above and below that a correction needs.

    The sheet may be replaced band by band with what is computed of them.

    Parameters
    ----------
    sheet
        The sheet to correct.
    reach
        Number of rows above and below.
    wrapped
        Whether the last row continues at the first; otherwise the sheet continues with its
        reflection.
    begin
        The first band; if it is not 0, the sheet is not replaced.
    """
    height = sheet.shape[0]
    # Copies of rows that are replaced before they are read.
    upper, lower = sheet[: reach + 1].copy(), sheet[max(height - reach - 1, 0) : height].copy()
    above = lower[1:] if wrapped else upper[:0:-1]
    beyond = upper[:-1] if wrapped else lower[-2::-1]
    if not len(above):  # a sheet of one row
        above = beyond = upper
    first = begin * CORRECTED_ROWS
    if begin:
        above = sheet[first - reach : first]
    for top in range(first, height, CORRECTED_ROWS):
        last = min(top + CORRECTED_ROWS, height)
        below = np.concatenate([sheet[last : min(last + reach, height)], beyond])[:reach]
        band = np.concatenate([above, sheet[top:last], below])
        above = band[len(band) - 2 * reach : len(band) - reach].copy()
        yield slice(top, last), band


def block_side(*masks: Bool) -> int:
    """Return the largest side of blocks of which some fit into each mask; 0 if none do."""
    return next((b for b in _BLOCKS if all(len(_blocks(mask, b)) for mask in masks)), 0)


def _blocks(mask: Bool, block: int) -> Int64:
    """Return the first pixels ``(n, 2)`` of the overlapping blocks that lie inside a mask."""
    step = block // 4
    return np.argwhere(places_of(mask, block)[::step, ::step]) * step


def band_powers(part: NormalMap, block: int, bands: int) -> Float64:
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
        _banded(_windowed_power(slopes[y : y + block, x : x + block].transpose(2, 0, 1)), bands)
        for y, x in places
    ])  # fmt: skip


def _windowed_power(slopes: Float32) -> Float32:
    """Return the power ``(block, block / 2 + 1)`` of blocks ``(..., 2, block, block)``, summed."""
    tapered = (slopes - slopes.mean(axis=(-2, -1), keepdims=True)) * _taper(slopes.shape[-1])
    waves = rfft2(tapered).reshape(-1, *slopes.shape[-2:-1], slopes.shape[-1] // 2 + 1)
    return np.asarray((np.square(waves.real) + np.square(waves.imag)).sum(axis=0))


@cache
def _taper(block: int) -> Float32:
    window = np.hanning(block + 2)[1:-1].astype(np.float32)
    return np.asarray(window[:, None] * window)


def _frequencies(side: int) -> Float64:
    """Return the frequencies ``(side, side / 2 + 1)`` of a transform in cycles per pixel."""
    return np.asarray(np.hypot(np.fft.fftfreq(side)[:, None], np.fft.rfftfreq(side)))


def _numbers(block: int, bands: int) -> Int64:
    return np.ceil(_frequencies(block) * 2 * bands).astype(np.int64).ravel()


def _band_counts(block: int, bands: int) -> Int64:
    """Return the number of values of a power in each band."""
    return np.bincount(_numbers(block, bands))[1 : bands + 1]


def _banded(power: Floating, bands: int) -> Float64:
    """Return the mean of a power in each band."""
    sums = np.bincount(_numbers(len(power), bands), power.ravel())[1 : bands + 1]
    return np.asarray(sums / _band_counts(len(power), bands))
