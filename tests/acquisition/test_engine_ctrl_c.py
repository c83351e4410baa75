"""Ctrl-C during a recording."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from acquisition import RecordingHooks, Session, record
from acquisition.engine import StopRequest
from rig import Rig as RealRig
from tests.acquisition.fake_bench import LABELS, PLAN, Bench, events_of


def _press_ctrl_c(times: int) -> Callable[[int], None]:
    def at(number: int) -> None:
        if number == 6:
            for _ in range(times):
                os.kill(os.getpid(), signal.SIGINT)
                time.sleep(0.1)  # two signals at once would be merged

    return at


def test_ctrl_c_once_ends_after_the_shot(rig: RealRig, bench: Bench, tmp_path: Path) -> None:
    bench.on_trigger = _press_ctrl_c(1)
    reported: list[str] = []
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt, match="after a shot"):
        record(
            rig,
            PLAN,
            tmp_path / "s",
            LABELS,
            hooks=RecordingHooks(on_stop=lambda: reported.append("stopping")),
        )
    assert signal.getsignal(signal.SIGINT) is before
    assert reported == ["stopping"]
    assert bench.led is None
    session = Session.open(tmp_path / "s")
    assert len(session.frames) == bench.frames == 6
    assert [line.event for line in events_of(session)] == ["interrupted"]


def test_another_thread_ends_a_recording_after_the_shot(
    rig: RealRig, bench: Bench, tmp_path: Path
) -> None:
    stop = StopRequest()
    asking = threading.Thread(target=stop.ask, args=("the page",))
    bench.on_trigger = lambda number: asking.start() or asking.join() if number == 6 else None
    with pytest.raises(KeyboardInterrupt, match="stopped by the page after a shot"):
        record(rig, PLAN, tmp_path / "s", LABELS, stop=stop)
    session = Session.open(tmp_path / "s")
    assert len(session.frames) == bench.frames == 6
    assert bench.led is None
    assert [line.event for line in events_of(session)] == ["interrupted"]


def test_a_shot_that_a_stop_spoiled_is_no_failure(
    rig: RealRig, bench: Bench, tmp_path: Path
) -> None:
    stop = StopRequest()

    def darken(number: int) -> None:
        if number == 6:
            stop.ask("the page")
            bench.led = None

    bench.on_trigger = darken
    with pytest.raises(KeyboardInterrupt, match="stopped by the page during a shot"):
        record(rig, PLAN, tmp_path / "s", LABELS, stop=stop)
    session = Session.open(tmp_path / "s")
    assert len(session.frames) == 5
    assert [line.event for line in events_of(session)] == ["interrupted"]


def test_ctrl_c_twice_ends_at_once(rig: RealRig, bench: Bench, tmp_path: Path) -> None:
    bench.on_trigger = _press_ctrl_c(2)
    with pytest.raises(KeyboardInterrupt):
        record(rig, PLAN, tmp_path / "s", LABELS)
    assert bench.led is None
    session = Session.open(tmp_path / "s")
    assert len(session.frames) == 5
    assert [line.event for line in events_of(session)] == ["interrupted"]
    assert events_of(session)[0].details["leds_confirmed_off"] is True


def test_ctrl_c_twice_ends_at_once_with_any_earlier_handler(
    rig: RealRig, bench: Bench, tmp_path: Path
) -> None:
    before = signal.signal(signal.SIGINT, lambda *_: None)
    try:
        bench.on_trigger = _press_ctrl_c(2)
        with pytest.raises(KeyboardInterrupt):
            record(rig, PLAN, tmp_path / "s", LABELS)
    finally:
        signal.signal(signal.SIGINT, before)
    assert len(Session.open(tmp_path / "s").frames) == 5


def test_ctrl_c_at_the_last_shot_finds_a_complete_recording(
    rig: RealRig, bench: Bench, tmp_path: Path
) -> None:
    bench.on_trigger = lambda n: os.kill(os.getpid(), signal.SIGINT) if n == 10 else None
    assert record(rig, PLAN, tmp_path / "s", LABELS).complete


def test_ctrl_c_while_waiting_for_the_card_takes_no_flat(
    rig: RealRig, bench: Bench, tmp_path: Path
) -> None:
    with pytest.raises(KeyboardInterrupt, match="after a shot"):
        record(
            rig,
            PLAN.changed(flats=2),
            tmp_path / "s",
            LABELS,
            hooks=RecordingHooks(before_flats=lambda: os.kill(os.getpid(), signal.SIGINT)),
        )
    assert bench.frames == 10
    session = Session.open(tmp_path / "s")
    assert len(session.frames) == 10
    assert [shot.role for shot in session.missing] == ["flat"] * 4
    assert [line.event for line in events_of(session)] == ["interrupted"]
