"""Dead LEDs, and shots that are taken again."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from acquisition import CapturePlan, RecordingHooks, Session, record, verify_session
from acquisition.session import writer as _session_writer
from rig import CameraError, RigError
from rig import Rig as RealRig
from rig.arrays import UInt16
from tests.acquisition.fake_bench import LABELS, PLAN, Bench, events_of, seen


def test_leds_listed_as_dead_are_left_out_reported_and_recorded(
    rig: RealRig, bench: Bench, tmp_path: Path
) -> None:
    reported: list[tuple[str, Any]] = []
    plan = CapturePlan(repeat=False, leds=(3, 4, 5), exposures_us=(100.0,))
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
    bench.unplug_at(number)
    session = record(rig, PLAN.changed(retakes=1), tmp_path / "s", LABELS)
    assert session.complete
    assert [line.event for line in events_of(session)] == ["retake"]
    assert events_of(session)[0].details["reason"] == "the camera was unplugged"
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


def test_the_journal_has_the_order_of_the_plan(
    rig: RealRig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Even if a later frame is on disk first."""
    real = _session_writer.store_frame
    second_is_there = threading.Event()

    def uneven(path: Path, pixels: UInt16) -> Any:
        if path.name.startswith("D_200us"):
            assert second_is_there.wait(60)
        stored = real(path, pixels)
        second_is_there.set()
        return stored

    monkeypatch.setattr(_session_writer, "store_frame", uneven)
    session = record(rig, PLAN, tmp_path / "s", LABELS)
    assert [frame.path.name for frame in session.frames] == [shot.file for shot in PLAN.shots()]


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
    plan = CapturePlan(repeat=False, leds=(3, 0, 1), exposures_us=(200.0,), flats=3, retakes=1)
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
