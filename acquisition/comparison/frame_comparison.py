"""Comparison of two frames of the same light: shift, gain, focus, and what does not fit."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from acquisition._errors import DataError
from acquisition.comparison.registration import Plane, Registered, register
from acquisition.comparison.sharpness import relative_sharpness
from rig.arrays import Bool, Float32, Float64, UInt16

# Fewest rows and columns of a frame.
LEAST_PX: Final = 16
# Frames are averaged over blocks until no side is longer than this.
_LONGEST_PX: Final = 1024
# Cells along the longer side, and the smallest cell.
_CELLS: Final = 64
_LEAST_CELL_PX: Final = 8
# A cell is judged if this share of its pixels is not saturated, and a pair if this share of its
# cells is judged.
_VALID: Final = 0.5
_LEAST_JUDGED: Final = 0.05
# Cells that are darker than this share of the bright ones in both frames are not judged.
_DIM: Final = 0.03
# A cell does not fit if it deviates by this many standard deviations; none of 4,096 cells does by
# chance.
_DEVIATES: Final = 6.0
# What noise does not explain, as a share of a cell's light: interpolation, and lights that vary
# over the frame.
_SLACK: Final = 0.02
# A cell does not fit either if the part of its structure that differs exceeds this share of the
# structure and this share of the light.
_UNLIKE: Final = 0.5
_LEAST_STRUCTURE: Final = 0.005
# Quantile of the variances that is that of even cells, and share of the cells that count as dark.
_EVEN: Final = 0.2
_DARKEST: Final = 0.25
# Cells at edges may deviate one by one; a part is at least this many cells that touch.
_LEAST_CELLS: Final = 3
_OTHER: Final = 0.01
# The noise of cells is known to this share of its standard deviation.
_NOISE_KNOWN: Final = 0.2
# A robust standard deviation of normal values varies by this multiple of that of the usual one,
# 1 / sqrt(2 n).
_ROBUST: Final = 1.65


@dataclass(frozen=True)
class FrameComparison:
    """How the second of two frames of the same light differs from the first.

    NaN stands for what the frames do not show: the shift of an even surface, or anything about a
    frame without light.

    Parameters
    ----------
    shift_px, shift_sigma_px
        ``(right, down)`` by which the content moved from the first to the second frame, pixels,
        and its standard deviations.
    gain, gain_sigma
        Light of the second frame divided by that of the first, and its standard deviation.
    focus, focus_sigma
        Contrast of the finest structure of the second frame divided by that of the first, after
        the gain, and its standard deviation: below 1 if the second frame is less sharp.
    other_fraction
        Share of the judged area, 0 to 1, that does not fit after shift and gain, at 6 standard
        deviations of its noise.
    other_box
        Columns and rows ``(left, top, right, bottom)`` in the second frame that contain what does
        not fit, the last two exclusive; None if all fits.
    judged_fraction
        Share of the frame, 0 to 1, that was judged: lit in one of the frames, and saturated in
        neither.
    gain_spread, gain_spread_sigma
        Robust standard deviation of the gain over the frame without the part that is noise,
        relative to the gain, and its standard deviation: 0 if all lights faded alike, more if the
        light came from another direction.
    unlike_fraction
        Share of the judged area, 0 to 1, whose structure differs: of another object, but not of
        the same object under another light.
    """

    shift_px: tuple[float, float]
    shift_sigma_px: tuple[float, float]
    gain: float
    gain_sigma: float
    focus: float
    focus_sigma: float
    other_fraction: float
    other_box: tuple[int, int, int, int] | None
    judged_fraction: float
    gain_spread: float
    gain_spread_sigma: float
    unlike_fraction: float

    @property
    def comparable(self) -> bool:
        """Whether both frames show enough light below saturation to be compared."""
        return not math.isnan(self.other_fraction)

    @property
    def same_object(self) -> bool:
        """Whether the frames fit after shift and gain: less than 1 % of the judged area differs."""
        return self.other_fraction < _OTHER

    @property
    def distance_px(self) -> float:
        """Length of the shift, pixels; NaN if it is not known."""
        return math.hypot(*self.shift_px)

    @property
    def distance_sigma_px(self) -> float:
        """Standard deviation of the shift along its direction, pixels; NaN if it is not known."""
        return math.hypot(*self.shift_sigma_px)


def compare_frames(
    first: UInt16 | Float32,
    second: UInt16 | Float32,
    *,
    black_level_dn: float = 0.0,
    white_level_dn: float = math.inf,
    mosaic: bool = False,
) -> FrameComparison:
    """Compare two frames of the same scene under the same light at the same exposure time.

    Parameters
    ----------
    first, second
        ``(H, W)`` or ``(H, W, 3)`` linear samples.
    black_level_dn, white_level_dn
        Value without light, and value from which a sample is saturated.
    mosaic
        Whether neighbouring samples lie under different colour filters, in blocks of 2 x 2.

    Returns
    -------
    FrameComparison
        Shifts are found up to half of the frame, with a precision of some hundredths of a pixel.

    Raises
    ------
    DataError
        If the frames differ in size or number of channels, have another shape, or have less than
        16 rows or columns.

    Notes
    -----
    Shift and gain are fitted robustly to both frames, which are moved half way each (see
    Lucas and Kanade 1981; the start is found by phase correlation, Kuglin and Hines 1975). The
    frames are then compared in cells: a cell does not fit if its mean deviates by more than its
    noise, estimated from the second differences of even cells of its brightness (Immerkaer 1996),
    or if most of its structure differs. If the shift is not determined, cells are compared in
    place.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition.comparison import compare_frames
    >>> y, x = np.mgrid[:96, :128]
    >>> waves = 900 + 300 * np.sin(x / 5) * np.cos(y / 7)
    >>> moved = 0.9 * (900 + 300 * np.sin((x - 1.5) / 5) * np.cos(y / 7))
    >>> found = compare_frames(waves.astype(np.float32), moved.astype(np.float32))
    >>> [round(px, 1) + 0.0 for px in found.shift_px], round(found.gain, 2), found.same_object
    ([1.5, 0.0], 0.9, True)
    """
    if first.shape != second.shape:
        raise DataError(
            f"frames of {_size(first)} and {_size(second)} cannot be compared: give two frames of "
            "the same camera and setting"
        )
    grey = first.ndim == 2 or (first.ndim == 3 and first.shape[2] == 3)
    if not grey or min(first.shape[:2]) < LEAST_PX:
        raise DataError(
            f"frames of {_size(first)} cannot be compared: they need at least {LEAST_PX} rows and "
            "columns, and one or three channels"
        )
    step = 2 if mosaic else 1
    block = step
    while max(first.shape[:2]) > block * _LONGEST_PX:
        block += step
    planes = [_plane(frame, block, black_level_dn, white_level_dn) for frame in (first, second)]
    side = max(_LEAST_CELL_PX, -(-max(planes[0].light.shape) // _CELLS))
    lit = [_is_lit(plane, side) for plane in planes]
    registered = register(*planes)
    cells = _Cells(planes, registered, side)
    judged = float(cells.judged.mean())
    if not all(lit) or judged < _LEAST_JUDGED:
        return _without_comparison(planes, lit, judged)
    gain, gain_sigma = cells.gain()
    other, unlike = cells.other(gain)
    share = float(np.count_nonzero(other) / np.count_nonzero(cells.judged))
    shift, sigma, focus = np.full(2, math.nan), np.full(2, math.nan), (math.nan, math.nan)
    if registered.determined and share < _UNLIKE:
        shift = block * registered.shift
        sigma = block * np.sqrt(np.diag(registered.covariance))
        focus = relative_sharpness(
            _samples(first, black_level_dn, step),
            _samples(second, black_level_dn, step),
            shift / step,
            white_level_dn - black_level_dn,
            other,
            side * block / step,
        )
    return FrameComparison(
        _pair(shift),
        _pair(sigma),
        gain,
        gain_sigma,
        *focus,
        share,
        _box(other, side * block, registered.shift * block, first.shape),
        judged,
        *cells.gain_spread(),
        unlike,
    )


def _size(frame: UInt16 | Float32) -> str:
    rows, columns, *channels = (*frame.shape, 0, 0)[: max(2, frame.ndim)]
    depth = f" x {channels[0]}" if channels else ""
    return f"{columns} x {rows}{depth} samples"


def _pair(values: Float64) -> tuple[float, float]:
    return float(values[0]), float(values[1])


def _samples(frame: UInt16 | Float32, black_dn: float, step: int) -> Float32:
    """Return the light of all samples of one colour, or the mean of three channels."""
    one = frame[::step, ::step].astype(np.float32) - np.float32(black_dn)
    return np.asarray(one if one.ndim == 2 else one.mean(axis=2))


def _plane(frame: UInt16 | Float32, block: int, black_dn: float, white_dn: float) -> Plane:
    """Average a frame over channels and blocks of samples."""
    height, width = (length - length % block for length in frame.shape[:2])
    inside = frame[:height, :width]
    brightest = inside if frame.ndim == 2 else inside.max(axis=2)
    grey = inside if frame.ndim == 2 else inside.mean(axis=2, dtype=np.float32)
    size = (width // block, height // block)
    light = cv2.resize(grey.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    blocks = brightest.reshape(size[1], block, size[0], block).max(axis=(1, 3)) < white_dn
    return Plane(np.asarray(light - np.float32(black_dn), np.float32), np.asarray(blocks))


def _is_lit(plane: Plane, side: int) -> bool:
    """Return whether the bright cells of a frame exceed the noise of a single pixel."""
    means, noise = (_cell_sums(part, side) / side**2 for part in (plane.light, _noise(plane.light)))
    return bool(np.percentile(means, 99) > np.median(noise) ** 0.5)


def _noise(light: Float32) -> Float32:
    """Return the variance of the noise at each pixel from second differences (Immerkaer 1996).

    Structure down to single pixels counts as noise, too.
    """
    kernel = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32) / np.float32(6)
    return np.asarray(np.square(cv2.filter2D(light, cv2.CV_32F, kernel)), np.float32)


def _cell_sums(values: Float32 | Bool, side: int) -> Float64:
    """Return the sums over cells; cells at the right and bottom edge may be smaller."""
    edges = [np.arange(0, length, side) for length in values.shape]
    rows = np.add.reduceat(values, edges[0], axis=0, dtype=np.float64)
    return np.asarray(np.add.reduceat(rows, edges[1], axis=1))


def _noise_law(level: Float64, variance: Float64, count: Float64) -> Float64:
    """Return the variance of the noise of each cell, which grows with its brightness.

    The law is that of a sensor, a constant and a part in proportion to the light. The least
    variances are those of even cells; others have structure.
    """
    known = count > 0
    if not known.any():
        return np.zeros_like(level)
    light, own = np.maximum(level[known], 0), variance[known]
    dark = light <= np.quantile(light, _DARKEST)
    constant = max(float(np.quantile(own[dark], _EVEN)), 0.0)
    # A small object on a dark ground leaves few bright cells.
    bright = light > np.quantile(light, 0.99) / 4
    slope = 0.0
    if bright.any() and light[bright].min() > 0:
        slope = max(float(np.quantile((own[bright] - constant) / light[bright], _EVEN)), 0.0)
    # The quantile of even cells is below their mean by 0.84 standard deviations of an estimate from
    # this many second differences, of which about two fifths are independent.
    below = 0.84 * math.sqrt(5 / float(np.median(count[known])))
    return np.asarray((constant + slope * np.maximum(level, 0)) / max(1 - below, 0.5))


def _without_comparison(planes: list[Plane], lit: list[bool], judged: float) -> FrameComparison:
    """Return a comparison that states only the loss of light, if there is one."""
    nan = (math.nan, math.nan)
    gain = nan
    if lit[0] and not lit[1]:
        before, after = (float(plane.light.mean(dtype=np.float64)) for plane in planes)
        noise = float(_noise(planes[1].light).mean(dtype=np.float64)) / planes[1].light.size
        gain = after / before, noise**0.5 / before
    seen = judged if all(lit) else 0.0
    return FrameComparison(nan, nan, *gain, *nan, math.nan, None, seen, *nan, math.nan)


class _Cells:
    """Sums over the cells of two registered frames.

    Parameters
    ----------
    planes
        Both frames as they are.
    registered
        Both frames at the same positions.
    side
        Side of a cell, pixels of the planes.
    """

    def __init__(self, planes: list[Plane], registered: Registered, side: int) -> None:
        pair = registered.first, registered.second
        valid = pair[0].valid & pair[1].valid
        area = _cell_sums(np.ones_like(valid), side)
        count = _cell_sums(valid, side)
        self._count = np.maximum(count, 1)
        self._side = side

        def mean(values: Float32) -> Float64:
            return _cell_sums(np.where(valid, values, 0), side) / self._count

        self._mean = [mean(plane.light) for plane in pair]
        self._square = [mean(np.square(plane.light)) for plane in pair]
        self._product = mean(pair[0].light * pair[1].light)
        halves = -registered.shift / 2, registered.shift / 2
        self._noise = [
            _noise_law(
                level, mean(Plane(_noise(plane.light), plane.valid).sampled(half).light), count
            )
            for plane, half, level in zip(planes, halves, self._mean, strict=True)
        ]
        moved = float(np.hypot(*registered.shift)) / max(valid.shape)
        self._slack = _SLACK + moved
        bright = [max(float(np.percentile(means, 99)), 1e-12) for means in self._mean]
        self._lit = [means > _DIM * most for means, most in zip(self._mean, bright, strict=True)]
        self.judged = (count >= _VALID * area) & (self._lit[0] | self._lit[1])

    def gain(self) -> tuple[float, float]:
        """Return the median ratio of the cells and its standard deviation."""
        gain, scatter, by_noise, count = self._ratios()
        # The median of normal values varies by 1.2533 times as much as their mean.
        return gain, 1.2533 * max(scatter, by_noise) / count**0.5

    def gain_spread(self) -> tuple[float, float]:
        """Return the relative scatter of the ratios beyond their noise, and its deviation."""
        gain, scatter, by_noise, count = self._ratios()
        beyond = math.sqrt(max(scatter**2 - by_noise**2, 0.0))
        chance = _ROBUST * scatter**2 * (2 / count) ** 0.5
        sigma = math.hypot(chance, 2 * _NOISE_KNOWN * by_noise**2)
        # Frames without noise have neither.
        return beyond / gain, sigma / (max(2 * beyond, by_noise) or 1.0) / gain

    def _ratios(self) -> tuple[float, float, float, int]:
        """Return median and robust deviation of the cells' ratios, that of noise, and a count."""
        both = self.judged & self._lit[0] & self._lit[1]
        if not both.any():
            return math.nan, math.nan, math.nan, 1
        ratios = self._mean[1][both] / self._mean[0][both]
        gain = float(np.median(ratios))
        noise = (self._noise[1] + gain**2 * self._noise[0])[both] / self._count[both]
        by_noise = float(np.median(noise**0.5 / self._mean[0][both]))
        return gain, 1.4826 * float(np.median(np.abs(ratios - gain))), by_noise, ratios.size

    def other(self, gain: float) -> tuple[Bool, float]:
        """Return the judged cells that do not fit and touch others that do not.

        Also return the share of judged cells whose structure differs.
        """
        if math.isnan(gain):
            return self.judged, 1.0
        one, two = gain * self._mean[0], self._mean[1]
        noise = gain**2 * self._noise[0] + self._noise[1]
        level = np.maximum(np.abs(one), np.abs(two))
        off = np.abs(two - one) > self._slack * level + _DEVIATES * np.sqrt(noise / self._count)
        structure = [
            gain**2 * (self._square[0] - self._mean[0] ** 2),
            self._square[1] - self._mean[1] ** 2,
        ]
        common = gain * (self._product - self._mean[0] * self._mean[1])
        left = structure[0] + structure[1] - 2 * common - noise
        # Differences of one cell's variance vary by the square root of twice its samples.
        chance = _DEVIATES * noise * np.sqrt(2 / self._count)
        least = np.square((self._slack - _SLACK + _LEAST_STRUCTURE) * level) + chance
        total = structure[0] + structure[1] - noise
        unlike = (left > _UNLIKE * total) & (left > least)
        apart = (self.judged & (off | unlike)).astype(np.uint8)
        _, labels, figures, _ = cv2.connectedComponentsWithStats(apart, connectivity=8)
        large = figures[:, cv2.CC_STAT_AREA] >= _LEAST_CELLS
        large[0] = False
        share = np.count_nonzero(self.judged & unlike) / np.count_nonzero(self.judged)
        return np.asarray(large[labels]), float(share)


def _box(
    other: Bool, side: int, shift: Float64, shape: tuple[int, ...]
) -> tuple[int, int, int, int] | None:
    """Return the rectangle in the second frame around the cells that do not fit."""
    if not other.any():
        return None
    limits = []
    for axis, moved in ((0, shift[0]), (1, shift[1])):
        cells = np.flatnonzero(other.any(axis=axis))
        ends = np.array([cells[0], cells[-1] + 1]) * side + moved / 2
        limits.append(np.clip(np.rint(ends), 0, shape[1 - axis]).astype(int).tolist())
    (left, right), (top, bottom) = limits
    return left, top, right, bottom
