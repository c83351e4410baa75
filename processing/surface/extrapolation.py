"""Steps along pixel edges from four normals in a row instead of two.

The error of a chord grows with the cube of its length. The chord over three edges therefore has 27
times the error of one of them, and the sum of their three chords 3 times: the difference is 24
times the error of the edge in the middle (Richardson's extrapolation). What is exact by the chord
rule, planes and spheres in any view, remains so.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from rig.arrays import Float32, Float64
from rig.kernels import PART

# Compiled in: rig/kernels/parts.py 986f6e8c38a7

# Larger errors, in pixels, are those of jumps and folds, which more normals do not explain.
_LARGEST_PX = 0.1


def extrapolate(
    normals: Float32,
    rays: Float64 | None,
    edges: tuple[Float32, Float32],
    steps: tuple[Float64, Float64],
    step_px: float,
) -> None:
    """Correct the steps of the chord rule where the edges before and after exist.

    Parameters
    ----------
    normals
        ``(H, W, 3)`` float32 unit vectors.
    rays
        ``(H, W, 3)`` float64 directions of the pixels from the camera; None for an orthographic
        view.
    edges
        ``(H+2, W+2)`` float32 weights of the edges to the right and down; 0 means no edge.
    steps
        ``(H+2, W+2)`` float64 steps along them; corrected in place.
    step_px
        Pixels for a step of 1.
    """
    seen = np.zeros((0, 0, 3)) if rays is None else rays
    for vertical in (0, 1):
        _extrapolate(
            normals, seen, edges[vertical], vertical, _LARGEST_PX / step_px, steps[vertical]
        )


@numba.njit(**PART)
def _chord(normals: Float32, rays: Float64, r: int, c: int, q: int, d: int) -> float:
    """Return the step between two pixels by the chord rule; NaN if it is seen from behind."""
    x = float(normals[r, c, 0]) + float(normals[q, d, 0])
    y = float(normals[r, c, 1]) + float(normals[q, d, 1])
    z = float(normals[r, c, 2]) + float(normals[q, d, 2])
    if len(rays) == 0:
        return ((q - r) * y - (d - c) * x) / z if z > 0 else math.nan
    near = -(x * rays[r, c, 0] + y * rays[r, c, 1] + z * rays[r, c, 2])
    far = -(x * rays[q, d, 0] + y * rays[q, d, 1] + z * rays[q, d, 2])
    return math.log(near / far) if min(near, far) > 0 else math.nan


@numba.njit(parallel=True, cache=True)
def _extrapolate(
    normals: Float32, rays: Float64, edges: Float32, vertical: int, largest: float, steps: Float64
) -> None:
    rows, columns = normals.shape[:2]
    down, right = vertical, 1 - vertical
    for r in numba.prange(rows):
        for c in range(columns):
            # Edges have a border of one pixel. The edges before and after:
            before = edges[r + 1 - down, c + 1 - right]
            after = edges[r + 1 + down, c + 1 + right]
            if min(before, edges[r + 1, c + 1], after) <= 0:
                continue
            a, b, e, f = r - down, c - right, r + 2 * down, c + 2 * right
            q, d, middle = r + down, c + right, steps[r + 1, c + 1]
            first, last = _chord(normals, rays, a, b, r, c), _chord(normals, rays, q, d, e, f)
            # Chords over two edges show on which side a jump is: they have 8 times the error.
            one = (_chord(normals, rays, a, b, q, d) - first - middle) / 6
            other = (_chord(normals, rays, r, c, e, f) - middle - last) / 6
            both = (_chord(normals, rays, a, b, e, f) - first - middle - last) / 24
            # Each is false for NaN.
            if abs(one) < largest and abs(other) < largest and abs(both) < largest:
                steps[r + 1, c + 1] -= both
