"""Selection of the images of a stack that show light on the object."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

# An image shows no light if its brightest parts are below this fraction of those of the others.
_BLACK = 0.02


def lit_images(values: npt.NDArray[np.float32], mask: npt.NDArray[np.bool_]) -> list[int]:
    """Return the indices of the images with light on the object.

    The other images are black, because of a dead LED or a lost trigger.

    Parameters
    ----------
    values
        ``(N, H, W)`` linear radiance; samples that are not finite are saturated.
    mask
        ``(H, W)`` bool, the object.
    """
    bright = np.array([np.quantile(np.nan_to_num(image[mask], nan=1.0), 0.99) for image in values])
    return [int(i) for i in np.flatnonzero(bright > _BLACK * np.median(bright))]
