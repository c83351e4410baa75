"""A small copy of a stack for tests: means over square cells of the object."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from acquisition import Lights
from processing.images.recorded_images import Images
from processing.images.viewing_rays import SurfacePoints
from rig import short_repr
from rig.arrays import Bool, Float32, Float64, Intp

_PIXELS = 3000
# Darker samples, relative to the brightest of their pixel, are probably in shadow.
_DARK = 0.1
# Under near lights, only cells within this fraction of the distance to the lights: there the light
# vectors of all cells are nearly linear maps of those in the middle.
_NEAR = 0.15
CELLS = 16_000
# Cells of the bounding box, which limits the memory.
_LARGEST = 16 * CELLS
_FULL = 0.999


@dataclass(frozen=True, eq=False)
class Samples:
    """Samples of the object as under distant lights.

    Parameters
    ----------
    values
        ``(P, N)`` linear radiance, scaled so that the usable samples of a cell have the root mean
        square 1; under near lights divided by their falloff relative to the middle of the object.
    usable
        ``(P, N)`` bool, measured and not in shadow, at least half of each cell and 4.
    vectors
        ``(N, 3)`` the given light vectors in the middle of the object.
    scale
        ``(P, N)`` factors from radiance to `values`.
    pixels
        ``(P, 2)`` row and column of the cells in the images.
    share
        Usable samples of all cells of the object, as a fraction 0..1.
    """

    values: Float64
    usable: Bool
    vectors: Float64
    scale: Float64
    pixels: Intp
    share: float

    __repr__ = short_repr


def samples_of(cells: Cells, lights: Lights, pixels: int = _PIXELS) -> Samples:
    """Choose the cells, and remove what is known about albedo and falloff.

    Parameters
    ----------
    cells
        N images.
    lights
        Their N lights.
    pixels
        Largest number of cells.
    """
    count = len(cells.values)
    places = np.argwhere(cells.mask)
    values = cells.values[:, cells.mask].T.astype(np.float64)
    with np.errstate(invalid="ignore"):
        measured = np.isfinite(values) & (values > 0)
    values = np.where(measured, values, 0.0)
    usable = measured & (values > _DARK * values.max(axis=1, keepdims=True, initial=0.0))
    share = float(usable.mean()) if usable.size else 0.0
    if lights.near and cells.points_mm is not None:
        points = cells.points_mm[cells.mask]
        middle = np.median(points, axis=0)
        vectors = lights.vectors_at(middle)
        away = np.linalg.norm(points - middle, axis=1)
        distance = float(np.median(_distances(lights, middle[None])))
        kept = away < _NEAR * distance
        scale = _falloff(lights, middle[None]) / _falloff(lights, points)
    else:
        vectors = lights.unit_directions
        kept = np.ones(len(values), np.bool_)
        scale = np.ones((len(values), count))
    enough = np.flatnonzero(kept & (usable.sum(axis=1) >= max(4, count / 2)))
    enough = enough[:: max(1, -(-len(enough) // pixels))]
    values, usable, scale = values[enough], usable[enough], scale[enough]
    usable &= np.isfinite(scale)
    values = np.where(usable, values * np.where(usable, scale, 1.0), 0.0)
    size = np.sqrt(np.sum(values**2, axis=1) / np.maximum(usable.sum(axis=1), 1))
    size = np.where(size > 0, size, 1.0)[:, None]
    middles = places[enough] * cells.size + cells.size // 2 + np.array(cells.corner)
    return Samples(values / size, usable, vectors, scale / size, middles, share)


def _distances(lights: Lights, points: Float64) -> Float64:
    """Return the distances ``(P, N)`` from points to lights."""
    positions = np.asarray(lights.positions_mm)
    return np.asarray(np.linalg.norm(points[:, None] - positions[None], axis=2))


def _falloff(lights: Lights, points: Float64) -> Float64:
    """Return the lengths ``(P, N)`` of the light vectors relative to the distances.

    A light vector is this factor times the line from the point to the light, which depends
    linearly on the light for lights in one plane.
    """
    strength = np.linalg.norm(lights.vectors_at(points), axis=2).T
    with np.errstate(divide="ignore", invalid="ignore"):
        factor: Float64 = np.where(strength > 0, strength / _distances(lights, points), np.nan)
    return factor


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
