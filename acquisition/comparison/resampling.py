"""Weights for interpolation between samples."""

from __future__ import annotations

import numpy as np

from rig.arrays import Float64


def lanczos(fraction: float) -> Float64:
    """Return the weights of nine samples for the value at a fraction of a sample (Lanczos 4).

    The interpolation of OpenCV is no alternative: it rounds positions to 1/32 of a pixel.

    Parameters
    ----------
    fraction
        Position relative to the middle one of the samples, from -1 to 1.

    Examples
    --------
    >>> from acquisition.comparison import lanczos
    >>> lanczos(0.0).round(3) + 0.0
    array([0., 0., 0., 0., 1., 0., 0., 0., 0.])
    """
    distance = np.arange(-4, 5) - fraction
    weights = np.sinc(distance) * np.sinc(distance / 4) * (np.abs(distance) < 4)
    return np.asarray(weights / weights.sum())
