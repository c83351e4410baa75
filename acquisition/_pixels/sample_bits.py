"""Samples of fewer than 16 bits in 16-bit files, in the high or in the low bits.

High bits show in one image: all samples have a common factor. Low bits show only if highlights are
saturated: no sample of the recording exceeds 1023, 4095 or 16383, and many are equal to it. Without
such a pile-up nothing is saturated, and no white level is needed.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

import numpy as np

from acquisition._pixels.images import Image
from rig import Notice

# Bits of a sample by the step between its values.
_BITS: Final = {4: 14, 16: 12, 64: 10}
# Fewer different values may share a factor by chance.
_LEAST_VALUES: Final = 16
# Saturated samples are as many as those of several values below the white level together. These
# are the values within a 64th of it; the most frequent one counts, because samples that were
# stretched from 8 bits leave values out.
_NEAR: Final = 64
_PILE: Final = 4
_LEAST_PILE: Final = 16


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


def low_bits_of(images: Iterable[Image]) -> int | None:
    """Return how many low bits of all samples are in use: 10, 12 or 14; None if that is not known.

    Parameters
    ----------
    images
        All images of a recording. No more of them are taken than necessary.
    """
    brightest = 0
    counts = {bits: np.zeros((2**bits - 1) // _NEAR + 1, np.int64) for bits in _BITS.values()}
    for pixels in images:
        if pixels.dtype != np.uint16:
            return None
        own = int(pixels.max(initial=0))
        brightest = max(brightest, own)
        if brightest >= 2 ** max(counts):
            return None
        near = counts.get(own.bit_length())
        if near is not None and own == 2 ** own.bit_length() - 1:
            low = own + 1 - len(near)
            near += np.bincount(pixels[pixels >= low] - low, minlength=len(near))
    near = counts.get(brightest.bit_length())
    if near is None or brightest != 2 ** brightest.bit_length() - 1:
        return None
    return brightest.bit_length() if near[-1] >= max(_LEAST_PILE, _PILE * near[:-1].max()) else None


def white_level_of(bits: int) -> float:
    """Return the value of a saturated sample in the high bits: 65520 for 12 bits."""
    return float(2**16 - 2 ** (16 - bits))


def high_bits_notice(bits: int, where: str) -> Notice:
    """Return the notice that reports the white level of samples in the high bits."""
    text = (
        f"{bits}-bit samples in the high bits of 16: the white level is {white_level_of(bits):.0f}"
    )
    return Notice("samples-in-high-bits", text, where, "info")


def low_bits_notice(bits: int, where: str) -> Notice:
    """Return the notice that reports the white level of samples in the low bits."""
    text = (
        f"{bits}-bit samples in the low bits of 16: many are saturated at {2**bits - 1}, which is "
        "taken as the white level"
    )
    return Notice("samples-in-low-bits", text, where, "info")
