"""Dark frames: offset and dark current of each pixel, and the temporal noise around them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from acquisition import Frame
from acquisition.source import row_bands
from calibration._errors import EstimateError
from rig import Progress, no_progress
from rig.arrays import Bool, Float32, Float64

# A pixel this many standard deviations from the others is a defect.
_DEVIATIONS = 8.0
# Share of dark samples at 0 that distorts mean and variance.
_CLIPPED = 1e-3


@dataclass(frozen=True, eq=False)
class DarkFrames:
    """Least-squares line of each pixel's dark signal over exposure time.

    Parameters
    ----------
    time_s
        Exposure times of the frames.
    mean_dn
        Mean of each frame over the good pixels.
    level, slope
        ``(H, W)`` grey value at the mean exposure time, and change per second; the slope is 0 if
        all exposure times are equal.
    good
        ``(H, W)`` bool, pixels that are like the others.
    residual
        Mean over the good pixels of the sum of squared deviations from the lines, DN^2.
    """

    time_s: Float64
    mean_dn: Float64
    level: Float32
    slope: Float32
    good: Bool
    residual: float

    @property
    def sloped(self) -> bool:
        """Whether the exposure times differ."""
        return bool(np.ptp(self.time_s) > 0)

    @property
    def free(self) -> int:
        """Degrees of freedom of the residuals of a pixel."""
        return len(self.time_s) - 1 - int(self.sloped)

    @property
    def middle_s(self) -> float:
        """Mean exposure time."""
        return float(self.time_s.mean())

    @property
    def spread_s2(self) -> float:
        """Sum of the squared deviations of the exposure times from their mean."""
        return float(np.sum((self.time_s - self.middle_s) ** 2))

    @cached_property
    def current_dn_per_s(self) -> float:
        """Mean slope of the good pixels."""
        return float(np.mean(self.slope, dtype=np.float64, where=self.good))

    @cached_property
    def level_dn(self) -> float:
        """Mean level of the good pixels."""
        return float(np.mean(self.level, dtype=np.float64, where=self.good))

    @property
    def level_variance(self) -> float:
        """Variance of the levels of the good pixels, DN^2."""
        squares = [
            np.sum((self.level[rows][self.good[rows]] - self.level_dn) ** 2, dtype=np.float64)
            for rows in row_bands(len(self.level))
        ]
        return float(np.sum(squares)) / int(self.good.sum())

    @property
    def black_dn(self) -> float:
        """Mean grey value of the good pixels at an exposure time of 0."""
        return self.level_dn - self.current_dn_per_s * self.middle_s

    def image(self, time_s: float, rows: slice = slice(None)) -> Float32:
        """Return rows of the expected dark frame of an exposure time."""
        away = np.float32(time_s - self.middle_s if self.sloped else 0.0)
        return self.level[rows] + away * self.slope[rows]

    def leverage(self, time_s: float) -> float:
        """Return the variance of `image` relative to the temporal variance of a frame."""
        share = 1.0 / len(self.time_s)
        if self.sloped:
            share += (time_s - self.middle_s) ** 2 / self.spread_s2
        return share

    def variance(self, gain: float) -> float:
        """Return the temporal variance at an exposure time of 0, DN^2.

        Parameters
        ----------
        gain
            Grey values per electron, by which dark current has shot noise.
        """
        free = 1.0 - np.array([self.leverage(time) for time in self.time_s])
        current = np.maximum(self.current_dn_per_s * self.time_s, 0.0)
        return (self.residual - gain * float(free @ current)) / float(free.sum())


def dark_frames(frames: Sequence[Frame], on_progress: Progress = no_progress) -> DarkFrames:
    """Read dark frames.

    Raises
    ------
    DataError
        If a frame is damaged.
    EstimateError
        If samples are clipped at 0.
    """
    time_s = np.array([(frame.exposure_us or 0.0) / 1e6 for frame in frames])
    # Exposure times that the camera rounds differently are equal.
    if np.ptp(time_s) < 1e-3 * time_s.mean():
        time_s = np.full_like(time_s, time_s.mean())
    sloped = np.ptp(time_s) > 0
    away = time_s - time_s.mean() if sloped else np.zeros_like(time_s)
    first = frames[0].read()
    # Differences from the first frame are so small that single precision is enough.
    total, product, squares = (np.zeros(first.shape, np.float32) for _ in range(3))
    for done, (frame, shift) in enumerate(zip(frames, away, strict=True), 1):
        pixels = frame.read()
        if np.mean(pixels == 0) > _CLIPPED:
            raise EstimateError(
                f"{frame.path}: {np.mean(pixels == 0):.1%} of the dark samples are 0, which hides "
                "their noise: raise the black level of the camera"
            )
        for rows in row_bands(len(pixels)):
            part = pixels[rows].astype(np.float32) - first[rows]
            total[rows] += part
            product[rows] += np.float32(shift) * part
            squares[rows] += part * part
        on_progress("dark frames", done, len(frames))
    spread = float(away @ away)
    level, slope, residual = total, product, squares
    for rows in row_bands(len(first)):
        residual[rows] -= total[rows] ** 2 / np.float32(len(frames))
        level[rows] = first[rows] + total[rows] / np.float32(len(frames))
        if sloped:
            residual[rows] -= product[rows] ** 2 / np.float32(spread)
            slope[rows] /= np.float32(spread)
    del first, pixels
    free = len(frames) - 1 - int(sloped)
    noise = max(float(np.median(_sample(residual))) / free, 1 / 12)
    good = _inliers(level, (noise / len(frames)) ** 0.5)
    if sloped:
        good &= _inliers(slope, (noise / spread) ** 0.5)
    means = np.array([np.mean(frame.read(), dtype=np.float64, where=good) for frame in frames])
    mean_residual = float(np.mean(residual, dtype=np.float64, where=good))
    return DarkFrames(time_s, means, level, slope, good, mean_residual)


def _inliers(values: Float32, least_sigma: float) -> Bool:
    sample = _sample(values)
    middle = float(np.median(sample))
    sigma = max(1.4826 * float(np.median(np.abs(sample - middle))), least_sigma)
    inside = np.zeros(values.shape, np.bool_)
    for rows in row_bands(len(values)):
        inside[rows] = np.abs(values[rows] - np.float32(middle)) <= _DEVIATIONS * sigma
    return inside


def _sample(values: Float32) -> Float32:
    """Return rows that are spread over an image."""
    return values[:: max(1, len(values) // 400)]
