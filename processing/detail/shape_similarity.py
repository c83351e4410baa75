"""Similarity of the rotations of neighbouring shape normals, for the paper's shape table."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np

from acquisition import DataError
from processing.maps.normal_map import NormalMap
from rig import in_threads
from rig.arrays import Bool, Float32, Float64
from rig.kernels import PART

# Compiled in: rig/kernels/parts.py 986f6e8c38a7

# Below this squared sine a normal counts as opposite to z: its rotation axis would be 0/0.
_OPPOSITE = 1e-30


@dataclass(frozen=True)
class RotationSimilarity:
    """The mean rotation between the shape normals of each pixel and its neighbours.

    Each value is averaged over the window of a pixel and then over the mask (eq.
    ``eq_similar_coe`` and ``eq_similar_norm`` of the paper). Neighbours outside the mask do not
    count.

    Parameters
    ----------
    angle_deg
        Angle of R(here) R(there)^-1.
    norm_1, norm_2, norm_inf
        Norms of R(here) R(there)^-1 - I: largest column sum, largest singular value and largest
        row sum.
    """

    angle_deg: float
    norm_1: float
    norm_2: float
    norm_inf: float


def rotation_similarity(shape: NormalMap, w: int = 5) -> RotationSimilarity:
    """Compare the rotations that take neighbouring shape normals to z.

    Parameters
    ----------
    shape
        A shape component.
    w
        Half width of the window of (2w+1) x (2w+1) pixels, 1 or more.

    Raises
    ------
    DataError
        If `w` is below 1.

    Examples
    --------
    >>> import numpy as np
    >>> from processing import NormalMap
    >>> from processing.detail import rotation_similarity
    >>> flat = NormalMap.from_vectors(np.tile([0.0, 0.0, 1.0], (16, 16, 1)))
    >>> rotation_similarity(flat).angle_deg
    0.0
    """
    if w < 1:
        raise DataError(f"the window's half width must be 1 or more, not {w}")
    sums = np.zeros((len(shape.mask), 4))
    in_threads(_similarity, len(sums), shape.normals, shape.mask, w, sums)
    mean = sums.sum(axis=0) / np.count_nonzero(shape.mask)
    return RotationSimilarity(math.degrees(mean[0]), *(float(value) for value in mean[1:]))


@numba.njit(**PART)
def _to_z(x: float, y: float, z: float, out: Float64) -> None:
    """Write the shortest rotation of a unit vector to z."""
    sine2 = x * x + y * y
    if z < 0 and sine2 < _OPPOSITE:
        out[:] = 0
        out[0, 0], out[1, 1], out[2, 2] = 1, -1, -1
        return
    k = 1 / (1 + z) if z >= 0 else (1 - z) / sine2
    out[0, 0], out[0, 1], out[0, 2] = 1 - k * x * x, -k * x * y, -x
    out[1, 0], out[1, 1], out[1, 2] = -k * x * y, 1 - k * y * y, -y
    out[2, 0], out[2, 1], out[2, 2] = x, y, z


@numba.njit(nogil=True, cache=True)
def _similarity(
    first: int,
    last: int,
    normals: Float32,
    mask: Bool,
    w: int,
    sums: Float64,
) -> None:
    """Write, for each row, the sums of the window means of angle, 1-, 2- and infinity-norm."""
    height, width = mask.shape
    for r in range(first, last):
        here, there, between = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3))
        columns, rows = np.zeros(3), np.zeros(3)
        for c in range(width):
            if not mask[r, c]:
                continue
            _to_z(float(normals[r, c, 0]), float(normals[r, c, 1]), float(normals[r, c, 2]), here)
            count = 0
            angle, one, two, most = 0.0, 0.0, 0.0, 0.0
            for q in range(max(r - w, 0), min(r + w + 1, height)):
                for d in range(max(c - w, 0), min(c + w + 1, width)):
                    if not mask[q, d]:
                        continue
                    x, y, z = normals[q, d, 0], normals[q, d, 1], normals[q, d, 2]
                    _to_z(float(x), float(y), float(z), there)
                    columns[:] = 0
                    rows[:] = 0
                    for i in range(3):
                        for j in range(3):
                            dot = (
                                here[i, 0] * there[j, 0]
                                + here[i, 1] * there[j, 1]
                                + here[i, 2] * there[j, 2]
                            )
                            between[i, j] = dot
                            off = abs(dot - 1 if i == j else dot)
                            columns[j] += off
                            rows[i] += off
                    ax = between[2, 1] - between[1, 2]
                    ay = between[0, 2] - between[2, 0]
                    az = between[1, 0] - between[0, 1]
                    trace = between[0, 0] + between[1, 1] + between[2, 2]
                    turn = math.atan2(math.sqrt(ax * ax + ay * ay + az * az), trace - 1)
                    count += 1
                    angle += turn
                    one += max(columns[0], columns[1], columns[2])
                    two += 2 * math.sin(turn / 2)
                    most += max(rows[0], rows[1], rows[2])
            sums[r, 0] += angle / count
            sums[r, 1] += one / count
            sums[r, 2] += two / count
            sums[r, 3] += most / count
