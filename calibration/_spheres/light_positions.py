"""Positions of near lights from their highlights on spheres of known size."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from acquisition import CameraModel
from calibration._errors import EstimateError
from calibration._spheres.joint_refinement import (
    KnownSpheres,
    Refined,
    predicted_highlights,
    refine,
    slopes_at,
)
from calibration._spheres.photon_noise import with_photon_noise
from calibration._spheres.ray_positions import observed_rays, pair_positions
from calibration._spheres.robust import Array
from rig import short_repr

_INLIER_PX = 1.5
_INLIER_RATIO = 5.0
_INLIER_SIGMAS = 4.0


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
    used: npt.NDArray[np.bool_]
    residuals_px: Array
    sigma_px: Array

    __repr__ = short_repr


def locate_lights(
    camera: CameraModel,
    spheres: KnownSpheres,
    highlights_px: Array,
    sigma_px: Array,
    ids: tuple[str, ...],
    *,
    peaks: bool = False,
    photon_px2: Array | None = None,
) -> LocatedLights:
    """Estimate the positions of lights with highlights on two or more spheres.

    Every pair of reflected rays gives a candidate position for a light. The candidate whose
    predicted highlights have the least median error decides which spheres agree, so one false
    highlight among three or more is harmless: a highlight agrees if its error is at most 1.5 px,
    five times the median error, or four standard deviations. All positions are then refined
    together with the sphere centres by `refine`.

    Parameters
    ----------
    camera
        Camera with a working distance.
    spheres
        K spheres.
    highlights_px
        ``(N, K, 2)``; NaN if a light has no highlight on a sphere.
    sigma_px
        ``(N, K)`` standard deviations of each coordinate of the highlights.
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
    points, directions = observed_rays(camera, spheres, highlights_px)
    seen = np.isfinite(directions[..., 0])
    few = [name for name, count in zip(ids, seen.sum(axis=1), strict=True) if count < 2]
    if few:
        raise EstimateError(
            f"{_names(few)}: highlights on fewer than 2 of {seen.shape[1]} spheres; positions "
            "require two: leave out the radius to get directions"
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
        used[i, at] = errors[best] <= np.maximum(limit, _INLIER_SIGMAS * sigma_px[i, at])
    sigma_px = np.where(used, sigma_px, np.inf)
    refined = refine(camera, spheres, positions, highlights_px, sigma_px, ids, peaks=peaks)
    if peaks and photon_px2 is not None:
        positions, centres = refined.positions_mm, refined.centres_mm
        slopes = slopes_at(camera, spheres, positions, centres, highlights_px, used)
        weighed_px = with_photon_noise(slopes, sigma_px, photon_px2)
        if weighed_px is not sigma_px:
            sigma_px = weighed_px
            refined = refine(camera, spheres, positions, highlights_px, sigma_px, ids, peaks=peaks)
    predicted = predicted_highlights(
        camera, refined.centres_mm, spheres.radii_mm, refined.positions_mm
    )
    square = np.where(used, np.sum((predicted - highlights_px) ** 2, axis=-1), 0.0)
    residuals_px = np.sqrt(square.sum(axis=1) / used.sum(axis=1))
    return LocatedLights(refined, used, residuals_px, sigma_px)


def _names(ids: list[str]) -> str:
    shown = ", ".join(ids[:4]) + (f" and {len(ids) - 4} more" if len(ids) > 4 else "")
    return f"light {shown}" if len(ids) == 1 else f"lights {shown}"
