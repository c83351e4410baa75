"""Errors of normals by the blur of the lens.

A lens averages the light of neighbouring pixels, and thus their normals. Residuals do not show it,
because the average of matte pixels is matte. What the images show is how their detail ends: the
width of the blur is found from the spectrum of the normals, and what the same blur would remove
from them once more says how much it has removed before.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import cv2
import numpy as np

from acquisition import MapRows
from acquisition.files import rows_in_bands
from processing.noise.around import mean_around
from rig import short_repr
from rig.arrays import Bool, Float32, Float64, Intp

# Blur of a lens in focus, pixels, and the spread of its logarithm among lenses.
_USUAL_PX, _SPREAD = 0.7, 0.25
# Spectra along a line fall with this power of the frequency, as those of edges do, and its spread.
_POWER, _POWER_SPREAD = 2.0, 1.0
# Scatter of the logarithms of spectra around such a law.
_SCATTER = 0.5
_WIDTHS_PX = np.exp(np.linspace(math.log(0.25), math.log(2.5), 47))
# Pixels of a window, the first frequency, and fewest frequencies and windows that show a width.
_WINDOW, _FIRST, _FEWEST, _FEWEST_WINDOWS = 32, 3, 7, 50
_MOST_WINDOWS = 10_000
# Frequencies count up to where the signal falls below these shares of the noise and of the first
# one: normals have unit length, and what keeps it so is no detail.
_SIGNAL, _DETAIL = 0.5, 1e-5
# A second blur removes detail, and a third one the share q of it. What the first one has removed is
# that detail times (1 - q)^-(1 + q): exact for one low frequency, and about right for spectra that
# fall as a power of the frequency.
_LARGEST_SHARE = 0.65
_REACH = 3.0
# Pixels across over which removed detail is averaged.
_ACROSS = 3
# Bytes of rows that are computed at once, and of a pixel while it is computed.
_BAND, _PIXEL_BYTES = 32_000_000, 128
# Pixels of the normals that show the blur, in groups of rows.
_SAMPLE, _GROUP = 1_000_000, 96


@dataclass(frozen=True)
class LensBlur:
    """Blur of a lens, and how much of the normals it removes.

    Parameters
    ----------
    sigma_px
        Standard deviation of the Gaussian that blurs the images, in pixels.
    lost
        What the blur has removed from the normals, relative to what it would remove again, 1 or
        more.
    shown
        Whether the normals show the width; otherwise it is that of a usual lens in focus.
    """

    sigma_px: float
    lost: float
    shown: bool

    __repr__ = short_repr

    @cached_property
    def _kernel(self) -> Float64:
        return _gaussian(self.sigma_px)

    @cached_property
    def _noise_gain(self) -> float:
        return _noise_gains(self._kernel)[0]

    def variance(self, normals: MapRows, noise: MapRows, valid: Bool, rows: slice) -> Float32:
        """Return the variance of the normals of some rows by the blur, in rad^2.

        It does not depend on the rows that are asked for together.

        Parameters
        ----------
        normals
            ``(H, W, 3)`` unit normals.
        noise
            ``(H, W)`` their variance by noise in rad^2, both tangent directions together.
        valid
            ``(H, W)`` bool, the pixels with a normal.
        rows
            Rows to compute, with start and stop.
        """
        found = np.zeros((rows.stop - rows.start, valid.shape[1]), np.float32)
        for band in rows_in_bands(len(found), _PIXEL_BYTES * valid.shape[1], _BAND):
            some = slice(rows.start + band.start, rows.start + band.stop)
            found[band] = self._of_rows(normals, noise, valid, some)
        return found

    def _of_rows(self, normals: MapRows, noise: MapRows, valid: Bool, rows: slice) -> Float32:
        around = len(self._kernel) // 2 + _ACROSS // 2
        part = slice(max(rows.start - around, 0), min(rows.stop + around, len(valid)))
        inner = slice(rows.start - part.start, rows.stop - part.start)
        inside = valid[part]
        unit = np.where(inside[..., None], normals[part], 0)
        removed = _tangent(unit - _blurred(unit, inside, self._kernel), unit)
        square = np.sum(np.square(removed), axis=2) - self._noise_gain * noise[part]
        square = np.where(inside, square, 0).astype(np.float32)
        mean = np.maximum(mean_around(square, inside, _ACROSS), 0)
        return np.asarray(self.lost**2 * mean[inner], np.float32)


def lens_blur(normals: MapRows, noise: MapRows, valid: Bool) -> LensBlur:
    """Return the blur that a map of normals shows.

    The spectrum of normals along rows and columns is fitted by a power of the frequency times that
    of a Gaussian, above the noise. Both have a prior: edges and lenses as they usually are. Where
    noise hides the detail, the width is 0.7 px.

    Parameters
    ----------
    normals, noise, valid
        As for `LensBlur.variance`. Of large maps, some rows are read.

    Examples
    --------
    >>> import cv2
    >>> import numpy as np
    >>> from processing.noise import lens_blur
    >>> plates = np.random.default_rng(1).normal(size=(20, 20, 3)) + [0, 0, 9]
    >>> edges = cv2.resize(plates, (200, 200), interpolation=cv2.INTER_NEAREST)
    >>> for width in (0.7, 1.4):
    ...     blurred = cv2.GaussianBlur(edges, (0, 0), width)
    ...     unit = blurred / np.linalg.norm(blurred, axis=2, keepdims=True)
    ...     noise, valid = np.full((200, 200), 1e-6), np.ones((200, 200), bool)
    ...     print(f"{lens_blur(unit, noise, valid).sigma_px:.1f}")
    0.6
    1.2
    """
    groups = rows_that_show(valid)
    spectrum = _Spectrum(np.zeros(_WINDOW // 2 + 1), 0.0, 0)
    for rows in groups:
        spectrum = spectrum.plus(_spectrum(normals[rows], noise[rows], valid[rows]))
    width, shown = _width(spectrum)
    kernel = _gaussian(width)
    gains = _noise_gains(kernel)
    removed = np.zeros(2)
    around = len(kernel) - 1
    for rows in groups:
        inside = valid[rows]
        unit = np.where(inside[..., None], normals[rows], 0)
        first = unit - _blurred(unit, inside, kernel)
        second = first - _blurred(first, inside, kernel)
        counted = inside.copy()
        counted[: around if rows.start else 0] = False
        counted[len(counted) - (around if rows.stop < len(valid) else 0) :] = False
        own = noise[rows]
        for i, part in enumerate((first, second)):
            squares = np.sum(np.square(_tangent(part, unit)), axis=2) - gains[i] * own
            removed[i] += float(squares[counted].sum(dtype=np.float64))
    share = math.sqrt(max(removed[1], 0) / removed[0]) if removed[0] > 0 else 0.0
    share = min(share, _LARGEST_SHARE)
    return LensBlur(width, (1 - share) ** -(1 + share), shown)


class _Spectrum(NamedTuple):
    """Sums over windows: power by frequency ``(17,)``, variance by noise, and their number."""

    power: Float64
    noise: float
    windows: int

    def plus(self, other: _Spectrum) -> _Spectrum:
        return _Spectrum(
            self.power + other.power, self.noise + other.noise, self.windows + other.windows
        )


def rows_that_show(valid: Bool) -> list[slice]:
    """Return rows that stand for those of an object: all of a small one, else groups of them."""
    inside = np.flatnonzero(valid.any(axis=1))
    first, last = int(inside[0]), int(inside[-1]) + 1
    count = max(1, _SAMPLE // (_GROUP * valid.shape[1]))
    if last - first <= count * _GROUP:
        return [slice(first, last)]
    starts = np.linspace(first, last - _GROUP, count).astype(int)
    return [slice(int(start), int(start) + _GROUP) for start in starts]


def _spectrum(normals: Float32, noise: Float32, valid: Bool) -> _Spectrum:
    """Return the spectrum of normals in windows along rows and columns."""
    both = (normals, noise, valid), (normals.swapaxes(0, 1), noise.T, valid.T)
    one, other = (_along_rows(*maps) for maps in both)
    return one.plus(other)


def _along_rows(normals: Float32, noise: Float32, valid: Bool) -> _Spectrum:
    # Low frequencies leak little into high ones.
    weight = np.hanning(_WINDOW + 2)[1:-1] ** 2
    rows, columns = _windows(np.ascontiguousarray(valid))
    at = columns[:, None] + np.arange(_WINDOW)
    values = np.asarray(normals[rows[:, None], at], np.float64)
    values -= values.mean(axis=1, keepdims=True)
    along = np.arange(_WINDOW) - (_WINDOW - 1) / 2
    slopes = np.einsum("pic,i->pc", values, along / (along @ along))
    values -= slopes[:, None] * along[:, None]
    power = np.square(np.abs(np.fft.rfft(values * weight[:, None], axis=1))).sum(axis=(0, 2))
    variance = np.asarray(noise[rows[:, None], at], np.float64).mean(axis=1).sum()
    return _Spectrum(power / (weight @ weight), float(variance), len(rows))


def _windows(valid: Bool) -> tuple[Intp, Intp]:
    """Return rows and first columns of windows inside of a mask, without its border."""
    inner = cv2.erode(valid.astype(np.uint8), np.ones((3, 3), np.uint8), borderValue=0)
    sums = np.cumsum(np.pad(inner, ((0, 0), (1, 0))), axis=1, dtype=np.int32)
    full = sums[:, _WINDOW:] - sums[:, :-_WINDOW] == _WINDOW
    full[:, np.arange(full.shape[1]) % (_WINDOW // 4) != 0] = False
    rows, columns = np.nonzero(full)
    every = 1 + len(rows) // _MOST_WINDOWS
    return rows[::every], columns[::every]


def _width(spectrum: _Spectrum) -> tuple[float, bool]:
    """Return the most probable width of the blur, and whether the spectrum shows it."""
    if spectrum.windows < _FEWEST_WINDOWS:
        return _USUAL_PX, False
    noise = spectrum.noise / spectrum.windows
    signal = spectrum.power / spectrum.windows - noise
    least = max(_SIGNAL * noise, _DETAIL * signal[_FIRST])
    hidden = np.flatnonzero(signal[_FIRST:-1] <= least)
    last = _FIRST + (int(hidden[0]) if len(hidden) else len(signal) - 1 - _FIRST)
    if last - _FIRST < _FEWEST:
        return _USUAL_PX, False
    frequency = 2 * np.pi * np.arange(_FIRST, last) / _WINDOW
    logarithm = np.log(signal[_FIRST:last])
    law = np.column_stack([np.ones(len(frequency)), -np.log(frequency)]) / _SCATTER
    law = np.vstack([law, [0, 1 / _POWER_SPREAD]])
    costs = []
    for width in _WIDTHS_PX:
        sharp = np.append((logarithm + (width * frequency) ** 2) / _SCATTER, _POWER / _POWER_SPREAD)
        left = sharp - law @ np.linalg.lstsq(law, sharp, rcond=None)[0]
        costs.append(left @ left + (math.log(width / _USUAL_PX) / _SPREAD) ** 2)
    return float(_WIDTHS_PX[int(np.argmin(costs))]), True


def _gaussian(sigma_px: float) -> Float64:
    along = np.arange(-math.ceil(_REACH * sigma_px), math.ceil(_REACH * sigma_px) + 1)
    kernel = np.exp(-0.5 * np.square(along / sigma_px))
    return np.asarray(kernel / kernel.sum())


def _noise_gains(kernel: Float64) -> tuple[float, float]:
    """Return the variance that independent noise has in detail that is removed once and twice."""
    image = np.zeros((4 * len(kernel) + 1,) * 2)
    image[len(image) // 2, len(image) // 2] = 1
    once = image - cv2.sepFilter2D(image, -1, kernel, kernel)
    twice = once - cv2.sepFilter2D(once, -1, kernel, kernel)
    return float(np.square(once).sum()), float(np.square(twice).sum())


def _blurred(values: Float32, inside: Bool, kernel: Float64) -> Float32:
    """Return a map that is 0 outside of a mask, averaged over the pixels inside."""
    border = cv2.BORDER_CONSTANT
    sums = cv2.sepFilter2D(values, -1, kernel, kernel, borderType=border)
    weights = cv2.sepFilter2D(inside.astype(np.float32), -1, kernel, kernel, borderType=border)
    mean = sums / np.maximum(weights, np.float32(1e-6))[..., None]
    return np.asarray(np.where(inside[..., None], mean, 0))


def _tangent(change: Float32, unit: Float32) -> Float32:
    """Return the part of changes across the unit vectors."""
    return np.asarray(change - np.sum(change * unit, axis=2, keepdims=True) * unit)
