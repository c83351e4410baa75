"""Positions of near lights from their highlights on spheres of known size."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from acquisition import CameraModel
from calibration._errors import EstimateError
from calibration.spheres.geometry.reflection import reflected_rays
from calibration.spheres.highlights.spot import PEAK_SIGMA_PX
from calibration.spheres.solve.joint_refinement import (
    EXPECTED,
    KnownSpheres,
    Observation,
    Refined,
    Slopes,
    degrees_of_freedom,
    predicted_highlights,
    refine,
    slopes_at,
)
from calibration.spheres.solve.lost_images import named
from rig import short_repr
from rig.arrays import Bool, Float64

_INLIER_PX = 1.5
_INLIER_RATIO = 5.0
_INLIER_SIGMAS = 4.0
# What remains of the standard deviation of a peak with many photons.
_FLOOR_PX = 0.003
# The gain is searched for around the one that explains the stated deviation. Of a visible peak,
# photons do not explain errors ten times as large: outlines or given values are wrong.
_LEAST_GAIN, _LARGEST_GAIN, _HALVINGS = -12.0, 2 * np.log(10), 30


@dataclass(frozen=True, eq=False)
class LocatedLights:
    """Positions of N lights from highlights on K spheres.

    Parameters
    ----------
    refined
        Positions, sphere centres and covariances.
    used
        ``(N, K)`` highlights that agree with the position of their light.
    residuals_px
        ``(N,)`` rms distance between the used highlights and those predicted.
    sigma_px
        ``(N, K)`` standard deviations with which the highlights count; infinite for those that do
        not.
    """

    refined: Refined
    used: Bool
    residuals_px: Float64
    sigma_px: Float64

    __repr__ = short_repr


def locate_lights(
    given: Observation,
    ids: tuple[str, ...],
    *,
    peaks: bool = False,
    photon_px2: Float64 | None = None,
) -> LocatedLights:
    """Estimate the positions of lights with highlights on two or more spheres.

    Every pair of reflected rays gives a candidate position for a light. The candidate whose
    predicted highlights have the least median error decides which spheres agree, so one false
    highlight among three or more is harmless: a highlight agrees if its error is at most 1.5 px,
    five times the median error, or four standard deviations. All positions are then refined
    together with the sphere centres by `refine`.

    Parameters
    ----------
    given
        Highlights and spheres.
    ids
        N names of the lights, for messages.
    peaks
        Whether the highlights are unsaturated peaks, as in `refine`.
    photon_px2
        ``(N, K)`` variances of their coordinates by photon noise, if a photon had the brightness 1:
        peaks count as `with_photon_noise` says. Default: as stated.

    Raises
    ------
    EstimateError
        If a light has highlights on fewer than two spheres, its rays do not meet in front of them,
        or the standard deviation of its position exceeds a quarter of its distance.
    """
    camera, spheres, highlights_px = given.camera, given.spheres, given.highlights_px
    points, directions = observed_rays(camera, spheres, highlights_px)
    seen = np.isfinite(directions[..., 0])
    few = [name for name, count in zip(ids, seen.sum(axis=1), strict=True) if count < 2]
    if few:
        raise EstimateError(
            f"{named(few, range(len(few)))}: highlights on fewer than 2 of {seen.shape[1]} "
            "spheres; positions require two: leave out the radius to get directions"
        )
    positions = np.zeros((len(ids), 3))
    used = np.zeros_like(seen)
    for i, name in enumerate(ids):
        at = np.flatnonzero(seen[i])
        proposals = pair_positions(points[i, at], directions[i, at])
        if len(proposals) == 0:
            raise EstimateError(
                f"the reflected rays of light {name} do not meet in front of the spheres: "
                "check the radius, the camera and the outlines, and cover other lamps"
            )
        predicted = predicted_highlights(
            camera, spheres.centres_mm[at], spheres.radii_mm[at], proposals
        )
        errors = np.linalg.norm(predicted - highlights_px[i, at], axis=-1)
        best = int(np.argmin(np.median(errors, axis=1)))
        limit = max(_INLIER_PX, _INLIER_RATIO * float(np.median(errors[best])))
        positions[i] = proposals[best]
        used[i, at] = errors[best] <= np.maximum(limit, _INLIER_SIGMAS * given.sigma_px[i, at])
    given = replace(given, sigma_px=np.where(used, given.sigma_px, np.inf))
    refined = refine(given, positions, ids, peaks=peaks)
    if peaks and photon_px2 is not None:
        positions, centres = refined.positions_mm, refined.centres_mm
        slopes = slopes_at(given, positions, centres)
        weighed_px = with_photon_noise(slopes, given.sigma_px, photon_px2)
        if weighed_px is not given.sigma_px:
            given = replace(given, sigma_px=weighed_px)
            refined = refine(given, positions, ids, peaks=peaks)
    predicted = predicted_highlights(
        camera, refined.centres_mm, spheres.radii_mm, refined.positions_mm
    )
    square = np.where(used, np.sum((predicted - highlights_px) ** 2, axis=-1), 0.0)
    residuals_px = np.sqrt(square.sum(axis=1) / used.sum(axis=1))
    return LocatedLights(refined, used, residuals_px, given.sigma_px)


def with_photon_noise(slopes: Slopes, sigma_px: Float64, photon_px2: Float64) -> Float64:
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

    def law(power: float) -> Float64:
        sigma = sigma_px.copy()
        sigma[use] = np.sqrt(others + usual * np.exp(power) * photons)
        return sigma

    def surplus(sigma: Float64) -> float:
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


def _unlikely(slopes: Slopes, sigma_px: Float64) -> float:
    """Return minus twice the logarithm of the restricted likelihood (Patterson, Thompson 1971)."""
    system = slopes.weighted(sigma_px)
    variances = 4 * float(np.sum(np.log(sigma_px[np.isfinite(sigma_px)])))
    return variances + system.log_determinant() + system.square_at_minimum()


def observed_rays(
    camera: CameraModel, spheres: KnownSpheres, highlights_px: Float64
) -> tuple[Float64, Float64]:
    """Return the points of the highlights and the directions of the incident light.

    Parameters
    ----------
    camera
        Camera with a working distance.
    spheres
        K spheres.
    highlights_px
        ``(N, K, 2)``; NaN if a light has no highlight on a sphere.

    Returns
    -------
    points_mm
        ``(N, K, 3)`` on the spheres, house frame; NaN without a highlight.
    directions
        ``(N, K, 3)`` unit vectors toward the light.
    """
    eye = camera.centre_mm
    rays = camera.rays(highlights_px)
    points, directions = reflected_rays(rays, spheres.centres_mm - eye, spheres.radii_mm)
    return points + eye, directions


def pair_positions(points: Float64, directions: Float64) -> Float64:
    """Return the points closest to each pair of rays that are in front of both spheres."""
    proposals = []
    for a, b in combinations(range(len(points)), 2):
        cosine = directions[a] @ directions[b]
        parallel = 1 - cosine**2
        if parallel < 1e-9:
            continue
        gap = points[b] - points[a]
        s = (gap @ directions[a] - cosine * (gap @ directions[b])) / parallel
        t = (cosine * (gap @ directions[a]) - gap @ directions[b]) / parallel
        if s > 0 and t > 0:
            proposals.append(0.5 * (points[a] + s * directions[a] + points[b] + t * directions[b]))
    return np.array(proposals).reshape(-1, 3)
