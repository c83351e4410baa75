"""Sub-pixel points on the outline of a sphere, from a mask or from the images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from calibration._errors import EstimateError, or_none
from calibration.radiance.stack import Images
from calibration.spheres.geometry.ellipse import ELLIPSE_COVERAGE, Ellipse, fit_circle, fit_ellipse
from calibration.spheres.geometry.robust import middle_of
from calibration.spheres.outline.limb import (
    REACH_PX,
    STEP_PX,
    edge_offsets,
    estimate_blur,
    profile_offsets,
    slopes_across,
    smooth_along,
    stack_profiles,
)
from rig import short_repr
from rig.arrays import Bool, Float32, Float64, Floating

_SMALLEST_AREA_PX = 60
_BAND_ROWS = 64
_WHITE_STEP = 7
ALONG_PX = 4.0
# Outlines of spheres scatter by 0.02 to 0.15 px, those of other round objects by 0.4 px or more.
SHARP_PX = 0.25
# Largest error of a mask that is painted by hand, or of a circle that a search found.
_REACH_PX, _REACH_SHARE = 3.0, 0.03
# The steepest points of a sharp outline scatter by up to 0.8 px, near a rough guess by 0.9 px.
# An outline that ends within half a pixel of another one is the same.
_ROUGH_PX, _NEAR_GUESS_PX, _SAME_PX = 1.0, 2.0, 0.5
_NEARLY = 0.75
_MOST_ANGLES = 720
IMMERKAER = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)
# So many pixels show the noise of an image.
_SHOW_NOISE = 40_000
_BLOCK, _FEW_IMAGES, _MIDDLE_PX, _EVERY = 8, 4, 1024, 5
# In the 12 images of the University of Washington's chrome ball: 1.0 without compression, 1.4 with
# quality 95, 1.7 with 90, 2.2 with 85, 3.5 with 75, 5.3 with 60; without colour 1.6 with 85, 1.8
# with 75, 2.3 with 60.
_VISIBLE = 1.7


@dataclass(frozen=True, eq=False)
class TracedOutline:
    """An outline of a sphere, and the points that belong to it.

    Parameters
    ----------
    outline
        The ellipse. It is a circle unless more than three quarters of the circumference are
        visible, because a smaller part does not determine an ellipse.
    points_px
        ``(M, 2)`` outline points.
    coverage
        Share 0..1 of the circumference that these points cover.
    """

    outline: Ellipse
    points_px: Float64
    coverage: float

    __repr__ = short_repr

    @property
    def rms_px(self) -> float:
        """Robust scatter of the points about the outline."""
        return 1.4826 * float(np.median(np.abs(self.outline.distance_px(self.points_px))))


def mask_outlines(mask: Bool | Floating) -> list[Float64]:
    """Return the outline points of every connected region of a mask.

    The points are the linearly interpolated crossings of the level 0.5 between neighbouring pixels.
    They are accurate to a few hundredths of a pixel for an anti-aliased mask (values 0..1), and to
    half a pixel without bias for a binary mask. The image border is not an outline, so only the
    visible arc remains of a sphere that is cut off by the frame. Regions below 60 pixels are
    ignored.

    Parameters
    ----------
    mask
        ``(H, W)`` bool, or 0..1.

    Returns
    -------
    list of Array
        One ``(M, 2)`` array of points (x, y) per region.

    Examples
    --------
    >>> import numpy as np
    >>> from calibration.spheres import mask_outlines
    >>> y, x = np.indices((60, 60))
    >>> (points,) = mask_outlines((x - 30) ** 2 + (y - 30) ** 2 < 20**2)
    >>> points.mean(axis=0).round(1)
    array([30., 30.])
    """
    level = np.asarray(mask, np.float64)
    _, regions, stats, _ = cv2.connectedComponentsWithStats((level > 0.5).astype(np.uint8))
    outlines = []
    for index in range(1, len(stats)):
        x, y, width, height, area = stats[index]
        if area < _SMALLEST_AREA_PX:
            continue
        rows = slice(max(y - 1, 0), y + height + 1)
        columns = slice(max(x - 1, 0), x + width + 1)
        # Other regions may overlap the box: keep this region and the pixels outside every region.
        own = np.isin(regions[rows, columns], (0, index))
        crop = np.where(own, level[rows, columns], 0.0)
        points = np.concatenate([_crossings(crop), _crossings(crop.T)[:, ::-1]])
        outlines.append(points + np.array([columns.start, rows.start]))
    return outlines


def _crossings(level: Float64) -> Float64:
    """Return the crossings of the level 0.5 along the rows of the image, as (x, y)."""
    left, right = level[:, :-1], level[:, 1:]
    y, x = np.nonzero((left > 0.5) != (right > 0.5))
    step = (0.5 - left[y, x]) / (right[y, x] - left[y, x])
    return np.column_stack([x + step, y])


def outline_image(values: Images) -> Float32:
    """Return the image in which outlines are searched for: the upper mean over the lights.

    The upper mean of a pixel is taken over its brighter half of the lights without the brightest
    tenth. It contains no shadows, which darken some lights, and no highlights, which brighten few.
    A multiple of its noise is added, so noise in dark areas causes no edges in the logarithm, whose
    steps are searched for.

    Parameters
    ----------
    values
        ``(N, H, W)`` linear images; NaN counts as white.
    """
    count = len(values)
    low, high = count // 2, max(count - max(count // 10, 1), count // 2 + 1)
    white = _white(values)
    mean = np.zeros(values.shape[1:], np.float32)
    for start in range(0, values.shape[1], _BAND_ROWS):
        rows = slice(start, start + _BAND_ROWS)
        # The minimum with a number is that number where a value is NaN.
        band = np.clip(np.fmin(values[:, rows], np.float32(white)), 0.0, white)
        # Move the lights to the last axis: sorting along contiguous memory is several times faster.
        ordered = np.sort(np.ascontiguousarray(np.moveaxis(band, 0, -1)), axis=-1)
        mean[rows] = ordered[..., low:high].mean(axis=-1)
    offset = max(20 * image_noise(mean, 1), 0.01 * float(mean.mean()), 1e-6)
    return mean + np.float32(offset)


class OutlineImages:
    """The images in which outlines are searched for, computed when they are used.

    Parameters
    ----------
    values
        ``(N, H, W)`` linear images; NaN counts as white.
    """

    def __init__(self, values: Images) -> None:
        self.values = values

    @cached_property
    def upper(self) -> Float32:
        """The upper mean, see `outline_image`: it shows most of an outline in most recordings."""
        return outline_image(self.values)

    @cached_property
    def median(self) -> Float32:
        """The median: of few images, reflections and shadows of the surroundings spoil it least."""
        white = _white(self.values)
        median = np.zeros(self.values.shape[1:], np.float32)
        for start in range(0, len(median), _BAND_ROWS):
            rows = slice(start, start + _BAND_ROWS)
            band = self.values[:, rows]
            median[rows] = np.median(np.where(np.isnan(band), np.float32(white), band), axis=0)
        # Noise about black may be negative, as the upper mean is not.
        median = np.maximum(median, 0)
        return median + np.float32(max(0.01 * float(median.mean()), 1e-6))


def _white(values: Images) -> float:
    """Return the white level: 1, or the 99th percentile if that is higher (other scales)."""
    some = values[:, ::_WHITE_STEP, ::_WHITE_STEP]
    finite = some[np.isfinite(some)]
    return max(float(np.percentile(finite, 99)), 1.0) if len(finite) else 1.0


def refine_outline(
    image: Float32, guess: Ellipse, reach_px: float, rivals: Sequence[Ellipse] = ()
) -> TracedOutline:
    """Fit the outline to image edges near a guess, in rounds with a decreasing search range.

    Parameters
    ----------
    image
        ``(H, W)`` from `outline_image`.
    guess
        Start value.
    reach_px
        Largest distance of the true outline from the guess.
    rivals
        Outlines that only another, sharp one can replace: others are not fitted exactly.

    Raises
    ------
    EstimateError
        If there is no edge near the guess.
    """
    ellipse = guess
    start: Ellipse | None = None  # the error of the guess may exceed that of the outliers
    for reach in (reach_px, max(reach_px / 2, 3.0), REACH_PX):
        angles, offsets, seen = _steepest(image, ellipse, reach)
        found = _fit(ellipse, angles[seen], offsets[seen], len(angles), start)
        ellipse = start = found.outline
        if rivals and found.rms_px > _NEAR_GUESS_PX:
            return found
    if rivals:
        same = any(_is_same(ellipse, rival) for rival in rivals)
        if found.rms_px > (SHARP_PX if same else _ROUGH_PX):
            return found
    return _refine_edges(image, ellipse)


def _is_same(a: Ellipse, b: Ellipse) -> bool:
    """Return whether two outlines differ by less than half a pixel."""
    change = np.subtract((*a.centre_px, *a.semi_axes_px), (*b.centre_px, *b.semi_axes_px))
    return bool(np.abs(change).max() < _SAME_PX)


def refine_sharpest(
    images: OutlineImages, guess: Ellipse, reach_px: float, rivals: Sequence[Ellipse] = ()
) -> TracedOutline:
    """Fit the outline to the upper mean, or to the median image if it is sharper there.

    Where reflections or shadows of the surroundings meet the outline, edge points scatter, and the
    outline may be wrong by many pixels. The fit with the smaller scatter wins if it covers nearly
    as much of the circumference. Parameters, results and errors are those of `refine_outline`.
    """
    found = refine_outline(images.upper, guess, reach_px, rivals)
    if found.rms_px < SHARP_PX:
        return found
    other = or_none(refine_outline, images.median, guess, reach_px, rivals)
    if other is None:
        return found
    sharper = other.rms_px < 0.5 * found.rms_px
    return other if sharper and other.coverage > _NEARLY * found.coverage else found


def _refine_edges(image: Float32, ellipse: Ellipse) -> TracedOutline:
    """Fit an outline that is known to a pixel, with the model of a blurred limb."""
    for _ in range(2):
        angles, _, seen = _steepest(image, ellipse, REACH_PX)
        if not seen.any():
            raise no_outline(ellipse)
        profiles = stack_profiles([image], ellipse, angles, profile_offsets())[:, 0]
        # What decides between rivals starts here, so rounding should not: float64. Smoothing along
        # the outline averages out its position relative to the pixel grid.
        profiles = smooth_along(profiles.astype(np.float64), ALONG_PX)[:, seen]
        offsets = edge_offsets(profiles, estimate_blur(profiles))
        found = _fit(ellipse, angles[seen], offsets, len(angles), ellipse)
        ellipse = found.outline
    return found


def _fit(
    guess: Ellipse, angles: Float64, offsets: Float64, count: int, start: Ellipse | None
) -> TracedOutline:
    """Fit a circle, or an ellipse if enough is visible."""
    if len(angles) < 12:
        raise no_outline(guess)
    points = guess.point(angles, 1 + offsets / guess.radius_px)
    ellipse, weights = fit_circle(points, start)
    if len(points) > ELLIPSE_COVERAGE * count:
        ellipse, weights = fit_ellipse(points, start or ellipse)
    good = weights > 0
    return TracedOutline(ellipse, points[good], float(np.count_nonzero(good)) / count)


def usual_reach_px(radius_px: float, share: float = _REACH_SHARE) -> float:
    """Return by how much an outline may be wrong: 3 px, or a share of the radius."""
    return max(_REACH_PX, share * radius_px)


def no_outline(guess: Ellipse) -> EstimateError:
    """Return the error that there is no outline near a guess."""
    x, y = guess.centre_px
    return EstimateError(
        f"no sphere outline at ({x:.0f}, {y:.0f}) px: give a mask or a better circle"
    )


def edge_angles(outline: Ellipse, most: int = _MOST_ANGLES) -> Float64:
    """Return the angles at which an outline is examined, about one per pixel, or so many."""
    count = int(np.clip(2 * np.pi * outline.radius_px, 90, most))
    return np.arange(count, dtype=np.float64) * (2 * np.pi / count)


def _steepest(image: Float32, guess: Ellipse, reach_px: float) -> tuple[Float64, Float64, Bool]:
    """Find the step with the largest contrast on each radius.

    Returns the angles (about one per pixel), the offset of the step from the guess at each angle,
    and whether the step is significant.
    """
    angles = edge_angles(guess)
    count = len(angles)
    wide = max(reach_px, 6.0)  # a wider range shows the contrast of pixels without an edge
    offsets = np.arange(-wide, wide + STEP_PX / 2, STEP_PX, dtype=np.float64)
    profiles = stack_profiles([image], guess, angles, offsets)[:, 0]
    contrast = np.abs(slopes_across(np.log(profiles), 0.8 / STEP_PX))
    within_reach = np.abs(offsets) <= reach_px
    best = np.argmax(within_reach[:, None] * contrast, axis=0)
    peak = contrast[best, np.arange(count)]
    place = guess.point(angles, 1 + offsets[best] / guess.radius_px)
    height, width = image.shape
    margin = REACH_PX
    within = np.all((place > margin) & (place < np.array([width, height]) - 1 - margin), axis=1)
    return angles, offsets[best], within & (peak > 4 * middle_of(contrast) + 1e-4 * STEP_PX)


def image_noise(image: Float32, every: int | None = None) -> float:
    """Return the standard deviation of the noise of one image, fine texture included.

    Immerkaer's kernel is insensitive to brightness, slopes and straight edges (Fast noise variance
    estimation, 1996); the upper quartile of its response is that of noise if most of the image is
    even. It is taken from every so many rows and columns; default: enough of them.
    """
    residue = cv2.filter2D(image, -1, IMMERKAER)
    every = every or max(int(np.sqrt(residue.size / _SHOW_NOISE)), 1)
    return float(np.percentile(np.abs(residue[::every, ::every]), 75)) / 6.9


def shows_blocks(values: Images) -> bool:
    """Return whether images show the borders of blocks of 8 x 8 px, as JPEG compression does.

    Second differences along rows and columns are larger by a factor of 1.7 or more at every eighth
    border between pixels than elsewhere, in both directions. Such borders look like edges.

    Parameters
    ----------
    values
        ``(N, H, W)`` linear images, NaN where saturated.
    """
    sums = np.zeros((2, _BLOCK))
    if min(values.shape[1:]) < 4 * _BLOCK:
        return False
    height, width = values.shape[1:]
    rows, columns = (
        slice(max(size - _MIDDLE_PX, 0) // 2, (size + _MIDDLE_PX) // 2) for size in (height, width)
    )
    for k in range(0, len(values), -(-len(values) // _FEW_IMAGES)):
        # Square roots, because the steps of quantization are larger where it is bright.
        image = np.sqrt(np.clip(np.nan_to_num(values[k, rows, columns], nan=1.0), 0, 1))
        for along, lines in zip(sums, (image[:, ::_EVERY].T, image[::_EVERY]), strict=True):
            differences = np.abs(np.diff(lines, 2, axis=1)).mean(axis=0, dtype=np.float64)
            along += [differences[first::_BLOCK].mean() for first in range(_BLOCK)]
    # Both differences that contain the border are large.
    pairs = np.minimum(sums, np.roll(sums, 1, axis=1)).max(axis=1)
    return bool(np.all(pairs > _VISIBLE * np.median(sums, axis=1)) and np.all(pairs > 0))
