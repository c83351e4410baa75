"""Transfers of detail in memory, or in files if they need more memory than there is."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Literal, NamedTuple, TypedDict

import processing
import rig
from sgp._console import Stages
from sgp._map_doubts import read_map, with_doubts
from sgp._memory_limit import Limit, identity, stored
from sgp._write_transfer import Transferred

Green = Literal["up", "down"]
Maps = tuple[processing.NormalMapFile, processing.NormalMapFile]


class TransferOptions(TypedDict):
    """Arguments that `processing.transfer` and `processing.transfer_on_disk` have in common."""

    keep_target_detail: bool
    amplitude: float
    refine: int
    shape_filter: processing.ShapeFilter
    at: tuple[int, int] | None
    tile: processing.Tile


class TransferMaps(NamedTuple):
    """The maps of a transfer, and how they are read."""

    source: Path
    target: Path
    source_green: Green
    target_green: Green
    max_pixels: int

    def read(self) -> Maps:
        """Read source and target."""
        source, target = (
            read_map(path, green=green, option=option, max_pixels=self.max_pixels)
            for path, green, option in self._given()
        )
        return source, target

    def need(self, shape_filter: processing.ShapeFilter) -> tuple[processing.Need, list[Path]]:
        """Return the memory that a transfer needs, and the files of the maps."""
        source, target = (
            processing.find_normals(path, max_pixels=self.max_pixels)
            for path in (self.source, self.target)
        )
        sizes = source.size, target.size
        texts = (f"{width} x {height}" for height, width in sizes)
        need = processing.Need(
            processing.memory_of_transfer(*sizes, shape_filter),
            processing.least_memory_of_transfer(*sizes, shape_filter),
            f"normal maps of {' and '.join(texts)} pixels",
        )
        return need, [*source.files, *target.files]

    def notices(self, maps: tuple[processing.StoredNormals, ...]) -> tuple[rig.Notice, ...]:
        """Return the notices about maps in files, as `read` gives those about maps in memory."""
        found: list[rig.Notice] = []
        for read, (path, green, option) in zip(maps, self._given(), strict=True):
            found += with_doubts(read.warnings, path, read.normals, read.mask, green, option)
        return tuple(found)

    def _given(self) -> list[tuple[Path, Green, str]]:
        return [
            (self.source, self.source_green, "--source-green"),
            (self.target, self.target_green, "--target-green"),
        ]


@contextmanager
def transferred_within(
    limit: Limit, maps: TransferMaps, options: TransferOptions, read: Maps | None
) -> Iterator[Transferred]:
    """Provide a transfer of detail, computed with a limited memory.

    Parameters
    ----------
    limit
        Memory to use, and where maps that do not fit are.
    maps, options
        The maps, and how the detail is transferred.
    read
        The maps if the command has to keep them in memory; None to decide by the limit.

    Raises
    ------
    UsageError
        If the memory is too small, or there are unfinished maps of another command.
    """
    need, files = maps.need(options["shape_filter"])
    if read is not None or not limit.must_be_stored(need):
        source, target = read or maps.read()
        with Stages() as progress:
            done = processing.transfer(
                source.normal_map, target.normal_map, **options, on_progress=progress
            )
        with Stages() as progress:
            yield Transferred.in_memory(done, source, target, progress)
        return
    by, given = options["shape_filter"], dict(options)
    del given["shape_filter"]
    given |= {"filter": by.kind, "order": by.order, "w": by.w}
    given |= {"source_green": maps.source_green, "target_green": maps.target_green}
    depends_on = identity(given, files)
    with stored(
        lambda progress: processing.transfer_on_disk(
            maps.source,
            maps.target,
            limit.path,
            memory=limit.bytes_of_bands(need),
            identity=depends_on,
            replace=limit.force,
            source_green=maps.source_green,
            target_green=maps.target_green,
            max_pixels=maps.max_pixels,
            on_progress=progress,
            **options,
        )
    ) as made:
        yield Transferred(
            made.normals,
            made.target.mask,
            made.shape_error_deg,
            made.detail_error_deg,
            made.figures,
            made.placement,
            maps.notices((made.source, made.target)),
            (*made.source.files, *made.target.files),
        )
