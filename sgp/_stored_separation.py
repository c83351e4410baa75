"""Shape and detail in memory, or in files if they need more memory than there is."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import Literal

import processing
from sgp._console import Stages
from sgp._map_doubts import read_map, with_doubts
from sgp._memory_limit import Limit, Need, identity, stored
from sgp._stage_options import SeparationOptions

Green = Literal["up", "down"]
Separated = processing.Separation | processing.StoredSeparation


@contextmanager
def separation_within(
    limit: Limit, normals: Path, options: SeparationOptions, *, green: Green, max_pixels: int
) -> Iterator[tuple[Separated, processing.NormalMapFile | processing.StoredSeparation]]:
    """Provide shape and detail of a normal map, computed with a limited memory, and its file.

    Parameters
    ----------
    limit
        Memory to use, and where maps that do not fit are.
    normals, options, green, max_pixels
        The map, the filter, and how the map is read.

    Raises
    ------
    UsageError
        If the memory is too small, or there are unfinished maps of another command.
    """
    found = processing.find_normals(normals, max_pixels=max_pixels)
    shape_filter = options.shape_filter()
    need = separation_need(found.size, shape_filter)
    if not limit.must_be_stored(need):
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
            limit.path,
            memory=limit.bytes_of_bands(need),
            identity=depends_on,
            replace=limit.force,
            shape_filter=shape_filter,
            green=green,
            max_pixels=max_pixels,
            on_progress=progress,
        )
    ) as made:
        warnings = with_doubts(made.warnings, normals, made.normals, made.mask, green)
        yield made, replace(made, warnings=warnings)


def separation_need(size: tuple[int, int], shape_filter: processing.ShapeFilter) -> Need:
    """Return the memory that the separation of a map needs."""
    return Need(
        processing.memory_of_separation(size, shape_filter),
        processing.least_memory_of_separation(size, shape_filter),
        f"a normal map of {size[1]} x {size[0]} pixels",
    )
