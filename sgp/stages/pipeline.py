"""Compute normals, shape, detail and surface from a source, and write them into one folder."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

import acquisition
import processing
from rig.arrays import Float32, UInt8
from sgp.cli.console import Stages
from sgp.cli.options import SourceOptions
from sgp.pictures.crop import Crop
from sgp.pictures.sheet import Panel
from sgp.results.metrics import StagesMetrics
from sgp.results.output import claim_folder, write_record
from sgp.results.result import Result
from sgp.results.stage_metrics import NormalsMetrics
from sgp.stages.options import MapOptions, SeparationOptions, SurfaceOptions
from sgp.stages.panels import (
    error_panels,
    normals_panels,
    separation_panels,
    surface_panels,
)
from sgp.stages.recording import Stopwatch, compute_normals, with_scale
from sgp.stages.write import write_normals_stage, write_separation
from sgp.stages.write_surface import write_surface

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

_Write = Callable[[str, Callable[[Path], Result]], Result]
_MAPS, _SEPARATION, _SURFACES = MapOptions(), SeparationOptions(), SurfaceOptions()


@dataclass(frozen=True, eq=False)
class Outcome:
    """What the stages leave for one source; `result` has no figures so far.

    The pictures are made while the stages run, so that their maps need not stay in memory: of a
    large recording these are several GB.

    Parameters
    ----------
    panels
        The overview pictures that can be drawn for any recording.
    metrics
        Figures by stage.
    result
        Files, warnings and lines of all stages.
    """

    panels: list[Panel]
    metrics: StagesMetrics
    result: Result


@dataclass(frozen=True, eq=False)
class OutcomeInMemory(Outcome):
    """What the stages leave if all maps are in memory.

    Parameters
    ----------
    normal_map
        The normals.
    surface
        The height.
    crop
        The rectangle that all pictures show, with its scale if it is known.
    panels, metrics, result
        As in `Outcome`.
    """

    normal_map: processing.NormalMap
    surface: processing.HeightMap
    crop: Crop


@dataclass(frozen=True, eq=False)
class Integrable:
    """What the surface is computed from: normals, colours, depths and deviations."""

    normal_map: processing.NormalMap
    colours: UInt8
    depth_mm: Float32 | None
    sigma_deg: Float32 | None
    common_sigma_deg: Float32 | None


@dataclass(frozen=True, eq=False)
class _Normals(Integrable):
    """What the stages after the first need of it."""

    crop: Crop
    panels: list[Panel]
    errors: list[Panel]


class StageRecords:
    """Writes the folders of the stages with their records, and merges their results."""

    def __init__(
        self, out: Path, files: list[Path], source: acquisition.Source, *groups: DataclassInstance
    ) -> None:
        chosen = {"transfer": source.transfer.record()}
        given = {name: value for group in groups for name, value in asdict(group).items()}
        self._defaults = {
            name: value for group in groups for name, value in asdict(type(group)()).items()
        }
        self._out, self._files = out, files
        self._parameters = {"source": source.path, **given, **chosen}
        self.merged = Result(inputs=files, parameters=chosen)

    def write(self, name: str, files_of: Callable[[Path], Result]) -> Result:
        """Let a function write the files of a stage; write their record, and return the result."""
        record = f"{name}.json"
        result = files_of(claim_folder(self._out / name, record, self._files))
        result.inputs = self._files
        path = self._out / name / record
        made = self._parameters | result.parameters
        write_record(path, "sgp run", made, result, defaults=self._defaults)
        return result

    def merge(self, name: str, result: Result) -> None:
        """Add the result of a stage under its name."""
        merged = self.merged
        merged.parameters |= result.parameters
        merged.outputs.update({f"{name}.{key}": path for key, path in result.outputs.items()})
        merged.warnings += result.warnings
        merged.summary += [f"{name:<8} {line}" for line in result.summary]


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
    true_lights: acquisition.Lights | None = None,
) -> OutcomeInMemory:
    """Run every stage on a source and write ``normals/``, ``detail/`` and ``surface/`` in ``out``.

    Each folder gets its own record. Outputs and figures of the stages are merged under the
    stage's name. The overview also shows ``true_lights``, if they are known.

    Raises
    ------
    DataError
        If both a pixel size and a camera with a working distance are given, or the images are
        smaller than the window of the filter, besides the errors of the stages.
    """
    source, pixel_mm = with_scale(source, surfaces.pixel_mm)
    surfaces.sharpness()  # refuses wrong combinations before any work
    # Before the normals, which take long.
    unit, pixel_size = processing.surface.surface_scale(source.camera, pixel_mm)
    separation.shape_filter().check_size(source.size)
    records = StageRecords(out, files, source, options, maps, separation, surfaces)

    figures: dict[str, Any] = {}

    def write(name: str, files_of: Callable[[Path], Result]) -> Result:
        result = records.write(name, files_of)
        figures[name] = result.metrics
        records.merge(name, result)
        return result

    with watch.stage("normals"):
        seen = _normals(
            source, files, options, maps, write, (unit, pixel_size), pixel_mm, true_lights
        )
    with watch.stage("detail"):
        part_panels = _detail(seen, separation, maps, write)
    with watch.stage("surface"):
        surface = _surface(seen, source, pixel_mm, surfaces, write)
    shown = surface_panels(surface.height, surface.unit, surface.pixel_size, seen.crop)
    panels = [*seen.panels, *part_panels, *shown, *seen.errors]
    metrics = cast("StagesMetrics", figures)
    return OutcomeInMemory(panels, metrics, records.merged, seen.normal_map, surface, seen.crop)


def _normals(
    source: acquisition.Source,
    files: list[Path],
    options: SourceOptions,
    maps: MapOptions,
    write: _Write,
    scale: tuple[str, float],
    pixel_mm: float | None,
    true_lights: acquisition.Lights | None,
) -> _Normals:
    """Compute, write and draw the normals, and keep what the other stages need."""
    stage = compute_normals(source, options.stage(pixel_mm))
    normal_map = stage.normals
    picture = processing.colour.albedo_picture(stage.albedo, normal_map.mask)
    result = write(
        "normals",
        lambda folder: write_normals_stage(
            folder, stage, maps, picture, command="sgp run", files=files
        ),
    )
    crop = Crop.around(normal_map.mask, scale[1] if scale[0] == "mm" else None)
    drawn = {**stage.maps} | dict(zip(("first", "last"), stage.previews, strict=True))
    metrics = cast("NormalsMetrics", result.metrics)
    return _Normals(
        normal_map=normal_map,
        colours=picture.pixels,
        crop=crop,
        panels=normals_panels(drawn, normal_map.mask, crop, stage.lights, metrics, true_lights),
        errors=error_panels(None if stage.error is None else stage.error.map_deg, metrics, crop),
        depth_mm=None if stage.near_height is None else stage.near_height.depth,
        sigma_deg=stage.uncertainty.sigma_deg,
        common_sigma_deg=stage.uncertainty.common_sigma_deg,
    )


def _detail(
    seen: _Normals, separation: SeparationOptions, maps: MapOptions, write: _Write
) -> list[Panel]:
    with Stages() as progress:
        parts = processing.stages.computed(
            separation.stage(), seen.normal_map, on_progress=progress
        )
    mask = seen.normal_map.mask
    write("detail", lambda folder: write_separation(folder, parts, mask, maps))
    return separation_panels(parts["shape"], parts["detail"], mask, seen.crop)


def _surface(
    seen: _Normals,
    source: acquisition.Source,
    pixel_mm: float | None,
    options: SurfaceOptions,
    write: _Write,
) -> processing.HeightMap:
    surface = integrate(seen, source.camera, pixel_mm, options)
    write("surface", lambda folder: write_integrated(folder, surface, seen, options))
    return surface


def integrate(
    seen: Integrable,
    camera: acquisition.CameraModel | None,
    pixel_mm: float | None,
    options: SurfaceOptions,
) -> processing.HeightMap:
    """Integrate the normals of a run, and show the progress."""
    known = seen.sigma_deg is not None and bool(np.isfinite(seen.sigma_deg).any())
    with Stages() as progress:
        return processing.integrate(
            seen.normal_map,
            camera=camera,
            pixel_mm=pixel_mm,
            depth_mm=seen.depth_mm,
            sigma_deg=seen.sigma_deg,
            common_sigma_deg=seen.common_sigma_deg,
            weighted=False,
            height_errors=options.height_sigma and known,
            discontinuity=options.discontinuity,
            k=options.sharpness(),
            on_progress=progress,
        )


def write_integrated(
    folder: Path, surface: processing.HeightMap, seen: Integrable, options: SurfaceOptions
) -> Result:
    """Write the surface of a run."""
    return write_surface(
        folder, surface, seen.normal_map, options, colours=seen.colours, sigma_deg=seen.sigma_deg
    )
