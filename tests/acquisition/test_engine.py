"""The engine on the real `Rig` with a fake board and camera."""

from __future__ import annotations

import errno
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from acquisition._engine import carry_out as _carry_out
from acquisition._engine import recording as _recording
from acquisition._engine import write_queue as _write_queue
from acquisition._engine.engine import record
from acquisition._engine.hooks import RecordingHooks
from acquisition._engine.rehearsal import rehearse
from acquisition._errors import DataError, StorageError
from acquisition._pixels.images import read_image
from acquisition._plan.plan import CapturePlan
from acquisition._session import writer as _session_writer
from acquisition._session.calibrations import Calibrations
from acquisition._session.journal import FrameLine
from acquisition._session.labels import Labels
from acquisition._session.session import Session
from acquisition._session.verify import verify_session
from acquisition._session.writer import SessionWriter
from acquisition._values.camera_model import CameraModel
from acquisition._values.lights import Lights
from acquisition._values.noise_model import NoiseModel
from rig import BoardError, CameraError, CameraFrame, RigConfig, RigError
from rig import Rig as RealRig
from simulator import ImageFormation
from tests.acquisition.fake_bench import LABELS, PLAN, Bench, events_of, rig_on, seen


@pytest.fixture
def bench() -> Bench:
    return Bench()


@pytest.fixture
def rig(bench: Bench) -> Iterator[RealRig]:
    rig = rig_on(bench)
    yield rig
    bench.off_fails = False
    rig.close()


def test_a_recording(rig: RealRig, bench: Bench, tmp_path: Path) -> None:
    sensor = NoiseModel(2.0, 5.0, 64.0, 12)
    camera = CameraModel(np.array([[50.0, 0, 5], [0, 50, 3], [0, 0, 1]]), 10, 7, 300.0)
    lights = Lights(directions=np.eye(3)[[2, 2, 2, 2, 2, 2]])
    files: list[str] = []
    steps: list[tuple[str, int, int]] = []

    def on_frame(line: FrameLine) -> None:
        assert (tmp_path / "s" / line.file).exists()
        files.append(line.file)

    session = record(
        rig,
        PLAN,
        tmp_path / "s",
        replace(LABELS, notes="rim scratched"),
        calibrations=Calibrations(camera_model=camera, sensor=sensor, lights=lights),
        hooks=RecordingHooks(on_frame=on_frame, on_progress=lambda *report: steps.append(report)),
    )
    assert session.complete
    assert bench.shots == [None, None, None, None, 3, 0, 5, 3, 0, 5]
    assert bench.led is None
    assert files == [f"frames/{shot.file}" for shot in PLAN.shots()]
    assert steps == [("recording", done, 10) for done in range(1, 11)]
    for frame in session.frames:
        planned = PLAN.exposures_us[frame.bracket]
        np.testing.assert_array_equal(frame.read(), seen(frame.led, planned))
        assert frame.exposure_us == planned + 0.25
        assert frame.line.gain_db == 2.0
        assert frame.line.temperature_c == 41.5
        assert frame.line.echo is not None
        assert frame.line.echo.led == frame.led
    assert [frame.line.frame_id for frame in session.frames] == list(range(1, 11))
    manifest = session.manifest
    assert (manifest.operator, manifest.object, manifest.notes) == ("Ada", "coin", "rim scratched")
    assert manifest.plan == PLAN
    assert manifest.rig is not None
    assert (manifest.rig.name, manifest.rig.board, manifest.rig.protocol) == (
        *("bench-1", "fake-board", "2"),
    )
    assert (manifest.camera.model, manifest.camera.serial) == ("Eye", "42")
    assert (manifest.camera.black_level_dn, manifest.camera.white_dn) == (64.0, 4095.0)
    assert session.sensor == sensor
    assert session.camera_model is not None
    assert session.lights is not None
    assert verify_session(tmp_path / "s").ok


def test_quality_is_of_raw_values(rig: RealRig, tmp_path: Path) -> None:
    session = record(rig, PLAN, tmp_path / "s", LABELS)
    line = next(f.line for f in session.frames if (f.led, f.bracket) == (5, 0))
    pixels = read_image(tmp_path / "s" / line.file)
    # LED 5 at 200 us: 64 + 1200 * (1 ... 4), above 4095 in the last columns.
    assert line.clipped_fraction == np.mean(64 + 1200 * np.linspace(1, 4, 10) >= 4095)
    assert line.percentiles_dn["100"] == 4095
    assert line.percentiles_dn["0"] == 64 + 1200
    assert line.percentiles_dn["50"] == np.sort(pixels.ravel())[34]


@pytest.mark.parametrize(
    ("error", "event"),
    [
        pytest.param(KeyboardInterrupt(), "interrupted", id="ctrl-c"),
        pytest.param(SystemExit(143), "interrupted", id="sigterm"),
        pytest.param(CameraError("frame 6 did not come"), "failed", id="camera"),
        pytest.param(BoardError("unplugged"), "failed", id="board"),
        pytest.param(ZeroDivisionError("a program fault"), "failed", id="fault"),
    ],
)
def test_an_error_during_a_shot(
    rig: RealRig, bench: Bench, tmp_path: Path, error: BaseException, event: str
) -> None:
    def fail(number: int) -> None:
        if number == 6:
            raise error

    bench.on_trigger = fail
    with pytest.raises(type(error)):
        record(rig, PLAN, tmp_path / "s", LABELS)
    assert bench.led is None
    found = verify_session(tmp_path / "s")
    assert (found.ok, found.complete, found.frames, len(found.missing)) == (True, False, 5, 5)
    session = Session.open(tmp_path / "s")
    assert [line.event for line in events_of(session)] == [event]
    assert events_of(session)[0].details["leds_confirmed_off"] is True
    reasons = {"SystemExit": "the program was ended, exit code 143"}
    name = type(error).__name__
    assert events_of(session)[0].details["reason"] == reasons.get(name, str(error) or name)
    # It can be completed with exactly the missing shots.
    bench.on_trigger = lambda number: None
    with SessionWriter.reopen(tmp_path / "s") as writer:
        assert [shot.led for shot in writer.missing] == [0, 5, 3, 0, 5]


def test_an_error_in_the_callback_leaves_the_leds_off(
    rig: RealRig, bench: Bench, tmp_path: Path
) -> None:
    def stop(line: FrameLine) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        record(rig, PLAN, tmp_path / "s", LABELS, hooks=RecordingHooks(on_frame=stop))
    assert bench.led is None
    # The frames taken before are kept.
    session = Session.open(tmp_path / "s")
    assert len(session.frames) == bench.frames
    assert session.events[-1].details["leds_confirmed_off"] is True


def test_a_full_disk_turns_the_leds_off_before_anything_else(
    rig: RealRig, bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = os.write
    leds_on: list[int | None] = []

    def full(descriptor: int, data: Any) -> int:
        if bench.frames >= 6:
            if threading.current_thread() is threading.main_thread():
                leds_on.append(bench.led)
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return real(descriptor, data)

    monkeypatch.setattr(os, "write", full)
    with pytest.raises(StorageError, match="No space left"):
        record(rig, PLAN, tmp_path / "s", LABELS)
    # The last event is written by the shooting thread after the LEDs are off.
    assert set(leds_on) <= {None}
    assert bench.log[-1] == "off"
    assert bench.led is None
    monkeypatch.undo()
    found = verify_session(tmp_path / "s")
    assert (found.ok, found.complete) == (True, False)
    assert 0 < found.frames < 10


def test_leds_that_cannot_be_turned_off_are_reported_and_hide_no_error(
    rig: RealRig, bench: Bench, tmp_path: Path
) -> None:
    def fail(number: int) -> None:
        bench.off_fails = True
        raise CameraError("frame 1 did not come")

    bench.on_trigger = fail
    with pytest.raises(CameraError, match="frame 1 did not come") as caught:
        record(rig, PLAN, tmp_path / "s", LABELS)
    assert caught.value.__notes__ == ["LEDs not confirmed off: fake: OFF is not answered"]
    assert events_of(Session.open(tmp_path / "s"))[0].details["leds_confirmed_off"] is False


def test_leds_that_cannot_be_turned_off_after_a_shot_are_reported(
    rig: RealRig, bench: Bench, tmp_path: Path
) -> None:
    def stop(line: FrameLine) -> None:
        bench.off_fails = True
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt) as caught:
        record(rig, PLAN, tmp_path / "s", LABELS, hooks=RecordingHooks(on_frame=stop))
    assert caught.value.__notes__ == ["LEDs not confirmed off: fake: OFF is not answered"]
    assert Session.open(tmp_path / "s").events[-1].details["leds_confirmed_off"] is False


def test_code_is_compiled_before_an_led_is_on(
    rig: RealRig, bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real, logs = _carry_out.measure_quality, []

    def compiled(*words: Any, **more: Any) -> Any:
        logs.append([*bench.log])
        return real(*words, **more)

    monkeypatch.setattr(_carry_out, "measure_quality", compiled)
    record(rig, PLAN, tmp_path / "s", LABELS)
    assert ["on" in log for log in logs] == [False]


def test_the_writers_end_with_the_recording(rig: RealRig, tmp_path: Path) -> None:
    before = set(threading.enumerate())
    record(rig, PLAN, tmp_path / "s", LABELS)
    for thread in set(threading.enumerate()) - before:
        thread.join(10)
        assert not thread.is_alive()


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        pytest.param({"plan": CapturePlan(leds=(6,), exposures_us=(1,))}, "LED 6", id="no-led"),
        pytest.param({"plan": CapturePlan(leds=(4,), exposures_us=(1,))}, "dead", id="dead-led"),
        pytest.param(
            {"calibrations": Calibrations(camera_model=CameraModel(np.eye(3), 9, 7))},
            "9 x 7 pixels",
            id="camera",
        ),
        pytest.param(
            {"calibrations": Calibrations(sensor=NoiseModel(1.0, 1.0, 0.0, 10))},
            "10 bits",
            id="sensor",
        ),
        pytest.param({"labels": replace(LABELS, operator=None)}, "operator", id="no-operator"),
        pytest.param(
            {
                "calibrations": Calibrations(
                    lights=Lights(directions=np.eye(3), ids=("L00", "L03", "L04"))
                )
            },
            r"lights do not fit the plan: .*L05 does not",
            id="light missing",
        ),
        pytest.param(
            {"calibrations": Calibrations(lights=Lights(directions=np.eye(3)[:2]))},
            "lights do not fit the plan: 3 images for 2 lights",
            id="too few lights",
        ),
        pytest.param(
            {
                "calibrations": Calibrations(
                    lights=Lights(directions=np.eye(3), ids=("a.0", "a.1", "a.2"))
                )
            },
            "lights are named a.0 .* the LEDs of the plan L03",
            id="lights of something else",
        ),
        pytest.param({"labels": Labels("Ada", "\udc80")}, "object", id="no-text"),
    ],
)
def test_invalid_arguments_are_refused_before_a_folder_is_created(
    rig: RealRig, bench: Bench, tmp_path: Path, changed: dict[str, Any], said: str
) -> None:
    arguments: dict[str, Any] = {"plan": PLAN, "labels": LABELS, **changed}
    with pytest.raises(DataError, match=said):
        record(rig, folder=tmp_path / "s", **arguments)
    assert not (tmp_path / "s").exists()
    assert bench.frames == 0


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        pytest.param({"gain_db": 500.0}, "Gain: 500 dB", id="gain"),
        pytest.param({"exposures_us": (5.0,)}, "exposes for 10 to", id="camera's exposures"),
        pytest.param({"exposures_us": (9.99e5, 50.0)}, "LED board on fake", id="board's hold"),
    ],
)
def test_plans_that_the_rig_cannot_run_are_refused_before_a_folder_is_created(
    rig: RealRig,
    bench: Bench,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    changed: dict[str, Any],
    said: str,
) -> None:
    configure = bench.configure

    def limited(*, exposure_us: float, gain_db: float = 0.0) -> float:
        if gain_db > 24:
            raise CameraError(f"camera Eye 42, Gain: {gain_db:g} dB is not 0 to 24")
        return configure(exposure_us=exposure_us, gain_db=gain_db)

    monkeypatch.setattr(bench, "configure", limited)
    monkeypatch.setattr(bench, "identity", replace(bench.identity, max_hold_ms=900))
    with pytest.raises(RigError, match=said):
        record(rig, PLAN.changed(**changed), tmp_path / "s", LABELS)
    assert not (tmp_path / "s").exists()
    assert bench.frames == 0


def test_a_used_folder_is_refused_before_a_shot(rig: RealRig, bench: Bench, tmp_path: Path) -> None:
    record(rig, PLAN, tmp_path / "s", LABELS)
    before = {path: path.read_bytes() for path in (tmp_path / "s").rglob("*") if path.is_file()}
    taken = bench.frames
    with pytest.raises(StorageError, match="not empty"):
        record(rig, PLAN, tmp_path / "s", LABELS)
    assert bench.frames == taken
    assert {path: path.read_bytes() for path in before} == before


def test_a_camera_that_delivers_frames_of_another_size(
    rig: RealRig, bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    frame = CameraFrame(np.zeros((7, 9), np.uint16), 1, 0, 200.0, 2.0, None)
    monkeypatch.setattr(bench, "fetch", lambda *_: frame)
    with pytest.raises(DataError, match="this session requires"):
        record(rig, PLAN, tmp_path / "s", LABELS)


def test_rig_errors_are_raised_unchanged(rig: RealRig, bench: Bench, tmp_path: Path) -> None:
    bench.on_trigger = lambda number: setattr(bench, "led", None)
    with pytest.raises(RigError, match="LED 3 was requested"):
        record(rig, PLAN, tmp_path / "s", LABELS)
    assert [frame.led for frame in Session.open(tmp_path / "s").frames] == [None] * 4


def test_on_the_simulated_rig(tmp_path: Path) -> None:
    """Real serial bytes and the board's own process; without noise the frames are predictable."""
    from simulator._simulated_rig import simulated_rig

    sensor = NoiseModel(1.0, 0.0, 0.0, 12)
    config = RigConfig(name="sim", driver="simulated", leds=4)
    base = np.arange(48, dtype=np.float32).reshape(6, 8)

    def plane(led: int | None) -> npt.NDArray[np.float32]:
        return np.zeros((6, 8), np.float32) if led is None else base * 0.02 * (led + 1)

    plan = CapturePlan(leds=(2, 0, 3), exposures_us=(500.0,))
    with simulated_rig(
        plane, config, size=(6, 8), formation=ImageFormation(sensor, noisy=False)
    ) as rig:
        session = record(
            rig, plan, tmp_path / "s", LABELS, calibrations=Calibrations(sensor=sensor)
        )
    assert [frame.led for frame in session.frames] == [None, 2, 0, 3]
    for frame in session.frames:
        expected = plane(frame.led).astype(np.float64) * 500.0
        assert np.abs(frame.read() - expected).max() <= 1.0
    assert verify_session(tmp_path / "s").ok


def test_leds_listed_as_dead_are_left_out_reported_and_recorded(
    rig: RealRig, bench: Bench, tmp_path: Path
) -> None:
    reported: list[tuple[str, Any]] = []
    plan = CapturePlan(leds=(3, 4, 5), exposures_us=(100.0,))
    session = record(
        rig,
        plan,
        tmp_path / "s",
        LABELS,
        hooks=RecordingHooks(on_event=lambda name, of: reported.append((name, dict(of)))),
    )
    assert session.complete
    assert session.manifest.plan is not None
    assert session.manifest.plan.leds == (3, 5)
    assert reported == [("left_out", {"leds": [4], "reason": "listed as dead"})]
    assert [(line.event, dict(line.details)) for line in events_of(session)] == reported
    assert bench.shots == [None, 3, 5]


def test_an_led_without_light_is_named(rig: RealRig, bench: Bench, tmp_path: Path) -> None:
    bench.dead = {0}
    with pytest.raises(RigError, match=r"L00_E0\.tif: LED 0 gave no light at 200 us"):
        record(rig, PLAN, tmp_path / "s", LABELS)
    session = Session.open(tmp_path / "s")
    rejected = [frame.line for frame in session.recorded if frame.line.status == "rejected"]
    assert [line.led for line in rejected] == [0]
    assert ("light", 0, 0, 0) in [shot.key for shot in session.missing]
    assert verify_session(tmp_path / "s").ok


def test_an_led_that_lights_the_second_time_is_retaken(
    rig: RealRig, bench: Bench, tmp_path: Path
) -> None:
    bench.dead = {0}
    reported: list[str] = []

    def on_event(name: str, details: Any) -> None:
        if name == "retake":
            reported.append(details["file"])
            bench.dead = set()

    plan = PLAN.changed(retakes=1)
    session = record(rig, plan, tmp_path / "s", LABELS, hooks=RecordingHooks(on_event=on_event))
    assert session.complete
    assert "L00_E0.tif" in reported
    takes = [f.line for f in session.recorded if (f.led, f.bracket) == (0, 0)]
    assert [(line.file, line.status) for line in takes] == [
        ("frames/L00_E0.tif", "rejected"),
        ("frames/L00_E0_R1.tif", "ok"),
    ]
    for frame in session.frames:
        np.testing.assert_array_equal(
            frame.read(), seen(frame.led, PLAN.exposures_us[frame.bracket])
        )
    assert verify_session(tmp_path / "s").ok


@pytest.mark.parametrize("number", [1, 6, 10])
def test_a_shot_that_fails_once_is_taken_again(
    rig: RealRig, bench: Bench, tmp_path: Path, number: int
) -> None:
    def fail(frame: int) -> None:
        if frame == number:
            raise CameraError("frame did not come")

    bench.on_trigger = fail
    session = record(rig, PLAN.changed(retakes=1), tmp_path / "s", LABELS)
    assert session.complete
    assert [line.event for line in events_of(session)] == ["retake"]
    assert events_of(session)[0].details["reason"] == "frame did not come"
    assert bench.frames == 11
    for frame in session.frames:
        np.testing.assert_array_equal(
            frame.read(), seen(frame.led, PLAN.exposures_us[frame.bracket])
        )


def test_a_shot_that_keeps_failing_ends_the_recording(
    rig: RealRig, bench: Bench, tmp_path: Path
) -> None:
    def fail(frame: int) -> None:
        if frame >= 6:
            raise CameraError("frame did not come")

    bench.on_trigger = fail
    with pytest.raises(CameraError) as caught:
        record(rig, PLAN.changed(retakes=2), tmp_path / "s", LABELS)
    assert bench.frames == 8
    assert "L00_E0.tif was taken 3 times" in caught.value.__notes__
    session = Session.open(tmp_path / "s")
    assert [line.event for line in events_of(session)] == ["retake", "retake", "failed"]
    assert len(session.frames) == 5


def test_too_much_clipping_is_refused(rig: RealRig, bench: Bench, tmp_path: Path) -> None:
    plan = PLAN.changed(max_clipped_fraction=0.1)
    with pytest.raises(DataError, match=r"L05_E0\.tif: .* clipped at 200 us, the plan allows 10"):
        record(rig, plan, tmp_path / "s", LABELS)
    assert bench.led is None
    assert ("light", 5, 0, 0) in [shot.key for shot in Session.open(tmp_path / "s").missing]


def test_the_journal_has_the_order_of_the_plan(
    rig: RealRig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Even if a later frame is on disk first."""
    real = _session_writer.store_frame
    second_is_there = threading.Event()

    def uneven(path: Path, pixels: npt.NDArray[np.uint16]) -> Any:
        if path.name.startswith("D_200us"):
            assert second_is_there.wait(20)
        stored = real(path, pixels)
        second_is_there.set()
        return stored

    monkeypatch.setattr(_session_writer, "store_frame", uneven)
    session = record(rig, PLAN, tmp_path / "s", LABELS)
    assert [frame.path.name for frame in session.frames] == [shot.file for shot in PLAN.shots()]


class _Gate:
    """A disk that blocks all writes until the gate is opened."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.open = threading.Event()
        real = _session_writer.store_frame

        def slow(path: Path, pixels: npt.NDArray[np.uint16]) -> Any:
            assert self.open.wait(30)
            return real(path, pixels)

        monkeypatch.setattr(_session_writer, "store_frame", slow)


def test_a_slow_disk_pauses_the_shooting_and_loses_nothing(
    rig: RealRig, bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    gate = _Gate(monkeypatch)
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
    gate = _Gate(monkeypatch)
    with pytest.raises(StorageError, match=r"no write has finished for 0.3 s, 6 writes"):
        record(rig, PLAN, tmp_path / "s", LABELS, stall_s=0.3)
    assert bench.led is None
    assert bench.frames == _recording.ROOM
    # The stuck writer still holds the lock, and its frame does not count.
    with pytest.raises(StorageError, match="another process"):
        SessionWriter.reopen(tmp_path / "s")
    gate.open.set()
    deadline = threading.Event()
    for _ in range(200):
        try:
            SessionWriter.reopen(tmp_path / "s").close()
        except StorageError:
            deadline.wait(0.05)
        else:
            break
    session = Session.open(tmp_path / "s")
    assert session.frames == ()
    assert verify_session(tmp_path / "s").ok
    assert session.events[-1].event == "reopened"


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


def test_ctrl_c_twice_does_not_wait_for_a_stuck_disk(
    rig: RealRig, bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    gate = _Gate(monkeypatch)

    def press_soon(number: int) -> None:
        if number == 2:
            for wait_s in (0.3, 0.6):
                threading.Timer(wait_s, os.kill, (os.getpid(), signal.SIGINT)).start()

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
    gate = _Gate(monkeypatch)

    def fail(number: int) -> None:
        if number == 3:
            raise CameraError("the camera was unplugged")

    bench.on_trigger = fail
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

    def slow(path: Path, pixels: npt.NDArray[np.uint16]) -> Any:
        time.sleep(0.1)
        return real(path, pixels)

    def fail(number: int) -> None:
        if number == 5:
            raise CameraError("the camera was unplugged")

    monkeypatch.setattr(_session_writer, "store_frame", slow)
    monkeypatch.setattr(_carry_out, "_PATIENCE_S", 0.0)
    bench.on_trigger = fail
    with pytest.raises(CameraError):
        record(rig, PLAN, tmp_path / "s", LABELS)
    session = Session.open(tmp_path / "s")
    assert len(session.frames) == 4
    assert [line.event for line in events_of(session)] == ["failed"]


def test_a_disk_counts_as_stuck_after_half_a_minute(
    rig: RealRig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = SimpleNamespace(monotonic=lambda: 20 * time.monotonic())
    monkeypatch.setattr(_write_queue, "time", clock)
    gate = _Gate(monkeypatch)
    # It is checked twice a second, every 10 s of this clock.
    with pytest.raises(StorageError, match=r"no write has finished for [345]\d\.\d s"):
        record(rig, PLAN, tmp_path / "s", LABELS)
    gate.open.set()


def test_ctrl_c_at_the_last_shot_finds_a_complete_recording(
    rig: RealRig, bench: Bench, tmp_path: Path
) -> None:
    bench.on_trigger = lambda n: os.kill(os.getpid(), signal.SIGINT) if n == 10 else None
    assert record(rig, PLAN, tmp_path / "s", LABELS).complete


def test_flats_wait_for_the_card(rig: RealRig, bench: Bench, tmp_path: Path) -> None:
    shots_before: list[int] = []
    plan = PLAN.changed(flats=2)
    session = record(
        rig,
        plan,
        tmp_path / "s",
        LABELS,
        hooks=RecordingHooks(before_flats=lambda: shots_before.append(bench.frames)),
    )
    assert shots_before == [10]
    assert bench.shots[10:] == [3, 0, 3, 0]
    assert [frame.role for frame in session.frames][10:] == ["flat"] * 4
    assert verify_session(tmp_path / "s").ok


@pytest.mark.parametrize("led", [1, 3, 0])
def test_retakes_are_taken_before_the_white_card(
    rig: RealRig, bench: Bench, tmp_path: Path, led: int
) -> None:
    """One LED fails once: first, last or between the lights, and once among the flats."""
    card: list[int] = []
    bench.dead = {led}

    def light_again(number: int) -> None:
        before = bench.shots[card[0] :] if card else bench.shots
        bench.dead = {led} if before.count(led) == 1 and bench.led == led else set()

    bench.on_trigger = light_again
    plan = CapturePlan(leds=(3, 0, 1), exposures_us=(200.0,), flats=3, retakes=1)
    session = record(
        *(rig, plan, tmp_path / "s"),
        LABELS,
        hooks=RecordingHooks(before_flats=lambda: card.append(bench.frames)),
    )
    assert session.complete
    assert card == [5]
    assert bench.shots == [None, 3, 0, 1, led, 3, 0, 1, led]
    roles = [frame.role for frame in session.recorded]
    assert roles == ["dark"] + ["light"] * 4 + ["flat"] * 4


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


def test_a_sequence_that_the_rig_cannot_run_is_reported(
    rig: RealRig, bench: Bench, tmp_path: Path
) -> None:
    session = record(rig, PLAN.changed(sequence=True), tmp_path / "s", LABELS)
    assert [line.event for line in events_of(session)] == ["not_sequenced"]
    assert "trigger = 'software'" in str(events_of(session)[0].details["reason"])


def test_a_rehearsal_takes_every_shot_with_the_leds_off(rig: RealRig, bench: Bench) -> None:
    counted: list[tuple[str, int, int]] = []
    assert rehearse(rig, PLAN, on_progress=lambda *report: counted.append(report)) > 0
    assert bench.shots == [None] * 10
    assert counted[-1] == ("dry run", 10, 10)


def _plane(led: int | None) -> npt.NDArray[np.float32]:
    base = np.arange(48, dtype=np.float32).reshape(6, 8)
    return np.zeros((6, 8), np.float32) if led is None else base * np.float32(0.01 * (led + 1))


def _sequenced_rig() -> RealRig:
    from simulator._simulated_rig import simulated_rig

    config = RigConfig(name="sim", driver="simulated", leds=12, trigger="board", settle_ms=0.5)
    sensor = NoiseModel(1.0, 0.0, 0.0, 12)
    return simulated_rig(
        _plane, config, size=(6, 8), camera="inside", formation=ImageFormation(sensor, noisy=False)
    )


SEQUENCE = CapturePlan(leds=tuple(range(12)), exposures_us=(500.0, 300.0), sequence=True)


def test_a_sequence_is_recorded(tmp_path: Path) -> None:
    with _sequenced_rig() as rig:
        session = record(rig, SEQUENCE, tmp_path / "s", LABELS)
    files = [frame.path.name for frame in session.frames]
    assert files == [shot.file for shot in SEQUENCE.shots()]
    assert events_of(session) == []
    for frame in session.frames:
        expected = _plane(frame.led).astype(np.float64) * SEQUENCE.exposures_us[frame.bracket]
        assert np.abs(frame.read() - expected).max() <= 1.0
    assert verify_session(tmp_path / "s").ok


def test_a_sequence_too_fast_for_the_disk_is_ended_and_restarted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    gate = _Gate(monkeypatch)

    def on_event(name: str, details: Any) -> None:
        if name == "paused":
            assert rig.board.status().led is None
            gate.open.set()

    with _sequenced_rig() as rig:
        session = record(
            rig, SEQUENCE, tmp_path / "s", LABELS, hooks=RecordingHooks(on_event=on_event)
        )
    assert session.complete
    assert [line.event for line in session.events][:2] == ["paused", "resumed"]
    files = [frame.path.name for frame in session.frames]
    assert files == [shot.file for shot in SEQUENCE.shots()]
    for frame in session.frames:
        expected = _plane(frame.led).astype(np.float64) * SEQUENCE.exposures_us[frame.bracket]
        assert np.abs(frame.read() - expected).max() <= 1.0
