"""``sgp normals`` and ``sgp run --memory`` that are killed, and continued by the same command."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from acquisition import Lights, write_lights, write_mask, write_png

SIZE = (320, 400)
COUNT = 12
# Bands of a few dozen rows, besides interpreter and libraries, which count as nothing here.
MEMORY = "8M"
KILLS = 10

# A process that forks one child for each line of words, so that imports are paid once.
SERVER = """
import json, os, sys
from processing._blocks import memory as blocks
from processing._detail import rows
from processing._reconstruction import memory
from sgp import _surface_memory
from sgp.app import build, run

memory._FIXED = rows._FIXED = blocks._FIXED = _surface_memory._PROGRAM = 0
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


@pytest.fixture
def options(tmp_path: Path) -> list[str]:
    """Recording and options, for a bumpy ball with noise that fills the frame."""
    (tmp_path / "images").mkdir()
    rng = np.random.default_rng(67)
    y, x = (np.mgrid[: SIZE[0], : SIZE[1]] - 160.0) / 210
    normals = np.stack([x + 0.2 * np.sin(30 * x), -y + 0.2 * np.cos(25 * y), 1 + 0 * x], -1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    around = np.arange(COUNT) * 2.4
    lights = Lights(directions=np.stack([np.cos(around), np.sin(around), 1 + around / 20], 1))
    write_lights(tmp_path / "lights.json", lights)
    for i, light in enumerate(lights.unit_directions):
        shade = 0.7 * np.clip(normals @ light, 0, 1) + rng.normal(0, 0.003, SIZE)
        pixels = np.rint(np.clip(shade, 0, 1) * 65535).astype(np.uint16)
        write_png(tmp_path / "images" / f"ball.{i:02}.png", pixels)
    write_mask(tmp_path / "images" / "mask.png", x**2 + y**2 < 0.6)
    words = (tmp_path / "images", "--lights", tmp_path / "lights.json", "--memory", MEMORY)
    return [*map(str, words)]


class Watched:
    """The files of a command that show how far it is.

    Parameters
    ----------
    out
        Folder of the result.
    stages
        Folders of the stages; none for a command with a single one.
    """

    def __init__(self, out: Path, stages: tuple[str, ...]) -> None:
        self.out, self.stages = out, stages
        self.normals = out / "normals" if stages else out
        self._part = self.normals / ".part-normals"

    def rows_done(self) -> list[tuple[int, int]]:
        """Return the rows that the journal names, without a last line that was cut short."""
        try:
            lines = (self._part / "journal.jsonl").read_bytes().split(b"\n")[:-1]
        except FileNotFoundError:
            return []
        return [tuple(json.loads(line)) for line in lines]

    def rows_filled(self) -> set[int]:
        """Return the rows of the unfinished albedo that contain a value."""
        albedo = np.fromfile(self._part / "albedo.raw", np.float32).reshape(SIZE)
        return set(np.flatnonzero(albedo.any(axis=1)))

    def reached(self, target: int | str) -> bool:
        """Return whether so many rows, or a stage, are complete."""
        if isinstance(target, str):
            return (self.out / target / f"{target}.json").exists()
        rows = sum(last - first for first, last in self.rows_done())
        return rows >= target or (self.normals / "normals.json").exists()

    def complete(self) -> dict[str, int]:
        """Return the stages that a run counts as complete, with the time of their records."""
        names = [
            name for name in self.stages if (self.out / ".part-summary" / f"{name}.json").exists()
        ]
        return {name: (self.out / name / f"{name}.json").stat().st_mtime_ns for name in names}

    def results(self) -> dict[str, bytes]:
        """Return maps, pictures, masks and meshes."""
        kinds = {".exr", ".png", ".ply"}
        return {
            str(path.relative_to(self.out)): path.read_bytes()
            for path in self.out.rglob("*")
            if path.suffix in kinds
        }


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


@pytest.fixture
def server() -> Iterator[Server]:
    server = Server()
    yield server
    server.close()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "stages"),
    [("normals", ()), ("run", ("normals", "detail", "surface"))],
    ids=["normals", "run"],
)
def test_killed_at_random_moments(
    server: Server, options: list[str], tmp_path: Path, name: str, stages: tuple[str, ...]
) -> None:
    """Nothing that is complete is lost, and at most one band is computed again."""
    # A batch repeats a run with --force.
    command = [name, *options, *(["--force"] if stages else []), "--out"]
    whole, watched = Watched(tmp_path / "whole", stages), Watched(tmp_path / "out", stages)
    server.start([*command, str(whole.out)])
    assert server.status() == 0
    rng = np.random.default_rng(10)
    # Rows or stages after which the process is killed; the last kills hit the files of the result.
    ends = stages or (SIZE[0], SIZE[0])
    rows = np.sort(rng.integers(0, SIZE[0], KILLS - 1 - len(ends)))
    targets = [0, *(int(row) for row in rows), *ends]
    killed, before, again, complete = 0, [], [0], {}
    for target in targets:
        pid = server.start([*command, str(watched.out)])
        limit = time.monotonic() + 60
        while not watched.reached(target):
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
        assert complete.items() <= watched.complete().items()
        complete = watched.complete()
        done = watched.rows_done()
        if not complete:
            assert done[: len(before)] == before
        if done:
            named = {row for first, last in done for row in range(first, last)}
            again.append(len(watched.rows_filled() - named))
            before = done
    if status:
        server.start([*command, str(watched.out)])
        assert server.status() == 0
    times = [(watched.out / one / f"{one}.json").stat().st_mtime_ns for one in complete]
    assert times == list(complete.values())
    assert killed >= KILLS // 2, targets
    assert len(before) > 5
    band = max(last - first for first, last in before)
    sys.stdout.write(f"{name}: {killed} kills, bands of {band} rows; rows lost: {again[1:]}\n")
    assert max(again) <= band, (again, before)
    assert watched.results() == whole.results()
    assert not list(watched.out.rglob(".part-*"))
