"""Trace camera rays to the object or the board, directly or via the spheres."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np
import numpy.typing as npt

from acquisition import DataError
from simulator._scene.scene import Scene

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

_BOUNCES = 4


@dataclass(frozen=True, eq=False)
class Seen:
    """Points that n camera rays see.

    Parameters
    ----------
    points_mm, normals
        ``(n, 3)`` end point of each ray, and the unit normal there.
    on_object
        ``(n,)`` True if the point has the albedo of the object, not of the board.
    sphere
        ``(n,)`` first sphere that the ray hits, -1 if it hits none.
    lost
        ``(n,)`` True if the ray left the spheres upward, into the surroundings.
    weight
        ``(n,)`` product of the reflectances of the spheres that the ray hits, 1 without spheres.
    """

    points_mm: Array
    normals: Array
    on_object: Mask
    sphere: npt.NDArray[np.int64]
    lost: Mask
    weight: Array

    @property
    def direct(self) -> Mask:
        """``(n,)`` True if the ray hits no sphere."""
        return self.sphere < 0


def see(scene: Scene, origins_mm: Array, rays: Array) -> Seen:
    """Trace camera rays to their end points.

    Rays that a sphere mirrors ignore the height of the object: they end on the plane of the board,
    as if there were a flat picture of the object.

    Parameters
    ----------
    scene
        The scene.
    origins_mm, rays
        ``(n, 3)`` each, rays scaled to z = -1.

    Returns
    -------
    Seen
        End points, to 1e-9 mm.

    Raises
    ------
    DataError
        If the object cannot be traced or hides part of a sphere.
    """
    # End points on the board; those of rays that hit something else are replaced below.
    points = origins_mm + origins_mm[:, 2:] * rays
    points[:, 2] = 0.0
    normals = np.zeros(points.shape)
    normals[:, 2] = 1.0
    on_object = np.zeros(len(points), np.bool_)
    count = len(rays)
    sphere, entry_mm = np.full(count, -1, np.int64), np.full(count, -math.inf)
    lost, weight = np.zeros(count, np.bool_), np.ones(count)
    if scene.spheres:
        _follow(origins_mm, rays, scene.sphere_table, sphere, entry_mm, lost, points, weight)
    if scene.body is not None:
        hits = scene.body.trace(origins_mm, rays)
        before = hits.hit & (sphere >= 0) & (hits.points_mm[:, 2] > entry_mm)
        if before.any():
            raise DataError(
                f"the object hides part of sphere {sphere[np.argmax(before)]} from the camera: "
                "move the sphere outward"
            )
        on_object = np.where(sphere < 0, hits.hit, scene.body.inside(points[:, 0], points[:, 1]))
        met = hits.hit & (sphere < 0)
        points[met], normals[met] = hits.points_mm[met], hits.normals[met]
    return Seen(points, normals, on_object, sphere, lost, weight)


def meets_sphere(scene: Scene, origins_mm: Array, rays: Array) -> Mask:
    """Return which camera rays ``(n, 3)`` hit a sphere."""
    met = np.zeros(len(rays), np.bool_)
    for sphere in scene.spheres:
        offset = origins_mm - np.array(sphere.centre_mm)
        along = (offset * rays).sum(axis=1)
        squared = (rays**2).sum(axis=1)
        gap = (offset**2).sum(axis=1) - along**2 / squared
        met |= (gap < sphere.radius_mm**2) & (along < 0)
    return met


@numba.njit(parallel=True, cache=True)
def _follow(
    origins: Array,
    rays: Array,
    spheres: Array,
    first: npt.NDArray[np.int64],
    entry: Array,
    lost: Mask,
    points: Array,
    weight: Array,
) -> None:
    for i in numba.prange(len(rays)):
        px, py, pz = origins[i, 0], origins[i, 1], origins[i, 2]
        dx, dy, dz = rays[i, 0], rays[i, 1], rays[i, 2]
        norm = math.sqrt(dx * dx + dy * dy + dz * dz)
        dx, dy, dz = dx / norm, dy / norm, dz / norm
        share = 1.0
        for bounce in range(_BOUNCES + 1):
            best, hit = math.inf, -1
            for j in range(len(spheres)):
                ox, oy, oz = px - spheres[j, 0], py - spheres[j, 1], pz - spheres[j, 2]
                b = ox * dx + oy * dy + oz * dz
                root = b * b - (ox * ox + oy * oy + oz * oz - spheres[j, 3] ** 2)
                # b < 0: the sphere is ahead. This also keeps a ray from hitting the sphere
                # that it has just left.
                if root > 0.0 and b < 0.0 and -b - math.sqrt(root) < best:
                    best, hit = -b - math.sqrt(root), j
            if hit < 0 or bounce == _BOUNCES:
                break
            px, py, pz = px + best * dx, py + best * dy, pz + best * dz
            if bounce == 0:
                first[i], entry[i] = hit, pz
            share *= spheres[hit, 4]
            nx = (px - spheres[hit, 0]) / spheres[hit, 3]
            ny = (py - spheres[hit, 1]) / spheres[hit, 3]
            nz = (pz - spheres[hit, 2]) / spheres[hit, 3]
            turn = 2.0 * (dx * nx + dy * ny + dz * nz)
            dx, dy, dz = dx - turn * nx, dy - turn * ny, dz - turn * nz
        if first[i] >= 0:
            weight[i] = share
            if dz > -1e-9:
                lost[i] = True
            else:
                points[i, 0] = px - dx / dz * pz
                points[i, 1] = py - dy / dz * pz
