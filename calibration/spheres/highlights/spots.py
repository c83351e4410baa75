"""Clusters of bright spots that move with the light: where mirror spheres are."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, reduce

import cv2
import numpy as np

from calibration.radiance.stack import Images
from rig.arrays import Float32, Float64, Intp

_SIZE_PX = 900
# Rows of the reduced image that are computed together, so that their pixels fit into the cache.
_BAND_ROWS = 8
# A highlight is this much brighter than what the other lights show at its place, and than the
# brightest matte surface.
_EXCESS = 1.5
_BRIGHTER = 1.5
_WIDEST_SHARE = 1 / 12
_FAINTEST_FLUX = 0.01
_LEAST_LIGHTS = 0.4
_FARTHEST = 2.5
# Drawn layouts have at most one cluster more than spheres; noise has thousands.
_MOST_CLUSTERS = 32


@dataclass(frozen=True, eq=False)
class ReducedStack:
    """The images at a lower resolution.

    Parameters
    ----------
    factor
        Size of the blocks of pixels.
    mean, peak
        ``(N, h, w)`` mean and maximum of each block; saturated samples have the largest value.
    """

    factor: int
    mean: Float32
    peak: Float32

    @cached_property
    def spots(self) -> Float64:
        """Rows (light, x, y, flux) of compact bright spots, in reduced pixels."""
        return _spots(self)

    def full_px(self, pixels: Float64) -> Float64:
        """Return the pixels in the images of positions in the reduced images."""
        return (pixels + 0.5) * self.factor - 0.5


@dataclass(frozen=True, eq=False)
class SpotCluster:
    """Bright spots of different lights at one place.

    Parameters
    ----------
    centre_px
        ``(2,)`` median position.
    reach_px
        Distance from the centre that contains nine tenths of the spots.
    spots_px
        ``(M, 2)`` positions, one for each light that has one.
    """

    centre_px: Float64
    reach_px: float
    spots_px: Float64


def reduce_stack(values: Images) -> ReducedStack:
    """Return the images at a lower resolution, of about 900 px."""
    count, height, width = values.shape
    factor = max(min(-(-max(height, width) // _SIZE_PX), height, width), 1)
    rows, columns = height // factor, width // factor
    mean = np.zeros((count, rows, columns), np.float32)
    peak = np.zeros_like(mean)
    for k in range(count):
        if factor == 1:
            mean[k] = peak[k] = without_nan(values[k])
            continue
        for top in range(0, rows, _BAND_ROWS):
            band = slice(top, min(top + _BAND_ROWS, rows))
            image = values[k, band.start * factor : band.stop * factor]
            size = columns, len(image) // factor
            mean[k, band] = reduced_image(image, size, factor)
            # First down: whole rows are contiguous. Blocks with NaN become NaN.
            down = image[: size[1] * factor].reshape(size[1], -1, width).max(axis=1)
            whole = down[:, : columns * factor]
            peak[k, band] = reduce(np.maximum, (whole[:, i::factor] for i in range(factor)))
        y, x = np.nonzero(~np.isfinite(peak[k]))
        if len(y):
            # Only these blocks are copied.
            across = np.arange(factor)
            rows_of = np.minimum(y[:, None] * factor + across, height - 1)[:, :, None]
            columns_of = np.minimum(x[:, None] * factor + across, width - 1)[:, None, :]
            blocks = values[k, rows_of, columns_of]
            others = np.max(peak[k], initial=1.0, where=np.isfinite(peak[k]))
            filled = without_nan(blocks, float(others))
            mean[k, y, x], peak[k, y, x] = filled.mean(axis=(1, 2)), filled.max(axis=(1, 2))
    return ReducedStack(factor, mean, peak)


def reduced_image(image: Float32, size: tuple[int, int], factor: int) -> Float32:
    """Return an image of ``size`` (columns, rows) that averages ``factor x factor`` pixels."""
    whole = image[: size[1] * factor, : size[0] * factor]
    return cv2.resize(whole, size, interpolation=cv2.INTER_AREA).astype(np.float32, copy=False)


def without_nan(image: Float32, least: float = 1.0) -> Float32:
    """Return an image whose saturated samples have its largest value, or ``least`` if larger."""
    if np.isfinite(np.max(image)):  # NaN spreads: one pass shows whether there is any
        return image
    saturated = ~np.isfinite(image)
    filled = np.where(saturated, np.float32(least), image)
    filled[saturated] = filled.max()
    return filled


def spot_clusters(stack: ReducedStack) -> list[SpotCluster]:
    """Find places with one compact bright spot under each of many lights, the brightest first.

    A spot is much brighter than the place is under most other lights, which excludes print, and
    than any matte surface. Each spot starts a cluster of the nearest spots under all other lights.
    A cluster has spots under at least two fifths of the lights. At most 32 clusters are returned:
    images in which more places look like highlights contain noise, and no lights.
    """
    spots = stack.spots
    if not len(spots):
        return []
    groups = [np.flatnonzero(spots[:, 0] == k) for k in np.unique(spots[:, 0])]
    least = max(_LEAST_LIGHTS * len(stack.peak), 1)
    clusters: list[SpotCluster] = []
    for first in np.argsort(-spots[:, 3]):
        start = spots[first, 1:3]
        if any(_apart(start, c.centre_px) < max(1.3 * c.reach_px, 2.0) for c in clusters):
            continue
        centre, near = _nearest_of_each(spots[:, 1:3], groups, start)
        reach = float(np.percentile(np.linalg.norm(spots[near, 1:3] - centre, axis=1), 90))
        if len(near) < least:
            continue
        if any(_apart(centre, c.centre_px) < 0.7 * max(c.reach_px, reach, 2) for c in clusters):
            continue
        clusters.append(SpotCluster(centre, reach, spots[near, 1:3]))
        if len(clusters) == _MOST_CLUSTERS:
            break
    return [
        SpotCluster(
            stack.full_px(c.centre_px), max(c.reach_px, 1) * stack.factor, stack.full_px(c.spots_px)
        )
        for c in clusters
    ]


def _spots(stack: ReducedStack) -> Float64:
    """Return rows (light, x, y, flux) of compact bright spots."""
    peak = stack.peak
    several = len(peak) > 2
    base = np.median(stack.mean, axis=0)
    level = 0.0
    if several:
        white = max(1.0, float(np.percentile(peak, 99.9)))
        level = min(_BRIGHTER * float(np.percentile(base, 99.5)), 0.9 * white)
    size = max(round(_WIDEST_SHARE * min(base.shape)) | 1, 3)
    kernel = np.ones((size, size), np.uint8)
    spots = []
    for k, image in enumerate(peak):
        compact = image - cv2.morphologyEx(image, cv2.MORPH_OPEN, kernel)
        excess = image - (base if several else image - compact)
        bright = (excess > _EXCESS * (image - excess) + 1e-6) & (compact > 0.5 * image)
        bright &= image > level
        count, regions = cv2.connectedComponents(bright.astype(np.uint8))
        if count < 2:
            continue
        y, x = np.nonzero(bright)
        region, weight = regions[y, x], excess[y, x].astype(np.float64)
        flux = np.bincount(region, weight, count)[1:]
        rows = [np.bincount(region, weight * at, count)[1:] / flux for at in (x, y)]
        kept = flux > _FAINTEST_FLUX * flux.max()
        spots.append(np.column_stack([np.full(len(flux), k), *rows, flux])[kept])
    return np.concatenate(spots) if spots else np.zeros((0, 4))


def _nearest_of_each(places: Float64, groups: list[Intp], start: Float64) -> tuple[Float64, Intp]:
    """Return the centre of the nearest spots of all lights, and those that are not far from it."""
    centre = start
    for _ in range(8):
        near = np.array([g[np.argmin(np.sum((places[g] - centre) ** 2, axis=1))] for g in groups])
        distance = np.linalg.norm(places[near] - centre, axis=1)
        near = near[distance <= max(_FARTHEST * float(np.median(distance)), 2.0)]
        moved = np.median(places[near], axis=0)
        if np.allclose(moved, centre):
            break
        centre = moved
    return centre, near


def _apart(a: Float64, b: Float64) -> float:
    return float(np.hypot(a[0] - b[0], a[1] - b[1]))
