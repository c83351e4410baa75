"""Height as a 16-bit picture with its scale."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from processing._surface.height_map import HeightMap
from rig import check_type, short_repr

_TOP = 65535


class HeightPicture(NamedTuple):
    """A height map as 16-bit samples: the height is ``base + step * sample``, without one at 0.

    Parameters
    ----------
    pixels
        ``(H, W)`` uint16: 1 at the lowest point, 65535 at the highest, 0 outside the mask.
    base, step
        Scale in the unit of the height map.
    """

    pixels: npt.NDArray[np.uint16]
    base: float
    step: float

    def __repr__(self) -> str:
        return short_repr(self)


def height_picture(height_map: HeightMap) -> HeightPicture:
    """Encode a height map as 16-bit samples; the error is at most half a step.

    Examples
    --------
    >>> import numpy as np
    >>> from processing import NormalMap, height_picture, integrate
    >>> y, x = np.mgrid[1:-1:5j, -1:1:5j]
    >>> surface = integrate(NormalMap.from_vectors(np.dstack([x, y, 0 * x + 2])), pixel_mm=0.5)
    >>> picture = height_picture(surface)
    >>> heights_mm = picture.base + picture.step * picture.pixels
    >>> bool(np.abs(heights_mm - surface.height).max() <= picture.step)
    True
    """
    check_type("height_map", height_map, HeightMap, "integrate(normal_map) returns one")
    inside = height_map.height[height_map.mask].astype(np.float64)
    lowest, highest = float(inside.min()), float(inside.max())
    step = (highest - lowest) / (_TOP - 1) or 1.0
    pixels = np.zeros(height_map.mask.shape, np.uint16)
    pixels[height_map.mask] = np.rint(1 + (inside - lowest) / step).astype(np.uint16)
    return HeightPicture(pixels, lowest - step, step)
