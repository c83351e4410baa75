"""Separation of a normal map into a shape component and a detail component."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from acquisition import DataError, MapRows
from acquisition.files import Form, Maps
from processing.detail.rotation import rotate_from_z, rotate_to_z
from processing.detail.shape_filter import ShapeFilter
from processing.maps.metrics import angle_map_deg
from processing.maps.normal_map import NormalMap, check_normal_map
from processing.stages.stage import Need, NormalRows, Size, Step
from rig import Progress, check_type, no_progress
from rig.arrays import Bool, Float32, Float64

# The interpreter, libraries and compiled kernels.
_FIXED = 330_000_000
# Bytes per pixel: of a map in memory besides those of its separation, and of masks while the maps
# are on disk.
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
    >>> from processing import NormalMap, ShapeFilter
    >>> from processing.detail import SeparationStage
    >>> from processing.stages import computed
    >>> y, x = np.mgrid[1:-1:32j, -1:1:32j]
    >>> bowl = NormalMap.from_vectors(np.dstack([x, y, 0 * x + 2]))
    >>> computed(SeparationStage(ShapeFilter(w=3)), bowl)["shape"][10:12].shape
    (2, 32, 3)
    """

    name: ClassVar = "detail"

    shape_filter: ShapeFilter = ShapeFilter()

    def need(self, *sizes: Size) -> Need:
        """Return the memory for a map of (height, width)."""
        ((height, width),) = sizes
        halo, of_pixel = self.shape_filter.halo, self.shape_filter.pixel_bytes
        rows = min(LEAST_ROWS + 2 * halo, height)
        return Need(
            _FIXED + height * width * (_MAP + of_pixel),
            _FIXED + width * (_ON_DISK * height + rows * of_pixel),
            f"a normal map of {width} x {height} pixels",
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
        most = None
        if memory is not None:
            free = (memory - _FIXED - _ON_DISK * mask.size) // (mask.shape[1] * by.pixel_bytes)
            most = useful_rows(free - 2 * by.halo, by.halo)

        def split(rows: slice) -> None:
            parts = separate_rows(normals, mask, rows, shape_filter=by)
            maps["shape"][rows], maps["detail"][rows] = parts

        def judge(rows: slice) -> None:
            left, _ = separate_rows(maps["detail"], mask, rows, shape_filter=by)
            angles = angle_map_deg(left, (0.0, 0.0, 1.0), mask[rows])
            maps["sums"][rows] = sums_of_rows(angles, mask[rows])

        return [Step("split", len(mask), split, most), Step("judge", len(mask), judge, most)]

    @staticmethod
    def separability_deg(maps: Maps, mask: Bool) -> float:
        """Return the mean angle of `Separation.separability_deg`."""
        return _mean_of(maps["sums"][:], mask)


def separate_rows(
    normals: MapRows, mask: Bool, rows: slice, *, shape_filter: ShapeFilter = ShapeFilter()
) -> tuple[Float32, Float32]:
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
    >>> from processing import NormalMap, ShapeFilter, separate
    >>> from processing.detail import separate_rows
    >>> y, x = np.mgrid[1:-1:64j, -1:1:32j]
    >>> bowl, by = NormalMap.from_vectors(np.dstack([x, y, 0 * x + 2])), ShapeFilter(w=3)
    >>> _, part = separate_rows(bowl.normals, bowl.mask, slice(20, 30), shape_filter=by)
    >>> bool((part == separate(bowl, shape_filter=by).detail.normals[20:30]).all())
    True
    """
    height, width = mask.shape
    shape_filter.check_size((height, width))
    halo = shape_filter.halo
    top, bottom = max(0, rows.start - halo), min(height, rows.stop + halo)
    inner = slice(rows.start - top, rows.stop - top)
    if not mask[rows].any():
        empty = np.zeros((rows.stop - rows.start, width, 3), np.float32)
        return empty, empty.copy()
    read = np.ascontiguousarray(normals[top:bottom], np.float32)
    shape, detail = shape_filter.split(NormalMap.of_unit_vectors(read, mask[top:bottom]))
    return shape.normals[inner], detail.normals[inner]


def useful_rows(rows: int, halo: int) -> int:
    """Return the rows of a band: as many as fit, but not more than are useful."""
    return max(1, min(rows, max(_MOST_MARGINS * halo, _MOST_ROWS)))


def fixed() -> int:
    """Return the bytes of the interpreter, libraries and compiled kernels."""
    return _FIXED


@dataclass(frozen=True, eq=False)
class Separation:
    """The shape and detail components of one normal map; `combine` is the inverse operation.

    Parameters
    ----------
    shape
        The low-pass filtered normals.
    detail
        The normals in the local frame whose z is the shape's normal; (0, 0, 1) means no detail.
    shape_filter
        The filter that separated them.
    """

    shape: NormalMap
    detail: NormalMap
    shape_filter: ShapeFilter

    def __repr__(self) -> str:
        return f"Separation({self.shape!r}, {self.shape_filter!r})"

    @cached_property
    def separability_map_deg(self) -> Float32:
        """``(H, W)`` angle between the shape component of the detail and z, NaN outside the mask.

        0 means that the detail contains no shape (the paper's detail separability).
        """
        mask = self.detail.mask
        left = self.shape_filter.shape(self.detail).normals
        return angle_map_deg(left, (0.0, 0.0, 1.0), mask)

    @property
    def separability_deg(self) -> float:
        """Mean of `separability_map_deg` over the mask."""
        return mean_over(self.separability_map_deg, self.detail.mask)


def sums_of_rows(values: Float32, mask: Bool) -> Float64:
    """Return the sum of each row over a mask, which does not depend on the other rows."""
    return np.asarray(np.where(mask, values, np.float32(0)).sum(axis=1, dtype=np.float64))


def mean_over(values: Float32, mask: Bool) -> float:
    """Return the mean over a mask, equal to that of bands of rows."""
    return _mean_of(sums_of_rows(values, mask), mask)


def _mean_of(sums: Float64, mask: Bool) -> float:
    return float(sums.sum() / np.count_nonzero(mask))


def separate(
    normal_map: NormalMap,
    *,
    shape_filter: ShapeFilter = ShapeFilter(),
    on_progress: Progress = no_progress,
) -> Separation:
    """Separate a normal map into shape and detail.

    Parameters
    ----------
    normal_map
        The map; outside its mask both components are 0.
    shape_filter
        The low-pass filter; ``ShapeFilter(order=1)`` is the paper's.
    on_progress
        Receives the stage ``detail``, one step per pass of the filter and one for the normals.

    Returns
    -------
    Separation
        Its components; `combine` restores the map from them to 5e-5 degree.

    Raises
    ------
    DataError
        If the filter is unknown or its window is larger than the map.

    Examples
    --------
    >>> import numpy as np
    >>> from processing import NormalMap, ShapeFilter, separate
    >>> y, x = np.mgrid[1:-1:32j, -1:1:32j]
    >>> bowl = NormalMap.from_vectors(np.dstack([x, y, 0 * x + 2]))
    >>> separate(bowl, shape_filter=ShapeFilter(w=3)).detail
    NormalMap(float32[32, 32, 3], 1024 normals)
    """
    check_normal_map("normal_map", normal_map)
    check_type("shape_filter", shape_filter, ShapeFilter, "ShapeFilter(kind, order, w)")
    return Separation(*shape_filter.split(normal_map, on_progress), shape_filter)


def relative_detail(normal_map: NormalMap, shape: NormalMap) -> NormalMap:
    """Return the detail relative to any shape (eq. ``eq_detail_form`` of the paper).

    `combine` of the shape and this detail restores the map.

    Parameters
    ----------
    normal_map, shape
        Maps of the same size. The shape need not be the low-pass part of the map.

    Returns
    -------
    NormalMap
        Normals in the local frames of the shape, known where both maps are known.

    Raises
    ------
    DataError
        If the sizes differ or the masks do not overlap.

    Examples
    --------
    >>> import numpy as np
    >>> from processing import NormalMap
    >>> from processing.detail import relative_detail
    >>> y, x = np.mgrid[1:-1:24j, -1:1:24j]
    >>> bowl = NormalMap.from_vectors(np.dstack([x, y, 0 * x + 2]))
    >>> round(float(relative_detail(bowl, bowl).normals[3, 4, 2]), 6)
    1.0
    """
    mask = _common_mask("normal_map", normal_map, shape)
    return NormalMap.of_unit_vectors(rotate_to_z(normal_map.normals, shape.normals), mask)


def combine(shape: NormalMap, detail: NormalMap) -> NormalMap:
    """Combine a shape component and a detail component (eq. ``eq_transfer`` of the paper).

    Parameters
    ----------
    shape, detail
        Components of the same size, from the same normal map or from two maps.

    Returns
    -------
    NormalMap
        Normals, known where both components are known.

    Raises
    ------
    DataError
        If the sizes differ or the masks do not overlap.

    Examples
    --------
    >>> import numpy as np
    >>> from processing import NormalMap, angular_error, combine, separate
    >>> y, x = np.mgrid[1:-1:24j, -1:1:24j]
    >>> ripples = NormalMap.from_vectors(np.dstack([x + np.sin(40 * x), y, 0 * x + 2]))
    >>> parts = separate(ripples)
    >>> angular_error(combine(parts.shape, parts.detail), ripples).mae_deg < 1e-3
    True
    """
    mask = _common_mask("detail", detail, shape)
    # The result is 0 where either component is 0.
    return NormalMap.of_unit_vectors(rotate_from_z(detail.normals, shape.normals), mask)


def _common_mask(name: str, normal_map: NormalMap, shape: NormalMap) -> Bool:
    check_normal_map("shape", shape)
    check_normal_map(name, normal_map)
    what = "a normal map" if name == "normal_map" else f"a {name}"
    if shape.size != normal_map.size:
        raise DataError(
            f"a shape of {shape.size[1]} x {shape.size[0]} pixels and {what} of "
            f"{normal_map.size[1]} x {normal_map.size[0]} cannot be combined: they must have the "
            "same size"
        )
    mask = shape.mask & normal_map.mask
    if not mask.any():
        raise DataError(f"the masks of shape and {what[2:]} do not overlap: nothing to combine")
    return mask
