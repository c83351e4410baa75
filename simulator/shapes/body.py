"""Interface between objects and the renderer: ray hits and shadow casters."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from rig.arrays import Bool, Float32, Float64
from simulator.shapes.bvh import TriangleTree


@dataclass(frozen=True, eq=False)
class BodyHits:
    """First hits of rays on a body.

    Parameters
    ----------
    points_mm
        ``(..., 3)`` first hit of each ray, 0 if a ray misses.
    normals
        ``(..., 3)`` unit normals of the body there, on the side from which the ray arrives; 0 if a
        ray misses.
    hit
        ``(...)`` True for rays that hit the body.
    """

    points_mm: Float64
    normals: Float64
    hit: Bool


@dataclass(frozen=True, eq=False)
class HeightGrid:
    """A height field sampled for casting shadows.

    Parameters
    ----------
    origin_xy_mm
        Position (x, y) of ``heights_mm[0, 0]``.
    step_mm
        Distance between neighbouring samples along x and along y.
    heights_mm
        ``(rows, columns)`` float32: ``heights_mm[j, i]`` is at
        ``(origin_x + i * step, origin_y + j * step)``, so y increases with the row. Heights outside
        the outline are 0, the board; the first and last rows and columns are outside the outline.
    """

    origin_xy_mm: tuple[float, float]
    step_mm: float
    heights_mm: Float32


class Body(Protocol):
    """An object on the board: a height field or a mesh.

    All lengths are mm in the house frame. Rays are ``origins + t * directions`` with t > 0 and
    directions of any length.
    """

    @property
    def radius_mm(self) -> float:
        """Radius around the origin that contains the footprint."""
        ...

    @property
    def top_mm(self) -> float:
        """Height of the highest point above the board."""
        ...

    def inside(self, x_mm: Float64, y_mm: Float64) -> Bool:
        """Return which positions of the board the body covers, seen vertically from above."""
        ...

    def trace(self, origins_mm: Float64, directions: Float64) -> BodyHits:
        """Return the first hits of rays ``(..., 3)``; the two arrays are broadcast."""
        ...

    def shadow_caster(self, step_mm: float) -> HeightGrid | TriangleTree:
        """Return the object that a shadow kernel searches; a mesh ignores ``step_mm``."""
        ...
