"""Irradiance of near LEDs on many points: the Lambertian kernel."""

from __future__ import annotations

import math

import numba
import numpy as np
import numpy.typing as npt

from simulator._scene import Scene

Array = npt.NDArray[np.float64]
Values = npt.NDArray[np.float32]

_BLOCK = 1024


def shade(scene: Scene, points_mm: Array, normals: Array, weight: Array, group: int = 1) -> Values:
    """Light points with every LED.

    The irradiance is ``I0 max(cos t, 0)^mu / r^2 max(n . l, 0)``, with r and l from the point to
    the LED, t the angle to the LED's axis and I0 its axial intensity (Queau et al., LED-based
    photometric stereo, 2018). Attached shadows follow from ``n . l``; spheres cast shadows with a
    hard edge; the object casts none.

    Parameters
    ----------
    scene
        Lights and spheres.
    points_mm, normals
        ``(n, 3)`` points and unit normals.
    weight
        ``(n,)`` albedo, or albedo times the reflectances on the way.
    group
        Neighbouring points that are averaged into one value.

    Returns
    -------
    Values
        ``(leds, n / group)`` radiance, 1 for a white surface under irradiance 1.
    """
    positions = np.asarray(scene.lights.positions_mm)
    leds = np.column_stack([positions, np.asarray(scene.lights.axes), np.asarray(scene.lights.mu)])
    out = np.zeros((len(positions), len(points_mm) // group), np.float32)
    _shade(
        points_mm.astype(np.float32),
        normals.astype(np.float32),
        weight.astype(np.float32),
        leds,
        scene.axial_intensity,
        scene.sphere_table,
        group,
        out,
    )
    return out


@numba.njit(cache=True)
def _blocked(
    px: float, py: float, pz: float, dx: float, dy: float, dz: float, r2: float, spheres: Array
) -> bool:
    """Return whether a sphere stands on the way from the point p to the LED at p + d."""
    for j in range(len(spheres)):
        ox, oy, oz = spheres[j, 0] - px, spheres[j, 1] - py, spheres[j, 2] - pz
        along = ox * dx + oy * dy + oz * dz
        gap = ox * ox + oy * oy + oz * oz - along * along / r2
        if 0.0 < along < r2 and gap < spheres[j, 3] ** 2:
            return True
    return False


@numba.njit(parallel=True, cache=True)
def _shade(
    points: Values,
    normals: Values,
    weight: Values,
    leds: Array,
    intensity: Array,
    spheres: Array,
    group: int,
    out: Values,
) -> None:
    count = out.shape[1]
    for block in numba.prange((count + _BLOCK - 1) // _BLOCK):
        start, stop = block * _BLOCK, min((block + 1) * _BLOCK, count)
        for k in range(len(leds)):
            lx, ly, lz = leds[k, 0], leds[k, 1], leds[k, 2]
            ax, ay, az = leds[k, 3], leds[k, 4], leds[k, 5]
            mu = leds[k, 6]
            for i in range(start, stop):
                total = 0.0
                for s in range(i * group, (i + 1) * group):
                    if weight[s] == 0.0:
                        continue
                    px, py, pz = points[s, 0], points[s, 1], points[s, 2]
                    dx, dy, dz = lx - px, ly - py, lz - pz
                    facing = dx * normals[s, 0] + dy * normals[s, 1] + dz * normals[s, 2]
                    ahead = -(dx * ax + dy * ay + dz * az)
                    if facing <= 0.0 or ahead <= 0.0:
                        continue
                    r2 = dx * dx + dy * dy + dz * dz
                    if len(spheres) and _blocked(px, py, pz, dx, dy, dz, r2, spheres):
                        continue
                    r = math.sqrt(r2)
                    total += weight[s] * intensity[k] * (ahead / r) ** mu * facing / (r2 * r)
                out[k, i] = total / group
