"""Masks as image files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from acquisition._errors import DataError
from acquisition._pixels.images import read_image


def read_mask(path: str | Path, size: tuple[int, int] | None = None) -> npt.NDArray[np.bool_]:
    """Read a mask; inside is what is brighter than half of the file's range.

    Parameters and errors are those of `read_mask_shares`.

    Returns
    -------
    npt.NDArray[np.bool_]
        ``(H, W)``.
    """
    mask: npt.NDArray[np.bool_] = read_mask_shares(path, size) > 0.5
    return mask


def read_mask_shares(
    path: str | Path, size: tuple[int, int] | None = None
) -> npt.NDArray[np.float64]:
    """Read a mask whose edges may be anti-aliased: how much of each pixel lies inside.

    Parameters
    ----------
    path
        An image of any kind. Of colours, the brightest counts.
    size
        (height, width) that the mask must have.

    Returns
    -------
    npt.NDArray[np.float64]
        ``(H, W)`` shares 0..1 of the file's range, of floats 0..1; what is no number is outside.

    Raises
    ------
    MissingPathError
        If there is no such file.
    DataError
        If it is not an image, of another size, or no pixel lies inside by more than half.
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
    shares: npt.NDArray[np.float64] = values.astype(np.float64) / full
    shares = np.clip(np.nan_to_num(shares), 0.0, 1.0)
    if not (shares > 0.5).any():
        raise DataError(
            f"{path}: a mask with nothing inside: paint the object in white (above {full / 2:g})"
        )
    return shares
