"""Write a surface into a folder, and return the figures to report."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import acquisition
import processing
import rig
from sgp.cli.console import shown
from sgp.pictures import write_jumps
from sgp.results import Result, SurfaceMetrics
from sgp.stages.options import SurfaceOptions
from sgp.stages.write_doubts import add_height_sigma, height_sigma_lines, write_curl
from sgp.stages.write_meshes import write_meshes

_SURFACE = SurfaceOptions()
# Values that are read at once.
_READ = 4_000_000


def write_surface(
    folder: Path,
    surface: processing.HeightMap,
    normal_map: processing.stages.NormalRows,
    options: SurfaceOptions = _SURFACE,
    *,
    colours: acquisition.MapRows | None = None,
    sigma_deg: acquisition.MapRows | None = None,
    maps: acquisition.files.Maps | None = None,
) -> Result:
    """Write height as .exr and .png, depth.exr if there is a depth, doubts, mask and meshes.

    Parameters
    ----------
    folder
        The folder.
    surface, normal_map
        The surface, and the normals that it was integrated from.
    options
        Formats and figures.
    colours
        sRGB samples for the meshes.
    sigma_deg
        Standard deviations of the normals.
    maps
        Holds ``curl`` and ``residual`` until they are written; default: they are in memory.
    """
    curl = processing.normal_curl(
        normal_map,
        camera=surface.camera,
        sigma_deg=sigma_deg,
        into=None if maps is None else maps["curl"],
    )
    residual = processing.normal_residual(
        surface, normal_map, into=None if maps is None else maps["residual"]
    )
    errors, jumps = surface.uncertainty, surface.jumps
    metrics = surface_metrics(surface)
    result = Result(
        warnings=[
            *surface.warnings,
            *_scale_notice(surface),
            *processing.surface.curl_notices(curl),
        ]
    )
    result.outputs = {"height": folder / "height.exr", "mask": folder / "mask.png"}
    values = {
        "height": surface.maps["height"],
        "normal_residual_deg": residual,
        "curl_deg": curl.curl_deg,
    }
    if errors is not None:
        values["height_sigma"] = errors.sigma
    if "depth" in surface.maps:
        values["depth"] = surface.maps["depth"]
    for name in shown("writing maps", list(values)):
        result.outputs[name] = folder / f"{name}.exr"
        acquisition.write_exr(result.outputs[name], values[name])
    acquisition.write_mask(result.outputs["mask"], surface.mask)
    _write_height_picture(folder / "height.png", surface, result)
    result.outputs["curl_png"] = write_curl(folder, curl)
    if np.isfinite(curl.spread_deg):
        metrics["curl_deg"] = curl.spread_deg
    if np.isfinite(curl.excess):
        metrics["curl_excess"] = curl.excess
    mean = _mean(residual)
    if np.isfinite(mean):
        metrics["normal_residual_deg"] = mean
    if errors is None and options.height_sigma:
        text = "heights have no standard deviations, because those of the normals are not known"
        result.warnings.append(rig.Notice("height-sigma-unknown", text))
    if jumps is not None:
        result.outputs |= write_jumps(folder, jumps)
    meshes, figures, notices = write_meshes(folder, surface, normal_map, options, colours)
    result.outputs |= meshes
    result.warnings += notices
    result.metrics = {**metrics, **figures}
    result.summary = _lines(surface, metrics)
    if "deviation_rms" in figures:
        result.summary.append(
            f"meshes of {figures['triangles']} triangles, {rig.figure(figures['deviation_rms'])} "
            f"{metrics['unit']} rms and at most {rig.figure(figures['deviation_largest'])} "
            f"{metrics['unit']} from the surface"
        )
    return result


def _mean(values: acquisition.MapRows) -> float:
    """Return the mean of values that are not NaN; sums of rows do not depend on bands."""
    height, width = values.shape
    sums, count = [], 0
    for rows in acquisition.files.rows_in_bands(height, width, _READ):
        part = values[rows]
        sums.append(np.nansum(part, axis=1, dtype=np.float64))
        count += int(np.count_nonzero(np.isfinite(part)))
    return float(np.concatenate(sums).sum() / count) if count else np.nan


def _lines(surface: processing.HeightMap, metrics: SurfaceMetrics) -> list[str]:
    """Return the lines about a surface."""
    unit = metrics["unit"]
    lines = [f"height range {metrics['height_range']:.4g} {unit}, {metrics['vertices']} vertices"]
    if surface.blocks is not None:
        lines.append(
            f"solved in {surface.blocks.number} blocks of rows: differs from the surface of the "
            f"whole by at most {rig.figure(surface.blocks.error)} {unit} (estimated)"
        )
    lines += height_sigma_lines(surface)
    if "normal_residual_deg" in metrics:
        angle = metrics["normal_residual_deg"]
        curl = f", their curl is {metrics['curl_deg']:.2f} deg" if "curl_deg" in metrics else ""
        lines.append(
            f"normals of the surface differ from the given ones by {angle:.2f} deg (mean){curl}"
        )
    if "jumps" in metrics:
        lines.append(
            f"{metrics['jumps']} jumps between pixels, {metrics['pieces']} pieces between jumps"
        )
    return lines


def _write_height_picture(path: Path, surface: processing.HeightMap, result: Result) -> None:
    picture = processing.surface.height_picture(surface)
    stated = f"{picture.base:.9g} + {picture.step:.9g} * sample"
    description = f"height in {surface.unit} = {stated}; sample 0: no height"
    acquisition.write_png(path, picture.pixels, description=description)
    result.outputs["height_png"] = path
    result.parameters["height_png"] = {
        "base": picture.base,
        "step": picture.step,
        "unit": surface.unit,
    }


def _scale_notice(surface: processing.HeightMap) -> list[rig.Notice]:
    """Return a notice if a reader of the mesh could take pixels for millimetres."""
    if surface.unit == "mm":
        return []
    text = (
        "the scale is not known: heights and meshes are in pixels, and a program that reads a mesh "
        "in mm takes each pixel for 1 mm; give --pixel-mm, or a camera with a working distance"
    )
    return [rig.Notice("surface-without-scale", text, "", "info")]


def surface_metrics(surface: processing.HeightMap) -> SurfaceMetrics:
    """Return the figures of a surface."""
    lowest, highest = surface.extremes
    metrics: SurfaceMetrics = {
        "unit": surface.unit,
        "pixel_size": surface.pixel_size,
        "height_range": float(np.float32(highest) - np.float32(lowest)),
        "vertices": int(np.count_nonzero(surface.mask)),
        "parts": surface.part_count,
        "iterations": surface.iterations,
        "disagreement_deg": surface.disagreement_deg,
        "curl": None if np.isnan(surface.curl) else surface.curl,
    }
    if surface.blocks is not None:
        metrics["blocks"] = surface.blocks.number
        metrics["block_rounds"] = surface.blocks.rounds
        metrics["block_error"] = surface.blocks.error
    camera, jumps = surface.camera, surface.jumps
    if camera is not None and "depth" in surface.maps:
        metrics["camera_distance"] = surface.pixel_size * camera.focal_px
        metrics["camera_axis_px"] = [float(camera.K[0, 2]), float(camera.K[1, 2])]
    add_height_sigma(metrics, surface)
    if jumps is not None:
        metrics["jumps"] = jumps.count
        metrics["pieces"] = int(jumps.pieces.max()) + 1
        metrics["settled"] = jumps.settled
    return metrics
