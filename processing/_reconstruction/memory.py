"""How much memory a reconstruction needs."""

from __future__ import annotations

import math

from acquisition import Source
from processing._reconstruction.colour_albedo import may_have_colour

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


def memory_of_reconstruction(source: Source, channels: int = 1) -> int:
    """Return the bytes that `reconstruct` needs for the normals of a source, about.

    ``channels`` is 3 if the images are solved in colour.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import read_source, write_png
    >>> from processing import memory_of_reconstruction
    >>> write_png("card.png", np.full((40, 60), 700, np.uint16))
    >>> memory_of_reconstruction(read_source("card.png"))
    450321600
    """
    pixels = math.prod(source.size)
    stack = 4 * channels * len(source.light_ids) * pixels
    return (
        _FIXED + (_MAPS + 16 * (channels - 1)) * pixels + (stack if stack <= _STACK else 2 * _BAND)
    )


def least_memory(source: Source) -> int:
    """Return the bytes that `reconstruct_on_disk` needs at least.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import read_source, write_png
    >>> from processing import least_memory
    >>> write_png("card.png", np.full((40, 60), 700, np.uint16))
    >>> least_memory(read_source("card.png"))
    450180480
    """
    row = _row_bytes(source, len(source.light_ids), colour=False)
    return _FIXED + _on_disk(source) + _LEAST_ROWS * row


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
