"""Figures and pictures of super-resolution."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import acquisition
import processing
from rig.arrays import AnyArray, Bool
from sgp.pictures import Crop, Masked, lit_panel, map_panel, write_overview
from sgp.results import Result, SuperresMetrics

# Side of the part that is shown at its own resolution, and of the blocks in which it is found.
_PART_PX, _BLOCK_PX = 240, 16
# How far an interpolation depends on its surroundings, and a margin.
_AROUND_PX = 8
# Rows that are read at once, in blocks.
_READ = 8


def write_superres_maps(out: Path, made: processing.SuperResolution) -> dict[str, Path]:
    """Write the standard deviations, if there are any, and what was invented."""
    outputs = {"invented": out / "invented.png"}

    def shares(rows: slice) -> AnyArray:
        samples: AnyArray = np.rint(made.maps["invented"][rows] * 255).astype(np.uint8)
        return samples

    pixels = acquisition.files.ComputedRows(made.mask.shape, np.dtype(np.uint8), shares)
    acquisition.write_png(outputs["invented"], pixels)
    if "sigma_deg" in made.maps:
        outputs["normal_sigma_deg"] = out / "normal_sigma_deg.exr"
        acquisition.write_exr(outputs["normal_sigma_deg"], made.maps["sigma_deg"])
    return outputs


def measure_superres(made: processing.SuperResolution, result: Result) -> None:
    """Add the figures and the summary."""
    height, width = made.mask.shape
    sigma, model = made.median_sigma_deg, made.stage.model
    metrics: SuperresMetrics = {
        "width": width,
        "height": height,
        "pixels": int(np.count_nonzero(made.mask)),
        "invented_share": made.invented_share,
        "added_deg": made.mean_added_deg,
        "normal_sigma_deg": None if np.isnan(sigma) else sigma,
        "model_sha256": None if model is None else model.sha256,
    }
    result.metrics = metrics
    by = "bicubic interpolation" if model is None else f"{model.name} ({model.domain})"
    result.summary = [f"{width} x {height} pixels, {metrics['pixels']} on the object, by {by}"]
    if model is not None:
        result.summary += [
            f"added          {made.mean_added_deg:.2f} deg on average to an interpolation, "
            f"{made.invented_share:.1%} of the detail",
            f"deviation      {sigma:.2f} deg (median)",
        ]


def write_superres_picture(
    path: Path, name: str, made: processing.SuperResolution, low: processing.stages.NormalRows
) -> None:
    """Draw the part to which most was added at its own resolution, and the maps."""
    mask, maps, scale = made.mask, made.maps, made.stage.scale
    rows, columns = _part(maps["added_deg"], mask, scale)
    coarse = Crop(
        slice(rows.start // scale, rows.stop // scale),
        slice(columns.start // scale, columns.stop // scale),
    )
    plain, inside = _interpolated(made, low, coarse)
    fine, whole = Crop(rows, columns), Crop.around(mask)
    large = Masked(maps["normals"], mask)
    shown = f"result, {mask.shape[1]} x {mask.shape[0]} pixels"
    panels = [
        lit_panel("part of the given map", low, coarse),
        lit_panel("bicubic interpolation", plain, inside),
        lit_panel("result", large, fine),
        lit_panel(shown, large, whole),
    ]
    if "sigma_deg" in maps:
        title = "angle to interpolation"
        panels += [
            map_panel(title, maps["added_deg"], "deg", whole, error=True, mask=mask),
            map_panel("standard deviation", maps["sigma_deg"], "deg", whole, error=True),
        ]
    write_overview(path, f"{name}, scale {scale}", panels, columns=3)


def _interpolated(
    made: processing.SuperResolution, low: processing.stages.NormalRows, part: Crop
) -> tuple[processing.NormalMap, Crop]:
    """Return the bicubic interpolation of the surroundings of a part, and the part in it."""
    scale = made.stage.scale
    rows, columns = (
        slice(max(span.start - _AROUND_PX, 0), min(span.stop + _AROUND_PX, length))
        for span, length in zip((part.rows, part.columns), low.mask.shape, strict=True)
    )
    around = processing.NormalMap(low.normals[rows][:, columns], low.mask[rows, columns])
    mask = made.mask[_enlarged(rows, scale), _enlarged(columns, scale)]
    plain = processing.super_resolve(around, scale, method="bicubic", mask=mask)
    inner_rows, inner_columns = (
        _enlarged(slice(span.start - outer.start, span.stop - outer.start), scale)
        for span, outer in ((part.rows, rows), (part.columns, columns))
    )
    return plain.normal_map, Crop(inner_rows, inner_columns)


def _part(added_deg: acquisition.MapRows, mask: Bool, scale: int) -> tuple[slice, slice]:
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
