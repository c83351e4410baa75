"""``sgp curvature``: slopes and curvature of a surface from its normals."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import acquisition
import processing
import rig
from sgp.cli.options import FitScale, Green, Input, OptionalInput, Pixels, Positive
from sgp.results import CurvatureMetrics, Result, claim_folder, writes_folder
from sgp.stages import MapInput, recorded_pixel_mm


@writes_folder("curvature.json")
def curvature(
    normals: Input,
    *,
    out: Path,
    mask: OptionalInput = None,
    camera: OptionalInput = None,
    depth: OptionalInput = None,
    pixel_mm: Positive | None = None,
    scale: FitScale = 2.0,
    green: Green = "up",
    max_pixels: Pixels = rig.MAX_PIXELS,
    force: bool = False,
) -> Result:
    """Compute slopes, mean and Gaussian curvature from a normal map.

    Curvatures are positive where the surface is convex toward the camera. Their unit is 1/mm with
    a known size of a pixel or a camera at a known distance, else 1/pixel. Noise decreases with the
    square of the scale, and relief finer than about 4 times the scale is lost.

    For example:

        sgp curvature out/normals --pixel-mm 0.05 --scale 3 --out curvature

    Parameters
    ----------
    normals
        Image of normals, or folder with normals.* and mask.png, such as a result.
    out
        Folder for curvature_mean.exr, curvature_gaussian.exr, curvature_direction_deg.exr (of the
        largest curvature), gradient_x.exr and gradient_y.exr (slopes dz/dx and dz/dy),
        curvature.png and curvature.json.
    mask
        Mask image of the pixels to use; default: all pixels with a normal.
    camera
        File of a perspective camera; default: orthographic projection.
    depth
        depth.exr of `sgp surface`, for a camera with a working distance; default: the working
        distance everywhere.
    pixel_mm
        Size of a pixel on the object in mm; default: the one that the record of the normals
        states. Without it and without a working distance, the unit is the pixel.
    scale
        Standard deviation of the weights of the pixels around each, in pixels.
    green
        Direction of the green channel in an image file.
    max_pixels
        Refuse images with more pixels than this, before decoding them.
    force
        Write into an output folder that already contains files.
    """
    from sgp.pictures import signed_panel, write_overview

    if pixel_mm is None and camera is None:
        pixel_mm = recorded_pixel_mm(normals)
    read = MapInput(normals, green, max_pixels=max_pixels).read()
    normal_map = read.normal_map
    if mask is not None:
        inside = acquisition.read_mask(mask, normal_map.size) & normal_map.mask
        normal_map = processing.NormalMap.from_vectors(normal_map.normals, inside)
    found = processing.curvatures.curvature(
        normal_map,
        camera=None if camera is None else acquisition.read_camera(camera, normal_map.size),
        pixel_mm=pixel_mm,
        depth_mm=None if depth is None else acquisition.read_image(depth, max_pixels=max_pixels),
        scale_px=scale,
    )
    claim_folder(out, "curvature.json")
    maps = {
        "curvature_mean": found.mean,
        "curvature_gaussian": found.gaussian,
        "curvature_direction_deg": found.direction_deg,
        "gradient_x": found.gradient[..., 0],
        "gradient_y": found.gradient[..., 1],
    }
    result = Result(
        warnings=list(read.warnings),
        parameters={"pixel_mm": pixel_mm},
        inputs=[*read.files, *(path for path in (mask, camera, depth) if path is not None)],
        outputs={name: out / f"{name}.exr" for name in maps},
    )
    for name, values in maps.items():
        acquisition.write_exr(result.outputs[name], np.ascontiguousarray(values))
    metrics = _metrics(found)
    result.metrics = metrics
    per = f"1/{found.unit}"
    title = f"Curvature, scale {rig.figure(metrics['scale'], 3)} {found.unit}"
    panels = [
        signed_panel("mean curvature, red: convex", found.mean, per),
        signed_panel("Gaussian curvature, blue: saddles", found.gaussian, f"{per}²"),
    ]
    write_overview(result.file("picture", out / "curvature.png"), title, panels, columns=2)
    result.summary = [
        f"mean curvature      median {metrics['mean_median']:.4g}, rms {metrics['mean_rms']:.4g} "
        f"{per}",
        f"Gaussian curvature  median {metrics['gaussian_median']:.4g} {per}²",
        f"{metrics['pixels']} of {np.count_nonzero(normal_map.mask)} pixels, scale "
        f"{rig.figure(metrics['scale'], 3)} {found.unit}",
    ]
    return result


def _metrics(found: processing.curvatures.Curvature) -> CurvatureMetrics:
    mean = found.mean[found.mask].astype(np.float64)
    return {
        "unit": found.unit,
        "pixels": len(mean),
        "scale": found.scale_px * found.pixel_size,
        "mean_median": float(np.median(mean)),
        "mean_rms": float(np.sqrt(np.mean(mean**2))),
        "gaussian_median": float(np.median(found.gaussian[found.mask])),
    }
