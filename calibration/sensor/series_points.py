"""Mean and temporal variance of each zone at each exposure of a series."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from acquisition.source import RowReader, row_bands
from calibration._errors import DataError, EstimateError
from calibration.sensor.dark_frames import DarkFrames
from calibration.sensor.recorded_series import Repeats, Series
from rig.arrays import Bool, Float32, Float64, Int16

# Side of the box whose mean is the light at its middle, in pixels of one colour.
BOX = 11
# Levels relative to the brightest exposure: of the image that shows the zones, and of those from
# which the pattern of the pixels is taken.
_ZONES_AT = 0.5
_PATTERN_FROM, _PATTERN_TO = 0.2, 0.75
# Rows of a band of the pattern, and those around it that its box and median need in a mosaic; even,
# so that a band begins with the same colours.
_PATTERN_ROWS, _MARGIN = 512, 2 * (BOX // 2 + 3)
# A lamp that varies more cannot be corrected reliably.
_MOST_FLICKER = 0.1
# Noise of raw frames is independent; a blur of 0.5 px makes the correlation of neighbours 0.3.
_ALIKE = 0.1
_MOST_ZONES = 12
_FEWEST_PIXELS = 400
_NO_ZONE = -1
# Rows with about this number of pixels show the distribution of the light.
_SAMPLE = 2_000_000


@dataclass(frozen=True, eq=False)
class SeriesPoints:
    """What T exposures of a series show in Z zones.

    Parameters
    ----------
    time_s
        ``(T,)`` exposure times.
    signal
        ``(T, Z)`` mean above the dark frame, DN.
    variance
        ``(T, Z)`` temporal variance of a single frame, DN^2.
    white
        ``(T, Z)`` share of samples at the end of the converter.
    freedom
        ``(T, Z)`` degrees of freedom of the variance.
    flicker
        ``(T,)`` relative standard deviation of the frames' means.
    flicker_noise
        ``(T,)`` the part of it that the noise of the pixels explains.
    prnu_squared, prnu_weight
        Variance of the pixels' response, and the reciprocal of its variance; 0 without an exposure
        of suitable level.
    """

    time_s: Float64
    signal: Float64
    variance: Float64
    white: Float64
    freedom: Float64
    flicker: Float64
    flicker_noise: Float64
    prnu_squared: float
    prnu_weight: float


def series_points(series: Series, dark: DarkFrames, cfa: str | None, end_dn: int) -> SeriesPoints:
    """Read a series.

    Raises
    ------
    DataError
        If a frame is damaged, or the frames are not brighter than the dark frames.
    EstimateError
        If every exposure is saturated, the light varies too much, or frames were smoothed.
    """
    levels, tops = zip(*(_level(one, dark) for one in series.exposures), strict=True)
    top = max(tops)
    if not max(levels) > 0:
        raise DataError(
            f"{series.name}: the dark frames are brighter than those with light: are they swapped, "
            "or was the lens not covered?"
        )
    usable = [i for i, high in enumerate(tops) if high < 0.9 * top]
    if not usable:
        raise EstimateError(
            f"{series.name}: every exposure is as bright as the brightest one: record shorter "
            "exposure times"
        )
    shown = min(usable, key=lambda i: abs(levels[i] - _ZONES_AT * top))
    alike = _correlation(series.exposures[shown])
    if alike > _ALIKE:
        raise EstimateError(
            f"{series.name}: the noise of neighbouring pixels is alike (correlation {alike:.2f}): "
            "the frames were smoothed or scaled: record raw frames"
        )
    labels, count = zone_labels(_field(series.exposures[shown], dark), dark.good, cfa)
    shape = (len(series.exposures), count)
    signal, variance, white, freedom = (np.zeros(shape) for _ in range(4))
    flicker, flicker_noise = np.zeros(shape[0]), np.zeros(shape[0])
    pattern = _Pattern(dark, labels, count, cfa)
    for t, exposure in enumerate(series.exposures):
        shows_pixels = levels[t] > _PATTERN_FROM * top and tops[t] < _PATTERN_TO * top
        total = pattern.signal if shows_pixels else None
        seen = _Seen(exposure, dark, labels, count, end_dn, total)
        signal[t], variance[t], white[t] = seen.signal, seen.variance, seen.white
        freedom[t] = seen.pixels * (len(exposure.frames) - 1)
        flicker[t], flicker_noise[t] = seen.flicker, seen.flicker_noise
        if shows_pixels:
            pattern.add_noise(seen, exposure)
    worst = int(np.argmax(flicker - 5 * flicker_noise))
    if flicker[worst] > _MOST_FLICKER + 5 * flicker_noise[worst]:
        raise EstimateError(
            f"{series.name}: the frames at {series.exposures[worst].time_s * 1e6:g} us vary by "
            f"{flicker[worst]:.0%} in brightness: use a lamp that does not flicker"
        )
    times = np.array([one.time_s for one in series.exposures])
    return SeriesPoints(
        times, signal, variance, white, freedom, flicker, flicker_noise, *pattern.result()
    )


def _correlation(exposure: Repeats) -> float:
    """Return the correlation of the noise of pixels next to each other, 0 of raw frames."""
    first, second = (frame.read().astype(np.float32) for frame in exposure.frames[:2])
    noise = first - second
    noise -= smooth(noise)
    return float(np.mean(noise[:, 1:] * noise[:, :-1]) / max(float(np.mean(noise**2)), 1e-12))


def _level(exposure: Repeats, dark: DarkFrames) -> tuple[float, float]:
    """Return the median and the 99th percentile of the first frame, above dark."""
    pixels = exposure.frames[0].read()
    step = max(1, len(pixels) // 256)
    above = pixels[::step] - dark.image(exposure.time_s, slice(None, None, step))
    middle, high = np.percentile(above, [50, 99])
    return float(middle), float(high)


def _field(exposure: Repeats, dark: DarkFrames) -> Float32:
    """Return the mean of the repeats above dark."""
    total = np.zeros(exposure.frames[0].shape, np.float32)
    for frame in exposure.frames:
        total += frame.read()
    for rows in row_bands(len(total)):
        total[rows] /= np.float32(len(exposure.frames))
        total[rows] -= dark.image(exposure.time_s, rows)
    return total


class _Seen:
    """Figures of the repeats of one exposure."""

    def __init__(
        self,
        exposure: Repeats,
        dark: DarkFrames,
        labels: Int16,
        count: int,
        end_dn: int,
        total: Float32 | None,
    ) -> None:
        """Read the frames; their mean is added to ``total``."""
        frames = exposure.frames
        sums, pixels = np.zeros((3, count)), np.zeros(count)
        with RowReader() as reader:
            means, unlit = _means(exposure, dark, labels, reader)
            above = means - unlit
            # A lamp that flickers makes a frame brighter as a whole: all get the same mean.
            shares = np.ones(len(frames), np.float32)
            if above.min() > 0:
                shares = (above.mean() / above).astype(np.float32)
            for rows in row_bands(len(labels)):
                used = labels[rows] >= 0
                where = labels[rows][used]
                raw = [reader.rows(one, rows.start, rows.stop) for one in frames]
                part: Float32 = np.stack(raw).astype(np.float32)
                clipped = (part >= end_dn).mean(axis=0)
                part -= dark.image(exposure.time_s, rows)
                part *= shares[:, None, None]
                mean = part.mean(axis=0)
                if total is not None:
                    total[rows] += mean
                spread = ((part - mean) ** 2).sum(axis=0) / (len(frames) - 1)
                for k, values in enumerate((mean, spread, clipped)):
                    sums[k] += np.bincount(where, weights=values[used], minlength=count)
                pixels += np.bincount(where, minlength=count)
        self.pixels = pixels
        self.signal, self.variance, self.white = sums / np.maximum(self.pixels, 1)
        level = max(above.mean(), 1e-9)
        self.flicker = float(above.std(ddof=1) / level)
        self.flicker_noise = float((self.variance.mean() / pixels.sum()) ** 0.5 / level)


def _means(
    exposure: Repeats, dark: DarkFrames, labels: Int16, reader: RowReader
) -> tuple[Float64, float]:
    """Return the mean of each repeat and of the dark frame in all zones."""
    sums, unlit, pixels = np.zeros(len(exposure.frames)), 0.0, 0
    for rows in row_bands(len(labels)):
        used = labels[rows] >= 0
        for k, frame in enumerate(exposure.frames):
            sums[k] += reader.rows(frame, rows.start, rows.stop)[used].sum(dtype=np.float64)
        unlit += float(dark.image(exposure.time_s, rows)[used].sum(dtype=np.float64))
        pixels += int(used.sum())
    return sums / pixels, unlit / pixels


class _Pattern:
    """Sum of exposures, which shows the response of the pixels."""

    def __init__(self, dark: DarkFrames, labels: Int16, count: int, cfa: str | None) -> None:
        self._dark, self._labels, self._count, self._cfa = dark, labels, count, cfa
        self.signal = np.zeros(labels.shape, np.float32)
        self._noise = np.zeros(count)
        self._times: list[float] = []

    def add_noise(self, seen: _Seen, exposure: Repeats) -> None:
        self._noise += seen.variance / len(exposure.frames)
        self._times.append(exposure.time_s)

    def result(self) -> tuple[float, float]:
        """Return the variance of the response, and the reciprocal of its variance."""
        if not self._times:
            return 0.0, 0.0
        pixels, light, squares = np.zeros((3, self._count))
        for rows, pattern in self._patterns():
            used = self._labels[rows] >= 0
            where = self._labels[rows][used]
            squared = pattern[used].astype(np.float64) ** 2
            pixels += np.bincount(where, minlength=self._count)
            light += np.bincount(where, self.signal[rows][used], self._count)
            squares += np.bincount(where, squared, self._count)
        signal = light / pixels
        # The box leaves this share of the variance of single pixels.
        total = squares / (pixels * (1 - 1 / BOX**2))
        # All exposures have the same errors of the dark frame in common.
        middle = float(np.mean(self._times))
        common = len(self._times) ** 2 * self._dark.leverage(middle) * self._dark.variance(0.0)
        squared = total - (self._noise + common) / signal**2
        weight = pixels / (2 * total**2)
        return float(weight @ squared / weight.sum()), float(weight.sum())

    def _patterns(self) -> Iterator[tuple[slice, Float32]]:
        """Yield bands of rows and their pattern, which needs the rows around them."""
        height = len(self.signal)
        for first in range(0, height, _PATTERN_ROWS):
            last = min(first + _PATTERN_ROWS, height)
            window = slice(max(first - _MARGIN, 0), min(last + _MARGIN, height))
            pattern = relative_pattern(self.signal[window], self._dark.good[window], self._cfa)
            yield slice(first, last), pattern[first - window.start : last - window.start]


def site_slices(cfa: str | None) -> list[tuple[slice, slice]]:
    """Return the pixels of each colour filter of a mosaic; all pixels without a mosaic."""
    if cfa is None:
        return [(slice(None), slice(None))]
    return [(slice(row, None, 2), slice(column, None, 2)) for row in (0, 1) for column in (0, 1)]


def zone_labels(signal: Float32, good: Bool, cfa: str | None) -> tuple[Int16, int]:
    """Divide the pixels into zones by the light that they get.

    Parameters
    ----------
    signal
        ``(H, W)`` image of the field, above dark.
    good
        ``(H, W)`` pixels to use.
    cfa
        Colour filter; pixels of different filters are in different zones.

    Returns
    -------
    labels
        ``(H, W)`` zone of each pixel; -1 for pixels that are not used: not good, or near the edge.
    count
        Number of zones.
    """
    labels = np.full(signal.shape, _NO_ZONE, np.int16)
    count = 0
    for site in site_slices(cfa):
        light = smooth(signal[site])
        inner = np.zeros(light.shape, np.bool_)
        margin = BOX // 2
        inner[margin:-margin, margin:-margin] = True
        inner &= good[site]
        pixels = int(inner.sum())
        zones = max(1, min(_MOST_ZONES, pixels // _FEWEST_PIXELS))
        step = max(1, pixels // _SAMPLE)
        edges = np.quantile(light[::step][inner[::step]], np.arange(1, zones) / zones)
        of_site = labels[site]
        for rows in row_bands(len(light)):
            found = count + np.searchsorted(edges, light[rows])
            of_site[rows] = np.where(inner[rows], found, _NO_ZONE)
        count += zones
    return labels, count


def smooth(image: Float32) -> Float32:
    """Return the mean of a box around each pixel."""
    compact = np.ascontiguousarray(image)
    smoothed = cv2.blur(compact, (BOX, BOX), borderType=cv2.BORDER_REFLECT)
    return np.asarray(smoothed, np.float32)


def relative_pattern(signal: Float32, good: Bool, cfa: str | None) -> Float32:
    """Return the relative deviation of each pixel from the mean of the box around it.

    The box removes the field of the light. White noise of variance s^2 in the pixels has the
    variance (1 - 1 / box^2) s^2 in the result. Pixels that are not good count as the median of
    their neighbours.
    """
    pattern = np.zeros_like(signal)
    for site in site_slices(cfa):
        raw = np.ascontiguousarray(signal[site])
        values: Float32 = np.where(good[site], raw, cv2.medianBlur(raw, 5)).astype(np.float32)
        light = smooth(values)
        pattern[site] = values / np.maximum(light, np.float32(1e-6)) - 1
    return pattern
