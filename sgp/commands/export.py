"""``sgp export``: a result in the formats of other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import processing
import rig
from sgp.cli.console import Stages
from sgp.cli.exit import UsageError
from sgp.cli.options import Input, Pixels, Quality
from sgp.results import Result, claim_folder, input_hashes, recordings_of, writes_folder
from sgp.stages import RelightOptions, find_normals

_RELIGHT = RelightOptions()
_QUALITY = 95


@writes_folder("export.json")
def export(
    result: Input,
    *,
    out: Path,
    format: Literal["rti", "x3p"] = "rti",  # noqa: A002 - the name of the option
    options: RelightOptions = _RELIGHT,
    quality: Quality = _QUALITY,
    max_pixels: Pixels = rig.MAX_PIXELS,
    force: bool = False,
) -> Result:
    """Export a result for viewers that move a light, or for programs for surface texture.

    The functions of rti are fitted to the recorded images that the record of the result names, or,
    if these are gone, to the shading of its normals and albedo; a note says so. RelightLab and
    OpenLIME open info.json, RTIViewer opens relight.ptm. Saturated samples are left out of the fit,
    shadows are part of it. x3p contains the heights of a surface in mm, unchanged, with the hash of
    its record.

    For example:

        sgp export result --format rti --out rti
        sgp export result --basis hsh9 --colours rgb --out rti
        sgp export result --format x3p --out x3p

    Parameters
    ----------
    result
        Folder of sgp run or sgp demo; for rti also of sgp normals, for x3p of sgp surface.
    out
        Folder for export.json, and for rti info.json and plane_0.jpg ... (for RelightLab and
        OpenLIME), relight.ptm (with --basis ptm), fit_rms.exr (deviation of the fit at each pixel)
        and relit.png (a picture under four lights); for x3p surface.x3p.
    format
        rti: relightable images of reflectance transformation imaging; x3p: heights (ISO 25178-72).
    options
        Functions of the direction of the light.
    quality
        Quality of the JPEGs of rti, 1 to 100.
    max_pixels
        Refuse images with more pixels than this, before decoding them.
    force
        Write into an output folder that already contains files.
    """
    if format == "x3p":
        return _x3p(result, out, options, quality, max_pixels)
    from sgp.stages import fit_result, write_relightable

    found = find_normals(result)
    read = processing.read_normals(found.folder, max_pixels=max_pixels)
    input_hashes(read.files)
    with Stages() as progress:
        made = fit_result(result, found, read.normal_map, options, max_pixels, progress)
    folder = claim_folder(out, "export.json")
    inputs = list(dict.fromkeys([found.record_file, *read.files, *made.files]))
    about = recordings_of(inputs)
    written = write_relightable(folder, made, read.normal_map.mask, options, quality, about)
    written.inputs = inputs
    written.warnings = [*read.warnings, *written.warnings]
    return written


def _x3p(result: Path, out: Path, options: RelightOptions, quality: int, max_pixels: int) -> Result:
    from sgp.stages import read_heights, write_surface_x3p

    given = {**vars(options), "quality": quality}
    unchanged = {**vars(_RELIGHT), "quality": _QUALITY}
    for name, value in given.items():
        if value != unchanged[name]:
            raise UsageError(f"--{name} is for --format rti, x3p has no images")
    surface = read_heights(result, max_pixels)
    return write_surface_x3p(claim_folder(out, "export.json"), surface)
