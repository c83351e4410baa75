"""Photon noise of highlights, as strong as the disagreement between spheres shows."""

from __future__ import annotations

import numpy as np

from calibration._spheres.joint_refinement import EXPECTED, Slopes, degrees_of_freedom
from calibration._spheres.robust import Array
from calibration._spheres.spot import PEAK_SIGMA_PX

# What remains of the standard deviation of a peak with many photons.
_FLOOR_PX = 0.003
# The gain is searched for around the one that explains the stated deviation. Of a visible peak,
# photons do not explain errors ten times as large: outlines or given values are wrong.
_LEAST_GAIN, _LARGEST_GAIN, _HALVINGS = -12.0, 2 * np.log(10), 30


def with_photon_noise(slopes: Slopes, sigma_px: Array, photon_px2: Array) -> Array:
    """Return standard deviations of unsaturated highlights that fall with their photons.

    A small or dark sphere reflects fewer photons, and its highlights are less certain. How bright a
    photon is, the images do not say: stated standard deviations suppose 0.01 px for all. So the
    gain is the one with which the residuals are as large as expected; a few more residuals,
    as large as stated, keep it from vanishing if there are few. The result is this law, or that all
    stated deviations are wrong by one factor, whichever the residuals make more likely.

    Parameters
    ----------
    slopes
        Errors of the highlights at the solution with the stated deviations.
    sigma_px
        ``(N, K)`` stated deviations; infinite for highlights that do not count.
    photon_px2
        ``(N, K)`` variances of a coordinate, if a photon had the brightness 1.
    """
    use = np.isfinite(sigma_px)
    freedom = degrees_of_freedom(sigma_px)
    photons = photon_px2[use]
    if freedom <= 0 or not np.all(photons > 0):
        return sigma_px
    stated = sigma_px[use] ** 2
    others = np.maximum(stated - PEAK_SIGMA_PX**2, 0.0) + _FLOOR_PX**2
    usual = PEAK_SIGMA_PX**2 / float(np.median(photons))

    def law(power: float) -> Array:
        sigma = sigma_px.copy()
        sigma[use] = np.sqrt(others + usual * np.exp(power) * photons)
        return sigma

    def surplus(sigma: Array) -> float:
        as_stated = EXPECTED * float(np.mean(stated / sigma[use] ** 2))
        square = slopes.weighted(sigma).square_at_minimum()
        return square + as_stated - freedom - EXPECTED

    low, high = _LEAST_GAIN, _LARGEST_GAIN
    if surplus(law(low)) < 0 or surplus(law(high)) > 0:
        return sigma_px
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        low, high = (middle, high) if surplus(law(middle)) > 0 else (low, middle)
    by_law = law(high)
    square = slopes.weighted(sigma_px).square_at_minimum()
    by_factor = sigma_px * np.sqrt((square + EXPECTED) / (freedom + EXPECTED))
    return by_law if _unlikely(slopes, by_law) < _unlikely(slopes, by_factor) else sigma_px


def _unlikely(slopes: Slopes, sigma_px: Array) -> float:
    """Return minus twice the logarithm of the restricted likelihood (Patterson, Thompson 1971)."""
    system = slopes.weighted(sigma_px)
    variances = 4 * float(np.sum(np.log(sigma_px[np.isfinite(sigma_px)])))
    return variances + system.log_determinant() + system.square_at_minimum()
