"""``sgp run``: a recording to normals, detail, surface and overview."""

from __future__ import annotations

from pathlib import Path

from sgp._output import writes_folder
from sgp._overview import write_overview
from sgp._pipeline import overview_panels, process
from sgp._result import Result
from sgp._stages import Method, Stopwatch, open_source


@writes_folder("summary.json")
def run(
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
    """Turn a recording into normals, shape and detail, and a surface.

    For example:

        sgp run photographs/ --lights lights.json --out result

    Parameters
    ----------
    source
        A session, a DiLiGenT object folder, images with an .lp, or a folder of images.
    out
        Folder for overview.png, summary.json, normals/, detail/ and surface/.
    lights
        lights.json, .lp or DiLiGenT text; default: those of the source.
    camera
        Needed for lights with positions, and for a perspective surface.
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
    watch = Stopwatch()
    opened, files = open_source(source, lights=lights, camera=camera, mask=mask)
    outcome = process(opened, out, watch, method=method, distant=distant, gamma=gamma)
    result = outcome.result
    result.inputs = files
    result.outputs["overview"] = out / "overview.png"
    with watch.stage("overview"):
        write_overview(result.outputs["overview"], source.name, overview_panels(outcome))
    result.metrics["seconds"] = watch.seconds
    result.outputs["summary"] = out / "summary.json"
    result.summary.append(f"look at  {result.outputs['overview']}")
    return result
