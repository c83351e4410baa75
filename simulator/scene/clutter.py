"""Clutter: balls that are no mirrors, and boxes, anywhere on the board."""

from __future__ import annotations

import math
from dataclasses import dataclass

from acquisition import DataError
from simulator.scene.reflectance import Ggx, Lambert
from simulator.shapes.ranges import Albedo, check_albedo, check_length

# First column of `Scene.clutter_table`.
BALL, BOX = 0.0, 1.0


@dataclass(frozen=True)
class Ball:
    """A painted ball: a diffuse or glossy one, not a mirror.

    Parameters
    ----------
    centre_mm
        Centre in the house frame; a ball on the board has ``z = radius_mm``.
    radius_mm
        Radius, greater than 0.
    albedo
        Albedo of the paint, grey or ``(r, g, b)``.
    roughness
        Roughness of a glossy coat, see `Ggx`; None for matte paint.

    Raises
    ------
    DataError
        If a value is out of range.
    """

    centre_mm: tuple[float, float, float]
    radius_mm: float
    albedo: Albedo = 0.6
    roughness: float | None = None

    def __post_init__(self) -> None:
        if len(self.centre_mm) != 3 or not all(math.isfinite(v) for v in self.centre_mm):
            raise DataError(f"a ball centre of {self.centre_mm} is not three finite numbers")
        check_length("a ball", radius_mm=self.radius_mm)
        check_albedo("a ball", albedo=self.albedo)
        if self.centre_mm[2] < self.radius_mm - 1e-9:
            raise DataError("the ball intersects the board: raise its centre to its radius")
        _coat(self.roughness)

    @property
    def material(self) -> Lambert | Ggx:
        """Reflectance of the surface."""
        return _coat(self.roughness)

    @property
    def reach_mm(self) -> float:
        """Radius of the sphere around the centre that contains the ball."""
        return self.radius_mm

    def gap_mm(self, point_mm: tuple[float, ...]) -> float:
        """Return the distance of a point from the surface, negative inside."""
        return math.dist(point_mm, self.centre_mm) - self.radius_mm

    @property
    def row(self) -> tuple[float, ...]:
        """Row of `Scene.clutter_table`."""
        return (BALL, *self.centre_mm, self.radius_mm, 0.0, 0.0, 1.0, 0.0)


@dataclass(frozen=True)
class Box:
    """A box that stands on the board.

    Parameters
    ----------
    place_mm
        Position (x, y) of its middle.
    size_mm
        Lengths of its edges: two along the board, and its height.
    turn_deg
        Angle by which it is turned on the board, counterclockwise.
    albedo
        Albedo of all its faces, grey or ``(r, g, b)``.
    roughness
        Roughness of a glossy coat, see `Ggx`; None for matte paint.

    Raises
    ------
    DataError
        If a value is out of range.
    """

    place_mm: tuple[float, float]
    size_mm: tuple[float, float, float]
    turn_deg: float = 0.0
    albedo: Albedo = 0.4
    roughness: float | None = None

    def __post_init__(self) -> None:
        if not all(map(math.isfinite, (*self.place_mm, self.turn_deg))):
            raise DataError(f"a box at {self.place_mm}, turned by {self.turn_deg}, is not finite")
        for length in self.size_mm:
            check_length("a box", size_mm=length)
        check_albedo("a box", albedo=self.albedo)
        _coat(self.roughness)

    @property
    def material(self) -> Lambert | Ggx:
        """Reflectance of the surface."""
        return _coat(self.roughness)

    @property
    def centre_mm(self) -> tuple[float, float, float]:
        """Middle of the box."""
        return (*self.place_mm, self.size_mm[2] / 2)

    @property
    def reach_mm(self) -> float:
        """Radius of the sphere around the centre that contains the box."""
        return math.hypot(*self.size_mm) / 2

    def gap_mm(self, point_mm: tuple[float, ...]) -> float:
        """Return the distance of a point from the surface, not positive inside."""
        x, y, z = (a - b for a, b in zip(point_mm, self.centre_mm, strict=True))
        turn = math.radians(self.turn_deg)
        along = math.cos(turn) * x + math.sin(turn) * y
        across = math.cos(turn) * y - math.sin(turn) * x
        edges = zip((along, across, z), self.size_mm, strict=True)
        return math.hypot(*(max(abs(v) - edge / 2, 0.0) for v, edge in edges))

    @property
    def row(self) -> tuple[float, ...]:
        """Row of `Scene.clutter_table`."""
        turn = math.radians(self.turn_deg)
        half = (length / 2 for length in self.size_mm)
        return (BOX, *self.centre_mm, *half, math.cos(turn), math.sin(turn))


Clutter = Ball | Box


def _coat(roughness: float | None) -> Lambert | Ggx:
    return Lambert() if roughness is None else Ggx(roughness)
