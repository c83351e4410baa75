"""The stages of a run: normals, detail and surface of a recording, written into one folder."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, cast

import numpy as np

import acquisition
import processing
import rig
from rig.arrays import Bool, UInt8
from sgp.cli.console import note
from sgp.cli.options import SourceOptions
from sgp.pictures import Crop, Panel
from sgp.results import (
    NormalsMetrics,
    Result,
    StagesMetrics,
    claim_folder,
    dumps,
    good_result,
    output_fault,
    read_record,
    recorded_verdict,
    seen_in,
    verdict_record,
    write_record,
)
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
from sgp.stages.recording import Stopwatch, with_scale
from sgp.stages.stored_normals import are_normals_in_files, normals_within
from sgp.stages.surface_maps import SurfaceInputs, SurfaceWay, integrated
from sgp.stages.write import write_normals_stage, write_separation

# Bytes per pixel that the stages after the normals have in memory besides their own.
_HELD = 16
# Maps that later stages and pictures need besides those in the folder of the normals.
_KEPT = ("depth", "common", "first", "last", "error")
# Values that are read at once.
_READ = 4_000_000


@dataclass(frozen=True, kw_only=True)
class RunOptions:
    """Options of the stages of a run."""

    source: SourceOptions = field(default_factory=SourceOptions)
    maps: MapOptions = field(default_factory=MapOptions)
    separation: SeparationOptions = field(default_factory=SeparationOptions)
    surfaces: SurfaceOptions = field(default_factory=SurfaceOptions)

    def by_name(self) -> dict[str, Any]:
        """Return all options."""
        groups = (self.source, self.maps, self.separation, self.surfaces)
        return {name: value for group in groups for name, value in asdict(group).items()}


@dataclass(frozen=True, eq=False)
class Outcome:
    """What the stages leave for one source; `result` has no figures so far.

    Parameters
    ----------
    panels
        The overview pictures that can be drawn for any recording.
    metrics
        Figures by stage.
    result
        Files, warnings and lines of all stages.
    crop
        The rectangle that all pictures show, with its scale if it is known.
    """

    panels: list[Panel]
    metrics: StagesMetrics
    result: Result
    crop: Crop


@contextmanager
def processed(
    source: acquisition.Source,
    files: list[Path],
    out: Path,
    watch: Stopwatch,
    given: RunOptions,
    *,
    memory: int | None = None,
    force: bool = False,
    true_lights: acquisition.Lights | None = None,
) -> Iterator[Outcome]:
    """Run every stage on a source and write ``normals/``, ``detail/`` and ``surface/`` in ``out``.

    Each folder gets its own record. Outputs and figures of the stages are merged under the
    stage's name. What does not fit into memory is computed in bands of rows, and each stage reads
    the maps of the one before from its files. The state of the run is then in a hidden folder of
    ``out`` until the block ends without an error; another call continues it.

    Parameters
    ----------
    source, files, out, watch, given
        The recording with all its files, where the results belong, what measures the stages, and
        the options.
    memory
        Bytes to use; None for half of what is free.
    force
        Whether an unfinished run with other inputs or options is removed.
    true_lights
        The true lights, if they are known: the overview shows them.

    Raises
    ------
    UsageError
        If the memory is too small, or there is an unfinished run of another command.
    DataError
        If both a pixel size and a camera with a working distance are given, or the images are
        smaller than the window of the filter, besides the errors of the stages.
    """
    source, pixel_mm = with_scale(source, given.surfaces.pixel_mm)
    way, in_files, lines = _ways(memory, source, given)
    in_files |= acquisition.files.is_unfinished(out / "summary")
    # Wrong combinations are refused before any work.
    given.surfaces.sharpness()
    processing.surface.surface_scale(source.camera, pixel_mm)
    given.separation.shape_filter().check_size(source.size)
    run = _Run(source, pixel_mm, files, out, given, memory, force, way, true_lights)
    if not in_files:
        _state(lines if memory is not None else [])
        yield run.outcome(watch)
        return
    options = {
        name: value
        for name, value in given.by_name().items()
        if not isinstance(value, Path)  # the hashes of the inputs are those of their contents
    }
    depends_on = identity(options, files)
    forms = dict.fromkeys(_KEPT, (source.size, np.float32))
    with other_maps_refused():
        if not force:
            acquisition.files.check_unfinished(out / "summary", depends_on)
        _state(lines)
        store = acquisition.files.BandStore(out / "summary", depends_on, forms, replace=force)
    with store:
        run.store = store
        try:
            yield run.outcome(watch)
        except BaseException:
            run.leave(store)
            raise
        store.remove()


def _ways(
    memory: int | None, source: acquisition.Source, given: RunOptions
) -> tuple[SurfaceWay, bool, list[str]]:
    """Return how the surface is solved, whether maps need files, and lines about the stages."""
    need = given.separation.stage().need(source.size)
    banded = (
        are_normals_in_files(memory, source, given.source.stage(None)),
        is_in_bands(memory, need),
    )
    options = given.surfaces
    surface = SurfaceWay.within(
        memory,
        source.size,
        processing.surface.SurfaceStage(
            source.camera is not None, True, options.jumps() is not False
        ),
        stl=options.stl,
        whole_for=[name for name, asked in options.whole_surface().items() if asked],
    )
    held = _HELD * source.size[0] * source.size[1]
    fits = max(need.whole, surface.memory) + held <= rig.processes.memory_budget(memory)
    normals, detail = ("in bands of rows" if found else "as a whole" for found in banded)
    lines = [f"normals {normals}, detail {detail}", surface.line()]
    return surface, any(banded) or surface.rows is not None or not fits, lines


def _state(lines: list[str]) -> None:
    for line in lines:
        note(line)


@dataclass(eq=False)
class _Run:
    """The stages of a run; with a store, each is done once even if the process is killed."""

    source: acquisition.Source
    pixel_mm: float | None
    files: list[Path]
    out: Path
    given: RunOptions
    memory: int | None
    force: bool
    way: SurfaceWay
    true_lights: acquisition.Lights | None
    store: acquisition.files.BandStore | None = None
    results: dict[str, Result] = field(default_factory=dict)
    panels: list[Panel] = field(default_factory=list)
    errors: list[Panel] = field(default_factory=list)
    # Without a store: what the surface is computed from, and the maps of the last stage, which are
    # drawn at once, so that they need not stay in memory: of a large recording these are several
    # GB.
    inputs: SurfaceInputs | None = None
    maps: Mapping[str, acquisition.MapRows] = field(default_factory=dict)
    used: list[str] = field(default_factory=list)

    def outcome(self, watch: Stopwatch) -> Outcome:
        """Compute what is missing, and draw all stages."""
        merged = Result(inputs=self.files, parameters=seen_in(self.source))
        stages = {
            "normals": (self._normals, self._draw_normals),
            "detail": (self._detail, self._draw_detail),
            "surface": (self._surface, self._draw_surface),
        }
        for name, (compute, draw) in stages.items():
            with watch.stage(name), ExitStack() as opened:
                result = self.results[name] = self._kept(name) or compute()
                if self.store is not None:
                    # What a kill left after the stage was complete.
                    acquisition.files.remove_unfinished(self.out / name / name)
                draw(self._drawn(name, opened))
                self.maps = {}
            merged.parameters |= result.parameters
            merged.outputs.update({f"{name}.{key}": path for key, path in result.outputs.items()})
            merged.warnings += result.warnings
            if result.verdict is not None:
                merged.verdict, merged.good = result.verdict, result.good
            merged.summary += [f"{name:<8} {line}" for line in result.summary]
        self.inputs = None  # the pictures that follow need the memory
        figures = {name: result.metrics for name, result in self.results.items()}
        panels = [*self.panels, *self.errors]
        return Outcome(panels, cast("StagesMetrics", figures), merged, self._crop())

    def leave(self, store: acquisition.files.BandStore) -> None:
        """Keep what can be continued; otherwise leave nothing."""
        begun = any((self.out / name).exists() for name in ("normals", "detail", "surface"))
        store.close()
        if not begun:
            store.remove()
            with suppress(OSError):
                self.out.rmdir()

    def _kept(self, name: str) -> Result | None:
        """Return the result of a stage that is complete, and whose files are as it left them."""
        if self.store is None:
            return None
        try:
            content: Any = rig.files.parse_json(
                rig.read_bounded(self.store.folder / f"{name}.json")
            )
        except (FileNotFoundError, rig.UnreadableError):
            return None
        folder = self.out / name
        result = Result(
            outputs={key: folder / file for key, file in content["outputs"].items()},
            metrics=content["metrics"],
            warnings=[rig.Notice(**notice) for notice in content["notices"]],
            summary=content["summary"],
            parameters=content["parameters"],
        )
        if "verdict" in content:
            result.verdict = recorded_verdict(content)
            result.good = good_result(result.verdict)
        try:
            files = read_record(folder / f"{name}.json").files
        except (acquisition.DataError, acquisition.MissingPathError):
            return None
        intact = all(
            output_fault(folder / file, known.bytes, known.sha256) is None
            for file, known in files.items()
        )
        return result if intact else None

    def _written(self, name: str, files_of: Callable[[Path], Result]) -> Result:
        """Let a function write the files of a stage; write their record, and return the result."""
        record = f"{name}.json"
        result = files_of(claim_folder(self.out / name, record, self.files))
        result.inputs = self.files
        made = {
            "source": self.source.path,
            **self.given.by_name(),
            **seen_in(self.source),
            **result.parameters,
        }
        defaults = RunOptions().by_name()
        write_record(self.out / name / record, "sgp run", made, result, defaults=defaults)
        return result

    def _keep(self, name: str, result: Result) -> Result:
        """State that a stage is complete, with what the end of the run needs of it."""
        if self.store is not None:
            content = {
                "outputs": {key: path.name for key, path in result.outputs.items()},
                "metrics": result.metrics,
                "notices": [asdict(notice) for notice in result.warnings],
                "summary": result.summary,
                "parameters": result.parameters,
                **({} if result.verdict is None else verdict_record(result.verdict)),
            }
            acquisition.write_durably(self.store.folder / f"{name}.json", dumps(content).encode())
        return result

    def _normals(self) -> Result:
        given, folder = self.given, self.out / "normals"
        with normals_within(
            self.memory,
            self.source,
            given.source,
            self.pixel_mm,
            files=self.files,
            out=folder,
            force=self.force,
        ) as stage:
            picture = None
            if self.store is None:
                picture = processing.colour.albedo_picture(stage.albedo, stage.valid)
            else:
                # Results of an earlier run are removed only now.
                claim_folder(self.out, "summary.json")
            result = self._written(
                "normals",
                lambda place: write_normals_stage(
                    place, stage, given.maps, picture, command="sgp run", files=self.files
                ),
            )
            self.used = [*stage.lights.ids]
            first, last = stage.previews
            kept: dict[str, acquisition.MapRows] = {"first": first, "last": last}
            kept["common"] = stage.maps["normal_sigma_common_deg"]
            if stage.near_height is not None:
                kept["depth"] = stage.near_height.depth
            if stage.error is not None:
                kept["error"] = stage.error.map_deg
            if picture is not None:
                self.maps = {**stage.maps, **kept}
                self.inputs = self._surface_inputs(
                    result, stage.normals, picture.pixels, stage.maps["normal_sigma_deg"], kept
                )
                return result
            self._store_maps(kept)
            return self._keep("normals", result)

    def _store_maps(self, kept: Mapping[str, acquisition.MapRows]) -> None:
        store = cast("acquisition.files.BandStore", self.store)
        for rows in acquisition.files.rows_in_bands(*self.source.size, _READ):
            for name, values in kept.items():
                store[name][rows] = values[rows]
        for file in store.values():
            file.sync()
        images = dumps({"ids": self.used}).encode()
        acquisition.write_durably(store.folder / "images.json", images)

    def _detail(self) -> Result:
        given, folder = self.given, self.out / "detail"
        normals = MapInput(self.out / "normals", max_pixels=given.source.max_pixels)
        read = None
        if self.inputs is not None:
            whole = cast("processing.NormalMap", self.inputs.normals)
            read = [processing.NormalMapFile(whole, (), ())]
        limit = Limit(self.memory, folder / "detail", self.force)
        with stage_maps(given.separation.stage(), [normals], limit, read=read) as made:
            mask = made.inputs[0].mask
            result = self._written(
                "detail", lambda place: write_separation(place, made.maps, mask, given.maps)
            )
            if read is not None:
                self.maps = made.maps
            return self._keep("detail", result)

    def _surface(self) -> Result:
        inputs, normals = self.inputs, self.results["normals"]
        if inputs is None:
            maps = cast("acquisition.files.BandStore", self.store)
            albedo, sigma = normals.outputs["albedo_png"], normals.outputs["normal_sigma_deg"]
            inputs = self._surface_inputs(normals, self.out / "normals", albedo, sigma, maps)
        given = inputs

        def write(place: Path) -> Result:
            result, surface = integrated(
                given, self.given.surfaces, self.way, place, force=self.force
            )
            if self.store is None:
                self.maps = {"height": surface.height}
            return result

        return self._keep("surface", self._written("surface", write))

    def _surface_inputs(
        self,
        result: Result,
        normals: Path | processing.NormalMap,
        albedo: Path | UInt8,
        sigma: Path | acquisition.MapRows,
        maps: Mapping[str, acquisition.MapRows],
    ) -> SurfaceInputs:
        """Return what the surface is computed from: figures, files or maps of the normals."""
        metrics = cast("NormalsMetrics", result.metrics)
        return SurfaceInputs(
            normals=normals,
            albedo=albedo,
            camera=self.source.camera,
            sigma=sigma if is_known(metrics["normal_sigma_deg"]) else None,
            common_sigma_deg=maps["common"] if self.given.surfaces.height_sigma else None,
            pixel_mm=self.pixel_mm,
            depth_mm=maps["depth"] if metrics["lights"] == "near" else None,
            weighted=False,
            max_pixels=self.given.source.max_pixels,
        )

    def _drawn(self, name: str, opened: ExitStack) -> Mapping[str, acquisition.MapRows]:
        """Return the maps of a stage that are drawn, in memory or in its files."""
        if self.store is None:
            return self.maps
        paths, most = self.results[name].outputs, self.given.source.max_pixels
        return {
            key: opened.enter_context(acquisition.pixels.ImageRows(paths[key], max_pixels=most))
            for key in DRAWN[name]
        } | dict(self.store)

    def _mask(self) -> Bool:
        return acquisition.read_mask(self.results["normals"].outputs["mask"], self.source.size)

    def _scale(self) -> tuple[str, float]:
        return processing.surface.surface_scale(self.source.camera, self.pixel_mm)

    def _crop(self) -> Crop:
        unit, pixel_size = self._scale()
        return Crop.around(self._mask(), pixel_size if unit == "mm" else None)

    def _draw_normals(self, maps: Mapping[str, acquisition.MapRows]) -> None:
        if self.store is not None:
            file = rig.read_bounded(self.store.folder / "images.json")
            self.used = rig.files.parse_json(file)["ids"]
        lights = cast("acquisition.Lights", self.source.lights)
        used = lights.take([lights.ids.index(name) for name in self.used])
        metrics, crop = cast("NormalsMetrics", self.results["normals"].metrics), self._crop()
        self.panels += normals_panels(maps, self._mask(), crop, used, metrics, self.true_lights)
        self.errors += error_panels(maps["error"] if "mae_deg" in metrics else None, metrics, crop)

    def _draw_detail(self, maps: Mapping[str, acquisition.MapRows]) -> None:
        self.panels += separation_panels(maps["shape"], maps["detail"], self._mask(), self._crop())

    def _draw_surface(self, maps: Mapping[str, acquisition.MapRows]) -> None:
        self.panels += surface_panels(maps["height"], *self._scale(), self._crop())
