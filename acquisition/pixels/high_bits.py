"""Samples of fewer than 16 bits in the high bits of 16-bit files: all have a common factor."""

from __future__ import annotations

from typing import Final

import numpy as np

from acquisition.pixels.images import Image
from rig import Notice

# Bits of a sample by the step between its values.
_BITS: Final = {4: 14, 16: 12, 64: 10}
# Fewer different values may share a factor by chance.
_LEAST_VALUES: Final = 16


def high_bits_of(pixels: Image) -> int | None:
    """Return how many high bits of the samples are in use: 10, 12 or 14; None if it is all 16.

    All samples are then multiples of 64, 16 or 4, and some are beyond the range of the low bits.
    """
    if pixels.dtype != np.uint16 or not pixels.size:
        return None
    used = int(np.bitwise_or.reduce(pixels, axis=None))
    step = used & -used
    bits = _BITS.get(step)
    if bits is None or pixels.max() < 2**bits or len(np.unique(pixels)) < _LEAST_VALUES:
        return None
    return bits


def white_level_of(bits: int) -> float:
    """Return the value of a saturated sample in the high bits: 65520 for 12 bits."""
    return float(2**16 - 2 ** (16 - bits))


def high_bits_notice(bits: int, where: str) -> Notice:
    """Return the notice that reports the white level of samples in the high bits."""
    text = (
        f"{bits}-bit samples in the high bits of 16: the white level is {white_level_of(bits):.0f}"
    )
    return Notice("samples-in-high-bits", text, where, "info")
