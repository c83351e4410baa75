"""``sgp normals``: photometric stereo."""

from __future__ import annotations

from pathlib import Path

from sgp._output import writes_folder
from sgp._result import Result
from sgp._stages import Method, compute_normals, open_source
from sgp._write import write_normals_stage


@writes_folder("normals.json")
def normals(
    source: Path,
    *,
    out: Path,
    lights: Path | None = None,
    camera: Path | None = None,
    mask: Path | None = None,
    method: Method = "cauchy",
    distant: bool = False,
    gamma: float | None = None,
    force: bool = False,
) -> Result:
    """Estimate a normal map from images under known lights.

    For example:

        sgp normals recording/ --lights lights.json --out normals

    Parameters
    ----------
    source
        A session, a DiLiGenT object folder, images with an .lp, or a folder of images.
    out
        Folder for normals.exr, normals.png, albedo.exr, residual.exr, used.exr, mask.png and
        normals.json.
    lights
        lights.json, .lp or DiLiGenT text; default: those of the source.
    camera
        Needed for lights with positions: our JSON, OpenCV YAML, COLMAP or a 3x3 matrix.
    mask
        Image of the object; default: the source's own, else made from the images.
    method
        ls (plain least squares) or cauchy (shadows and highlights lose their weight).
    distant
        Take lights with positions as directions.
    gamma
        Exponent that makes the images linear (2.2 for display-ready ones); default: linear already.
    force
        Write into a folder that holds files already.
    """
    opened, files = open_source(source, lights=lights, camera=camera, mask=mask)
    stage = compute_normals(opened, method=method, distant=distant, gamma=gamma)
    out.mkdir(parents=True, exist_ok=True)
    result = write_normals_stage(out, stage)
    result.inputs = files
    return result
