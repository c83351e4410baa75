"""Resuming an interrupted recording: exactly the missing shots, on the same rig."""

from __future__ import annotations

import threading
import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w

from acquisition._engine.engine import check_resume, record, resume
from acquisition._engine.hooks import RecordingHooks
from acquisition._errors import DataError, MissingPathError, StorageError
from acquisition._plan.plan import CapturePlan
from acquisition._session.calibrations import Calibrations
from acquisition._session.compact import compact_session
from acquisition._session.manifest import _ADDED_2, CameraRecord, Manifest
from acquisition._session.session import Session
from acquisition._session.verify import verify_session
from acquisition._session.writer import SessionWriter
from acquisition._source.reader import read_source
from acquisition._values.noise_model import NoiseModel
from rig import CameraError, Rig, RigError
from tests.acquisition.fake_bench import LABELS, PLAN, Bench, events_of, rig_on, seen
from tests.acquisition.mutants import rows_of, seal


def interrupted(
    rig: Rig, bench: Bench, folder: Path, at: int, sensor: NoiseModel | None = None
) -> Session:
    """Record until the camera fails at a given frame."""

    def fail(number: int) -> None:
        if number == at:
            raise CameraError("the camera was unplugged")

    bench.on_trigger = fail
    with pytest.raises(CameraError):
        record(rig, PLAN, folder, LABELS, calibrations=Calibrations(sensor=sensor))
    bench.on_trigger = lambda number: None
    bench.shots.clear()
    return Session.open(folder)


@pytest.mark.parametrize("at", range(1, 11))
def test_exactly_the_missing_shots_are_taken(
    rig: Rig, bench: Bench, tmp_path: Path, at: int
) -> None:
    before = interrupted(rig, bench, tmp_path / "s", at)
    assert len(before.frames) == at - 1
    steps: list[tuple[str, int, int]] = []
    session = resume(
        rig, tmp_path / "s", hooks=RecordingHooks(on_progress=lambda *report: steps.append(report))
    )
    assert session.complete
    assert bench.shots == [shot.led for shot in PLAN.shots()[at - 1 :]]
    recorded = [step for step in steps if step[0] == "recording"]
    assert recorded == [("recording", done, 10) for done in range(at, 11)]
    assert [line.event for line in events_of(session)] == ["failed", "reopened"]
    for frame in session.frames:
        expected = seen(frame.led, PLAN.exposures_us[frame.bracket])
        np.testing.assert_array_equal(frame.read(), expected)
    assert [f.line for f in session.frames][: at - 1] == [f.line for f in before.frames]
    found = verify_session(tmp_path / "s")
    assert (found.ok, found.complete, found.frames) == (True, True, 10)


def test_a_recording_can_be_interrupted_again_and_again(
    rig: Rig, bench: Bench, tmp_path: Path
) -> None:
    interrupted(rig, bench, tmp_path / "s", 3)
    for left in range(8, 1, -1):
        first = bench.frames
        bench.on_trigger = lambda number, first=first: fail_after(number, first + 1)
        with pytest.raises(CameraError):
            resume(rig, tmp_path / "s")
        assert len(Session.open(tmp_path / "s").missing) == left - 1
    bench.on_trigger = lambda number: None
    assert resume(rig, tmp_path / "s").complete


def fail_after(number: int, last: int) -> None:
    if number > last:
        raise CameraError("the camera was unplugged")


def test_frames_are_judged_by_the_earlier_dark_frame(
    rig: Rig, bench: Bench, tmp_path: Path
) -> None:
    interrupted(rig, bench, tmp_path / "s", 6)
    bench.dead = {0}
    with pytest.raises(RigError, match="LED 0 gave no light"):
        resume(rig, tmp_path / "s")


def test_the_levels_of_the_sensor_are_those_of_the_session(
    rig: Rig, bench: Bench, tmp_path: Path
) -> None:
    interrupted(rig, bench, tmp_path / "s", 6, sensor=NoiseModel(2.0, 5.0, 64.0, 12))
    session = resume(rig, tmp_path / "s")
    assert session.manifest.camera.black_level_dn == 64.0


def _camera(**changed: Any) -> Callable[[Bench], None]:
    def change(bench: Bench) -> None:
        bench.info = replace(bench.info, **changed)

    return change


def _board(**changed: Any) -> Callable[[Bench], None]:
    def change(bench: Bench) -> None:
        bench.identity = replace(bench.identity, **changed)

    return change


@pytest.mark.parametrize(
    ("change", "config", "said"),
    [
        pytest.param(_camera(serial="43"), {}, "camera serial was 42 and is 43", id="serial"),
        pytest.param(_camera(width=12), {}, "camera width was 10 and is 12", id="size"),
        pytest.param(
            _camera(pixel_format="Mono10", bit_depth=10),
            {},
            "camera bit_depth was 12 and is 10; camera pixel_format was Mono12 and is Mono10",
            id="format",
        ),
        pytest.param(_camera(cfa="RGGB"), {}, "cfa was not stated and is RGGB", id="colour"),
        pytest.param(_board(name="other"), {}, "board was fake-board and is other", id="board"),
        pytest.param(_board(firmware="2"), {}, "firmware was 1.2.3 and is 2", id="firmware"),
        pytest.param(_board(leds=8), {"leds": 8}, "rig leds was 6 and is 8", id="led count"),
        pytest.param(
            _board(), {"mounting": {"rotation_deg": 180}}, "rig mounting was", id="mounting"
        ),
        pytest.param(
            _board(name="other"),
            {"name": "bench-2"},
            "another rig: rig name was bench-1 and is bench-2; rig board was fake-board",
            id="two things",
        ),
    ],
)
def test_another_rig_is_refused_with_its_differences(
    rig: Rig,
    bench: Bench,
    tmp_path: Path,
    change: Callable[[Bench], None],
    config: dict[str, Any],
    said: str,
) -> None:
    interrupted(rig, bench, tmp_path / "s", 5)
    before = (tmp_path / "s" / "journal.jsonl").read_bytes()
    other = Bench()
    change(other)
    with rig_on(other, **config) as other_rig, pytest.raises(DataError) as caught:
        resume(other_rig, tmp_path / "s")
    assert said in str(caught.value)
    assert str(tmp_path / "s") in str(caught.value)
    assert other.frames == 0
    assert (tmp_path / "s" / "journal.jsonl").read_bytes() == before


@pytest.mark.parametrize(
    ("stored", "current", "said"),
    [
        pytest.param(
            {"pixel_format": "Mono12"},
            {"pixel_format": "Mono12", "black_level": 300.0},
            "started with another rig: rig option black_level was not stated and is 300.0;",
            id="black level",
        ),
        pytest.param(
            {"black_level": 300.0, "trigger_line": "Line1"},
            {"readout_us": 20},
            "rig option black_level was 300.0 and is not stated; "
            "rig option trigger_line was Line1 and is not stated; "
            "rig option readout_us was not stated and is 20;",
            id="several",
        ),
        pytest.param(
            {"sensor": {"black_level_dn": 64}},
            {"sensor": {"black_level_dn": 90}},
            "rig option sensor was {'black_level_dn': 64} and is {'black_level_dn': 90};",
            id="a table",
        ),
        pytest.param(
            {"port": "COM3", "cti": "a.cti", "black_level": 300},
            {"port": "auto", "cti": "b/a.cti", "black_level": 300.0, "camera": "42"},
            None,
            id="found elsewhere",
        ),
    ],
)
def test_a_session_is_not_resumed_with_other_driver_options(
    tmp_path: Path, stored: dict[str, Any], current: dict[str, Any], said: str | None
) -> None:
    first, second = Bench(), Bench()
    with rig_on(first, options=stored) as rig:
        interrupted(rig, first, tmp_path / "s", 5)
    with rig_on(second, options=current) as rig:
        if said is None:
            assert resume(rig, tmp_path / "s").complete
            return
        with pytest.raises(DataError) as caught:
            resume(rig, tmp_path / "s")
    assert said in str(caught.value)
    assert second.frames == 0


@pytest.mark.parametrize(
    ("plan", "said"),
    [
        pytest.param(
            PLAN.changed(leds=(3, 5, 0)), r"leds was \(3, 0, 5\) and is \(3, 5, 0\)", id="order"
        ),
        pytest.param(PLAN.changed(exposures_us=(200.0, 60.0)), "exposures_us was", id="exposure"),
        pytest.param(PLAN.changed(gain_db=3.0), "gain_db was 2.0 and is 3.0", id="gain"),
    ],
)
def test_another_plan_is_refused(
    rig: Rig, bench: Bench, tmp_path: Path, plan: CapturePlan, said: str
) -> None:
    interrupted(rig, bench, tmp_path / "s", 5)
    with pytest.raises(DataError, match=f"started with another plan: .*{said}"):
        resume(rig, tmp_path / "s", plan=plan)
    assert bench.shots == []
    assert resume(rig, tmp_path / "s", plan=PLAN).complete


def test_sessions_that_cannot_be_resumed(rig: Rig, bench: Bench, tmp_path: Path) -> None:
    with pytest.raises(MissingPathError):
        resume(rig, tmp_path / "none")
    (tmp_path / "empty").mkdir()
    with pytest.raises(DataError, match="not a session"):
        resume(rig, tmp_path / "empty")
    record(rig, PLAN, tmp_path / "whole", LABELS)
    with pytest.raises(DataError, match="is complete"):
        resume(rig, tmp_path / "whole")
    manifest = Manifest.begin(tmp_path, camera=vars(CameraRecord(width=8, height=6, bit_depth=12)))
    SessionWriter.create(tmp_path / "imported", manifest).close()
    with pytest.raises(DataError, match="was not recorded on a rig"):
        resume(rig, tmp_path / "imported")


def test_a_second_recorder_is_refused(rig: Rig, bench: Bench, tmp_path: Path) -> None:
    """Two engines on one session: the second takes no shot, the first continues undisturbed."""
    refused: list[str] = []
    other = Bench()

    def second() -> None:
        with rig_on(other) as other_rig:
            for attempt in (
                lambda: resume(other_rig, tmp_path / "s"),
                lambda: record(other_rig, PLAN, tmp_path / "s", LABELS),
            ):
                try:
                    attempt()
                except StorageError as error:
                    refused.append(str(error))

    def at(number: int) -> None:
        if number == 5:
            thread = threading.Thread(target=second)
            thread.start()
            thread.join(30)

    bench.on_trigger = at
    assert record(rig, PLAN, tmp_path / "s", LABELS).complete
    assert len(refused) == 2
    assert all("another process is recording into this session" in text for text in refused)
    assert other.frames == 0
    assert verify_session(tmp_path / "s").ok


def test_a_session_of_an_older_format_is_not_resumed(
    rig: Rig, bench: Bench, tmp_path: Path
) -> None:
    """Adding newer lines would mix two formats in one file."""
    session = interrupted(rig, bench, tmp_path / "s", 5)
    older = session.manifest.model_copy(update={"format_version": 1})
    with pytest.raises(DataError, match="version 1"):
        SessionWriter.create(tmp_path / "older", older)
    assert not (tmp_path / "older").exists()
    _make_older(tmp_path / "s", 1)
    assert Session.open(tmp_path / "s").format_version == 1
    with pytest.raises(DataError, match="has format version 1"):
        resume(rig, tmp_path / "s")
    assert bench.shots == []


def test_a_session_of_version_2_is_resumed_in_version_2(
    rig: Rig, bench: Bench, tmp_path: Path
) -> None:
    interrupted(rig, bench, tmp_path / "s", 5)
    _make_older(tmp_path / "s", 2)
    toml = (tmp_path / "s" / "session.toml").read_bytes()
    session = resume(rig, tmp_path / "s")
    assert (session.complete, session.format_version) == (True, 2)
    assert verify_session(tmp_path / "s").ok
    assert (tmp_path / "s" / "session.toml").read_bytes() == toml
    assert "upgraded" not in {line.event for line in session.events}


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

    def fail(number: int) -> None:
        if number == at:
            raise CameraError("the camera was unplugged")

    bench.on_trigger = fail
    with pytest.raises(CameraError):
        record(rig, plan, tmp_path / "s", LABELS)
    bench.on_trigger = lambda number: None
    taken = len(bench.shots)
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
    assert 0 not in bench.shots[taken:]
    assert [shot.led for shot in missing] == bench.shots[taken:]
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
        assert writer.demanded == 8
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


def _make_older(folder: Path, version: int) -> None:
    """Rewrite ``session.toml`` and every line in an older format version."""
    path = folder / "session.toml"
    manifest = tomllib.loads(path.read_text(encoding="utf-8"))
    manifest["format_version"] = version
    if version == 1:
        for table, keys in _ADDED_2.items():
            for key in keys:
                manifest.get(table, {}).pop(key, None)
    path.write_text(tomli_w.dumps(manifest), encoding="utf-8")
    rows = rows_of(folder)
    for row in rows:
        if version == 1 and row["kind"] == "frame":
            del row["mean_dn"], row["above_dark"]
            if row["echo"]:
                del row["echo"]["lit_us"], row["echo"]["active_us"]
    seal(folder, rows)


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
    _make_older(tmp_path / "s", version)
    session = Session.open(tmp_path / "s")
    assert [shot.led for shot in session.missing] == ([] if complete else [1])
    assert [shot.led for shot in session.left_out] == ([1] if complete else [])


def two_lights(folder: Path) -> SessionWriter:
    """Start a session of two lights and write the first."""
    manifest = Manifest.begin(
        folder,
        plan=CapturePlan(leds=(0, 1), exposures_us=(10.0,), dark=False),
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


@pytest.mark.parametrize("ambient", [True, False])
def test_the_difference_from_the_dark_is_in_each_lit_line(
    rig: Rig, bench: Bench, tmp_path: Path, ambient: bool
) -> None:
    """Also after an interruption, with the dark frames recorded before."""
    plan = PLAN.changed(ambient=ambient, flats=1)
    dark = 4 if ambient else 2

    def fail(number: int) -> None:
        if number == dark + 2:
            raise CameraError("the camera was unplugged")

    bench.on_trigger = fail
    with pytest.raises(CameraError):
        record(
            rig,
            plan,
            tmp_path / "s",
            LABELS,
            calibrations=Calibrations(sensor=NoiseModel(2.0, 5.0, 60.0, 12)),
        )
    bench.on_trigger = lambda number: None
    session = resume(rig, tmp_path / "s")
    means = {frame.line.key: frame.read().mean() for frame in session.frames}
    role = "ambient" if ambient else "dark"
    for frame in session.frames:
        line = frame.line
        assert line.mean_dn == pytest.approx(means[line.key], abs=1e-4)
        if line.role in ("light", "flat"):
            expected = (means[line.key] - means[role, None, line.bracket, 0]) / (4095 - 60)
            assert expected > 0.01
            assert line.above_dark == pytest.approx(expected, abs=1e-6)
        else:
            assert line.above_dark is None


def test_without_a_dark_frame_there_is_no_difference_from_it(
    rig: Rig, bench: Bench, tmp_path: Path
) -> None:
    plan = PLAN.changed(ambient=False, dark=False)
    session = record(rig, plan, tmp_path / "s", LABELS)
    assert {frame.line.above_dark for frame in session.frames} == {None}
