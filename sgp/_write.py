"""Write the results of the stages into a folder, and return the figures to report."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import numpy.typing as npt

import acquisition
import processing
import rig
from sgp._console import Stages, shown
from sgp._metrics import NormalsMetrics, SeparationMetrics, SurfaceMetrics
from sgp._output import provenance
from sgp._quality import add_quality, quality_lines
from sgp._result import Result
from sgp._stage_options import MapOptions, SurfaceOptions
from sgp._uncertainty import Normals, add_uncertainty, sigma_lines
from sgp._write_doubts import add_height_sigma, height_sigma_lines, write_curl
from sgp._write_jumps import write_jumps
from sgp._write_meshes import write_meshes

_WRITERS = 2  # files that are encoded at the same time
_FLOATS = ("albedo", "residual", "specular", "normal_sigma_deg")
# Values that are read at once.
_READ = 4_000_000
_MAPS, _SURFACE = MapOptions(), SurfaceOptions()


def write_normals_stage(
    folder: Path,
    stage: Normals,
    maps: MapOptions = _MAPS,
    picture: processing.AlbedoPicture | None = None,
    *,
    command: str,
    files: list[Path],
) -> Result:
    """Write normals, albedo, error bars and maps of doubts; return files and figures.

    ``picture`` is that of the albedo, if it is known. Estimated strengths of lights are written
    with their provenance: the command and its input files.
    """
    result, maps_of = Result(warnings=list(stage.warnings)), stage.maps
    with Stages() as progress:
        result.outputs = processing.write_normal_rows(
            folder, maps_of["normals"], stage.valid, green=maps.green_out, on_progress=progress
        )
    values = {name: maps_of[name] for name in _FLOATS} | {"used": _as_float(maps_of["used"])}
    result.outputs |= {name: folder / f"{name}.exr" for name in values}
    with ThreadPoolExecutor(_WRITERS) as pool:
        written = [
            pool.submit(acquisition.write_exr, result.outputs[name], values[name])
            for name in values
        ]
        for done in shown("writing maps", written):
            done.result()
    for name in (*(f"samples_{kind.name.lower()}" for kind in processing.SampleKind), "validity"):
        result.outputs[name] = folder / f"{name}.png"
        acquisition.write_png(result.outputs[name], maps_of[name])
    white = _write_albedo(folder / "albedo.png", maps_of["albedo"], stage.valid, picture)
    result.outputs["albedo_png"] = folder / "albedo.png"
    result.parameters = {"albedo_png": {"white": white}}
    metrics = normals_metrics(stage)
    result.metrics = metrics
    if stage.strengths is not None:
        result.outputs["lights"] = folder / "lights.json"
        chosen = {"source": stage.source.path, "semi_calibrated": True}
        acquisition.write_lights(
            result.outputs["lights"],
            stage.strengths.lights,
            provenance=provenance(command, chosen, files),
        )
    solved_share = stage.valid.sum() / stage.mask.sum()
    result.summary = [
        *quality_lines(stage.quality),
        *_height_line(metrics),
        *_strength_line(stage.strengths),
        *sigma_lines(metrics),
        f"{len(stage.lights)} images, {metrics['lights']} lights, "
        f"{solved_share:.1%} of {metrics['pixels']} pixels solved",
    ]
    if stage.error is not None:
        result.summary.append(
            f"against ground truth: mean {stage.error.mae_deg:.2f} deg, "
            f"median {stage.error.median_deg:.2f} deg"
        )
    return result


def _as_float(values: acquisition.MapRows) -> acquisition.MapRows:
    kind = np.dtype(np.float32)
    return acquisition.ComputedRows(values.shape, kind, lambda rows: values[rows].astype(kind))


def _write_albedo(
    path: Path,
    albedo: acquisition.MapRows,
    mask: npt.NDArray[np.bool_],
    picture: processing.AlbedoPicture | None,
) -> float:
    """Write the albedo as a picture, and return the albedo at white."""
    if picture is None:
        white = processing.albedo_white(albedo, mask)
        pixels: acquisition.MapRows = acquisition.ComputedRows(
            albedo.shape,
            np.dtype(np.uint8),
            lambda rows: processing.albedo_samples(albedo[rows], mask[rows], white),
        )
    else:
        pixels, white = picture
    description = f"albedo / {white:.6g} as sRGB"
    acquisition.write_png(path, pixels, srgb=True, description=description)
    return white


def _residual_rms(stage: Normals) -> float:
    residual = stage.maps["residual"]
    height, width = residual.shape
    bands = acquisition.rows_in_bands(height, width, _READ)
    # Sums of rows do not depend on the bands; the residual is 0 where there is no normal.
    of_rows = [np.square(residual[rows], dtype=np.float64).sum(axis=1) for rows in bands]
    return float(np.sqrt(np.concatenate(of_rows).sum() / np.count_nonzero(stage.valid)))


def _height_line(metrics: NormalsMetrics) -> list[str]:
    if "mean_height_mm" not in metrics:
        return []
    sigma = metrics.get("mean_height_sigma_mm")
    # Gloss would shift the height that explains the images best.
    known = "" if sigma is None else f" (sd {sigma:.2g}, if it is matte)"
    mean, lowest = metrics["mean_height_mm"], metrics["lowest_height_mm"]
    return [
        f"mean height {mean:.2f} mm above the working plane{known}, lowest part {lowest:.2f} mm"
    ]


def _strength_line(strengths: processing.LightStrengths | None) -> list[str]:
    if strengths is None:
        return []
    factors = strengths.factors
    return [
        f"strengths of lights {factors.min():.2f} to {factors.max():.2f} of the given ones "
        f"(sd {np.median(strengths.sigmas):.1%}); their geometric mean is fixed"
    ]


def normals_metrics(stage: Normals) -> NormalsMetrics:
    """Return the figures of an estimation of normals."""
    metrics: NormalsMetrics = {
        "images": len(stage.lights),
        "lights": "near" if stage.lights.near else "distant",
        "pixels": int(stage.mask.sum()),
        "coverage": float(stage.valid.sum() / stage.mask.sum()),
        "residual_rms": _residual_rms(stage),
    }
    add_quality(metrics, stage.quality)
    add_uncertainty(metrics, stage)
    near = stage.near_height
    if near is not None and near.steps:
        metrics["mean_height_mm"] = near.mean_height_mm
        metrics["lowest_height_mm"] = near.lowest_mm
        metrics["height_changes_mm"] = [step.change_mm for step in near.steps]
        if np.isfinite(near.mean_height_sigma_mm):
            metrics["mean_height_sigma_mm"] = near.mean_height_sigma_mm
    if stage.excluded:
        metrics["excluded"] = list(stage.excluded)
    if stage.strengths is not None:
        metrics["strength_sigma"] = float(np.median(stage.strengths.sigmas))
    if stage.error is not None:
        metrics["coverage"] = stage.error.coverage
        metrics["mae_deg"] = stage.error.mae_deg
        metrics["median_deg"] = stage.error.median_deg
    return metrics


def write_separation(
    folder: Path,
    parts: processing.Separation | processing.StoredSeparation,
    maps: MapOptions = _MAPS,
) -> Result:
    """Write shape and detail as EXR and 16-bit PNG, with their mask; return files and figures."""
    outputs: dict[str, Path] = {}
    with Stages() as progress:
        for name, (normals, mask) in _components(parts).items():
            outputs |= processing.write_normal_rows(
                folder, normals, mask, name, green=maps.green_out, on_progress=progress
            )
        progress("measuring the detail", 0, 1)
        metrics = separation_metrics(parts)
        progress("measuring the detail", 1, 1)
    separability = metrics["separability_deg"]
    return Result(
        outputs=outputs,
        metrics=metrics,
        summary=[f"separability {separability:.2f} deg (shape left in the detail; 0 is best)"],
    )


def _components(
    parts: processing.Separation | processing.StoredSeparation,
) -> dict[str, tuple[acquisition.MapRows, npt.NDArray[np.bool_]]]:
    if isinstance(parts, processing.StoredSeparation):
        return {"shape": (parts.shape, parts.mask), "detail": (parts.detail, parts.mask)}
    components = {"shape": parts.shape, "detail": parts.detail}
    return {name: (part.normals, part.mask) for name, part in components.items()}


def separation_metrics(
    parts: processing.Separation | processing.StoredSeparation,
) -> SeparationMetrics:
    """Return the figures of a separation."""
    return {"separability_deg": parts.separability_deg}


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
    result = Result(warnings=[*height_map.warnings, *_scale_notice(height_map)])
    curl = processing.normal_curl(normal_map, camera=height_map.camera, sigma_deg=sigma_deg)
    result.warnings += processing.curl_notices(curl, height_map)
    result.outputs = {"height": folder / "height.exr", "mask": folder / "mask.png"}
    residual = processing.normal_residual(height_map, normal_map)
    result.outputs["normal_residual_deg"] = folder / "normal_residual_deg.exr"
    result.outputs["curl_deg"] = folder / "curl_deg.exr"
    values = {
        "height": height_map.height,
        "normal_residual_deg": residual,
        "curl_deg": curl.curl_deg,
    }
    errors = height_map.uncertainty
    if errors is not None:
        result.outputs["height_sigma"] = folder / "height_sigma.exr"
        values["height_sigma"] = errors.sigma
    elif options.height_sigma:
        text = "heights have no standard deviations, because those of the normals are not known"
        result.warnings.append(rig.Notice("height-sigma-unknown", text))
    if height_map.depth is not None:
        result.outputs["depth"] = folder / "depth.exr"
        values["depth"] = height_map.depth
    for name in shown("writing maps", list(values)):
        acquisition.write_exr(result.outputs[name], values[name])
    acquisition.write_mask(result.outputs["mask"], height_map.mask)
    _write_height_picture(folder / "height.png", height_map, result)
    result.outputs["curl_png"] = write_curl(folder, curl)
    if height_map.jumps is not None:
        result.outputs |= write_jumps(folder, height_map.jumps)
    meshes, figures, notices = write_meshes(folder, height_map, normal_map, options, colours)
    result.outputs |= meshes
    result.warnings += notices
    metrics = surface_metrics(height_map)
    if np.isfinite(curl.spread_deg):
        metrics["curl_deg"] = curl.spread_deg
    if np.isfinite(curl.excess):
        metrics["curl_excess"] = curl.excess
    if np.isfinite(residual).any():
        metrics["normal_residual_deg"] = float(np.nanmean(residual, dtype=np.float64))
    result.metrics = {**metrics, **figures}
    result.summary = [
        f"height range {metrics['height_range']:.4g} {metrics['unit']}, "
        f"{metrics['vertices']} vertices",
        *height_sigma_lines(height_map),
        *_residual_line(metrics),
        *_jumps_line(metrics),
    ]
    if "deviation_rms" in figures:
        result.summary.append(
            f"meshes of {figures['triangles']} triangles, {figures['deviation_rms']:.2g} "
            f"{metrics['unit']} rms and at most {figures['deviation_largest']:.2g} "
            f"{metrics['unit']} from the surface"
        )
    return result


def _residual_line(metrics: SurfaceMetrics) -> list[str]:
    if "normal_residual_deg" not in metrics:
        return []
    angle = metrics["normal_residual_deg"]
    curl = f", their curl is {metrics['curl_deg']:.2f} deg" if "curl_deg" in metrics else ""
    return [f"normals of the surface differ from the given ones by {angle:.2f} deg (mean){curl}"]


def _jumps_line(metrics: SurfaceMetrics) -> list[str]:
    if "jumps" not in metrics:
        return []
    return [f"{metrics['jumps']} jumps between pixels, {metrics['pieces']} pieces between jumps"]


def _write_height_picture(path: Path, height_map: processing.HeightMap, result: Result) -> None:
    picture = processing.height_picture(height_map)
    scale = f"{picture.base:.9g} + {picture.step:.9g} * sample"
    description = f"height in {height_map.unit} = {scale}; sample 0: no height"
    acquisition.write_png(path, picture.pixels, description=description)
    result.outputs["height_png"] = path
    result.parameters["height_png"] = {
        "base": picture.base,
        "step": picture.step,
        "unit": height_map.unit,
    }


def _scale_notice(height_map: processing.HeightMap) -> list[rig.Notice]:
    """Return a notice if a reader of the mesh could take pixels for millimetres."""
    if height_map.unit == "mm":
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
    camera = height_map.camera
    if camera is not None and height_map.depth is not None:
        metrics["camera_distance"] = height_map.pixel_size * camera.focal_px
        metrics["camera_axis_px"] = [float(camera.K[0, 2]), float(camera.K[1, 2])]
    add_height_sigma(metrics, height_map)
    jumps = height_map.jumps
    if jumps is not None:
        metrics["jumps"] = jumps.count
        metrics["pieces"] = int(jumps.pieces.max()) + 1
        metrics["settled"] = jumps.settled
    return metrics
