"""Alignment of the images of a recording whose camera or object moved."""

from __future__ import annotations

from typing import Final, Literal, NamedTuple

import numpy as np

from acquisition import Lights
from calibration import EstimateError
from processing.images.recorded_images import RecordedImages
from processing.images.viewing_rays import View
from processing.registration import ImageShifts, find_image_shifts
from rig import Notice, pluralize
from rig.arrays import Bool, Float64

# ``auto``: if images are surely shifted; ``always``: also by less; ``off``: never.
AlignChoice = Literal["auto", "off", "always"]

# Shifts that are corrected by default, and those that are left as they are.
_SHIFTED_PX: Final = 0.15
_LEFT_PX: Final = 0.05
# Below this, a first look is enough.
_STILL_PX: Final = 0.1


class Alignment(NamedTuple):
    """Shifts to correct, by the ids of the lights, and what to report."""

    shifts_px: dict[str, tuple[float, float]]
    notices: list[Notice]


def find_alignment(
    images: RecordedImages, lights: Lights, mask: Bool, view: View | None, choice: AlignChoice
) -> Alignment:
    """Find by how much images are shifted, and decide which are moved back.

    Parameters
    ----------
    images
        N images.
    lights
        Their lights.
    mask
        ``(H, W)`` bool, the object.
    view
        How the pixels see points under near lights; None under distant ones.
    choice
        When to align.

    Raises
    ------
    EstimateError
        If shifts must be found, and the images do not determine them.
    """
    nothing = Alignment({}, [])
    if choice == "off":
        return nothing

    def vectors_at(rows: Float64, columns: Float64) -> Float64:
        height, width = mask.shape
        down = np.clip(np.rint(rows), 0, height - 1).astype(int)
        right = np.clip(np.rint(columns), 0, width - 1).astype(int)
        points = np.zeros((len(down), 3))
        if view is not None:
            numbers, of_row = np.unique(down, return_inverse=True)
            points = view.points_of(numbers, view.distance_mm)[of_row, right]
        return np.moveaxis(lights.vectors_at(points), 0, 1)

    forced = choice == "always"
    try:
        found = find_image_shifts(images, mask, vectors_at, 0.0 if forced else _STILL_PX)
        if not found.determined:
            raise EstimateError(
                "the images show too little structure to align them: fine detail or paint is needed"
            )
    except EstimateError:
        if forced:
            raise
        return nothing
    least_px = _LEFT_PX if forced else _SHIFTED_PX
    if not found.significant(least_px).any() or not (forced or found.real):
        return nothing
    moved = np.hypot(*found.shifts_px.T) > _LEFT_PX
    shifts = {
        name: (right, down)
        for name, (right, down), one in zip(
            images.ids, found.shifts_px.tolist(), moved, strict=True
        )
        if one
    }
    return Alignment(shifts, [_notice(found, len(shifts))])


def _notice(found: ImageShifts, count: int) -> Notice:
    left = float(np.hypot(*found.sigma_px.T).max())
    text = (
        f"camera or object moved: {pluralize(count, 'image was', 'images were')} moved back by up "
        f"to {found.largest_px:.2g} px, and what is left is about {left:.1g} px"
    )
    return Notice("images-aligned", text, severity="info")
