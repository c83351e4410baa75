"""Compact bright blobs on a sphere in one image: the highlight of a light, and its rivals."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from calibration.spheres.highlights import spot
from rig.arrays import Bool, Float32, Float64, Intp

_BLOB_LEVEL = 0.3
_CORE_LEVEL = 0.85
_SMOOTH_PX = 0.7
_LARGEST_BLOB = 0.35
# A blob with a smaller share of the flux of the brightest one is a reflection or a part of a ray.
_RIVAL_FLUX = 0.1
MOST_BLOBS = 3
_FEWEST = 5
# Of the logarithm of the areas: their usual scatter at least, and how many times it is unusual.
_SCATTER, _UNUSUAL = 0.03, 3.0
# The size is known if half of the lights have a spot that differs by less than this.
_ALIKE, _HALF = 0.09, 0.5
# On 49 drawn balls, 11 of 28 spots that differ by more than this were reflections elsewhere. On
# 100 balls (300 to 399), 18 of 50 were; 3 of the 50 are round, and none of these is elsewhere.
_ELSEWHERE = 0.3
_OTHER_LAMP = 1.0
# Standard deviation of each coordinate for these, in radii of the sphere: the highlight is
# anywhere within 0.85 of the radius, as the reflection is, with a probability of 0.4.
_ELSEWHERE_RADII = 0.38
# If no size is usual, the logarithms of the areas scatter by more than this, and the contours by
# more than this share of their radii, most spots are reflections. The medians of six such drawn
# balls are 0.6 to 1.3 and 0.14 to 0.3; of 95 % of the highlights on others, contours scatter by
# 0.04.
_SCATTERED, _NOT_ROUND = 0.5, 0.05


@dataclass(frozen=True, eq=False)
class Blob:
    """Pixels, flux and height of a bright blob, and level and noise of the image around it.

    ``rival`` is the largest flux of another blob, compact or not.
    """

    region: Bool
    flux: float
    height: float
    level: float
    noise: float
    saturated: bool
    rival: float

    def locate(self, image: Float32, clipped: Bool) -> spot.Spot:
        """Return its centre in the image in which it was found."""
        above = image - np.float32(self.level)
        if self.saturated:
            white = float(above[clipped & self.region].min())
            return spot.saturated_spot(above, self.region, white)
        return spot.unsaturated_spot(above, self.region, self.noise)


def bright_blobs(
    image: Float32, saturated: Bool, within: Bool, sample: Intp, radius_px: float
) -> list[Blob]:
    """Return the compact bright blobs of an image, the one with the largest flux first.

    Parameters
    ----------
    image
        ``(H, W)`` around the sphere, at least white where saturated.
    saturated
        ``(H, W)`` saturated pixels on the sphere.
    within
        ``(H, W)`` pixels on which highlights are searched for.
    sample
        Some indices of ``within``, for the level of the image and its noise.
    radius_px
        Radius of the sphere.

    Returns
    -------
    list of Blob
        At most 3; empty if nothing exceeds the noise, or if the brightest blob is not compact. The
        others are compact and have more than a tenth of its flux.
    """
    smooth = np.where(within, cv2.GaussianBlur(image, (0, 0), _SMOOTH_PX), np.float32(0))
    peak = float(smooth.max())
    typical = smooth.ravel()[sample]
    level = float(np.median(typical))
    noise = 1.4826 * float(np.median(np.abs(typical - level)))
    clipped = np.flatnonzero(saturated)
    # Saturated pixels are not noise, and their glare may cover half of the sphere.
    if not peak - level > max((2 if len(clipped) else 12) * noise, 1e-6):
        return []
    for share in (_BLOB_LEVEL, _CORE_LEVEL):
        bright = (smooth > level + share * (peak - level)).astype(np.uint8)
        count, regions = cv2.connectedComponents(bright)
        where = np.flatnonzero(bright)
        flux = np.bincount(regions.ravel()[where], image.ravel()[where] - level, count)
        # Around a saturated core, rays and glare are not part of it.
        if int(np.argmax(flux)) not in regions.ravel()[clipped]:
            break
    # Smoothing divides the noise of a pixel by the root of the area of its kernel, 4 pi sigma^2.
    noise *= float(np.sqrt(4 * np.pi)) * _SMOOTH_PX
    blobs: list[Blob] = []
    order = np.argsort(-flux)[:MOST_BLOBS]
    for index in order:
        if not flux[index] > (_RIVAL_FLUX * blobs[0].flux if blobs else 0):
            break
        region = regions == index
        core = bool(region.ravel()[clipped].any())
        if _width_px(region, core=core) <= max(_LARGEST_BLOB * radius_px, 3):
            rival = float(flux[order[0 if blobs else 1]])
            height = float(smooth[region].max()) - level
            blobs.append(Blob(region, float(flux[index]), height, level, noise, core, rival))
        elif not blobs:
            break
    return blobs


def _width_px(region: Bool, *, core: bool) -> float:
    """Return the width of the largest disc in a core, or of the disc with the area of a region."""
    if core:
        return 2 * spot.largest_disc(region)[1]
    return 2 * float(np.sqrt(np.count_nonzero(region) / np.pi))


@dataclass(frozen=True)
class UsualSize:
    """Area that most highlights on a sphere have.

    The image of a lamp in a mirror ball has the same area wherever it is: toward the rim it becomes
    narrower by as much as it becomes longer. Therefore, a highlight that is larger than the others
    contains a reflection, and a smaller one is a part of a highlight, or a reflection.

    Parameters
    ----------
    log_area
        Natural logarithm of the area in px^2, divided by pi.
    tolerance
        Largest difference of a usual one.
    known
        Whether at least half of the lights have a spot of this size. Otherwise, it is the median
        of the brightest spots, and tolerance is their scatter.
    reflections
        Whether no size is usual, and most spots are not round, either.
    """

    log_area: float
    tolerance: float
    known: bool
    reflections: bool

    def matches(self, radii_px: Float64) -> Bool:
        """Return which spots have this size; False for NaN."""
        return np.abs(self._away(radii_px)) <= self.tolerance

    def part_px(self, radii_px: Float64) -> Float64:
        """Return by how much spots may be off because a part is missing or too much, in px.

        If that is on one side, the centre is off by about its share of the area times the radius.
        The result is the standard deviation of each coordinate; 0 if the size is usual, or NaN.
        """
        away = np.abs(self._away(radii_px))
        mean_px = (radii_px + np.exp(self.log_area / 2)) / 2
        return np.where(away > self.tolerance, (1 - np.exp(-away)) * mean_px / np.sqrt(2), 0.0)

    def elsewhere_px(self, radii_px: Float64, sigma_px: Float64, sphere_px: float) -> Float64:
        """Return by how much highlights may be off because spots are reflections, in px.

        It is 0 for a spot of nearly the usual size; a highlight that is not saturated (NaN) has
        another size. It is 0 for a round spot up to 2.7 times larger or smaller, too: lamps that
        are not equally bright saturate discs of different areas. If no size is usual, it is 0
        except for spots that are not round among reflections.
        """
        doubtful = _not_round(radii_px, sigma_px)
        if self.known:
            away = np.abs(self._away(radii_px))
            usual = away <= max(self.tolerance, _ELSEWHERE)
            doubtful = ~usual & (doubtful | (away > _OTHER_LAMP))
        else:
            doubtful &= self.reflections
        return np.where(doubtful, _ELSEWHERE_RADII * sphere_px, 0.0)

    def _away(self, radii_px: Float64) -> Float64:
        return 2 * np.log(radii_px) - self.log_area


def usual_size(radii_px: Float64, sigma_px: Float64) -> UsualSize | None:
    """Return the usual size of highlights; None if fewer than five are known, or most are tiny.

    Parameters
    ----------
    radii_px
        ``(N, M)`` radii of discs with the areas of at most M bright spots under each of N lights,
        the brightest one first; NaN without one, or if it is not saturated.
    sigma_px
        ``(N, M)`` standard deviations of their centres, by the scatter of their contours.
    """
    logs = 2 * np.log(radii_px)
    seen = np.isfinite(logs).any(axis=1)
    # The pixels alone make smaller cores uneven.
    least_px = (spot.PIXELS_PX2[0] / _NOT_ROUND) ** 0.5
    if np.count_nonzero(seen) < _FEWEST or np.nanmedian(radii_px) < least_px:
        return None
    every = logs[np.isfinite(logs)]
    differ = np.abs(every[:, None, None] - logs)
    votes = np.any(differ <= _ALIKE, axis=2).sum(axis=1)
    most = int(np.argmax(votes))
    known = bool(votes[most] >= max(_FEWEST, _HALF * np.count_nonzero(seen)))
    some = logs[differ[most] <= _ALIKE] if known else logs[np.isfinite(logs[:, 0]), 0]
    if len(some) < _FEWEST:
        return None
    middle = float(np.median(some))
    # Of each light, the spot that is nearest to the usual size.
    away = np.abs(logs - middle)
    nearest = np.nanmin(away[seen], axis=1) if known else away[np.isfinite(logs[:, 0]), 0]
    scatter = 1.4826 * float(np.median(nearest))
    odd = _not_round(radii_px[seen, 0], sigma_px[seen, 0])
    reflections = not known and scatter > _SCATTERED and float(np.mean(odd)) > _HALF
    return UsualSize(middle, _UNUSUAL * (_SCATTER + scatter), known, reflections)


def _not_round(radii_px: Float64, sigma_px: Float64) -> Bool:
    return ~(sigma_px <= _NOT_ROUND * radii_px)
