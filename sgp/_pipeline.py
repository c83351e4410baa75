"""Compute normals, shape, detail and surface from a source, and write them into one folder."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

import acquisition
import processing
from sgp._console import Stages
from sgp._metrics import StagesMetrics
from sgp._options import SourceOptions
from sgp._output import claim_folder, write_record
from sgp._overview import Panel
from sgp._panels.crop import Crop
from sgp._panels.lights import lights_panel
from sgp._panels.maps import (
    detail_panel,
    image_panel,
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
        If both a pixel size and a camera with a working distance are given, or the images are
        smaller than the window of the filter, besides the errors of the stages.
    """
    # Before the normals, which take long.
    if surfaces.pixel_mm is not None and source.camera is not None:
        processing.check_scale(source.camera, surfaces.pixel_mm)
    separation.shape_filter().check_size(source.size)
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
        stage = compute_normals(source, options.method, distant=options.distant)
        write("normals", lambda folder: write_normals_stage(folder, stage, maps))
    normal_map = stage.stereo.normal_map
    with watch.stage("detail"):
        with Stages() as progress:
            parts = processing.separate(
                normal_map, shape_filter=separation.shape_filter(), on_progress=progress
            )
        write("detail", lambda folder: write_separation(folder, parts, maps))
    with watch.stage("surface"):
        with Stages() as progress:
            surface = processing.integrate(
                normal_map,
                camera=source.camera,
                pixel_mm=_pixel_mm(source, surfaces),
                on_progress=progress,
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


def crop_of(outcome: Outcome) -> Crop:
    """Return the rectangle that all pictures of an outcome show, with its scale if it is known."""
    surface = outcome.surface
    return Crop.around(outcome.normals.mask, surface.pixel_size if surface.unit == "mm" else None)


def overview_panels(outcome: Outcome, true_lights: acquisition.Lights | None = None) -> list[Panel]:
    """Return the overview pictures that can be drawn for any recording."""
    stage, surface = outcome.normals, outcome.surface
    solved, names, crop = stage.stereo, stage.lights.ids, crop_of(outcome)
    normal_map = solved.normal_map
    lights_title = "lights" if true_lights is None else "lights (red: truth)"
    return [
        image_panel(f"light {names[0]}", stage.previews[0], crop),
        image_panel(f"light {names[-1]}", stage.previews[1], crop),
        lights_panel(f"{lights_title}, rings in degrees", stage.lights, true_lights),
        normals_panel("normals (right red, up green)", normal_map, crop),
        image_panel("albedo", _albedo(stage), crop),
        *_doubts(solved, len(names), crop),
        normals_panel("shape component", outcome.parts.shape, crop),
        detail_panel("detail component", outcome.parts.detail, crop),
        map_panel("height", surface.height, surface.unit, crop),
        shaded_panel("surface, lit from the upper left", surface.height / surface.pixel_size, crop),
        *_error(stage.error, crop),
    ]


def _doubts(solved: processing.PhotometricStereoResult, count: int, crop: Crop) -> list[Panel]:
    """Return maps of the residual relative to the signal, and of the number of samples."""
    mask = solved.normal_map.mask
    with np.errstate(divide="ignore", invalid="ignore"):
        percent = np.where(mask, 100 * solved.residual / solved.albedo, np.nan)
    used = _inside(solved.used, mask)
    middle, least, most = float(np.nanmedian(percent)), np.nanmin(used), np.nanmax(used)
    counts = f"{most:.0f}" if least == most else f"{least:.0f} to {most:.0f}"
    return [
        map_panel(f"residual, median {middle:.2g} %", percent, "% of the albedo", crop, error=True),
        map_panel(f"samples used, {counts} of {count}", used, "samples", crop, limits=(0, count)),
    ]


def _error(error: processing.AngularError | None, crop: Crop) -> list[Panel]:
    if error is None:
        return []
    title = f"normal error, mean {error.mae_deg:.2f} deg"
    return [map_panel(title, error.map_deg, "deg", crop, error=True)]


def _inside(values: npt.NDArray[Any], mask: npt.NDArray[np.bool_]) -> npt.NDArray[np.float32]:
    return np.where(mask, values, np.nan).astype(np.float32)
