"""``sgp export``: a result in the formats of other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import processing
import rig
from sgp.cli.console import Stages
from sgp.cli.options import Input, Pixels, Quality
from sgp.results import Result, claim_folder, input_hashes, recordings_of, writes_folder
from sgp.stages import RelightOptions, find_normals

_RELIGHT = RelightOptions()


@writes_folder("export.json")
def export(
    result: Input,
    *,
    out: Path,
    format: Literal["rti"] = "rti",  # noqa: A002 - the name of the option
    options: RelightOptions = _RELIGHT,
    quality: Quality = 95,
    max_pixels: Pixels = rig.MAX_PIXELS,
    force: bool = False,
) -> Result:
    """Export a result for viewers that show it under a light that is moved by hand.

    The functions are fitted to the recorded images that the record of the result names, or, if
    these are gone, to the shading of its normals and albedo; a note says so. RelightLab and
    OpenLIME open info.json, RTIViewer opens relight.ptm. Saturated samples are left out of the fit,
    shadows are part of it.

    For example:

        sgp export result --format rti --out rti
        sgp export result --basis hsh9 --colours rgb --out rti

    Parameters
    ----------
    result
        Folder of sgp run, sgp demo or sgp normals.
    out
        Folder for info.json and plane_0.jpg ... (for RelightLab and OpenLIME), relight.ptm (with
        --basis ptm), fit_rms.exr (deviation of the fit at each pixel), relit.png (a picture under
        four lights) and export.json.
    format
        rti: relightable images of reflectance transformation imaging.
    options
        Functions of the direction of the light.
    quality
        Quality of the JPEGs, 1 to 100.
    max_pixels
        Refuse images with more pixels than this, before decoding them.
    force
        Write into an output folder that already contains files.
    """
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
