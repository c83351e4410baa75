"""``sgp surface``: integrate normals to a surface."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import acquisition
import processing
import rig
from sgp._console import Stages
from sgp._options import Input, OptionalInput, Pixels, Positive
from sgp._output import claim_folder, writes_folder
from sgp._result import Result
from sgp._write import write_surface


@writes_folder("surface.json")
def surface(
    normals: Input,
    *,
    out: Path,
    mask: OptionalInput = None,
    camera: OptionalInput = None,
    pixel_mm: Positive | None = None,
    green: Literal["up", "down"] = "up",
    glb: bool = False,
    stl: bool = False,
    obj: bool = False,
    max_pixels: Pixels = rig.MAX_PIXELS,
    force: bool = False,
) -> Result:
    """Integrate a normal map to height, depth and a mesh.

    For example:

        sgp surface out/normals --camera camera.json --out surface

    Parameters
    ----------
    normals
        Image of normals, or folder with normals.* and mask.png.
    out
        Folder for height.exr, depth.exr (with a camera), mask.png, surface.ply and surface.json.
    mask
        Mask image of the pixels to integrate; default: all pixels with a normal.
    camera
        File of a perspective camera; default: orthographic projection.
    pixel_mm
        Size of a pixel on the object in mm; without it and without a working distance, the unit of
        the height is one pixel.
    green
        Direction of the green channel in an image file.
    glb
        Also write surface.glb, in metres as glTF requires.
    stl
        Also write surface.stl.
    obj
        Also write surface.obj.
    max_pixels
        Refuse images with more pixels than this, before decoding them.
    force
        Write into an output folder that already contains files.
    """
    read = processing.read_normals(normals, green=green, max_pixels=max_pixels)
    normal_map = read.normal_map
    if mask is not None:
        inside = acquisition.read_mask(mask, normal_map.size) & normal_map.mask
        normal_map = processing.NormalMap.from_vectors(normal_map.normals, inside)
    model = None if camera is None else acquisition.read_camera(camera, normal_map.size)
    with Stages() as progress:
        height_map = processing.integrate(
            normal_map, camera=model, pixel_mm=pixel_mm, on_progress=progress
        )
    wanted = {"glb": glb, "stl": stl, "obj": obj}
    formats = ("ply", *(name for name, asked in wanted.items() if asked))
    claimed = claim_folder(out, "surface.json")
    result = write_surface(claimed, height_map, normal_map, formats=formats)
    result.warnings = [*read.warnings, *result.warnings]
    options = [path for path in (mask, camera) if path is not None]
    result.inputs = [*read.files, *options]
    return result
