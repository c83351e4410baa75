"""Whether a surface is solved as a whole or in blocks, by the memory that it may use."""

from __future__ import annotations

from dataclasses import dataclass

import processing
import rig
from sgp._exit import UsageError
from sgp._memory_limit import size_text, too_small

# Interpreter, libraries and bands of rows that are written.
_PROGRAM = 330_000_000
# Bytes per pixel of a surface in memory: the normals while it is solved, all maps and the mesh,
# measured at 5 and 20 megapixels; depths and deviations are additional maps.
_NORMALS, _WRITING, _MAP = 14, 105, 8
# Bytes per pixel in blocks while the files are written: masks, and a map for its median; and of
# the temporary and final files.
_FINISHING = 12
_TEMPORARY, _FILES = 64, 75
_CAMERA_FILES, _SIGMA_FILES, _STL_FILE = 12, 4, 100
_ROWS = 8  # a block has a multiple of these


@dataclass(frozen=True)
class SurfaceWay:
    """How a surface is solved.

    Parameters
    ----------
    size
        Height and width of the map.
    rows
        Most rows of a block; None to solve it as a whole.
    memory
        Bytes of memory that it needs.
    disk
        Bytes of disk for files, temporary ones included; 0 as a whole, when they are not stated.
    """

    size: tuple[int, int]
    rows: int | None
    memory: int
    disk: int = 0

    def line(self) -> str:
        """Return what it needs, as a line for people."""
        height, width = self.size
        pixels = f"surface of {width} x {height} pixels"
        if self.rows is None:
            return f"{pixels}: as a whole, needs about {size_text(self.memory)} of memory"
        return (
            f"{pixels}: in blocks of {self.rows} rows, needs about {size_text(self.memory)} of "
            f"memory and {size_text(self.disk)} of disk"
        )


def surface_way(
    memory: int | None,
    size: tuple[int, int],
    *,
    camera: bool,
    sigma: bool,
    stl: bool,
    whole_for: list[str],
) -> SurfaceWay:
    """Return how a surface is solved within a memory.

    Parameters
    ----------
    memory
        Bytes to use; None for half of what is free.
    size
        Height and width of the map.
    camera, sigma, stl
        Whether these are given or written.
    whole_for
        Options that need the complete surface in memory. Without a stated memory, they are tried
        in any case.

    Raises
    ------
    UsageError
        If the memory is too small.
    """
    whole = _whole(size, camera=camera, sigma=sigma)
    budget = rig.memory_budget(memory)
    if whole <= budget or (whole_for and memory is None):
        return SurfaceWay(size, None, whole)
    pixels = f"a surface of {size[1]} x {size[0]} pixels"
    if whole_for and memory is not None:
        raise UsageError(
            f"--memory {size_text(memory)} is too small for {pixels} with {whole_for[0]}, which "
            f"needs the complete surface: give --memory {size_text(whole)}, or leave "
            f"{whole_for[0]} out"
        )
    needs = _blocks(size, camera=camera, sigma=sigma)
    fits = [rows for rows, need in needs.items() if need <= budget]
    if not fits:
        least = min(needs.values(), default=whole)
        if memory is not None:
            raise too_small(memory, pixels, min(least, whole))
        fits = [min(needs, key=lambda rows: needs[rows])] if needs else []
        if least >= whole:
            return SurfaceWay(size, None, whole)
    rows = max(fits)
    per_pixel = (
        _TEMPORARY + _FILES + camera * _CAMERA_FILES + sigma * _SIGMA_FILES + stl * _STL_FILE
    )
    return SurfaceWay(size, rows, needs[rows], size[0] * size[1] * per_pixel)


def _whole(size: tuple[int, int], *, camera: bool, sigma: bool) -> int:
    pixels = size[0] * size[1]
    solving = processing.surface_memory(size, camera=camera, sigma=sigma) + _NORMALS * pixels
    writing = _WRITING + (camera + sigma) * _MAP
    return _PROGRAM + max(solving, writing * pixels)


def _blocks(size: tuple[int, int], *, camera: bool, sigma: bool) -> dict[int, int]:
    """Return the bytes for each number of rows of a block."""
    height, width = size
    found = {}
    for count in range(2, height // _ROWS):
        rows = -(-height // (count * _ROWS)) * _ROWS
        if rows not in found:
            solving = processing.surface_memory(size, rows=rows, camera=camera, sigma=sigma)
            found[rows] = _PROGRAM + max(solving + height * width, _FINISHING * height * width)
    return found
