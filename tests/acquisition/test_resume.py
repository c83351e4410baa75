"""Going on with a recording that was interrupted: exactly what is missing, on the same rig."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from acquisition._engine import record, resume
from acquisition._errors import DataError, MissingPathError, StorageError
from acquisition._manifest import CameraRecord, Manifest
from acquisition._noise_model import NoiseModel
from acquisition._plan import CapturePlan
from acquisition._session import Session
from acquisition._session_writer import SessionWriter
from acquisition._verify import verify_session
from rig import CameraError, Rig, RigError
from tests.acquisition.fake_bench import PLAN, TOLD, Bench, events_of, rig_on, seen


@pytest.fixture
def bench() -> Bench:
    return Bench()


@pytest.fixture
def rig(bench: Bench) -> Iterator[Rig]:
    rig = rig_on(bench)
    yield rig
    rig.close()


def interrupted(rig: Rig, bench: Bench, folder: Path, at: int, **more: Any) -> Session:
    """Record until the camera fails at a frame."""

    def fail(number: int) -> None:
        if number == at:
            raise CameraError("the camera was unplugged")

    bench.on_trigger = fail
    with pytest.raises(CameraError):
        record(rig, PLAN, folder, **{**TOLD, **more})
    bench.on_trigger = lambda number: None
    bench.shots.clear()
    return Session.open(folder)


@pytest.mark.parametrize("at", range(1, 11))
def test_exactly_the_missing_shots_are_taken(
    rig: Rig, bench: Bench, tmp_path: Path, at: int
) -> None:
    before = interrupted(rig, bench, tmp_path / "s", at)
    assert len(before.frames) == at - 1
    told: list[tuple[int, int]] = []
    session = resume(rig, tmp_path / "s", on_frame=lambda line, *of: told.append(of))
    assert session.complete
    assert bench.shots == [shot.lit_led for shot in PLAN.shots()[at - 1 :]]
    assert told == [(done, 10) for done in range(at, 11)]
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


def test_frames_are_judged_by_the_dark_frame_of_before(
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
def test_another_rig_is_refused_and_it_is_said_how_it_differs(
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
    with pytest.raises(DataError, match=f"begun with another plan: .*{said}"):
        resume(rig, tmp_path / "s", plan=plan)
    assert bench.shots == []
    assert resume(rig, tmp_path / "s", plan=PLAN).complete


def test_what_cannot_be_resumed(rig: Rig, bench: Bench, tmp_path: Path) -> None:
    with pytest.raises(MissingPathError):
        resume(rig, tmp_path / "none")
    (tmp_path / "empty").mkdir()
    with pytest.raises(DataError, match="not a session"):
        resume(rig, tmp_path / "empty")
    record(rig, PLAN, tmp_path / "whole", **TOLD)
    with pytest.raises(DataError, match="is complete"):
        resume(rig, tmp_path / "whole")
    manifest = Manifest.begin(
        tmp_path, operator="", object="", camera=vars(CameraRecord(width=8, height=6, bit_depth=12))
    )
    SessionWriter.create(tmp_path / "imported", manifest).close()
    with pytest.raises(DataError, match="was not recorded on a rig"):
        resume(rig, tmp_path / "imported")


def test_a_second_recorder_is_refused(rig: Rig, bench: Bench, tmp_path: Path) -> None:
    """Two engines at one session: the second takes no shot, the first goes on undisturbed."""
    refused: list[str] = []
    other = Bench()

    def second() -> None:
        with rig_on(other) as other_rig:
            for attempt in (
                lambda: resume(other_rig, tmp_path / "s"),
                lambda: record(other_rig, PLAN, tmp_path / "s", **TOLD),
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
    assert record(rig, PLAN, tmp_path / "s", **TOLD).complete
    assert len(refused) == 2
    assert all("another process is recording into this session" in text for text in refused)
    assert other.frames == 0
    assert verify_session(tmp_path / "s").ok


def test_a_session_of_an_older_format_is_not_taken_up(
    rig: Rig, bench: Bench, tmp_path: Path
) -> None:
    """Adding lines of a newer format would mix the two in one file."""
    interrupted(rig, bench, tmp_path / "s", 5)
    session = Session.open(tmp_path / "s")
    older = session.manifest.model_copy(update={"format_version": 1})
    copy = tmp_path / "older"
    with SessionWriter.create(copy, older):
        pass
    with pytest.raises(DataError, match="version"):
        resume(rig, copy)
