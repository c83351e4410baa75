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
from sgp._console import Stages
from sgp._metrics import StagesMetrics
from sgp._options import SourceOptions
from sgp._output import claim_folder, write_record
from sgp._overview import Panel
from sgp._panels.crop import Crop
from sgp._panels.lights import lights_panel
from sgp._panels.maps import (
    image_panel,
    map_panel,
    normals_panel,
    shaded_panel,
    slopes_panel,
    vectors_panel,
)
from sgp._result import Result
from sgp._stage_metrics import NormalsMetrics, SeparationMetrics
from sgp._stage_options import MapOptions, SeparationOptions, SurfaceOptions
from sgp._stages import Stopwatch, compute_normals, with_scale
from sgp._write import (
    normals_metrics,
    write_normals_stage,
    write_separation,
)
from sgp._write_surface import surface_metrics, write_surface

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

_Write = Callable[[str, Callable[[Path], Result]], None]
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
    colours: npt.NDArray[np.uint8]
    depth_mm: npt.NDArray[np.float32] | None
    sigma_deg: npt.NDArray[np.float32] | None
    common_sigma_deg: npt.NDArray[np.float32] | None


@dataclass(frozen=True, eq=False)
class _Normals(Integrable):
    """What the stages after the first need of it."""

    crop: Crop
    panels: list[Panel]
    errors: list[Panel]
    metrics: NormalsMetrics


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
    unit, pixel_size = processing.surface_scale(source.camera, pixel_mm)
    separation.shape_filter().check_size(source.size)
    records = StageRecords(out, files, source, options, maps, separation, surfaces)

    def write(name: str, files_of: Callable[[Path], Result]) -> None:
        records.merge(name, records.write(name, files_of))

    with watch.stage("normals"):
        seen = _normals(
            source, files, options, maps, write, (unit, pixel_size), pixel_mm, true_lights
        )
    with watch.stage("detail"):
        part_metrics, part_panels = _detail(seen, separation, maps, write)
    with watch.stage("surface"):
        surface, surface_panels = _surface(seen, source, pixel_mm, surfaces, write)
    figures: StagesMetrics = {
        "normals": seen.metrics,
        "detail": part_metrics,
        "surface": surface_metrics(surface),
    }
    panels = [*seen.panels, *part_panels, *surface_panels, *seen.errors]
    return OutcomeInMemory(panels, figures, records.merged, seen.normal_map, surface, seen.crop)


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
    stage = compute_normals(source, options, pixel_mm)
    normal_map = stage.normals
    picture = processing.albedo_picture(stage.albedo, normal_map.mask)
    write(
        "normals",
        lambda folder: write_normals_stage(
            folder, stage, maps, picture, command="sgp run", files=files
        ),
    )
    crop = Crop.around(stage.mask, scale[1] if scale[0] == "mm" else None)
    return _Normals(
        normal_map=normal_map,
        colours=picture.pixels,
        crop=crop,
        panels=_normals_panels(stage, crop, true_lights),
        errors=_error(stage.error, crop),
        metrics=normals_metrics(stage),
        depth_mm=None if stage.near_height is None else stage.near_height.depth,
        sigma_deg=stage.uncertainty.sigma_deg,
        common_sigma_deg=stage.uncertainty.common_sigma_deg,
    )


def _detail(
    seen: _Normals, separation: SeparationOptions, maps: MapOptions, write: _Write
) -> tuple[SeparationMetrics, list[Panel]]:
    with Stages() as progress:
        parts = processing.computed(separation.stage(), seen.normal_map, on_progress=progress)
    mask = seen.normal_map.mask
    write("detail", lambda folder: write_separation(folder, parts, mask, maps))
    panels = [
        vectors_panel("shape component", parts["shape"], mask, seen.crop),
        slopes_panel("detail component", parts["detail"], mask, seen.crop),
    ]
    return {"separability_deg": separation.stage().separability_deg(parts, mask)}, panels


def _surface(
    seen: _Normals,
    source: acquisition.Source,
    pixel_mm: float | None,
    options: SurfaceOptions,
    write: _Write,
) -> tuple[processing.HeightMap, list[Panel]]:
    surface = integrate(seen, source.camera, pixel_mm, options)
    write("surface", lambda folder: write_integrated(folder, surface, seen, options))
    shaded = "surface, lit from the upper left"
    return surface, [
        map_panel("height", surface.height, surface.unit, seen.crop),
        shaded_panel(shaded, surface.height, seen.crop, surface.pixel_size),
    ]


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


def _normals_panels(
    stage: processing.Reconstruction, crop: Crop, true_lights: acquisition.Lights | None
) -> list[Panel]:
    solved, names = stage.stereo, stage.lights.ids
    lights_title = "lights" if true_lights is None else "lights (red: truth)"
    return [
        image_panel(f"light {names[0]}", stage.previews[0], crop),
        image_panel(f"light {names[-1]}", stage.previews[1], crop),
        lights_panel(f"{lights_title}, rings in degrees", stage.lights, true_lights),
        normals_panel("normals (right red, up green)", solved.normal_map, crop),
        image_panel("albedo", stage.albedo, crop, stage.mask),
        _highlights(stage, crop),
        *_doubts(solved, len(names), crop),
        *_error_bars(stage.uncertainty, crop),
    ]


def _error_bars(found: processing.NormalUncertainty, crop: Crop) -> list[Panel]:
    """Return a map of the standard deviations of the normals, if they are known."""
    sigma = found.sigma_deg
    if not np.isfinite(sigma).any():
        return []
    title = f"normals: standard deviation, median {np.nanmedian(sigma):.2g} deg"
    return [map_panel(title, sigma, "deg", crop, error=True)]


def _highlights(stage: processing.Reconstruction, crop: Crop) -> Panel:
    """Return a map of the light above a matte surface, relative to the mean albedo."""
    mask = stage.normals.mask
    percent = 100 * stage.specular / np.mean(stage.gray_albedo[mask], dtype=np.float64)
    title = f"light above a matte surface, mean {np.mean(percent[mask]):.2g} %"
    return map_panel(title, percent, "% of the mean albedo", crop, error=True, mask=mask)


def _doubts(solved: processing.PhotometricStereoResult, count: int, crop: Crop) -> list[Panel]:
    """Return maps of the residual relative to the signal, and of the number of samples."""
    mask = solved.normal_map.mask
    percent = np.divide(
        solved.residual, solved.albedo, out=np.zeros_like(solved.albedo), where=mask
    )
    percent *= 100
    middle = float(np.nanmedian(percent[mask], overwrite_input=True))
    used = solved.used[mask]
    least, most = int(used.min()), int(used.max())
    counts = f"{most}" if least == most else f"{least} to {most}"
    unit, title = "% of the albedo", f"samples used, {counts} of {count}"
    return [
        map_panel(f"residual, median {middle:.2g} %", percent, unit, crop, error=True, mask=mask),
        map_panel(title, solved.used, "samples", crop, limits=(0, count), mask=mask),
    ]


def _error(error: processing.AngularError | None, crop: Crop) -> list[Panel]:
    if error is None:
        return []
    title = f"normal error, mean {error.mae_deg:.2f} deg"
    return [map_panel(title, error.map_deg, "deg", crop, error=True)]
