"""Write a surface into a folder, and return the figures to report."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

import acquisition
import processing
import rig
from sgp._console import shown
from sgp._result import Result
from sgp._stage_metrics import SurfaceMetrics
from sgp._stage_options import SurfaceOptions
from sgp._write_doubts import add_height_sigma, height_sigma_lines, write_curl
from sgp._write_jumps import write_jumps
from sgp._write_meshes import write_meshes

_SURFACE = SurfaceOptions()
# Values that are read at once.
_READ = 4_000_000


def write_surface(
    folder: Path,
    height_map: processing.HeightMap,
    normal_map: processing.NormalMap,
    options: SurfaceOptions = _SURFACE,
    *,
    colours: npt.NDArray[np.uint8] | None = None,
    sigma_deg: npt.NDArray[np.float32] | None = None,
) -> Result:
    """Write height as .exr and .png, depth.exr if there is a depth, doubts, mask and meshes.

    ``colours`` are sRGB samples for the meshes, ``sigma_deg`` deviations of the normals.
    """
    curl = processing.normal_curl(normal_map, camera=height_map.camera, sigma_deg=sigma_deg)
    residual = processing.normal_residual(height_map, normal_map)
    errors = height_map.uncertainty
    inside = height_map.height[height_map.mask]
    metrics = surface_metrics(height_map)
    result = write_height_maps(
        folder,
        height_map,
        (float(inside.min()), float(inside.max())),
        curl,
        residual,
        metrics,
        None if errors is None else errors.sigma,
    )
    result.warnings = [*height_map.warnings, *result.warnings]
    if errors is None and options.height_sigma:
        text = "heights have no standard deviations, because those of the normals are not known"
        result.warnings.append(rig.Notice("height-sigma-unknown", text))
    if height_map.jumps is not None:
        result.outputs |= write_jumps(folder, height_map.jumps)
    meshes, figures, notices = write_meshes(folder, height_map, normal_map, options, colours)
    result.outputs |= meshes
    result.warnings += notices
    result.metrics = {**metrics, **figures}
    result.summary = [
        *surface_lines(metrics),
        *height_sigma_lines(height_map),
        *residual_lines(metrics),
        *_jumps_line(metrics),
    ]
    if "deviation_rms" in figures:
        result.summary.append(
            f"meshes of {figures['triangles']} triangles, {figures['deviation_rms']:.2g} "
            f"{metrics['unit']} rms and at most {figures['deviation_largest']:.2g} "
            f"{metrics['unit']} from the surface"
        )
    return result


def write_height_maps(
    folder: Path,
    surface: processing.HeightRows,
    extremes: tuple[float, float],
    curl: processing.NormalCurl,
    residual: acquisition.MapRows,
    metrics: SurfaceMetrics,
    sigma: acquisition.MapRows | None = None,
) -> Result:
    """Write the maps of a surface that is in memory or in files; add their figures to ``metrics``.

    Parameters
    ----------
    folder
        The folder.
    surface
        The surface.
    extremes
        Its lowest and highest height.
    curl
        The curl of its normals.
    residual
        ``(H, W)`` float32 angles between the given normals and those of the surface.
    metrics
        Figures of the surface.
    sigma
        ``(H, W)`` float32 standard deviations of the heights.
    """
    result = Result(warnings=[*_scale_notice(surface), *processing.curl_notices(curl, surface)])
    result.outputs = {"height": folder / "height.exr", "mask": folder / "mask.png"}
    values: dict[str, acquisition.MapRows] = {
        "height": surface.height,
        "normal_residual_deg": residual,
        "curl_deg": curl.curl_deg,
    }
    if sigma is not None:
        values["height_sigma"] = sigma
    if surface.depth is not None:
        values["depth"] = surface.depth
    for name in shown("writing maps", list(values)):
        result.outputs[name] = folder / f"{name}.exr"
        acquisition.write_exr(result.outputs[name], values[name])
    acquisition.write_mask(result.outputs["mask"], surface.mask)
    _write_height_picture(folder / "height.png", surface, extremes, result)
    result.outputs["curl_png"] = write_curl(folder, curl)
    if np.isfinite(curl.spread_deg):
        metrics["curl_deg"] = curl.spread_deg
    if np.isfinite(curl.excess):
        metrics["curl_excess"] = curl.excess
    mean = _mean(residual)
    if np.isfinite(mean):
        metrics["normal_residual_deg"] = mean
    return result


def _mean(values: acquisition.MapRows) -> float:
    """Return the mean of values that are not NaN; sums of rows do not depend on bands."""
    height, width = values.shape
    sums, count = [], 0
    for rows in acquisition.rows_in_bands(height, width, _READ):
        part = values[rows]
        sums.append(np.nansum(part, axis=1, dtype=np.float64))
        count += int(np.count_nonzero(np.isfinite(part)))
    return float(np.concatenate(sums).sum() / count) if count else np.nan


def surface_lines(metrics: SurfaceMetrics) -> list[str]:
    """Return the line about the size of a surface."""
    return [
        f"height range {metrics['height_range']:.4g} {metrics['unit']}, "
        f"{metrics['vertices']} vertices"
    ]


def residual_lines(metrics: SurfaceMetrics) -> list[str]:
    """Return the line about the normals of a surface."""
    if "normal_residual_deg" not in metrics:
        return []
    angle = metrics["normal_residual_deg"]
    curl = f", their curl is {metrics['curl_deg']:.2f} deg" if "curl_deg" in metrics else ""
    return [f"normals of the surface differ from the given ones by {angle:.2f} deg (mean){curl}"]


def _jumps_line(metrics: SurfaceMetrics) -> list[str]:
    if "jumps" not in metrics:
        return []
    return [f"{metrics['jumps']} jumps between pixels, {metrics['pieces']} pieces between jumps"]


def _write_height_picture(
    path: Path, surface: processing.HeightRows, extremes: tuple[float, float], result: Result
) -> None:
    scale = processing.height_scale(*extremes)
    pixels = acquisition.ComputedRows(
        surface.mask.shape,
        np.dtype(np.uint16),
        lambda rows: processing.height_samples(surface.height[rows], scale),
    )
    stated = f"{scale.base:.9g} + {scale.step:.9g} * sample"
    description = f"height in {surface.unit} = {stated}; sample 0: no height"
    acquisition.write_png(path, pixels, description=description)
    result.outputs["height_png"] = path
    result.parameters["height_png"] = {
        "base": scale.base,
        "step": scale.step,
        "unit": surface.unit,
    }


def _scale_notice(surface: processing.HeightRows) -> list[rig.Notice]:
    """Return a notice if a reader of the mesh could take pixels for millimetres."""
    if surface.unit == "mm":
        return []
    text = (
        "the scale is not known: heights and meshes are in pixels, and a program that reads a mesh "
        "in mm takes each pixel for 1 mm; give --pixel-mm, or a camera with a working distance"
    )
    return [rig.Notice("surface-without-scale", text, "", "info")]


def surface_metrics(height_map: processing.HeightMap) -> SurfaceMetrics:
    """Return the figures of a surface."""
    inside = height_map.height[height_map.mask]
    metrics: SurfaceMetrics = {
        "unit": height_map.unit,
        "pixel_size": height_map.pixel_size,
        "height_range": float(np.ptp(inside)),
        "vertices": len(inside),
        "parts": int(height_map.parts.max()) + 1,
        "iterations": height_map.iterations,
        "disagreement_deg": height_map.disagreement_deg,
        "curl": None if np.isnan(height_map.curl) else height_map.curl,
    }
    add_camera(metrics, height_map)
    add_height_sigma(metrics, height_map)
    jumps = height_map.jumps
    if jumps is not None:
        metrics["jumps"] = jumps.count
        metrics["pieces"] = int(jumps.pieces.max()) + 1
        metrics["settled"] = jumps.settled
    return metrics


def add_camera(metrics: SurfaceMetrics, surface: processing.HeightRows) -> None:
    """Add the place of the camera of a perspective surface."""
    camera = surface.camera
    if camera is not None and surface.depth is not None:
        metrics["camera_distance"] = surface.pixel_size * camera.focal_px
        metrics["camera_axis_px"] = [float(camera.K[0, 2]), float(camera.K[1, 2])]
