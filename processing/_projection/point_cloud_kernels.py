"""Compiled rendering of discs: every point is a small disc at right angles to its normal."""

from __future__ import annotations

import math

import numba
import numpy as np
import numpy.typing as npt

Float = npt.NDArray[np.float32]
Double = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int32]

# Smallest cosine between line of sight and normal that is used to intersect a disc: the
# intersection of a grazing ray would be far away.
_GRAZING = 0.1
# Tangent of the largest change of a normal within its disc.
_MOST_BENT = 0.5


@numba.njit(cache=True)
def _meet(
    dx: float, dy: float, ray_x: float, ray_y: float, nx: float, ny: float, nz: float
) -> tuple[float, float]:
    """Return how far below the disc's centre a line meets its plane, and the squared distance.

    ``dx`` and ``dy`` are the offset from the line to the centre at the centre's height.
    """
    # Normals point toward the viewer, the line points away.
    t = -(nx * dx + ny * dy) / max(nz - nx * ray_x - ny * ray_y, _GRAZING)
    x, y = t * ray_x - dx, t * ray_y - dy
    return t, x * x + y * y + t * t


@numba.njit(cache=True)
def _bent(
    bend: Double, x: float, y: float, z: float, nx: float, ny: float, nz: float
) -> tuple[float, float, float]:
    """Return the unit normal at an offset from a disc's centre."""
    bx = bend[0, 0] * x + bend[0, 1] * y + bend[0, 2] * z
    by = bend[1, 0] * x + bend[1, 1] * y + bend[1, 2] * z
    bz = bend[2, 0] * x + bend[2, 1] * y + bend[2, 2] * z
    scale = _MOST_BENT / max(math.sqrt(bx * bx + by * by + bz * bz), _MOST_BENT)
    mx, my, mz = nx + scale * bx, ny + scale * by, nz + scale * bz
    length = math.sqrt(mx * mx + my * my + mz * mz)
    return mx / length, my / length, mz / length


@numba.njit(nogil=True, cache=True, error_model="numpy")
def splat(
    first_band: int,
    last_band: int,
    points: Double,
    point_normals: Double,
    bends: Double,
    radii: Double,
    pixels: Double,
    reach_px: Double,
    members: Whole,
    begin: npt.NDArray[np.int64],
    band_rows: int,
    x: Double,
    y: Double,
    rays: Double,
    eye_z: float,
    normals: Float,
    height: Float,
) -> None:
    """Blend the discs of the nearest layer at each pixel into normals and heights.

    A layer consists of the discs within one disc radius behind the nearest disc. Weights decrease
    from the disc's centre to 0 at its rim. ``bends`` ``(N, 3, 3)`` times the offset from the centre
    is the change of the normal. Lines of sight are those of
    `processing._projection.rasterize_kernels.shade`.
    """
    rows, columns = height.shape
    bent = rays.shape[0] > 1
    for band in range(first_band, last_band):
        first = band * band_rows
        last = min(first + band_rows, rows) - 1
        nearest = np.full((band_rows, columns), -np.inf)
        total = np.zeros((band_rows, columns, 5))
        for blend in (False, True):
            for m in range(begin[band], begin[band + 1]):
                i = members[m]
                nx, ny, nz = point_normals[i, 0], point_normals[i, 1], point_normals[i, 2]
                below = eye_z - points[i, 2]
                reach2 = radii[i] ** 2
                top = max(math.ceil(pixels[i, 1] - reach_px[i]), first)
                bottom = min(math.floor(pixels[i, 1] + reach_px[i]), last)
                left = max(math.ceil(pixels[i, 0] - reach_px[i]), 0)
                right = min(math.floor(pixels[i, 0] + reach_px[i]), columns - 1)
                for r in range(top, bottom + 1):
                    for c in range(left, right + 1):
                        ray_x = rays[r, c, 0] if bent else rays[0, 0, 0]
                        ray_y = rays[r, c, 1] if bent else rays[0, 0, 1]
                        dx = points[i, 0] - x[c] - below * ray_x
                        dy = points[i, 1] - y[r] - below * ray_y
                        t, distance2 = _meet(dx, dy, ray_x, ray_y, nx, ny, nz)
                        if distance2 >= reach2:
                            continue
                        z = points[i, 2] - t
                        if not blend:
                            nearest[r - first, c] = max(nearest[r - first, c], z)
                        elif z >= nearest[r - first, c] - radii[i]:
                            w = (1 - distance2 / reach2) ** 3
                            mx, my, mz = _bent(
                                bends[i], t * ray_x - dx, t * ray_y - dy, -t, nx, ny, nz
                            )
                            total[r - first, c, 0] += w * mx
                            total[r - first, c, 1] += w * my
                            total[r - first, c, 2] += w * mz
                            total[r - first, c, 3] += w * z
                            total[r - first, c, 4] += w
        for r in range(first, last + 1):
            for c in range(columns):
                sum_x, sum_y, sum_z = total[r - first, c, :3]
                length = math.sqrt(sum_x * sum_x + sum_y * sum_y + sum_z * sum_z)
                if length > 0:
                    normals[r, c, 0] = sum_x / length
                    normals[r, c, 1] = sum_y / length
                    normals[r, c, 2] = sum_z / length
                    height[r, c] = total[r - first, c, 3] / total[r - first, c, 4]
