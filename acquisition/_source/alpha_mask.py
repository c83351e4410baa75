"""The object mask that the alpha channel of photographs gives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from acquisition._errors import DataError
from acquisition._pixels.images import Image, read_image_with_alpha
from acquisition._source.source import Source
from rig import MAX_PIXELS, Notice


def with_alpha_mask(source: Source, images: Sequence[Path], max_pixels: int = MAX_PIXELS) -> Source:
    """Return a source without a mask with that of its alpha channels: what no image cuts out.

    Alpha channels that are opaque everywhere are ignored.

    Parameters
    ----------
    source
        The recording, without a mask.
    images
        Its images with an alpha channel; they are decoded.
    max_pixels
        Largest allowed number of pixels per image.

    Raises
    ------
    DataError
        If an image cannot be read, or the alpha channels leave no pixel.
    """
    if source.mask is not None or not images:
        return source
    inside = np.ones(source.size, np.bool_)
    for path in images:
        _, alpha = read_image_with_alpha(path, max_pixels=max_pixels)
        if alpha is not None:
            inside &= _opaque(alpha)
    if inside.all():
        return source
    count = int(np.count_nonzero(inside))
    if not count:
        raise DataError(
            f"{images[0]}: the alpha channel of the images leaves no pixel: save them without "
            "alpha, or give a mask"
        )
    text = f"the alpha channel of the images is the mask, {count} of {inside.size} pixels"
    notice = Notice("alpha-is-mask", text, str(source.path), "info")
    return replace(source, mask=inside, mask_origin="alpha", warnings=(*source.warnings, notice))


def _opaque(alpha: Image) -> npt.NDArray[np.bool_]:
    full = 1.0 if alpha.dtype.kind == "f" else float(np.iinfo(alpha.dtype.name).max)
    return np.asarray(alpha > full / 2, np.bool_)
