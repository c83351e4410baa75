"""Commands that are killed at random moments, and given again."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

# A process that forks one child for each line of words, so that imports are paid once.
SERVER = """
import json, os, sys
from sgp.app import build, run

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
        Folder of its result.
    name
        Name of the maps, and of the record.
    shape
        ``(H, ...)`` of a map of float32 that is not 0 in any row.
    filled
        The name of this map.
    """

    out: Path
    name: str
    shape: tuple[int, ...]
    filled: str

    @property
    def folder(self) -> Path:
        return self.out / f".part-{self.name}"

    def rows_done(self) -> list[tuple[int, int]]:
        """Return the rows that the journal names, without a last line that was cut short."""
        try:
            lines = (self.folder / "journal.jsonl").read_bytes().split(b"\n")[:-1]
        except FileNotFoundError:
            return []
        return [tuple(json.loads(line)) for line in lines]

    def rows_filled(self) -> set[int]:
        """Return the rows of the unfinished map that contain a value."""
        values = np.fromfile(self.folder / f"{self.filled}.raw", np.float32).reshape(self.shape)
        return set(np.flatnonzero(values.reshape(len(values), -1).any(axis=1)))


def results(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.suffix != ".json"}


class Server:
    """Runs commands, each in a process of its own."""

    def __init__(self) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-c", SERVER],
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


def check_killed(
    server: Server, command: list[str], found: Unfinished, whole: Path, kills: int, seed: int
) -> None:
    """Kill a command at random moments until it is complete.

    Nothing that the journal names is lost, and at most one band is computed again.

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
    rng, out, height = np.random.default_rng(seed), found.out, found.shape[0]
    # Rows after which the process is killed; the last kills hit the files of the result.
    targets = [0, *np.sort(rng.integers(0, height, kills - 3)), height, height]
    killed, before, again = 0, [], [0]
    for target in targets:
        pid = server.start([*command, str(out)])
        limit = time.monotonic() + 60
        while (
            sum(b - a for a, b in found.rows_done()) < target
            and not (out / f"{found.name}.json").exists()
        ):
            assert time.monotonic() < limit, before
            time.sleep(0.005)
        time.sleep(rng.uniform(0, 0.1))
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)
        status = server.status()
        if status == 0:
            break  # complete before the signal came
        assert status == -signal.SIGKILL
        killed += 1
        done = found.rows_done()
        assert done[: len(before)] == before
        if done:
            named = {row for first, last in done for row in range(first, last)}
            again.append(len(found.rows_filled() - named))
        before = done
    if status:
        server.start([*command, str(out)])
        assert server.status() == 0
    assert killed >= kills // 2, targets
    assert len(before) > 5
    assert max(again) <= max(last - first for first, last in before), (again, before)
    assert results(out) == results(whole)
    assert not found.folder.exists()
