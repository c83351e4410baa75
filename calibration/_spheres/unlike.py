"""The usual size of the highlights on a sphere, and those that have another one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from calibration._spheres.robust import Array

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
# balls are .6 to 1.3 and .14 to .3; of 95 % of the highlights on others, contours scatter by .04.
_SCATTERED, _NOT_ROUND = 0.5, 0.05


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

    def matches(self, radii_px: Array) -> npt.NDArray[np.bool_]:
        """Return which spots have this size; False for NaN."""
        usual: npt.NDArray[np.bool_] = np.abs(self._away(radii_px)) <= self.tolerance
        return usual

    def part_px(self, radii_px: Array) -> Array:
        """Return by how much spots may be off because a part is missing or too much, in px.

        If that is on one side, the centre is off by about its share of the area times the radius.
        The result is the standard deviation of each coordinate; 0 if the size is usual, or NaN.
        """
        away = np.abs(self._away(radii_px))
        mean_px = (radii_px + np.exp(self.log_area / 2)) / 2
        return np.where(away > self.tolerance, (1 - np.exp(-away)) * mean_px / np.sqrt(2), 0.0)

    def elsewhere_px(self, radii_px: Array, sigma_px: Array, sphere_px: float) -> Array:
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

    def _away(self, radii_px: Array) -> Array:
        away: Array = 2 * np.log(radii_px) - self.log_area
        return away


def usual_size(radii_px: Array, sigma_px: Array) -> UsualSize | None:
    """Return the usual size of highlights, or None if fewer than five are known.

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
    if np.count_nonzero(seen) < _FEWEST:
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


def _not_round(radii_px: Array, sigma_px: Array) -> npt.NDArray[np.bool_]:
    odd: npt.NDArray[np.bool_] = ~(sigma_px <= _NOT_ROUND * radii_px)
    return odd
