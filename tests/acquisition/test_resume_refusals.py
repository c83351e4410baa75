"""Sessions, rigs and plans with which a recording is not resumed; sessions of older formats."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from acquisition import (
    CapturePlan,
    DataError,
    MissingPathError,
    Session,
    StorageError,
    record,
    resume,
    verify_session,
)
from acquisition.session import CameraRecord, Manifest, SessionWriter
from rig import Rig
from tests.acquisition.fake_bench import LABELS, PLAN, Bench, rig_on
from tests.acquisition.interruptions import interrupted, make_older
from tests.cases import cases


def _camera(**changed: Any) -> Callable[[Bench], None]:
    def change(bench: Bench) -> None:
        bench.info = replace(bench.info, **changed)

    return change


def _board(**changed: Any) -> Callable[[Bench], None]:
    def change(bench: Bench) -> None:
        bench.identity = replace(bench.identity, **changed)

    return change


OTHER_RIGS = {
    "serial": (_camera(serial="43"), {}, "camera serial was 42 and is 43"),
    "size": (_camera(width=12), {}, "camera width was 10 and is 12"),
    "format": (
        _camera(pixel_format="Mono10", bit_depth=10),
        {},
        "camera bit_depth was 12 and is 10; camera pixel_format was Mono12 and is Mono10",
    ),
    "colour": (_camera(cfa="RGGB"), {}, "cfa was not stated and is RGGB"),
    "board": (_board(name="other"), {}, "board was fake-board and is other"),
    "firmware": (_board(firmware="2"), {}, "firmware was 1.2.3 and is 2"),
    "led count": (_board(leds=8), {"leds": 8}, "rig leds was 6 and is 8"),
    "mounting": (_board(), {"mounting": {"rotation_deg": 180}}, "rig mounting was"),
    "two things": (
        _board(name="other"),
        {"name": "bench-2"},
        "another rig: rig name was bench-1 and is bench-2; rig board was fake-board",
    ),
}


@pytest.mark.parametrize(("change", "config", "said"), OTHER_RIGS.values(), ids=OTHER_RIGS)
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


OTHER_OPTIONS = {
    "black level": (
        {"pixel_format": "Mono12"},
        {"pixel_format": "Mono12", "black_level": 300.0},
        "started with another rig: rig option black_level was not stated and is 300.0;",
    ),
    "several": (
        {"black_level": 300.0, "trigger_line": "Line1"},
        {"readout_us": 20},
        (
            "rig option black_level was 300.0 and is not stated; "
            "rig option trigger_line was Line1 and is not stated; "
            "rig option readout_us was not stated and is 20;"
        ),
    ),
    "a table": (
        {"sensor": {"black_level_dn": 64}},
        {"sensor": {"black_level_dn": 90}},
        "rig option sensor was {'black_level_dn': 64} and is {'black_level_dn': 90};",
    ),
    "found elsewhere": (
        {"port": "COM3", "cti": "a.cti", "black_level": 300},
        {"port": "auto", "cti": "b/a.cti", "black_level": 300.0, "camera": "42"},
        None,
    ),
}


@pytest.mark.parametrize(("stored", "current", "said"), OTHER_OPTIONS.values(), ids=OTHER_OPTIONS)
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


@cases(
    ("plan", "said"),
    {
        "order": (PLAN.changed(leds=(3, 5, 0)), r"leds was \(3, 0, 5\) and is \(3, 5, 0\)"),
        "exposure": (PLAN.changed(exposures_us=(200.0, 60.0)), "exposures_us was"),
        "gain": (PLAN.changed(gain_db=3.0), "gain_db was 2.0 and is 3.0"),
    },
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
    make_older(tmp_path / "s", 1)
    assert Session.open(tmp_path / "s").format_version == 1
    with pytest.raises(DataError, match="has format version 1"):
        resume(rig, tmp_path / "s")
    assert bench.shots == []


def test_a_session_of_version_2_is_resumed_in_version_2(
    rig: Rig, bench: Bench, tmp_path: Path
) -> None:
    interrupted(rig, bench, tmp_path / "s", 5)
    make_older(tmp_path / "s", 2)
    toml = (tmp_path / "s" / "session.toml").read_bytes()
    session = resume(rig, tmp_path / "s")
    assert (session.complete, session.format_version) == (True, 2)
    assert verify_session(tmp_path / "s").ok
    assert (tmp_path / "s" / "session.toml").read_bytes() == toml
    assert "upgraded" not in {line.event for line in session.events}
