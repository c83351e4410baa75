"""Rays from lights to their highlights on spheres, and the positions at which they meet."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from acquisition import CameraModel
from calibration._spheres.joint_refinement import KnownSpheres
from calibration._spheres.reflection import reflected_rays
from calibration._spheres.robust import Array


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


def pair_positions(points: Array, directions: Array) -> Array:
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
