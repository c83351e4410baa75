"""Figures and pictures of super-resolution."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

import acquisition
import processing
from sgp._detail_metrics import SuperresMetrics
from sgp._overview import write_overview
from sgp._panels.crop import Crop
from sgp._panels.maps import lit_panel, map_panel
from sgp._result import Result

# Side of the part that is shown at its own resolution.
_PART_PX = 240


def write_superres_maps(out: Path, made: processing.SuperResolution) -> dict[str, Path]:
    """Write the standard deviations, if there are any, and what was invented."""
    outputs = {"invented": out / "invented.png"}
    shares = np.rint(made.invented * 255).astype(np.uint8)
    acquisition.write_png(outputs["invented"], shares)
    if made.sigma_deg is not None:
        outputs["normal_sigma_deg"] = out / "normal_sigma_deg.exr"
        acquisition.write_exr(outputs["normal_sigma_deg"], made.sigma_deg)
    return outputs


def measure_superres(made: processing.SuperResolution, result: Result) -> None:
    """Add the figures and the summary."""
    height, width = made.normal_map.size
    sigma = made.median_sigma_deg
    metrics: SuperresMetrics = {
        "width": width,
        "height": height,
        "pixels": int(np.count_nonzero(made.normal_map.mask)),
        "invented_share": made.invented_share,
        "added_deg": made.mean_added_deg,
        "normal_sigma_deg": None if np.isnan(sigma) else sigma,
        "model_sha256": None if made.model is None else made.model.sha256,
    }
    result.metrics = metrics
    by = "bicubic interpolation" if made.model is None else f"{made.model.name} ({made.method})"
    result.summary = [f"{width} x {height} pixels, {metrics['pixels']} on the object, by {by}"]
    if made.model is not None:
        result.summary += [
            f"added          {made.mean_added_deg:.2f} deg on average to an interpolation, "
            f"{made.invented_share:.1%} of the detail",
            f"deviation      {sigma:.2f} deg (median)",
        ]


def write_superres_picture(
    path: Path, name: str, low: processing.NormalMap, made: processing.SuperResolution
) -> None:
    """Draw the part to which most was added at its own resolution, and the maps."""
    scale, high = made.scale, made.normal_map
    plain = processing.super_resolve(low, scale, method="bicubic", mask=high.mask)
    rows, columns = _part(made)
    coarse = Crop(
        slice(rows.start // scale, rows.stop // scale),
        slice(columns.start // scale, columns.stop // scale),
    )
    fine = Crop(
        slice(coarse.rows.start * scale, coarse.rows.stop * scale),
        slice(coarse.columns.start * scale, coarse.columns.stop * scale),
    )
    whole = Crop.around(high.mask)
    panels = [
        lit_panel("part of the given map", low, coarse),
        lit_panel("bicubic interpolation", plain.normal_map, fine),
        lit_panel("result", high, fine),
        lit_panel(f"result, {high.size[1]} x {high.size[0]} pixels", high, whole),
    ]
    if made.sigma_deg is not None:
        added = np.where(high.mask, made.added_deg, np.float32(np.nan))
        panels += [
            map_panel("angle to interpolation", added, "deg", whole, error=True),
            map_panel("standard deviation", made.sigma_deg, "deg", whole, error=True),
        ]
    write_overview(path, f"{name}, scale {scale}", panels, columns=3)


def _part(made: processing.SuperResolution) -> tuple[slice, slice]:
    """Return the window to which the network added most."""
    height, width = made.normal_map.size
    side = min(_PART_PX, height, width)
    added = np.where(made.normal_map.mask, made.added_deg + 1e-3, 0).astype(np.float32)
    means = cv2.boxFilter(added, -1, (side, side), borderType=cv2.BORDER_CONSTANT)
    inner = means[side // 2 : height - (side - 1) // 2, side // 2 : width - (side - 1) // 2]
    best = np.unravel_index(int(np.argmax(inner)), inner.shape)
    row, column = (int(first) // made.scale * made.scale for first in best)
    return slice(row, row + side), slice(column, column + side)
