"""What an object offers to the renderer: who meets a ray first, and what casts its shadow."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from simulator._shapes.bvh import TriangleTree

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class BodyHits:
    """Where rays first meet a body.

    Parameters
    ----------
    points_mm
        ``(..., 3)`` first points met, 0 where a ray misses.
    normals
        ``(..., 3)`` unit normals of the body there, toward the side the ray came from; 0 where it
        misses.
    hit
        ``(...)`` which rays meet the body.
    """

    points_mm: Array
    normals: Array
    hit: npt.NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class HeightGrid:
    """A height field sampled for casting shadows.

    Parameters
    ----------
    origin_xy_mm
        Place (x, y) of ``heights_mm[0, 0]``.
    step_mm
        Distance of neighbouring samples along x and along y.
    heights_mm
        ``(rows, columns)`` float32: ``heights_mm[j, i]`` lies at
        ``(origin_x + i * step, origin_y + j * step)``, so that y grows with the row. 0, the board,
        outside the outline; the first and last rows and columns lie outside it.
    """

    origin_xy_mm: tuple[float, float]
    step_mm: float
    heights_mm: npt.NDArray[np.float32]


class Body(Protocol):
    """An object on the board: a height field or a mesh.

    All lengths are mm in the house frame. Rays are ``origins + t * directions`` with t > 0 and
    directions of any length.
    """

    @property
    def radius_mm(self) -> float:
        """Radius around the origin that holds the whole footprint."""
        ...

    @property
    def top_mm(self) -> float:
        """Height of the highest point above the board."""
        ...

    def inside(self, x_mm: Array, y_mm: Array) -> npt.NDArray[np.bool_]:
        """Return which positions of the board the body covers, seen straight from above."""
        ...

    def trace(self, origins_mm: Array, directions: Array) -> BodyHits:
        """Return where rays ``(..., 3)`` first meet the body; the two arrays may broadcast."""
        ...

    def shadow_caster(self, step_mm: float) -> HeightGrid | TriangleTree:
        """Return what a shadow kernel searches; a mesh takes no heed of ``step_mm``."""
        ...
