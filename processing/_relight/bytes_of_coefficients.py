"""Coefficients as 8-bit samples with a scale and a bias for each."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Float = npt.NDArray[np.float32]
Byte = npt.NDArray[np.uint8]
Double = npt.NDArray[np.float64]

# Coefficients of few pixels, for example of those with few samples, may be far from all others: at
# most this share is clipped at either end.
_CLIPPED = 1e-4
_MOST = 2_000_000


class Coded(NamedTuple):
    """Coefficients ``(samples - bias) * scale``.

    Parameters
    ----------
    samples
        ``(H, W, K)`` uint8.
    scale
        ``(K,)`` positive.
    bias
        ``(K,)`` whole numbers, 0 to 255.
    """

    samples: Byte
    scale: Double
    bias: Double

    def decoded(self) -> Float:
        """Return the coefficients that the samples stand for."""
        return ((self.samples.astype(np.float32) - self.bias) * self.scale).astype(np.float32)


def coded(coefficients: Float) -> Coded:
    """Round coefficients ``(H, W, K)`` to 8 bits; 0 is always among the values of the samples."""
    terms = coefficients.shape[2]
    flat = coefficients.reshape(-1, terms)
    some = flat[:: 1 + len(flat) // _MOST]
    low = np.minimum(np.quantile(some, _CLIPPED, axis=0, method="lower"), 0).astype(np.float64)
    high = np.maximum(np.quantile(some, 1 - _CLIPPED, axis=0, method="higher"), 0)
    scale = (high - low) / 254
    scale[scale == 0] = 1.0
    # The written text of the scale is what readers multiply by.
    scale = np.array([float(f"{step:.9g}") for step in scale])
    bias = np.ceil(np.abs(low) / scale)
    samples = np.zeros(coefficients.shape, np.uint8)
    for row, line in enumerate(coefficients):
        samples[row] = np.clip(np.rint(line / scale + bias), 0, 255)
    return Coded(samples, scale, bias)
