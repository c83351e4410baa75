"""Albedo over the plane: what is painted or printed on the object and on the board."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import cv2
import numpy as np
import numpy.typing as npt

from acquisition import DataError
from simulator._shapes.waves import random_waves

Array = npt.NDArray[np.float64]
Albedo = float | tuple[float, float, float]

# A marker is 6 x 6 modules within a square of 8 x 8, so that every edge lies on one grid.
_MODULES_PER_SQUARE, _MODULES_PER_MARKER = 8, 6
_MARKERS = 250


class Pattern(ABC):
    """An albedo for every position (x, y), whatever the height there.

    ``sharp`` says that it has edges, which the renderer then averages over a pixel.
    """

    sharp: ClassVar[bool] = False

    @abstractmethod
    def evaluate(self, x_mm: Array, y_mm: Array) -> Array:
        """Return the albedo, 0 to 1.

        Parameters
        ----------
        x_mm, y_mm
            Positions in the house frame, any one shape.

        Returns
        -------
        Array
            That shape for a grey pattern, with a last axis of red, green, blue for a coloured one.
        """


@dataclass(frozen=True)
class Even(Pattern):
    """One albedo everywhere, grey or ``(r, g, b)``."""

    albedo: Albedo = 0.8

    def __post_init__(self) -> None:
        _check_albedo("Even", albedo=self.albedo)

    def evaluate(self, x_mm: Array, y_mm: Array) -> Array:
        return _blend(self.albedo, self.albedo, np.zeros(np.shape(x_mm)))


@dataclass(frozen=True)
class Checker(Pattern):
    """Squares of two albedos; a corner of four squares lies at the origin.

    Parameters
    ----------
    low, high
        Albedos, grey or ``(r, g, b)``; ``high`` lies right above the origin.
    square_mm
        Side of a square.
    """

    sharp = True
    low: Albedo = 0.2
    high: Albedo = 0.8
    square_mm: float = 10.0

    def __post_init__(self) -> None:
        _check_albedo("Checker", low=self.low, high=self.high)
        _check_length("Checker", square_mm=self.square_mm)

    def evaluate(self, x_mm: Array, y_mm: Array) -> Array:
        odd = (np.floor(x_mm / self.square_mm) + np.floor(y_mm / self.square_mm)) % 2
        return _blend(self.high, self.low, odd)


@dataclass(frozen=True)
class Gradient(Pattern):
    """An even change from one albedo to another, constant before and after.

    Parameters
    ----------
    low, high
        Albedos at both ends, grey or ``(r, g, b)``.
    length_mm
        Way from one to the other, half of it on each side of the origin.
    angle_deg
        Direction of the change: 0 to the right (+X), 90 up (+Y).
    """

    low: Albedo = 0.2
    high: Albedo = 0.8
    length_mm: float = 160.0
    angle_deg: float = 0.0

    def __post_init__(self) -> None:
        _check_albedo("Gradient", low=self.low, high=self.high)
        _check_length("Gradient", length_mm=self.length_mm)
        if not math.isfinite(self.angle_deg):
            raise DataError(f"Gradient: angle_deg is {self.angle_deg}, not a number")

    def evaluate(self, x_mm: Array, y_mm: Array) -> Array:
        angle = math.radians(self.angle_deg)
        along = (math.cos(angle) * x_mm + math.sin(angle) * y_mm) / self.length_mm
        return _blend(self.low, self.high, np.clip(0.5 + along, 0.0, 1.0))


@dataclass(frozen=True)
class Paint(Pattern):
    """An albedo that wanders smoothly between two values, or one value where both are equal.

    Parameters
    ----------
    low, high
        Bounds, ``0 <= low <= high <= 1``.
    wavelength_mm
        Typical length of the variation.
    seed
        Of the pattern.
    """

    low: float
    high: float
    wavelength_mm: float = 60.0
    seed: int = 0

    def __post_init__(self) -> None:
        if not 0 <= self.low <= self.high <= 1 or not self.wavelength_mm > 0:
            raise DataError(
                f"an albedo runs from low to high within 0..1 over a positive wavelength, "
                f"not {self.low}..{self.high} over {self.wavelength_mm} mm"
            )

    def evaluate(self, x_mm: Array, y_mm: Array) -> Array:
        waves = random_waves(self.wavelength_mm, self.seed, count=5)
        swing = sum(np.cos(kx * x_mm + ky * y_mm + phase) for kx, ky, phase in waves)
        # Five waves seldom meet: tanh spreads their sum to the bounds and never past them.
        albedo: Array = self.low + (self.high - self.low) * (0.5 + 0.5 * np.tanh(0.7 * swing))
        return albedo


@dataclass(frozen=True)
class ColourWheel(Pattern):
    """All hues around the origin: red to the right, green and blue counterclockwise after it.

    Parameters
    ----------
    radius_mm
        Where the colours are full; they fade to grey toward the middle.
    low, high
        Albedo of a full colour's weakest and strongest channel.
    """

    radius_mm: float = 80.0
    low: float = 0.1
    high: float = 0.8

    def __post_init__(self) -> None:
        _check_albedo("ColourWheel", low=self.low, high=self.high)
        _check_length("ColourWheel", radius_mm=self.radius_mm)

    def evaluate(self, x_mm: Array, y_mm: Array) -> Array:
        full = np.minimum(np.hypot(x_mm, y_mm) / self.radius_mm, 1.0)
        hue = np.arctan2(y_mm, x_mm)
        turn = np.cos(hue[..., None] - 2 * math.pi / 3 * np.arange(3))
        albedo: Array = (self.low + self.high) / 2 + (self.high - self.low) / 2 * (
            full[..., None] * turn
        )
        return albedo


@dataclass(frozen=True)
class ChArUco(Pattern):
    """A ChArUco board around the origin, of markers from OpenCV's ``DICT_4X4_250``.

    A checkerboard whose white squares carry markers, the first at the upper left. Around it is
    white paper without end. A marker is 3/4 as wide as its square.

    Parameters
    ----------
    columns, rows
        Squares in x and in y, 2 or more each, at most 500 in all.
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
        _check_albedo("ChArUco", black=self.black, white=self.white)
        _check_length("ChArUco", square_mm=self.square_mm)
        if min(self.columns, self.rows) < 2 or self.columns * self.rows > 2 * _MARKERS:
            raise DataError(
                f"ChArUco: {self.columns} x {self.rows} squares; it takes 2 or more each way and "
                f"at most {2 * _MARKERS} in all"
            )

    @property
    def corners_mm(self) -> Array:
        """``(n, 2)`` inner corners of the squares, row by row from the upper left as in OpenCV."""
        x = (np.arange(1, self.columns) - self.columns / 2) * self.square_mm
        y = (self.rows / 2 - np.arange(1, self.rows)) * self.square_mm
        corners: Array = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        return corners

    def evaluate(self, x_mm: Array, y_mm: Array) -> Array:
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
    def _modules(self) -> npt.NDArray[np.bool_]:
        board = cv2.aruco.CharucoBoard(
            (self.columns, self.rows),
            _MODULES_PER_SQUARE,
            _MODULES_PER_MARKER,
            cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_250),
        )
        size = (self.columns * _MODULES_PER_SQUARE, self.rows * _MODULES_PER_SQUARE)
        drawn: npt.NDArray[np.bool_] = np.asarray(board.generateImage(size, marginSize=0)) > 127
        return drawn


def _check_albedo(pattern: str, **values: Albedo) -> None:
    for name, value in values.items():
        levels = np.asarray(value, np.float64)
        if levels.shape not in ((), (3,)) or not np.all((levels >= 0) & (levels <= 1)):
            raise DataError(
                f"{pattern}: {name} is {value}, it must be one or three numbers in 0..1"
            )


def _check_length(pattern: str, **values: float) -> None:
    for name, value in values.items():
        if not (math.isfinite(value) and value > 0):
            raise DataError(f"{pattern}: {name} is {value}, it must be a positive length in mm")


def _blend(first: Albedo, second: Albedo, share: Array) -> Array:
    """Return ``first`` where the share is 0 and ``second`` where it is 1."""
    a, b = np.broadcast_arrays(np.asarray(first, np.float64), np.asarray(second, np.float64))
    weight = share[..., None] if a.ndim else share
    blended: Array = a + (b - a) * weight
    return blended
