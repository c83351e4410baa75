"""Compute normals, shape, detail and surface from a source, and write them into one folder."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

import acquisition
import processing
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
from sgp._stage_options import MapOptions, SeparationOptions, SurfaceOptions
from sgp._stages import Stopwatch, compute_normals
from sgp._write import (
    normals_metrics,
    separation_metrics,
    surface_metrics,
    write_normals_stage,
    write_separation,
    write_surface,
)

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

_MAPS, _SEPARATION, _SURFACES = MapOptions(), SeparationOptions(), SurfaceOptions()


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
    *,
    maps: MapOptions = _MAPS,
    separation: SeparationOptions = _SEPARATION,
    surfaces: SurfaceOptions = _SURFACES,
) -> Outcome:
    """Run every stage on a source and write ``normals/``, ``detail/`` and ``surface/`` in ``out``.

    Each folder gets its own record. Outputs and figures of the stages are merged under the
    stage's name.

    Raises
    ------
    DataError
        If both a pixel size and a camera with a working distance are given, besides the errors of
        the stages.
    """
    if surfaces.pixel_mm is not None and source.camera is not None:
        # Before the normals, which take long.
        processing.check_scale(source.camera, surfaces.pixel_mm)
    chosen = {"transfer": source.transfer.record()}
    parameters = {"source": source.path, **_recorded(options, maps, separation, surfaces), **chosen}
    merged = Result(inputs=files, parameters=chosen)

    def write(name: str, files_of: Callable[[Path], Result]) -> None:
        record = f"{name}.json"
        result = files_of(claim_folder(out / name, record))
        result.inputs = files
        write_record(out / name / record, "sgp run", parameters | result.parameters, result)
        merged.parameters |= result.parameters
        merged.outputs.update({f"{name}.{key}": path for key, path in result.outputs.items()})
        merged.warnings += result.warnings
        merged.summary += [f"{name:<8} {line}" for line in result.summary]

    with watch.stage("normals"):
        stage = compute_normals(source, options)
        write("normals", lambda folder: write_normals_stage(folder, stage, maps))
    normal_map = stage.stereo.normal_map
    with watch.stage("detail"):
        parts = processing.separate(normal_map, shape_filter=separation.shape_filter())
        write("detail", lambda folder: write_separation(folder, parts, maps))
    with watch.stage("surface"):
        surface = processing.integrate(
            normal_map, camera=source.camera, pixel_mm=_pixel_mm(source, surfaces)
        )
        colours = processing.albedo_picture(stage.albedo, normal_map.mask).pixels
        write(
            "surface",
            lambda folder: write_surface(folder, surface, normal_map, surfaces, colours=colours),
        )
    metrics: StagesMetrics = {
        "normals": normals_metrics(stage),
        "detail": separation_metrics(parts),
        "surface": surface_metrics(surface),
    }
    return Outcome(stage, parts, surface, metrics, merged)


def _albedo(stage: processing.Reconstruction) -> npt.NDArray[np.float32]:
    """Return the albedo for a picture, NaN outside the object."""
    outside = ~stage.mask if stage.albedo.ndim == 2 else ~stage.mask[..., None]
    return np.where(outside, np.float32(np.nan), stage.albedo)


def _pixel_mm(source: acquisition.Source, options: SurfaceOptions) -> float | None:
    """Return the size of a pixel of the images that are processed."""
    if options.pixel_mm is None or source.reduction is None:
        return options.pixel_mm
    return options.pixel_mm * source.reduction.factor


def _recorded(*groups: DataclassInstance) -> dict[str, object]:
    return {name: value for group in groups for name, value in asdict(group).items()}


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
        image_panel("albedo", _albedo(stage), stage.mask),
        normals_panel("shape component", outcome.parts.shape),
        normals_panel("detail component", outcome.parts.detail),
        map_panel("height", surface.height, surface.unit),
        shaded_panel("surface, lit from the upper left", surface.height / surface.pixel_size),
    ]
    if stage.error is not None:
        title = f"normal error, mean {stage.error.mae_deg:.2f} deg"
        panels.append(map_panel(title, stage.error.map_deg, "deg", error=True))
    return panels
