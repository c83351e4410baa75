"""Write the results of the stages into a folder, and return the figures to report."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import acquisition
import processing
from sgp._result import Result


def write_normals_stage(folder: Path, stage: processing.Reconstruction) -> Result:
    """Write normals.exr and .png, albedo, residual, used and mask; return files and figures."""
    solved = stage.stereo
    result = Result(warnings=list(stage.warnings))
    result.outputs = processing.write_normals(folder, solved.normal_map)
    for name in ("albedo", "residual", "used"):
        path = folder / f"{name}.exr"
        acquisition.write_exr(path, getattr(solved, name).astype(np.float32))
        result.outputs[name] = path
    inside = solved.normal_map.mask
    result.metrics = {
        "images": len(stage.lights),
        "lights": "near" if stage.lights.near else "distant",
        "pixels": int(stage.mask.sum()),
        "coverage": float(inside.sum() / stage.mask.sum()),
        "residual_rms": float(np.sqrt(np.mean(solved.residual[inside] ** 2, dtype=np.float64))),
    }
    result.summary = [
        f"{len(stage.lights)} images, {result.metrics['lights']} lights, "
        f"{result.metrics['coverage']:.1%} of {result.metrics['pixels']} pixels solved"
    ]
    if stage.error is not None:
        result.metrics |= {
            "mae_deg": stage.error.mae_deg,
            "median_deg": stage.error.median_deg,
            "coverage": stage.error.coverage,
        }
        result.summary.append(
            f"against ground truth: mean {stage.error.mae_deg:.2f} deg, "
            f"median {stage.error.median_deg:.2f} deg"
        )
    return result


def write_separation(folder: Path, parts: processing.Separation) -> Result:
    """Write shape and detail as EXR and 16-bit PNG, with their mask; return files and figures."""
    outputs = processing.write_normals(folder, parts.shape, name="shape")
    outputs |= processing.write_normals(folder, parts.detail, name="detail")
    separability = parts.separability_deg
    return Result(
        outputs=outputs,
        metrics={"separability_deg": separability},
        summary=[f"separability {separability:.2f} deg (shape left in the detail; 0 is best)"],
    )


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
    acquisition.write_exr(result.outputs["height"], height_map.height)
    acquisition.write_mask(result.outputs["mask"], height_map.mask)
    if height_map.depth is not None:
        result.outputs["depth"] = folder / "depth.exr"
        acquisition.write_exr(result.outputs["depth"], height_map.depth)
    for suffix in formats:
        result.outputs[suffix] = folder / f"surface.{suffix}"
        processing.write_mesh(result.outputs[suffix], height_map, normals=normal_map)
    inside = height_map.height[height_map.mask]
    result.metrics = {
        "unit": height_map.unit,
        "height_range": float(np.ptp(inside)),
        "vertices": len(inside),
        "parts": int(height_map.parts.max()) + 1,
        "iterations": height_map.iterations,
    }
    result.summary = [
        f"height range {result.metrics['height_range']:.4g} {height_map.unit}, "
        f"{result.metrics['vertices']} vertices"
    ]
    return result
