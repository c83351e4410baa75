"""What the dark and ambient frames of a source show."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from acquisition import Source
from acquisition.source import Linearizer, row_bands, same_exposure
from rig import Notice, pluralize
from rig.arrays import Bool, Float32, Intp

# Share of the range from black to white above which a pixel is hot, and standard deviations of the
# dark frame above its surroundings.
_HOT_EXCESS = 0.01
_DEVIATIONS = 8.0
_HOT_ROWS = 200
# Pixels around one, to each side, of which the median is taken.
_AROUND = 2


class References:
    """Hot pixels of the dark frames, and notices about references.

    Parameters
    ----------
    source
        The frames.
    linear
        Reads them.
    exposures_us
        Exposure times of the frames with light, each once, in ascending order.
    """

    def __init__(self, source: Source, linear: Linearizer, exposures_us: Sequence[float]) -> None:
        self._source = source
        self._linear = linear
        self._notices: list[Notice] = []
        # For each exposure time in use, the hot pixels of its dark frames.
        self._hot: list[tuple[float | None, Bool]] = []
        self._levels = [linear.reference_level(time)[0] for time in exposures_us or (None,)]
        if any(frame.role in ("dark", "ambient") for frame in source.frames):
            self._read(exposures_us)

    def _read(self, exposures_us: Sequence[float]) -> None:
        """Read the references of all exposure times; note those that are missing."""
        if not exposures_us:
            self._find_hot(None)
            if self._linear.reference(None) is None:
                text = "dark and ambient frames were not used: the images have no exposure times"
                self._notices.append(Notice("dark-frames-unused", text))
        last_us = 0.0
        for exposure_us in exposures_us:
            if last_us and same_exposure(exposure_us, last_us):
                continue
            last_us = exposure_us
            self._find_hot(exposure_us)
            if self._linear.reference(exposure_us) is None:
                text = (
                    f"no dark or ambient frame with an exposure of {exposure_us:g} us: only the "
                    "black level was subtracted"
                )
                self._notices.append(Notice("dark-frames-missing", text))

    def _find_hot(self, exposure_us: float | None) -> None:
        dark = self._linear.dark_signal(exposure_us)
        if dark is None or not np.isfinite(self._source.white_level):
            return
        hot = hot_pixels(dark)
        if hot.any():
            self._hot.append((exposure_us, hot))

    def hot_at(self, exposure_us: float | None) -> Bool | None:
        """Return where pixels are hot in an exposure time; None if none is."""
        for other_us, hot in self._hot:
            if exposure_us is None or other_us is None or same_exposure(exposure_us, other_us):
                return hot
        return None

    @property
    def hot_pixels(self) -> Intp:
        """Row and column ``(M, 2)`` of the pixels of a frame that are hot in some exposure."""
        hot = [np.argwhere(mask.any(axis=2) if mask.ndim == 3 else mask) for _, mask in self._hot]
        return np.unique(np.concatenate([np.zeros((0, 2), np.intp), *hot]), axis=0)

    @property
    def level(self) -> float:
        """Largest median signal of the references of an exposure time; 0 without any."""
        return max(self._levels, default=0.0)

    @property
    def notices(self) -> list[Notice]:
        """Return what was noted about references and hot pixels."""
        if not self._hot:
            return list(self._notices)
        text = (
            f"{pluralize(len(self.hot_pixels), 'hot pixel')} in the dark frames: replaced by "
            "shorter brackets if there are any, else only corrected"
        )
        return [*self._notices, Notice("hot-pixels", text, severity="info")]


def hot_pixels(dark: Float32) -> Bool:
    """Return the hot pixels of a dark frame.

    A pixel is hot if it is brighter than the median of the 5 x 5 pixels around it by more than 1 %
    of the range and 8 standard deviations of the frame.

    Parameters
    ----------
    dark
        ``(H, W)`` or ``(H, W, 3)`` signal without light, 1 at white.

    Returns
    -------
    NDArray
        bool of the same shape.
    """
    # Every excess is above the darkest pixel.
    if min(dark.shape[:2]) < 5 or not dark.max() - dark.min() > _HOT_EXCESS:
        return np.zeros(dark.shape, np.bool_)
    excess = np.zeros_like(dark)
    for band in row_bands(len(dark)):  # the median of the whole would be one more image in memory
        first = max(band.start - _AROUND, 0)
        around = np.ascontiguousarray(dark[first : band.stop + _AROUND], np.float32)
        median = cv2.medianBlur(around, 2 * _AROUND + 1)
        excess[band] = dark[band] - median[band.start - first :][: band.stop - band.start]
    # Some of the rows show the spread of all.
    rows = excess[:: max(1, len(excess) // _HOT_ROWS)]
    spread = 1.4826 * float(np.median(np.abs(rows)))
    return excess > max(_HOT_EXCESS, _DEVIATIONS * spread)
