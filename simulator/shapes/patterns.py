"""Albedo over the plane: paint or print on the object and on the board."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import cv2
import numpy as np

from acquisition import DataError
from rig.arrays import Bool, Float64
from simulator.shapes.ranges import Albedo, check_albedo, check_length
from simulator.shapes.surface import random_waves

# A marker is 6 x 6 modules within a square of 8 x 8, so all edges are on one grid.
_MODULES_PER_SQUARE, _MODULES_PER_MARKER = 8, 6
_MARKERS = 250
# Fields of patterns that are albedos.
_ALBEDOS = ("albedo", "low", "high", "paper", "ink", "black", "white")


class Pattern(ABC):
    """Albedo as a function of the position (x, y), independent of the height.

    ``sharp`` is True for a pattern with edges; the renderer averages it over a pixel.
    """

    sharp: ClassVar[bool] = False

    def __post_init__(self) -> None:
        name, values = type(self).__name__, vars(self)
        check_albedo(name, **{key: values[key] for key in values if key in _ALBEDOS})
        lengths = [key for key in values if key.endswith("_mm") and key != "shift_mm"]
        check_length(name, **{key: values[key] for key in lengths})
        for key in ("angle_deg", "shift_mm"):
            if not np.isfinite(values.get(key, 0.0)).all():
                raise DataError(f"{name}: {key} is {values[key]}, it must be finite")

    @abstractmethod
    def evaluate(self, x_mm: Float64, y_mm: Float64) -> Float64:
        """Return the albedo, 0 to 1.

        Parameters
        ----------
        x_mm, y_mm
            Positions in the house frame, arrays of one shape.

        Returns
        -------
        Array
            Array of that shape for a grey pattern; a coloured pattern adds a last axis of red,
            green, blue.
        """


@dataclass(frozen=True)
class Even(Pattern):
    """Uniform albedo, grey or ``(r, g, b)``."""

    albedo: Albedo = 0.8

    def evaluate(self, x_mm: Float64, y_mm: Float64) -> Float64:
        """Return the albedo at positions, see `Pattern`."""
        return blend(self.albedo, self.albedo, np.zeros(np.shape(x_mm)))


@dataclass(frozen=True)
class Checker(Pattern):
    """Squares of two albedos; a corner of four squares is at ``shift_mm``.

    Parameters
    ----------
    low, high
        Albedos, grey or ``(r, g, b)``; the square to the upper right of that corner has ``high``.
    square_mm
        Side of a square.
    angle_deg
        Direction of the rows, counterclockwise from x.
    shift_mm
        Position of the corner.
    """

    sharp = True
    low: Albedo = 0.2
    high: Albedo = 0.8
    square_mm: float = 10.0
    angle_deg: float = 0.0
    shift_mm: tuple[float, float] = (0.0, 0.0)

    def evaluate(self, x_mm: Float64, y_mm: Float64) -> Float64:
        """Return the albedo at positions, see `Pattern`."""
        x, y = turned(x_mm - self.shift_mm[0], y_mm - self.shift_mm[1], self.angle_deg)
        odd = (np.floor(x / self.square_mm) + np.floor(y / self.square_mm)) % 2
        return blend(self.high, self.low, odd)


@dataclass(frozen=True)
class Gradient(Pattern):
    """Linear change from one albedo to another, constant on both sides of it.

    Parameters
    ----------
    low, high
        Albedos at both ends, grey or ``(r, g, b)``.
    length_mm
        Length of the change, half of it on each side of the origin.
    angle_deg
        Direction of the change: 0 to the right (+X), 90 up (+Y).
    """

    low: Albedo = 0.2
    high: Albedo = 0.8
    length_mm: float = 160.0
    angle_deg: float = 0.0

    def evaluate(self, x_mm: Float64, y_mm: Float64) -> Float64:
        """Return the albedo at positions, see `Pattern`."""
        along = turned(x_mm, y_mm, self.angle_deg)[0] / self.length_mm
        return blend(self.low, self.high, np.clip(0.5 + along, 0.0, 1.0))


@dataclass(frozen=True)
class Paint(Pattern):
    """Albedo that varies smoothly and randomly between two values.

    Parameters
    ----------
    low, high
        Bounds, ``0 <= low <= high <= 1``.
    wavelength_mm
        Typical length of the variation.
    seed
        Seed of the pattern.
    """

    low: float
    high: float
    wavelength_mm: float = 60.0
    seed: int = 0

    def __post_init__(self) -> None:
        if not 0 <= self.low <= self.high <= 1 or not self.wavelength_mm > 0:
            raise DataError(
                f"Paint: low {self.low}, high {self.high}, wavelength_mm {self.wavelength_mm} are "
                "out of range: 0 <= low <= high <= 1, wavelength_mm > 0"
            )

    def evaluate(self, x_mm: Float64, y_mm: Float64) -> Float64:
        """Return the albedo at positions, see `Pattern`."""
        waves = random_waves(self.wavelength_mm, self.seed, count=5)
        swing = sum(np.cos(kx * x_mm + ky * y_mm + phase) for kx, ky, phase in waves)
        # The sum of five waves is rarely near its extremes: tanh expands it to the bounds.
        return np.asarray(self.low + (self.high - self.low) * (0.5 + 0.5 * np.tanh(0.7 * swing)))


@dataclass(frozen=True)
class ColourWheel(Pattern):
    """All hues around the origin: red on the right, then counterclockwise green and blue.

    Parameters
    ----------
    radius_mm
        Radius of full saturation; the colours fade to grey toward the middle.
    low, high
        Albedo of the weakest and the strongest channel at full saturation.
    """

    radius_mm: float = 80.0
    low: float = 0.1
    high: float = 0.8

    def evaluate(self, x_mm: Float64, y_mm: Float64) -> Float64:
        """Return the albedo at positions, see `Pattern`."""
        full = np.minimum(np.hypot(x_mm, y_mm) / self.radius_mm, 1.0)[..., None]
        hue = np.arctan2(y_mm, x_mm)[..., None]
        swing = full * np.cos(hue - 2 * math.pi / 3 * np.arange(3))
        middle, reach = (self.low + self.high) / 2, (self.high - self.low) / 2
        return np.asarray(middle + reach * swing)


@dataclass(frozen=True)
class ChArUco(Pattern):
    """A ChArUco board around the origin, with markers from OpenCV's ``DICT_4X4_250``.

    The white squares of a checkerboard have markers, the first one at the upper left. The paper
    around the board is white and unlimited. The width of a marker is 3/4 of its square.

    Parameters
    ----------
    columns, rows
        Number of squares in x and in y, 2 or more each, at most 500 in total.
    square_mm
        Side of a square.
    black, white
        Albedos of ink and paper, grey.
    """

    sharp = True
    columns: int = 7
    rows: int = 5
    square_mm: float = 20.0
    black: float = 0.04
    white: float = 0.85

    def __post_init__(self) -> None:
        super().__post_init__()
        if min(self.columns, self.rows) < 2 or self.columns * self.rows > 2 * _MARKERS:
            raise DataError(
                f"ChArUco: {self.columns} x {self.rows} squares; columns and rows must be 2 or "
                f"more, and the total at most {2 * _MARKERS}"
            )

    @property
    def corners_mm(self) -> Float64:
        """``(n, 2)`` inner corners of the squares, row by row from the upper left as in OpenCV."""
        x = (np.arange(1, self.columns) - self.columns / 2) * self.square_mm
        y = (self.rows / 2 - np.arange(1, self.rows)) * self.square_mm
        return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)

    def evaluate(self, x_mm: Float64, y_mm: Float64) -> Float64:
        """Return the albedo at positions, see `Pattern`."""
        modules = self._modules
        module_mm = self.square_mm / _MODULES_PER_SQUARE
        column = np.floor(x_mm / module_mm + modules.shape[1] / 2)
        row = np.floor(modules.shape[0] / 2 - y_mm / module_mm)
        on_board = (column >= 0) & (column < modules.shape[1])
        on_board &= (row >= 0) & (row < modules.shape[0])
        column, row = np.where(on_board, column, 0), np.where(on_board, row, 0)
        white = ~on_board | modules[row.astype(np.intp), column.astype(np.intp)]
        return np.where(white, self.white, self.black)

    @cached_property
    def _modules(self) -> Bool:
        board = cv2.aruco.CharucoBoard(
            (self.columns, self.rows),
            _MODULES_PER_SQUARE,
            _MODULES_PER_MARKER,
            cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_250),
        )
        size = (self.columns * _MODULES_PER_SQUARE, self.rows * _MODULES_PER_SQUARE)
        return np.asarray(board.generateImage(size, marginSize=0)) > 127


def turned(x_mm: Float64, y_mm: Float64, angle_deg: float) -> tuple[Float64, Float64]:
    """Return positions in axes that are turned counterclockwise by an angle."""
    cosine, sine = math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg))
    return cosine * x_mm + sine * y_mm, cosine * y_mm - sine * x_mm


def blend(first: Albedo, second: Albedo, share: Float64) -> Float64:
    """Return ``first`` where the share is 0 and ``second`` where it is 1."""
    a, b = np.broadcast_arrays(np.asarray(first, np.float64), np.asarray(second, np.float64))
    weight = share[..., None] if a.ndim else share
    return np.asarray(a + (b - a) * weight)
