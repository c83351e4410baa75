"""Separation of a normal map into a shape component and a detail component."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from acquisition import DataError
from processing._detail.rotation import rotate_from_z, rotate_to_z
from processing._detail.shape_filter import ShapeFilter
from processing._metrics import angle_map_deg
from processing._normal_map import NormalMap, check_normal_map
from rig import Progress, no_progress

Sums = npt.NDArray[np.float64]


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
    def separability_map_deg(self) -> npt.NDArray[np.float32]:
        """``(H, W)`` angle between the shape component of the detail and z, NaN outside the mask.

        0 means that the detail contains no shape (the paper's detail separability).
        """
        mask = self.detail.mask
        left = self.shape_filter.shape(self.detail).normals
        return angle_map_deg(left, (0.0, 0.0, 1.0), mask)

    @property
    def separability_deg(self) -> float:
        """Mean of `separability_map_deg` over the mask."""
        mask = self.detail.mask
        return float(sums_of_rows(self.separability_map_deg, mask).sum() / np.count_nonzero(mask))


def sums_of_rows(values: npt.NDArray[np.float32], mask: npt.NDArray[np.bool_]) -> Sums:
    """Return the sum of each row over a mask, which does not depend on the other rows."""
    sums: Sums = np.where(mask, values, np.float32(0)).sum(axis=1, dtype=np.float64)
    return sums


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
    >>> from processing import NormalMap, relative_detail
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


def _common_mask(name: str, normal_map: NormalMap, shape: NormalMap) -> npt.NDArray[np.bool_]:
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
