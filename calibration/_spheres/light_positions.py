"""Positions of near lights from their mirror images on spheres of known size."""

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
# How far to trust a highlight, and the middle of a saturated one.
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
        ``(3 K, 3 K)`` how well the outlines determine the centres.
    """

    centres_mm: Array
    radii_mm: Array
    covariance_mm2: Array


def observed_rays(
    camera: CameraModel, spheres: KnownSpheres, highlights_px: Array
) -> tuple[Array, Array]:
    """Return where the highlights lie and where the light comes from.

    Parameters
    ----------
    camera
        With a working distance.
    spheres
        K spheres.
    highlights_px
        ``(N, K, 2)``; NaN where a light was not seen.

    Returns
    -------
    points_mm
        ``(N, K, 3)`` on the spheres, house frame; NaN where not seen.
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
    """Return the pixels ``(N, K, 2)`` in which K spheres show N lights."""
    points = mirror_points(camera.centre_mm, lights_mm[:, None], centres_mm[None], radii_mm[None])
    return camera.project(points)


def locate_lights(
    camera: CameraModel,
    spheres: KnownSpheres,
    highlights_px: Array,
    saturated: npt.NDArray[np.bool_],
    ids: tuple[str, ...],
) -> tuple[Array, Array, npt.NDArray[np.bool_]]:
    """Find the positions of lights seen on two or more spheres.

    Every pair of reflected rays proposes a position for a light; the proposal whose predicted
    highlights have the least median error decides which spheres agree, so that one false highlight
    among three or more does no harm. Then all positions are refined together with the sphere
    centres, to the least sum of squared highlight errors in pixels and of deviations of the centres
    from what the outlines say.

    Parameters
    ----------
    camera
        With a working distance.
    spheres
        K spheres.
    highlights_px
        ``(N, K, 2)``; NaN where a light was not seen.
    saturated
        ``(N, K)`` highlights that are only known as the middle of a saturated blob.
    ids
        N names of the lights, for messages.

    Returns
    -------
    positions_mm
        ``(N, 3)`` of the lights, house frame.
    centres_mm
        ``(K, 3)`` of the spheres, as refined.
    used
        ``(N, K)`` highlights that agree with the position.

    Raises
    ------
    EstimateError
        If a light is seen on fewer than two spheres or its rays do not meet in front of them.
    """
    points, directions = observed_rays(camera, spheres, highlights_px)
    seen = np.isfinite(directions[..., 0])
    few = [name for name, count in zip(ids, seen.sum(axis=1), strict=True) if count < 2]
    if few:
        raise EstimateError(
            f"{_names(few)} seen on fewer than 2 of {seen.shape[1]} spheres: positions need two; "
            "leave the radius out to get directions"
        )
    positions = np.zeros((len(ids), 3))
    used = np.zeros_like(seen)
    for i, name in enumerate(ids):
        at = np.flatnonzero(seen[i])
        proposals = _pair_positions(points[i, at], directions[i, at])
        if len(proposals) == 0:
            raise EstimateError(
                f"the reflections of light {name} do not meet in front of the spheres: "
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
    """Return the points nearest to each pair of rays, if in front of both."""
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
    """Gauss-Newton on all lights and sphere centres; the lights are eliminated (Schur)."""
    n, k = weight.shape
    used = weight > 0
    centres = spheres.centres_mm.copy()
    information = np.linalg.inv(spheres.covariance_mm2)
    weight = np.repeat(weight[..., None], 2, axis=-1)
    observed = np.where(used[..., None], highlights_px, 0.0)

    def residuals(lights: Array, at: Array) -> Array:
        predicted = predicted_highlights(camera, at, spheres.radii_mm, lights)
        return np.where(used[..., None], predicted - observed, 0.0)

    of_light = np.zeros((n, 3, 3))
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
        # A step beyond a fifth of the distance would leave the range of the linear model.
        longest = 0.2 * np.linalg.norm(positions, axis=1)
        length = np.linalg.norm(move_light, axis=1)
        positions = (
            positions + move_light * np.minimum(1, longest / np.maximum(length, 1e-12))[:, None]
        )
        centres = centres + move_centre.reshape(k, 3)
        if float(length.max()) < 1e-9:
            break
    return positions, centres


def _slopes(
    residuals: Callable[[Array, Array], Array], positions: Array, centres: Array
) -> tuple[Array, Array]:
    """Return the derivatives ``(N, K, 2, 3)`` by light and by sphere centre, from differences."""
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
    """Refuse a position whose deviation is a good part of its distance."""
    values = np.linalg.eigvalsh(of_light)
    deviation = 1 / np.sqrt(np.maximum(values[:, 0], 1e-30))
    share = deviation / np.linalg.norm(positions, axis=1)
    worst = int(np.argmax(share))
    if not share[worst] < _WORST_SHARE:
        raise EstimateError(
            f"the distance of light {ids[worst]} is not determined: its reflections are nearly "
            "parallel; move the spheres apart, or leave the radius out to get directions"
        )


def _names(ids: list[str]) -> str:
    shown = ", ".join(ids[:4]) + (f" and {len(ids) - 4} more" if len(ids) > 4 else "")
    return f"light {shown}" if len(ids) == 1 else f"lights {shown}"
