"""Mean and temporal variance of each zone at each exposure of a series."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from acquisition import row_bands
from calibration._errors import DataError, EstimateError
from calibration._sensor.dark_frames import DarkFrames
from calibration._sensor.recorded_series import Repeats, Series
from calibration._sensor.zones import BOX, Labels, relative_pattern, zone_labels

Array = npt.NDArray[np.float64]
Image = npt.NDArray[np.float32]

# Levels relative to the brightest exposure: of the image that shows the zones, and of those from
# which the pattern of the pixels is taken.
_ZONES_AT = 0.5
_PATTERN_FROM, _PATTERN_TO = 0.2, 0.75
# A lamp that varies more cannot be corrected reliably.
_MOST_FLICKER = 0.1


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

    time_s: Array
    signal: Array
    variance: Array
    white: Array
    freedom: Array
    flicker: Array
    flicker_noise: Array
    prnu_squared: float
    prnu_weight: float


def series_points(series: Series, dark: DarkFrames, cfa: str | None, end_dn: int) -> SeriesPoints:
    """Read a series.

    Raises
    ------
    DataError
        If a frame is damaged, or the frames are not brighter than the dark frames.
    EstimateError
        If every exposure is saturated, or the light varies too much.
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
    field = _mean(series.exposures[shown]) - dark.image(series.exposures[shown].time_s)
    labels, count = zone_labels(field, dark.good, cfa)
    shape = (len(series.exposures), count)
    signal, variance, white, freedom = (np.zeros(shape) for _ in range(4))
    flicker, flicker_noise = np.zeros(shape[0]), np.zeros(shape[0])
    pattern = _Pattern(dark, labels, count, cfa)
    for t, exposure in enumerate(series.exposures):
        seen = _Seen(exposure, dark, labels, count, end_dn)
        signal[t], variance[t], white[t] = seen.signal, seen.variance, seen.white
        freedom[t] = seen.pixels * (len(exposure.frames) - 1)
        flicker[t], flicker_noise[t] = seen.flicker, seen.flicker_noise
        if levels[t] > _PATTERN_FROM * top and tops[t] < _PATTERN_TO * top:
            pattern.add(seen, exposure)
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


def _level(exposure: Repeats, dark: DarkFrames) -> tuple[float, float]:
    """Return the median and the 99th percentile of the first frame, above dark."""
    pixels = exposure.frames[0].read()
    step = max(1, len(pixels) // 256)
    above = pixels[::step] - dark.image(exposure.time_s)[::step]
    middle, high = np.percentile(above, [50, 99])
    return float(middle), float(high)


def _mean(exposure: Repeats) -> Image:
    total = np.zeros(exposure.frames[0].shape)
    for frame in exposure.frames:
        total += frame.read()
    return (total / len(exposure.frames)).astype(np.float32)


class _Seen:
    """Figures of the repeats of one exposure."""

    def __init__(
        self, exposure: Repeats, dark: DarkFrames, labels: Labels, count: int, end_dn: int
    ) -> None:
        frames = [frame.read() for frame in exposure.frames]
        unlit = dark.image(exposure.time_s)
        inside = labels >= 0
        means = np.array([float(np.mean(one[inside], dtype=np.float64)) for one in frames])
        above = means - float(np.mean(unlit[inside], dtype=np.float64))
        # A lamp that flickers makes a frame brighter as a whole: all get the same mean.
        shares = np.ones(len(frames))
        if above.min() > 0:
            shares = above.mean() / above
        self.image = np.zeros(unlit.shape, np.float32)
        sums = np.zeros((3, count))
        for rows in row_bands(len(unlit)):
            zone = labels[rows]
            used = zone >= 0
            where = zone[used]
            part = np.stack([one[rows] for one in frames]).astype(np.float32) - unlit[rows]
            part *= shares[:, None, None].astype(np.float32)
            mean = part.mean(axis=0)
            self.image[rows] = mean
            spread = ((part - mean) ** 2).sum(axis=0) / (len(frames) - 1)
            clipped = np.mean([one[rows] >= end_dn for one in frames], axis=0)
            for k, values in enumerate((mean, spread, clipped)):
                sums[k] += np.bincount(where, weights=values[used], minlength=count)
        self.pixels = np.bincount(labels[inside], minlength=count).astype(np.float64)
        self.signal, self.variance, self.white = sums / np.maximum(self.pixels, 1)
        level = max(above.mean(), 1e-9)
        self.flicker = float(above.std(ddof=1) / level)
        self.flicker_noise = float((self.variance.mean() / inside.sum()) ** 0.5 / level)


class _Pattern:
    """Sum of exposures, which shows the response of the pixels."""

    def __init__(self, dark: DarkFrames, labels: Labels, count: int, cfa: str | None) -> None:
        self._dark, self._labels, self._count, self._cfa = dark, labels, count, cfa
        self._signal = np.zeros(labels.shape, np.float32)
        self._noise = np.zeros(count)
        self._times: list[float] = []

    def add(self, seen: _Seen, exposure: Repeats) -> None:
        self._signal += seen.image
        self._noise += seen.variance / len(exposure.frames)
        self._times.append(exposure.time_s)

    def result(self) -> tuple[float, float]:
        """Return the variance of the response, and the reciprocal of its variance."""
        if not self._times:
            return 0.0, 0.0
        labels, count = self._labels, self._count
        inside = labels >= 0
        where = labels[inside]
        pixels = np.bincount(where, minlength=count)
        signal = np.bincount(where, weights=self._signal[inside], minlength=count) / pixels
        pattern = relative_pattern(self._signal, self._dark.good, self._cfa)[inside]
        # The box leaves this share of the variance of single pixels.
        squares = np.bincount(where, weights=pattern.astype(np.float64) ** 2, minlength=count)
        total = squares / (pixels * (1 - 1 / BOX**2))
        # All exposures have the same errors of the dark frame in common.
        middle = float(np.mean(self._times))
        common = len(self._times) ** 2 * self._dark.leverage(middle) * self._dark.variance(0.0)
        squared = total - (self._noise + common) / signal**2
        weight = pixels / (2 * total**2)
        return float(weight @ squared / weight.sum()), float(weight.sum())
