"""What records state for measuring: deviations of differences, the camera (decision 66)."""

from __future__ import annotations

from typing import Any

from sgp._report.folder import ResultFolder
from sgp._report.maps import Embedded, scale


def height_differences(folder: ResultFolder) -> dict[str, list[float]] | None:
    """Return distances and the standard deviations there, in the unit; None without a record."""
    for record in folder.records.values():
        distances: Any = record.metrics.get("difference_distances_px")
        sigma: Any = record.metrics.get("difference_sigma")
        if distances and sigma and len(distances) == len(sigma):
            size = scale(folder)[1] or 1.0
            return {"distances": [size * one for one in distances], "sigma": sigma}
    return None


def camera_of(folder: ResultFolder, maps: Embedded) -> dict[str, Any] | None:
    """Return distance and axis of a perspective camera; None if the view counts as parallel.

    The axis has x to the right and y up from the middle of the embedded rectangle, in the unit.
    """
    for record in folder.records.values():
        distance: Any = record.metrics.get("camera_distance")
        axis: Any = record.metrics.get("camera_axis_px")
        if not distance or not axis or "height" not in maps.planes:
            continue
        size = maps.pixel_size / maps.crop.step
        column, row = (
            (one.start + one.stop - 1) / 2 for one in (maps.crop.columns, maps.crop.rows)
        )
        place = [size * (axis[0] - column), size * (row - axis[1])]
        return {"distance": float(distance), "axis": place}
    return None
