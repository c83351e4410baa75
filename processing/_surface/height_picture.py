"""Height as a 16-bit picture with its scale."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from processing._surface.height_map import HeightMap
from rig import check_type, short_repr

Float = npt.NDArray[np.float32]

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
    inside = height_map.height[height_map.mask]
    scale = height_scale(float(inside.min()), float(inside.max()))
    return HeightPicture(height_samples(height_map.height, scale), scale.base, scale.step)


class HeightScale(NamedTuple):
    """The height at sample 0 of a picture, and that between two samples."""

    base: float
    step: float


def height_scale(lowest: float, highest: float) -> HeightScale:
    """Return the scale of a picture of heights.

    Examples
    --------
    >>> from processing import height_scale
    >>> height_scale(0.0, 131068.0)
    HeightScale(base=-2.0, step=2.0)
    """
    step = (highest - lowest) / (_TOP - 1) or 1.0
    return HeightScale(lowest - step, step)


def height_samples(height: Float, scale: HeightScale) -> npt.NDArray[np.uint16]:
    """Return the samples of a picture of heights, or of rows of it; 0 for NaN.

    Examples
    --------
    >>> import numpy as np
    >>> from processing import height_samples, height_scale
    >>> height_samples(np.float32([2.0, np.nan, 4.0]), height_scale(2.0, 4.0))
    array([    1,     0, 65535], dtype=uint16)
    """
    inside = np.isfinite(height)
    pixels = np.zeros(height.shape, np.uint16)
    lowest = scale.base + scale.step
    samples = np.rint(1 + (height[inside].astype(np.float64) - lowest) / scale.step)
    pixels[inside] = samples.clip(1, _TOP)
    return pixels
