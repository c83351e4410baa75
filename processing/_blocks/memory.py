"""The memory that the integration of a normal map needs."""

from __future__ import annotations

from processing._blocks.plan import plan_blocks

# Bytes whatever the size, measured with those per pixel from 1 to 10 megapixels (decision 69).
_FIXED = 30_000_000
# Bytes per pixel of a surface that is solved as a whole; additional ones with a camera, and with
# deviations of the normals.
_WHOLE, _CAMERA, _SIGMA = 70, 45, 14
# Bytes per pixel of the largest block, of the rows that two blocks share, and of the map.
_BLOCK, _SHARED, _MAP = 82, 48, 2


def surface_memory(
    size: tuple[int, int], *, rows: int | None = None, camera: bool = False, sigma: bool = False
) -> int:
    """Return the bytes that the integration of a normal map needs, besides its inputs.

    The estimate is 3 to 55 % above the peaks that were measured from 1 to 10 megapixels. Jumps,
    priors and errors of heights need more.

    Parameters
    ----------
    size
        Height and width of the map.
    rows
        Most rows of a block, as for `integrate_in_blocks`; None for `integrate`.
    camera
        Whether a camera is given.
    sigma
        Whether deviations of the normals are given.

    Examples
    --------
    >>> from processing import surface_memory
    >>> whole = surface_memory((8944, 11180))
    >>> blocks = surface_memory((8944, 11180), rows=256)
    >>> f"{whole / 1e9:.1f} GB as a whole, {blocks / 1e9:.1f} GB in blocks"
    '7.0 GB as a whole, 1.7 GB in blocks'
    """
    height, width = size
    if rows is None:
        return _FIXED + height * width * (_WHOLE + camera * _CAMERA + sigma * _SIGMA)
    blocks = plan_blocks(height, rows)
    largest: int = max(block.rows.stop - block.rows.start for block in blocks.blocks)
    shared = 2 * blocks.halo * (len(blocks.blocks) - 1)
    of_rows = largest * (_BLOCK + camera * _CAMERA) + shared * _SHARED + height * _MAP
    return _FIXED + of_rows * width
