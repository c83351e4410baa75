"""``sgp run``: a recording to normals, detail, surface and overview."""

from __future__ import annotations

from pathlib import Path

from sgp._options import SourceOptions
from sgp._output import claim_folder, writes_folder
from sgp._overview import write_overview
from sgp._pipeline import overview_panels, process
from sgp._result import Result
from sgp._stages import Stopwatch, open_source

_DEFAULTS = SourceOptions()


@writes_folder("summary.json")
def run(
    source: Path,
    *,
    out: Path = Path("result"),
    options: SourceOptions = _DEFAULTS,
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
    options
        Lights, camera, mask, method.
    force
        Write into a folder that holds files already.
    """
    watch = Stopwatch()
    opened, files = open_source(
        source,
        lights=options.lights,
        camera=options.camera,
        mask=options.mask,
        max_pixels=options.max_pixels,
    )
    outcome = process(opened, files, out, watch, options)
    result = outcome.result
    result.outputs["overview"] = claim_folder(out, "summary.json") / "overview.png"
    with watch.stage("overview"):
        write_overview(result.outputs["overview"], source.name, overview_panels(outcome))
    result.metrics["seconds"] = watch.seconds
    result.outputs["summary"] = out / "summary.json"
    result.summary.append(f"look at  {result.outputs['overview']}")
    return result
