"""Commands that are killed at random moments, and given again."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

# A process that forks one child for each line of words, so that imports are paid once.
SERVER = """
import json, os, sys
from sgp.app import build, run

exec(sys.argv[1])
print("ready", flush=True)
for line in sys.stdin:
    pid = os.fork()
    if pid == 0:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        words = json.loads(line)
        os._exit(run(build(words), words))
    print(pid, flush=True)
    print(os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]), flush=True)
"""


@dataclass(frozen=True)
class Unfinished:
    """The maps of a command that was killed.

    Parameters
    ----------
    out
        Folder of the result.
    name
        Name of the maps in bands, and of their record.
    shape
        ``(H, ...)`` of a map of float32 that is not 0 in any row.
    filled
        The name of this map.
    stages
        Folders of the stages in ``out``, of which one is ``name``; none for a command with a
        single one.
    units, begin, rows
        What the journal counts if it does not count the rows of this map: their number, that of the
        first row of the map, and the rows of one.
    """

    out: Path
    name: str
    shape: tuple[int, ...]
    filled: str
    stages: tuple[str, ...] = ()
    units: int | None = None
    begin: int = 0
    rows: int = 1

    @property
    def total(self) -> int:
        """Number of what the journal counts."""
        return self.units or self.shape[0]

    @property
    def _result(self) -> Path:
        return self.out / self.name if self.stages else self.out

    @property
    def _part(self) -> Path:
        return self._result / f".part-{self.name}"

    def rows_done(self) -> list[tuple[int, int]]:
        """Return the rows that the journal names, without a last line that was cut short."""
        if not (self._part / "identity.json").exists():  # they are being removed
            return []
        try:
            lines = (self._part / "journal.jsonl").read_bytes().split(b"\n")[:-1]
        except FileNotFoundError:
            return []
        done: list[tuple[int, int]] = []
        begins: dict[str, int] = {}  # steps follow each other
        for line in map(json.loads, lines):
            if "units" in line:
                begin = begins.setdefault(line["step"], max((last for _, last in done), default=0))
                first, last = line["units"]
                done.append((begin + first, begin + last))
        return done

    def rows_filled(self) -> set[int]:
        """Return what the journal calls the rows of the unfinished map that contain a value."""
        values = np.fromfile(self._part / f"{self.filled}.raw", np.float32).reshape(self.shape)
        filled = np.flatnonzero(values.reshape(len(values), -1).any(axis=1))
        return {*(filled // self.rows + self.begin)}

    def reached(self, target: int | str) -> bool:
        """Return whether so many rows, or a stage, are complete."""
        if isinstance(target, str):
            return (self.out / target / f"{target}.json").exists()
        rows = sum(last - first for first, last in self.rows_done())
        return rows >= target or (self._result / f"{self.name}.json").exists()

    def complete(self) -> dict[str, int]:
        """Return the stages that count as complete, with the time of their records."""
        names = [
            name for name in self.stages if (self.out / ".part-summary" / f"{name}.json").exists()
        ]
        return {name: self.recorded(name) for name in names}

    def recorded(self, stage: str) -> int:
        """Return the time of the record of a stage."""
        return (self.out / stage / f"{stage}.json").stat().st_mtime_ns


def results(folder: Path) -> dict[str, bytes]:
    """Return maps, pictures, masks and meshes; records and reports contain times."""
    kinds = {".exr", ".png", ".ply", ".stl"}
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.suffix in kinds
    }


class Server:
    """Runs commands, each in a process of its own.

    Parameters
    ----------
    before
        Statements that are executed before the first command.
    """

    def __init__(self, before: str = "") -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-c", SERVER, before],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )
        assert self._answer() == "ready"

    def _answer(self) -> str:
        return self._process.stdout.readline().strip()

    def start(self, words: list[str]) -> int:
        self._process.stdin.write(f"{json.dumps(words)}\n")
        self._process.stdin.flush()
        return int(self._answer())

    def status(self) -> int:
        return int(self._answer())

    def close(self) -> None:
        self._process.stdin.close()
        self._process.stdout.close()
        self._process.wait(60)


@pytest.fixture
def server(request: pytest.FixtureRequest) -> Iterator[Server]:
    server = Server(getattr(request, "param", ""))
    yield server
    server.close()


def killed_when(
    server: Server, words: list[str], reached: Callable[[], bool], seconds: float
) -> int:
    """Kill a command some seconds after it has reached a state, and return its exit status."""
    pid = server.start(words)
    limit = time.monotonic() + 60
    while not reached():
        assert time.monotonic() < limit, words
        time.sleep(0.002)
    time.sleep(seconds)
    with suppress(ProcessLookupError):
        os.kill(pid, signal.SIGKILL)
    status = server.status()
    assert status in (0, -signal.SIGKILL)
    return status


def check_killed(
    server: Server, command: list[str], found: Unfinished, whole: Path, kills: int, seed: int
) -> None:
    """Kill a command at random moments until it is complete.

    Nothing that is complete is lost, and at most one band is computed again.

    Parameters
    ----------
    command
        The command, up to its output folder, which is that of ``found``.
    whole
        Folder for the result of the same command that is not killed.
    kills
        How often to kill.
    seed
        Fixes the moments.
    """
    server.start([*command, str(whole)])
    assert server.status() == 0
    rng, height = np.random.default_rng(seed), found.total
    # Rows or stages after which the process is killed; the last kills hit the files of the result.
    ends = found.stages or (height, height)
    rows = np.sort(rng.integers(0, height, kills - 1 - len(ends)))
    killed, before, again, complete = 0, [], [0], {}
    for target in (0, *(int(row) for row in rows), *ends):
        status = killed_when(
            server,
            [*command, str(found.out)],
            lambda target=target: found.reached(target),
            rng.uniform(0, 0.1),
        )
        if status == 0:
            break  # complete before the signal came
        killed += 1
        assert complete.items() <= found.complete().items()
        complete = found.complete()
        done = found.rows_done()
        if not complete:
            assert done[: len(before)] == before
        if done:
            named = {row for first, last in done for row in range(first, last)}
            again.append(len(found.rows_filled() - named))
            before = done
    if status:
        server.start([*command, str(found.out)])
        assert server.status() == 0
    assert [found.recorded(stage) for stage in complete] == list(complete.values())
    assert killed >= kills // 2, rows
    assert len(before) > 5
    band = max(last - first for first, last in before)
    sys.stdout.write(f"{command[0]}: {killed} kills, bands of {band} rows; lost: {again[1:]}\n")
    assert max(again) <= band, (again, before)
    assert results(found.out) == results(whole)
    assert not list(found.out.rglob(".part-*"))
