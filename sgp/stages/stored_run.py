"""A run within a limit of memory: each stage leaves its maps in files for the next one."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np

import acquisition
import processing
import rig
from sgp.cli.console import note
from sgp.cli.options import SourceOptions
from sgp.pictures.crop import Crop
from sgp.pictures.sheet import Panel
from sgp.results.hashes import output_fault
from sgp.results.metrics import StagesMetrics
from sgp.results.output import claim_folder
from sgp.results.record import read_record
from sgp.results.result import Result, dumps
from sgp.results.stage_metrics import NormalsMetrics
from sgp.stages.maps import MapInput, stage_maps
from sgp.stages.memory_limit import Limit, identity, is_in_bands, other_maps_refused
from sgp.stages.options import MapOptions, SeparationOptions, SurfaceOptions
from sgp.stages.panels import (
    DRAWN,
    error_panels,
    is_known,
    normals_panels,
    separation_panels,
    surface_panels,
)
from sgp.stages.pipeline import (
    Outcome,
    StageRecords,
    process,
)
from sgp.stages.recording import Stopwatch, with_scale
from sgp.stages.stored_normals import are_normals_in_files, normals_within
from sgp.stages.surface_maps import SurfaceInputs, SurfaceWay, integrated
from sgp.stages.write import write_normals_stage, write_separation

# Bytes per pixel that the stages after the normals have in memory besides their own.
_HELD = 16
# Maps that the end of a run needs besides those in its folder.
_KEPT = ("depth", "common", "first", "last", "error")
# Values that are read at once.
_READ = 4_000_000


@dataclass(frozen=True, kw_only=True)
class RunOptions:
    """Options of the stages of a run."""

    source: SourceOptions
    maps: MapOptions
    separation: SeparationOptions
    surfaces: SurfaceOptions


@contextmanager
def processed_within(
    memory: int | None,
    source: acquisition.Source,
    files: list[Path],
    out: Path,
    watch: Stopwatch,
    given: RunOptions,
    *,
    force: bool,
) -> Iterator[Outcome]:
    """Run every stage on a source with a limited memory, as `process` does.

    What does not fit is computed in bands of rows. The state of the run is then in a hidden folder
    of ``out`` until the block ends without an error; another call continues it.

    Parameters
    ----------
    memory
        Bytes to use; None for half of what is free.
    source, files, out, watch
        As for `process`.
    given
        The options.
    force
        Whether an unfinished run with other inputs or options is removed.

    Raises
    ------
    UsageError
        If the memory is too small, or there is an unfinished run of another command.
    """
    scaled, pixel_mm = with_scale(source, given.surfaces.pixel_mm)
    in_files, lines = _ways(memory, scaled, given)
    in_files |= acquisition.files.is_unfinished(out / "summary")
    if not in_files:
        _state(lines if memory is not None else [])
        yield process(
            source,
            files,
            out,
            watch,
            given.source,
            maps=given.maps,
            separation=given.separation,
            surfaces=given.surfaces,
        )
        return
    # Wrong combinations are refused before any work.
    given.surfaces.sharpness()
    scale = processing.surface.surface_scale(scaled.camera, pixel_mm)
    given.separation.shape_filter().check_size(scaled.size)
    options = {
        name: value
        for group in (given.source, given.maps, given.separation, given.surfaces)
        for name, value in asdict(group).items()
        if not isinstance(value, Path)  # the hashes of the inputs are those of their contents
    }
    depends_on = identity(options, files)
    forms = dict.fromkeys(_KEPT, (scaled.size, np.float32))
    with other_maps_refused():
        if not force:
            acquisition.files.check_unfinished(out / "summary", depends_on)
        _state(lines)
        store = acquisition.files.BandStore(out / "summary", depends_on, forms, replace=force)
    with store:
        run = _Run(memory, scaled, pixel_mm, files, out, given, force, store)
        try:
            results = run.stages(watch)
            metrics = cast(
                "StagesMetrics", {name: result.metrics for name, result in results.items()}
            )
            yield Outcome(run.panels(results, *scale), metrics, run.records.merged)
        except BaseException:
            run.leave()
            raise
        store.remove()


def _ways(
    memory: int | None, source: acquisition.Source, given: RunOptions
) -> tuple[bool, list[str]]:
    """Return whether the maps of a run do not fit into memory, and lines about the stages."""
    need = given.separation.stage().need(source.size)
    banded = (
        are_normals_in_files(memory, source, given.source.stage(None)),
        is_in_bands(memory, need),
    )
    surface = run_surface_way(memory, source, given.surfaces)
    held = _HELD * source.size[0] * source.size[1]
    fits = max(need.whole, surface.memory) + held <= rig.processes.memory_budget(memory)
    normals, detail = ("in bands of rows" if found else "as a whole" for found in banded)
    lines = [f"normals {normals}, detail {detail}", surface.line()]
    return any(banded) or surface.rows is not None or not fits, lines


def _state(lines: list[str]) -> None:
    for line in lines:
        note(line)


def run_surface_way(
    memory: int | None, source: acquisition.Source, options: SurfaceOptions
) -> SurfaceWay:
    """Return how the surface of a run is solved."""
    return SurfaceWay.within(
        memory,
        source.size,
        processing.surface.SurfaceStage(source.camera is not None, True),
        stl=options.stl,
        whole_for=[name for name, asked in options.whole_surface().items() if asked],
    )


class _Run:
    """The stages of a run, each of which is done once even if the process is killed."""

    def __init__(
        self,
        memory: int | None,
        source: acquisition.Source,
        pixel_mm: float | None,
        files: list[Path],
        out: Path,
        given: RunOptions,
        force: bool,
        store: acquisition.files.BandStore,
    ) -> None:
        self._memory, self._source, self._pixel_mm = memory, source, pixel_mm
        self._files, self._out, self._given, self._force = files, out, given, force
        self._store = store
        self.records = StageRecords(
            out, files, source, given.source, given.maps, given.separation, given.surfaces
        )

    def stages(self, watch: Stopwatch) -> dict[str, Result]:
        """Compute what is missing; return the results by stage."""
        results: dict[str, Result] = {}
        todo: dict[str, Callable[[], Result]] = {
            "normals": self._normals,
            "detail": self._detail,
            "surface": lambda: self._surface(results["normals"]),
        }
        for name, compute in todo.items():
            with watch.stage(name):
                results[name] = self._kept(name) or compute()
            # What a kill left after the stage was complete.
            acquisition.files.remove_unfinished(self._out / name / name)
            self.records.merge(name, results[name])
        return results

    def panels(self, results: dict[str, Result], unit: str, pixel_size: float) -> list[Panel]:
        """Return the overview pictures, which `process` makes of maps in memory."""
        with ExitStack() as opened:

            def rows(stage: str, name: str) -> acquisition.MapRows:
                path, most = results[stage].outputs[name], self._given.source.max_pixels
                return opened.enter_context(acquisition.pixels.ImageRows(path, max_pixels=most))

            metrics = cast("NormalsMetrics", results["normals"].metrics)
            lights = cast("acquisition.Lights", self._source.lights)
            used = rig.files.parse_json(rig.read_bounded(self._store.folder / "images.json"))["ids"]
            mask = acquisition.read_mask(results["normals"].outputs["mask"], self._source.size)
            crop = Crop.around(mask, pixel_size if unit == "mm" else None)
            drawn = {name: rows("normals", name) for name in DRAWN} | dict(self._store)
            error = self._store["error"] if "mae_deg" in metrics else None
            return [
                *normals_panels(
                    drawn,
                    mask,
                    crop,
                    lights.take([lights.ids.index(name) for name in used]),
                    metrics,
                ),
                *separation_panels(rows("detail", "shape"), rows("detail", "detail"), mask, crop),
                *surface_panels(rows("surface", "height"), unit, pixel_size, crop),
                *error_panels(error, metrics, crop),
            ]

    def leave(self) -> None:
        """Keep what can be continued; otherwise leave nothing."""
        begun = any((self._out / name).exists() for name in ("normals", "detail", "surface"))
        self._store.close()
        if not begun:
            self._store.remove()
            with suppress(OSError):
                self._out.rmdir()

    def _kept(self, name: str) -> Result | None:
        """Return the result of a stage that is complete, and whose files are as it left them."""
        try:
            content: Any = rig.files.parse_json(
                rig.read_bounded(self._store.folder / f"{name}.json")
            )
        except (FileNotFoundError, rig.UnreadableError):
            return None
        folder = self._out / name
        result = Result(
            outputs={key: folder / file for key, file in content["outputs"].items()},
            metrics=content["metrics"],
            warnings=[rig.Notice(**notice) for notice in content["notices"]],
            summary=content["summary"],
            parameters=content["parameters"],
        )
        try:
            files = read_record(folder / f"{name}.json").files
        except (acquisition.DataError, acquisition.MissingPathError):
            return None
        intact = all(
            output_fault(folder / file, known.bytes, known.sha256) is None
            for file, known in files.items()
        )
        return result if intact else None

    def _keep(self, name: str, result: Result) -> Result:
        """State that a stage is complete, with what the end of the run needs of it."""
        content = {
            "outputs": {key: path.name for key, path in result.outputs.items()},
            "metrics": result.metrics,
            "notices": [asdict(notice) for notice in result.warnings],
            "summary": result.summary,
            "parameters": result.parameters,
        }
        acquisition.write_durably(self._store.folder / f"{name}.json", dumps(content).encode())
        return result

    def _normals(self) -> Result:
        given, folder = self._given, self._out / "normals"
        with normals_within(
            self._memory,
            self._source,
            given.source,
            self._pixel_mm,
            files=self._files,
            out=folder,
            force=self._force,
        ) as stage:
            # Results of an earlier run are removed only now.
            claim_folder(self._out, "summary.json")
            result = self.records.write(
                "normals",
                lambda place: write_normals_stage(
                    place, stage, given.maps, command="sgp run", files=self._files
                ),
            )
            kept: dict[str, acquisition.MapRows] = {
                "first": stage.previews[0],
                "last": stage.previews[1],
                "common": stage.maps["normal_sigma_common_deg"],
            }
            if stage.near_height is not None:
                kept["depth"] = stage.near_height.depth
            if stage.error is not None:
                kept["error"] = stage.error.map_deg
            height, width = self._source.size
            for rows in acquisition.files.rows_in_bands(height, width, _READ):
                for name, values in kept.items():
                    self._store[name][rows] = values[rows]
            for file in self._store.values():
                file.sync()
            images = dumps({"ids": stage.lights.ids}).encode()
            acquisition.write_durably(self._store.folder / "images.json", images)
            return self._keep("normals", result)

    def _detail(self) -> Result:
        given = self._given
        limit = Limit(self._memory, self._out / "detail" / "detail", self._force)
        normals = MapInput(self._out / "normals", max_pixels=given.source.max_pixels)
        with stage_maps(given.separation.stage(), [normals], limit) as made:
            mask = made.inputs[0].mask
            result = self.records.write(
                "detail", lambda place: write_separation(place, made.maps, mask, given.maps)
            )
            return self._keep("detail", result)

    def _surface(self, normals: Result) -> Result:
        options = self._given.surfaces
        sigma_known = is_known(cast("float | None", normals.metrics["normal_sigma_deg"]))
        inputs = SurfaceInputs(
            normals=self._out / "normals",
            albedo=normals.outputs["albedo_png"],
            camera=self._source.camera,
            sigma=normals.outputs["normal_sigma_deg"] if sigma_known else None,
            common_sigma_deg=self._store["common"] if options.height_sigma else None,
            pixel_mm=self._pixel_mm,
            depth_mm=self._store["depth"] if normals.metrics["lights"] == "near" else None,
            weighted=False,
            max_pixels=self._given.source.max_pixels,
        )
        way = run_surface_way(self._memory, self._source, options)
        result = self.records.write(
            "surface", lambda place: integrated(inputs, options, way, place, force=self._force)
        )
        return self._keep("surface", result)
