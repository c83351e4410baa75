"""Samples of a stack for tests of its images and lights."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from acquisition import Lights
from processing._reconstruction.cells import Cells
from rig import short_repr

Double = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

_PIXELS = 3000
# Darker samples, relative to the brightest of their pixel, are probably in shadow.
_DARK = 0.1
# Under near lights, only cells within this fraction of the distance to the lights: there the light
# vectors of all cells are nearly linear maps of those in the middle.
_NEAR = 0.15


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

    values: Double
    usable: Mask
    vectors: Double
    scale: Double
    pixels: npt.NDArray[np.intp]
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


def _distances(lights: Lights, points: Double) -> Double:
    """Return the distances ``(P, N)`` from points to lights."""
    positions = np.asarray(lights.positions_mm)
    distances: Double = np.linalg.norm(points[:, None] - positions[None], axis=2)
    return distances


def _falloff(lights: Lights, points: Double) -> Double:
    """Return the lengths ``(P, N)`` of the light vectors relative to the distances.

    A light vector is this factor times the line from the point to the light, which depends
    linearly on the light for lights in one plane.
    """
    strength = np.linalg.norm(lights.vectors_at(points), axis=2).T
    with np.errstate(divide="ignore", invalid="ignore"):
        factor: Double = np.where(strength > 0, strength / _distances(lights, points), np.nan)
    return factor
