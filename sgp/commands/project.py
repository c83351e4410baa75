"""``sgp project``: meshes and point clouds to normal maps."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from cyclopts import Parameter
from cyclopts.validators import Number

from acquisition import DataError, read_camera, write_exr
from processing import View, read_geometry, view_rotation, write_normals
from processing import project as project_geometry
from sgp._exit import UsageError
from sgp._options import Positive, Whole, image_size, numbers
from sgp._output import claim_folder, writes_folder
from sgp._result import Result

Unit = Literal["um", "mm", "cm", "m", "in"]
Neighbours = Annotated[Whole, Parameter(validator=Number(gte=3, lte=1000))]
# "-90,0,0" is a value and no option.
Triple = Annotated[str, Parameter(allow_leading_hyphen=True)]

_UNIT_MM: dict[Unit, float] = {"um": 1e-3, "mm": 1.0, "cm": 10.0, "m": 1000.0, "in": 25.4}


@writes_folder("project.json")
def project(
    geometry: Path,
    *,
    out: Path,
    view: View | None = None,
    look: Triple | None = None,
    up: Literal["y", "z"] = "y",
    rotate_deg: Triple = "0,0,0",
    size: str | None = None,
    pixel_mm: Positive | None = None,
    unit: Unit | None = None,
    camera: Path | None = None,
    distance_mm: Positive | None = None,
    keep_origin: bool = False,
    shading: Literal["smooth", "flat"] = "smooth",
    neighbours: Neighbours = 16,
    force: bool = False,
) -> Result:
    """Draw a mesh or a point cloud as a normal map, with mask and height.

    For example:

        sgp project bunny.obj --unit m --size 1000x1000 --out bunny
        sgp project part.stl --up z --view top --pixel-mm 0.05 --out part
        sgp project scan.ply --camera camera.json --rotate-deg 0,30,0 --out scan

    Parameters
    ----------
    geometry
        A mesh (.obj, .ply, .stl, .glb, .off), or points (.ply without faces, .xyz).
    out
        Folder for normals.exr, normals.png, mask.png, height.exr (mm), depth.exr (with a camera)
        and project.json.
    view
        The side that is seen; default: front, looking along -Z of the file.
    look
        Instead of --view: the direction of sight x,y,z in the file's axes.
    up
        The file's axis that points up; with z the front looks along +Y.
    rotate_deg
        Then turn the object about x (right), y (up) and z (toward the viewer).
    size
        Width and height in pixels, such as 640x512; default: what fits, or the camera's.
    pixel_mm
        Size of a pixel on the object; default: the object fills the image.
    unit
        Of the file's coordinates; default: mm, and m for .glb.
    camera
        Perspective camera; default: orthographic.
    distance_mm
        From the camera to the working plane; default: the camera's own.
    keep_origin
        The file's origin lies on the optical axis in the working plane; default: the middle of the
        object does.
    shading
        smooth blends the normals of a mesh's vertices, flat keeps its faces.
    neighbours
        Points around each point of a cloud that its normal is fitted to; more is smoother.
    force
        Write into a folder that holds files already.
    """
    if view is not None and look is not None:
        raise UsageError("--view and --look both say from where: give one of them")
    if camera is None and distance_mm is not None:
        raise UsageError("--distance-mm is the distance of a camera: give --camera too")
    if camera is not None and pixel_mm is not None:
        raise UsageError("with --camera the scale follows from its distance: leave --pixel-mm out")
    pixels = None if size is None else image_size("--size", size)[::-1]
    try:
        rotation = view_rotation(
            view or "front",
            look=None if look is None else numbers("--look", look, 3),
            up=up,
            rotate_deg=numbers("--rotate-deg", rotate_deg, 3),
        )
    except DataError as error:
        raise UsageError(str(error)) from error
    model = None if camera is None else read_camera(camera, pixels)
    if model is not None and distance_mm is not None:
        model = replace(model, working_distance_mm=distance_mm)
    if model is not None and model.working_distance_mm is None:
        raise UsageError(f"{camera}: the camera has no working distance: give --distance-mm")
    read = read_geometry(geometry)
    used: Unit = unit or ("m" if geometry.suffix.lower() == ".glb" else "mm")
    seen = project_geometry(
        read,
        rotation,
        unit_mm=_UNIT_MM[used],
        size=pixels,
        mm_per_px=pixel_mm,
        camera=model,
        centred=not keep_origin,
        smooth=shading == "smooth",
        neighbours=neighbours,
    )
    claim_folder(out, "project.json")
    result = Result(
        outputs=write_normals(out, seen.normal_map),
        warnings=list(seen.warnings),
        inputs=[geometry, *([] if camera is None else [camera])],
    )
    for name, values in (("height", seen.height), ("depth", seen.depth)):
        if values is not None:
            result.outputs[name] = out / f"{name}.exr"
            write_exr(result.outputs[name], values)
    mask = seen.normal_map.mask
    height, width = mask.shape
    result.metrics = {
        "width": width,
        "height": height,
        "mm_per_px": seen.mm_per_px,
        "pixels": int(mask.sum()),
        "height_range_mm": float(np.ptp(seen.height[mask])),
        "vertices": len(read.vertices),
        "faces": 0 if read.faces is None else len(read.faces),
        "unit": used,
    }
    result.summary = [
        f"{width} x {height} pixels of {seen.mm_per_px:.4g} mm, {result.metrics['pixels']} on the "
        f"object, height spans {result.metrics['height_range_mm']:.4g} mm"
    ]
    return result
