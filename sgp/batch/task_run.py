"""Run one task, in whichever process it arrived."""

from __future__ import annotations

import os
import time
from collections import ChainMap, Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import chdir, contextmanager, redirect_stderr, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from cyclopts import App, CycloptsError, Parameter

import acquisition
import rig
from sgp.batch.files import Stamp, stamps
from sgp.batch.task import Outcome, Stage, Task
from sgp.cli.exit import FAULT, error_text, exit_code
from sgp.cli.help import usage_complaint
from sgp.cli.options import paths_of, require_inputs, transfer_files
from sgp.cli.places import regions
from sgp.cli.threads import opencv_threads
from sgp.results import Result, flat_parameters, input_hashes, output_files, own_files_named

# Exit code of errors that may pass: a full disk, a network drive that does not answer.
_MAY_PASS = 3
_PAUSE_S = 2.0
_THUMBNAIL_PX = 192
_PICTURES = ("normals.normals_png", "normals_png", "normals.png")


def bound_arguments(stage: Stage) -> Any:
    """Return the arguments of a stage as its command line says.

    Raises
    ------
    CycloptsError
        If an option does not exist, is missing or has a wrong value.
    """
    app = App(name=stage.name, default_parameter=Parameter(negative=()))
    app.default(stage.command)
    _, bound, _ = app.parse_args(list(stage.words), exit_on_error=False, print_error=False)
    bound.apply_defaults()
    return bound


def perform(task: Task) -> Outcome:
    """Run a task; errors become its outcome, and messages go to its log."""
    began_s, cpu_s = time.monotonic(), time.process_time()
    attempt = 1
    while True:
        outcome = _attempt(task)
        if outcome.exit_code != _MAY_PASS or attempt >= task.attempts:
            break
        attempt += 1
        time.sleep(_PAUSE_S)
    return replace(
        outcome,
        attempts=attempt,
        seconds=round(time.monotonic() - began_s, 3),
        cpu_seconds=round(time.process_time() - cpu_s, 3),
    )


def _attempt(task: Task) -> Outcome:
    roots: dict[str, None] = {str(task.source): None}
    before: dict[str, Stamp] = {}
    try:
        acquisition.make_folder(task.log.parent)
        with _claimed(task.log), chdir(task.folder), _threads(task.threads):
            return _stages(task, roots, before)
    except CycloptsError as error:
        return Outcome(usage_complaint(error, "sgp batch"), 2)
    except _TakenOver as error:
        return Outcome(str(error), FAULT)
    except MemoryError as error:
        text = "needs more memory than this process may have"
        return Outcome(
            " ".join(f"{text}: {error}".split()), FAULT, roots=tuple(roots), files=before
        )
    except Exception as error:  # noqa: BLE001 - one source must not stop the others
        text = "; ".join([error_text(error), *getattr(error, "__notes__", ())])
        return Outcome(" ".join(text.split()), exit_code(error), roots=tuple(roots), files=before)


def _stages(task: Task, roots: dict[str, None], before: dict[str, Stamp]) -> Outcome:
    results: list[Result] = []
    hashes: dict[str, str] = {}
    records: list[Path] = []
    for stage in task.stages:
        bound = bound_arguments(stage)
        require_inputs(stage.command, bound.arguments)
        for root in _inputs(bound.arguments):
            if not root.absolute().is_relative_to(task.out):
                roots[str(root.absolute())] = None
        before |= {path: stamp for path, stamp in stamps(roots).items() if path not in before}
        with own_files_named():
            results.append(stage.command(*bound.args, **bound.kwargs))
            if not (results[-1].ok or stage.judges):
                why = results[-1].conclusion or results[-1].summary
                verdict = _verdict(results)
                return Outcome("; ".join(why), results[-1].failing_code, verdict=verdict)
            used = input_hashes(results[-1].inputs)
        if stage.judges:
            records.append(bound.arguments["out"] / "roughness.json")
        hashes |= {str(Path(name).absolute()): digest for name, digest in used.items()}
    paths = [path for result in results for path in result.outputs.values()]
    paths += records
    _write_thumbnail(dict(ChainMap(*(result.outputs for result in results))), task.thumbnail)
    notices = Counter[str](notice.severity for result in results for notice in result.warnings)
    return Outcome(
        roots=tuple(roots),
        files={path: stamp._replace(sha256=hashes.get(path, "")) for path, stamp in before.items()},
        outputs=tuple(str(path.absolute()) for path in dict.fromkeys(paths)),
        sizes={str(path.absolute()): path.stat().st_size for path in output_files(paths)},
        notices=dict(notices),
        figures={name: value for one in results for name, value in _figures(one.metrics).items()},
        verdict=_verdict(results),
    )


def _verdict(results: Sequence[Result]) -> str:
    """Return the verdict of the one result that has one."""
    return next((one.verdict.answer for one in results if one.verdict is not None), "")


def _inputs(arguments: Mapping[str, Any]) -> list[Path]:
    """Return the paths among the arguments of a command except that of its result."""
    flat = flat_parameters({name: value for name, value in arguments.items() if name != "out"})
    masks = (one.mask for one in regions(flat.get("region", ())))
    named = [*transfer_files(flat.get("gamma", "auto")), *masks]
    return paths_of([*flat.values(), *named])


def _figures(metrics: Mapping[str, Any]) -> dict[str, int | float | None]:
    """Return the figures of the normals for the table."""
    normals = metrics.get("normals", metrics)
    names = ("pixels", "images", "normal_sigma_deg", "residual_relative", "mae_deg")
    return {name: normals[name] for name in names if isinstance(normals.get(name), (int, float))}


class _TakenOver(rig.SgpError):
    """Another worker has begun the task since."""


@contextmanager
def _claimed(path: Path) -> Iterator[None]:
    """Write messages to a new log; as long as it has its name, the task is this worker's.

    A cluster gives the task of a worker that does not answer to another one. If the first was only
    suspended, it may wake up after the other one has finished, and must not replace its result.
    """
    path.unlink(missing_ok=True)
    with path.open("x", encoding="utf-8", errors="backslashreplace") as log:

        def check() -> None:
            with suppress(OSError), path.open("rb") as now:  # opened: a network file system
                if os.path.samestat(os.fstat(now.fileno()), os.fstat(log.fileno())):
                    return
            raise _TakenOver("another worker has begun this recording again: this one ends")

        with redirect_stderr(log), acquisition.files.publishing_if(check):
            yield


@contextmanager
def _threads(count: int) -> Iterator[None]:
    import numba

    before = numba.get_num_threads()
    numba.set_num_threads(min(count, before))
    try:
        with opencv_threads(count):
            yield
    finally:
        numba.set_num_threads(before)


def _write_thumbnail(outputs: Mapping[str, Path], path: Path) -> None:
    """Write a small picture of the normals, if the result has one."""
    import cv2

    source = next((outputs[name] for name in _PICTURES if name in outputs), None)
    if source is None:
        return
    values = acquisition.read_image(source)
    if values.dtype == np.uint16:
        values = np.right_shift(values, 8).astype(np.uint8)
    scale = _THUMBNAIL_PX / max(values.shape[:2])
    small = cv2.resize(values, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    acquisition.make_folder(path.parent)
    acquisition.write_png(path, np.asarray(small, np.uint8))
