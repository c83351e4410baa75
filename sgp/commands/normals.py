"""``sgp normals``: photometric stereo."""

from __future__ import annotations

from pathlib import Path

from sgp._options import Input, SourceOptions
from sgp._output import claim_folder, writes_folder
from sgp._result import Result
from sgp._spheres import add_sphere_lights
from sgp._stage_options import MapOptions
from sgp._stages import compute_normals, open_recording
from sgp._write import write_normals_stage

_DEFAULTS = SourceOptions()
_MAPS = MapOptions()


@writes_folder("normals.json")
def normals(
    source: Input,
    *,
    out: Path,
    options: SourceOptions = _DEFAULTS,
    maps: MapOptions = _MAPS,
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
    force
        Write into an output folder that already contains files.
    """
    opened = open_recording(source, options)
    stage = compute_normals(opened.source, options)
    result = write_normals_stage(claim_folder(out, "normals.json"), stage, maps)
    result.inputs = opened.files
    result.parameters |= {"transfer": opened.source.transfer.record()}
    add_sphere_lights(result, out, opened.lit_by, "sgp normals")
    return result
