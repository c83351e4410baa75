"""Law of the noise of samples that are combined from several colours."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from calibration import StackNoise, luma

Float = npt.NDArray[np.float32]
Double = npt.NDArray[np.float64]


def over_colours(values: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return the sums over the last axis, of length 3; `numpy.sum` takes ten times as long."""
    return np.asarray(values[..., 0] + values[..., 1] + values[..., 2])


@dataclass(frozen=True, eq=False, repr=False)
class JointNoise(StackNoise):
    """Law of the noise of combined samples: the reciprocal of the sum of the precisions.

    Parameters
    ----------
    colours
        ``(H, W, 3)`` colours with which the samples were combined.
    values
        ``(N, H, W, 3)`` the stack, which says which of its samples were measured.
    """

    colours: Float = field(default_factory=lambda: np.zeros((0, 0, 3), np.float32))
    values: Float = field(default_factory=lambda: np.zeros((0, 0, 0, 3), np.float32))

    @classmethod
    def of(cls, noise: StackNoise, colours: Float, values: Float) -> JointNoise:
        """Return the law of the combined samples of a stack with this noise."""
        return cls(**vars(noise), colours=colours, values=values)

    @property
    def linear(self) -> bool:
        """The shares of the colours change with the signal."""
        return False

    def variance(self, image: int, values: npt.ArrayLike, first_row: int = 0) -> Double:
        """Return the variance of combined samples ``(R, W)``; see `StackNoise.variance`."""
        signal = np.asarray(values, np.float64)
        rows = slice(first_row, first_row + len(signal))
        colours, measured = self.colours[rows], np.isfinite(self.values[image, rows])
        gray = luma(colours).astype(np.float64)
        shading = np.divide(np.maximum(signal, 0), gray, out=np.zeros_like(gray), where=gray > 0)
        of_colours = super().variance(image, colours * shading[..., None], first_row)
        precision = over_colours(measured * colours**2 / of_colours)
        # A sample that no colour determines is not there; any variance does for it.
        unseen = np.ones_like(gray)
        return np.asarray(np.divide(gray**2, precision, out=unseen, where=precision > 0))

    def take(self, indices: list[int]) -> Self:
        """Return the law of the images with these indices, in this order."""
        return replace(super().take(indices), values=self.values[indices])

    def rows(self, first: int, last: int) -> Self:
        """Return the law of some rows, see `StackNoise.rows`."""
        return replace(
            super().rows(first, last),
            colours=self.colours[first:last],
            values=self.values[:, first:last],
        )
