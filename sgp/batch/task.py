"""One source of a batch: its command lines, and what came of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from sgp.batch.files import Stamp
from sgp.cli.options import distinct
from sgp.results import Result

# Files and folders that a batch itself writes.
_TAKEN = (
    "state",
    "thumbnails",
    "batch.csv",
    "batch.json",
    "index.html",
    "roughness",
    "roughness.csv",
    "roughness.png",
)


def names_of(sources: Sequence[Path], known: Mapping[str, str]) -> dict[str, Path]:
    """Return a name for each source: its last part, with those of its folders where needed.

    Parameters
    ----------
    sources
        The sources.
    known
        Sources of earlier runs by their names, which they keep.

    Raises
    ------
    UsageError
        If a source is given twice.
    """
    first = distinct(sources)
    kept = {source: name for name, source in known.items()}
    used = {name.casefold() for name in (*_TAKEN, *known)}
    named = {}
    for place in first:
        name = kept.get(str(place)) or _new_name(place, used)
        used.add(name.casefold())
        named[name] = place
    return named


def _new_name(place: Path, used: set[str]) -> str:
    parts = list(place.parts[1:]) or ["source"]
    for count in range(1, len(parts) + 1):
        name = "-".join(parts[-count:])
        if name.casefold() not in used and not name.startswith("."):
            return name
    number = 2
    while f"{parts[-1]}-{number}".casefold() in used:
        number += 1
    return f"{parts[-1]}-{number}"


@dataclass(frozen=True)
class Stage:
    """One command line.

    Parameters
    ----------
    name
        The command, such as ``sgp run``.
    command
        The function of the command; processes receive it by its name.
    words
        The words after the command.
    judges
        Whether a result that is not ok is one: a limit is exceeded.
    """

    name: str
    command: Callable[..., Result]
    words: tuple[str, ...]
    judges: bool = False


@dataclass(frozen=True)
class Task:
    """The work for one source.

    Parameters
    ----------
    name
        Name of the source in the batch, and of its folder.
    source
        The recording.
    stages
        What runs, one after another.
    out
        Folder of the result.
    folder
        Working directory, to which paths among the words are relative.
    log
        File for progress and messages.
    thumbnail
        Picture to write.
    threads
        Number of threads.
    attempts
        How often a failure that may pass is tried.
    """

    name: str
    source: Path
    stages: tuple[Stage, ...]
    out: Path
    folder: Path
    log: Path
    thumbnail: Path
    threads: int = 1
    attempts: int = 2

    def lines(self) -> list[list[str]]:
        """Return the command lines as lists of words."""
        return [[*stage.name.split()[1:], *stage.words] for stage in self.stages]


@dataclass(frozen=True)
class Outcome:
    """What came of a task.

    Parameters
    ----------
    error
        The line that says why it failed; None if it succeeded.
    exit_code
        That of the command which failed, otherwise 0.
    attempts
        How often it was tried.
    seconds, cpu_seconds
        Time of all attempts.
    roots
        Files and folders that were named on the command lines and read.
    files
        Every file in them as it was before the work, by its path.
    outputs
        Files of the result.
    sizes
        Bytes of those that no later command writes again, by path.
    notices
        Number of notices by severity.
    figures
        Some figures of the result by name, for the table.
    verdict
        Whether the result can be used, see `processing.checks.Verdict`; empty if that is not known.
    """

    error: str | None = None
    exit_code: int = 0
    attempts: int = 1
    seconds: float = 0.0
    cpu_seconds: float = 0.0
    roots: tuple[str, ...] = ()
    files: Mapping[str, Stamp] = field(default_factory=dict)
    outputs: tuple[str, ...] = ()
    sizes: Mapping[str, int] = field(default_factory=dict)
    notices: Mapping[str, int] = field(default_factory=dict)
    figures: Mapping[str, Any] = field(default_factory=dict)
    verdict: str = ""


class Workers(Protocol):
    """What performs tasks: processes here, or a cluster.

    Attributes
    ----------
    count
        Number of tasks that run at the same time.
    """

    count: int

    def outcomes(
        self, tasks: Sequence[Task], started: Callable[[Task], None]
    ) -> Iterator[tuple[Task, Outcome]]:
        """Yield each task with its outcome as it ends; ``started`` is called as it begins."""
