"""Write the results of the stages into a folder, and return the figures to report."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import acquisition
import processing
from sgp._console import Stages, shown
from sgp._metrics import NormalsMetrics, SeparationMetrics, SurfaceMetrics
from sgp._result import Result


def write_normals_stage(folder: Path, stage: processing.Reconstruction) -> Result:
    """Write normals.exr and .png, albedo, residual, used and mask; return files and figures."""
    solved = stage.stereo
    result = Result(warnings=list(stage.warnings))
    with Stages() as progress:
        result.outputs = processing.write_normals(folder, solved.normal_map, on_progress=progress)
    for name in shown("writing maps", ("albedo", "residual", "used")):
        path = folder / f"{name}.exr"
        acquisition.write_exr(path, getattr(solved, name).astype(np.float32))
        result.outputs[name] = path
    metrics = normals_metrics(stage)
    result.metrics = metrics
    solved_share = solved.normal_map.mask.sum() / stage.mask.sum()
    result.summary = [
        f"{len(stage.lights)} images, {metrics['lights']} lights, "
        f"{solved_share:.1%} of {metrics['pixels']} pixels solved"
    ]
    if stage.error is not None:
        result.summary.append(
            f"against ground truth: mean {stage.error.mae_deg:.2f} deg, "
            f"median {stage.error.median_deg:.2f} deg"
        )
    return result


def normals_metrics(stage: processing.Reconstruction) -> NormalsMetrics:
    """Return the figures of an estimation of normals."""
    solved = stage.stereo
    inside = solved.normal_map.mask
    metrics: NormalsMetrics = {
        "images": len(stage.lights),
        "lights": "near" if stage.lights.near else "distant",
        "pixels": int(stage.mask.sum()),
        "coverage": float(inside.sum() / stage.mask.sum()),
        "residual_rms": float(
            np.sqrt(np.mean(np.square(solved.residual[inside], dtype=np.float64)))
        ),
    }
    if stage.error is not None:
        metrics["coverage"] = stage.error.coverage
        metrics["mae_deg"] = stage.error.mae_deg
        metrics["median_deg"] = stage.error.median_deg
    return metrics


def write_separation(folder: Path, parts: processing.Separation) -> Result:
    """Write shape and detail as EXR and 16-bit PNG, with their mask; return files and figures."""
    outputs: dict[str, Path] = {}
    with Stages() as progress:
        for name, part in (("shape", parts.shape), ("detail", parts.detail)):
            outputs |= processing.write_normals(folder, part, name, on_progress=progress)
        progress("measuring the detail", 0, 1)
        metrics = separation_metrics(parts)
        progress("measuring the detail", 1, 1)
    separability = metrics["separability_deg"]
    return Result(
        outputs=outputs,
        metrics=metrics,
        summary=[f"separability {separability:.2f} deg (shape left in the detail; 0 is best)"],
    )


def separation_metrics(parts: processing.Separation) -> SeparationMetrics:
    """Return the figures of a separation."""
    return {"separability_deg": parts.separability_deg}


def write_surface(
    folder: Path,
    height_map: processing.HeightMap,
    normal_map: processing.NormalMap,
    *,
    formats: tuple[str, ...] = ("ply",),
) -> Result:
    """Write height.exr, depth.exr if there is a depth, mask.png and meshes."""
    result = Result(warnings=list(height_map.warnings))
    result.outputs = {"height": folder / "height.exr", "mask": folder / "mask.png"}
    maps = {"height": height_map.height}
    if height_map.depth is not None:
        result.outputs["depth"] = folder / "depth.exr"
        maps["depth"] = height_map.depth
    for name in shown("writing maps", list(maps)):
        acquisition.write_exr(result.outputs[name], maps[name])
    acquisition.write_mask(result.outputs["mask"], height_map.mask)
    for suffix in shown("writing meshes", formats):
        result.outputs[suffix] = folder / f"surface.{suffix}"
        processing.write_mesh(result.outputs[suffix], height_map, normals=normal_map)
    metrics = surface_metrics(height_map)
    result.metrics = metrics
    result.summary = [
        f"height range {metrics['height_range']:.4g} {metrics['unit']}, "
        f"{metrics['vertices']} vertices"
    ]
    return result


def surface_metrics(height_map: processing.HeightMap) -> SurfaceMetrics:
    """Return the figures of a surface."""
    inside = height_map.height[height_map.mask]
    return {
        "unit": height_map.unit,
        "height_range": float(np.ptp(inside)),
        "vertices": len(inside),
        "parts": int(height_map.parts.max()) + 1,
        "iterations": height_map.iterations,
    }
