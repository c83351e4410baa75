"""Normals in memory, or in files if they need more memory than there is."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path

import acquisition
import processing
import rig
from sgp._exit import UsageError
from sgp._memory_limit import identity, other_maps_refused, size_text, stored, too_small
from sgp._options import SourceOptions
from sgp._stages import compute_normals, with_answers
from sgp._uncertainty import Normals


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
) -> Iterator[Normals]:
    """Provide the normals of a source, computed with a limited memory.

    Parameters
    ----------
    memory
        Bytes to use; None for half of what is free.
    source, options, pixel_mm
        As in `compute_normals`.
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
    path = out / "normals"

    def depends_on() -> dict[str, object]:
        given = {name: value for name, value in asdict(options).items() if not _is_file(value)}
        return identity({**given, "pixel_mm": pixel_mm}, files)

    if not are_normals_on_disk(memory, source, options):
        if not force and acquisition.is_unfinished(path):
            with other_maps_refused():
                acquisition.check_unfinished(path, depends_on())
        yield compute_normals(source, options, pixel_mm)
        acquisition.remove_unfinished(path)
        return
    with stored(
        lambda progress: processing.reconstruct_on_disk(
            source,
            path,
            memory=max(rig.memory_budget(memory), processing.least_memory(source)),
            identity=depends_on(),
            replace=force,
            method=options.method,
            distant=options.distant,
            height_mm=options.height_mm,
            rests_on_plane=options.rests_on_plane,
            pixel_mm=pixel_mm,
            exclude_disagreeing=options.exclude_disagreeing,
            on_progress=progress,
        )
    ) as stage:
        yield replace(stage, warnings=with_answers(stage.warnings, source))


def are_normals_on_disk(
    memory: int | None, source: acquisition.Source, options: SourceOptions
) -> bool:
    """Return whether the maps do not fit into memory.

    Raises
    ------
    UsageError
        If the memory is too small.
    """
    in_colour = options.channel in ("rgb", "joint")
    whole = processing.memory_of_reconstruction(source, 3 if in_colour else 1)
    if whole <= rig.memory_budget(memory):
        return False
    height, width = source.size
    images = f"{rig.pluralize(len(source.light_ids), 'image')} of {width} x {height} pixels"
    if options.channel != "gray" or options.semi_calibrated:
        if memory is None:
            return False  # perhaps there is enough
        option = "--semi-calibrated" if options.semi_calibrated else f"--channel {options.channel}"
        raise UsageError(
            f"--memory {size_text(memory)} is too small for {images} with {option}, which needs "
            f"the complete maps: give --memory {size_text(whole)}, or leave {option} out"
        )
    least = processing.least_memory(source)
    if memory is not None and memory < least:
        raise too_small(memory, images, least)
    return True


def _is_file(value: object) -> bool:
    # The contents of files are in the hashes of the inputs.
    return isinstance(value, Path)
