"""Positions of near lights from their highlights on spheres of known size."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import numpy.typing as npt

from acquisition import CameraModel
from calibration._errors import EstimateError
from calibration._spheres.reflection import mirror_points, reflected_rays
from calibration._spheres.robust import Array

_ROUNDS = 8
# Standard deviation of a highlight, and of the centre of a saturated highlight.
_HIGHLIGHT_SIGMA_PX = 0.05
_SATURATED_SIGMA_PX = 0.5
_INLIER_PX = 1.5
_INLIER_RATIO = 5.0
_WORST_SHARE = 0.25


@dataclass(frozen=True, eq=False)
class KnownSpheres:
    """K spheres in the house frame.

    Parameters
    ----------
    centres_mm
        ``(K, 3)``.
    radii_mm
        ``(K,)``.
    covariance_mm2
        ``(3 K, 3 K)`` covariance of the centres from the outlines.
    """

    centres_mm: Array
    radii_mm: Array
    covariance_mm2: Array


def observed_rays(
    camera: CameraModel, spheres: KnownSpheres, highlights_px: Array
) -> tuple[Array, Array]:
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


def predicted_highlights(
    camera: CameraModel, centres_mm: Array, radii_mm: Array, lights_mm: Array
) -> Array:
    """Return the pixels ``(N, K, 2)`` of the highlights of N lights on K spheres."""
    points = mirror_points(camera.centre_mm, lights_mm[:, None], centres_mm[None], radii_mm[None])
    return camera.project(points)


def locate_lights(
    camera: CameraModel,
    spheres: KnownSpheres,
    highlights_px: Array,
    saturated: npt.NDArray[np.bool_],
    ids: tuple[str, ...],
) -> tuple[Array, Array, npt.NDArray[np.bool_]]:
    """Estimate the positions of lights with highlights on two or more spheres.

    Every pair of reflected rays gives a candidate position for a light. The candidate whose
    predicted highlights have the least median error decides which spheres agree, so one false
    highlight among three or more is harmless: a highlight agrees if its error is at most 1.5 px, or
    five times the median error. All positions are then refined together with the sphere centres:
    the refinement minimises the sum of the squared highlight errors, relative to a standard
    deviation of 0.05 px, or 0.5 px if saturated, and of the squared deviations of the centres from
    those given by the outlines, relative to their covariance.

    Parameters
    ----------
    camera
        Camera with a working distance.
    spheres
        K spheres.
    highlights_px
        ``(N, K, 2)``; NaN if a light has no highlight on a sphere.
    saturated
        ``(N, K)`` highlights that are only known as the centre of a saturated blob.
    ids
        N names of the lights, for messages.

    Returns
    -------
    positions_mm
        ``(N, 3)`` positions of the lights, house frame.
    centres_mm
        ``(K, 3)`` refined centres of the spheres.
    used
        ``(N, K)`` highlights that agree with the position.

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
        proposals = _pair_positions(points[i, at], directions[i, at])
        if len(proposals) == 0:
            raise EstimateError(
                f"the reflected rays of light {name} do not meet in front of the spheres: "
                "check the radius, the camera and the outlines"
            )
        predicted = predicted_highlights(
            camera, spheres.centres_mm[at], spheres.radii_mm[at], proposals
        )
        errors = np.linalg.norm(predicted - highlights_px[i, at], axis=-1)
        best = int(np.argmin(np.median(errors, axis=1)))
        limit = max(_INLIER_PX, _INLIER_RATIO * float(np.median(errors[best])))
        positions[i] = proposals[best]
        used[i, at] = errors[best] <= limit
    sigma_px = np.where(saturated, _SATURATED_SIGMA_PX, _HIGHLIGHT_SIGMA_PX)
    weight = np.where(used, sigma_px**-2, 0.0)
    positions, centres = _refine(camera, spheres, positions, highlights_px, weight, ids)
    return positions, centres, used


def _pair_positions(points: Array, directions: Array) -> Array:
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


def _refine(
    camera: CameraModel,
    spheres: KnownSpheres,
    positions: Array,
    highlights_px: Array,
    weight: Array,
    ids: tuple[str, ...],
) -> tuple[Array, Array]:
    """Refine all lights and sphere centres by Gauss-Newton with a Schur complement."""
    n, k = weight.shape
    centres = spheres.centres_mm.copy()
    information = np.linalg.inv(spheres.covariance_mm2)
    weight = np.repeat(weight[..., None], 2, axis=-1)
    observed = np.where(weight > 0, highlights_px, 0.0)

    def residuals(lights: Array, at: Array) -> Array:
        predicted = predicted_highlights(camera, at, spheres.radii_mm, lights)
        return predicted - observed

    for _ in range(_ROUNDS):
        error = residuals(positions, centres)
        by_light, by_centre = _slopes(residuals, positions, centres)
        of_light = np.einsum("nkia,nki,nkib->nab", by_light, weight, by_light)
        cross = np.einsum("nkia,nki,nkib->nakb", by_light, weight, by_centre)
        of_centre = information.copy()
        blocks = np.einsum("nkia,nki,nkib->kab", by_centre, weight, by_centre)
        for j in range(k):
            of_centre[3 * j : 3 * j + 3, 3 * j : 3 * j + 3] += blocks[j]
        pull_light = np.einsum("nkia,nki->na", by_light, weight * error)
        pull_centre = np.einsum("nkia,nki->ka", by_centre, weight * error).ravel()
        pull_centre += information @ (centres - spheres.centres_mm).ravel()
        cross = cross.reshape(n, 3, 3 * k)
        _check_determined(of_light, positions, ids)
        inverse = np.linalg.inv(of_light)
        schur = of_centre - np.einsum("nap,nab,nbq->pq", cross, inverse, cross)
        right = pull_centre - np.einsum("nap,nab,nb->p", cross, inverse, pull_light)
        move_centre = -np.linalg.solve(schur, right)
        move_light = -np.einsum("nab,nb->na", inverse, pull_light + cross @ move_centre)
        # Limit the step to a fifth of the distance, where the linear model is valid.
        longest = 0.2 * np.linalg.norm(positions, axis=1)
        length = np.linalg.norm(move_light, axis=1)
        positions = (
            positions + move_light * np.minimum(1, longest / np.maximum(length, 1e-12))[:, None]
        )
        centres = centres + move_centre.reshape(k, 3)
    return positions, centres


def _slopes(
    residuals: Callable[[Array, Array], Array], positions: Array, centres: Array
) -> tuple[Array, Array]:
    """Return the numerical derivatives ``(N, K, 2, 3)`` by light and by sphere centre."""
    step = 1e-3
    by_light, by_centre = [], []
    for axis in np.eye(3) * step:
        by_light.append(residuals(positions + axis, centres) - residuals(positions - axis, centres))
        by_centre.append(
            residuals(positions, centres + axis) - residuals(positions, centres - axis)
        )
    scale = 1 / (2 * step)
    return np.stack(by_light, axis=-1) * scale, np.stack(by_centre, axis=-1) * scale


def _check_determined(of_light: Array, positions: Array, ids: tuple[str, ...]) -> None:
    """Raise `EstimateError` if the uncertainty of a position is large relative to its distance."""
    values = np.linalg.eigvalsh(of_light)
    deviation = 1 / np.sqrt(np.maximum(values[:, 0], 1e-30))
    share = deviation / np.linalg.norm(positions, axis=1)
    worst = int(np.argmax(share))
    if not share[worst] < _WORST_SHARE:
        raise EstimateError(
            f"the distance of light {ids[worst]} is not determined, because its reflected rays are "
            "nearly parallel: move the spheres apart, or leave out the radius to get directions"
        )


def _names(ids: list[str]) -> str:
    shown = ", ".join(ids[:4]) + (f" and {len(ids) - 4} more" if len(ids) > 4 else "")
    return f"light {shown}" if len(ids) == 1 else f"lights {shown}"
