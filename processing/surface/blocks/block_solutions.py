"""The solutions of all blocks, which differ in the rows that two of them share."""

from __future__ import annotations

import numpy as np

from processing.surface.blocks.block_files import BlockFiles
from processing.surface.blocks.seams import Seam, Side
from rig.arrays import Float64


class OwnSolutions:
    """The solution of each block after some rounds, in files.

    Parameters
    ----------
    files
        The files.
    constants
        What is added to each part of a block before the first round.
    """

    def __init__(self, files: BlockFiles, constants: Float64) -> None:
        self.files, self.blocks, self.constants = files, files.blocks, constants
        self._after = [0] * len(files.blocks.blocks)

    def advanced(self, number: int, after: int) -> None:
        """Use the solution of a block after a round, and remove that before it."""
        self._after[number] = after
        self.files.remove_solution(number, after - 1)

    def all_advanced(self, after: int) -> None:
        """Use the solutions after a round."""
        self._after = [after] * len(self._after)

    def solution(self, number: int, rows: slice = slice(None)) -> Side:
        """Return rows of the solution of a block, counted from its first one."""
        u = self.files.solution(number, self._after[number], rows)
        labels = self.files.labels(number, rows)
        if not self._after[number]:
            u += np.append(self.constants, 0)[labels]
        return Side(u, labels)

    def seam(self, number: int) -> Seam:
        """Return what a block shares with the next one."""
        rows, shared = self.blocks.shared(number), 2 * self.blocks.halo
        upper = self.solution(number, slice(-shared, None))
        lower = self.solution(number + 1, slice(shared))
        both = (upper.labels >= 0) & (lower.labels >= 0)
        difference = np.where(both, upper.u - lower.u, 0)
        down = np.ascontiguousarray(self.files.weights[rows][:, 1])
        return Seam(rows, self.blocks.share_of_upper(), down, difference)

    def blended(self, number: int) -> Side:
        """Return the core of a block, blended with its neighbours in shared rows."""
        block, halo = self.blocks.blocks[number], self.blocks.halo
        own = self.solution(number, block.inner)
        share = self.blocks.share_of_upper()[:, None]
        if number:
            above = self.solution(number - 1, slice(-halo, None))
            _mix(own.u[:halo], above, share[halo:])
        if number + 1 < len(self.blocks.blocks):
            below = self.solution(number + 1, slice(halo))
            _mix(own.u[-halo:], below, 1 - share[:halo])
        return own


def _mix(u: Float64, other: Side, share: Float64) -> None:
    """Give another solution a share, which is 0 where it may lack pixels: in its outermost row."""
    u += np.where(other.labels >= 0, share * (other.u - u), 0)
