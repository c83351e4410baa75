"""How much memory a reconstruction needs."""

from __future__ import annotations

import math

from acquisition import Source
from processing._reconstruction.colour_albedo import may_have_colour
from processing._stages.stage import Need
from rig import pluralize

# The interpreter, libraries and compiled kernels, and buffers of the threads.
_FIXED = 450_000_000
# Bytes per pixel: maps of a result in memory with what is computed of them, and what is in memory
# while the maps are on disk (mask, one gray reference, and one image with what is computed of it).
_MAPS = 130
_ON_DISK = 14
# Bytes per pixel of a band, besides the values of the images.
_OF_BAND = 300
# Largest stack that is in memory as a whole; bytes of a band otherwise.
_STACK, _BAND = 1_000_000_000, 128_000_000
_LEAST_ROWS = 8


def memory_need(source: Source, channels: int, *, whole: bool) -> Need:
    """Return the memory for the normals of a source, about.

    Parameters
    ----------
    source
        The recording.
    channels
        3 if the images are solved in colour, else 1.
    whole
        Whether the complete maps are needed.
    """
    (height, width), count = source.size, len(source.light_ids)
    pixels, row = height * width, _row_bytes(source, count, colour=False)
    stack = 4 * channels * count * pixels
    most = (
        _FIXED + (_MAPS + 16 * (channels - 1)) * pixels + (stack if stack <= _STACK else 2 * _BAND)
    )
    least = _FIXED + _on_disk(source) + _LEAST_ROWS * row
    of = f"{pluralize(count, 'image')} of {width} x {height} pixels"
    return Need(most, most if whole else least, of)


def rows_of_band(source: Source, lights: int, memory: int, *, colour: bool) -> int:
    """Return the rows of a band for which a number of bytes is enough."""
    free = memory - _FIXED - _on_disk(source)
    most = _BAND // (4 * lights * source.size[1])
    rows = free // _row_bytes(source, lights, colour=colour)
    return max(1, min(rows, most))


def _on_disk(source: Source) -> int:
    """Return the bytes besides bands while the maps are on disk."""
    references = {
        frame.exposure_us: 4 * math.prod(frame.shape)
        for frame in source.frames
        if frame.role in ("dark", "ambient")
    }
    # Images in gray and in colour have references of their own.
    kept = sum(references.values()) * (2 if may_have_colour(source) else 1)
    pixels = math.prod(source.size)
    return _ON_DISK * pixels + max(0, kept - 4 * pixels)


def _row_bytes(source: Source, lights: int, *, colour: bool) -> int:
    return (6 * lights + _OF_BAND + (60 if colour else 0)) * source.size[1]
