"""Figures and pictures of super-resolution."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

import acquisition
import processing
import rig
from sgp._detail_metrics import SuperresMetrics
from sgp._overview import write_overview
from sgp._panels.crop import Crop
from sgp._panels.maps import lit_vectors_panel, map_panel
from sgp._result import Result

Mask = npt.NDArray[np.bool_]

# Side of the part that is shown at its own resolution, and of the blocks in which it is found.
_PART_PX, _BLOCK_PX = 240, 16
# How far an interpolation depends on its surroundings, and a margin.
_AROUND_PX = 8
# Rows that are read at once, in blocks.
_READ = 8


@dataclass(frozen=True)
class Enlarged:
    """An enlarged normal map and the given one, in memory or in files.

    Parameters
    ----------
    made
        The result.
    normals, mask
        ``(H, W, 3)`` and ``(H, W)``, its normals.
    low, low_mask
        ``(h, w, 3)`` and ``(h, w)``, the given normals.
    warnings, files
        Those of the reader.
    """

    made: processing.SuperResolution | processing.StoredSuperResolution
    normals: acquisition.MapRows
    mask: Mask
    low: acquisition.MapRows
    low_mask: Mask
    warnings: tuple[rig.Notice, ...]
    files: tuple[Path, ...]

    @classmethod
    def in_memory(
        cls, made: processing.SuperResolution, read: processing.NormalMapFile
    ) -> Enlarged:
        """Return a result in memory and the map that was read."""
        high, low = made.normal_map, read.normal_map
        return cls(made, high.normals, high.mask, low.normals, low.mask, read.warnings, read.files)

    @classmethod
    def on_disk(
        cls, made: processing.StoredSuperResolution, warnings: tuple[rig.Notice, ...]
    ) -> Enlarged:
        """Return a result in files, with the notices about the given map."""
        return cls(made, made.normals, made.mask, made.low, made.low_mask, warnings, made.files)


def write_superres_maps(out: Path, enlarged: Enlarged) -> dict[str, Path]:
    """Write the standard deviations, if there are any, and what was invented."""
    made, outputs = enlarged.made, {"invented": out / "invented.png"}

    def shares(rows: slice) -> npt.NDArray[Any]:
        return np.rint(made.invented[rows] * 255).astype(np.uint8)

    pixels = acquisition.ComputedRows(enlarged.mask.shape, np.dtype(np.uint8), shares)
    acquisition.write_png(outputs["invented"], pixels)
    if made.sigma_deg is not None:
        outputs["normal_sigma_deg"] = out / "normal_sigma_deg.exr"
        acquisition.write_exr(outputs["normal_sigma_deg"], made.sigma_deg)
    return outputs


def measure_superres(enlarged: Enlarged, result: Result) -> None:
    """Add the figures and the summary."""
    made, (height, width) = enlarged.made, enlarged.mask.shape
    sigma = made.median_sigma_deg
    metrics: SuperresMetrics = {
        "width": width,
        "height": height,
        "pixels": int(np.count_nonzero(enlarged.mask)),
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


def write_superres_picture(path: Path, name: str, enlarged: Enlarged) -> None:
    """Draw the part to which most was added at its own resolution, and the maps."""
    made, mask = enlarged.made, enlarged.mask
    scale = made.scale
    rows, columns = _part(made.added_deg, mask, scale)
    coarse = Crop(
        slice(rows.start // scale, rows.stop // scale),
        slice(columns.start // scale, columns.stop // scale),
    )
    plain, inside = _interpolated(enlarged, coarse)
    fine, whole = Crop(rows, columns), Crop.around(mask)
    shown = f"result, {mask.shape[1]} x {mask.shape[0]} pixels"
    panels = [
        lit_vectors_panel("part of the given map", enlarged.low, enlarged.low_mask, coarse),
        lit_vectors_panel("bicubic interpolation", plain.normals, plain.mask, inside),
        lit_vectors_panel("result", enlarged.normals, mask, fine),
        lit_vectors_panel(shown, enlarged.normals, mask, whole),
    ]
    if made.sigma_deg is not None:
        title = "angle to interpolation"
        panels += [
            map_panel(title, made.added_deg, "deg", whole, error=True, mask=mask),
            map_panel("standard deviation", made.sigma_deg, "deg", whole, error=True),
        ]
    write_overview(path, f"{name}, scale {scale}", panels, columns=3)


def _interpolated(enlarged: Enlarged, part: Crop) -> tuple[processing.NormalMap, Crop]:
    """Return the bicubic interpolation of the surroundings of a part, and the part in it."""
    scale, low = enlarged.made.scale, enlarged.low_mask
    rows, columns = (
        slice(max(span.start - _AROUND_PX, 0), min(span.stop + _AROUND_PX, length))
        for span, length in zip((part.rows, part.columns), low.shape, strict=True)
    )
    around = processing.NormalMap(enlarged.low[rows][:, columns], low[rows, columns])
    mask = enlarged.mask[_enlarged(rows, scale), _enlarged(columns, scale)]
    made = processing.super_resolve(around, scale, method="bicubic", mask=mask)
    inner_rows, inner_columns = (
        _enlarged(slice(span.start - outer.start, span.stop - outer.start), scale)
        for span, outer in ((part.rows, rows), (part.columns, columns))
    )
    return made.normal_map, Crop(inner_rows, inner_columns)


def _part(added_deg: acquisition.MapRows, mask: Mask, scale: int) -> tuple[slice, slice]:
    """Return the window to which the network added most, in steps of the blocks."""
    height, width = mask.shape
    edges = np.arange(0, width, _BLOCK_PX)
    sums = []
    for top in range(0, height, _READ * _BLOCK_PX):
        rows = slice(top, min(top + _READ * _BLOCK_PX, height))
        added = np.where(mask[rows], added_deg[rows] + 1e-3, 0).astype(np.float64)
        across = np.add.reduceat(added, edges, axis=1)
        sums.append(np.add.reduceat(across, np.arange(0, len(added), _BLOCK_PX), axis=0))
    blocks = np.concatenate(sums)
    sides = [min(_PART_PX // _BLOCK_PX, count) for count in blocks.shape]
    windows = np.lib.stride_tricks.sliding_window_view(blocks, sides).sum(axis=(2, 3))
    best = np.unravel_index(int(np.argmax(windows)), windows.shape)
    spans = []
    for first, length in zip(best, mask.shape, strict=True):
        side = min(_PART_PX, length)
        start = min(int(first) * _BLOCK_PX, length - side) // scale * scale
        spans.append(slice(start, start + side // scale * scale))
    return spans[0], spans[1]


def _enlarged(span: slice, scale: int) -> slice:
    return slice(span.start * scale, span.stop * scale)
