"""The recorded deviations of differences in height, for measuring on the page (decision 66)."""

from __future__ import annotations

from typing import Any

from sgp._report.folder import ResultFolder
from sgp._report.maps import scale


def height_differences(folder: ResultFolder) -> dict[str, list[float]] | None:
    """Return distances and the standard deviations there, in the unit; None without a record."""
    for record in folder.records.values():
        distances: Any = record.metrics.get("difference_distances_px")
        sigma: Any = record.metrics.get("difference_sigma")
        if distances and sigma and len(distances) == len(sigma):
            size = scale(folder)[1] or 1.0
            return {"distances": [size * one for one in distances], "sigma": sigma}
    return None
