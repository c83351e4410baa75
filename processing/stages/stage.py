"""A stage of the processing, and the loop that runs every one of them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from acquisition import MapRows
from acquisition.files import Form, Maps, MemoryMaps
from rig import Progress, no_progress
from rig.arrays import Bool

Size = tuple[int, int]


@dataclass(frozen=True)
class Need:
    """The memory that a program needs for a stage.

    Parameters
    ----------
    whole
        Bytes if all maps are in memory.
    least
        Bytes in bands, at least.
    of
        What needs them, for messages: "a normal map of 48 x 40 pixels".
    """

    whole: int
    least: int
    of: str


@dataclass(frozen=True)
class Step:
    """A part of a stage, which begins when the parts before it are complete.

    Parameters
    ----------
    name
        Name in the journal, unique in the stage.
    units
        What is counted: rows of a map, or other parts that can be computed on their own.
    run
        Computes some units and writes them into the maps. It may read beyond them: maps of earlier
        steps are complete. If it takes long, it yields the share of the units that is done.
    most
        Units that are computed at once; None for all.
    weight
        How much a unit counts in the progress.
    """

    name: str
    units: int
    run: Callable[[slice], Iterable[float] | None]
    most: int | None = None
    weight: int = 1


class NormalRows(Protocol):
    """A normal map of which rows are read: a `NormalMap`, or a `StoredNormals` in a file."""

    @property
    def normals(self) -> MapRows:
        """``(H, W, 3)`` float32 unit vectors, 0 outside the mask."""

    @property
    def mask(self) -> Bool:
        """``(H, W)`` bool."""


class Stage(Protocol):
    """What is computed from normal maps: a frozen dataclass, whose fields are the options.

    The fields identify the maps: work that was interrupted is continued only with equal ones.
    """

    @property
    def name(self) -> str:
        """Name of the work, for its progress."""

    def need(self, *sizes: Size) -> Need:
        """Return the memory for inputs of these (height, width)."""

    def forms(self, *sizes: Size) -> Mapping[str, Form]:
        """Return shape and type of every map that the steps fill; refuse sizes that do not fit."""

    def steps(self, maps: Maps, *inputs: NormalRows, memory: int | None = None) -> Sequence[Step]:
        """Return the steps that fill the maps.

        ``memory`` is what bands may use, in bytes; None if everything is in memory.
        """


def run_steps(
    name: str, steps: Sequence[Step], maps: Maps, on_progress: Progress = no_progress
) -> None:
    """Compute what is missing of a stage.

    Parameters
    ----------
    name
        Name of the stage; ``on_progress`` receives it with the units of all steps by their weight.
    steps
        All steps, in order.
    maps
        The maps, in memory or in files. What is complete in them is not computed again.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition.files import MemoryMaps
    >>> from processing.stages import Step, run_steps
    >>> maps = MemoryMaps({"squares": ((4,), np.float64)})
    >>> def square(rows):
    ...     maps["squares"][rows] = np.arange(rows.start, rows.stop) ** 2
    >>> run_steps("squares", [Step("square", 4, square, most=3)], maps)
    >>> maps["squares"][:]
    array([0., 1., 4., 9.])
    """
    gaps = [(step, gap) for step in steps for gap in maps.missing(step.name, step.units)]
    total = sum(step.units * step.weight for step in steps)
    done = total - sum((gap.stop - gap.start) * step.weight for step, gap in gaps)
    on_progress(name, done, total)
    for step, gap in gaps:
        most = step.most or step.units
        for first in range(gap.start, gap.stop, most):
            units = slice(first, min(first + most, gap.stop))
            length = (units.stop - units.start) * step.weight
            for share in step.run(units) or ():
                on_progress(name, done + int(share * length), total)
            maps.complete(step.name, units)
            done += length
            on_progress(name, done, total)


def computed(stage: Stage, *inputs: NormalRows, on_progress: Progress = no_progress) -> MemoryMaps:
    """Return the maps of a stage, computed in memory.

    Examples
    --------
    >>> import numpy as np
    >>> from processing import NormalMap
    >>> from processing.detail import SeparationStage
    >>> from processing.stages import computed
    >>> y, x = np.mgrid[1:-1:32j, -1:1:32j]
    >>> bowl = NormalMap.from_vectors(np.dstack([x, y, 0 * x + 2]))
    >>> sorted(computed(SeparationStage(), bowl))
    ['detail', 'shape', 'sums']
    """
    maps = MemoryMaps(stage.forms(*(size_of(given) for given in inputs)))
    run_steps(stage.name, stage.steps(maps, *inputs), maps, on_progress)
    return maps


def size_of(given: NormalRows) -> Size:
    """Return (height, width) of a normal map."""
    height, width = given.mask.shape
    return height, width
