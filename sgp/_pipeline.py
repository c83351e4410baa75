"""Compute normals, shape, detail and surface from a source, and write them into one folder."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

import acquisition
import processing
from sgp._console import Stages
from sgp._metrics import StagesMetrics
from sgp._options import SourceOptions
from sgp._output import claim_folder, write_record
from sgp._overview import (
    Panel,
    image_panel,
    lights_panel,
    map_panel,
    normals_panel,
    shaded_panel,
)
from sgp._result import Result
from sgp._stages import Stopwatch, compute_normals
from sgp._write import (
    normals_metrics,
    separation_metrics,
    surface_metrics,
    write_normals_stage,
    write_separation,
    write_surface,
)


@dataclass(frozen=True, eq=False)
class Outcome:
    """All results of the pipeline for one source; `result` has no figures so far."""

    normals: processing.Reconstruction
    parts: processing.Separation
    surface: processing.HeightMap
    metrics: StagesMetrics
    result: Result


def process(
    source: acquisition.Source,
    files: list[Path],
    out: Path,
    watch: Stopwatch,
    options: SourceOptions,
) -> Outcome:
    """Run every stage on a source and write ``normals/``, ``detail/`` and ``surface/`` in ``out``.

    Each folder gets its own record. Outputs and figures of the stages are merged under the
    stage's name.
    """
    chosen = {"transfer": source.transfer.record()}
    parameters = {"source": source.path, **asdict(options), **chosen}
    merged = Result(inputs=files, parameters=chosen)

    def write(name: str, files_of: Callable[[Path], Result]) -> None:
        record = f"{name}.json"
        result = files_of(claim_folder(out / name, record))
        result.inputs = files
        write_record(out / name / record, "sgp run", parameters, result)
        merged.outputs.update({f"{name}.{key}": path for key, path in result.outputs.items()})
        merged.warnings += result.warnings
        merged.summary += [f"{name:<8} {line}" for line in result.summary]

    with watch.stage("normals"):
        stage = compute_normals(source, options)
        write("normals", lambda folder: write_normals_stage(folder, stage))
    normal_map = stage.stereo.normal_map
    with watch.stage("detail"):
        with Stages() as progress:
            parts = processing.separate(normal_map, on_progress=progress)
        write("detail", lambda folder: write_separation(folder, parts))
    with watch.stage("surface"):
        with Stages() as progress:
            surface = processing.integrate(normal_map, camera=source.camera, on_progress=progress)
        write("surface", lambda folder: write_surface(folder, surface, normal_map))
    metrics: StagesMetrics = {
        "normals": normals_metrics(stage),
        "detail": separation_metrics(parts),
        "surface": surface_metrics(surface),
    }
    return Outcome(stage, parts, surface, metrics, merged)


def overview_panels(outcome: Outcome, true_lights: acquisition.Lights | None = None) -> list[Panel]:
    """Return the overview pictures that can be drawn for any recording."""
    stage, surface = outcome.normals, outcome.surface
    normal_map, names = stage.stereo.normal_map, stage.lights.ids
    lights_title = "lights" if true_lights is None else "lights (red: truth)"
    panels = [
        image_panel(f"light {names[0]}", stage.previews[0], stage.mask),
        image_panel(f"light {names[-1]}", stage.previews[1], stage.mask),
        lights_panel(f"{lights_title}, as the camera sees them", stage.lights, true_lights),
        normals_panel("normals (right red, up green)", normal_map),
        image_panel("albedo", np.where(stage.mask, stage.stereo.albedo, np.nan), stage.mask),
        normals_panel("shape component", outcome.parts.shape),
        normals_panel("detail component", outcome.parts.detail),
        map_panel("height", surface.height, surface.unit),
        shaded_panel("surface, lit from the upper left", surface.height / surface.pixel_size),
    ]
    if stage.error is not None:
        title = f"normal error, mean {stage.error.mae_deg:.2f} deg"
        panels.append(map_panel(title, stage.error.map_deg, "deg", error=True))
    return panels
