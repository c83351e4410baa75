"""Images of a camera that drifts, moved back so that the spheres are at one place."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import ceil

import cv2
import numpy as np

from calibration.radiance import moved_values, structure_shifts
from calibration.radiance.stack import Images
from calibration.spheres.judge.sphere_shifts import sphere_shifts
from calibration.spheres.outline.sphere_image import SphereImage, places
from rig import Notice, figure, short_repr
from rig.arrays import Bool, Float32, Float64

SpheresIn = Callable[[Images], tuple[list[SphereImage], list[Notice]]]

# Images are compared in at most so many blocks along a side, first and then.
_BLOCKS = 220, 880
_ROUNDS, _SETTLED_PX, _FEWEST = 4, 0.2, 3
# Spheres move as the rest of the image does, which is known to this many blocks; a sphere that is
# nearer to the camera by a tenth of the distance moves further by a tenth.
_SAME_BLOCKS, _NEARER = 2.5, 0.1
# Standard deviation of the place of a sphere in one image, along each axis.
FOLLOWED_PX = 0.1


@dataclass(frozen=True, eq=False)
class Drift:
    """How a camera drifted, and where images do not show the spheres.

    Parameters
    ----------
    shifts_px
        ``(N, 2)`` right and down.
    values
        The images, moved back, for the outlines.
    sharp
        The images, moved back by whole pixels, for the highlights.
    unseen
        What to say about images in which a sphere is outside, or was moved alone.
    """

    shifts_px: Float64
    values: Images
    sharp: Images
    unseen: dict[int, str]

    __repr__ = short_repr


def follow_camera(values: Images, usable: Sequence[int], spheres_in: SpheresIn) -> Drift:
    """Follow a camera by what all images show, and then by the outlines of the spheres.

    Parameters
    ----------
    values
        ``(N, H, W)`` linear images, NaN where saturated.
    usable
        Images that are neither black nor white.
    spheres_in
        Finds the spheres in some images.

    Raises
    ------
    EstimateError
        If ``spheres_in`` finds no sphere.
    """
    height, width = values.shape[1:]
    size, fine = (ceil(max(height, width) / blocks) for blocks in _BLOCKS)
    rough = np.zeros((len(values), 2))
    rough[list(usable)] = size * structure_shifts([_blocks(values[k], size) for k in usable])
    if fine < size:  # fine blocks are more accurate, but may be far off
        moved = moved_values(values, rough)
        rest = np.zeros_like(rough)
        rest[list(usable)] = fine * structure_shifts([_blocks(moved[k], fine) for k in usable])
        rough += np.where(np.hypot(*rest.T) < _SAME_BLOCKS * size, rest.T, 0).T
    shifts = rough.copy()
    shown, spheres = list(usable), list[SphereImage]()
    unseen: dict[int, str] = {}
    for _ in range(_ROUNDS):
        moved = moved_values(values, shifts)
        spheres, _ = spheres_in(moved[shown])
        whole = _whole(spheres, shifts, (height, width))
        shown = [k for k in usable if whole[k]]
        unseen = {k: f"{places(spheres)} is outside the image" for k in usable if not whole[k]}
        if len(shown) < _FEWEST:
            break
        by = np.mean([sphere_shifts(moved[shown], sphere.outline) for sphere in spheres], axis=0)
        off = shifts[shown] + by - rough[shown]
        far_px = np.hypot(*(off - np.median(off, axis=0)).T)
        same = far_px < _SAME_BLOCKS * size + _NEARER * np.hypot(*rough[shown].T)
        for k, far in zip(np.array(shown)[~same], far_px[~same], strict=True):
            text = f"{places(spheres)} moved by {figure(far)} px against the rest of the image"
            unseen[int(k)] = text
        shown = [k for k in shown if k not in unseen]
        shifts[shown] += by[same]
        if np.abs(by[same]).max(initial=0.0) < _SETTLED_PX:
            break
    sharp = moved_values(values, np.rint(shifts))
    return Drift(shifts, moved_values(values, shifts), sharp, unseen)


def _blocks(image: Float32, size: int) -> Float32:
    """Return the means over blocks."""
    rows, columns = (length // size for length in image.shape)
    part = np.where(np.isnan(image), np.float32(1), image)[: rows * size, : columns * size]
    return np.asarray(cv2.resize(part, (columns, rows), interpolation=cv2.INTER_AREA), np.float32)


def _whole(spheres: Sequence[SphereImage], shifts: Float64, size: tuple[int, int]) -> Bool:
    """Return the images inside of which all spheres are."""
    whole = np.ones(len(shifts), np.bool_)
    for sphere in spheres:
        at = np.array(sphere.outline.centre_px) + shifts
        radius = sphere.outline.radius_px
        whole &= np.all((at >= radius) & (at <= np.array(size[::-1]) - 1 - radius), axis=1)
    return whole
