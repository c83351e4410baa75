"""A recording whose board or camera is gone for a while."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from acquisition import CapturePlan, NoiseModel, RecordingHooks, Session, record, verify_session
from acquisition.engine import StopRequest, resume
from acquisition.engine.recording_loop import _LOSSES_IN_A_ROW
from acquisition.session.event_details import details_complaint
from acquisition.session.journal import CAMERA_SETTINGS
from rig import BoardGoneError, CameraGoneError, DeviceGoneError, Rig, open_bench, read_rig_config
from rig.genicam import IsolatedCamera
from rig.host import clock, threads
from rig.rigs import rig as open_rig
from simulator.camera import GentlCamera
from simulator.gentl import CompilerError
from simulator.led_board import BoardFault, VirtualBoard
from simulator.world import Schedule, World
from tests.acquisition.fake_bench import LABELS
from tests.rig.camera_benches import AwaitedTime
from tests.simulator.camera_options import grouped

LEDS = 6
PLAN = CapturePlan(repeat=False, leds=tuple(range(LEDS)), exposures_us=(4000.0,))
Record = Callable[..., Session]


def reported(session: Session) -> list[str]:
    """Return the events of the journal, with the device that each concerns."""
    events = [one for one in session.events if one.event != CAMERA_SETTINGS]
    return [f"{one.event} {one.details.get('device', '')}".strip() for one in events]


def after(frames: int, act: Callable[[], None], **others: Any) -> RecordingHooks:
    """Return hooks that act once so many frames are safe."""
    lines: list[object] = []

    def on_frame(line: object) -> None:
        lines.append(line)
        if len(lines) == frames:
            act()

    return RecordingHooks(on_frame=on_frame, **others)


@pytest.fixture
def opened(tmp_path: Path) -> Iterator[tuple[World, Rig]]:
    """A world and its open rig."""
    world = World(Schedule(1, ()), tmp_path, leds=LEDS)
    with world.inside(), world.open_rig() as rig:
        yield world, rig


@pytest.mark.parametrize("device", ["board", "camera"])
def test_the_loss_is_told_and_is_no_retake(
    opened: tuple[World, Rig], tmp_path: Path, device: str
) -> None:
    world, rig = opened
    unplug = {"board": world.unplug_board, "camera": world.unplug_camera}[device]
    seen: list[str] = []
    hooks = after(3, lambda: unplug(12.0), on_event=lambda name, details: seen.append(name))
    session = record(rig, PLAN, tmp_path / "s", LABELS, hooks=hooks)
    assert session.complete
    assert reported(session) == [f"device_lost {device}", f"device_returned {device}"]
    assert seen == ["device_lost", "device_returned"]
    lost, returned = (dict(line.details) for line in session.events)
    assert device in lost["reason"]
    assert 11 < returned["seconds"] < 14
    assert verify_session(tmp_path / "s").ok


@pytest.mark.parametrize("device", ["board", "camera"])
def test_a_device_that_stays_away_ends_a_recording_that_can_be_resumed(
    opened: tuple[World, Rig], tmp_path: Path, device: str
) -> None:
    world, rig = opened
    unplug = {"board": world.unplug_board, "camera": world.unplug_camera}[device]
    began_s = clock.monotonic()
    with pytest.raises(DeviceGoneError) as error:
        record(rig, PLAN, tmp_path / "s", LABELS, hooks=after(3, lambda: unplug(100.0)))
    assert 30 < clock.monotonic() - began_s < 33
    assert any(one.startswith("on opening it again") for one in error.value.__notes__)
    session = Session.open(tmp_path / "s")
    assert reported(session) == [f"device_lost {device}", "failed"]
    clock.sleep(70)
    rig.recover(error.value)
    assert resume(rig, tmp_path / "s").complete


def test_a_rig_file_may_turn_it_off(opened: tuple[World, Rig], tmp_path: Path) -> None:
    world, rig = opened
    rig.config = rig.config.model_copy(update={"reconnect_s": 0.0})
    hooks = after(3, lambda: world.unplug_camera(1.0))
    with pytest.raises(CameraGoneError):
        record(rig, PLAN, tmp_path / "s", LABELS, hooks=hooks)
    assert reported(Session.open(tmp_path / "s")) == ["failed"]


def test_a_stop_ends_the_wait(opened: tuple[World, Rig], tmp_path: Path) -> None:
    world, rig = opened
    stop, times = StopRequest(), list[float]()

    def ask() -> None:
        clock.sleep(5)
        times.append(clock.monotonic())
        stop.ask("a button")

    def on_event(name: str, details: object) -> None:
        if name == "device_lost":
            threads.Thread(target=ask).start()

    hooks = after(3, lambda: world.unplug_board(20.0), on_event=on_event)
    with pytest.raises(KeyboardInterrupt, match="stopped by a button while the board was gone"):
        record(rig, PLAN, tmp_path / "s", LABELS, hooks=hooks, stop=stop)
    assert clock.monotonic() - times[0] < 0.3
    session = Session.open(tmp_path / "s")
    assert reported(session) == ["device_lost board", "interrupted"]
    assert len(session.frames) >= 3
    with pytest.raises(BoardGoneError):
        rig.off()
    clock.sleep(20)
    rig.recover(BoardGoneError())


def test_a_device_that_is_gone_at_every_shot_is_broken(
    opened: tuple[World, Rig], tmp_path: Path
) -> None:
    world, rig = opened
    lost: list[str] = []

    def on_event(name: str, details: object) -> None:
        lost.extend([name] if name == "device_lost" else [])
        if name == "device_returned":
            world.unplug_camera(0.1)

    hooks = after(3, lambda: world.unplug_camera(0.1), on_event=on_event)
    with pytest.raises(CameraGoneError) as error:
        record(rig, PLAN, tmp_path / "s", LABELS, hooks=hooks)
    assert len(lost) == _LOSSES_IN_A_ROW
    rig.recover(error.value)


def test_losses_with_frames_in_between_do_not_add_up(
    opened: tuple[World, Rig], tmp_path: Path
) -> None:
    world, rig = opened
    plan = PLAN.changed(exposures_us=(4000.0, 16_000.0))
    lines: list[object] = []

    def on_frame(line: object) -> None:
        lines.append(line)
        if len(lines) <= _LOSSES_IN_A_ROW + 1:
            world.unplug_camera(0.1)

    hooks = RecordingHooks(on_frame=on_frame)
    session = record(rig, plan, tmp_path / "s", LABELS, hooks=hooks)
    assert session.complete
    assert reported(session).count("device_returned camera") == _LOSSES_IN_A_ROW + 1


@pytest.mark.parametrize(
    ("event", "details", "valid"),
    [
        ("device_lost", {"device": "board", "reason": "no answer"}, True),
        ("device_lost", {"device": "lamp", "reason": "no answer"}, False),
        ("device_lost", {"device": "camera"}, False),
        ("device_returned", {"device": "camera", "seconds": 0.5}, True),
        ("device_returned", {"device": "camera", "seconds": -1.0}, False),
    ],
)
def test_the_details_follow_the_format(event: str, details: dict[str, Any], valid: bool) -> None:
    assert (details_complaint(event, details, 5) is None) == valid
    assert details_complaint(event, details, 2) is None


# Real processes: a board behind a pty, a camera behind a GenTL producer.
SIZE = (4, 6)


def _plane(led: int | None) -> np.ndarray:
    return np.full(SIZE, 0.0 if led is None else (led + 1) / 40, np.float32)


class _Bench:
    """A virtual board and camera, as a rig file of the driver ``bench``."""

    def __init__(self, stack: ExitStack, folder: Path, *, trigger: str, isolate: bool) -> None:
        self.board = stack.enter_context(VirtualBoard(LEDS))
        noise = NoiseModel(1.0, 0.0, 0.0, 12)
        options = grouped(
            size=SIZE,
            leds=LEDS,
            noise=noise,
            noisy=False,
            bench_state_path=self.board.bench_state_path,
        )
        try:
            self.camera = stack.enter_context(GentlCamera(_plane, **options))
        except CompilerError as error:
            pytest.skip(str(error))
        file = folder / "rig.toml"
        file.write_text(
            f'name = "b"\ndriver = "bench"\nleds = {LEDS}\ntrigger = "{trigger}"\n'
            "settle_ms = 0.5\nframe_timeout_s = 0.5\nframe_period_ms = 50\nreconnect_s = 60\n"
            f'[options]\nport = "{self.board.port}"\ncti = "{self.camera.cti}"\n'
            f"isolate = {str(isolate).lower()}\n"
        )
        self.rig = stack.enter_context(open_bench(read_rig_config(file)))

    def replug(self, name: str, details: Any) -> None:
        """Plug the camera in again a moment after the recording has noticed its loss."""
        if name == "device_lost" and details["device"] == "camera":
            threading.Timer(0.1, self.camera.replug).start()


def _check(session: Session, plan: CapturePlan) -> None:
    assert session.complete
    assert verify_session(session.folder).ok
    for frame in session.frames:
        pixels = frame.read()
        assert (pixels == 100 * (0 if frame.led is None else frame.led + 1)).all(), frame.path
    assert len(session.frames) == len(plan.shots())


_REAL = [
    pytest.param("software", False, id="software"),
    pytest.param("board", False, id="sequence", marks=pytest.mark.slow),
    pytest.param("software", True, id="isolated", marks=pytest.mark.slow),
    pytest.param("board", True, id="isolated-sequence", marks=pytest.mark.slow),
]


@pytest.mark.parametrize(("trigger", "isolate"), _REAL)
def test_board_and_camera_are_unplugged_and_come_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, trigger: str, isolate: bool
) -> None:
    monkeypatch.setattr(open_rig, "_AGAIN_AFTER_S", 0.1)
    # A camera that is gone is noticed when its frame does not come.
    AwaitedTime(monkeypatch, 2)
    plan = PLAN.changed(sequence=trigger == "board")
    with ExitStack() as stack:
        bench = _Bench(stack, tmp_path, trigger=trigger, isolate=isolate)
        # Exposures are counted since the camera was made, retakes included.
        bench.camera.set_fault(4, "unplug")
        verb = "DID" if trigger == "board" else "OFF"
        bench.board.set_faults(BoardFault(kind="hang-up", verb=verb, skip=2, value=100))
        hooks = RecordingHooks(on_event=bench.replug)
        session = record(bench.rig, plan, tmp_path / "s", LABELS, hooks=hooks)
        _check(session, plan)
        events = reported(session)
        assert events.count("device_lost board") == events.count("device_returned board") == 1
        assert events.count("device_lost camera") == events.count("device_returned camera") == 1


@pytest.mark.slow
@pytest.mark.parametrize("trigger", ["software", "board"])
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP], ids=["dies", "hangs"])
def test_a_producer_that_fails_is_started_again(
    tmp_path: Path, trigger: str, number: signal.Signals
) -> None:
    plan = PLAN.changed(sequence=trigger == "board")
    with ExitStack() as stack:
        bench = _Bench(stack, tmp_path, trigger=trigger, isolate=True)

        def fail() -> None:
            assert isinstance(bench.rig.camera, IsolatedCamera)
            os.kill(bench.rig.camera.pid, number)

        session = record(bench.rig, plan, tmp_path / "s", LABELS, hooks=after(3, fail))
        _check(session, plan)
        assert reported(session) == ["device_lost camera", "device_returned camera"]
