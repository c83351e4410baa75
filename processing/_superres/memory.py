"""The memory that super-resolution needs."""

from __future__ import annotations

from processing._superres.enlarge import margin_rows
from processing._superres.enlargement import tile_side

# The interpreter, libraries, compiled kernels and a network with the features of a tile.
_FIXED = 450_000_000
# Bytes per pixel of the high resolution: a result in memory with what is written of it, masks while
# the maps are on disk, and the rows of tiles that are computed together.
_WHOLE, _ON_DISK, _OF_BAND = 30, 2, 36
# Bytes per pixel of the low resolution: a map in memory, a mask, and rows of tiles with halos.
_MAP, _MASK, _OF_LOW_BAND = 13, 2, 60


def memory_of_super_resolution(size: tuple[int, int], scale: int, halo_px: int = 19) -> int:
    """Return the bytes that a program needs to read and `super_resolve` a map of (height, width).

    ``halo_px`` is that of the network.

    Examples
    --------
    >>> from processing import memory_of_super_resolution
    >>> memory_of_super_resolution((3000, 4000), 4) // 1_000_000
    6770
    """
    height, width = size
    return _FIXED + height * width * (_MAP + scale**2 * _WHOLE) + _band(size, scale, halo_px)


def least_memory_of_super_resolution(size: tuple[int, int], scale: int, halo_px: int = 19) -> int:
    """Return the bytes that `super_resolve_on_disk` needs; parameters are those in memory.

    Examples
    --------
    >>> from processing import least_memory_of_super_resolution
    >>> least_memory_of_super_resolution((3000, 4000), 4) // 1_000_000
    1262
    """
    height, width = size
    return _FIXED + height * width * (_MASK + scale**2 * _ON_DISK) + _band(size, scale, halo_px)


def _band(size: tuple[int, int], scale: int, halo_px: int) -> int:
    """Return the bytes for rows that are computed together."""
    height, width = size
    rows = tile_side(halo_px)
    read = min(rows + 2 * (halo_px + margin_rows(halo_px)), height)
    return width * (read * _OF_LOW_BAND + scale**2 * min(rows, height) * _OF_BAND)
