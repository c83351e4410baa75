"""Parts of blocks that are parts of one surface."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph, linalg

from processing.surface.blocks.block_solutions import Side
from rig.arrays import Float64, Int32, Int64


class Meeting(NamedTuple):
    """The parts of two neighbouring blocks that have pixels in common.

    Parameters
    ----------
    pairs
        ``(2, N)`` parts of the upper and of the lower block, numbered over all blocks.
    sizes
        Number of pixels that they have in common.
    means
        Mean difference of their solutions, the upper one minus the lower one.
    """

    pairs: Int64
    sizes: Float64
    means: Float64


NO_MEETING = Meeting(np.zeros((2, 0), np.int64), np.zeros(0), np.zeros(0))


def meeting_of(upper: Side, lower: Side) -> Meeting:
    """Return which parts meet in the rows that two blocks share."""
    both = (upper.labels >= 0) & (lower.labels >= 0)
    if not both.any():
        return NO_MEETING
    count = int(lower.labels.max()) + 1
    code = upper.labels[both].astype(np.int64) * count + lower.labels[both]
    codes, members = np.unique(code, return_inverse=True)
    sizes = np.bincount(members).astype(np.float64)
    means = np.bincount(members, upper.u[both] - lower.u[both]) / sizes
    return Meeting(np.stack([codes // count, codes % count]), sizes, means)


@dataclass(frozen=True, eq=False)
class LocalParts:
    """The parts of all blocks: which hang together, and the constants between their solutions.

    Parameters
    ----------
    count
        Their number. They are numbered over all blocks, from the top downwards.
    meeting
        Those of neighbouring blocks that have pixels in common.
    """

    count: int
    meeting: Meeting

    def joined(self) -> tuple[Int32, int]:
        """Return the part of the surface of each part of a block, and their number.

        They are numbered in the order of their first parts.
        """
        count, members = csgraph.connected_components(self._matrix(), directed=False)
        _, first = np.unique(members, return_index=True)
        number = np.zeros(count, np.int32)
        number[np.argsort(first)] = np.arange(count, dtype=np.int32)
        return number[members], count

    def constants(self) -> Float64:
        """Return the constants that bring the solutions together, by least squares."""
        constants = np.zeros(self.count)
        (upper, lower), weights, means = self.meeting
        # The first part of each that hang together keeps its heights.
        joined, _ = self.joined()
        free = np.ones(self.count, bool)
        free[np.unique(joined, return_index=True)[1]] = False
        if not free.any():
            return constants
        adjacency = self._matrix(weights)
        matrix = sparse.csr_array(sparse.diags_array(adjacency.sum(axis=0)) - adjacency)
        load = np.bincount(lower, weights * means, self.count)
        load -= np.bincount(upper, weights * means, self.count)
        inner = sparse.csc_array(matrix[free][:, free])
        constants[free] = linalg.spsolve(inner, load[free])
        return constants

    def _matrix(self, weights: Float64 | None = None) -> sparse.csr_array:
        upper, lower = self.meeting.pairs
        values = np.ones(len(upper)) if weights is None else weights
        one = sparse.coo_array((values, (upper, lower)), (self.count, self.count))
        return sparse.csr_array(one + one.T)
