"""Shape and detail of some rows of a normal map, for maps that are larger than memory."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from acquisition import MapRows
from processing._detail.shape_filter import ShapeFilter
from processing._normal_map import NormalMap

Float = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]

# Bytes per pixel of a band: normals, shape, detail, and what the filter computes of them.
_OF_BAND, _OF_EDGE_AWARE_BAND = 50, 160


def separate_rows(
    normals: MapRows, mask: Mask, rows: slice, *, shape_filter: ShapeFilter = ShapeFilter()
) -> tuple[Float, Float]:
    """Return shape and detail of some rows of a normal map.

    The filter is local: it reads `ShapeFilter.margin` rows above and below, too. Rows are equal to
    those of `separate`, except that those of a bilateral filter differ by rounding (less than
    1e-5): OpenCV tabulates its weights over the range of the values that it receives.

    Parameters
    ----------
    normals
        ``(H, W, 3)`` float32 unit vectors inside the mask and 0 outside, not checked; an array, or
        a map on disk, of which rows are read.
    mask
        ``(H, W)`` bool.
    rows
        Rows to separate, with start and stop.
    shape_filter
        The low-pass filter.

    Returns
    -------
    shape, detail
        ``(rows, W, 3)`` float32 each, 0 outside the mask.

    Raises
    ------
    DataError
        If the window of the filter is larger than the map.

    Examples
    --------
    >>> import numpy as np
    >>> from processing import NormalMap, ShapeFilter, separate, separate_rows
    >>> y, x = np.mgrid[1:-1:64j, -1:1:32j]
    >>> bowl, by = NormalMap.from_vectors(np.dstack([x, y, 0 * x + 2])), ShapeFilter(w=3)
    >>> _, part = separate_rows(bowl.normals, bowl.mask, slice(20, 30), shape_filter=by)
    >>> bool((part == separate(bowl, shape_filter=by).detail.normals[20:30]).all())
    True
    """
    height, width = mask.shape
    shape_filter.check_size((height, width))
    # A window that is cut at the border of the map must still fit.
    margin = max(shape_filter.margin, 2 * shape_filter.w)
    top, bottom = max(0, rows.start - margin), min(height, rows.stop + margin)
    inner = slice(rows.start - top, rows.stop - top)
    if not mask[rows].any():
        empty = np.zeros((rows.stop - rows.start, width, 3), np.float32)
        return empty, empty.copy()
    read = np.ascontiguousarray(normals[top:bottom], np.float32)
    shape, detail = shape_filter.split(NormalMap.of_unit_vectors(read, mask[top:bottom]))
    return shape.normals[inner], detail.normals[inner]


def memory_of_separation(size: tuple[int, int], shape_filter: ShapeFilter = ShapeFilter()) -> int:
    """Return the bytes that `separate` needs for a map of (height, width), besides the map.

    Examples
    --------
    >>> from processing import memory_of_separation
    >>> memory_of_separation((3000, 4000)) // 1_000_000
    600
    """
    edge_aware = shape_filter.kind in ("guided", "bilateral")
    return size[0] * size[1] * (_OF_EDGE_AWARE_BAND if edge_aware else _OF_BAND)
