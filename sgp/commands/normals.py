"""``sgp normals``: photometric stereo."""

from __future__ import annotations

from pathlib import Path

from sgp.cli.options import Input, Memory, Positive, SourceOptions
from sgp.results import Result, claim_folder, input_hashes, seen_in, writes_folder
from sgp.stages import (
    MAPS,
    MapOptions,
    add_sphere_lights,
    normals_within,
    open_recording,
    with_scale,
    write_normals_stage,
)

_DEFAULTS = SourceOptions()


@writes_folder("normals.json")
def normals(
    source: Input,
    *,
    out: Path,
    options: SourceOptions = _DEFAULTS,
    maps: MapOptions = MAPS,
    pixel_mm: Positive | None = None,
    memory: Memory | None = None,
    strict: bool = False,
    force: bool = False,
) -> Result:
    """Estimate a normal map from images under known lights.

    For example:

        sgp normals recording/ --lights lights.json --out normals
        sgp normals session/ --spheres --radius-mm 12 --out normals

    Parameters
    ----------
    source
        Session, DiLiGenT object folder, images with an .lp file, or folder of images.
    out
        Folder for normals.exr, normals.png, normal_sigma_deg.exr (standard deviations of the
        normals), albedo.exr, albedo.png, residual.exr, specular.exr, used.exr, samples_*.png,
        validity.png, mask.png and normals.json.
    options
        Lights, camera, mask and method.
    maps
        Form of the PNG.
    pixel_mm
        Size of a pixel on the object in mm, for lights with positions if there is no camera with a
        working distance. Without a camera, the view is that of a telecentric lens whose axis is in
        the middle of the image.
    memory
        Memory to use, such as 3G or 500M; default: half of what is free. Maps that do not fit are
        computed in bands of rows, in files in the output folder; the same command continues them
        if it was interrupted.
    strict
        End with exit code 6 if the verdict is "do not use"; the result is written.
    force
        Write into an output folder that already contains files.
    """
    opened = open_recording(source, options, follow=options.align != "off")
    input_hashes(opened.files)
    pixel_mm = opened.pixel_mm(pixel_mm)
    seen, pixel = with_scale(opened.source, pixel_mm)
    with normals_within(
        memory, seen, options, pixel, files=opened.files, out=out, force=force
    ) as stage:
        folder = claim_folder(out, "normals.json", opened.files)
        result = write_normals_stage(folder, stage, maps, command="sgp normals", files=opened.files)
    result.inputs = opened.files
    result.parameters |= {**seen_in(opened.source), "pixel_mm": pixel_mm}
    add_sphere_lights(result, out, opened.lit_by, "sgp normals")
    if strict:
        result.refuse_unusable()
    return result
