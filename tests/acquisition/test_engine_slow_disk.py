"""A disk that is slow or stuck during a recording."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import Any

import pytest

from acquisition import RecordingHooks, Session, StorageError, record, verify_session
from acquisition.engine import recording_loop as _recording
from acquisition.engine import recording_run as _carry_out
from acquisition.session import SessionWriter
from acquisition.session import writer as _session_writer
from rig import CameraError
from rig import Rig as RealRig
from rig.arrays import UInt16
from rig.host import clock, program, threads
from tests.acquisition.fake_bench import LABELS, PLAN, Bench, Gate, events_of

pytestmark = pytest.mark.usefixtures("world")


def test_a_slow_disk_pauses_the_shooting_and_loses_nothing(
    rig: RealRig, bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    gate = Gate(monkeypatch)
    taken: list[int] = []

    def on_event(name: str, details: Any) -> None:
        if name == "paused":
            taken.append(bench.frames)
            assert bench.led is None
            assert bench.log[-1] == "off"
            gate.open.set()

    session = record(rig, PLAN, tmp_path / "s", LABELS, hooks=RecordingHooks(on_event=on_event))
    assert taken[0] == _recording.ROOM
    assert session.complete
    assert [line.event for line in session.events][:2] == ["paused", "resumed"]
    assert len(session.frames) == bench.frames == 10
    assert verify_session(tmp_path / "s").ok


def test_a_stuck_disk_is_reported_with_the_leds_off(
    rig: RealRig, bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    gate = Gate(monkeypatch)
    with pytest.raises(StorageError, match=r"no write has finished for 0.3 s, 6 writes"):
        record(rig, PLAN, tmp_path / "s", LABELS, stall_s=0.3)
    assert bench.led is None
    assert bench.frames == _recording.ROOM
    # The stuck writer still holds the lock, and its frame does not count.
    with pytest.raises(StorageError, match="another process"):
        SessionWriter.reopen(tmp_path / "s")
    gate.open.set()
    for _ in range(200):
        try:
            SessionWriter.reopen(tmp_path / "s").close()
        except StorageError:
            clock.sleep(0.05)
        else:
            break
    session = Session.open(tmp_path / "s")
    assert session.frames == ()
    assert verify_session(tmp_path / "s").ok
    assert session.events[-1].event == "reopened"


def test_ctrl_c_twice_does_not_wait_for_a_stuck_disk(
    rig: RealRig, bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    gate = Gate(monkeypatch)

    def press() -> None:
        for _ in range(2):
            clock.sleep(0.3)
            program.send_to_itself(signal.SIGINT)

    def press_soon(number: int) -> None:
        if number == 2:
            threads.Thread(target=press).start()

    bench.on_trigger = press_soon
    with pytest.raises(KeyboardInterrupt) as caught:
        record(rig, PLAN, tmp_path / "s", LABELS, stall_s=5.0)
    assert bench.led is None
    # The writers get a second, which is less than the time after which a disk counts as stuck.
    assert not hasattr(caught.value, "__notes__")
    gate.open.set()


def test_a_stuck_disk_is_noted_after_another_error(
    rig: RealRig, bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    gate = Gate(monkeypatch)
    bench.unplug_at(3)
    with pytest.raises(CameraError, match="unplugged") as caught:
        record(rig, PLAN, tmp_path / "s", LABELS, stall_s=0.2)
    (note,) = caught.value.__notes__
    assert "no write has finished for 0.2 s, 2 writes are waiting" in note
    # Nothing is written while a writer runs.
    assert Session.open(tmp_path / "s").events == ()
    gate.open.set()


def test_a_slow_disk_may_finish_after_an_error(
    rig: RealRig, bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = _session_writer.store_frame

    def slow(path: Path, pixels: UInt16) -> Any:
        clock.sleep(0.1)
        return real(path, pixels)

    monkeypatch.setattr(_session_writer, "store_frame", slow)
    monkeypatch.setattr(_carry_out, "_PATIENCE_S", 0.0)
    bench.unplug_at(5)
    with pytest.raises(CameraError):
        record(rig, PLAN, tmp_path / "s", LABELS)
    session = Session.open(tmp_path / "s")
    assert len(session.frames) == 4
    assert [line.event for line in events_of(session)] == ["failed"]


def test_a_disk_counts_as_stuck_after_half_a_minute(
    rig: RealRig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    gate = Gate(monkeypatch)
    with pytest.raises(StorageError, match=r"no write has finished for 30\.\d s"):
        record(rig, PLAN, tmp_path / "s", LABELS)
    gate.open.set()
