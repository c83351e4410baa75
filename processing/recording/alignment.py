"""Alignment of the images of a recording whose camera or object moved."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, Literal, NamedTuple

import numpy as np

from acquisition import Lights
from calibration import EstimateError
from processing.images.recorded_images import RecordedImages
from processing.images.viewing_rays import View
from processing.registration import find_image_shifts
from rig import Notice, pluralize
from rig.arrays import Bool, Float64

# ``auto``: if images are surely shifted; ``always``: also by less; ``off``: never.
AlignChoice = Literal["auto", "off", "always"]

# Shifts that are corrected by default, and those that are left as they are.
_SHIFTED_PX: Final = 0.15
_LEFT_PX: Final = 0.05
# What is left of shifts of spheres: they are nearer to the camera than parts of the object.
_BY_SPHERES_PX: Final = 1.0
# Below this, a first look is enough.
_STILL_PX: Final = 0.1


class Alignment(NamedTuple):
    """Shifts to correct, by the ids of the lights, and what to report."""

    shifts_px: dict[str, tuple[float, float]]
    notices: list[Notice]


def find_alignment(
    images: RecordedImages,
    lights: Lights,
    mask: Bool,
    view: View | None,
    choice: AlignChoice,
    known_px: Mapping[str, tuple[float, float]],
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
    known_px
        By how much the images have been moved back already, by the ids of the lights, as spheres
        in them show. These shifts are refined if the object shows enough structure.

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

    forced, known = choice == "always", bool(known_px)
    before = np.array([known_px.get(name, (0.0, 0.0)) for name in images.ids])
    try:
        found = find_image_shifts(images, mask, vectors_at, 0.0 if forced or known else _STILL_PX)
        if not found.determined:
            raise EstimateError(
                "the images show too little structure to align them: fine detail or paint is needed"
            )
    except EstimateError:
        if forced:
            raise
        return Alignment(dict(known_px), [_notice(before, _BY_SPHERES_PX)] if known else [])
    if not known:
        least_px = _LEFT_PX if forced else _SHIFTED_PX
        if not found.significant(least_px).any() or not (forced or found.real):
            return nothing
    shifts = before + found.shifts_px
    shifts -= np.median(shifts, axis=0)
    moved = np.hypot(*shifts.T) > _LEFT_PX
    by_name = {
        name: (right, down)
        for name, (right, down), one in zip(images.ids, shifts.tolist(), moved, strict=True)
        if one
    }
    return Alignment(by_name, [_notice(shifts[moved], float(np.hypot(*found.sigma_px.T).max()))])


def _notice(shifts_px: Float64, left_px: float) -> Notice:
    largest = float(np.hypot(*shifts_px.T).max(initial=0.0))
    count = len(shifts_px)
    text = (
        f"camera or object moved: {pluralize(count, 'image was', 'images were')} moved back by up "
        f"to {largest:.2g} px, and what is left is about {left_px:.1g} px"
    )
    return Notice("images-aligned", text, severity="info")
