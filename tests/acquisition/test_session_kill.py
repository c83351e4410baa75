"""Processes killed while they record. They are forked from a server with all imports done."""

from __future__ import annotations

import json
import os
import random
import signal
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from acquisition import CapturePlan, Session, verify_session
from acquisition.plan import PlannedShot
from acquisition.session import SessionWriter
from rig.arrays import UInt16
from tests.forked import ForkServer
from tests.quick_sample import quick

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="forks processes")

PLAN = CapturePlan(leds=tuple(range(6)), exposures_us=(100.0,))
SHORT = CapturePlan(leds=(0, 1), exposures_us=(100.0,))

# For each folder it receives, forks a process that records into it and appends the name of each
# frame to `acks` once the frame is reported as safe. `dies_at` kills the process at that call to
# the disk, in the middle of a write; `limit` is the largest allowed file size.
SERVER = """
import json, os, resource, sys
from datetime import UTC, datetime
import numpy as np
from acquisition import StorageError
from acquisition.session import CameraRecord, Manifest
from acquisition import CapturePlan
from acquisition.pixels import measure_quality
from acquisition.session import SessionWriter

measure_quality(np.zeros((16, 16), np.uint16), white_level_dn=4095)  # compile it once

def record(folder, acks, plan, dies_at, limit):
    plan = CapturePlan(**plan)
    manifest = Manifest(
        started_utc=datetime(2026, 1, 2, tzinfo=UTC), operator="Ada", object="coin", plan=plan,
        camera=CameraRecord(width=16, height=16, bit_depth=12),
    )
    log = os.open(acks, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    calls = [0]
    def deadly(name):
        real = getattr(os, name)
        def call(*arguments):
            calls[0] += 1
            if calls[0] == dies_at:
                if name == "write":
                    real(arguments[0], bytes(arguments[1])[: len(arguments[1]) // 2])
                os._exit(9)
            return real(*arguments)
        setattr(os, name, call)
    write = os.write
    if dies_at is not None:
        for name in ("write", "fsync", "replace", "mkdir"):
            deadly(name)
    if limit is not None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
    try:
        with SessionWriter.create(folder, manifest) as writer:
            for index, shot in enumerate(writer.missing):
                pixels = np.random.default_rng(index).integers(0, 4096, (16, 16))
                writer.write_frame(shot, pixels.astype(np.uint16))
                write(log, (shot.file + "\\n").encode())
            writer.complete()
    except StorageError as error:
        write(log, ("refused: " + str(error) + "\\n").encode())

print("ready", flush=True)
for line in sys.stdin:
    pid = os.fork()
    if pid == 0:
        try:
            record(**json.loads(line))
        finally:
            os._exit(0)
    print(pid, flush=True)
    sys.stdin.readline()  # until then the process id is not reused
    print(os.waitpid(pid, 0)[1], flush=True)
"""


class Server:
    def __init__(self, forks: ForkServer) -> None:
        self.process = forks.start(SERVER)
        assert self._line() == "ready"

    def _line(self) -> str:
        return str(self.process.stdout.readline()).strip()

    def _send(self, line: str) -> None:
        self.process.stdin.write(line + "\n")
        self.process.stdin.flush()

    def record(
        self,
        folder: Path,
        plan: CapturePlan = PLAN,
        *,
        kill_after: tuple[int, float] | None = None,
        dies_at: int | None = None,
        limit: int | None = None,
    ) -> tuple[list[str], int]:
        """Return the acknowledged frames and the exit status.

        ``kill_after`` is a number of acknowledged frames and a delay.
        """
        acks = folder.with_suffix(".acks")
        request: dict[str, Any] = {"folder": str(folder), "acks": str(acks)}
        request |= {"plan": plan.model_dump(), "dies_at": dies_at, "limit": limit}
        self._send(json.dumps(request))
        pid = int(self._line())
        if kill_after is not None:
            frames, delay_s = kill_after
            while frames and (not acks.exists() or acks.read_text().count("\n") < frames):
                time.sleep(0.0005)
            time.sleep(delay_s)
            os.kill(pid, signal.SIGKILL)
        self._send("done")
        status = int(self._line())
        return acks.read_text().splitlines() if acks.exists() else [], status

    def close(self) -> None:
        self.process.stdin.close()
        self.process.wait(60)
        self.process.end()


@pytest.fixture(scope="module")
def server(forks: ForkServer) -> Iterator[Server]:
    server = Server(forks)
    yield server
    server.close()


def pixels_of(frame: PlannedShot, shots: tuple[PlannedShot, ...]) -> UInt16:
    rng = np.random.default_rng(shots.index(frame))
    return rng.integers(0, 4096, (16, 16)).astype(np.uint16)


def check(folder: Path) -> int:
    """Check that every frame that counts is right, and return how many there are."""
    found = verify_session(folder)
    assert found.problems == ()
    session = Session.open(folder)
    assert session.manifest.plan is not None
    shots = {shot.key: shot for shot in session.manifest.plan.shots()}
    for frame in session.frames:
        wanted = pixels_of(shots[frame.line.key], tuple(shots.values()))
        np.testing.assert_array_equal(frame.read(), wanted)
    return len(session.frames)


def finish(folder: Path) -> None:
    """Reopen the session and complete it."""
    with SessionWriter.reopen(folder) as writer:
        assert writer.manifest.plan is not None
        shots = writer.manifest.plan.shots()
        for shot in writer.missing:
            writer.write_frame(shot, pixels_of(shot, shots))
        writer.complete()
    assert check(folder) == len(shots)
    assert verify_session(folder).complete
    assert verify_session(folder).warnings == ()


def survived(folder: Path, acknowledged: list[str]) -> None:
    """Check a session whose writer was killed: no frame lost, no damaged frame accepted."""
    count = check(folder)
    session = Session.open(folder)
    assert [frame.path.name for frame in session.frames][: len(acknowledged)] == acknowledged
    assert count - len(acknowledged) in (0, 1)
    if session.complete:
        assert session.missing == ()
    else:
        finish(folder)


@pytest.mark.parametrize("kills", quick([8, 40], every=2))
def test_kill_at_random_moments(server: Server, tmp_path: Path, kills: int) -> None:
    whole = tmp_path / "whole"
    began = time.monotonic()
    acknowledged, status = server.record(whole)
    frame_s = (time.monotonic() - began) / len(acknowledged)
    assert (len(acknowledged), status) == (8, 0)
    assert verify_session(whole).complete
    rng = random.Random(7)
    killed = 0
    for number in range(kills):
        folder = tmp_path / f"s{number}"
        moment = rng.randrange(6), rng.uniform(0, 1.5 * frame_s)
        acknowledged, status = server.record(folder, kill_after=moment)
        killed += status == signal.SIGKILL
        if (folder / "session.toml").exists():
            survived(folder, acknowledged)
    # Otherwise no kill happened during the recording.
    assert killed >= kills // 2


@pytest.mark.slow
def test_death_at_every_call_to_the_disk(server: Server, tmp_path: Path) -> None:
    """From the creation to COMPLETE, one process per call, killed in the middle of a write."""
    status, dies_at = -1, 0
    while status != 0:
        dies_at += 1
        folder = tmp_path / f"s{dies_at}"
        acknowledged, status = server.record(folder, SHORT, dies_at=dies_at)
        if not (folder / "session.toml").exists():
            # Only a temporary file of the creation: the folder counts as empty.
            assert acknowledged == []
            acknowledged, _ = server.record(folder, SHORT)
            assert len(acknowledged) == 4
        survived(folder, acknowledged)
    # At least five calls for each of four frames, and the last process was not killed.
    assert dies_at > 5 * 4


@pytest.mark.parametrize("limit", quick([600, 1000, 2048], every=3))
def test_a_full_disk(server: Server, tmp_path: Path, limit: int) -> None:
    """Real refusals of the operating system, in frames or in the journal."""
    folder = tmp_path / "s"
    acknowledged, status = server.record(folder, limit=limit)
    assert status == 0
    assert acknowledged[-1].startswith(f"refused: {folder}")
    survived(folder, acknowledged[:-1])
