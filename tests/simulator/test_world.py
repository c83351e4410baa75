"""Recordings in virtual time: they are replayable, and their faults and checks are real."""

from __future__ import annotations

import json
import os
import random
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from acquisition import DataError, make_folder
from acquisition.files import storage
from acquisition.session import SessionWriter
from rig import Board, BoardError, CameraFrame, Shot
from rig.board import BoardEcho, protocol
from rig.host import clock, filesystem, program, threads
from rig.shooting import lights_off
from simulator.bench.state import LitPeriod
from simulator.led_board import BoardFault
from simulator.world import Event, Schedule, Trial, World, trial
from simulator.world.disk import Disk
from simulator.world.invariants import SessionState, badly_lit, misplaced
from simulator.world.light import LightHistory, LightView
from simulator.world.schedule import KINDS, VERSION
from simulator.world.scheduler import StuckError
from simulator.world.trial import run, run_seed
from tests.quick_sample import quick

CALM = Schedule(3, ())


def lines_of(schedule: Schedule, folder: Path) -> list[str]:
    lines: list[str] = []
    folder.mkdir()
    Trial(schedule, folder, lines.append).run()
    return lines


def disk_in(folder: Path, seed: int = 0) -> Disk:
    return Disk(folder, random.Random(seed), lambda name: None, lambda seconds: None)


@pytest.mark.parametrize("first", quick(range(0, 40, 10), every=2))
def test_no_promise_is_broken(first: int) -> None:
    outcomes = [run_seed(seed) for seed in range(first, first + 10)]
    assert [one.violations for one in outcomes] == [()] * 10
    assert sum(len(one.met) for one in outcomes) > 30


@pytest.mark.slow
@pytest.mark.parametrize("first", range(40, 2040, 100))
def test_no_promise_is_broken_in_two_thousand_recordings(first: int) -> None:
    found = {seed: run_seed(seed).violations for seed in range(first, first + 100)}
    assert {seed: texts for seed, texts in found.items() if texts} == {}


def test_a_seed_is_replayed_step_by_step(tmp_path: Path) -> None:
    schedule = Schedule.drawn(7)
    first, second = (lines_of(schedule, tmp_path / name) for name in "ab")
    assert first == second
    assert len(first) > 500


@pytest.mark.slow
def test_a_violation_is_reduced_to_few_faults(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(storage, "sync_folder", lambda folder: None)
    seed = next(seed for seed in range(40) if run_seed(seed).violations)
    shrunk = Schedule.drawn(seed).shrunk(lambda fewer: bool(run(fewer).violations))
    assert "host:power-loss" in [event.kind for event in shrunk.events]
    assert len(shrunk.events) <= 4
    path = tmp_path / "schedule.json"
    path.write_text(shrunk.to_json())
    assert Schedule.read(path) == shrunk
    assert run(Schedule.read(path)).violations


@pytest.mark.parametrize("kind", KINDS)
def test_every_fault_happens_and_is_survived(kind: str) -> None:
    outcome = run(Schedule(5, tuple(Event(step, kind, 20) for step in (150, 300, 450))))
    assert {event.kind for event in outcome.met} == {kind}
    assert outcome.violations == ()


FRAME = CameraFrame(np.zeros((2, 2), np.uint16), 1, 1000, 2.0, 0.0, None)
WHOLE = LitPeriod(4, 1000, 3000)


@pytest.mark.parametrize(
    ("shot", "periods", "found"),
    [
        pytest.param(Shot(FRAME, 4, BoardEcho(1, 4)), [WHOLE], None, id="whole"),
        pytest.param(Shot(FRAME, None, None), [LitPeriod(4, 3000, 4000)], None, id="dark"),
        pytest.param(Shot(FRAME, 4, None), [LitPeriod(4, 1000, 2999)], "that was lit by", id="end"),
        pytest.param(
            Shot(FRAME, 4, None), [LitPeriod(4, 1001, 3000)], "that was lit by", id="start"
        ),
        pytest.param(Shot(FRAME, 4, None), [], "that was lit by", id="none"),
        pytest.param(Shot(FRAME, 5, None), [WHOLE], "that was lit by", id="another LED"),
        pytest.param(Shot(FRAME, None, None), [WHOLE], "that was lit by", id="not dark"),
        pytest.param(
            Shot(FRAME, 4, None), [WHOLE, LitPeriod(5, 1, 9000)], "that was lit by", id="two LEDs"
        ),
        pytest.param(Shot(FRAME, 4, BoardEcho(1, 5)), [WHOLE], "the echo states 5", id="echo"),
    ],
)
def test_a_shot_needs_its_led_for_its_complete_exposure(
    shot: Shot, periods: list[LitPeriod], found: str | None
) -> None:
    cancelled = LitPeriod(3, 2000, 2000)
    texts = list(badly_lit([shot], [*periods, cancelled]))
    assert [found in text for text in texts if found] == [True] * (found is not None)
    assert len(texts) == (found is not None)


def test_files_are_where_the_journal_states(tmp_path: Path) -> None:
    """A damaged frame is set aside, and each way to misplace its file is found."""
    events = (
        Event(400, "disk:lost-file", 3),
        Event(400, "disk:rot", 1),
        Event(420, "program:SIGKILL"),
    )
    trial = Trial(Schedule(5, events), tmp_path)
    assert trial.run().violations == ()
    state = SessionState.read(trial.session)
    assert [event["kept"] is None for event in state.set_aside_events] == [False, True]
    assert list(misplaced(state)) == []
    (path,) = trial.session.glob("derived/set_aside/*")
    path.rename(path.with_name("other"))
    (trial.session / "frames" / "more.tif").touch()
    found = list(misplaced(SessionState.read(trial.session)))
    assert [text.split(" ", 1)[1][:30] for text in found] == [
        "was set aside without an event",
        "is missing, although an event ",
        "but no line that counts has th",
    ]


def test_a_program_of_an_operator_may_not_complete_without_what_it_rejected(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    refused: list[str] = []
    complete = SessionWriter.complete

    def noted(writer: SessionWriter) -> None:
        try:
            complete(writer)
        except DataError as error:
            refused.append(str(error))
            raise

    monkeypatch.setattr(trial, "_BY_HAND", 1)
    monkeypatch.setattr(SessionWriter, "complete", noted)
    for seed in range(4):
        events = Event(500, "program:second"), Event(505, "program:SIGKILL")
        assert run(Schedule(seed, events)).violations == ()
    assert any("take them before completing" in text for text in refused)


def test_a_stray_trigger_comes_whatever_the_board_does() -> None:
    history = LightHistory()
    history.pulse(2000)
    history.disturb(1500)
    history.pulse(500)
    history.put_out(1000)
    seen = LightView(history, lambda: None).triggers()
    assert [pulse.time_ns for pulse in seen] == [500, 1500]


def test_a_fault_may_wait_for_a_later_program(tmp_path: Path) -> None:
    events = Event(10, "program:SIGKILL", after=2), Event(300, "program:SIGKILL")
    trial = Trial(Schedule(2, events), tmp_path)
    outcome = trial.run()
    # The second one ends well, and there is no third.
    assert (outcome.programs, len(outcome.met)) == (2, 1)
    (tmp_path / "more").mkdir()
    trial = Trial(Schedule(2, (*events, Event(20, "program:SIGKILL", after=1))), tmp_path / "more")
    outcome = trial.run()
    assert (outcome.programs, len(outcome.met)) == (4, 3)


# Schedules that broke a promise, and what was wrong.
FOUND = {
    "a zero in place of the last newline made the journal damaged": Schedule(
        100620, (Event(485, "host:power-loss"),)
    ),
    "a stray trigger at the right distance took the place of the first one of a run": Schedule(
        320043,
        (
            Event(94, "board:lose-trigger", 151, flush=True),
            Event(151, "board:reset", 138, flush=True),
            Event(297, "wire:stray-trigger", 51),
        ),
    ),
    "the file of a write that failed after its rename stayed in a complete session": Schedule(
        79, (Event(168, "program:SIGKILL"), Event(224, "disk:flush-fails", 1, 1, flush=True))
    ),
}


@pytest.mark.parametrize("schedule", FOUND.values(), ids=FOUND)
def test_what_was_found_stays_repaired(schedule: Schedule) -> None:
    assert run(schedule).violations == ()


def test_a_folder_that_a_killed_program_created_becomes_durable(tmp_path: Path) -> None:
    for step in range(1, 20):
        (tmp_path / str(step)).mkdir()
        world = World(Schedule(step, (Event(step, "program:SIGKILL"),)), tmp_path / str(step))
        folder = world.disk.root / "owl" / "frames"
        for name in ("killed", "next"):
            world.run(name, lambda folder=folder: make_folder(folder))
        world.disk.power_loss()
        assert folder.is_dir(), step


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["host:power-loss", "program:SIGKILL", "program:SIGTERM"])
def test_an_end_at_every_sixteenth_step_is_survived(kind: str) -> None:
    for step in range(100, 1000, 16):
        outcome = run(Schedule(step, (Event(step, kind),)))
        assert outcome.violations == (), step


def test_an_led_that_is_on_at_off_was_on_since_its_on(tmp_path: Path) -> None:
    """Seed 7666: a frame was recorded although its LED went out when its exposure began."""
    for reset_ms in range(100, 800, 15):
        (tmp_path / str(reset_ms)).mkdir()
        world = World(CALM, tmp_path / str(reset_ms))
        world.board.extra_ns = 140_000_000  # ON is sent again before its reply arrives
        seen: list[int | None] = []

        def shoots(world: World = world, reset_ms: int = reset_ms, seen: list[Any] = seen) -> None:
            def restarts() -> None:
                clock.sleep(reset_ms / 1000)
                world.board.reset()

            board = Board("world")
            threads.Thread(target=restarts, daemon=True).start()
            with suppress(BoardError):
                board.on(2, 5000)
                begins_ns = clock.monotonic_ns()
                clock.sleep(0.15)
                ends_ns = clock.monotonic_ns()
                if board.off().led == 2:
                    seen.extend((begins_ns, ends_ns))

        assert world.run("program", shoots).error is None
        lit = world.board.history.lit
        for begins_ns, ends_ns in zip(seen[::2], seen[1::2], strict=True):
            assert any(p.start_ns <= begins_ns and ends_ns <= p.end_ns for p in lit), reset_ms


def test_the_second_operator_is_refused_or_has_the_session_alone(tmp_path: Path) -> None:
    refused = set()
    for seed in range(12):
        lines = lines_of(Schedule(seed, (Event(300, "program:second"),)), tmp_path / str(seed))
        refused |= {line.partition("second: ")[2] for line in lines if "second: " in line}
    assert any("another process is recording into this session" in text for text in refused)
    assert any("the port is in use" in text for text in refused)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        pytest.param({"version": VERSION + 1}, "version", id="another version"),
        pytest.param({"events": [{"step": 1, "kind": "meteor"}]}, "unknown event", id="unknown"),
        pytest.param({"events": [{"when": 1}]}, "is not a schedule file", id="another key"),
        pytest.param({"seed": None}, "is not a schedule file", id="no seed"),
    ],
)
def test_a_schedule_file_is_checked(
    change: dict[str, object], message: str, tmp_path: Path
) -> None:
    path = tmp_path / "schedule.json"
    path.write_text(json.dumps(json.loads(CALM.to_json()) | change))
    with pytest.raises(DataError, match=message):
        Schedule.read(path)


def test_real_time_in_a_world_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # A function of this module that takes the time from the operating system.
    inside: dict[str, Any] = {"__name__": protocol.__name__, "time": time}
    exec("def crc16(data): return time.monotonic()", inside)
    monkeypatch.setattr(protocol, "crc16", inside["crc16"])
    world = World(CALM, tmp_path)
    ended = world.run("program", world.open_rig)
    assert "rig.board.protocol calls time.monotonic: use rig.host.clock" in str(ended.error)


def waits_for_ever() -> None:
    condition = threads.Condition()
    with condition:
        condition.wait()


def test_a_deadlock_is_named_and_leaves_nothing(tmp_path: Path) -> None:
    world = World(CALM, tmp_path)
    opened: list[int] = []

    def leaves_all_open() -> None:
        lights_off.watch(lambda: None)
        path = world.disk.root / "file"
        opened.append(filesystem.open_file(path, os.O_CREAT | os.O_WRONLY))
        waits_for_ever()

    with pytest.raises(StuckError, match="waiting forever: program main"):
        world.run("program", leaves_all_open)
    assert lights_off.watched == {}
    with pytest.raises(OSError, match="Bad file descriptor"):
        os.fstat(opened[0])


def test_a_block_is_a_program_of_the_world(tmp_path: Path) -> None:
    world = World(CALM, tmp_path)
    done: list[str] = []

    def after(seconds: float, name: str) -> None:
        clock.sleep(seconds)
        done.append(name)

    with world.inside():
        program.at_exit(lambda: done.append("exit"))
        for seconds, name in ((10, "soon"), (5000, "too late")):
            threads.Thread(target=after, args=(seconds, name)).start()
        clock.sleep(3000)
        done.append("main")
    assert done == ["soon", "main", "exit"]
    assert clock.sleep is time.sleep


def test_a_deadlock_in_a_block_is_named(tmp_path: Path) -> None:
    world = World(CALM, tmp_path)
    with pytest.raises(StuckError, match="waiting forever: block main"), world.inside():
        waits_for_ever()
    assert clock.sleep is time.sleep


@pytest.mark.parametrize("answers", [True, False], ids=["plugged in", "unplugged"])
def test_another_board_may_be_connected_and_unplugged(tmp_path: Path, answers: bool) -> None:
    world = World(CALM, tmp_path)
    with world.inside():
        world.connect(4)
        board = Board(world.board.port)
        assert board.identity.leds == 4
        board.on(3, 2000)
        if not answers:
            world.board.unplug()
            with pytest.raises(BoardError, match="unplugged"):
                board.off()
            # The board itself ends the hold.
            assert world.board.view.led(clock.monotonic_ns()) == 3
            clock.sleep(2)
        else:
            world.board.set_faults(BoardFault(kind="drop-reply", verb="OFF"))
            assert board.off().led == 3
        assert world.board.view.led(clock.monotonic_ns()) is None
        board.close()


def test_time_passes_without_waiting(tmp_path: Path) -> None:
    world = World(CALM, tmp_path)
    began_s = time.monotonic()
    slept: list[float] = []

    def sleeps() -> None:
        before_s = clock.monotonic()
        clock.sleep(3000)
        slept.append(clock.monotonic() - before_s)

    world.run("program", sleeps)
    assert slept[0] == pytest.approx(3000, abs=0.01)
    assert time.monotonic() - began_s < 300


def test_outside_a_world_the_system_is_used(tmp_path: Path) -> None:
    world = World(CALM, tmp_path)
    world.run("program", lambda: None)
    assert clock.sleep is time.sleep
    assert threads.Thread is threading.Thread


def test_what_was_flushed_survives_a_power_loss(tmp_path: Path) -> None:
    for seed in range(30):
        root = tmp_path / str(seed)
        root.mkdir()
        disk = disk_in(root, seed)
        descriptor = disk.open_file(root / "a", os.O_WRONLY | os.O_CREAT)
        disk.write(descriptor, b"safe")
        disk.fsync(descriptor)
        folder = disk.open_file(root, os.O_RDONLY)
        disk.fsync(folder)
        disk.write(descriptor, b"more")
        disk.close(descriptor)
        disk.replace(root / "a", root / "b")
        disk.close(folder)
        disk.power_loss()
        (path,) = root.iterdir()
        assert path.name in "ab"
        data = path.read_bytes()
        assert data.startswith(b"safe")
        assert b"more".startswith(data[4:].rstrip(b"\0"))


def test_what_was_not_flushed_may_be_lost(tmp_path: Path) -> None:
    left = set()
    for seed in range(60):
        root = tmp_path / str(seed)
        root.mkdir()
        disk = disk_in(root, seed)
        descriptor = disk.open_file(root / "a", os.O_WRONLY | os.O_CREAT)
        disk.write(descriptor, b"more")
        disk.close(descriptor)
        disk.power_loss()
        left.add(*[path.read_bytes() for path in root.iterdir()] or [None])
    assert {None, b"", b"more", b"mor\0"} <= left
    assert len(left) > 5  # torn


@given(
    st.lists(
        st.tuples(
            st.sampled_from(("write", "replace", "unlink", "mkdir", "sync")),
            st.sampled_from("abc"),
            st.sampled_from("abc"),
        ),
        max_size=30,
    )
)
def test_the_model_has_the_files_of_the_disk(
    tmp_path_factory: pytest.TempPathFactory, calls: list[tuple[str, str, str]]
) -> None:
    root = tmp_path_factory.mktemp("disk")
    disk = disk_in(root)
    for call, one, other in calls:
        path = root / one
        if call == "mkdir" and not path.exists():
            disk.mkdir(path)
        elif call == "write" and not path.is_dir():
            descriptor = disk.open_file(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
            disk.write(descriptor, other.encode())
            disk.close(descriptor)
        elif call == "unlink" and path.is_file():
            disk.unlink(path)
        elif call == "replace" and path.is_file() and not (root / other).is_dir():
            disk.replace(path, root / other)
        elif call == "sync":
            folder = disk.open_file(root, os.O_RDONLY)
            disk.fsync(folder)
            disk.close(folder)
    real = {path.name: path.read_bytes() if path.is_file() else None for path in root.iterdir()}
    assert disk.shown() == real
