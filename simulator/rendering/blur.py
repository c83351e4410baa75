"""The point-spread function of the lens: defocus that depends on depth, then a Gaussian.

Images are radiance integrated over each pixel; both steps leave uniform radiance unchanged.
"""

from __future__ import annotations

import math
from functools import lru_cache

import cv2
import numba
import numpy as np

from acquisition import DataError
from rig import in_threads
from rig.arrays import Float32, Float64, Int16, Int64

# Circles of confusion are rounded to this many steps per pixel of diameter.
_STEPS = 8
_MOST_PX = 64.0
_FINE = 16
_REACH_SIGMAS = 4.0
# Weight of hidden parts: enough to define them, too little to blur what is in focus.
_SPARE = 1e-3


def blur(
    planes: Float32,
    depth_mm: Float64,
    circle_px: Float32,
    sigma_px: float,
    largest_px: float | None = None,
) -> None:
    """Blur images in place as the lens does.

    Every pixel spreads its light over its own circle of confusion. Around each pixel, the nearer
    half of the depths covers the farther half as far as its circles reach; what a lens sees behind
    an edge continues what is next to it.

    Parameters
    ----------
    planes
        ``(N, H, W)`` images of one scene.
    depth_mm
        ``(H, W)`` depth of what each pixel sees.
    circle_px
        ``(H, W)`` diameter of the circle of confusion of what each pixel sees.
    sigma_px
        Standard deviation of the Gaussian.
    largest_px
        Largest circle of the image, of which ``planes`` are some rows; None for that of ``planes``.

    Raises
    ------
    DataError
        If a circle is larger than 64 pixels.
    """
    largest = float(circle_px.max(initial=0.0)) if largest_px is None else largest_px
    table, reach = _kernels(largest)
    if reach.max():
        index = np.rint(circle_px * _STEPS).astype(np.int16)
        sides = table.shape[1]
        spread = cv2.dilate((reach[index] > 0).astype(np.uint8), np.ones((sides, sides)))
        y, x = np.nonzero(spread)
        middle, widest = np.zeros(len(y)), np.zeros(len(y), np.int64)
        in_threads(_split, len(y), depth_mm, index, y, x, sides // 2, middle, widest)
        in_threads(_defocus, len(planes), planes, depth_mm, index, y, x, middle, widest, table)
    kernel = gaussian(sigma_px)
    for plane in planes:
        cv2.sepFilter2D(plane, -1, kernel, kernel, dst=plane, borderType=cv2.BORDER_REPLICATE)


def blur_reach(largest_px: float, sigma_px: float) -> int:
    """Return how many pixels `blur` reaches, with circles of up to ``largest_px`` pixels."""
    return len(_kernels(largest_px)[0][0]) // 2 + len(gaussian(sigma_px)) // 2


def gaussian(sigma_px: float) -> Float64:
    """Return a Gaussian sampled at whole pixels, with the sum 1."""
    reach = max(1, math.ceil(_REACH_SIGMAS * sigma_px))
    kernel: Float64 = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma_px) ** 2)
    kernel /= kernel.sum()
    return kernel


@lru_cache(maxsize=4)
def _kernels(largest_px: float) -> tuple[Float32, Int64]:
    """Return the kernels of all circles up to the largest one, and how far each one reaches."""
    if largest_px > _MOST_PX:
        raise DataError(
            f"parts of the scene are out of focus by {largest_px:.0f} pixels, more than "
            f"{_MOST_PX:.0f}: change focus_mm, f_number or the size of the image"
        )
    count = int(np.rint(np.float32(largest_px) * np.float32(_STEPS)))
    table = np.stack([_disc(step / _STEPS, largest_px) for step in range(count + 1)])
    reach = np.array([_reach(kernel) for kernel in table])
    sides = 2 * int(reach.max()) + 1
    inner = (table.shape[1] - sides) // 2
    table = np.ascontiguousarray(table[:, inner : inner + sides, inner : inner + sides])
    return table, reach


def _disc(diameter_px: float, largest_px: float) -> Float32:
    """Return the kernel of a uniform disc, with the sum 1 and the disc's variance.

    A disc that is integrated over pixels has the variance of the disc plus that of a pixel. The
    diameter is reduced until the variance is the disc's, ``diameter^2 / 16`` along each axis.
    """
    half = math.ceil(largest_px / 2) + 1
    fine = (np.arange((2 * half + 1) * _FINE) + 0.5) / _FINE - half - 0.5
    squared = fine[:, None] ** 2 + fine**2
    pixel = np.arange(-half, half + 1)

    def covered(diameter: float) -> Float64:
        # The edge of the disc is a ramp of one sample, so the kernel changes continuously.
        share = np.clip((diameter / 2 - np.sqrt(squared)) * _FINE + 0.5, 0.0, 1.0)
        cells = share.reshape(2 * half + 1, _FINE, 2 * half + 1, _FINE).sum(axis=(1, 3))
        return np.asarray(cells / max(cells.sum(), 1e-12))

    low, high = 0.1, max(diameter_px, 0.1) + 1.2
    for _ in range(25):
        middle = (low + high) / 2
        variance = float((covered(middle).sum(axis=0) * pixel**2).sum())
        low, high = (middle, high) if variance < diameter_px**2 / 16 else (low, middle)
    return covered(low).astype(np.float32)


def _reach(kernel: Float32) -> int:
    """Return how many pixels a kernel reaches from its middle."""
    half = len(kernel) // 2
    used = np.flatnonzero(kernel.sum(axis=0) > 1e-4)
    return int(np.abs(used - half).max())


@numba.njit(nogil=True, cache=True)
def _split(
    first: int, last: int, depth: Float64, index: Int16, y: Int64, x: Int64,
    reach: int, middle: Float64, widest: Int64,
) -> None:  # fmt: skip
    """Write the depth between near and far, and the largest index, around pixels (y, x)."""
    rows, columns = depth.shape
    for i in range(first, last):
        near, far, most = depth[y[i], x[i]], depth[y[i], x[i]], 0
        for r in range(max(y[i] - reach, 0), min(y[i] + reach + 1, rows)):
            for c in range(max(x[i] - reach, 0), min(x[i] + reach + 1, columns)):
                near, far = min(near, depth[r, c]), max(far, depth[r, c])
                most = max(most, index[r, c])
        middle[i], widest[i] = (near + far) / 2.0, most


@numba.njit(nogil=True, cache=True)
def _defocus(
    first: int,
    last: int,
    planes: Float32,
    depth: Float64,
    index: Int16,
    y: Int64,
    x: Int64,
    middle: Float64,
    widest: Int64,
    table: Float32,
) -> None:
    """Gather pixels (y, x) from kernels that depend on where the light comes from.

    What is nearer than ``middle`` covers what is farther as far as its kernels reach.
    """
    reach = table.shape[1] // 2
    rows, columns = planes.shape[1:]
    for n in range(first, last):
        source = planes[n].copy()
        for i in range(len(y)):
            front, covered = np.float32(0.0), np.float32(0.0)
            back, weight = np.float32(0.0), np.float32(0.0)
            for dy in range(-reach, reach + 1):
                r = min(max(y[i] + dy, 0), rows - 1)
                for dx in range(-reach, reach + 1):
                    c = min(max(x[i] + dx, 0), columns - 1)
                    share = table[index[r, c], reach - dy, reach - dx]
                    if depth[r, c] < middle[i]:
                        front += share * source[r, c]
                        covered += share
                    else:
                        # What is hidden behind an edge continues what is seen next to it.
                        share += np.float32(_SPARE) * table[widest[i], reach - dy, reach - dx]
                        back += share * source[r, c]
                        weight += share
            if weight <= 0.0:
                planes[n, y[i], x[i]] = front / covered
            else:
                open_ = max(np.float32(1.0) - covered, np.float32(0.0))
                planes[n, y[i], x[i]] = (front + open_ * back / weight) / (covered + open_)
