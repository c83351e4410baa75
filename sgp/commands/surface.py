"""``sgp surface``: integrate normals to a surface."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt

import acquisition
import processing
import rig
from sgp._console import Stages
from sgp._options import Input, OptionalInput, Pixels
from sgp._output import claim_folder, writes_folder
from sgp._result import Result
from sgp._stage_options import SurfaceOptions
from sgp._write import write_surface

_SURFACE = SurfaceOptions()


@writes_folder("surface.json")
def surface(
    normals: Input,
    *,
    out: Path,
    mask: OptionalInput = None,
    albedo: OptionalInput = None,
    camera: OptionalInput = None,
    options: SurfaceOptions = _SURFACE,
    green: Literal["up", "down"] = "up",
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
        Folder for height.exr, height.png, depth.exr (with a camera), normal_residual_deg.exr (angle
        between the given normals and those of the surface), mask.png, surface.ply and
        surface.json; discontinuity.png and parts.png with --discontinuity.
    mask
        Mask image of the pixels to integrate; default: all pixels with a normal.
    albedo
        Image of colours for the mesh: albedo.exr, or a picture; default: none.
    camera
        File of a perspective camera; default: orthographic projection.
    options
        Scale and formats of the mesh.
    green
        Direction of the green channel in an image file.
    max_pixels
        Refuse images with more pixels than this, before decoding them.
    force
        Write into an output folder that already contains files.
    """
    sharpness = options.sharpness()
    read = processing.read_normals(normals, green=green, max_pixels=max_pixels)
    normal_map = read.normal_map
    if mask is not None:
        inside = acquisition.read_mask(mask, normal_map.size) & normal_map.mask
        normal_map = processing.NormalMap.from_vectors(normal_map.normals, inside)
    model = None if camera is None else acquisition.read_camera(camera, normal_map.size)
    with Stages() as progress:
        height_map = processing.integrate(
            normal_map,
            camera=model,
            pixel_mm=options.pixel_mm,
            discontinuity=options.discontinuity,
            k=sharpness,
            on_progress=progress,
        )
    colours = None if albedo is None else _colours(albedo, normal_map, max_pixels)
    claimed = claim_folder(out, "surface.json")
    result = write_surface(claimed, height_map, normal_map, options, colours=colours)
    result.warnings = [*read.warnings, *(_with_remedy(doubt, green) for doubt in result.warnings)]
    given = [path for path in (mask, albedo, camera) if path is not None]
    result.inputs = [*read.files, *given]
    return result


def _with_remedy(notice: rig.Notice, green: Literal["up", "down"]) -> rig.Notice:
    """Name the option that turns green round, if normals are mirrored."""
    if notice.code != "normals-mirrored":
        return notice
    other = "down" if green == "up" else "up"
    return replace(notice, text=f"{notice.text}; if green is the other way round, --green {other}")


def _colours(
    path: Path, normal_map: processing.NormalMap, max_pixels: int
) -> npt.NDArray[np.uint8]:
    """Read colours as sRGB samples: floats are linear albedo, other samples are sRGB."""
    image = acquisition.read_image(path, max_pixels=max_pixels)
    if image.shape[:2] != normal_map.size:
        height, width = normal_map.size
        raise acquisition.DataError(
            f"{path}: {image.shape[1]} x {image.shape[0]} pixels, but the normals have {width} x "
            f"{height}: give an image of the same size"
        )
    if image.dtype == np.uint8:
        return image.astype(np.uint8)
    if image.dtype == np.uint16:
        return np.rint(image / 257).astype(np.uint8)
    return processing.albedo_picture(image.astype(np.float32), normal_map.mask).pixels
