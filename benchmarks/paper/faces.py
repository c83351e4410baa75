"""The faces that are transferred to other surfaces, with their positions."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

import processing
from rig.arrays import Bool

# The paper's granularity for faces.
FACE_W = 10


class Face(NamedTuple):
    """A face of one DiLiGenT map and its place on another.

    Parameters
    ----------
    source, target
        Names of the maps.
    ellipse
        Ellipse around the face: column, row and half axes, in pixels of the source.
    pose
        Its place on the target.
    """

    source: str
    target: str
    ellipse: tuple[int, int, int, int]
    pose: processing.detail.Pose

    def set_in(
        self,
        source: processing.NormalMap,
        target: processing.NormalMap,
        *,
        order: int = 8,
        reach_px: float | None = None,
    ) -> processing.detail.LocalTransferResult:
        """Transfer the face to the target at the paper's granularity."""
        x, y, across, down = self.ellipse
        rows, columns = np.ogrid[: source.size[0], : source.size[1]]
        part: Bool = ((columns - x) / across) ** 2 + ((rows - y) / down) ** 2 <= 1
        return processing.transfer_local(
            source,
            target,
            source_mask=part,
            pose=self.pose,
            shape_filter=processing.ShapeFilter(order=order, w=FACE_W),
            reach_px=reach_px,
        )


FACES: Mapping[str, Face] = {
    "Cat onto Bear": Face(
        "cat",
        "bear",
        (390, 166, 45, 35),
        processing.detail.Pose((303, 188), scale=1.2, rotate_deg=6),
    ),
    "Buddha onto Bear": Face(
        "buddha",
        "bear",
        (305, 118, 27, 34),
        processing.detail.Pose((303, 185), scale=1.5, mirror=True),
    ),
}
