"""What two neighbouring blocks have in common: shared rows with two solutions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rig.arrays import Float32, Float64, Int32


@dataclass(eq=False)
class Seam:
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


@dataclass(eq=False)
class Side:
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
