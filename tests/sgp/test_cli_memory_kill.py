"""``sgp normals --memory`` that is killed, and continued by the same command."""

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
# A few MB more than interpreter and libraries: bands of a few dozen rows.
MEMORY = "437M"
KILLS = 10

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


@pytest.fixture
def command(tmp_path: Path) -> list[str]:
    """The command, without its output folder, for a bumpy ball with noise that fills the frame."""
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
    words = ("normals", tmp_path / "images", "--lights", tmp_path / "lights.json")
    return [*map(str, words), "--memory", MEMORY, "--out"]


def rows_done(out: Path) -> list[tuple[int, int]]:
    """Return the rows that the journal names, without a last line that was cut short."""
    try:
        lines = (out / ".part-normals" / "journal.jsonl").read_bytes().split(b"\n")[:-1]
    except FileNotFoundError:
        return []
    return [tuple(json.loads(line)) for line in lines]


def rows_filled(out: Path) -> set[int]:
    """Return the rows of the unfinished albedo that contain a value."""
    albedo = np.fromfile(out / ".part-normals" / "albedo.raw", np.float32).reshape(SIZE)
    return set(np.flatnonzero(albedo.any(axis=1)))


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


@pytest.fixture
def server() -> Iterator[Server]:
    server = Server()
    yield server
    server.close()


@pytest.mark.slow
def test_killed_at_random_moments(server: Server, command: list[str], tmp_path: Path) -> None:
    """Nothing that the journal names is lost, and at most one band is computed again."""
    whole, out = tmp_path / "whole", tmp_path / "out"
    server.start([*command, str(whole)])
    assert server.status() == 0
    rng = np.random.default_rng(10)
    # Rows after which the process is killed; the last kills hit the files of the result.
    targets = [0, *np.sort(rng.integers(0, SIZE[0], KILLS - 3)), SIZE[0], SIZE[0]]
    killed, before, again = 0, [], [0]
    for target in targets:
        pid = server.start([*command, str(out)])
        limit = time.monotonic() + 60
        while (
            sum(b - a for a, b in rows_done(out)) < target and not (out / "normals.json").exists()
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
        done = rows_done(out)
        assert done[: len(before)] == before
        if done:
            named = {row for first, last in done for row in range(first, last)}
            again.append(len(rows_filled(out) - named))
        before = done
    if status:
        server.start([*command, str(out)])
        assert server.status() == 0
    assert killed >= KILLS // 2, targets
    assert len(before) > 5
    assert max(again) <= max(last - first for first, last in before), (again, before)
    assert results(out) == results(whole)
    assert not (out / ".part-normals").exists()
