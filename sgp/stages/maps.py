"""Maps of a stage, computed from normal maps in files within a limit of memory."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import acquisition
import processing
import rig
from sgp.cli.console import Stages, with_progress
from sgp.cli.options import Green
from sgp.results import input_hashes
from sgp.stages.given_normals import with_remedy
from sgp.stages.memory_limit import Limit, identity, other_maps_refused

Computed = acquisition.files.MemoryMaps | acquisition.files.BandStore


@dataclass(frozen=True)
class MapInput:
    """A normal map that a command reads.

    Parameters
    ----------
    path
        Image of normals, or folder with normals.* and mask.png, such as a result.
    green
        Direction of the green channel.
    option
        The option that states it, None if the command has none.
    max_pixels
        Largest allowed number of pixels.
    """

    path: Path
    green: Green = "up"
    option: str | None = "--green"
    max_pixels: int = rig.MAX_PIXELS

    def find(self) -> processing.maps.FoundNormals:
        """Return size and files of the map."""
        return processing.find_normals(self.path, max_pixels=self.max_pixels)

    def read(self) -> processing.NormalMapFile:
        """Read the map; its notices name it if it is a surface only with other axes."""
        read = processing.read_normals(self.path, green=self.green, max_pixels=self.max_pixels)
        input_hashes(read.files)
        return read._replace(warnings=self._with_doubts(read.warnings, read.normal_map))

    def store(self, file: Path) -> processing.maps.StoredNormals:
        """Read the map into a file of rows."""
        found = processing.maps.store_normals(
            self.path, file, green=self.green, max_pixels=self.max_pixels
        )
        return found._replace(warnings=self._with_doubts(found.warnings, found))

    def _with_doubts(
        self, notices: tuple[rig.Notice, ...], rows: processing.stages.NormalRows
    ) -> tuple[rig.Notice, ...]:
        """Return the notices of a reader with those about the axes, unless it named these."""
        if any(notice.code == "normals-channels-swapped" for notice in notices):
            return notices
        doubts = processing.surface.axes_notices(rows)
        named = (with_remedy(doubt, self.green, self.option) for doubt in doubts)
        return (*notices, *(replace(one, where=str(self.path)) for one in named))


@dataclass(frozen=True, eq=False)
class StageMaps:
    """The maps of a stage, in memory or in files.

    Parameters
    ----------
    maps
        The maps.
    inputs
        The normal maps that were given.
    warnings, files
        Those of the readers.
    """

    maps: Computed
    inputs: tuple[processing.stages.NormalRows, ...]
    warnings: tuple[rig.Notice, ...]
    files: tuple[Path, ...]


@contextmanager
def stage_maps(
    stage: processing.stages.Stage,
    inputs: Sequence[MapInput],
    limit: Limit,
    *,
    files: Sequence[Path] = (),
    read: Sequence[processing.NormalMapFile] | None = None,
) -> Iterator[StageMaps]:
    """Provide the maps of a stage, which are computed here.

    Parameters
    ----------
    stage
        The stage with its options.
    inputs
        The normal maps.
    limit
        Memory to use, and where maps that do not fit are.
    files
        Further files on which the maps depend.
    read
        The normal maps if the command needs them in memory.

    Raises
    ------
    UsageError
        If the memory is too small, or there are unfinished maps of another command.
    """
    found = [given.find() for given in inputs]
    sizes = [one.size for one in found]
    if read is not None or not limit.must_be_stored(stage.need(*sizes)):
        whole = [given.read() for given in inputs] if read is None else read
        maps = [one.normal_map for one in whole]
        notices, used = _of_all(whole)
        made = with_progress(processing.stages.computed)(stage, *maps)
        yield StageMaps(made, tuple(maps), notices, used)
        return
    greens = {str(one.option).strip("-").replace("-", "_"): one.green for one in inputs}
    depends_on = identity(
        {**options_of(stage), **greens}, [*(path for one in found for path in one.files), *files]
    )
    rows: list[processing.maps.StoredNormals] = []

    def stored(store: acquisition.files.BandStore) -> list[processing.maps.StoredNormals]:
        for number, given in enumerate(inputs):
            rows.append(given.store(store.folder / f"input-{number}.raw"))
            store.close_with(rows[-1].normals)
        return rows

    with maps_in_files(stage, sizes, limit, depends_on, stored) as store:
        yield StageMaps(store, tuple(rows), *_of_all(rows))


@contextmanager
def maps_in_files(
    stage: processing.stages.Stage,
    sizes: Sequence[processing.stages.Size],
    limit: Limit,
    depends_on: Mapping[str, object],
    inputs: Callable[[acquisition.files.BandStore], Sequence[processing.stages.NormalRows]],
) -> Iterator[acquisition.files.BandStore]:
    """Provide the maps of a stage in files, which are removed if the block ends well.

    After an error, the same command continues with them.

    Parameters
    ----------
    stage, limit
        As for `stage_maps`.
    sizes
        (height, width) of the inputs.
    depends_on
        What the maps depend on.
    inputs
        Provides the inputs, perhaps in files next to the maps.
    """
    need = stage.need(*sizes)
    with ExitStack() as opened:
        with other_maps_refused(), Stages() as progress:
            progress(stage.name, 0, 1)
            store = opened.enter_context(
                acquisition.files.BandStore(
                    limit.path, depends_on, stage.forms(*sizes), replace=limit.force
                )
            )
            with store.filling():
                steps = stage.steps(store, *inputs(store), memory=limit.bytes_of_bands(need))
                processing.stages.run_steps(stage.name, steps, store, progress)
        yield store
        store.remove()


def _of_all(
    read: Sequence[processing.NormalMapFile | processing.maps.StoredNormals],
) -> tuple[tuple[rig.Notice, ...], tuple[Path, ...]]:
    """Return all notices and all files."""
    notices = tuple(notice for one in read for notice in one.warnings)
    files = tuple(path for one in read for path in one.files)
    return notices, files


def options_of(stage: Any) -> Mapping[str, object]:
    """Return the options of a stage by name, also those of the values that it consists of."""
    flat: dict[str, object] = {}
    for one in fields(stage):
        value = getattr(stage, one.name)
        if one.repr:  # the content of the others is that of files
            flat |= options_of(value) if is_dataclass(value) else {one.name: value}
    return flat
