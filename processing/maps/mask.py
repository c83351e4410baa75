"""Object mask of a stack of images, from the brightness under all lights."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from acquisition import DataError
from calibration import EstimateError
from calibration.radiance import check_linear
from rig import short_repr
from rig.arrays import Bool, Float32, Float64

# Values below this fraction of the object's brightness are raised to it. Without the floor, the
# threshold on the logarithm would split the noise of the background.
_FLOOR = 0.05
# Otsu's separability is 0.64 for one Gaussian and 0.75 for a uniform distribution; two groups have
# more.
_MIN_SEPARABILITY = 0.75
# The object is at least this many times as bright as the background; shading and texture alone have
# less contrast.
_MIN_CONTRAST = 3.0
# Parts smaller than this fraction of the largest are dust.
_MIN_PART = 0.05
_BINS = 256


@dataclass(frozen=True, eq=False)
class ObjectMask:
    """An object mask and the evidence for it.

    Parameters
    ----------
    mask
        ``(H, W)`` bool, True on the object, without holes.
    contrast
        Median brightness of the object divided by that of the background, at least 3.
    separability
        Otsu's criterion, the variance between the two groups divided by the total variance,
        0.75..1.
    """

    mask: Bool
    contrast: float
    separability: float

    __repr__ = short_repr


def object_mask(values: npt.ArrayLike, *, outside: Bool | None = None) -> ObjectMask:
    """Find the object: the pixels that are much brighter than the background under some light.

    Parameters
    ----------
    values
        ``(N, H, W)`` linear radiance under N lights, divided by their intensities. Samples that
        are not finite count as the brightest: they are saturated. Single dead pixels are filtered
        out.
    outside
        ``(H, W)`` bool, pixels that do not belong to the object and are not examined, such as
        calibration spheres next to it.

    Returns
    -------
    ObjectMask
        Otsu's threshold (1979) on the logarithm of the brightest sample of each pixel. Parts
        smaller than 5 % of the largest part are removed and holes are filled. The object should
        cover at least 1 % of the frame.

    Raises
    ------
    DataError
        If the stack is not ``(N, H, W)``, or ``outside`` has another size or covers the frame.
    EstimateError
        If no object stands out: it fills the frame, the background is bright, or all images are
        black.

    Examples
    --------
    >>> import numpy as np
    >>> from processing.maps import object_mask
    >>> values = np.full((3, 40, 40), 0.001, np.float32)
    >>> values[:, 10:30, 10:30] = 0.5
    >>> object_mask(values).mask[20, 8:12]
    array([False, False,  True,  True])
    """
    check_linear("values", values)
    stack = np.asarray(values, np.float32)
    if stack.ndim != 3 or 0 in stack.shape:
        raise DataError(f"an object mask requires a stack (N, H, W), not {stack.shape}")
    return mask_of_images(stack, stack.shape[1:], outside)


def mask_of_images(
    images: Iterable[Float32], shape: tuple[int, ...], outside: Bool | None
) -> ObjectMask:
    """Return `object_mask` of images ``(H, W)`` that are read one after the other."""
    examined = np.ones(shape, np.bool_) if outside is None else ~np.asarray(outside)
    if examined.shape != shape or examined.dtype != np.bool_ or not examined.any():
        raise DataError(
            f"outside must be bool {shape} and leave pixels to examine, not "
            f"{examined.dtype} {examined.shape}"
        )
    brightness, saturated = _brightest(images, shape)
    # Up to 1 % of the pixels may be highlights.
    reference = float(np.quantile(brightness[examined], 0.99))
    if not reference > 0:
        raise EstimateError("no object found: all images are black or saturated; check the images")
    brightness[saturated] = reference
    level, separability = _otsu(np.log(np.maximum(brightness[examined], _FLOOR * reference)))
    bright = (brightness > np.exp(level)) & examined
    # In a uniform image, all pixels are on one side of the threshold.
    sides = (bright, ~bright & examined)
    near, far = (float(np.median(brightness[side if side.any() else examined])) for side in sides)
    contrast = near / max(far, 1e-6 * reference)
    if separability < _MIN_SEPARABILITY or contrast < _MIN_CONTRAST:
        raise EstimateError(
            f"no object stands out from the background (contrast {contrast:.2g}, required "
            f"{_MIN_CONTRAST:g}; separability {separability:.2f}, required "
            f"{_MIN_SEPARABILITY:g}): give a mask"
        )
    return ObjectMask(mask=_clean(bright) & examined, contrast=contrast, separability=separability)


def _brightest(images: Iterable[Float32], shape: tuple[int, ...]) -> tuple[Float32, Bool]:
    """Return the largest finite sample of each pixel, and the mask of the saturated pixels.

    A median filter removes single pixels from both.
    """
    brightness = np.zeros(shape, np.float32)
    saturated = np.zeros(shape, np.uint8)
    for image in images:
        finite = np.isfinite(image)
        np.maximum(brightness, np.where(finite, image, 0), out=brightness)
        saturated[~finite] = 1
    filtered = np.asarray(cv2.medianBlur(brightness, 3), np.float32)
    return filtered, np.asarray(cv2.medianBlur(saturated, 3)) > 0


def _otsu(image: Float32) -> tuple[float, float]:
    """Return the threshold that splits the values best, and its separability, 0..1."""
    total = float(np.var(image, dtype=np.float64))
    if not total > 0:
        return float(image.flat[0]), 0.0
    counts, edges = np.histogram(image, _BINS)
    centres = 0.5 * (edges[1:] + edges[:-1])
    share = counts / counts.sum()
    below = np.cumsum(share)[:-1]
    moment = np.cumsum(share * centres)
    # Never 0 / 0: the first and the last bin hold the extremes.
    between: Float64 = (moment[-1] * below - moment[:-1]) ** 2 / (below * (1.0 - below))
    best = int(np.argmax(between))
    return float(edges[best + 1]), min(float(between[best]) / total, 1.0)


def _clean(bright: Bool) -> Bool:
    # Imported here: it takes 0.2 s, and most recordings have a mask.
    from scipy import ndimage

    parts, count = ndimage.label(bright)
    area = np.bincount(parts.ravel(), minlength=count + 1)
    area[0] = 0
    kept = area >= _MIN_PART * area.max()
    kept[0] = False
    return np.asarray(ndimage.binary_fill_holes(kept[parts]))


def bounding_box(mask: Bool) -> tuple[slice, slice]:
    """Return the rows and the columns of the smallest rectangle around a mask, not empty."""
    rows, columns = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)
