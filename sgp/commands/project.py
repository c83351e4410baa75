"""``sgp project``: project meshes and point clouds to normal maps."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from cyclopts import Parameter
from cyclopts.validators import Number

import acquisition
import processing
from sgp.cli.console import shown, with_progress
from sgp.cli.exit import UsageError
from sgp.cli.options import Input, OptionalInput, Positive, Whole, image_size, numbers
from sgp.results import ProjectMetrics, Result, claim_folder, writes_folder
from sgp.stages import MAPS, MapOptions

Unit = Literal["um", "mm", "cm", "m", "in"]
Neighbours = Annotated[Whole, Parameter(validator=Number(gte=3, lte=1000))]
# "-90,0,0" is a value, not an option.
Triple = Annotated[str, Parameter(allow_leading_hyphen=True)]

_UNIT_MM: dict[Unit, float] = {"um": 1e-3, "mm": 1.0, "cm": 10.0, "m": 1000.0, "in": 25.4}


@writes_folder("project.json")
def project(
    geometry: Input,
    *,
    out: Path,
    view: processing.projection.View | None = None,
    look: Triple | None = None,
    up: Literal["y", "z"] = "y",
    rotate_deg: Triple = "0,0,0",
    size: str | None = None,
    pixel_mm: Positive | None = None,
    unit: Unit | None = None,
    camera: OptionalInput = None,
    distance_mm: Positive | None = None,
    keep_origin: bool = False,
    shading: Literal["smooth", "flat"] = "smooth",
    neighbours: Neighbours = 16,
    maps: MapOptions = MAPS,
    force: bool = False,
) -> Result:
    """Project a mesh or a point cloud to a normal map, with mask and height.

    For example:

        sgp project bunny.obj --unit m --size 1000x1000 --out bunny
        sgp project part.stl --up z --view top --pixel-mm 0.05 --out part
        sgp project scan.ply --camera camera.json --rotate-deg 0,30,0 --out scan

    Parameters
    ----------
    geometry
        Mesh (.obj, .ply, .stl, .glb, .off) or points (.ply without faces, .xyz).
    out
        Folder for normals.exr, normals.png, mask.png, height.exr (mm), depth.exr (with a camera)
        and project.json.
    view
        Visible side; default: front, viewed along -Z of the file.
    look
        Viewing direction x,y,z in the axes of the file, instead of --view.
    up
        Axis of the file that points up; with z, the front view is along +Y.
    rotate_deg
        Additional rotation of the object in degrees about x (right), y (up) and z (toward the
        viewer).
    size
        Width and height in pixels, for example 640x512; default: the size of the camera, else the
        size that fits the object.
    pixel_mm
        Size of a pixel on the object in mm; default: the object fills the image.
    unit
        Unit of the coordinates in the file; default: mm, or m for .glb.
    camera
        File of a perspective camera; default: orthographic projection.
    distance_mm
        Distance from the camera to the working plane; default: the one in the camera file.
    keep_origin
        Place the origin of the file, instead of the centre of the object, on the optical axis in
        the working plane.
    shading
        smooth blends the normals of faces, but not across the sharp edges of a part, or uses those
        of the file if they fit the faces; flat uses the normals of the faces.
    neighbours
        Number of neighbours of each point to which its normal is fitted; more give smoother
        normals.
    maps
        Form of the PNG.
    force
        Write into an output folder that already contains files.
    """
    if view is not None and look is not None:
        raise UsageError("--view and --look both give the viewing direction: give only one")
    if camera is None and distance_mm is not None:
        raise UsageError("--distance-mm requires a camera: give --camera too")
    if camera is not None and pixel_mm is not None:
        raise UsageError("--camera and its distance give the scale: leave --pixel-mm out")
    pixels = None if size is None else image_size("--size", size)[::-1]
    try:
        rotation = processing.projection.view_rotation(
            view or "front",
            look=None if look is None else numbers("--look", look, 3),
            up=up,
            rotate_deg=numbers("--rotate-deg", rotate_deg, 3),
        )
    except acquisition.DataError as error:
        raise UsageError(str(error)) from error
    model = None if camera is None else acquisition.read_camera(camera, pixels)
    if model is not None and distance_mm is not None:
        model = replace(model, working_distance_mm=distance_mm)
    if model is not None and model.working_distance_mm is None:
        raise UsageError(f"{camera}: the camera has no working distance: give --distance-mm")
    (read,) = [processing.read_geometry(path) for path in shown("reading", [geometry])]
    used: Unit = unit or ("m" if geometry.suffix.lower() == ".glb" else "mm")
    seen = with_progress(processing.project)(
        read,
        rotation,
        unit_mm=_UNIT_MM[used],
        size=pixels,
        pixel_mm=pixel_mm,
        camera=model,
        centred=not keep_origin,
        smooth=shading == "smooth",
        neighbours=neighbours,
    )
    result = Result(
        outputs=maps.write_map(claim_folder(out, "project.json"), seen.normal_map),
        warnings=list(seen.warnings),
        inputs=[geometry, *([] if camera is None else [camera])],
    )
    for name, values in (("height", seen.height), ("depth", seen.depth)):
        if values is not None:
            acquisition.write_exr(result.file(name, out / f"{name}.exr"), values)
    mask = seen.normal_map.mask
    height, width = mask.shape
    metrics: ProjectMetrics = {
        "width": width,
        "height": height,
        "mm_per_px": seen.pixel_mm,
        "pixels": int(mask.sum()),
        "height_range_mm": float(np.ptp(seen.height[mask])),
        "vertices": len(read.vertices),
        "faces": 0 if read.faces is None else len(read.faces),
        "unit": used,
    }
    result.metrics = metrics
    result.summary = [
        f"{width} x {height} pixels of {seen.pixel_mm:.4g} mm, {metrics['pixels']} on the "
        f"object, height range {metrics['height_range_mm']:.4g} mm"
    ]
    return result
