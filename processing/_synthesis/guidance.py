"""Maps that guide a synthesis: checks, the guide of an exemplar, directions of curvature."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt
from scipy.ndimage import distance_transform_edt

from acquisition import DataError
from processing._curvature.curvature import curvature
from processing._normal_map import NormalMap

Float = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]

_LEAST_SCALE, _MOST_SCALE = 0.1, 10.0
_MOST_WEIGHT = 100.0
# Curvature is fitted over this share of a patch, and its direction smoothed over half a patch.
_FITTED, _SMOOTHED = 8, 2
_LEAST_FIT, _MOST_FIT = 2.0, 100.0


def checked_map(name: str, values: npt.ArrayLike, mask: Mask) -> Float:
    """Return a map as float32; outside the mask, it has the value of the nearest pixel inside.

    Raises
    ------
    DataError
        If the map has another size than the mask, or no number at a pixel of the mask.
    """
    array = np.asarray(values)
    if array.shape != mask.shape:
        has = f"{array.shape[1]} x {array.shape[0]} pixels" if array.ndim == 2 else "another shape"
        raise DataError(
            f"the {name} has {has}, but {mask.shape[1]} x {mask.shape[0]} are necessary: give a "
            "map with one value per pixel"
        )
    missing = np.count_nonzero(~np.isfinite(array[mask]))
    if missing:
        raise DataError(f"the {name} has no number at {missing} pixels inside the mask")
    y, x = distance_transform_edt(~mask, return_distances=False, return_indices=True)
    nearest: Float = array.astype(np.float32)[y, x]
    return nearest


def checked_scale(values: npt.ArrayLike, mask: Mask) -> Float:
    """Return a map of scales.

    Raises
    ------
    DataError
        Also if a scale is out of range.
    """
    scale = checked_map("scale map", values, mask)
    if scale.min() < _LEAST_SCALE or scale.max() > _MOST_SCALE:
        raise DataError(
            f"the scale map has values from {scale.min():.3g} to {scale.max():.3g}: use "
            f"{_LEAST_SCALE:g} to {_MOST_SCALE:g}"
        )
    return scale


def guide_pair(
    guide: npt.ArrayLike | None,
    exemplar_guide: npt.ArrayLike | None,
    weight: float,
    mask: Mask,
    exemplar_mask: Mask,
) -> tuple[Float, Float] | None:
    """Return both guides in standard deviations of the exemplar's, times the root of the weight.

    Raises
    ------
    DataError
        If only one is given, a size is wrong, a number is missing, or the guide of the exemplar is
        the same everywhere.
    """
    if not 0 < weight <= _MOST_WEIGHT:
        raise DataError(f"a weight of {weight:g} of the guide is out of range: use up to 100")
    if guide is None and exemplar_guide is None:
        return None
    if guide is None or exemplar_guide is None:
        raise DataError("a guide requires two maps: one of the target and one of the exemplar")
    own = checked_map("guide of the exemplar", exemplar_guide, exemplar_mask)
    aim = checked_map("guide of the target", guide, mask)
    spread = float(own[exemplar_mask].std(dtype=np.float64))
    if spread <= 1e-6 * float(np.abs(own[exemplar_mask]).max()):
        raise DataError("the guide of the exemplar is the same everywhere, so it guides nothing")
    factor = np.float32(np.sqrt(weight) / spread)
    return aim * factor, own * factor


def guide_copies(guide: Float, *, rotate: bool, mirror: bool) -> Float:
    """Return the guide of an exemplar for its copies, in the order of `prepare_exemplar`."""
    height, width = guide.shape
    side = (max(height, width), max(height, width)) if rotate else (height, width)
    copies = []
    for quarter in range(4 if rotate else 1):
        for flip in (False, True) if mirror else (False,):
            turned = np.rot90(guide, quarter)
            turned = turned[:, ::-1] if flip else turned
            copies.append(np.zeros(side, np.float32))
            copies[-1][: turned.shape[0], : turned.shape[1]] = turned
    return np.stack(copies).ravel()


def curvature_direction_deg(shape: NormalMap, patch: int) -> Float:
    """Return the direction of the largest curvature, smoothed, counter-clockwise from X.

    Directions are averaged as angles of lines, weighted by the difference of the two curvatures,
    so that parts where both are equal, and the direction arbitrary, take that of their
    surroundings. Known everywhere; on a plane it is 0.
    """
    fit = min(max(patch / _FITTED, _LEAST_FIT), _MOST_FIT)
    found = curvature(shape, scale_px=fit)
    first, second = found.principal
    angle = 2 * np.radians(np.where(found.mask, found.direction_deg, 0))
    weight = np.where(found.mask, first - second, 0)
    lines = np.dstack([weight * np.cos(angle), weight * np.sin(angle)]).astype(np.float32)
    sigma = patch / _SMOOTHED
    smooth = cv2.GaussianBlur(lines, (0, 0), sigma, borderType=cv2.BORDER_REFLECT_101)
    degrees: Float = (np.degrees(np.arctan2(smooth[..., 1], smooth[..., 0])) / 2).astype(np.float32)
    return degrees % np.float32(180)
