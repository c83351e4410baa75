"""What is known of each source of a batch, on disk between runs."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field, ValidationError

import acquisition
from sgp.batch.files import Stamp, difference, stamps
from sgp.batch.task import Outcome, Task
from sgp.results import check_folder, dumps, json_table, locked

FORMAT, VERSION = "sgp-batch-state", 1
# Errors of a name: too long, or with characters that the file system does not have.
_NAMES = (errno.ENAMETOOLONG, errno.EINVAL, errno.EILSEQ)
_INTERRUPTED = "the batch was interrupted while it was computed"


class State(BaseModel):
    """The last run of one source.

    Parameters
    ----------
    format, version
        ``sgp-batch-state`` and 1.
    source
        The recording.
    lines
        The command lines.
    software
        Version of the program.
    error, exit_code, attempts, seconds, cpu_seconds, roots, files, outputs, notices, figures
        As in `Outcome`.
    sizes, verdict
        As in `Outcome`; earlier programs did not write them.
    """

    model_config = ConfigDict(extra="ignore", frozen=True)

    format: str
    version: int
    source: str
    lines: list[list[str]]
    software: str
    error: str | None
    exit_code: int
    attempts: int
    seconds: float
    cpu_seconds: float
    roots: list[str]
    files: dict[str, Stamp]
    outputs: list[str]
    notices: dict[str, int]
    figures: dict[str, int | float | None]
    sizes: dict[str, int] = Field(default_factory=dict)
    verdict: str = ""


@dataclass(frozen=True)
class States:
    """The states of a batch: one file for each source in a folder."""

    folder: Path

    def path(self, name: str) -> Path:
        """Return the file of a source."""
        return self.folder / f"{name}.json"

    def read_all(self) -> dict[str, State]:
        """Return all states by the names of the sources; files that are damaged are left out.

        Raises
        ------
        DataError
            If a state was written by another version.
        """
        found = {path.stem: _read(path) for path in sorted(self.folder.glob("*.json"))}
        return {name: state for name, state in found.items() if state is not None}

    def begin(self, task: Task, state: State) -> None:
        """Note that a task begins to overwrite the result that a state describes.

        If the batch is interrupted, the result may have files of both, so it is computed again.
        """
        begun = state.model_copy(update={"error": _INTERRUPTED, "exit_code": 1})
        self._store(task.name, begun)

    def write(self, task: Task, outcome: Outcome) -> State:
        """Write the outcome of a task."""
        state = state_of(task, outcome)
        self._store(task.name, state)
        return state

    def confirm(self, name: str, state: State) -> None:
        """Note the times that the files of a result have now, so that they are not read again.

        Only after `reason_to_run` has found none.
        """
        now = stamps(state.roots)
        if now.keys() == state.files.keys():
            files = {
                path: one._replace(sha256=state.files[path].sha256) for path, one in now.items()
            }
            if files != state.files:
                self._store(name, state.model_copy(update={"files": files}))

    def unusable(self, name: str) -> str | None:
        """Return why the disk takes no state of a source of this name; None if it does."""
        part = acquisition.files.part_path(self.path(name))
        try:
            os.close(os.open(part, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
        except OSError as error:
            return error.strerror if error.errno in _NAMES else None
        part.unlink()
        return None

    def _store(self, name: str, state: State) -> None:
        content = f"{dumps(state.model_dump())}\n".encode()
        acquisition.write_durably(self.path(name), content)


def state_of(task: Task, outcome: Outcome) -> State:
    """Return the state that an outcome leaves."""
    return State(
        format=FORMAT,
        version=VERSION,
        source=str(task.source),
        lines=task.lines(),
        software=acquisition.files.software_version(),
        **vars(outcome),
    )


def _read(path: Path) -> State | None:
    content = json_table(path)
    if content.get("format") != FORMAT:
        return None
    if content.get("version") != VERSION:
        raise acquisition.DataError(
            f"{path}: has version {str(content.get('version'))[:20]} of {FORMAT}, and this program "
            f"reads version {VERSION}: choose another --out, or remove {path.parent.parent}"
        )
    try:
        return State.model_validate(content)
    except ValidationError:
        return None


def reason_to_run(task: Task, states: Mapping[str, State]) -> str | None:
    """Return why a task has to run, or None if its result is complete and up to date."""
    state = states.get(task.name)
    if state is None:
        return "new"
    if state.error == _INTERRUPTED:
        return "interrupted before"
    if state.error is not None:
        return "failed before"
    if state.lines != task.lines():
        return "other options"
    if state.software != acquisition.files.software_version():
        return f"computed by version {state.software}"
    missing = [name for name in state.outputs if not os.path.isfile(name)]
    if missing:
        return f"{Path(missing[0]).name} is missing"
    for name, size in state.sizes.items():
        now = os.path.getsize(name)
        if now != size:
            return f"{Path(name).name} has {now} bytes instead of {size}"
    return difference(state.files, stamps(state.roots))


@contextmanager
def batch_folder(out: Path) -> Iterator[States]:
    """Create the folder of a batch or continue one; others are refused as long as this is open.

    Raises
    ------
    UsageError
        If the folder contains something else, or another batch is writing into it.
    StorageError
        If it cannot be created.
    """
    states = States(out / "state")
    if not states.folder.is_dir():
        check_folder(out)
    acquisition.make_folder(states.folder)
    other = f"another batch is writing into {out}: wait until it has ended, or choose another --out"
    with locked(states.folder, other):
        for folder in (out, states.folder):
            acquisition.files.remove_part_files(folder)
        yield states
