"""Dark frames: offset and dark current of each pixel, and the temporal noise around them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from acquisition import Frame, row_bands
from calibration._errors import EstimateError
from rig import Progress, no_progress

Array = npt.NDArray[np.float64]
Image = npt.NDArray[np.float32]

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

    time_s: Array
    mean_dn: Array
    level: Image
    slope: Image
    good: npt.NDArray[np.bool_]
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

    @property
    def current_dn_per_s(self) -> float:
        """Mean slope of the good pixels."""
        return float(self.slope[self.good].mean(dtype=np.float64))

    @property
    def black_dn(self) -> float:
        """Mean grey value of the good pixels at an exposure time of 0."""
        level = float(self.level[self.good].mean(dtype=np.float64))
        return level - self.current_dn_per_s * self.middle_s

    def image(self, time_s: float) -> Image:
        """Return the expected dark frame of an exposure time."""
        away = np.float32(time_s - self.middle_s if self.sloped else 0.0)
        return self.level + away * self.slope

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
    first = frames[0].read().astype(np.float32)
    total, product, squares = (np.zeros(first.shape) for _ in range(3))
    for done, (frame, shift) in enumerate(zip(frames, away, strict=True), 1):
        pixels = frame.read()
        if np.mean(pixels == 0) > _CLIPPED:
            raise EstimateError(
                f"{frame.path}: {np.mean(pixels == 0):.1%} of the dark samples are 0, which hides "
                "their noise: raise the black level of the camera"
            )
        for rows in row_bands(len(pixels)):
            part = pixels[rows] - first[rows].astype(np.float64)
            total[rows] += part
            product[rows] += shift * part
            squares[rows] += part * part
        on_progress("dark frames", done, len(frames))
    spread = float(away @ away)
    level = (first + total / len(frames)).astype(np.float32)
    slope = (product / spread if sloped else product).astype(np.float32)
    residual = squares - total**2 / len(frames)
    if sloped:
        residual -= product**2 / spread
    free = len(frames) - 1 - int(sloped)
    noise = max(float(np.median(residual)) / free, 1 / 12)
    good = _inliers(level, (noise / len(frames)) ** 0.5)
    if sloped:
        good &= _inliers(slope, (noise / spread) ** 0.5)
    means = np.array([np.mean(frame.read()[good], dtype=np.float64) for frame in frames])
    return DarkFrames(time_s, means, level, slope, good, float(residual[good].mean()))


def _inliers(values: Image, least_sigma: float) -> npt.NDArray[np.bool_]:
    sample = values[:: max(1, len(values) // 400)]
    middle = float(np.median(sample))
    sigma = max(1.4826 * float(np.median(np.abs(sample - middle))), least_sigma)
    inside: npt.NDArray[np.bool_] = np.abs(values - np.float32(middle)) <= _DEVIATIONS * sigma
    return inside
