"""Which pixels of the images of a recording are the object."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from processing._mask import mask_of_images
from processing._reconstruction.mosaic import blocks_of_sites
from processing._reconstruction.recorded_images import RecordedImages
from rig import Notice

Mask = npt.NDArray[np.bool_]

# A computed mask beyond these probably contains background.
_LARGEST_SHARE = 0.8
_MOST_BORDERS = 3


def object_of(
    images: RecordedImages, mask: Mask | None, elsewhere: Mask | None, pattern: str | None
) -> tuple[Mask, list[Notice]]:
    """Return the mask of the object, computed from the images if no mask is given, and notices.

    Parameters
    ----------
    images
        The N images.
    mask
        ``(H, W)`` bool, the mask of the source; None if it has no mask.
    elsewhere
        ``(H, W)`` bool, pixels that are something else, such as spheres; None without any.
    pattern
        Colours of the first 2 x 2 sites of a mosaic; None for other images.

    Raises
    ------
    EstimateError
        If no object stands out.
    """
    if mask is not None:
        return mask if elsewhere is None else mask & ~elsewhere, []
    seen = images if pattern is None else map(blocks_of_sites, images)
    computed = mask_of_images(seen, images.size, elsewhere)
    text = (
        "the images have no mask: one was computed; the object is "
        f"{computed.contrast:.0f} times as bright as the background"
    )
    return computed.mask, [Notice("mask-estimated", text), *_mask_warning(computed.mask)]


def _mask_warning(mask: Mask) -> list[Notice]:
    """Return a warning about a computed mask that probably contains background."""
    share = float(mask.mean())
    touched = sum(bool(border.any()) for border in (mask[0], mask[-1], mask[:, 0], mask[:, -1]))
    if share <= _LARGEST_SHARE and touched < _MOST_BORDERS:
        return []
    text = (
        f"the computed mask covers {share:.0%} of the image and touches {touched} of its borders: "
        "it probably contains background; give a mask"
    )
    return [Notice("mask-fills-frame", text)]
