"""Shape and detail in memory, or in files if they need more memory than there is."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import Literal

import processing
from sgp._console import Stages
from sgp._map_doubts import axes_doubts, read_map
from sgp._memory_limit import Need, bytes_of_bands, identity, must_be_stored, stored
from sgp._stage_options import SeparationOptions

Green = Literal["up", "down"]
Separated = processing.Separation | processing.StoredSeparation


@contextmanager
def separation_within(
    memory: int | None,
    normals: Path,
    options: SeparationOptions,
    *,
    green: Green,
    max_pixels: int,
    out: Path,
    force: bool,
) -> Iterator[tuple[Separated, processing.NormalMapFile | processing.StoredSeparation]]:
    """Provide shape and detail of a normal map, computed with a limited memory, and its file.

    Parameters
    ----------
    memory
        Bytes to use; None for half of what is free.
    normals, options, green, max_pixels
        The map, the filter, and how the map is read.
    out
        Future result. Maps that do not fit into memory are in a hidden folder there until the block
        ends without an error; another call continues them.
    force
        Whether unfinished maps of other inputs or options are removed.

    Raises
    ------
    UsageError
        If the memory is too small, or there are unfinished maps of another command.
    """
    found = processing.find_normals(normals, max_pixels=max_pixels)
    shape_filter, path = options.shape_filter(), out / "detail"
    need = separation_need(found.size, shape_filter)
    if not must_be_stored(memory, need, path):
        read = read_map(normals, green=green, max_pixels=max_pixels)
        with Stages() as progress:
            parts = processing.separate(
                read.normal_map, shape_filter=shape_filter, on_progress=progress
            )
        # Frees the memory of the map.
        yield parts, read._replace(normal_map=parts.shape)
        return
    depends_on = identity({**asdict(options), "green": green}, list(found.files))
    with stored(
        lambda progress: processing.separate_on_disk(
            normals,
            path,
            memory=bytes_of_bands(memory, need),
            identity=depends_on,
            replace=force,
            shape_filter=shape_filter,
            green=green,
            max_pixels=max_pixels,
            on_progress=progress,
        )
    ) as made:
        doubts = axes_doubts(normals, made.normals, made.mask, green)
        yield made, replace(made, warnings=(*made.warnings, *doubts))


def separation_need(size: tuple[int, int], shape_filter: processing.ShapeFilter) -> Need:
    """Return the memory that the separation of a map needs."""
    return Need(
        processing.memory_of_separation(size, shape_filter),
        processing.least_memory_of_separation(size, shape_filter),
        f"a normal map of {size[1]} x {size[0]} pixels",
    )
