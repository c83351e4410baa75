"""A small copy of a stack for tests: means over square cells of the object."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from processing._reconstruction.recorded_images import Images
from processing._reconstruction.surface_points import SurfacePoints
from rig import short_repr

Float = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]

CELLS = 16_000
# Cells of the bounding box, which limits the memory.
_LARGEST = 16 * CELLS
_FULL = 0.999


@dataclass(frozen=True, eq=False)
class Cells:
    """A stack at a lower resolution.

    Parameters
    ----------
    values
        ``(N, h, w)`` float32 linear radiance, NaN where a pixel of the cell was not measured.
    mask
        ``(h, w)`` bool, the cells that are completely on the object.
    points_mm
        ``(h, w, 3)`` the surface points in the middle of the cells, or None.
    size
        Pixels along the side of a cell.
    corner
        Row and column of the first pixel of the first cell.
    """

    values: Float
    mask: Mask
    points_mm: npt.NDArray[np.float64] | None
    size: int
    corner: tuple[int, int]

    __repr__ = short_repr


def cells_of(
    values: Images, mask: Mask, points_mm: npt.NDArray[np.float64] | SurfacePoints | None
) -> Cells:
    """Average a stack over cells, so that about `CELLS` of them cover the object.

    A mean over a cell that no shadow edge crosses is linear in the lights as its pixels are, and
    has less noise.
    """
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    top, left = int(rows[0]), int(columns[0])
    high, wide = int(rows[-1]) + 1 - top, int(columns[-1]) + 1 - left
    area = np.count_nonzero(mask)
    smallest = max(1, math.ceil(math.sqrt(high * wide / _LARGEST)))
    size = max(smallest, math.ceil(math.sqrt(area / CELLS)))
    while True:
        high = max(min(-(-high // size), (mask.shape[0] - top) // size), 1) * size
        wide = max(min(-(-wide // size), (mask.shape[1] - left) // size), 1) * size
        window = slice(top, top + high), slice(left, left + wide)
        inside = _mean(mask[window].astype(np.float32), size) > _FULL
        # Thin objects fill few cells: make the cells smaller.
        if size == smallest or 4 * np.count_nonzero(inside) * size**2 > area:
            break
        size = max(size // 2, smallest)
    middle = None
    if points_mm is not None:
        rows = np.arange(mask.shape[0])[window[0]][size // 2 :: size]
        of_rows = points_mm.of(rows) if isinstance(points_mm, SurfacePoints) else points_mm[rows]
        middle = np.ascontiguousarray(of_rows[:, window[1]][:, size // 2 :: size])
    reduced = np.stack([_mean(image[window], size) for image in values])
    return Cells(reduced, inside, middle, size, (top, left))


def _mean(image: Float, size: int) -> Float:
    if size == 1:
        return np.array(image)
    shape = (image.shape[1] // size, image.shape[0] // size)
    return np.asarray(cv2.resize(image, shape, interpolation=cv2.INTER_AREA), np.float32)
