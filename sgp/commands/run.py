"""``sgp run``: compute normals, detail, surface and overview from a recording."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from sgp.cli.options import Input, Memory, SourceOptions
from sgp.pictures import source_title, write_overview
from sgp.report import write_report
from sgp.results import Result, RunMetrics, TruthMetrics, claim_folder, input_hashes, writes_folder
from sgp.stages import (
    MapOptions,
    RunOptions,
    SeparationOptions,
    Stopwatch,
    SurfaceOptions,
    add_sphere_lights,
    open_recording,
    processed,
)

_DEFAULTS = SourceOptions()
_MAPS, _SEPARATION, _SURFACES = MapOptions(), SeparationOptions(), SurfaceOptions()


@writes_folder("summary.json")
def run(
    source: Input,
    *,
    out: Path = Path("result"),
    options: SourceOptions = _DEFAULTS,
    maps: MapOptions = _MAPS,
    separation: SeparationOptions = _SEPARATION,
    surfaces: SurfaceOptions = _SURFACES,
    memory: Memory | None = None,
    strict: bool = False,
    force: bool = False,
) -> Result:
    """Compute normals, shape and detail components, and a surface from a recording.

    For example:

        sgp run photographs/ --lights lights.json --out result
        sgp run session/ --spheres --radius-mm 12 --out result

    Parameters
    ----------
    source
        Session, DiLiGenT object folder, images with an .lp file, or folder of images.
    out
        Folder for overview.png, report.html, summary.json, normals/, detail/ and surface/.
    options
        Lights, camera, mask and method.
    maps
        Form of the PNGs of normals.
    separation
        Low-pass filter between shape and detail.
    surfaces
        Scale and formats of the mesh.
    memory
        Memory to use, such as 3G or 500M; default: half of what is free. What does not fit is
        computed in bands of rows, in files in the output folder; the same command continues if it
        was interrupted.
    strict
        End with exit code 6 if the verdict is "do not use"; the result is written.
    force
        Write into an output folder that already contains files.
    """
    watch = Stopwatch()
    recording = open_recording(source, options, follow=options.align != "off")
    input_hashes(recording.files)
    opened = recording.source
    surfaces = replace(surfaces, pixel_mm=recording.pixel_mm(surfaces.pixel_mm))
    given = RunOptions(source=options, maps=maps, separation=separation, surfaces=surfaces)
    with processed(
        opened, recording.files, out, watch, given, memory=memory, force=force
    ) as outcome:
        result = outcome.result
        add_sphere_lights(result, claim_folder(out, "summary.json"), recording.lit_by, "sgp run")
        with watch.stage("overview"):
            title = source_title(opened, source.name)
            write_overview(result.file("overview", out / "overview.png"), title, outcome.panels)
        with watch.stage("report"):
            write_report(out / "report.html", out, result, options.max_pixels)
    figures = outcome.metrics["normals"]
    known = "mae_deg" in figures
    truth: TruthMetrics = {"normals_mae_deg": figures["mae_deg"]} if known else {}
    metrics: RunMetrics = {**outcome.metrics, **truth, "seconds": watch.seconds}
    result.metrics = metrics
    result.outputs["summary"] = out / "summary.json"
    if strict:
        result.refuse_unusable()
    result.summary.append(f"look at  {result.outputs['overview']}")
    return result
