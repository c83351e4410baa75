"""Whether normals are those of one surface, and whether they would be if their axes were others."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import cv2
import numpy as np
import numpy.typing as npt

from rig import short_repr

Double = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
Axes = Literal["right", "mirrored", "turned", "swapped"]

# The slopes of steeper normals vary too much with their errors.
_LEAST_NZ = 0.3
# Curvatures of fewer cells say little.
_FEWEST_CELLS = 300
# Cells are as large as needed to have at most this many of them. Smaller ones show more noise,
# which all axes share.
_CELLS = 4_000
# The curl with other axes must be smaller by this factor. By noise alone all are equal, within 5 %
# for the fewest cells.
_CLEARER = 0.75

# The slopes (p, q) of a map with these axes are `matrix @ (p, q)` of a map with the right ones.
# Turns by 180 degrees do not change the curl.
_AXES: Final[dict[Axes, Double]] = {
    "right": np.array([[1.0, 0.0], [0.0, 1.0]]),
    "mirrored": np.array([[-1.0, 0.0], [0.0, 1.0]]),
    "turned": np.array([[0.0, -1.0], [1.0, 0.0]]),
    "swapped": np.array([[0.0, 1.0], [1.0, 0.0]]),
}


@dataclass(frozen=True)
class Integrability:
    """How well normals agree with the existence of a surface.

    Parameters
    ----------
    curl
        Mean absolute difference of the two mixed second derivatives, divided by the mean sum of
        their absolute values: 0 for the normals of a surface, 1 if the map is mirrored, about .7
        for noise. NaN if too few normals face the camera.
    axes
        Under which axes the normals are those of a surface: ``right`` as they are; ``mirrored``
        about x or y; ``turned`` by 90 degrees; ``swapped`` x and y. ``right`` if that is not clear.
    other_curl
        The curl under `axes`.
    """

    curl: float
    axes: Axes
    other_curl: float

    __repr__ = short_repr


def integrability(normals: npt.NDArray[np.float32], mask: Mask) -> Integrability:
    """Compare the mixed second derivatives that normals imply, under four choices of their axes.

    The slopes p = dz/dx and q = dz/dy of a surface satisfy dp/dy = dq/dx. Mirroring the normals
    about x or y changes the sign of one of the two; turning them by 90 degrees or swapping x and y
    replaces both by other second derivatives. Turning by 180 degrees changes both signs and cannot
    be seen.

    Parameters
    ----------
    normals
        ``(H, W, 3)`` unit normals.
    mask
        ``(H, W)`` bool, the pixels with a normal.

    Examples
    --------
    >>> import numpy as np
    >>> from processing import integrability
    >>> y, x = np.mgrid[1:-1:32j, -1:1:32j]
    >>> normals = np.dstack([x + y, x - y, 0 * x + 4])  # of a saddle
    >>> normals = (normals / np.linalg.norm(normals, axis=2, keepdims=True)).astype(np.float32)
    >>> integrability(normals, np.ones((32, 32), bool)).curl < 0.01
    True
    """
    cells, inside = _cells(normals, mask)
    inside &= cells[..., 2] > _LEAST_NZ
    z = np.where(inside, cells[..., 2], 1.0)
    slopes = np.stack([-cells[..., 0] / z, -cells[..., 1] / z], axis=-1)
    # Around each corner of four cells; Y is up, rows run down.
    four = inside[:-1, :-1] & inside[:-1, 1:] & inside[1:, :-1] & inside[1:, 1:]
    right = (slopes[:-1, 1:] + slopes[1:, 1:] - slopes[:-1, :-1] - slopes[1:, :-1])[four] / 2
    up = (slopes[:-1, :-1] + slopes[:-1, 1:] - slopes[1:, :-1] - slopes[1:, 1:])[four] / 2
    if len(right) < _FEWEST_CELLS:
        return Integrability(float("nan"), "right", float("nan"))
    jacobian = np.stack([right, up], axis=-1)  # of the slopes, [p or q, x or y]
    # Edges of parts and outlines have huge derivatives: limit each to the typical ones.
    size = np.linalg.norm(jacobian, axis=(1, 2))
    limit = 3 * float(np.median(size))
    jacobian *= (np.minimum(size, limit) / np.maximum(size, 1e-12))[:, None, None]
    curls = {name: _curl(matrix.T @ jacobian) for name, matrix in _AXES.items()}
    best = min(curls, key=lambda name: curls[name][0])
    difference, total = curls["right"]
    clear = curls[best][0] < _CLEARER * difference
    axes: Axes = best if clear else "right"
    return Integrability(
        curl=difference / total if total > 0 else 0.0,
        axes=axes,
        other_curl=curls[axes][0] / curls[axes][1] if curls[axes][1] > 0 else 0.0,
    )


def _curl(jacobian: Double) -> tuple[float, float]:
    """Return the mean absolute difference and the mean absolute sum of the mixed derivatives."""
    a, b = jacobian[:, 0, 1], jacobian[:, 1, 0]
    return float(np.mean(np.abs(a - b))), float(np.mean(np.abs(a) + np.abs(b)))


def _cells(normals: npt.NDArray[np.float32], mask: Mask) -> tuple[Double, Mask]:
    """Average the normals over square cells that are completely inside the mask."""
    size = max(1, int(np.ceil(np.sqrt(np.count_nonzero(mask) / _CELLS))))
    if size == 1:
        return normals.astype(np.float64), mask.copy()
    rows, columns = mask.shape[0] // size, mask.shape[1] // size
    crop = slice(0, rows * size), slice(0, columns * size)
    shape = (columns, rows)
    mean = cv2.resize(normals[crop], shape, interpolation=cv2.INTER_AREA).astype(np.float64)
    share = cv2.resize(mask[crop].astype(np.float32), shape, interpolation=cv2.INTER_AREA)
    return mean, share > 0.999
