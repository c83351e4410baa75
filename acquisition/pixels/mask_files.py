"""Masks as image files."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from acquisition._errors import DataError
from acquisition.files.map_rows import ComputedRows, MapRows, rows_of
from acquisition.pixels.images import read_image_with_alpha, write_png
from acquisition.pixels.stated_facts import ImageFacts, image_facts
from rig import MAX_PIXELS
from rig.arrays import AnyArray, Bool, Float64


def read_mask(
    path: str | Path, size: tuple[int, int] | None = None, *, max_pixels: int = MAX_PIXELS
) -> Bool:
    """Read a mask; pixels brighter than half of the file's range are inside.

    Parameters and errors are those of `read_mask_shares`.

    Returns
    -------
    numpy.ndarray
        ``(H, W)`` bool.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import read_mask, write_mask
    >>> write_mask("mask.png", np.eye(3, dtype=bool))
    >>> read_mask("mask.png")
    array([[ True, False, False],
           [False,  True, False],
           [False, False,  True]])
    """
    return above_half(_read_samples(path, size, max_pixels))


def read_mask_of(path: Path, images: ImageFacts, size: tuple[int, int]) -> Bool:
    """Read the mask of images of ``size`` as `read_mask` does.

    Raises
    ------
    DataError
        As `read_mask`, or if a viewer turns the mask otherwise than the images, so that it may be
        a mask of the turned images: a mask of the stored pixels has the Orientation tag of the
        images, or its size shows that it is not turned.
    """
    turned = images.shot.orientation or 1
    own = image_facts(path, max_pixels=max(MAX_PIXELS, size[0] * size[1])).shot.orientation
    sideways = own == 1 and turned > 4 and size[0] != size[1]
    if own != turned and not sideways:
        raise DataError(
            f"{path}: a mask with the Orientation tag {own}, but the images have {turned}: save "
            "the mask with the tag of the images, or remove the tags from both"
        )
    return read_mask(path, size)


def write_mask(path: str | Path, mask: Bool | MapRows) -> None:
    """Write a mask as an 8-bit PNG, white inside.

    Parameters
    ----------
    path
        File to write (.png); an existing one is replaced.
    mask
        ``(H, W)`` bool, or a map whose rows are read band by band.

    Raises
    ------
    StorageError
        If the disk refuses the write.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import read_mask, write_mask
    >>> write_mask("mask.png", np.eye(3, dtype=bool))
    >>> int(read_mask("mask.png").sum())
    3
    """
    inside = rows_of(mask)
    full = np.dtype(np.uint8)
    write_png(path, ComputedRows(inside.shape, full, lambda rows: inside[rows] * np.uint8(255)))


def read_mask_shares(
    path: str | Path, size: tuple[int, int] | None = None, *, max_pixels: int = MAX_PIXELS
) -> Float64:
    """Read a mask with anti-aliased edges as the share of each pixel that is inside.

    Parameters
    ----------
    path
        Image file of any kind. In a colour image the brightest channel counts. In an image with
        transparent pixels the alpha channel is the mask, provided that its visible pixels have one
        colour or its colours give the same mask.
    size
        (height, width) that the mask must have.
    max_pixels
        Largest allowed number of pixels; a mask of the given ``size`` is always allowed.

    Returns
    -------
    npt.NDArray[np.float64]
        ``(H, W)`` shares 0..1 of the file's range, or of 0..1 in float images; NaN counts as
        outside.

    Raises
    ------
    MissingPathError
        If the file does not exist.
    DataError
        If the file is not an image, has another size or more than ``max_pixels`` pixels, has no
        pixel that is more than half inside, or if its colours and its alpha give two different
        masks.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import write_png
    >>> from acquisition.pixels import read_mask_shares
    >>> write_png("mask.png", np.array([[0, 51, 255]], np.uint8))
    >>> read_mask_shares("mask.png")
    array([[0. , 0.2, 1. ]])
    """
    values = _read_samples(path, size, max_pixels)
    shares: Float64 = np.divide(values, _full(values), dtype=np.float64)
    shares[np.isnan(shares)] = 0
    return np.clip(shares, 0.0, 1.0, out=shares)


def _read_samples(path: str | Path, size: tuple[int, int] | None, max_pixels: int) -> AnyArray:
    """Return the ``(H, W)`` samples that are the mask, as stored."""
    path = Path(path)
    if size is not None:
        max_pixels = max(max_pixels, size[0] * size[1])
        height, width, *_ = image_facts(path, max_pixels=max_pixels).shape
        if (height, width) != size:
            raise DataError(
                f"{path}: a mask of {width} x {height} pixels, but the images have {size[1]} x "
                f"{size[0]}: give a mask of the same size"
            )
    pixels, alpha = read_image_with_alpha(path, max_pixels=max_pixels)
    samples: AnyArray = pixels if pixels.ndim == 2 else pixels.max(axis=2)
    # NaN counts as transparent.
    if alpha is not None and not (alpha >= _full(alpha)).all():
        seen = pixels[alpha > 0]
        if (seen != seen[:1]).any() and (above_half(samples) != above_half(alpha)).any():
            raise DataError(
                f"{path}: its colours and its transparency give two different masks: save it "
                "without transparency, with the object in white"
            )
        samples = alpha
    if not above_half(samples).any():
        raise DataError(
            f"{path}: a mask with nothing inside: paint what belongs to it in white, brighter "
            "than half of the range"
        )
    return samples


def _full(values: AnyArray) -> float:
    return 1.0 if values.dtype.kind == "f" else float(np.iinfo(values.dtype).max)


def above_half(values: AnyArray) -> Bool:
    """Return where values are above half of the range of their type, or above 0.5 in floats."""
    inside: Bool = values > values.dtype.type(_full(values) / 2)
    return inside
