"""Height as a 16-bit picture with its scale."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from acquisition import MapRows
from acquisition.files import ComputedRows
from processing.surface.height_map import HeightMap
from rig import check_type, short_repr
from rig.arrays import Float32, UInt16

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

    pixels: MapRows
    base: float
    step: float

    def __repr__(self) -> str:
        return short_repr(self)


def height_picture(height_map: HeightMap) -> HeightPicture:
    """Encode a height map as 16-bit samples; the error is at most half a step.

    Examples
    --------
    >>> import numpy as np
    >>> from processing import NormalMap, integrate
    >>> from processing.surface import height_picture
    >>> y, x = np.mgrid[1:-1:5j, -1:1:5j]
    >>> surface = integrate(NormalMap.from_vectors(np.dstack([x, y, 0 * x + 2])), pixel_mm=0.5)
    >>> picture = height_picture(surface)
    >>> heights_mm = picture.base + picture.step * picture.pixels[:]
    >>> bool(np.abs(heights_mm - surface.height).max() <= picture.step)
    True
    """
    check_type("height_map", height_map, HeightMap, "integrate(normal_map) returns one")
    lowest, highest = height_map.extremes
    step = (highest - lowest) / (_TOP - 1) or 1.0
    base = lowest - step
    pixels = ComputedRows(
        height_map.mask.shape,
        np.dtype(np.uint16),
        lambda rows: _samples(height_map.maps["height"][rows], base, step),
    )
    return HeightPicture(pixels, base, step)


def _samples(height: Float32, base: float, step: float) -> UInt16:
    inside = np.isfinite(height)
    pixels = np.zeros(height.shape, np.uint16)
    samples = np.rint(1 + (height[inside].astype(np.float64) - (base + step)) / step)
    pixels[inside] = samples.clip(1, _TOP)
    return pixels
