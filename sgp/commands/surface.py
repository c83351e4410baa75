"""``sgp surface``: integrate normals to a surface."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np

import acquisition
import processing
import rig
from sgp.cli.console import note
from sgp.cli.exit import UsageError
from sgp.cli.options import Input, Memory, Millimetres, OptionalInput, Pixels, Positive
from sgp.results import Result, writes_folder
from sgp.stages import (
    SurfaceInputs,
    SurfaceOptions,
    SurfaceWay,
    camera_notices,
    integrated,
    recorded_pixel_mm,
    with_remedy,
)

_SURFACE = SurfaceOptions()


@writes_folder("surface.json")
def surface(
    normals: Input,
    *,
    out: Path,
    mask: OptionalInput = None,
    albedo: OptionalInput = None,
    camera: OptionalInput = None,
    sigma: OptionalInput = None,
    prior: OptionalInput = None,
    prior_sigma: Positive | None = None,
    height_mm: Millimetres | None = None,
    options: SurfaceOptions = _SURFACE,
    green: Literal["up", "down"] = "up",
    max_pixels: Pixels = rig.MAX_PIXELS,
    memory: Memory | None = None,
    force: bool = False,
) -> Result:
    """Integrate a normal map to height, depth and a mesh.

    For example:

        sgp surface out/normals --camera camera.json --out surface
        sgp surface normals --sigma normal_sigma_deg.exr --height-sigma --out s
        sgp surface out/normals --prior points.csv --pixel-mm 0.05 --out surface

    Parameters
    ----------
    normals
        Image of normals, or folder with normals.* and mask.png, such as a result.
    out
        Folder for height.exr, height.png, depth.exr (with a camera), normal_residual_deg.exr (angle
        between the given normals and those of the surface), curl_deg.exr and curl.png (where
        normals contradict each other), mask.png, surface.ply and surface.json;
        discontinuity.png, jumps.png and parts.png of a surface that jumps, height_sigma.exr with
        --height-sigma.
    mask
        Mask image of the pixels to integrate; default: all pixels with a normal.
    albedo
        Image of colours for the mesh: albedo.exr, or a picture; default: none.
    camera
        File of a perspective camera; default: orthographic projection, with the scale that the
        record of the normals states.
    sigma
        Standard deviations of the normals in degrees (normal_sigma_deg.exr of sgp normals and sgp
        run), so that noisy regions count less; default: all normals are equally certain.
    prior
        Known heights in the unit of the surface, with a camera above the working plane: a table
        (.csv) with columns x_px,y_px,height_mm and optionally sigma_mm, or a map (.exr, .npy,
        .tif) of floats, NaN where unknown, of the size of the normals or coarser. Four heights or
        more also remove a tilt that all normals have in common, seven or more a bend.
    prior_sigma
        Standard deviation of each known height in mm, or in pixels if the scale is not known; a
        small one fixes heights; default: the size of a pixel.
    height_mm
        Mean height of the surface above the working plane of the camera, as sgp normals reports it
        under near lights; default: 0.
    options
        Scale and formats of the mesh.
    green
        Direction of the green channel in an image file.
    max_pixels
        Refuse images with more pixels than this, before decoding them.
    memory
        Memory to use, such as 3G or 500M; default: half of what is free. A surface that does not
        fit is solved in blocks of rows, in files in the output folder.
    force
        Write into an output folder that already contains files.
    """
    options.sharpness()  # refuses options that exclude each other
    if options.pixel_mm is None and camera is None:
        options = replace(options, pixel_mm=recorded_pixel_mm(normals))
    if prior_sigma is not None and prior is None:
        raise UsageError("--prior-sigma is for known heights: give --prior too")
    if options.height_sigma and sigma is None:
        raise UsageError("--height-sigma needs deviations of the normals: give --sigma too")
    way = _way(memory, normals, camera, sigma, prior, options, max_pixels)
    model = None if camera is None else acquisition.read_camera(camera, way.size)
    doubts = () if camera is None or model is None else tuple(camera_notices(camera, model))
    depth = None if height_mm is None else np.float32(_mean_depth(height_mm, model))
    inputs = SurfaceInputs(
        normals=normals,
        mask=mask,
        albedo=albedo,
        camera=model,
        doubts=doubts,
        sigma=sigma,
        prior=None if prior is None else (prior, prior_sigma),
        pixel_mm=options.pixel_mm,
        depth_mm=None if depth is None else np.broadcast_to(depth, way.size),
        green=green,
        max_pixels=max_pixels,
    )
    result, _ = integrated(inputs, options, way, out, force=force)
    result.warnings = [_with_remedy(notice, green, options) for notice in result.warnings]
    result.inputs += [path for path in (mask, albedo, camera, sigma, prior) if path is not None]
    result.parameters |= {"pixel_mm": options.pixel_mm}
    return result


def _with_remedy(
    notice: rig.Notice, green: Literal["up", "down"], options: SurfaceOptions
) -> rig.Notice:
    """Name the option that turns green round, or smooths jumps in depth, if it may be the cause."""
    if notice.code == "surface-differs" and options.smooth:
        return replace(notice, text=f"{notice.text}; --smooth smooths jumps")
    return with_remedy(notice, green)


def _way(
    memory: int | None,
    normals: Path,
    camera: Path | None,
    sigma: Path | None,
    prior: Path | None,
    options: SurfaceOptions,
    max_pixels: int,
) -> SurfaceWay:
    """Return how the surface is solved, and state it if it is not the ordinary way."""
    size = processing.find_normals(normals, max_pixels=max_pixels).size
    wanted = {"--prior": prior is not None, **options.whole_surface()}
    way = SurfaceWay.within(
        memory,
        size,
        processing.surface.SurfaceStage(
            camera is not None, sigma is not None, options.jumps() is not False
        ),
        stl=options.stl,
        whole_for=[name for name, given in wanted.items() if given],
    )
    if memory is not None or way.rows is not None:
        note(way.line())
    return way


def _mean_depth(height_mm: float, camera: acquisition.CameraModel | None) -> float:
    """Return the depth at a height above the working plane."""
    distance = None if camera is None else camera.working_distance_mm
    if distance is None:
        raise UsageError("--height-mm needs a camera with a working distance: give --camera")
    if height_mm >= distance:
        raise UsageError(
            f"--height-mm {height_mm:g} is behind the camera, which is {distance:g} mm above the "
            "working plane"
        )
    return distance - height_mm
