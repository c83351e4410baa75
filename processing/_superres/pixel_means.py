"""Pixels as means over their area: made of points, and what a result keeps of the given ones."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from processing._normal_map import NormalMap
from processing._superres.filling import filled_outwards
from processing._superres.interpolation import REACH_PX, averaged, units

Float = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]


def means_of_points(normal_map: NormalMap, scale: int) -> NormalMap:
    """Return the means over pixels of a map that has the normals at their centres.

    Parameters
    ----------
    normal_map
        The map. It is continued beyond its mask first.
    scale
        How many pixels of the higher resolution are in a pixel, in each direction.
    """
    mask = normal_map.mask
    means = units(averaged(filled_outwards(normal_map.normals, mask, REACH_PX), scale))
    return NormalMap.of_unit_vectors(np.where(mask[..., None], means, np.float32(0)), mask)


def with_given(high: Float, low: Float, mask: Mask, side: int) -> Float:
    """Turn the normals of each large pixel alike, so that the mean of the inner ones is as given.

    Small errors that all normals of a pixel have in common add up to large errors of heights. The
    difference of the means is added once, which leaves an error of the second order.

    Parameters
    ----------
    high
        ``(s h, s w, 3)`` unit vectors.
    low
        ``(h, w, 3)`` unit vectors, the given normals.
    mask
        ``(s h, s w)`` where `high` is part of a map. Large pixels that are not complete stay as
        they are.
    side
        Side of the inner square: s for given means, 2 for given normals at the centres.
    """
    height, width = low.shape[:2]
    scale = len(high) // height
    blocks = high.reshape(height, scale, width, scale, 3)
    complete = mask.reshape(height, scale, width, scale).all(axis=(1, 3))
    inner = slice((scale - side) // 2, (scale + side) // 2)
    difference = low - units(blocks[:, inner, :, inner].mean(axis=(1, 3)))
    difference[~complete] = 0
    return units((blocks + difference[:, None, :, None]).reshape(high.shape))
