"""Write how sure a surface is: deviations of heights, and the curl of its normals."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import acquisition
import processing
from rig import figure
from rig.arrays import Float32, UInt8
from sgp.results import SurfaceMetrics

# The picture of the curl is saturated at this many robust standard deviations.
_SATURATED = 4
# Distances in the printed line.
_PRINTED = (1, 10, 100)


def write_curl(folder: Path, curl: processing.surface.NormalCurl) -> Path:
    """Write curl.png: white without curl, red positive, blue negative, black outside."""
    limit = max(_SATURATED * np.nan_to_num(curl.spread_deg), 0.1)

    def colours(rows: slice) -> UInt8:
        values = curl.curl_deg[rows]
        share = np.clip(np.nan_to_num(values) / limit, -1, 1)
        faded = 255 * (1 - np.abs(share))
        colour = np.stack(
            [np.where(share > 0, 255, faded), faded, np.where(share < 0, 255, faded)], axis=2
        )
        colour[np.isnan(values)] = 0
        samples: UInt8 = np.rint(colour).astype(np.uint8)
        return samples

    path = folder / "curl.png"
    text = f"curl of the normals, red positive, blue negative, saturated at {limit:.3g} degrees"
    shape = (*curl.curl_deg.shape, 3)
    pixels = acquisition.files.ComputedRows(shape, np.dtype(np.uint8), colours)
    acquisition.write_png(path, pixels, srgb=True, description=text)
    return path


def add_height_sigma(metrics: SurfaceMetrics, height_map: processing.HeightMap) -> None:
    """Add the deviations of heights to the figures, if they are known."""
    errors = height_map.uncertainty
    if errors is not None:
        metrics["height_sigma"] = _median(errors.sigma)
        metrics["difference_distances_px"] = list(errors.distances_px)
        metrics["difference_sigma"] = list(errors.difference_sigma)


def height_sigma_lines(height_map: processing.HeightMap) -> list[str]:
    """Return a line about the deviations of heights, if they are known."""
    errors = height_map.uncertainty
    if errors is None:
        return []
    unit, table = (
        height_map.unit,
        dict(zip(errors.distances_px, errors.difference_sigma, strict=True)),
    )
    shown = [distance for distance in _PRINTED if distance in table]
    text = f"standard deviation of heights {figure(_median(errors.sigma))} {unit} (median)"
    if shown:
        distances = ", ".join(map(str, shown))
        values = ", ".join(f"{figure(table[distance])}" for distance in shown)
        text += f"; of differences over {distances} px: {values} {unit}"
    return [text]


def _median(values: Float32) -> float:
    return float(np.nanmedian(values))
