"""Maps of a stage, computed from normal maps in files within a limit of memory."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import acquisition
import processing
import rig
from sgp._console import Stages
from sgp._map_doubts import read_map, with_doubts
from sgp._memory_limit import Limit, identity, other_maps_refused

Green = Literal["up", "down"]


@dataclass(frozen=True)
class MapInput:
    """A normal map that a command reads.

    Parameters
    ----------
    path
        Image of normals, or folder with normals.* and mask.png.
    green
        Direction of the green channel.
    option
        The option that states it.
    max_pixels
        Largest allowed number of pixels.
    """

    path: Path
    green: Green = "up"
    option: str = "--green"
    max_pixels: int = rig.MAX_PIXELS

    def find(self) -> processing.FoundNormals:
        """Return size and files of the map."""
        return processing.find_normals(self.path, max_pixels=self.max_pixels)

    def read(self) -> processing.NormalMapFile:
        """Read the map, with notices about its axes."""
        return read_map(
            self.path, green=self.green, option=self.option, max_pixels=self.max_pixels
        )

    def store(self, file: Path) -> processing.StoredNormals:
        """Read the map into a file of rows."""
        found = processing.store_normals(
            self.path, file, green=self.green, max_pixels=self.max_pixels
        )
        given = self.path, found.normals, found.mask, self.green, self.option
        return found._replace(warnings=with_doubts(found.warnings, *given))


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

    maps: acquisition.Maps
    inputs: tuple[processing.NormalRows, ...]
    warnings: tuple[rig.Notice, ...]
    files: tuple[Path, ...]


@contextmanager
def stage_maps(
    stage: processing.Stage,
    inputs: Sequence[MapInput],
    limit: Limit,
    *,
    files: Sequence[Path] = (),
    read: Sequence[processing.NormalMapFile] | None = None,
) -> Iterator[StageMaps]:
    """Provide the maps of a stage, which are computed here.

    Maps that do not fit into memory are in files, which are removed if the block ends well. After
    an error, the same command continues with them.

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
    need = stage.need(*sizes)
    if read is not None or not limit.must_be_stored(need):
        whole = [given.read() for given in inputs] if read is None else read
        maps = [one.normal_map for one in whole]
        notices, used = _of_all(whole)
        with Stages() as progress:
            made = processing.computed(stage, *maps, on_progress=progress)
        yield StageMaps(made, tuple(maps), notices, used)
        return
    greens = {given.option.strip("-").replace("-", "_"): given.green for given in inputs}
    depends_on = identity(
        {**options_of(stage), **greens}, [*(path for one in found for path in one.files), *files]
    )
    with ExitStack() as opened:
        with other_maps_refused(), Stages() as progress:
            store = opened.enter_context(
                acquisition.BandStore(
                    limit.path, depends_on, stage.forms(*sizes), replace=limit.force
                )
            )
            with store.filling():
                rows = [
                    given.store(store.folder / f"input-{number}.raw")
                    for number, given in enumerate(inputs)
                ]
                for one in rows:
                    store.close_with(one.normals)
                steps = stage.steps(store, *rows, memory=limit.bytes_of_bands(need))
                processing.run_steps(stage.name, steps, store, progress)
        yield StageMaps(store, tuple(rows), *_of_all(rows))
        store.remove()


def _of_all(
    read: Sequence[processing.NormalMapFile | processing.StoredNormals],
) -> tuple[tuple[rig.Notice, ...], tuple[Path, ...]]:
    """Return all notices and all files."""
    notices = tuple(notice for one in read for notice in one.warnings)
    files = tuple(path for one in read for path in one.files)
    return notices, files


def options_of(stage: Any) -> Mapping[str, object]:
    """Return the options of a stage by name, also those of the values that it consists of."""
    flat: dict[str, object] = {}
    for name, value in asdict(stage).items():
        flat |= value if isinstance(value, dict) else {name: value}
    return flat
