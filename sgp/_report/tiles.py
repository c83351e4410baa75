"""Tiles of full resolution, which the page decodes when they are in view."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from sgp._report.planes import Plane

SIDE: Final = 512  # pixels, without the border
_BORDER: Final = 1  # pixels of the neighbours on each side, for interpolation and curvature


@dataclass(frozen=True, eq=False)
class Tile:
    """A part of a map at full resolution.

    Parameters
    ----------
    name
        Name of the map.
    row, column
        Place of the tile, counted in tiles.
    header
        What the page has to know to decode it.
    encoded
        Its samples as text.
    """

    name: str
    row: int
    column: int
    header: dict[str, Any]
    encoded: str

    @property
    def key(self) -> str:
        """The name of the tile within the page's result."""
        return f"{self.name}-{self.row}-{self.column}"


def tiles_of(
    name: str, whole: npt.NDArray[np.float32], make: Callable[[npt.NDArray[np.float32]], Plane]
) -> list[Tile]:
    """Return the tiles of a map; each is encoded at once and only its text is kept."""
    rows, columns = whole.shape[:2]
    found = []
    for row in range(0, rows, SIDE):
        for column in range(0, columns, SIDE):
            down, across = (
                slice(max(0, at - _BORDER), at + SIDE + _BORDER) for at in (row, column)
            )
            plane = make(whole[down, across])
            numbers = ("rows", "columns", "channels", "bits", "kind", "low", "step")
            header = {key: value for key, value in plane.header().items() if key in numbers}
            found.append(Tile(name, row // SIDE, column // SIDE, header, plane.encoded))
    return found
