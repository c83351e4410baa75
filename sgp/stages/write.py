"""Write the results of the stages into a folder, and return the figures to report."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

import acquisition
import processing
from rig import figure
from rig.arrays import Bool
from sgp.cli.console import shown
from sgp.results import (
    NormalsMetrics,
    Result,
    SeparationMetrics,
    add_quality,
    add_uncertainty,
    good_result,
    provenance,
    quality_lines,
    sigma_lines,
)
from sgp.stages.options import MAPS, MapOptions

_WRITERS = 2  # files that are encoded at the same time
_FLOATS = ("albedo", "residual", "specular", "normal_sigma_deg")
# Values that are read at once.
_READ = 4_000_000


def write_normals_stage(
    folder: Path,
    stage: processing.Reconstruction,
    maps: MapOptions = MAPS,
    picture: processing.colour.AlbedoPicture | None = None,
    *,
    command: str,
    files: list[Path],
) -> Result:
    """Write normals, albedo, error bars and maps of doubts; return files and figures.

    ``picture`` is that of the albedo, if it is known. Lights with estimated strengths, or with
    positions that follow from a distance, are written with their provenance: the command and its
    input files.
    """
    result, maps_of = Result(warnings=list(stage.warnings)), stage.maps
    result.outputs = maps.write(folder, maps_of["normals"], stage.valid)
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
        acquisition.write_png(result.file(name, folder / f"{name}.png"), maps_of[name])
    white = _write_albedo(folder / "albedo.png", maps_of["albedo"], stage.valid, picture)
    result.outputs["albedo_png"] = folder / "albedo.png"
    result.parameters = {"albedo_png": {"white": white}}
    metrics = normals_metrics(stage)
    result.metrics = metrics
    _write_lights(result, folder / "lights.json", stage, command, files)
    result.verdict, result.good = stage.verdict, good_result(stage.verdict)
    solved_share = stage.valid.sum() / stage.mask.sum()
    result.summary = [
        *quality_lines(stage.quality),
        *_height_line(metrics),
        *_strength_line(stage.strengths),
        *_distance_line(metrics),
        *_ambient_line(metrics),
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


def _write_lights(
    result: Result, path: Path, stage: processing.Reconstruction, command: str, files: list[Path]
) -> None:
    """Write the lights if they are not those of the source."""
    lights = stage.source.lights if stage.strengths is None else stage.strengths.lights
    chosen: dict[str, object] = {}
    if stage.strengths is not None:
        chosen["semi_calibrated"] = True
    if stage.light_distance is not None:
        chosen["light_distance_mm"] = stage.light_distance.distance_mm
    if chosen and lights is not None:
        result.outputs["lights"] = path
        made_by = provenance(command, {"source": stage.source.path, **chosen}, files)
        acquisition.write_lights(path, lights, provenance=made_by)


def _as_float(values: acquisition.MapRows) -> acquisition.MapRows:
    kind = np.dtype(np.float32)
    return acquisition.files.ComputedRows(
        values.shape, kind, lambda rows: values[rows].astype(kind)
    )


def _write_albedo(
    path: Path,
    albedo: acquisition.MapRows,
    mask: Bool,
    picture: processing.colour.AlbedoPicture | None,
) -> float:
    """Write the albedo as a picture, and return the albedo at white."""
    if picture is None:
        white = processing.colour.albedo_white(albedo, mask)
        pixels: acquisition.MapRows = acquisition.files.ComputedRows(
            albedo.shape,
            np.dtype(np.uint8),
            lambda rows: processing.colour.albedo_samples(albedo[rows], mask[rows], white),
        )
    else:
        pixels, white = picture
    description = f"albedo / {white:.6g} as sRGB"
    acquisition.write_png(path, pixels, srgb=True, description=description)
    return white


def _residual_rms(stage: processing.Reconstruction) -> float:
    residual = stage.maps["residual"]
    height, width = residual.shape
    bands = acquisition.files.rows_in_bands(height, width, _READ)
    # Sums of rows do not depend on the bands; the residual is 0 where there is no normal.
    of_rows = [np.square(residual[rows], dtype=np.float64).sum(axis=1) for rows in bands]
    return float(np.sqrt(np.concatenate(of_rows).sum() / np.count_nonzero(stage.valid)))


def _height_line(metrics: NormalsMetrics) -> list[str]:
    if "mean_height_mm" not in metrics:
        return []
    sigma = metrics.get("mean_height_sigma_mm")
    # Gloss would shift the height that explains the images best.
    known = "" if sigma is None else f" (sd {figure(sigma)}, if it is matte)"
    mean, lowest = metrics["mean_height_mm"], metrics["lowest_height_mm"]
    return [
        f"mean height {mean:.2f} mm above the working plane{known}, lowest part {lowest:.2f} mm"
    ]


def _strength_line(strengths: processing.series.LightStrengths | None) -> list[str]:
    if strengths is None:
        return []
    factors = strengths.factors
    return [
        f"strengths of lights {factors.min():.2f} to {factors.max():.2f} of the given ones "
        f"(sd {np.median(strengths.sigmas):.1%}); their geometric mean is fixed"
    ]


def _distance_line(metrics: NormalsMetrics) -> list[str]:
    if "light_distance_mm" not in metrics:
        return []
    away, sigma = metrics["light_distance_mm"], metrics.get("light_distance_sigma_mm")
    known = "" if sigma is None else f" (sd {figure(sigma)})"
    return [
        f"lights {away:.0f} mm{known} from the middle of the object: their positions are written"
    ]


def _ambient_line(metrics: NormalsMetrics) -> list[str]:
    if "ambient_level" not in metrics:
        return []
    level, sigma = metrics["ambient_level"], metrics["ambient_sigma"]
    return [f"constant light of {level:.1%} of a light (sd {sigma:.1%}) subtracted"]


def normals_metrics(stage: processing.Reconstruction) -> NormalsMetrics:
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
    if stage.rescaled:
        metrics["rescaled"] = dict(stage.rescaled)
    if stage.source.shifts_px:
        metrics["shifts_px"] = {name: [*by] for name, by in stage.source.shifts_px.items()}
    if stage.strengths is not None:
        metrics["strength_sigma"] = float(np.median(stage.strengths.sigmas))
    if stage.light_distance is not None:
        metrics["light_distance_mm"] = stage.light_distance.distance_mm
        if stage.light_distance.sigma_mm:
            metrics["light_distance_sigma_mm"] = stage.light_distance.sigma_mm
    if stage.ambient is not None:
        metrics["ambient_level"] = stage.ambient.level
        metrics["ambient_sigma"] = stage.ambient.sigma
    if stage.error is not None:
        metrics["coverage"] = stage.error.coverage
        metrics["mae_deg"] = stage.error.mae_deg
        metrics["median_deg"] = stage.error.median_deg
    return metrics


def write_separation(
    folder: Path, parts: acquisition.files.Maps, mask: Bool, maps: MapOptions = MAPS
) -> Result:
    """Write shape and detail as EXR and 16-bit PNG, with their mask; return files and figures."""
    outputs = {
        key: path
        for name in ("shape", "detail")
        for key, path in maps.write(folder, parts[name], mask, name).items()
    }
    separability = processing.detail.SeparationStage.separability_deg(parts, mask)
    return Result(
        outputs=outputs,
        metrics=SeparationMetrics(separability_deg=separability),
        summary=[f"separability {separability:.2f} deg (shape left in the detail; 0 is best)"],
    )
