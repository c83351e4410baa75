"""The engine on the real `Rig` with a fake board and camera."""

from __future__ import annotations

import errno
import os
import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from acquisition import (
    Calibrations,
    CameraModel,
    CapturePlan,
    Lights,
    NoiseModel,
    RecordingHooks,
    Session,
    StorageError,
    read_image,
    record,
    verify_session,
)
from acquisition.engine import recording_run as _carry_out
from acquisition.engine import rehearse
from acquisition.session import FrameLine, SessionWriter
from rig import BoardError, CameraError, RigConfig
from rig import Rig as RealRig
from rig.arrays import Float32
from simulator.camera import ImageFormation
from tests.acquisition.fake_bench import LABELS, PLAN, Bench, events_of, seen


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


def test_on_the_simulated_rig(tmp_path: Path) -> None:
    """Real serial bytes and the board's own process; without noise the frames are predictable."""
    from simulator import simulated_rig

    sensor = NoiseModel(1.0, 0.0, 0.0, 12)
    config = RigConfig(name="sim", driver="simulated", leds=4)
    base = np.arange(48, dtype=np.float32).reshape(6, 8)

    def plane(led: int | None) -> Float32:
        return np.zeros((6, 8), np.float32) if led is None else base * 0.02 * (led + 1)

    plan = CapturePlan(repeat=False, leds=(2, 0, 3), exposures_us=(500.0,))
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


def test_a_rehearsal_takes_every_shot_with_the_leds_off(rig: RealRig, bench: Bench) -> None:
    counted: list[tuple[str, int, int]] = []
    assert rehearse(rig, PLAN, on_progress=lambda *report: counted.append(report)) > 0
    assert bench.shots == [None] * 10
    assert counted[-1] == ("dry run", 10, 10)
