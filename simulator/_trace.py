"""Where rays end: on the object, on the board, or by way of the spheres."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np
import numpy.typing as npt

from acquisition import DataError
from simulator._optics import centre
from simulator._scene import Scene
from simulator._surface import Surface

Array = npt.NDArray[np.float64]

_TOLERANCE_MM = 1e-10
_ITERATIONS = 30
_STEEPEST = 0.9
_BOUNCES = 4


@dataclass(frozen=True, eq=False)
class Hits:
    """Points on object and board: ``points_mm`` and unit ``normals`` (..., 3), ``on_object``."""

    points_mm: Array
    normals: Array
    on_object: npt.NDArray[np.bool_]


def trace_surface(scene: Scene, rays: Array) -> Hits:
    """Meet camera rays with object and board, spheres left out.

    Newton's method on ``z = surface(x, y)`` along each ray. A ray meets the surface once as long
    as the slope along it stays below 1 on the ray's own scale; a steeper surface is refused.

    Parameters
    ----------
    scene
        The scene.
    rays
        ``(..., 3)`` directions from the camera, scaled to z = -1.

    Returns
    -------
    Hits
        Points to 1e-9 mm.

    Raises
    ------
    DataError
        If the object is so steep that it may hide parts of itself from the camera.
    """
    height = centre(scene.camera)[2]
    across, up = rays[..., 0], rays[..., 1]
    z = np.zeros(rays.shape[:-1])
    normals = np.zeros(rays.shape)
    normals[..., 2] = 1.0
    on_object = np.zeros(z.shape, np.bool_)
    if scene.surface is not None:
        z, zx, zy = _newton(scene.surface, height, across, up)
        on_object = scene.surface.inside((height - z) * across, (height - z) * up)
        slope = np.hypot(zx, zy)
        tilt = np.max(np.hypot(across, up), initial=0.0)
        if tilt * np.max(slope, where=on_object, initial=0.0) > _STEEPEST:
            raise _hidden(scene.surface)
        z = np.where(on_object, z, 0.0)
        length = np.sqrt(1 + slope**2)
        for axis, part in enumerate((-zx, -zy, np.ones_like(z))):
            normals[..., axis] = np.where(on_object, part / length, normals[..., axis])
    points = np.stack([(height - z) * across, (height - z) * up, z], axis=-1)
    return Hits(points, normals, on_object)


def _newton(
    surface: Surface, height: float, across: Array, up: Array
) -> tuple[Array, Array, Array]:
    """Return height and gradient where rays meet the surface."""
    shape = across.shape
    across, up = across.ravel(), up.ravel()
    z, zx, zy = (np.zeros(across.size) for _ in range(3))
    todo = np.arange(across.size)
    for _ in range(_ITERATIONS):
        a, b = across[todo], up[todo]
        value, slope_x, slope_y = surface.evaluate((height - z[todo]) * a, (height - z[todo]) * b)
        miss = z[todo] - value
        zx[todo], zy[todo] = slope_x, slope_y
        steep = 1 + slope_x * a + slope_y * b
        if np.any(steep < 1 - _STEEPEST):
            raise _hidden(surface)
        z[todo] -= miss / steep
        todo = todo[np.abs(miss) > _TOLERANCE_MM]
        if not todo.size:
            return z.reshape(shape), zx.reshape(shape), zy.reshape(shape)
    raise _hidden(surface)


def _hidden(surface: Surface) -> DataError:
    return DataError(
        f"{type(surface).__name__} is too steep for this camera: it may hide parts of "
        f"itself; lower its relief or raise the working distance"
    )


@dataclass(frozen=True, eq=False)
class MirrorHits:
    """What rays see by way of the spheres.

    ``sphere`` (n,) is the first sphere met, -1 where none. A ray that met one ends at
    ``points_mm`` (n, 3) on the plane of the board, or is ``lost`` in the surroundings; ``weight``
    is the product of the reflectances, 1 where no sphere was met.
    """

    sphere: npt.NDArray[np.int64]
    lost: npt.NDArray[np.bool_]
    points_mm: Array
    weight: Array


def trace_spheres(scene: Scene, rays: Array) -> MirrorHits:
    """Follow camera rays ``(n, 3)`` from sphere to sphere until they leave them.

    The object is no obstacle to mirrored rays: they end on the plane of the board, as they would
    on a picture of the object laid there.
    """
    count = len(rays)
    sphere = np.full(count, -1, np.int64)
    lost, points, weight = np.zeros(count, np.bool_), np.zeros((count, 3)), np.ones(count)
    _follow(centre(scene.camera), rays, scene.sphere_table, sphere, lost, points, weight)
    return MirrorHits(sphere, lost, points, weight)


@numba.njit(parallel=True, cache=True)
def _follow(
    origin: Array,
    rays: Array,
    spheres: Array,
    first: npt.NDArray[np.int64],
    lost: npt.NDArray[np.bool_],
    points: Array,
    weight: Array,
) -> None:
    for i in numba.prange(len(rays)):
        px, py, pz = origin[0], origin[1], origin[2]
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
                # b < 0: the sphere lies ahead. It also keeps a ray from meeting the sphere
                # that it has just left.
                if root > 0.0 and b < 0.0 and -b - math.sqrt(root) < best:
                    best, hit = -b - math.sqrt(root), j
            if hit < 0 or bounce == _BOUNCES:
                break
            if bounce == 0:
                first[i] = hit
            share *= spheres[hit, 4]
            px, py, pz = px + best * dx, py + best * dy, pz + best * dz
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
