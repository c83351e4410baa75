"""What the lines of a journal mean together: frames that count, contradictions, missing shots."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from acquisition import CapturePlan, DataError, Session
from acquisition.plan import PlannedShot
from acquisition.session import CameraRecord, EventLine, FrameLine, Journal, StartLine
from acquisition.session.journal import Line
from acquisition.session.journal_frames import Recorded, recorded_frames
from acquisition.session.open_shots import OpenShots
from tests.acquisition.small_session import manifest

TIME = "2026-03-04T05:06:07Z"
CAMERA = CameraRecord(width=8, height=6, bit_depth=12)
# Shots: D_100us, D_50us, L00_E0, L01_E0, L00_E1, L01_E1.
PLAN = CapturePlan(repeat=False, leds=(0, 1), exposures_us=(100.0, 50.0))
BYTES = 2 * 8 * 6
ECHO = {"seq": 1, "led": 0, "lit_us": 5, "active_us": None}
KEYS_2 = {"mean_dn": 4.0, "above_dark": None}


def frame(seq: int = 1, **changed: Any) -> FrameLine:
    """Return the line of the first frame of LED 0 in version 2 or 3; None removes a key of 2."""
    row = {
        "seq": seq,
        "time_utc": TIME,
        "role": "light",
        "led": 0,
        "bracket": 0,
        "repeat": 0,
        "exposure_us": 100.0,
        "gain_db": None,
        "file": "frames/L00_E0.tif",
        "bytes": BYTES,
        "file_sha256": "b" * 64,
        "pixels_sha256": "c" * 64,
        "frame_id": None,
        "timestamp_ns": None,
        "temperature_c": None,
        "echo": None,
        "clipped_fraction": 0.0,
        "percentiles_dn": dict.fromkeys(("0", "1", "50", "99", "99.9", "100"), 4),
        "sharpness": 0.0,
        "status": "ok",
        "origin": None,
        **KEYS_2,
        **changed,
    }
    return FrameLine(**{key: value for key, value in row.items() if value is not ABSENT})


ABSENT = object()
NO_KEYS_2 = dict.fromkeys(KEYS_2, ABSENT)


def event(seq: int, name: str, **details: Any) -> EventLine:
    return EventLine(seq=seq, time_utc=TIME, event=name, details=details)


def compacted(seq: int, frame_seq: int, file: str) -> EventLine:
    more = {"bytes": 7, "file_sha256": "d" * 64}
    return event(seq, "compacted", frame_seq=frame_seq, file=file, **more)


def set_aside(seq: int, frame_seq: int, file: str, kept: str | None = None) -> EventLine:
    return event(seq, "set_aside", frame_seq=frame_seq, file=file, kept=kept, reason="why")


def upgraded(seq: int) -> EventLine:
    return event(seq, "upgraded", from_version=2, to_version=3, software_version="1")


def read(
    *lines: Line, folder: Path = Path("s"), version: int = 3, plan: CapturePlan | None = PLAN
) -> Recorded:
    content = manifest(plan=plan, camera=CAMERA)
    content = content.model_copy(update={"format_version": version})
    start = StartLine(seq=0, time_utc=TIME, session_toml_sha256="a" * 64)
    planned = () if plan is None else plan.shots()
    return recorded_frames(folder, content, planned, Journal((start, *lines), b"", ""))


def test_a_frame_and_its_later_file() -> None:
    line = frame()
    found = read(line, event(2, "note"), compacted(3, 1, "frames/L00_E0.z.tif"))
    (only,) = found.frames.values()
    assert (only.path, only.line, only.shape) == (Path("s/frames/L00_E0.z.tif"), line, (6, 8))
    assert (only.bytes, only.file_sha256) == (7, "d" * 64)
    assert found.names == {"L00_E0.tif", "L00_E0.z.tif"}
    assert (found.problems, found.flaws, found.set_aside) == ([], {}, {})
    (before,) = read(line).frames.values()
    assert (before.path, before.bytes) == (Path("s/frames/L00_E0.tif"), BYTES)
    assert (before.file_sha256, before.shape) == ("b" * 64, (6, 8))


MISFITS = {
    "with echo": (3, {"echo": ECHO}, None),
    "version 2": (2, {}, None),
    "version 1": (1, NO_KEYS_2, None),
    "version 1 with echo": (1, {**NO_KEYS_2, "echo": {"seq": 1, "led": 0}}, None),
    "new keys in 1": (1, {}, "format version 1 has no key 'above_dark'"),
    "new echo in 1": (1, {**NO_KEYS_2, "echo": ECHO}, "has no key 'active_us'"),
    "old keys in 2": (2, NO_KEYS_2, "the key 'above_dark' is missing"),
    "one key missing": (2, {"mean_dn": ABSENT}, "the key 'mean_dn' is missing"),
    "old echo in 3": (3, {"echo": {"seq": 1, "led": 0}}, "key 'active_us' is missing"),
    "not planned": (3, {"led": 5}, "frames/L00_E0.tif is not in the plan"),
    "too small": (3, {"bytes": BYTES - 1}, "95 bytes, too few for 8 x 6"),
    "13 bits": (
        3,
        {"percentiles_dn": frame().percentiles_dn | {"100": 4096}},
        "has a value of 4096, which exceeds 12 bits",
    ),
    "12 bits": (3, {"percentiles_dn": frame().percentiles_dn | {"100": 4095}}, None),
}


@pytest.mark.parametrize(("version", "changed", "said"), MISFITS.values(), ids=MISFITS)
def test_a_line_fits_version_plan_and_camera(
    version: int, changed: dict[str, Any], said: str | None
) -> None:
    found = read(frame(**changed), version=version)
    assert len(found.problems) == (said is not None)
    for problem in found.problems:
        assert problem.startswith("s/journal.jsonl: line 2: ")
        assert said is not None
        assert said in problem
    assert list(found.frames) == [1]
    assert found.flaws == {}


def test_without_a_plan_a_line_is_its_own_plan() -> None:
    found = read(frame(led=5, echo=ECHO | {"led": 5}), frame(2, led=6, file="frames/x"), plan=None)
    assert (found.problems, found.flaws) == ([], {})
    found = read(frame(led=5, echo=ECHO), plan=None)
    assert "was planned with LED 5, but the LED board reports LED 0" in found.flaws[1].text


@pytest.mark.parametrize(
    ("second", "said"),
    [
        pytest.param("frames/L00_E0.tif", True, id="same"),
        pytest.param("frames/l00_e0.TIF", True, id="other case"),
        pytest.param("frames/L00_E0.tif.", True, id="dot at the end"),
        pytest.param("frames/L00_E0_R1.tif", False, id="other"),
    ],
)
def test_no_two_frames_have_one_file(second: str, said: bool) -> None:
    found = read(frame(), frame(2, file=second))
    assert list(found.flaws) == ([1, 2] if said else [])
    for seq, damage in found.flaws.items():
        assert damage.frame is found.frames[seq]
        text = f"line 3: names {second}, which an earlier line names too"
        assert (damage.reason, damage.where) == (text, Path("s/journal.jsonl"))
    assert found.problems == []


def test_the_first_flaw_of_a_frame_is_kept() -> None:
    found = read(frame(echo=ECHO | {"led": 1}), frame(2))
    assert "the LED board reports LED 1" in found.flaws[1].reason
    assert "names frames/L00_E0.tif" in found.flaws[2].reason


@pytest.mark.parametrize(
    ("target", "said"), [("inside.tif", False), ("../../outside.tif", True), (None, False)]
)
def test_a_file_that_is_a_link(tmp_path: Path, target: str | None, said: bool) -> None:
    folder = tmp_path / "s"
    (folder / "frames").mkdir(parents=True)
    if target is None:  # The session itself lies behind a link.
        (tmp_path / "link").symlink_to(folder)
        (folder / "frames/L00_E0.tif").touch()
        folder = tmp_path / "link"
    else:
        (folder / "frames/L00_E0.tif").symlink_to(target)
    found = read(frame(), folder=folder)
    assert [("leaves the session" in flaw.reason) for flaw in found.flaws.values()] == [True] * said


@pytest.mark.parametrize(
    ("version", "lines", "problem"),
    [
        pytest.param(3, [compacted(2, 9, "frames/x")], "compacts a frame that does", id="compacts"),
        pytest.param(
            3, [event(2, "compacted")], "event compacted is not understood: ", id="no details"
        ),
        pytest.param(
            3, [set_aside(2, 9, "frames/L00_E0.tif")], "not the file of frame 9", id="no frame"
        ),
        pytest.param(
            3, [set_aside(2, 1, "frames/x.tif")], "sets frames/x.tif aside", id="not its file"
        ),
        pytest.param(3, [upgraded(2)], "version 2, but it has version 3", id="upgrades 3"),
        pytest.param(
            2, [upgraded(2), upgraded(3)], "line 4: upgrades the session from", id="upgrades twice"
        ),
        # Version 1 has neither event, version 2 does not set frames aside.
        pytest.param(1, [upgraded(2)], None, id="unknown to 1"),
        pytest.param(2, [set_aside(2, 1, "frames/L00_E0.tif")], None, id="unknown to 2"),
    ],
)
def test_an_event_that_contradicts_other_lines_changes_nothing(
    version: int, lines: list[EventLine], problem: str | None
) -> None:
    first = frame(**NO_KEYS_2) if version == 1 else frame()
    found = read(first, *lines, version=version)
    assert len(found.problems) == (problem is not None)
    assert all(problem in text for text in found.problems if problem)
    assert {seq: one.path.name for seq, one in found.frames.items()} == {1: "L00_E0.tif"}
    assert (found.set_aside, found.names) == ({}, {"L00_E0.tif"})
    assert found.version == (3 if len(lines) == 2 else version)


@pytest.mark.parametrize("kept", ["derived/set_aside/0.tif", None])
def test_a_frame_that_was_set_aside(kept: str | None) -> None:
    """Setting it aside resolves its flaw; its retake counts."""
    file = "frames/L00_E0.tif"
    lines = [frame(echo=ECHO | {"led": 1}), upgraded(2), set_aside(3, 1, file, kept)]
    found = read(*lines, version=2)
    assert (found.version, found.problems, found.flaws, found.frames) == (3, [], {}, {})
    one = found.set_aside[1]
    assert (one.frame.line, one.reason) == (lines[0], "why")
    assert one.kept == (None if kept is None else Path("s") / kept)
    assert found.names == {"L00_E0.tif"}
    assert found.counted() == {}
    retaken = read(*lines, frame(4, file="frames/L00_E0_R1.tif"), version=2)
    assert [one.path.name for one in retaken.counted().values()] == ["L00_E0_R1.tif"]


def test_the_last_take_that_was_not_rejected_counts() -> None:
    takes = [
        frame(1, file="frames/1.tif"),
        frame(2, file="frames/2.tif"),
        frame(3, file="frames/3.tif", status="rejected"),
        frame(4, file="frames/4.tif", led=1, status="rejected"),
    ]
    counted = read(*takes).counted()
    assert {key: one.path.name for key, one in counted.items()} == {("light", 0, 0, 0): "2.tif"}
    # A take that it replaced does not count instead.
    assert read(*takes, set_aside(5, 2, "frames/2.tif")).counted() == {}


def names(shots: OpenShots) -> list[str]:
    return [shot.file for shot in shots.missing]


def test_open_shots_are_noted_and_left_out() -> None:
    shots = OpenShots(PLAN)
    assert names(shots) == [shot.file for shot in PLAN.shots()]
    assert shots.demanded == 6
    shots.note(frame(status="rejected"))
    shots.note(frame(led=1))
    shots.note(frame(led=1))
    shots.note(StartLine(seq=0, time_utc=TIME, session_toml_sha256="a" * 64))
    assert names(shots) == ["D_100us.tif", "D_50us.tif", "L00_E0.tif", "L00_E1.tif", "L01_E1.tif"]
    assert shots.demanded == 6
    shots.note(event(2, "left_out", leds=[1]))
    shots.note(event(3, "left_out", leds=[1]))
    shots.note(event(4, "retake", leds=[0]))
    # The recorded shot of LED 1 is still one of those of a complete session.
    assert names(shots) == ["D_100us.tif", "D_50us.tif", "L00_E0.tif", "L00_E1.tif"]
    assert shots.demanded == 5


def test_a_resumed_session_requires_its_missing_shots() -> None:
    shots = PLAN.shots()
    session = SimpleNamespace(missing=shots[1:3], left_out=shots[3:4])
    left = OpenShots(PLAN, cast(Session, session))
    assert (left.missing, left.demanded) == (shots[1:3], 5)


def test_a_shot_is_replaced_by_the_planned_one() -> None:
    shot = PlannedShot("light", 1, 1, 0, 51.0)
    assert OpenShots(PLAN).planned(shot, Path("s")).exposure_us == 50.0
    other = PlannedShot("light", 2, 1, 0, 51.0)
    with pytest.raises(DataError, match=r"^s: L02_E1\.tif is not in the plan of this session"):
        OpenShots(PLAN).planned(other, Path("s"))
    free = OpenShots(None)
    assert free.planned(other, Path("s")) is other
    assert (free.missing, free.demanded) == ((), 0)
