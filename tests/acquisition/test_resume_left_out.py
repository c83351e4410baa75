"""LEDs that died during an interruption: their shots are left out."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from acquisition import (
    CapturePlan,
    DataError,
    RecordingHooks,
    Session,
    read_source,
    resume,
    verify_session,
)
from acquisition.engine import check_resume
from acquisition.session import CameraRecord, Manifest, SessionWriter, compact_session
from rig import CameraError, Rig
from tests.acquisition.fake_bench import PLAN, Bench, cut, events_of, rig_on
from tests.acquisition.interruptions import fail_after, interrupted, make_older
from tests.acquisition.mutants import rows_of, seal


def _of_led(session: Session, led: int) -> list[str]:
    return [shot.file for shot in session.left_out if shot.led == led]


# Shots 5 to 7 are LEDs 3, 0, 5 in the first bracket, 8 to 10 in the second, 11 and 12 flats.
@pytest.mark.parametrize(
    ("at", "left_out"),
    [
        pytest.param(6, ["L00_E0.tif", "L00_E1.tif", "F_E0_R1.tif", "F_E1_R1.tif"], id="before"),
        pytest.param(9, ["L00_E1.tif", "F_E0_R1.tif", "F_E1_R1.tif"], id="between brackets"),
        pytest.param(10, ["F_E0_R1.tif", "F_E1_R1.tif"], id="before its flats"),
    ],
)
def test_an_led_that_died_since_is_left_out(
    rig: Rig, bench: Bench, tmp_path: Path, at: int, left_out: list[str]
) -> None:
    plan = PLAN.changed(flats=2)
    cut(rig, bench, tmp_path / "s", at, plan)
    bench.dead = {0}
    reported: list[tuple[str, Any]] = []
    counted: list[tuple[str, int, int]] = []
    with rig_on(bench, dead_leds=(0, 4)) as knowing:
        _, _, missing = check_resume(knowing, tmp_path / "s", plan)
        session = resume(
            knowing,
            tmp_path / "s",
            plan=plan,
            hooks=RecordingHooks(
                on_event=lambda name, details: reported.append((name, dict(details))),
                on_progress=lambda *report: counted.append(report),
            ),
        )
    assert 0 not in bench.shots
    assert [shot.led for shot in missing] == bench.shots
    assert ("left_out", {"leds": [0], "reason": "listed as dead"}) in reported
    assert session.complete
    assert session.missing == ()
    assert _of_led(session, 0) == [shot.file for shot in session.left_out] == left_out
    assert len(session.frames) == 14 - len(left_out)
    recorded = [step for step in counted if step[0] == "recording"]
    assert recorded[-1] == ("recording", *(14 - len(left_out),) * 2)
    events = [line.event for line in events_of(session)]
    assert events == ["failed", "reopened", "left_out"]
    assert session.manifest.plan == plan
    assert session.manifest.rig is not None
    assert session.manifest.rig.dead_leds == (4,)
    found = verify_session(tmp_path / "s")
    assert (found.ok, found.complete, found.missing) == (True, True, ())
    assert list(found.left_out) == left_out
    warnings = read_source(tmp_path / "s").warnings
    assert any("left out because this LED failed: 0" in line for line in map(str, warnings))
    assert not any("missing" in line for line in map(str, warnings))
    # It stays complete after compaction, and no reader reports a missing shot.
    assert compact_session(tmp_path / "s").complete


def test_left_out_shots_stay_left_out_after_another_interruption(
    rig: Rig, bench: Bench, tmp_path: Path
) -> None:
    interrupted(rig, bench, tmp_path / "s", 6)
    last = bench.frames + 1
    bench.on_trigger = lambda number: fail_after(number, last)
    with rig_on(bench, dead_leds=(0, 4)) as knowing, pytest.raises(CameraError):
        resume(knowing, tmp_path / "s")
    bench.on_trigger = lambda number: None
    session = Session.open(tmp_path / "s")
    assert not session.complete
    assert [shot.led for shot in session.missing] == [3, 5]
    with SessionWriter.reopen(tmp_path / "s") as writer:
        assert writer.missing == session.missing
        assert writer.shots.demanded == 8
    bench.shots.clear()
    session = resume(rig, tmp_path / "s")
    assert session.complete
    assert bench.shots == [3, 5]
    assert [line.event for line in session.events].count("left_out") == 1


def test_missing_shots_of_working_leds_are_still_required(
    rig: Rig, bench: Bench, tmp_path: Path
) -> None:
    interrupted(rig, bench, tmp_path / "s", 6)
    with SessionWriter.reopen(tmp_path / "s") as writer:
        writer.write_event("left_out", leds=[0], reason="listed as dead")
        with pytest.raises(DataError, match=r"3 planned frames are missing, first L05_E0"):
            writer.complete()
    # An LED that was dead at the start cannot work later, and at least one must work.
    for dead, said in (
        ((), r"rig dead_leds was \(4,\) and is \(\)"),
        ((0, 3, 4, 5), "every LED of leds is marked dead"),
    ):
        with rig_on(bench, dead_leds=dead) as other, pytest.raises(DataError, match=said):
            resume(other, tmp_path / "s")
    assert bench.shots == []


@pytest.mark.parametrize(
    ("version", "event", "complete"),
    [
        pytest.param(3, "left_out", True, id="version 3"),
        pytest.param(2, "left_out", True, id="version 2"),
        pytest.param(1, "left_out", False, id="version 1 has no such event"),
        pytest.param(3, "left_in", False, id="another event"),
    ],
)
def test_which_events_leave_shots_out(
    tmp_path: Path, version: int, event: str, complete: bool
) -> None:
    with two_lights(tmp_path / "s") as writer:
        writer.write_event(event, leds=[1], reason="it went out")
    make_older(tmp_path / "s", version)
    session = Session.open(tmp_path / "s")
    assert [shot.led for shot in session.missing] == ([] if complete else [1])
    assert [shot.led for shot in session.left_out] == ([1] if complete else [])


def two_lights(folder: Path) -> SessionWriter:
    """Start a session of two lights and write the first."""
    manifest = Manifest.begin(
        folder,
        plan=CapturePlan(repeat=False, leds=(0, 1), exposures_us=(10.0,), dark=False),
        camera=vars(CameraRecord(width=8, height=6, bit_depth=12)),
    )
    writer = SessionWriter.create(folder, manifest)
    writer.write_frame(writer.missing[0], np.zeros((6, 8), np.uint16))
    return writer


@pytest.mark.parametrize(
    "details",
    [
        pytest.param({"leds": [True]}, id="truth"),
        pytest.param({"leds": ["1"]}, id="text"),
        pytest.param({"leds": [1.0]}, id="float"),
        pytest.param({"leds": [-1]}, id="negative"),
        pytest.param({"leds": 1}, id="no list"),
        pytest.param({}, id="nothing"),
    ],
)
def test_leds_that_are_left_out_are_leds(tmp_path: Path, details: dict[str, Any]) -> None:
    """Invalid LEDs are refused by the writer, and an error for the reader."""
    with (
        two_lights(tmp_path / "s") as writer,
        pytest.raises(DataError, match=r"'left_out' is invalid: .*'leds"),
    ):
        writer.write_event("left_out", **details)
    rows = rows_of(tmp_path / "s")
    event = {"kind": "event", "seq": len(rows), "time_utc": rows[0]["time_utc"]}
    seal(tmp_path / "s", [*rows, {**event, "event": "left_out", "details": details}])
    with pytest.raises(DataError, match=r"line 3: event left_out is not understood: .*'leds"):
        Session.open(tmp_path / "s")
