"""The search for jumps on resampled evidence, and the median of its surfaces.

The search decides between nearly equal arrangements of pieces, so that little changes of its input
or its constants move whole pieces. The same search with random weights of the evidence (the
bootstrap) shows which decisions hold; the median over these searches (bagging: L. Breiman, Machine
Learning 24, 1996) is close to what most of them agree on.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import ndimage

from rig.arrays import Bool, Float32, Float64, Int32

# Edges in a square of this side in pixels have the same random weight, which has this standard
# deviation: edges along a rim are not independent.
_CELL = 8
_DEVIATION = 0.5
# The heights of the surfaces are aligned to their median so often.
_ALIGNMENTS = 3


def random_weights(shape: tuple[int, int], rng: np.random.Generator) -> Float32:
    """Return ``shape`` float32 positive random weights with a mean of 1, equal in squares."""
    rows, columns = shape
    form = _DEVIATION**-2
    small = rng.gamma(form, 1 / form, (rows // _CELL + 2, columns // _CELL + 2))
    row, column = rng.integers(0, _CELL, 2)
    large = small.astype(np.float32).repeat(_CELL, axis=0).repeat(_CELL, axis=1)
    return np.ascontiguousarray(large[row : row + rows, column : column + columns])


def median_surface(
    surfaces: Sequence[Float64], parts: Int32, known: Bool
) -> tuple[Float64, Float64]:
    """Return the median over surfaces, and their range.

    Each is first moved so that its parts are at the median height.

    Parameters
    ----------
    surfaces
        ``(H, W)`` each.
    parts
        ``(H, W)`` int32 number of the connected part of each pixel, -1 outside.
    known
        Whether the height of each part is known, so that it does not move.
    """
    found = np.array(surfaces)
    numbers = np.arange(len(known))
    inside = parts >= 0
    middle: Float64 = found[0]
    for _ in range(_ALIGNMENTS):
        for surface in found:
            moves = ndimage.median(middle - surface, parts, numbers)
            surface[inside] += np.where(known, 0, moves)[parts[inside]]
        middle = np.median(found, axis=0)
    return middle, np.ptp(found, axis=0)
