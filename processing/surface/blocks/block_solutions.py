"""The solutions of all blocks, which differ in the rows that two of them share."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from processing.surface.blocks.block_files import BlockFiles
from rig.arrays import Float32, Float64, Int32


class Side(NamedTuple):
    """One of the two solutions in the shared rows.

    Parameters
    ----------
    u
        ``(2h, W)`` solution, up to a constant for each part.
    labels
        ``(2h, W)`` part of each pixel, numbered over all blocks; -1 for pixels without edges.
    """

    u: Float64
    labels: Int32


class Seam(NamedTuple):
    """Rows that two blocks share.

    Parameters
    ----------
    rows
        The rows of the image.
    share
        ``(2h,)`` share of the upper block in the blend, 1 to 0.
    down
        ``(2h, W)`` weights of the edges to the next row.
    difference
        ``(2h, W)`` solution of the upper block minus that of the lower one; 0 where one has none.
    """

    rows: slice
    share: Float64
    down: Float32
    difference: Float64

    def residual(self, difference: Float64) -> Float64:
        """Return the residual ``(2h, W)`` of the blend of two solutions with this difference."""
        found = np.zeros_like(difference)
        change = (self.share[:-1] - self.share[1:])[:, None] * self.down[:-1]
        found[:-1] -= change * difference[1:]
        found[1:] += change * difference[:-1]
        return found

    @property
    def largest(self) -> float:
        """Largest difference that the blend does not hide: where both have a share."""
        hidden = (self.share * (1 - self.share))[:, None]
        return float(4 * np.abs(hidden * self.difference).max())


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
        self.files.remove(f"solution-{number}-{after - 1}")

    def all_advanced(self, after: int) -> None:
        """Use the solutions after a round."""
        self._after = [after] * len(self._after)

    def solution(self, number: int, rows: slice = slice(None)) -> Side:
        """Return rows of the solution of a block, counted from its first one."""
        u = self.files.read(f"solution-{number}-{self._after[number]}", rows)
        labels = self.files.read(f"labels-{number}", rows)
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
