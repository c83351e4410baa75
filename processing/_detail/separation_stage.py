"""The separation of a normal map as a stage: its maps, its steps, its memory."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from acquisition import Form, MapRows, Maps
from processing._detail.separation import sums_of_rows
from processing._detail.shape_filter import ShapeFilter
from processing._metrics import angle_map_deg
from processing._normal_map import NormalMap
from processing._stages.stage import Need, NormalRows, Size, Step, size_of

Float = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]

# The interpreter, libraries and compiled kernels.
_FIXED = 330_000_000
# Bytes per pixel that is separated: normals, shape, detail, and what the filter computes of them.
_OF_BAND, _OF_EDGE_AWARE_BAND = 50, 225
# Bytes per pixel: of a map in memory besides that, and of masks while the maps are on disk.
_MAP, _ON_DISK = 13, 6
LEAST_ROWS = 8
# A band of fewer margins would compute most rows several times.
_MOST_MARGINS, _MOST_ROWS = 16, 512


@dataclass(frozen=True)
class SeparationStage:
    """The separation of a normal map into shape and detail.

    The maps ``shape`` and ``detail`` are ``(H, W, 3)`` float32 unit vectors, 0 outside the mask,
    equal to those of `separate`.

    Parameters
    ----------
    shape_filter
        The low-pass filter.

    Examples
    --------
    >>> import numpy as np
    >>> from processing import NormalMap, SeparationStage, ShapeFilter, computed
    >>> y, x = np.mgrid[1:-1:32j, -1:1:32j]
    >>> bowl = NormalMap.from_vectors(np.dstack([x, y, 0 * x + 2]))
    >>> computed(SeparationStage(ShapeFilter(w=3)), bowl)["shape"][10:12].shape
    (2, 32, 3)
    """

    name: ClassVar = "detail"

    shape_filter: ShapeFilter = ShapeFilter()

    def need(self, *sizes: Size) -> Need:
        """Return the memory for a map of (height, width)."""
        (size,) = sizes
        return Need(
            memory_of_separation(size, self.shape_filter),
            _least_memory_of_separation(size, self.shape_filter),
            f"a normal map of {size[1]} x {size[0]} pixels",
        )

    def forms(self, *sizes: Size) -> Mapping[str, Form]:
        """Return shapes and types of the maps."""
        (size,) = sizes
        self.shape_filter.check_size(size)
        vectors = (*size, 3), np.float32
        return {"shape": vectors, "detail": vectors, "sums": (size[:1], np.float64)}

    def steps(self, maps: Maps, *inputs: NormalRows, memory: int | None = None) -> list[Step]:
        """Return the steps: the components, then the shape that is left in the detail."""
        (given,) = inputs
        normals, mask, by = given.normals, given.mask, self.shape_filter
        most = None if memory is None else _rows_of_band(size_of(given), by, memory)

        def split(rows: slice) -> None:
            parts = separate_rows(normals, mask, rows, shape_filter=by)
            maps["shape"][rows], maps["detail"][rows] = parts

        def judge(rows: slice) -> None:
            left, _ = separate_rows(maps["detail"], mask, rows, shape_filter=by)
            angles = angle_map_deg(left, (0.0, 0.0, 1.0), mask[rows])
            maps["sums"][rows] = sums_of_rows(angles, mask[rows])

        return [Step("split", len(mask), split, most), Step("judge", len(mask), judge, most)]

    @staticmethod
    def separability_deg(maps: Maps, mask: Mask) -> float:
        """Return the mean angle of `Separation.separability_deg`."""
        return float(maps["sums"][:].sum() / np.count_nonzero(mask))


def separate_rows(
    normals: MapRows, mask: Mask, rows: slice, *, shape_filter: ShapeFilter = ShapeFilter()
) -> tuple[Float, Float]:
    """Return shape and detail of some rows of a normal map.

    The filter is local: it reads `ShapeFilter.margin` rows above and below, too. Rows are equal to
    those of `separate`.

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
    margin = halo_rows(shape_filter)
    top, bottom = max(0, rows.start - margin), min(height, rows.stop + margin)
    inner = slice(rows.start - top, rows.stop - top)
    if not mask[rows].any():
        empty = np.zeros((rows.stop - rows.start, width, 3), np.float32)
        return empty, empty.copy()
    read = np.ascontiguousarray(normals[top:bottom], np.float32)
    shape, detail = shape_filter.split(NormalMap.of_unit_vectors(read, mask[top:bottom]))
    return shape.normals[inner], detail.normals[inner]


def halo_rows(shape_filter: ShapeFilter) -> int:
    """Return the rows above and below that `separate_rows` reads."""
    # A window that is cut at the border of the map must still fit.
    return max(shape_filter.margin, 2 * shape_filter.w)


def memory_of_separation(size: tuple[int, int], shape_filter: ShapeFilter = ShapeFilter()) -> int:
    """Return the bytes that a program needs to read and `separate` a map of (height, width).

    Examples
    --------
    >>> from processing import memory_of_separation
    >>> memory_of_separation((3000, 4000)) // 1_000_000
    1086
    """
    return _FIXED + size[0] * size[1] * (_MAP + pixel_bytes(shape_filter))


def _least_memory_of_separation(
    size: tuple[int, int], shape_filter: ShapeFilter = ShapeFilter()
) -> int:
    """Return the bytes that `separate_on_disk` needs at least.

    Examples
    --------
    >>> from processing import least_memory_of_separation
    >>> least_memory_of_separation((3000, 4000)) // 1_000_000
    451
    """
    rows = min(LEAST_ROWS + 2 * halo_rows(shape_filter), size[0])
    return _FIXED + size[1] * (_ON_DISK * size[0] + rows * pixel_bytes(shape_filter))


def _rows_of_band(size: tuple[int, int], shape_filter: ShapeFilter, memory: int) -> int:
    """Return the rows of a band for which a number of bytes is enough."""
    halo = halo_rows(shape_filter)
    free = memory - _FIXED - _ON_DISK * size[0] * size[1]
    rows = free // (size[1] * pixel_bytes(shape_filter)) - 2 * halo
    return useful_rows(rows, halo)


def useful_rows(rows: int, halo: int) -> int:
    """Return the rows of a band: as many as fit, but not more than are useful."""
    return max(1, min(rows, max(_MOST_MARGINS * halo, _MOST_ROWS)))


def fixed() -> int:
    """Return the bytes of the interpreter, libraries and compiled kernels."""
    return _FIXED


def pixel_bytes(shape_filter: ShapeFilter) -> int:
    """Return the bytes per pixel that is separated."""
    return _OF_EDGE_AWARE_BAND if shape_filter.kind in ("guided", "bilateral") else _OF_BAND
