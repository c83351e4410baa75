"""Resuming an interrupted recording: exactly the missing shots, on the same rig."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from acquisition import (
    Calibrations,
    NoiseModel,
    RecordingHooks,
    Session,
    record,
    resume,
    verify_session,
)
from rig import CameraError, Rig, RigError
from tests.acquisition.fake_bench import LABELS, PLAN, Bench, cut, events_of, seen
from tests.acquisition.interruptions import fail_after, interrupted


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


@pytest.mark.parametrize("ambient", [True, False])
def test_the_difference_from_the_dark_is_in_each_lit_line(
    rig: Rig, bench: Bench, tmp_path: Path, ambient: bool
) -> None:
    """Also after an interruption, with the dark frames recorded before."""
    plan = PLAN.changed(ambient=ambient, flats=1)
    dark = 4 if ambient else 2
    calibrations = Calibrations(sensor=NoiseModel(2.0, 5.0, 60.0, 12))
    cut(rig, bench, tmp_path / "s", dark + 2, plan, calibrations=calibrations)
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
