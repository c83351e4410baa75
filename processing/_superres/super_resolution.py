"""The result of super-resolution, with what was invented and how uncertain it is."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
import numpy.typing as npt

from processing._detail.separation import sums_of_rows
from processing._normal_map import NormalMap
from processing._superres.model import SuperResolutionModel

Float = npt.NDArray[np.float32]
SuperResolutionMethod = Literal["bicubic", "normals", "detail"]
# What a normal is: the mean over the area of its pixel, or the normal at its centre.
PixelSampling = Literal["area", "points"]


@dataclass(frozen=True, eq=False)
class SuperResolution:
    """A normal map of a higher resolution.

    Parameters
    ----------
    normal_map
        The map.
    sigma_deg
        ``(H, W)`` float32, predicted root mean square angle to the true normal at this resolution,
        NaN outside the mask; None for bicubic interpolation, which predicts none.
    added_deg
        ``(H, W)`` float32, angle between the map and interpolation without a network, 0 outside the
        mask.
    invented
        ``(H, W)`` float32, share of the detail of each pixel that the network added: the square of
        `added_deg` relative to its sum with the square of the angle between interpolation and shape
        component; 0 to 1, and 0 outside the mask.
    invented_share
        The same ratio of the means over the mask.
    method
        How the map was made.
    scale
        Factor of the resolution.
    model
        The network; None for bicubic interpolation.
    self_ensemble
        Whether the results of turned copies were averaged.
    """

    normal_map: NormalMap
    sigma_deg: Float | None
    added_deg: Float
    invented: Float
    invented_share: float
    method: SuperResolutionMethod
    scale: int
    model: SuperResolutionModel | None
    self_ensemble: bool

    def __repr__(self) -> str:
        return f"SuperResolution({self.normal_map!r}, {self.method}, x{self.scale})"

    @cached_property
    def median_sigma_deg(self) -> float:
        """Median of `sigma_deg` over the mask, NaN for bicubic interpolation."""
        if self.sigma_deg is None:
            return float("nan")
        return float(np.median(self.sigma_deg[self.normal_map.mask]))

    @cached_property
    def mean_added_deg(self) -> float:
        """Mean of `added_deg` over the mask."""
        mask = self.normal_map.mask
        return float(sums_of_rows(self.added_deg, mask).sum() / np.count_nonzero(mask))
