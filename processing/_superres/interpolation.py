"""Interpolation of vectors and masks to a higher resolution; pixel centres are at half-integers."""

from __future__ import annotations

from itertools import product

import cv2
import numpy as np
import numpy.typing as npt

Float = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]

# How far the functions here depend on the surroundings of a pixel.
REACH_PX = 3
_LEAST_LENGTH = 1e-6
_FACING = np.array([0, 0, 1], np.float32)
_LAPLACE = np.array([[0, 1, 0], [1, -4, 1], [0, 1, 0]], np.float32)
_PLACES = np.arange(-3, 4)


def bicubic(values: Float, scale: int) -> Float:
    """Interpolate an image bicubically with a = -0.75, as OpenCV and torch do.

    Parameters
    ----------
    values
        ``(h, w)`` or ``(h, w, C)`` float32; the border is replicated.
    scale
        Factor of the size.

    Returns
    -------
    Float
        Image of ``scale * h`` x ``scale * w`` pixels.
    """
    size = (scale * values.shape[1], scale * values.shape[0])
    return np.asarray(cv2.resize(values, size, interpolation=cv2.INTER_CUBIC), np.float32)


def without_averaging(values: Float, scale: int) -> Float:
    """Return the values at the centres of pixels that are means over their area.

    The mean over a square is the value at its centre plus 1/24 of the Laplacian, as far as it is
    smooth; of the pixels of the higher resolution, which are means as well, the same is left.

    Parameters
    ----------
    values
        ``(h, w, 3)`` float32.
    scale
        How many pixels of the higher resolution are in a pixel, in each direction.
    """
    curved = cv2.filter2D(values, -1, _LAPLACE, borderType=cv2.BORDER_REPLICATE)
    return np.asarray(values - np.float32((1 - scale**-2) / 24) * curved, np.float32)


def averaged(values: Float, scale: int) -> Float:
    """Return the means over pixels of values at their centres, interpolated as `smoothly` does.

    Parameters
    ----------
    values
        ``(h, w, 3)`` float32; the border is replicated.
    scale
        How many pixels of the higher resolution are in a pixel, in each direction.
    """
    kernel = np.mean(_kernels(scale), axis=0)
    return np.asarray(
        cv2.sepFilter2D(values, -1, kernel, kernel, borderType=cv2.BORDER_REPLICATE), np.float32
    )


def smoothly(values: Float, scale: int) -> Float:
    """Interpolate an image by cubic convolution over six pixels, which is exact for cubics.

    Bicubic interpolation with a = -0.75 is sharper at edges, but not exact even for a ramp. From R.
    Keys, *Cubic convolution interpolation for digital image processing*, 1981, section VI.

    Parameters
    ----------
    values
        ``(h, w, C)`` float32; the border is replicated.
    scale
        Factor of the size.

    Returns
    -------
    Float
        Image of ``scale * h`` x ``scale * w`` pixels.
    """
    height, width, channels = values.shape
    out = np.zeros((scale * height, scale * width, channels), np.float32)
    kernels = _kernels(scale)
    for row, column in product(range(scale), repeat=2):
        out[row::scale, column::scale] = cv2.sepFilter2D(
            values, -1, kernels[column], kernels[row], borderType=cv2.BORDER_REPLICATE
        )
    return out


def enlarged_mask(mask: Mask, scale: int) -> Mask:
    """Return a mask at a higher resolution, with a smooth outline of about the same area."""
    size = (scale * mask.shape[1], scale * mask.shape[0])
    share = cv2.resize(mask.astype(np.float32), size, interpolation=cv2.INTER_LINEAR)
    return np.asarray(share >= 0.5)


def units(vectors: Float) -> Float:
    """Return vectors of unit length; those that cancel out face the camera."""
    length = np.linalg.norm(vectors, axis=2, keepdims=True)
    scaled = vectors / np.maximum(length, _LEAST_LENGTH)
    return np.asarray(np.where(length > _LEAST_LENGTH, scaled, _FACING), np.float32)


def _kernels(scale: int) -> list[Float]:
    """Return the weights of cubic convolution at the pixels of the higher resolution."""
    return [_weights((k + 0.5) / scale - 0.5) for k in range(scale)]


def _weights(offset: float) -> Float:
    """Return the weights of the seven nearest pixels at an offset from the middle one."""
    away = np.abs(offset - _PLACES)
    pieces = (
        (4 / 3 * away - 7 / 3) * away**2 + 1,
        ((-7 / 12 * away + 3) * away - 59 / 12) * away + 15 / 6,
        ((1 / 12 * away - 2 / 3) * away + 21 / 12) * away - 3 / 2,
    )
    return np.asarray(np.select([away <= 1, away <= 2, away < 3], pieces, 0), np.float32)
