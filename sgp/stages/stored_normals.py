"""Normals in memory, or in files if they need more memory than there is."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path

import acquisition
import processing
import rig
from sgp.cli.options import SourceOptions
from sgp.stages.memory_limit import identity, is_in_bands, needs_maps, other_maps_refused
from sgp.stages.recording import compute_normals


@contextmanager
def normals_within(
    memory: int | None,
    source: acquisition.Source,
    options: SourceOptions,
    pixel_mm: float | None,
    *,
    files: list[Path],
    out: Path,
    force: bool,
) -> Iterator[processing.Reconstruction]:
    """Provide the normals of a source, computed with a limited memory.

    Parameters
    ----------
    memory
        Bytes to use; None for half of what is free.
    source, options, pixel_mm
        As in `SourceOptions.stage`.
    files
        Input files, on which the result depends.
    out
        Future result. Maps that do not fit into memory are in a hidden folder there until the block
        ends without an error; another call continues them.
    force
        Whether unfinished maps of other inputs or options are removed.

    Raises
    ------
    UsageError
        If the memory is too small.
    """
    path, stage = out / "normals", options.stage(pixel_mm)

    def depends_on() -> dict[str, object]:
        given = {name: value for name, value in asdict(options).items() if not _is_file(value)}
        return identity({**given, "pixel_mm": pixel_mm}, files)

    if not are_normals_in_files(memory, source, stage):
        if not force and acquisition.files.is_unfinished(path):
            with other_maps_refused():
                acquisition.files.check_unfinished(path, depends_on())
        yield compute_normals(source, stage)
        acquisition.files.remove_unfinished(path)
        return
    limit = max(rig.processes.memory_budget(memory), stage.need(source).least)
    in_files = processing.recording.MapFiles(path, depends_on(), limit, force)
    with other_maps_refused():
        made = compute_normals(source, stage, in_files)
    if made.store is None:
        raise RuntimeError("maps in files have a store")
    with made.store:
        yield made
        made.store.remove()


def are_normals_in_files(
    memory: int | None, source: acquisition.Source, stage: processing.recording.NormalsStage
) -> bool:
    """Return whether the maps do not fit into memory.

    Raises
    ------
    UsageError
        If the memory is too small.
    """
    need = stage.need(source)
    if not stage.needs_whole(source):
        return is_in_bands(memory, need)
    if memory is not None and need.whole > rig.processes.memory_budget(memory):
        option = "--semi-calibrated" if stage.semi_calibrated else f"--channel {stage.channel}"
        remedy = "give --channel gray" if stage.channel == "auto" else f"leave {option} out"
        raise needs_maps(memory, need, option, remedy)
    return False  # without a limit, perhaps there is enough


def _is_file(value: object) -> bool:
    # The contents of files are in the hashes of the inputs.
    return isinstance(value, Path)
