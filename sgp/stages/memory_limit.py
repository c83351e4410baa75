"""What the commands with ``--memory`` have in common: in memory, or in bands with maps on disk."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import acquisition
import processing
import rig
from sgp.cli.exit import UsageError
from sgp.results import input_hashes, plain


def is_in_bands(memory: int | None, need: processing.stages.Need) -> bool:
    """Return whether a computation does not fit into memory.

    Parameters
    ----------
    memory
        Bytes of ``--memory``; None for half of what is free.

    Raises
    ------
    UsageError
        If ``--memory`` is too small for bands, too. The message states the least.
    """
    if need.whole <= rig.processes.memory_budget(memory):
        return False
    if memory is not None and memory < need.least:
        raise too_small(memory, need.of, need.least)
    return True


@dataclass(frozen=True)
class Limit:
    """The memory that a command may use, and where the maps are that do not fit into it.

    Parameters
    ----------
    memory
        Bytes of ``--memory``; None for half of what is free.
    path
        Future result. Maps that do not fit are in a hidden folder next to it until the result is
        complete; another call continues them.
    force
        Whether unfinished maps of other inputs or options are removed.
    """

    memory: int | None
    path: Path
    force: bool

    def must_be_stored(self, need: processing.stages.Need) -> bool:
        """Return whether the maps of a result belong into files.

        What is unfinished is continued, even if more memory is free now. Errors are those of
        `is_in_bands`.
        """
        return is_in_bands(self.memory, need) or acquisition.files.is_unfinished(self.path)

    def check_whole(self, need: processing.stages.Need, option: str) -> None:
        """Refuse an option that needs the complete maps if ``--memory`` is too small for them.

        Without a limit, perhaps there is enough.

        Raises
        ------
        UsageError
            The message names the option and states the memory that it needs. Also if there are
            unfinished maps of another command.
        """
        if self.force:
            acquisition.files.remove_unfinished(self.path)
        with other_maps_refused():
            acquisition.files.check_unfinished(self.path, {"options": option})
        if self.memory is not None and self.memory < need.whole:
            raise needs_maps(self.memory, need, option, f"leave {option} out")

    def bytes_of_bands(self, need: processing.stages.Need) -> int:
        """Return the bytes for bands: the limit, or the least if even that is not free."""
        return max(rig.processes.memory_budget(self.memory), need.least)


def needs_maps(memory: int, need: processing.stages.Need, option: str, remedy: str) -> UsageError:
    """Return the error of a limit that is too small for an option, which states what suffices."""
    return UsageError(
        f"--memory {size_text(memory)} is too small for {need.of} with {option}, which needs the "
        f"complete maps: give --memory {size_text(need.whole)}, or {remedy}"
    )


def too_small(memory: int, of: str, least: int) -> UsageError:
    """Return the error of a limit that is too small, which states the least."""
    return UsageError(
        f"--memory {size_text(memory)} is too small for {of}: give at least --memory "
        f"{size_text(least)}"
    )


def identity(parameters: Mapping[str, object], files: list[Path]) -> dict[str, object]:
    """Return what unfinished maps depend on: parameters, inputs and the version."""
    return {
        **plain(parameters),
        "inputs": [*input_hashes(files).values()],
        "software version": acquisition.files.software_version(),
    }


@contextmanager
def other_maps_refused() -> Iterator[None]:
    """Turn the error about unfinished maps of another command into one that names the remedy.

    Raises
    ------
    UsageError
        If there are such maps, or unfinished maps were changed.
    """
    try:
        yield
    except acquisition.files.DamagedMapsError as error:
        raise UsageError(f"{error.file}: {error.what}: add --force to begin again") from error
    except acquisition.files.OtherMapsError as error:
        raise UsageError(
            f"{error.folder} contains unfinished maps of a command that differs in {error.other}: "
            "repeat that command, choose another folder, or add --force to begin again"
        ) from error


def size_text(count: int) -> str:
    """Return bytes as an option of memory, rounded up."""
    if count < 2**20:
        return f"{math.ceil(count / 2**10)}K"
    if count < 2**30:
        return f"{math.ceil(count / 2**20)}M"
    return f"{math.ceil(count / 2**30 * 100) / 100:g}G"
