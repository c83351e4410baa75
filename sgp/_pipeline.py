"""From a source to normals, shape, detail and surface, written into one folder."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from acquisition import Source
from processing import HeightMap, Separation, integrate, separate
from sgp._overview import (
    Panel,
    image_panel,
    lights_panel,
    map_panel,
    normals_panel,
    shaded_panel,
)
from sgp._result import Result
from sgp._stages import Method, NormalsStage, Stopwatch, compute_normals
from sgp._write import write_normals_stage, write_separation, write_surface


@dataclass(frozen=True, eq=False)
class Outcome:
    """Everything the pipeline made of one source."""

    normals: NormalsStage
    parts: Separation
    surface: HeightMap
    result: Result


def process(
    source: Source,
    out: Path,
    watch: Stopwatch,
    *,
    method: Method = "cauchy",
    distant: bool = False,
    gamma: float | None = None,
) -> Outcome:
    """Run every stage on a source and write ``normals/``, ``detail/`` and ``surface/`` in ``out``.

    Outputs and metrics of the stages are merged under the stage's name.
    """
    folders = {name: out / name for name in ("normals", "detail", "surface")}
    for folder in folders.values():
        folder.mkdir(parents=True, exist_ok=True)
    with watch.stage("normals"):
        stage = compute_normals(source, method=method, distant=distant, gamma=gamma)
        normals = write_normals_stage(folders["normals"], stage)
    normal_map = stage.solved.normal_map
    with watch.stage("detail"):
        parts = separate(normal_map)
        detail = write_separation(folders["detail"], parts)
    with watch.stage("surface"):
        surface = integrate(normal_map, camera=source.camera)
        written = write_surface(folders["surface"], surface, normal_map)
    merged = Result()
    for name, made in (("normals", normals), ("detail", detail), ("surface", written)):
        merged.outputs |= {f"{name}.{key}": path for key, path in made.outputs.items()}
        merged.metrics[name] = made.metrics
        merged.warnings += made.warnings
        merged.summary += [f"{name:<8} {line}" for line in made.summary]
    return Outcome(stage, parts, surface, merged)


def overview_panels(outcome: Outcome) -> list[Panel]:
    """Return the pictures that every recording has."""
    stage, surface = outcome.normals, outcome.surface
    normal_map = stage.solved.normal_map
    first, *_, last = range(len(stage.lights))
    images = [
        image_panel(f"light {stage.lights.ids[i]}", picture)
        for i, picture in zip(
            (first, last), stage.previews[:: len(stage.previews) - 1], strict=True
        )
    ]
    panels = [
        *images,
        lights_panel("lights as the camera sees them", stage.lights),
        normals_panel("normals (right red, up green)", normal_map),
        normals_panel("shape component", outcome.parts.shape),
        normals_panel("detail component", outcome.parts.detail),
        map_panel("height", surface.height, surface.unit),
        shaded_panel("surface, lit from the upper left", surface.height / surface.pixel_size),
    ]
    if stage.error is not None:
        title = f"normal error, mean {stage.error.mae_deg:.2f} deg"
        panels.append(map_panel(title, stage.error.map_deg, "deg", error=True))
    return panels
