"""Parts of blocks that are parts of one surface."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy import sparse
from scipy.sparse import csgraph, linalg

from processing._blocks.seams import Side

Double = npt.NDArray[np.float64]
Labels = npt.NDArray[np.int32]


class LocalParts:
    """The parts of all blocks: which hang together, and the constants between their solutions.

    Parts are numbered over all blocks, from the top downwards.
    """

    def __init__(self) -> None:
        self.count = 0
        self._pairs: list[npt.NDArray[np.int64]] = []
        self._sizes: list[Double] = []
        self._means: list[Double] = []

    def add(self, labels: Labels, count: int) -> Labels:
        """Return the labels of a block with the numbers of its parts over all blocks."""
        numbered = np.where(labels >= 0, labels + np.int32(self.count), np.int32(-1))
        self.count += count
        return numbered

    def meet(self, upper: Side, lower: Side) -> None:
        """Add the two solutions in shared rows."""
        both = (upper.labels >= 0) & (lower.labels >= 0)
        if not both.any():
            return
        code = upper.labels[both].astype(np.int64) * self.count + lower.labels[both]
        codes, members = np.unique(code, return_inverse=True)
        sizes = np.bincount(members)
        self._pairs.append(np.stack([codes // self.count, codes % self.count]))
        self._sizes.append(sizes.astype(np.float64))
        self._means.append(np.bincount(members, upper.u[both] - lower.u[both]) / sizes)

    def joined(self) -> tuple[Labels, int]:
        """Return the part of the surface of each part of a block, and their number.

        They are numbered in the order of their first parts.
        """
        count, members = csgraph.connected_components(self._matrix(), directed=False)
        _, first = np.unique(members, return_index=True)
        number = np.zeros(count, np.int32)
        number[np.argsort(first)] = np.arange(count, dtype=np.int32)
        return number[members], count

    def constants(self) -> Double:
        """Return the constants that bring the solutions together, by least squares."""
        constants = np.zeros(self.count)
        if not self._pairs:
            return constants
        upper, lower = np.concatenate(self._pairs, axis=1)
        weights, means = np.concatenate(self._sizes), np.concatenate(self._means)
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

    def _matrix(self, weights: Double | None = None) -> sparse.csr_array:
        if not self._pairs:
            return sparse.csr_array((self.count, self.count))
        upper, lower = np.concatenate(self._pairs, axis=1)
        values = np.ones(len(upper)) if weights is None else weights
        one = sparse.coo_array((values, (upper, lower)), (self.count, self.count))
        return sparse.csr_array(one + one.T)
