"""Options that name files, read once for all commands; and the files behind them, for hashing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from acquisition import DataError, read_image


def read_mask_shares(path: Path, size: tuple[int, ...]) -> npt.NDArray[np.float64]:
    """Read an anti-aliased mask image as 0..1, the disc of a sphere.

    Errors are those of `acquisition.read_mask`.
    """
    image = read_image(path)
    if image.ndim == 3:
        image = image.max(axis=2)
    if image.shape != size:
        raise DataError(
            f"{path}: a mask of {image.shape[1]} x {image.shape[0]} pixels "
            f"does not fit images of {size[1]} x {size[0]}"
        )
    full = 1.0 if image.dtype.kind == "f" else float(np.iinfo(image.dtype.name).max)
    shares = np.clip(np.nan_to_num(image.astype(np.float64) / full), 0.0, 1.0)
    if not (shares > 0.5).any():
        raise DataError(f"{path}: the mask is all zeros: nothing is inside")
    return shares
