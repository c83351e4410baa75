"""Level of detection: the smallest change that would have been found."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.special import erf

from processing.changes.significance import HALF, TURN, Response, power_of, template
from rig import short_repr
from rig.arrays import Float64

# Full widths at half depth of scratches and spots, in pixels.
WIDTHS_PX: Final = (0.4, 1.0, 2.0, 4.0)
# A scratch is at least this long.
LENGTH_PX: Final = 20.0
# Full width at half maximum of a Gaussian, in standard deviations.
FWHM: Final = 2.3548
# A change that is this far above the threshold is found with 95 %.
_POWER: Final = 1.645


@dataclass(frozen=True, eq=False)
class DetectionLevel:
    """Depth of a scratch and of a round spot that would have been found with 95 %.

    Parameters
    ----------
    width_px
        Full width at half depth.
    scratch, spot
        Depths in pixels at a usual place, the median of the map.
    scratch_worst, spot_worst
        Depths in pixels at all but 5 % of the places.
    """

    width_px: float
    scratch: float
    spot: float
    scratch_worst: float
    spot_worst: float

    __repr__ = short_repr


class DetectionLevels:
    """Levels from the standard deviations of all templates.

    Parameters
    ----------
    blur_px
        Standard deviation of the blur of the maps.
    """

    def __init__(self, blur_px: float) -> None:
        self._changes = [
            (_change(width, blur_px, long=True), _change(width, blur_px, long=False))
            for width in WIDTHS_PX
        ]
        # Signal over noise of a change of depth 1.
        self._best = np.zeros((len(WIDTHS_PX), 2, 2))

    def add(self, response: Response) -> None:
        """Take the standard deviations of a template into account."""
        sigma = response.sigma[np.isfinite(response.sigma)]
        if not sigma.size:
            return
        quantiles = np.quantile(sigma[:: 1 + sigma.size // 100_000], [0.5, 0.95])
        # Scratches between two directions of templates are the worst ones.
        angle = None if response.angle is None else TURN / 2
        gradient = template(response.scale_px, angle)
        power = power_of(response.scale_px, angle)
        for row, changes in enumerate(self._changes):
            for kind, change in enumerate(changes):
                shared = sum(float((a * b).sum()) for a, b in zip(gradient, change, strict=True))
                self._best[row, kind] = np.maximum(
                    self._best[row, kind], shared / power / quantiles
                )

    def found(self, threshold: float) -> list[DetectionLevel]:
        """Return the levels, infinite if nothing was compared."""
        with np.errstate(divide="ignore"):
            depths = (threshold + _POWER) / self._best
        return [
            DetectionLevel(width, scratch[0], spot[0], scratch[1], spot[1])
            for width, (scratch, spot) in zip(WIDTHS_PX, depths.tolist(), strict=True)
        ]


def _change(width: float, blur: float, *, long: bool) -> tuple[Float64, Float64]:
    """Return derivatives along columns and rows of a blurred change of depth 1."""
    own = width / FWHM
    sigma = math.hypot(own, blur)
    row, column = np.mgrid[-HALF : HALF + 1, -HALF : HALF + 1].astype(float)
    if not long:
        height = (own / sigma) ** 2 * np.exp(-0.5 * (row**2 + column**2) / sigma**2)
        return -column / sigma**2 * height, -row / sigma**2 * height
    ends = (LENGTH_PX / 2 - np.abs(column)) / (math.sqrt(2) * sigma)
    height = own / sigma * np.exp(-0.5 * (row / sigma) ** 2) * (1 + erf(ends)) / 2
    return np.gradient(height, axis=1), -row / sigma**2 * height
