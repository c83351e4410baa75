"""Surfaces with natural and carved relief: scales, cloth, carved wood, leather, a step gauge."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import ClassVar, Literal

import numpy as np

from acquisition import DataError
from rig.arrays import Float64
from simulator.shapes.carved_kernels import CELLS, leather, scales, textile, wood
from simulator.shapes.field_trace import FieldBounds
from simulator.shapes.surface import Surface, drawn, random_waves

_DESIGN_RADIUS = 80.0  # lengths in the wood carving are for this radius


@dataclass(frozen=True)
class _Relief(Surface):
    """A relief that a kernel evaluates in its own units.

    Parameters
    ----------
    amplitude_mm
        Height of the relief: heights are between 0 and this value, the lowest ones near 0.
    seed
        Seed of all irregular parts.
    """

    amplitude_mm: float = 1.0
    seed: int = 0
    # Range of the kernel's heights over many seeds, the kernel, and the name of its unit's length.
    _reaches: ClassVar[tuple[float, float]] = (0.0, 1.0)
    _kernel: ClassVar[Callable[..., None]]
    _unit: ClassVar[str | None] = None
    _lengths = ("amplitude_mm",)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.seed < 0:
            raise DataError(f"{type(self).__name__}: seed is {self.seed}, it must not be negative")
        if self._unit:
            self._positive(self._unit)

    @property
    def _unit_mm(self) -> float:
        return float(getattr(self, self._unit or "radius_mm"))

    @property
    def _drawing(self) -> tuple[Float64, ...]:
        """What the kernel draws."""
        return (self._table,)

    def evaluate(self, x_mm: Float64, y_mm: Float64) -> tuple[Float64, Float64, Float64]:
        """Return height and gradient at positions, see `Surface`."""
        unit = self._unit_mm
        height, slope_x, slope_y = drawn(self._kernel, x_mm, y_mm, *self._drawing, unit_mm=unit)
        low, high = self._reaches
        gain = self.amplitude_mm / (high - low)
        return gain * (height - low), gain / unit * slope_x, gain / unit * slope_y

    @cached_property
    def _table(self) -> Float64:
        return np.random.default_rng(self.seed).uniform(-1.0, 1.0, (CELLS, CELLS, 3))


@dataclass(frozen=True)
class LizardScales(_Relief):
    """Keeled scales ``scale_mm`` wide in rows, each of which overlaps the next row in -Y."""

    amplitude_mm: float = 1.6
    scale_mm: float = 12.0
    _reaches = (-0.35, 0.96)
    _kernel = staticmethod(scales)
    _unit = "scale_mm"


@dataclass(frozen=True)
class Textile(_Relief):
    """A plain weave of twisted yarns, ``yarn_mm`` apart."""

    yarn_mm: float = 6.0
    _reaches = (-0.15, 0.78)
    _kernel = staticmethod(textile)
    _unit = "yarn_mm"


@dataclass(frozen=True)
class CrackedLeather(_Relief):
    """Old leather: fine pebbles, and cracks around plates about ``plate_mm`` wide."""

    amplitude_mm: float = 1.2
    plate_mm: float = 20.0
    _reaches = (-0.13, 0.88)
    _kernel = staticmethod(leather)
    _unit = "plate_mm"


@dataclass(frozen=True)
class WoodCarving(_Relief):
    """A chip-carved rosette of six petals in a border of small cuts, in grained wood.

    All lengths are proportional to the radius. The seed determines the course of the grain.
    """

    amplitude_mm: float = 2.0
    _reaches = (0.02, 1.0)
    _kernel = staticmethod(wood)

    @property
    def _unit_mm(self) -> float:
        return self.radius_mm / _DESIGN_RADIUS

    @cached_property
    def _waves(self) -> Float64:
        return random_waves(70.0, self.seed, count=5)

    @property
    def _drawing(self) -> tuple[Float64, ...]:
        return _rosette(), self._waves


def _rosette() -> Float64:
    """Return the cuts; each is given by the centres of two overlapping discs and their radius."""
    cuts = []
    large = 42.0
    around = [large * np.array([math.cos(a), math.sin(a)]) for a in np.arange(6) * math.pi / 3]
    for i in range(6):
        # A petal from the middle to around[i]; both its arcs have the large radius.
        cuts.append((*around[i - 1], *around[(i + 1) % 6], large))
        # Its outer neighbour, from around[i] to around[i + 1].
        cuts.append((0.0, 0.0, *(around[i] + around[(i + 1) % 6]), large))
    for i in range(40):
        angle = 2 * math.pi * i / 40
        out = np.array([math.cos(angle), math.sin(angle)])
        side = np.array([-out[1], out[0]])
        cuts.append((*(61.5 * out + 9.5 * side), *(61.5 * out - 9.5 * side), 12.3))
    return np.array(cuts)


@dataclass(frozen=True)
class StepGauge(Surface):
    """A staircase of known heights, level treads side by side along +X.

    Parameters
    ----------
    heights_mm
        Heights of the treads from left to right, 2 or more. The treads have equal widths, which
        add up to the width of the square.
    edge_mm
        Width of the smooth transition between treads, so that no wall is vertical. It must be less
        than the width of a tread.
    """

    heights_mm: tuple[float, ...] = (0.5, 1.0, 2.0, 4.0, 8.0)
    edge_mm: float = 0.4
    outline: Literal["round", "square"] = field(default="square", kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        self._positive("edge_mm")
        if len(self.heights_mm) < 2 or not all(math.isfinite(h) for h in self.heights_mm):
            raise DataError(
                f"StepGauge: heights_mm is {self.heights_mm}, it must be two or more numbers"
            )
        if self.edge_mm >= self.tread_mm:
            raise DataError(
                f"StepGauge: edge_mm {self.edge_mm} must be less than the width of a tread, "
                f"{self.tread_mm:g} mm"
            )

    @property
    def tread_mm(self) -> float:
        """Width of a tread, from the middle of one edge to the next."""
        return math.sqrt(2) * self.radius_mm / len(self.heights_mm)

    @property
    def edges_mm(self) -> Float64:
        """``(n - 1,)`` x of the middle of each edge."""
        count = len(self.heights_mm)
        return self.tread_mm * (np.arange(1.0, count) - count / 2)

    def evaluate(self, x_mm: Float64, y_mm: Float64) -> tuple[Float64, Float64, Float64]:
        """Return height and gradient at positions, see `Surface`."""
        z = np.full(np.broadcast(x_mm, y_mm).shape, float(self.heights_mm[0]))
        zx = np.zeros_like(z)
        for at, rise in zip(self.edges_mm, np.diff(self.heights_mm), strict=True):
            t = np.clip((x_mm - at) / self.edge_mm + 0.5, 0.0, 1.0)
            # The quintic with no slope and no curvature at its ends.
            z += rise * t**3 * (10 - 15 * t + 6 * t**2)
            zx += rise / self.edge_mm * 30 * (t * (1 - t)) ** 2
        return z, zx, np.zeros_like(z)

    @cached_property
    def bounds(self) -> FieldBounds:
        """Lowest and highest height, and the steepest slope."""
        steepest = 1.875 * float(np.abs(np.diff(self.heights_mm)).max()) / self.edge_mm
        return FieldBounds(min(self.heights_mm), max(self.heights_mm), steepest)
