"""Camera shake: frames shifted by fractions of a pixel."""

from __future__ import annotations

import math

import cv2
import numpy as np
import numpy.typing as npt

from simulator._dice import normal_pair, stream

Values = npt.NDArray[np.float32]

# Waves longer than 3 pixels keep amplitude and phase to 2e-4 under any shift.
_LOBES = 8  # lobes of the interpolation kernel on each side
_BETA = 7.0  # parameter of its Kaiser window
_TAG = 0x5AFE  # keeps the shake's random numbers apart from others of the shot


def shake_of(shot_key: tuple[int, ...], sigma_px: float) -> tuple[float, float]:
    """Return the shift of the image in a frame: right and down, pixels.

    Parameters
    ----------
    shot_key
        Non-negative integers that identify the shot.
    sigma_px
        Standard deviation along each axis.
    """
    right, down = normal_pair(stream(*shot_key, _TAG), 0)
    return sigma_px * right, sigma_px * down


def shifted(plane: Values, shift_px: tuple[float, float], *, mosaic: bool) -> Values:
    """Shift an image by band-limited interpolation (sinc under a Kaiser window).

    Parameters
    ----------
    plane
        ``(H, W)`` float32 image, not negative. It is continued beyond its edges by its mirror
        image.
    shift_px
        Shift of the image content to the right and down, pixels.
    mosaic
        True for a mosaic of 2 x 2 filters: each pixel is interpolated from pixels with the same
        filter.

    Returns
    -------
    Values
        ``(H, W)`` image, not negative. A shift of zero gives the same values.
    """
    step = 2 if mosaic else 1
    right, down = (_kernel(shift / step, step) for shift in shift_px)
    # Mirroring without repeating the edge pixel keeps the filters of a mosaic in phase.
    moved = cv2.sepFilter2D(plane, cv2.CV_32F, right, down, borderType=cv2.BORDER_REFLECT_101)
    return np.maximum(np.asarray(moved, np.float32), np.float32(0.0))


def _kernel(shift: float, step: int) -> Values:
    """Return the taps that shift a row; they use every ``step``-th pixel and their sum is 1."""
    reach = _LOBES + math.ceil(abs(shift))
    # OpenCV correlates: tap k multiplies the sample k pixels to the right.
    offset = np.arange(-reach, reach + 1) + shift
    taps = np.sinc(offset) * np.i0(_BETA * np.sqrt(np.clip(1 - (offset / _LOBES) ** 2, 0.0, None)))
    taps[np.abs(offset) >= _LOBES] = 0.0
    kernel = np.zeros(2 * reach * step + 1, np.float32)
    kernel[::step] = taps / taps.sum()
    return kernel
