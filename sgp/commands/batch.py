"""``sgp batch``: process many recordings with the same options."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Mapping
from contextlib import AbstractContextManager, chdir, nullcontext
from pathlib import Path
from typing import Annotated, Any

from cyclopts import CycloptsError, Parameter
from cyclopts.validators import Number

import acquisition
import rig as rigs
from processing.roughness import read_limits
from sgp.batch import (
    ROUGHNESS,
    BatchProgress,
    LocalWorkers,
    Outcome,
    Part,
    Recipe,
    Stage,
    State,
    States,
    Task,
    Workers,
    batch_folder,
    bound_arguments,
    check_scheduler,
    control_charts,
    csv_table,
    html_table,
    is_placed,
    names_of,
    option_words,
    other_results,
    placed,
    places_of,
    read_parts,
    read_recipe,
    reason_to_run,
    roughness_table,
    state_of,
)
from sgp.batch.cluster import cluster
from sgp.cli.console import note
from sgp.cli.exit import UNUSABLE, ClusterError, UsageError, exit_code
from sgp.cli.help import usage_complaint
from sgp.cli.options import Inputs, Memory, OptionalInput, Whole, inputs_of
from sgp.cli.places import lines, regions
from sgp.commands.calibrate import spheres
from sgp.commands.report import report
from sgp.commands.roughness import roughness
from sgp.commands.run import run
from sgp.pictures import write_overview
from sgp.results import LABELS, BatchMetrics, Result, check_output, input_hashes, write_record
from sgp.stages import size_text

_LEAST_MEMORY = 2**29
_CHARTS = "Control charts"
_Workers = Annotated[Whole, Parameter(validator=Number(gte=1, lte=256))]
_Retries = Annotated[Whole, Parameter(validator=Number(gte=0, lte=100))]


def batch(
    source: Inputs,
    *,
    out: Path,
    recipe: OptionalInput = None,
    workers: _Workers | None = None,
    memory: Memory | None = None,
    scheduler: str | None = None,
    retries: _Retries = 1,
) -> Result:
    """Process many recordings with the same options; run it again to do what is missing.

    Each source gets a folder in --out with the files of `sgp run`. A source is computed again only
    if its files, the options or the version of sgp have changed, if files of its result are
    missing, or if it failed. A source that fails does not stop the others; the exit code is then 4.
    The tables are batch.csv and index.html.

    A recipe is a TOML file. Its table [run] has options of `sgp run` by their long names. If each
    source has its own recording of spheres, the table [calibrate] has recordings, and options of
    `sgp calibrate spheres`. With a table [roughness], options of `sgp roughness`, the folder
    roughness has a result for each source, roughness.csv the table of all, and roughness.png
    control charts; the exit code is 6 if a limit is exceeded and no source failed. With a table
    [report], the page of `sgp run` is written again with options of `sgp report`. Paths are
    relative to the recipe; {source}, {name} and {parent} stand for the path of the source, its name
    and the folder that contains it.

    For example:

        sgp batch recordings/* --out results
        sgp batch recordings/* --out results --recipe recipe.toml --workers 2
        sgp batch recordings/* --out results --scheduler tcp://10.0.0.5:8786

    Parameters
    ----------
    source
        Sessions, DiLiGenT object folders, or folders of images.
    out
        Folder of the batch: a new one, or that of an earlier batch.
    recipe
        Recipe (.toml); default: the options that `sgp run` has by default.
    workers
        Number of processes on this computer; default: one for each core.
    memory
        Most memory of each of these processes, for example 4G, with which a source that needs more
        fails; default: no limit.
    scheduler
        Address of a Dask scheduler, whose workers do the work; they need the same paths and the
        same version of sgp.
    retries
        How often a source is tried again after an error of disk or network, or the end of its
        process.
    """
    parameters = {name: value for name, value in locals().items() if name != "out"}
    if scheduler is not None and workers is not None:
        raise UsageError("--workers is for this computer and --scheduler for a cluster: give one")
    if scheduler is not None and memory is not None:
        text = "--memory is for this computer: start the workers of the cluster with --memory-limit"
        raise UsageError(text)
    if memory is not None and memory < _LEAST_MEMORY:
        given, least = size_text(memory), size_text(_LEAST_MEMORY)
        raise UsageError(
            f"--memory {given} is too small for the libraries alone: give at least --memory {least}"
        )
    if not source:
        raise UsageError("no source is given: name at least one recording")
    if scheduler is not None:
        check_scheduler(scheduler)
    chosen = Recipe() if recipe is None else read_recipe(recipe)
    input_hashes([] if recipe is None else [recipe])  # a batch takes long
    check_output(out, [*source, recipe], force=True)
    _check_options(chosen, recipe, source[0])
    with batch_folder(out) as states:
        known = states.read_all()
        named = names_of(source, {name: state.source for name, state in known.items()})
        threads = 1 if scheduler or workers is None else max(1, _cores() // workers)
        tasks = [
            _task(name, place, chosen, out.absolute(), threads=threads, attempts=retries + 1)
            for name, place in named.items()
        ]
        due = _due(tasks, states, known)
        lost: ClusterError | None = None
        try:
            with _pool(scheduler, workers, memory, states.folder) as pool:
                _work(pool, due, states, known)
        except ClusterError as error:
            if not all(task.name in known for task in tasks):  # no work had begun
                raise
            lost = error
        shown = {task.name: known[task.name] for task in tasks}
        parts = None if chosen.roughness is None else _parts(out, shown)
        result = _written(out, shown, parts, recipe, len(due), len(known) - len(shown))
        write_record(out / "batch.json", "sgp batch", parameters, result)
        result.outputs["record"] = out / "batch.json"
        if lost is not None:
            raise lost
    return result


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _pool(
    scheduler: str | None, workers: int | None, memory: int | None, folder: Path
) -> AbstractContextManager[Workers]:
    if scheduler is None:
        return nullcontext(LocalWorkers(workers or _cores(), memory))
    return cluster(scheduler, folder.absolute())


def _task(
    name: str, source: Path, recipe: Recipe, out: Path, *, threads: int, attempts: int
) -> Task:
    """Return the task for one source."""
    target = out / name
    stages = _stages(recipe, str(source), target, places_of(source))
    return Task(
        name=name,
        source=source,
        stages=stages,
        out=target,
        folder=recipe.folder,
        log=out / "state" / f"{name}.log",
        thumbnail=out / "thumbnails" / f"{name}.png",
        threads=threads,
        attempts=attempts,
    )


def _stages(
    recipe: Recipe, source: str, target: Path, places: Mapping[str, str]
) -> tuple[Stage, ...]:
    """Return the command lines for one source."""
    stages = []
    words = [source, f"--out={target}", "--force", *option_words(recipe.run, places)]
    if recipe.calibrate is not None:
        lights = target / "calibration" / "lights.json"
        options = dict(recipe.calibrate)
        listed = options.pop("recordings")
        recordings = listed if isinstance(listed, list) else [listed]
        paths = [placed(one, places) for one in recordings]
        given = [f"--out={lights}", "--force", *option_words(options, places)]
        stages.append(Stage("sgp calibrate spheres", spheres, (*paths, *given)))
        words.append(f"--lights={lights}")
    stages.append(Stage("sgp run", run, tuple(words)))
    if recipe.roughness is not None:
        given = [str(target), f"--out={target.parent / ROUGHNESS / target.name}", "--force"]
        given += option_words(recipe.roughness, places)
        stages.append(Stage("sgp roughness", roughness, tuple(given), judges=True))
    if recipe.report is not None:
        page = [str(target), f"--out={target / 'report.html'}", "--force"]
        page += option_words(recipe.report, places)
        stages.append(Stage("sgp report", report, tuple(page)))
    return tuple(stages)


def _check_options(recipe: Recipe, path: Path | None, first: Path) -> None:
    """Refuse a recipe whose options are wrong, or whose files do not exist, before any work.

    Files with ``{name}`` and so on are those of one source, which fails alone.
    """
    where = path or "the options"
    with chdir(recipe.folder):
        for stage in _stages(recipe, str(first), Path(first.name), places_of(first)):
            try:
                bound_arguments(stage)
            except CycloptsError as error:
                raise UsageError(f"{where}: {usage_complaint(error, stage.name)}") from error
        for stage in _stages(recipe, "{source}", Path("{name}"), {}):
            try:
                bound = bound_arguments(stage)
            except CycloptsError:  # an option that is valid with the words of a source only
                continue
            if stage.command is roughness:
                _check_places(where, bound.arguments)
            for file in inputs_of(stage.command, bound.arguments):
                if not is_placed(str(file)) and not file.exists():
                    text = f"{where}: {acquisition.missing_path(file)}"
                    raise UsageError(f"{text}; its paths are relative to {recipe.folder}")


def _check_places(where: object, arguments: Mapping[str, Any]) -> None:
    """Refuse areas, lines and limits that no source can have."""
    named = {
        name: [one for one in arguments[name] if not is_placed(one)]
        for name in ("region", "line", "step")
    }
    limits = arguments["limits"]
    try:
        regions(named["region"])
        for name in ("line", "step"):
            lines(named[name], f"--{name}")
        if limits is not None and not is_placed(str(limits)) and limits.exists():
            read_limits(limits)
    except (UsageError, acquisition.DataError) as error:
        raise UsageError(f"{where}: [roughness] {error}") from error


def _due(tasks: list[Task], states: States, known: dict[str, State]) -> list[Task]:
    """Return the tasks that have to run, and report why those that have a result do.

    Sources whose names cannot be those of files fail here, before the work.
    """
    due, failed = [], 0
    for task in tasks:
        why = reason_to_run(task, known)
        if why is None:
            states.confirm(task.name, known[task.name])
        elif (refused := states.unusable(task.name)) is not None:
            error = f"{refused}: rename the recording ({len(os.fsencode(task.name))} bytes)"
            known[task.name] = state_of(task, Outcome(error, exit_code=4))
            note(f"{task.name}: FAILED: {error}")
            failed += 1
        else:
            due.append(task)
        if why not in (None, "new"):
            note(f"{task.name}: computed again: {why}")
    done = len(tasks) - len(due) - failed
    if done:
        note(f"{rigs.pluralize(done, 'result is', 'results are')} up to date")
    return due


def _work(pool: Workers, due: list[Task], states: States, known: dict[str, State]) -> None:
    before = dict(known)

    def started(task: Task) -> None:
        if task.name in before:
            states.begin(task, before[task.name])
        progress.started(task)

    with BatchProgress(len(due), pool.count) as progress:
        left = {task.name: task for task in due}
        try:
            for task, outcome in pool.outcomes(due, started):
                known[task.name] = states.write(left.pop(task.name), outcome)
                progress.ended(task, outcome)
        except ClusterError as error:
            for task in left.values():
                known[task.name] = states.write(task, Outcome(str(error), exit_code(error)))
            raise


def _parts(out: Path, states: Mapping[str, State]) -> list[Part]:
    return read_parts(out, [name for name, state in states.items() if state.error is None])


def _written(
    out: Path,
    states: Mapping[str, State],
    parts: list[Part] | None,
    recipe: Path | None,
    computed: int,
    others: int,
) -> Result:
    """Write the tables, and those of roughness if it was measured."""
    failed = {name: state for name, state in states.items() if state.error is not None}
    done = len(states) - len(failed)
    outputs = {"table": out / "batch.csv", "page": out / "index.html"}
    acquisition.write_durably(outputs["table"], csv_table(states).encode(errors="backslashreplace"))
    exceeded = [part.name for part in parts or () if part.has("exceeded")]
    limits = None
    table, charts = out / "roughness.csv", out / "roughness.png"
    for earlier in (table, charts):
        earlier.unlink(missing_ok=True)
    if parts:
        limits = f"roughness of {rigs.pluralize(len(parts), 'part')}"
        if any("limits" in part.record.metrics for part in parts):
            undecided = sum(part.has("undecided") for part in parts)
            names = f" ({rigs.listed(exceeded)})" if exceeded else ""
            limits += f": {len(exceeded)} beyond a limit{names}, {undecided} undecided"
        outputs |= {"roughness": table}
        content = roughness_table(parts).encode(errors="backslashreplace")
        acquisition.write_durably(table, content)
        if panels := control_charts(parts):
            outputs |= {"control_charts": charts}
            write_overview(charts, _CHARTS, panels)
    page = html_table(out, states, others, limits)
    acquisition.write_durably(outputs["page"], page.encode(errors="backslashreplace"))
    summary = [
        f"{name}: {state.error} (log: {out / 'state' / name}.log)" for name, state in failed.items()
    ]
    counts = f"{done} of {rigs.pluralize(len(states), 'source')} done, {computed} computed now"
    if failed:
        counts += f", {len(failed)} failed: run the command again to try them again"
    found = Counter(state.verdict for state in states.values())
    answers = ", ".join(f"{found[name]} {word}" for name, word in LABELS.items() if found[name])
    metrics = BatchMetrics(sources=len(states), done=done, failed=len(failed), computed=computed)
    if parts is not None:
        metrics["exceeded"] = len(exceeded)
    return Result(
        outputs=outputs,
        metrics=metrics,
        summary=[
            *summary,
            counts,
            *([f"verdicts: {answers}"] if answers else ()),
            *([limits] if limits else ()),
            *([other_results(others)] if others else ()),
            f"look at  {outputs['page']}",
        ],
        inputs=[] if recipe is None else [recipe],
        ok=not failed and not exceeded,
        failing_code=4 if failed else UNUSABLE,
    )
