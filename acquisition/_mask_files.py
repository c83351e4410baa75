"""Masks as image files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from acquisition._errors import DataError
from acquisition._images import read_image


def read_mask(path: str | Path, size: tuple[int, int] | None = None) -> npt.NDArray[np.bool_]:
    """Read a mask; inside is what is brighter than half of the file's range.

    Parameters
    ----------
    path
        An image of any kind. Of colours, the brightest counts; edges may be anti-aliased.
    size
        (height, width) that the mask must have.

    Returns
    -------
    npt.NDArray[np.bool_]
        ``(H, W)``.

    Raises
    ------
    MissingPathError
        If there is no such file.
    DataError
        If it is not an image, of another size, or nothing is inside.
    """
    path = Path(path)
    pixels = read_image(path)
    values = pixels if pixels.ndim == 2 else pixels.max(axis=2)
    if size is not None and values.shape != size:
        raise DataError(
            f"{path}: a mask of {values.shape[1]} x {values.shape[0]} pixels, but the images have "
            f"{size[1]} x {size[0]}: give the mask of these images"
        )
    full = 1.0 if values.dtype.kind == "f" else float(np.iinfo(values.dtype).max)
    mask: npt.NDArray[np.bool_] = values > full / 2
    if not mask.any():
        raise DataError(
            f"{path}: a mask with nothing inside: paint the object in white (above {full / 2:g})"
        )
    return mask
