"""Maps of a field on the pixels of another one, or of the whole."""

from __future__ import annotations

import math

import cv2
import numpy as np

from rig.arrays import Bool, Float32, Float64

Size = tuple[int, int]

# Pixels of the interpolation on each side.
REACH = 4


def turned(normals: Float32, turn: float) -> Float32:
    """Return normals of an object that is turned by radians from right to down, in place."""
    cos, sin = np.float32(math.cos(turn)), np.float32(math.sin(turn))
    x, y = normals[..., 0].copy(), normals[..., 1].copy()
    normals[..., 0] = cos * x + sin * y
    normals[..., 1] = cos * y - sin * x
    return normals


def resampled(image: Float32, matrix: Float64, size: Size, *, smooth: bool = False) -> Float32:
    """Return an image on other pixels.

    Parameters
    ----------
    image
        ``(H, W)`` or ``(H, W, C)``.
    matrix
        ``(3, 3)`` from the new pixels to those of the image.
    size
        (height, width) of the result.
    smooth
        Interpolate linearly, without overshoot; otherwise by Lanczos interpolation.
    """
    kind = cv2.INTER_LINEAR if smooth else cv2.INTER_LANCZOS4
    made = cv2.warpAffine(
        image,
        matrix[:2],
        size[::-1],
        flags=kind | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_REPLICATE,
    )
    return np.asarray(made, np.float32)


def masked(image: Float32, mask: Bool, matrix: Float64, size: Size) -> Float32:
    """Return an image on other pixels as `resampled` does, from what is inside a mask.

    Near the border of the mask, the interpolation is linear; where less than half of it is inside,
    values are 0.
    """
    if mask.all():
        return resampled(image, matrix, size)
    filled = np.where(mask if image.ndim == 2 else mask[..., None], image, np.float32(0))
    inner = cv2.erode(mask.astype(np.uint8), np.ones((2 * REACH + 1, 2 * REACH + 1), np.uint8))
    sharp = resampled(inner.astype(np.float32), matrix, size, smooth=True) > 0
    share = resampled(mask.astype(np.float32), matrix, size, smooth=True)
    if image.ndim == 3:
        share, sharp = share[..., None], sharp[..., None]
    linear = resampled(filled, matrix, size, smooth=True) / np.maximum(share, np.float32(0.5))
    linear = np.where(share >= 0.5, linear, np.float32(0))
    return np.where(sharp, resampled(filled, matrix, size), linear)


def inverse(matrix: Float64) -> Float64:
    """Return the inverse of a transform."""
    return np.asarray(np.linalg.inv(matrix), np.float64)


def shift_of(rows: slice, columns: slice) -> Float64:
    """Return the matrix from the pixels of a rectangle to those of the whole image."""
    return np.array([[1, 0, columns.start], [0, 1, rows.start], [0, 0, 1.0]])


def rectangle_of(
    matrix: Float64, size: Size, limits: Size, margin: int = 0
) -> tuple[slice, slice] | None:
    """Return the rows and columns that an image covers in another one; None outside of it.

    Parameters
    ----------
    matrix
        ``(3, 3)`` from pixels of the first image to those of the second.
    size
        (height, width) of the first image.
    limits
        (height, width) of the second one.
    margin
        Pixels around.
    """
    x, y = ends_of(matrix, size)
    first = max(0, math.floor(y.min()) - margin), max(0, math.floor(x.min()) - margin)
    last = (
        min(limits[0], math.ceil(y.max()) + 1 + margin),
        min(limits[1], math.ceil(x.max()) + 1 + margin),
    )
    if last[0] <= first[0] or last[1] <= first[1]:
        return None
    return slice(first[0], last[0]), slice(first[1], last[1])


def ends_of(matrix: Float64, size: Size) -> tuple[Float64, Float64]:
    """Return columns and rows of the corners of an image in another one."""
    height, width = size
    right = np.array([0.0, width - 1, 0, width - 1])
    down = np.array([0.0, 0, height - 1, height - 1])
    x, y, _ = matrix @ [right, down, np.ones(4)]
    return x, y
