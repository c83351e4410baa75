"""The separation of a normal map as a stage: its maps, its steps, its memory."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from acquisition import Form, Maps
from processing._detail.rows import (
    least_memory_of_separation,
    memory_of_separation,
    rows_of_band,
    separate_rows,
)
from processing._detail.separation import sums_of_rows
from processing._detail.shape_filter import ShapeFilter
from processing._metrics import angle_map_deg
from processing._stages.stage import Need, NormalRows, Size, Step, size_of

Mask = npt.NDArray[np.bool_]


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
            least_memory_of_separation(size, self.shape_filter),
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
        most = None if memory is None else rows_of_band(size_of(given), by, memory)

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
