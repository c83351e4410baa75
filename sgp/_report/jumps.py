"""Where the surface jumps between neighbouring pixels of the embedded maps."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from sgp._panels.crop import Crop
from sgp._report.planes import Plane
from sgp._write_jumps import JUMP_DOWN

# A reduced pixel is cut from its neighbour if this share of the pixels between them jumps.
_SHARE = 0.5


def jumps_plane(values: npt.NDArray[Any], crop: Crop, size: tuple[int, int]) -> Plane:
    """Return a plane of ``size``: 1 with a jump to the right neighbour, plus 2 with one below."""
    part = values[crop.rows, crop.columns]
    down = part >= JUMP_DOWN
    right = part % JUMP_DOWN > 0
    cut = _between(right, size) + 2 * _between(down.T, size[::-1]).T
    return Plane("jumps", "flags", cut.astype(np.uint8)[..., None])


def _between(right: npt.NDArray[np.bool_], size: tuple[int, int]) -> npt.NDArray[np.int64]:
    """Return for each reduced pixel whether the surface jumps on the way to the right one."""
    rows, columns = size
    high, wide = right.shape
    row, column = np.nonzero(right)
    # The boundary between two pixels, in reduced pixels, and the middle that is left of it.
    left = np.floor((column + 1) * columns / wide - 0.5).astype(int)
    inside = (left >= 0) & (left < columns - 1)
    # A row counts once, however many jumps it has there.
    found = np.unique(row[inside] * columns + left[inside])
    place = (found // columns * rows // high) * columns + found % columns
    count = np.bincount(place, minlength=rows * columns).reshape(rows, columns)
    enough: npt.NDArray[np.bool_] = count >= max(1.0, _SHARE * high / rows)
    return enough.astype(np.int64)
