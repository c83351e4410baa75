"""Highlights at the border of the image that belong to no sphere that was found."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from calibration._spheres.robust import Array
from calibration._spheres.sphere_image import SphereImage
from calibration._spheres.spots import ReducedStack
from rig import Notice, pluralize

# Highlights this close to the border, relative to the shorter side, may be those of a cut sphere;
# those of one sphere are not farther apart, and half of them are closer to the border: the others
# are beyond it.
_MARGIN, _CLOSE = 0.1, 0.05
# One light may glint anywhere.
_LEAST_LIGHTS = 3
_LEAST_SHARE = 0.2
# The mirror image of an LED lies within the outline; glare around it may reach beyond.
_INSIDE = 1.1


def cut_spheres(stack: ReducedStack, found: list[SphereImage]) -> list[Notice]:
    """Return a notice for each group of highlights at the border without a sphere.

    The frame cuts a sphere off, and what is visible of it does not determine its outline.

    Parameters
    ----------
    stack
        The images at a lower resolution.
    found
        The spheres that were found, whose highlights do not count.
    """
    spots = stack.spots
    rows, columns = stack.peak.shape[1:]
    margin = _MARGIN * min(rows, columns)
    x, y = spots[:, 1], spots[:, 2]
    to_border = np.minimum(np.minimum(x, columns - 1 - x), np.minimum(y, rows - 1 - y))
    alone = to_border <= margin
    places = stack.full_px(spots[:, 1:3])
    for sphere in found:
        outline = sphere.outline
        reach = _INSIDE * outline.radius_px
        alone &= np.linalg.norm(places - outline.centre_px, axis=1) > reach
    lights, places, to_border = spots[alone, 0].astype(int), places[alone], to_border[alone]
    least = max(_LEAST_LIGHTS, _LEAST_SHARE * len(stack.peak))
    notices = []
    for group in _groups(places, margin * stack.factor):
        count = len(np.unique(lights[group]))
        if count >= least and np.median(to_border[group]) <= _CLOSE * min(rows, columns):
            notices.append(_notice(count, np.median(places[group], axis=0)))
    return notices


def _groups(places: Array, reach: float) -> list[npt.NDArray[np.intp]]:
    """Return the indices of places that are less than ``reach`` from the next one."""
    left = list(range(len(places)))
    groups = []
    while left:
        group = [left.pop()]
        for member in group:
            apart = np.linalg.norm(places[left] - places[member], axis=1)
            near = [index for index, distance in zip(left, apart, strict=True) if distance < reach]
            group += near
            left = [index for index in left if index not in near]
        groups.append(np.array(sorted(group)))
    return groups


def _notice(lights: int, centre_px: Array) -> Notice:
    x, y = centre_px
    text = (
        f"a sphere at ({x:.0f}, {y:.0f}) px is not used: "
        f"{pluralize(lights, 'light')} shine in it, but too little of it is in the image for its "
        "outline; move it into the field, or ignore this"
    )
    return Notice("sphere-cut", text)
