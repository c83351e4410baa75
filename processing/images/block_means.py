"""A small copy of a stack for tests: means over square cells of the object."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from processing.images.recorded_images import Images
from processing.images.viewing_rays import SurfacePoints
from rig import short_repr
from rig.arrays import Bool, Float32, Float64

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

    values: Float32
    mask: Bool
    points_mm: Float64 | None
    size: int
    corner: tuple[int, int]

    __repr__ = short_repr


def cells_of(values: Images, mask: Bool, points_mm: Float64 | SurfacePoints | None) -> Cells:
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
        inside = block_mean(mask[window].astype(np.float32), size) > _FULL
        # Thin objects fill few cells: make the cells smaller.
        if size == smallest or 4 * np.count_nonzero(inside) * size**2 > area:
            break
        size = max(size // 2, smallest)
    middle = None
    if points_mm is not None:
        middle = _middles(points_mm, mask.shape[0], window, size)
    reduced = np.stack([block_mean(image[window], size) for image in values])
    return Cells(reduced, inside, middle, size, (top, left))


def _middles(
    points_mm: Float64 | SurfacePoints, height: int, window: tuple[slice, slice], size: int
) -> Float64:
    """Return the points in the middle of cells, which is between pixels if their size is even."""
    # Half a pixel of a coarse image tilts the strengths of near lights by a percent.
    beside = sorted({(size - 1) // 2, size // 2})
    total: Float64 | float = 0.0
    for down in beside:
        rows = np.arange(height)[window[0]][down::size]
        of_rows = points_mm.of(rows) if isinstance(points_mm, SurfacePoints) else points_mm[rows]
        total = total + sum(of_rows[:, window[1]][:, right::size] for right in beside)
    return np.ascontiguousarray(total / len(beside) ** 2)


def block_mean(image: Float32, size: int) -> Float32:
    """Return the means over squares of an image that consists of complete ones."""
    if size == 1:
        return np.array(image)
    shape = (image.shape[1] // size, image.shape[0] // size)
    return np.asarray(cv2.resize(image, shape, interpolation=cv2.INTER_AREA), np.float32)
