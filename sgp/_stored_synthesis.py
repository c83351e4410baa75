"""Sheets of detail in memory, or in files if they need more memory than there is."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import NamedTuple, TypedDict

import processing
from sgp._console import Stages
from sgp._memory_limit import Limit, stored
from sgp._write_synthesis import Synthesised


class SheetOptions(TypedDict):
    """Arguments that a sheet in memory and one in files have in common."""

    patch: int
    overlap: int | None
    seed: int
    rotate: bool
    mirror: bool
    tileable: bool


class SheetSizes(NamedTuple):
    """What the memory of a synthesis depends on: (height, width), and how patches are placed."""

    exemplar: tuple[int, int]
    size: tuple[int, int]
    patch: int
    overlap: int | None
    copies: int

    def need(self, kind: str) -> processing.Need:
        """Return the memory that a synthesis needs; ``kind`` is a sheet or a target."""
        height, width = self.size
        return processing.Need(
            processing.memory_of_synthesis(self.exemplar, self.size, copies=self.copies),
            processing.least_memory_of_synthesis(
                self.exemplar,
                self.size,
                patch=self.patch,
                overlap=self.overlap,
                copies=self.copies,
            ),
            f"a {kind} of {width} x {height} pixels",
        )


@contextmanager
def sheet_within(
    limit: Limit,
    need: processing.Need,
    exemplar: processing.NormalMap,
    size: tuple[int, int],
    options: SheetOptions,
    depends_on: Mapping[str, object],
) -> Iterator[Synthesised]:
    """Provide a sheet of detail, synthesised with a limited memory.

    Parameters
    ----------
    limit, need
        Memory to use, where maps that do not fit are, and what the synthesis needs.
    exemplar, size, options
        As for `processing.synthesize`.
    depends_on
        What the sheet depends on.

    Raises
    ------
    UsageError
        If the memory is too small, or there are unfinished maps of another command.
    """
    if not limit.must_be_stored(need):
        with Stages() as progress:
            made = processing.synthesize(exemplar, size, **options, on_progress=progress)
        yield Synthesised.in_memory(made)
        return
    with stored(
        lambda progress: processing.synthesize_on_disk(
            exemplar,
            size,
            limit.path,
            identity=depends_on,
            replace=limit.force,
            on_progress=progress,
            **options,
        )
    ) as on_disk:
        yield Synthesised.on_disk(on_disk)
