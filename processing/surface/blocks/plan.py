"""Blocks of rows of a surface, and the memory that its solution needs."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rig.arrays import Float64

# Pixels of the image per pixel of the coarse grid, along each side. A power of 2.
CELL = 8
# Rows that a block has in common with each neighbour, above and below the seam.
_HALO = 32
# A block has at least this many halos.
_LEAST_HALOS = 4


class Block(NamedTuple):
    """Rows of a block.

    Parameters
    ----------
    core
        Rows that belong to it.
    rows
        Rows that it solves: those and the halos.
    """

    core: slice
    rows: slice

    @property
    def inner(self) -> slice:
        """The core, counted from the first row."""
        first = self.core.start - self.rows.start
        return slice(first, first + self.core.stop - self.core.start)


class Blocks(NamedTuple):
    """All blocks of a surface.

    Parameters
    ----------
    blocks
        From the top downwards.
    halo
        Rows of a halo.
    """

    blocks: tuple[Block, ...]
    halo: int

    def shared(self, seam: int) -> slice:
        """Return the rows that a block and the next one share."""
        cut = self.blocks[seam].core.stop
        return slice(cut - self.halo, cut + self.halo)

    def share_of_upper(self) -> Float64:
        """Return the shares of the upper block in the rows that two blocks share: 1 to 0."""
        place = np.arange(2 * self.halo) / (2 * self.halo - 1)
        return np.asarray(0.5 + 0.5 * np.cos(np.pi * place), np.float64)


def plan_blocks(height: int, rows: int) -> Blocks:
    """Divide an image into blocks of about equal height.

    Parameters
    ----------
    height
        Rows of the image.
    rows
        Most rows of a block, without halos.
    """
    rows = max(rows // CELL * CELL, _LEAST_HALOS * CELL)
    count = -(-height // rows)
    # The last block is not too low for its halo.
    step = max(-(-height // (count * CELL)) * CELL, _LEAST_HALOS * CELL)
    halo = max(min(_HALO, step // _LEAST_HALOS // CELL * CELL), CELL)
    tops = [top for top in range(0, height, step) if top == 0 or height - top >= 2 * halo]
    ends = [*tops[1:], height]
    return Blocks(
        tuple(
            Block(slice(top, end), slice(max(top - halo, 0), min(end + halo, height)))
            for top, end in zip(tops, ends, strict=True)
        ),
        halo,
    )
