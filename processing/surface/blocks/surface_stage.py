"""The integration of a normal map as a stage: its maps and its memory."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from acquisition.files import Form
from processing.stages.stage import Need, Size
from processing.surface.blocks.plan import plan_blocks

# Bytes whatever the size, measured with those per pixel from 1 to 10 megapixels (decision 69), and
# what the allocator keeps, which depends on the order of small allocations by 12 MB.
_FIXED = 42_000_000
# Bytes per pixel of a surface that is solved as a whole; additional ones with a camera, and with
# deviations of the normals.
_WHOLE, _CAMERA, _SIGMA = 70, 45, 33
# Additional ones if jumps are looked for, of the whole or of the largest block; bytes of the search
# in large pixels; bytes per pixel of the maps of jumps.
_JUMPS, _SEARCH, _JUMP_MAPS = 55, 170_000_000, 15
# Bytes per pixel of the largest block, of the rows that two blocks share, and of the map.
_BLOCK, _SHARED, _MASKS = 82, 48, 2
# Interpreter, libraries and bands of rows that are written.
_PROGRAM = 318_000_000
# Bytes per pixel of a surface in memory: the normals while it is solved, all maps and the mesh,
# measured at 5 and 20 megapixels; depths and deviations are additional maps.
_NORMALS, _WRITING, _MAP = 14, 105, 8
# Bytes per pixel in blocks while the files are written: masks, and a map for its median.
_FINISHING = 12
_ROWS = 8  # a block has a multiple of these


@dataclass(frozen=True)
class SurfaceStage:
    """The integration of a normal map, as a whole or in blocks of rows.

    The maps are those of `HeightMap`; ``solution``, the heights before they are placed; and
    ``curl`` and ``residual``, for those of `normal_curl` and `normal_residual`.

    Parameters
    ----------
    perspective
        Whether a camera is given.
    weighted
        Whether standard deviations of the normals are given.
    jumps
        Whether jumps in depth are looked for.

    Examples
    --------
    >>> from processing.surface import SurfaceStage
    >>> need = SurfaceStage().need((8944, 11180))
    >>> f"{need.whole / 1e9:.1f} GB as a whole, {need.least / 1e9:.1f} GB in blocks"
    '14.3 GB as a whole, 2.1 GB in blocks'
    """

    name: ClassVar = "surface"

    perspective: bool = False
    weighted: bool = False
    jumps: bool = True

    def need(self, *sizes: Size) -> Need:
        """Return the memory for a map of (height, width)."""
        ((height, width),) = sizes
        pixels = height * width
        solving = self.solving((height, width)) + _NORMALS * pixels
        writing = _WRITING + (self.perspective + self.weighted) * _MAP
        whole = _PROGRAM + max(solving, writing * pixels)
        least = min(self._in_blocks((height, width)).values(), default=whole)
        return Need(whole, min(least, whole), f"a surface of {width} x {height} pixels")

    def blocks(self, size: Size, memory: int) -> tuple[int, int]:
        """Return the most rows of a block that fit into a memory, and the bytes that they need."""
        return max(item for item in self._in_blocks(size).items() if item[1] <= memory)

    def forms(self, *sizes: Size) -> Mapping[str, Form]:
        """Return shapes and types of the maps."""
        (size,) = sizes
        plain: Form = (size, np.float32)
        maps = dict.fromkeys(("height", "curl", "residual"), plain)
        maps |= {"parts": (size, np.int32), "solution": (size, np.float64)}
        return maps | {"depth": plain} if self.perspective else maps

    def solving(self, size: Size, rows: int | None = None) -> int:
        """Return the bytes that the solver needs, besides its inputs and the program.

        The estimate is 3 to 85 % above the peaks that were measured from 1 to 10 megapixels.
        Priors and errors of heights need more.

        Parameters
        ----------
        size
            Height and width of the map.
        rows
            Most rows of a block, as for `integrate_in_blocks`; None for `integrate`.
        """
        height, width = size
        given = self.perspective * _CAMERA + self.jumps * _JUMPS
        if rows is None:
            return _FIXED + height * width * (_WHOLE + given + self.weighted * _SIGMA)
        blocks = plan_blocks(height, rows)
        largest: int = max(block.rows.stop - block.rows.start for block in blocks.blocks)
        shared = 2 * blocks.halo * (len(blocks.blocks) - 1)
        solving = width * (largest * (_BLOCK + given) + shared * _SHARED + height * _MASKS)
        # Its pixels have four of the map or more.
        search = min(_SEARCH, height * width // 4 * (_WHOLE + given))
        return _FIXED + max(solving, self.jumps * max(search, _JUMP_MAPS * height * width))

    def _in_blocks(self, size: Size) -> dict[int, int]:
        """Return the bytes for each number of rows of a block."""
        height, width = size
        found = {}
        for count in range(2, height // _ROWS):
            rows = -(-height // (count * _ROWS)) * _ROWS
            if rows not in found:
                solving = self.solving(size, rows)
                found[rows] = _PROGRAM + max(solving + height * width, _FINISHING * height * width)
        return found
