"""Changes of a surface between two recordings, with their significance."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

import cv2
import numpy as np
from scipy.ndimage import binary_fill_holes, find_objects, label

from acquisition import DataError
from processing.changes.detection import FWHM, DetectionLevel, DetectionLevels
from processing.changes.difference import Difference, field_difference
from processing.changes.local_heights import height_variances, local_heights
from processing.changes.significance import (
    Response,
    albedo_responses,
    height_responses,
    threshold,
)
from processing.registration.field import Field
from rig import short_repr
from rig.arrays import Bool, Float32, Int32

# Deviation of the difference relative to the error bars, which no two recordings reach.
_SAME_RECORDING: Final = 1e-3
# A change extends as far as its significance is above this.
_EXTENT: Final = 4.0
# What is significant exceeds the curl within these pixels by this factor.
_NEARBY, _ABOVE_CURL = 8, 1.5
# Pixels around it whose height may have changed as well.
_MARGIN: Final = 3
# Relative standard deviation of the blur of a lens.
_BLUR_SPREAD: Final = 0.25
# Finer pixels on which widths are measured.
_FINER: Final = 4
# A narrow change is at least this share of the blur wide.
_NARROWEST: Final = 0.2
# Relative deviation of width and height by the profile.
_PROFILE: Final = 0.05
# Fewest pixels that have a direction.
_FEWEST: Final = 4
# Cross-sections within this distance in pixels are averaged.
_STRETCH: Final = 8
# Length over width of a scratch, which is blurred across only.
_LONG: Final = 2.0


@dataclass(frozen=True)
class Change:
    """A connected significant change.

    Parameters
    ----------
    row, column
        The worst place, a pixel of the first field.
    kind
        ``surface``: the shape has changed; ``albedo``: only the colour.
    area_px, length_px, width_px
        Area, length and width of the part that is more than half as deep as the worst place, in
        (square) pixels, without the blur of the lens.
    width_sigma_px
        Standard deviation of the width.
    height_px, height_sigma_px
        Change of height at the worst place along +Z in pixels, and its standard deviation; NaN for
        one of albedo.
    albedo_factor, albedo_sigma
        Albedo after over albedo before at the worst place, and its standard deviation; NaN without
        albedos.
    z
        The largest significance in standard deviations.
    """

    row: int
    column: int
    kind: str
    area_px: float
    length_px: float
    width_px: float
    width_sigma_px: float
    height_px: float
    height_sigma_px: float
    albedo_factor: float
    albedo_sigma: float
    z: float


@dataclass(frozen=True, eq=False)
class Changes:
    """What has changed between two fields, AFTER - BEFORE.

    Parameters
    ----------
    changes
        Significant changes, the most significant first.
    levels
        The smallest changes that would have been found.
    difference
        Differences of slopes and of the logarithm of the albedo, with their weights.
    height
        ``(H, W)`` change of height in pixels of the changed parts relative to their surroundings,
        0 elsewhere, NaN where the fields are not compared.
    height_sigma
        ``(H, W)`` standard deviation of the height of a spot as wide as a pixel.
    z
        ``(H, W)`` significance of a change of the surface, of the best template, with the sign of
        the height.
    albedo_z
        ``(H, W)`` the same of the albedo; None if one is not known.
    significant
        ``(H, W)`` bool, the significant changes.
    threshold
        The size of z above which a change is significant.
    false_alarm
        Probability that a map without a change has one above the threshold.
    """

    changes: tuple[Change, ...]
    levels: tuple[DetectionLevel, ...]
    difference: Difference
    height: Float32
    height_sigma: Float32
    z: Float32
    albedo_z: Float32 | None
    significant: Bool
    threshold: float
    false_alarm: float

    __repr__ = short_repr


class _Best:
    """The most significant template at every pixel."""

    def __init__(self, shape: tuple[int, ...]) -> None:
        self.z = np.zeros(shape, np.float32)
        self.control = np.zeros(shape, np.float32)
        self.amplitude = np.zeros(shape, np.float32)
        self.sigma = np.full(shape, np.nan, np.float32)
        self.factor = np.ones(shape, np.float32)

    def add(self, response: Response) -> None:
        better = np.abs(response.z) > np.abs(self.z)
        for name in ("z", "amplitude", "sigma"):
            np.copyto(getattr(self, name), getattr(response, name), where=better)
        np.maximum(self.factor, response.factor, out=self.factor)
        if response.control is not None:
            np.maximum(self.control, np.abs(response.control), out=self.control)


def find_changes(
    before: Field,
    after: Field,
    holds: Bool | None = None,
    *,
    false_alarm: float = 0.05,
    blur_px: float = 0.8,
) -> Changes:
    """Find what has changed on a surface between two recordings.

    What lights that deviate and what is left of the registration do to the normals varies smoothly
    over the map and is removed: in every neighbourhood of about 100 pixels, a linear map of the
    normals, a shift and a difference of blur. In what is left, spots and lines of several widths
    are compared with the errors nearby. These have as much curl as divergence, and a change of a
    surface has no curl: so its curl shows the errors of a map without its changes.

    Parameters
    ----------
    before
        First field, with error bars.
    after
        Second field on the pixels of the first, with error bars, see `Registration.resampled`.
    holds
        ``(H, W)`` bool, where the registration holds; None for everywhere.
    false_alarm
        Probability that anything is found in the complete map if nothing has changed, 0 to 1.
    blur_px
        Standard deviation of the blur of both maps, see `LensBlur`.

    Raises
    ------
    DataError
        If sizes differ, a field has no error bars, nothing is in common, both are of the same
        recording, or the probability is out of range.

    Examples
    --------
    >>> import numpy as np
    >>> from processing import NormalMap
    >>> from processing.changes import find_changes
    >>> from processing.registration import Field
    >>> noise = np.random.default_rng(1).normal(0, 0.003, (2, 200, 240, 3))
    >>> noise[1, 100, 60:100, 1] += 0.03
    >>> sigma_deg = np.full((200, 240), 0.3, np.float32)
    >>> before, after = (
    ...     Field(NormalMap.from_vectors(one + [0, 0, 1]), sigma_deg=sigma_deg) for one in noise
    ... )
    >>> len(find_changes(before, after).changes)
    1
    """
    shape = before.mask.shape
    if after.mask.shape != shape:
        raise DataError(f"fields of {shape} and {after.mask.shape} pixels: resample the second")
    if before.sigma_deg is None or after.sigma_deg is None:
        raise DataError(
            "significance requires the error bars of both normal maps: compute the normals with a "
            "noise law, or from 5 images at least"
        )
    if not 0 < false_alarm < 1:
        raise DataError(f"a probability of {false_alarm:g} is not between 0 and 1")
    difference = field_difference(before, after, np.ones(shape, bool) if holds is None else holds)
    known = difference.known
    found_slope = 1 / math.sqrt(float(np.median(difference.weight[known])))
    stated = float(np.median(np.radians(before.sigma_deg[known])))
    if found_slope < _SAME_RECORDING * stated:
        raise DataError(
            "the two fields differ by far less than their error bars: they are of the same "
            "recording, so nothing can have changed"
        )
    area = int(np.count_nonzero(known))
    with_albedo = difference.log_albedo is not None
    level = threshold(area, false_alarm, albedo=with_albedo)
    detection = DetectionLevels(blur_px)
    surface, albedo = _Best(shape), _Best(shape)
    height_sigma = None
    for response in height_responses(difference):
        surface.add(response)
        detection.add(response)
        height_sigma = response.sigma if height_sigma is None else height_sigma
    for response in albedo_responses(difference):
        albedo.add(response)
    regions = _regions(surface, level)
    height = local_heights(difference, regions)
    found = _surface_changes(difference, surface, albedo, regions, height, blur_px)
    only_albedo = _regions(albedo, level) if with_albedo else np.zeros(shape, np.int32)
    near = cv2.dilate((regions > 0).astype(np.uint8), np.ones((9, 9), np.uint8)) > 0
    found += _albedo_changes(difference, albedo, only_albedo, near)
    significant = (np.abs(surface.z) >= level) & (regions > 0)
    significant |= (np.abs(albedo.z) >= level) & (only_albedo > 0)
    return Changes(
        tuple(sorted(found, key=lambda one: -abs(one.z))),
        tuple(detection.found(level)),
        difference,
        np.where(difference.known, height, np.float32(np.nan)),
        np.asarray(height_sigma),
        surface.z,
        albedo.z if with_albedo else None,
        significant,
        level,
        false_alarm,
    )


def _regions(best: _Best, level: float) -> Int32:
    """Return the numbers of connected changes, each with a significant place."""
    seeds = np.abs(best.z) >= level
    if not seeds.any():
        return np.zeros(seeds.shape, np.int32)
    wide = binary_fill_holes(np.abs(best.z) > _EXTENT)
    numbers, count = label(wide, np.ones((3, 3)))
    peak, control = (np.zeros(count + 1) for _ in range(2))
    np.maximum.at(peak, numbers.ravel(), np.abs(best.z).ravel())
    nearby = cv2.dilate(best.control, np.ones((2 * _NEARBY + 1,) * 2, np.uint8))
    np.maximum.at(control, numbers.ravel(), nearby.ravel())
    kept = peak >= level
    # Where errors are large, they have curl as well.
    kept &= peak > _ABOVE_CURL * control
    kept[0] = False
    grown = cv2.dilate((kept[numbers]).astype(np.uint8), np.ones((2 * _MARGIN + 1,) * 2, np.uint8))
    grown[[0, -1]] = grown[:, [0, -1]] = 0
    return np.asarray(label(grown > 0, np.ones((3, 3)))[0], np.int32)


def _surface_changes(
    difference: Difference,
    surface: _Best,
    albedo: _Best,
    regions: Int32,
    height: Float32,
    blur_px: float,
) -> list[Change]:
    boxes = find_objects(regions)
    if not boxes:
        return []
    smooth = cv2.GaussianBlur(height, (0, 0), 1.0)
    places = []
    for number, box in enumerate(boxes, 1):
        inside = np.where(regions[box] == number, np.abs(smooth[box]), -1)
        row, column = np.unravel_index(int(np.argmax(inside)), inside.shape)
        places.append((row + box[0].start, column + box[1].start))
    spots = np.array(places)
    sigmas = np.sqrt(height_variances(difference, regions, spots))
    sigmas *= surface.factor[tuple(spots.T)]
    found = []
    for number, (box, (row, column)) in enumerate(zip(boxes, places, strict=True), 1):
        own = regions[box] == number
        size = _Size.of(np.where(own, height[box], 0), (row - box[0].start, column - box[1].start))
        sharp = size.sharpened(blur_px, sigmas[number - 1])
        peak = float(np.abs(np.where(own, surface.z[box], 0)).max())
        found.append(
            Change(
                int(row),
                int(column),
                "surface",
                size.area * sharp.width / size.width,
                size.length,
                sharp.width,
                sharp.width_sigma,
                sharp.height,
                sharp.height_sigma,
                *_albedo_at(albedo, row, column),
                math.copysign(peak, size.height),
            )
        )
    return found


def _albedo_at(albedo: _Best, row: int, column: int) -> tuple[float, float]:
    factor = math.exp(float(albedo.amplitude[row, column]))
    return factor, factor * float(albedo.sigma[row, column])


def _mean_factor(
    difference: Difference, albedo: _Best, place: tuple[int, int], radius: float
) -> tuple[float, float]:
    """Return the factor of the albedo and its deviation, averaged over the middle of a change."""
    if difference.log_albedo is None or difference.albedo_weight is None:
        raise AssertionError("a change of the albedo has an albedo")
    rows, columns = np.indices(difference.log_albedo.shape)
    near = (rows - place[0]) ** 2 + (columns - place[1]) ** 2 <= radius**2
    middle = np.asarray(near & (difference.albedo_weight > 0))
    variance = float((1 / difference.albedo_weight[middle]).mean()) / np.count_nonzero(middle)
    factor = math.exp(float(difference.log_albedo[middle].mean()))
    return factor, factor * math.sqrt(variance) * float(albedo.factor[place])


def _albedo_changes(
    difference: Difference, albedo: _Best, regions: Int32, taken: Bool
) -> list[Change]:
    found = []
    for number, box in enumerate(find_objects(regions), 1):
        own = regions[box] == number
        z = np.where(own, albedo.z[box], 0)
        place = np.unravel_index(int(np.argmax(np.abs(z))), z.shape)
        row, column = (int(at + of.start) for at, of in zip(place, box, strict=True))
        # The albedo of a changed surface is in the row of that change.
        if taken[row, column]:
            continue
        size = _Size.of(z, (int(place[0]), int(place[1])))
        found.append(
            Change(
                row,
                column,
                "albedo",
                size.area,
                size.length,
                size.width,
                math.nan,
                math.nan,
                math.nan,
                *_mean_factor(difference, albedo, (row, column), size.width / 4),
                float(z[place]),
            )
        )
    return found


@dataclass(frozen=True)
class _Size:
    """Size of the part of a change that is more than half as high as its worst place."""

    height: float
    area: float
    length: float
    width: float

    @classmethod
    def of(cls, values: Float32, place: tuple[int, int]) -> _Size:
        finer = cv2.resize(
            np.pad(values, 2), None, fx=_FINER, fy=_FINER, interpolation=cv2.INTER_CUBIC
        )
        row, column = (_FINER * (at + 2) for at in place)
        near = finer[
            max(row - _FINER, 0) : row + 2 * _FINER, max(column - _FINER, 0) : column + 2 * _FINER
        ]
        height = float(near.flat[int(np.argmax(np.abs(near)))])
        numbers = label(finer * np.sign(height) > abs(height) / 2, np.ones((3, 3)))[0]
        here = numbers[row : row + _FINER, column : column + _FINER]
        rows, columns = np.nonzero(numbers == (here.max() or 1))
        area = len(rows) / _FINER**2
        if len(rows) < _FEWEST:
            return cls(height, 1.0, 1.0, 1.0)
        spread = np.linalg.eigvalsh(np.cov(np.stack([rows, columns]) / _FINER))
        # Of a rectangle, and of an ellipse.
        length = math.sqrt(12 * float(spread[1]))
        if length**2 > _LONG * area:
            height, width = _across(values, place, height)
            return cls(height, area, length, width)
        length = 4 * math.sqrt(float(spread[1]))
        width = 4 * area / (math.pi * length)
        # The mean of its middle, because the largest value is one with a large error.
        down, right = np.indices(values.shape)
        middle = (down - place[0]) ** 2 + (right - place[1]) ** 2 <= (width / 4) ** 2
        return cls(float(values[middle].mean()), area, length, width)

    def sharpened(self, blur_px: float, sigma: float) -> _Sharp:
        """Return height and width without the blur, from a height with a standard deviation.

        A lens keeps the volume of a change. A Gaussian profile loses the most height and gains the
        most width, and a wide level one neither; profiles in between are within 2 deviations.
        """
        dimensions = 1 if self.length > _LONG * self.width else 2
        relative = sigma / abs(self.height)
        blur = FWHM * blur_px

        def narrowed(width: float, blur: float) -> float:
            return math.sqrt(max(width**2 - blur**2, (_NARROWEST * blur) ** 2))

        # A width that is not above that of the blur surely may be any smaller one.
        least = narrowed(self.width * max(1 - relative / 2, 0), (1 + _BLUR_SPREAD) * blur)
        most = (self.width / least) ** dimensions
        width, wider = narrowed(self.width, blur), narrowed(self.width, (1 - _BLUR_SPREAD) * blur)
        factor = (1 + most) / 2
        return _Sharp(
            factor * self.height,
            abs(self.height) * math.hypot(factor * relative, (most - 1) / 4, _PROFILE),
            (self.width + width) / 2,
            math.hypot(
                self.width * relative,
                (self.width - width) / 4,
                (wider - width) / 2,
                _PROFILE * self.width,
            ),
        )


def _across(values: Float32, place: tuple[int, int], height: float) -> tuple[float, float]:
    """Return height and width of a scratch: of the mean of its cross-sections near a place."""
    rows, columns = np.indices(values.shape)
    down, right = np.asarray(rows - place[0]), np.asarray(columns - place[1])
    relative = np.asarray(values / height, np.float32)
    near = (down**2 + right**2 <= _STRETCH**2) & (relative > 0.5)
    if np.count_nonzero(near) < _FEWEST:
        return height, 1.0
    spread = np.cov(np.stack([right[near], down[near]]), aweights=relative[near])
    axes = np.linalg.eigh(spread).eigenvectors
    along, across = axes[:, 1], axes[:, 0]
    v = np.arange(-4 * _STRETCH, 4 * _STRETCH + 1) / 4
    u = np.arange(-_STRETCH, _STRETCH + 1)
    x, y = (
        (place[1 - k] + across[k] * v[:, None] + along[k] * u).astype(np.float32) for k in (0, 1)
    )
    sampled = np.asarray(cv2.remap(relative, x, y, cv2.INTER_CUBIC))
    mean = sampled[:, np.abs(sampled).max(axis=0) > 0.5].mean(axis=1)
    peak = int(np.argmax(np.where(np.abs(v) <= 2, mean, 0)))
    beside = mean < mean[peak] / 2
    first = np.flatnonzero(beside[:peak])
    last = np.flatnonzero(beside[peak:])
    low, high = (first[-1] if len(first) else 0), (peak + last[0] if len(last) else len(v) - 1)

    def crossing(out: int, inside: int) -> float:
        share = (mean[peak] / 2 - mean[out]) / max(mean[inside] - mean[out], 1e-9)
        return float(v[out] + share * (v[inside] - v[out]))

    width = crossing(high, high - 1) - crossing(low, low + 1)
    return height * float(mean[peak]), width


class _Sharp(NamedTuple):
    height: float
    height_sigma: float
    width: float
    width_sigma: float
