"""Selection of the images of a stack that show light on the object."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import numpy.typing as npt

from processing._reconstruction.recorded_images import Images
from rig import Notice

# An image shows no light if its brightest parts are below this fraction of those of the others.
_BLACK = 0.02
_THREADS = 2
# Pixels of the object, spread over it, whose brightness counts.
_PIXELS = 100_000


def lit_images(values: Images, mask: npt.NDArray[np.bool_]) -> list[int]:
    """Return the indices of the images with light on the object.

    The other images are black, because of a dead LED or a lost trigger.

    Parameters
    ----------
    values
        N images ``(H, W)`` of linear radiance; samples that are not finite are saturated.
    mask
        ``(H, W)`` bool, the object.
    """
    pixels = _spread(mask)
    with ThreadPoolExecutor(_THREADS) as pool:
        bright = np.array(
            list(pool.map(lambda i: _brightness(values[i], pixels), range(len(values))))
        )
    return [int(i) for i in np.flatnonzero(bright > _BLACK * np.median(bright))]


def unlit_notices(
    values: Images, mask: npt.NDArray[np.bool_], ids: Sequence[str], lit: list[int]
) -> list[Notice]:
    """Return warnings about the images that `lit_images` left out.

    Noise makes some samples of a black image negative. An image most of whose samples are below
    zero by more than that is no image of light: more was subtracted than recorded.
    """
    out = [i for i in range(len(values)) if i not in lit]
    pixels = _spread(mask)
    least = -_BLACK * float(np.median([_brightness(values[i], pixels) for i in lit]))
    negative = [i for i in out if np.nanmedian(values[i][mask]) < least]
    dark = [i for i in out if i not in negative]
    reasons = {
        "images left out because they show no light": dark,
        "images left out because most of their samples are negative (check what was subtracted)": (
            negative
        ),
    }
    return [
        Notice("lights-unlit", f"{text}: {', '.join(ids[i] for i in some)}")
        for text, some in reasons.items()
        if some
    ]


def _spread(mask: npt.NDArray[np.bool_]) -> npt.NDArray[np.intp]:
    """Return flat indices of pixels of the object, at most `_PIXELS`."""
    inside = np.flatnonzero(mask)
    if len(inside) <= _PIXELS:
        return inside
    return inside[np.linspace(0, len(inside) - 1, _PIXELS).astype(np.intp)]


def _brightness(image: npt.NDArray[np.float32], pixels: npt.NDArray[np.intp]) -> np.float32:
    inside = np.nan_to_num(image.reshape(-1)[pixels], copy=False, nan=1.0)
    return np.float32(np.quantile(inside, 0.99, overwrite_input=True))
