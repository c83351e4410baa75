"""Edges across which the normals turn more than next to them.

At the rim of a part that hides another, the normals on both sides usually differ. Where a surface
only bends, they turn as much a few pixels away.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from rig.arrays import Bool, Float32

# Distance, in pixels, of the edges with which the turn at an edge is compared.
_AWAY = 4
# Turns, in radian, that count in any case, and in units of their deviation in the whole map.
_SMALLEST_TURN = 0.1
_DEVIATIONS = 3.0
_LEAST = 0.01
# From the median of absolute values to a standard deviation.
_MEDIAN_TO_SIGMA = 1.4826


def evenness(
    normals: Float32, mask: Bool, edges: tuple[Float32, Float32]
) -> tuple[Float32, Float32]:
    """Return a weight 0.01..1 of each edge, which is small where the normals turn abruptly.

    Parameters
    ----------
    normals
        ``(H, W, 3)`` float32 unit vectors.
    mask
        ``(H, W)`` bool.
    edges
        ``(H+2, W+2)`` float32 weights of the edges to the right and down; 0 means no edge.

    Returns
    -------
    tuple of Float
        ``(H+2, W+2)`` float32 weights of the edges to the right and down.
    """
    both = [_contrast(_turns(normals, mask, axis), axis) for axis in (0, 1)]
    known = [contrast[edge > 0] for contrast, edge in zip(both, edges, strict=True)]
    usual = _MEDIAN_TO_SIGMA * float(np.median(np.abs(np.concatenate(known))))
    width = np.float32(max(_DEVIATIONS * usual, _SMALLEST_TURN))
    for contrast in both:
        np.maximum(contrast, 0, out=contrast)
        contrast /= width
        contrast *= contrast
        contrast += 1
        contrast **= -2
        np.maximum(contrast, np.float32(_LEAST), out=contrast)
    return both[0], both[1]


@numba.njit(cache=True)
def _turns(normals: Float32, mask: Bool, vertical: int) -> Float32:
    """Return the chord between the mean normals of 2 x 3 pixels on each side; NaN if unknown."""
    rows, columns = mask.shape
    out = np.full((rows + 2, columns + 2), np.float32(np.nan))
    for r in range(rows):
        one, other = np.zeros(3), np.zeros(3)
        for c in range(columns):
            one[:], other[:] = 0, 0
            for along in range(-1, 3):
                for across in range(-1, 2):
                    q = r + (along if vertical else across)
                    d = c + (across if vertical else along)
                    if 0 <= q < rows and 0 <= d < columns and mask[q, d]:
                        side = one if along <= 0 else other
                        for k in range(3):
                            side[k] += normals[q, d, k]
            length, length_other = math.sqrt((one**2).sum()), math.sqrt((other**2).sum())
            if min(length, length_other) > 0.5:
                chord = ((one / length - other / length_other) ** 2).sum()
                out[r + 1, c + 1] = math.sqrt(chord)
    return out


@numba.njit(cache=True)
def _contrast(turns: Float32, vertical: int) -> Float32:
    """Return each turn without the mean of those before and after it; 0 if none is known."""
    rows, columns = turns.shape
    out = np.zeros((rows, columns), np.float32)
    down, right = _AWAY * vertical, _AWAY * (1 - vertical)
    for r in range(rows):
        for c in range(columns):
            here = turns[r, c]
            total, count = 0.0, 0
            for sign in (-1, 1):
                q, d = r + sign * down, c + sign * right
                if 0 <= q < rows and 0 <= d < columns and not math.isnan(turns[q, d]):
                    total += turns[q, d]
                    count += 1
            if count and not math.isnan(here):
                out[r, c] = here - total / count
    return out
