"""The memory that super-resolution needs."""

from __future__ import annotations

from processing._stages.stage import Need, Size
from processing._superres.enlarge import margin_rows

# Side of a tile in pixels of the low resolution, and its least ratio to the halo.
TILE_PX, _HALOS = 128, 2
# The interpreter, libraries, compiled kernels and a network with the features of a tile.
_FIXED = 450_000_000
# Bytes per pixel of the high resolution: a result in memory with what is written of it, masks while
# the maps are on disk, and the rows of tiles that are computed together.
_WHOLE, _ON_DISK, _OF_BAND = 30, 2, 36
# Bytes per pixel of the low resolution: a map in memory, a mask, and rows of tiles with halos.
_MAP, _MASK, _OF_LOW_BAND = 13, 2, 60


def memory_need(size: Size, scale: int, halo_px: int) -> Need:
    """Return the memory for a map of (height, width) and a network with a halo."""
    height, width = size
    fixed = _FIXED + _band(size, scale, halo_px)
    return Need(
        fixed + height * width * (_MAP + scale**2 * _WHOLE),
        fixed + height * width * (_MASK + scale**2 * _ON_DISK),
        f"a normal map of {width} x {height} pixels at scale {scale}",
    )


def tile_side(halo: int) -> int:
    """Return the side of a tile for a halo, both in pixels of the low resolution."""
    return max(TILE_PX, _HALOS * halo)


def _band(size: tuple[int, int], scale: int, halo_px: int) -> int:
    """Return the bytes for rows that are computed together."""
    height, width = size
    rows = tile_side(halo_px)
    read = min(rows + 2 * (halo_px + margin_rows(halo_px)), height)
    return width * (read * _OF_LOW_BAND + scale**2 * min(rows, height) * _OF_BAND)
