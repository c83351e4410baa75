"""Height of the surface, computed again whenever images or lights change."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from acquisition import Lights
from processing._reconstruction.near_height import NearHeight, near_height
from processing._reconstruction.recorded_images import Images
from processing._reconstruction.surface_points import SurfacePoints
from processing._reconstruction.views import View
from processing._stereo.method import Method
from rig import Progress


@dataclass(frozen=True, eq=False)
class Heights:
    """Where the surface is, from the images."""

    view: View | None
    mask: npt.NDArray[np.bool_]
    height_mm: float | None
    rests_on_plane: bool
    method: Method
    on_progress: Progress

    @property
    def stated(self) -> bool:
        """Whether the height does not have to be found."""
        return self.height_mm is not None or self.rests_on_plane

    def of(self, values: Images, lights: Lights) -> tuple[NearHeight | None, SurfacePoints | None]:
        """Return the height under near lights and the points; None under distant lights."""
        if self.view is None:
            return None, None
        near = near_height(
            values,
            lights,
            self.mask,
            self.view,
            method=self.method,
            height_mm=self.height_mm,
            rests_on_plane=self.rests_on_plane,
            on_step=lambda done, total: self.on_progress("height", done, total),
        )
        return near, SurfacePoints(self.view, near.depth, self.mask.shape)
