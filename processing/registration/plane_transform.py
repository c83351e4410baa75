"""Plane transforms: 3 x 3 matrices on pixels ``(column, row, 1)``, and their generators."""

from __future__ import annotations

import math
from typing import Final, Literal

import numpy as np
from scipy.linalg import expm

from rig.arrays import Float64

PlaneModel = Literal["rigid", "similarity", "affine", "homography"]
# Number of generators of each model.
PARAMETERS: Final[dict[PlaneModel, int]] = {
    "rigid": 3,
    "similarity": 4,
    "affine": 6,
    "homography": 8,
}
# Right, down, turn from right to down, size, stretch, shear, and perspective along both axes.
_GENERATORS: Final[Float64] = np.array(
    [
        [[0, 0, 1], [0, 0, 0], [0, 0, 0]],
        [[0, 0, 0], [0, 0, 1], [0, 0, 0]],
        [[0, -1, 0], [1, 0, 0], [0, 0, 0]],
        [[1, 0, 0], [0, 1, 0], [0, 0, 0]],
        [[1, 0, 0], [0, -1, 0], [0, 0, 0]],
        [[0, 1, 0], [1, 0, 0], [0, 0, 0]],
        [[0, 0, 0], [0, 0, 0], [1, 0, 0]],
        [[0, 0, 0], [0, 0, 0], [0, 1, 0]],
    ],
    dtype=np.float64,
)


def transformed(matrix: Float64, x: Float64, y: Float64) -> tuple[Float64, Float64]:
    """Return transformed positions."""
    w = matrix[2, 0] * x + matrix[2, 1] * y + matrix[2, 2]
    right = (matrix[0, 0] * x + matrix[0, 1] * y + matrix[0, 2]) / w
    down = (matrix[1, 0] * x + matrix[1, 1] * y + matrix[1, 2]) / w
    return right, down


def turn_of(matrix: Float64, x: float, y: float) -> float:
    """Return the angle in radians, from right to down, by which a transform turns at a place."""
    w = float(matrix[2] @ [x, y, 1])
    point = matrix[:2] @ [x, y, 1] / w
    jacobian = (matrix[:2, :2] - np.outer(point, matrix[2, :2])) / w
    return math.atan2(jacobian[1, 0] - jacobian[0, 1], jacobian[0, 0] + jacobian[1, 1])


def small_transform(step: Float64) -> Float64:
    """Return the transform of small parameters, relative to a middle and a size of 1."""
    return np.asarray(expm(np.tensordot(step, _GENERATORS[: len(step)], 1)))


def velocities(model: PlaneModel, u: Float64, v: Float64) -> Float64:
    """Return velocities ``(K, 2, P)`` of points, relative to a middle, by each parameter."""
    flows = []
    for one in _GENERATORS[: PARAMETERS[model]]:
        right = one[0, 0] * u + one[0, 1] * v + one[0, 2]
        down = one[1, 0] * u + one[1, 1] * v + one[1, 2]
        w = one[2, 0] * u + one[2, 1] * v
        flows.append(np.stack([right - w * u, down - w * v]))
    return np.stack(flows)
