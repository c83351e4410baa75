"""Which images of a stack show light on the object."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

# An image whose brightest parts stay below this share of the others' shows no light at all.
_BLACK = 0.02


def lit_images(values: npt.NDArray[np.float32], mask: npt.NDArray[np.bool_]) -> list[int]:
    """Return the indices of the images with light on the object.

    The others are black: a dead LED, or a trigger that was lost.

    Parameters
    ----------
    values
        ``(N, H, W)`` linear radiance; samples that are not finite are saturated.
    mask
        ``(H, W)`` bool, the object.
    """
    bright = np.array([np.quantile(np.nan_to_num(image[mask], nan=1.0), 0.99) for image in values])
    return [int(i) for i in np.flatnonzero(bright > _BLACK * np.median(bright))]
