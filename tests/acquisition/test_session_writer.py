from __future__ import annotations

from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from acquisition import (
    CameraModel,
    CapturePlan,
    DataError,
    Lights,
    MissingPathError,
    NoiseModel,
    Session,
    StorageError,
    read_image,
    verify_session,
)
from acquisition.plan import PlannedShot
from acquisition.session import (
    CameraModelRecord,
    CameraRecord,
    EventLine,
    LightsRecord,
    SensorRecord,
    SessionWriter,
)
from rig.arrays import UInt16
from tests.acquisition import small_session
from tests.forked import ForkServer

PLAN = CapturePlan(repeat=False, leds=(0, 1, 2), exposures_us=(100.0,))


manifest = partial(small_session.manifest, (6, 8), 12, plan=PLAN)
picture = partial(small_session.picture, shape=(6, 8), above=4096)


def write_all(writer: SessionWriter) -> None:
    for index, shot in enumerate(writer.missing):
        writer.write_frame(shot, picture(index))


def test_a_session_is_read_as_it_was_written(tmp_path: Path) -> None:
    lights = Lights(
        positions_mm=np.array([[1.0, 2, 300], [0, 5, 310], [7, 0, 290]]),
        intensities=np.array([1.0, 0.9, 1.1]),
        mu=np.array([1.0, 1.0, 0.5]),
    )
    camera = CameraModel(
        np.array([[900.0, 0, 4], [0, 905, 3], [0, 0, 1]]), 8, 6, 600.0, np.array([0.1, -0.02])
    )
    sensor = NoiseModel(2.5, 7.0, 64.0, 12)
    content = manifest(
        notes='two\nlines, "quotes" and ünïcode',
        lights=LightsRecord.of(lights),
        camera_model=CameraModelRecord.of(camera),
        sensor=SensorRecord.of(sensor),
    )
    folder = tmp_path / "new" / "session"
    with SessionWriter.create(folder, content) as writer:
        write_all(writer)
        writer.write_event("metering", chosen=[100.0], fine=True)
        writer.complete()
    session = Session.open(folder)
    assert session.manifest == content
    assert session.complete
    assert session.missing == ()
    assert session.warnings == ()
    assert [frame.light_id for frame in session.frames] == ["D_100us", "L00", "L01", "L02"]
    assert [frame.role for frame in session.frames] == ["dark", "light", "light", "light"]
    for index, frame in enumerate(session.frames):
        np.testing.assert_array_equal(frame.read(), picture(index))
        assert frame.exposure_us == 100.0
    assert [line.event for line in session.events] == ["metering"]
    assert session.events[0].details == {"chosen": [100.0], "fine": True}
    back = session.lights
    assert back is not None
    assert back.ids == lights.ids
    for name in ("positions_mm", "intensities", "axes", "mu"):
        np.testing.assert_array_equal(getattr(back, name), getattr(lights, name))
    assert session.camera_model is not None
    np.testing.assert_array_equal(session.camera_model.K, camera.K)
    np.testing.assert_array_equal(session.camera_model.distortion, camera.distortion)
    assert session.camera_model.working_distance_mm == 600.0
    assert session.sensor == sensor
    assert sorted(path.name for path in folder.iterdir()) == [
        *("COMPLETE", "frames", "journal.jsonl", "session.toml")
    ]


def test_frames_are_stored_unchanged_in_uncompressed_tiff(tmp_path: Path) -> None:
    with SessionWriter.create(tmp_path / "s", manifest()) as writer:
        line = writer.write_frame(writer.missing[1], picture(5))
    path = tmp_path / "s" / line.file
    np.testing.assert_array_equal(read_image(path), picture(5))
    assert picture(5).astype("<u2").tobytes() in path.read_bytes()
    assert line.bytes == path.stat().st_size


def test_colour_frames(tmp_path: Path) -> None:
    camera = CameraRecord(width=8, height=6, channels=3, bit_depth=16)
    pixels = np.arange(144, dtype=np.uint16).reshape(6, 8, 3)
    with SessionWriter.create(tmp_path / "s", manifest(plan=None, camera=camera)) as writer:
        writer.write_frame(PlannedShot("light", 0, 0, 0, None), pixels, origin="a b.png")
        writer.complete()
    session = Session.open(tmp_path / "s")
    np.testing.assert_array_equal(session.frames[0].read(), pixels)
    assert session.frames[0].line.origin == "a b.png"
    assert session.frames[0].exposure_us is None
    assert verify_session(tmp_path / "s").ok


def test_the_last_intact_retake_counts_and_no_file_is_overwritten(tmp_path: Path) -> None:
    plan = CapturePlan(repeat=False, leds=(0,), exposures_us=(100.0,), repeats=2, dark=False)
    with SessionWriter.create(tmp_path / "s", manifest(plan=plan)) as writer:
        first, second = writer.missing
        files = [
            writer.write_frame(first, picture(0)).file,
            writer.write_frame(second, picture(1)).file,
            writer.write_frame(first, picture(2)).file,
            writer.write_frame(second, picture(3)).file,
            writer.write_frame(first, picture(4), status="rejected").file,
        ]
        writer.complete()
    stems = ["L00_E0", "L00_E0_R1", "L00_E0_R2", "L00_E0_R3", "L00_E0_R4"]
    assert files == [f"frames/{stem}.tif" for stem in stems]
    session = Session.open(tmp_path / "s")
    assert {frame.line.repeat: frame.path.stem for frame in session.frames} == {
        0: "L00_E0_R2",
        1: "L00_E0_R3",
    }
    for index, frame in enumerate(session.recorded):
        np.testing.assert_array_equal(frame.read(), picture(index))
    assert verify_session(tmp_path / "s").frames == 5


def test_a_rejected_frame_leaves_its_shot_missing(tmp_path: Path) -> None:
    with SessionWriter.create(tmp_path / "s", manifest()) as writer:
        shot = writer.missing[1]
        writer.write_frame(shot, picture(0), status="rejected")
        assert shot in writer.missing
    assert shot in Session.open(tmp_path / "s").missing


def test_a_recording_with_missing_shots_cannot_be_completed(tmp_path: Path) -> None:
    with SessionWriter.create(tmp_path / "s", manifest()) as writer:
        writer.write_frame(writer.missing[0], picture(0))
        with pytest.raises(DataError, match=r"3 planned frames are missing, first L00_E0\.tif"):
            writer.complete()
    session = Session.open(tmp_path / "s")
    assert not session.complete
    assert [shot.led for shot in session.missing] == [0, 1, 2]
    found = verify_session(tmp_path / "s")
    assert (found.ok, found.complete, len(found.missing)) == (True, False, 3)


@pytest.mark.parametrize(
    ("pixels", "said"),
    [
        pytest.param(np.zeros((6, 9), np.uint16), "shape", id="size"),
        pytest.param(np.zeros((6, 8, 3), np.uint16), "shape", id="colour"),
        pytest.param(np.zeros((6, 8), np.uint8), "uint8", id="type"),
        pytest.param(np.full((6, 8), 4096, np.uint16), "12 bits", id="high-aligned"),
    ],
)
def test_a_frame_that_does_not_fit_is_refused(tmp_path: Path, pixels: UInt16, said: str) -> None:
    with SessionWriter.create(tmp_path / "s", manifest()) as writer:
        with pytest.raises(DataError, match=said):
            writer.write_frame(writer.missing[0], pixels)
        write_all(writer)
        writer.complete()
    assert verify_session(tmp_path / "s").ok


def test_a_shot_outside_the_plan_is_refused(tmp_path: Path) -> None:
    with (
        SessionWriter.create(tmp_path / "s", manifest()) as writer,
        pytest.raises(DataError, match="not in the plan"),
    ):
        writer.write_frame(PlannedShot("light", 9, 0, 0, 100.0), picture(0))


@pytest.mark.parametrize(
    "details",
    [
        pytest.param({"x": float("nan")}, id="nan"),
        pytest.param({"x": float("inf")}, id="infinite"),
        pytest.param({"x": object()}, id="object"),
    ],
)
def test_an_event_that_does_not_fit_json_is_refused(
    tmp_path: Path, details: dict[str, Any]
) -> None:
    with SessionWriter.create(tmp_path / "s", manifest()) as writer:
        with pytest.raises(DataError):
            writer.write_event("note", **details)
        writer.write_event("note", x=1.0)
    assert len(Session.open(tmp_path / "s").events) == 1


def test_a_folder_inside_a_session_is_refused(tmp_path: Path) -> None:
    SessionWriter.create(tmp_path / "s", manifest()).close()
    with pytest.raises(StorageError, match="is inside the session"):
        SessionWriter.create(tmp_path / "s" / "frames" / "again", manifest())
    assert not (tmp_path / "s" / "frames" / "again").exists()


def test_a_folder_that_is_not_empty_is_refused(tmp_path: Path) -> None:
    (tmp_path / "photo.tif").write_bytes(b"dear")
    with pytest.raises(StorageError, match=r"not empty \(it contains photo\.tif\)"):
        SessionWriter.create(tmp_path, manifest())
    assert [path.name for path in tmp_path.iterdir()] == ["photo.tif"]
    with pytest.raises(StorageError, match="cannot create"):
        SessionWriter.create(tmp_path / "photo.tif", manifest())
    assert (tmp_path / "photo.tif").read_bytes() == b"dear"


def test_a_second_writer_is_refused_in_this_process_and_in_another(
    tmp_path: Path, forks: ForkServer
) -> None:
    folder = tmp_path / "s"
    other = (
        "import sys; from acquisition.session.writer import SessionWriter\n"
        "from acquisition._errors import StorageError\n"
        "try: SessionWriter.reopen(sys.argv[1])\n"
        "except StorageError as error: print(error)\n"
    )
    with SessionWriter.create(folder, manifest()) as writer:
        write_all(writer)
        with pytest.raises(StorageError, match="another process"):
            SessionWriter.reopen(folder)
        with pytest.raises(StorageError, match="another process"):
            SessionWriter.create(folder, manifest())
        assert "another process is recording" in forks.run(other, folder).out
        writer.complete()
    assert verify_session(folder).ok


def test_the_lock_ends_with_the_writer(tmp_path: Path) -> None:
    SessionWriter.create(tmp_path / "s", manifest()).close()
    SessionWriter.reopen(tmp_path / "s").close()
    with SessionWriter.reopen(tmp_path / "s") as writer:
        write_all(writer)
        writer.complete()
        with pytest.raises(StorageError, match="closed"):
            writer.write_event("late")
    with pytest.raises(DataError, match="complete"):
        SessionWriter.reopen(tmp_path / "s")
    events = [line.event for line in Session.open(tmp_path / "s").events]
    assert events == ["reopened", "reopened"]


def test_reopening_keeps_torn_lines_and_unrecorded_files(tmp_path: Path) -> None:
    folder = tmp_path / "s"
    with SessionWriter.create(folder, manifest()) as writer:
        shots = writer.missing
        writer.write_frame(shots[0], picture(0))
        writer.write_frame(shots[1], picture(1))
    journal = folder / "journal.jsonl"
    whole, torn = journal.read_bytes()[:-30], journal.read_bytes().splitlines()[-1][:-29]
    journal.write_bytes(whole)
    orphan = (folder / "frames" / "L00_E0.tif").read_bytes()
    (folder / "frames" / ".part-L01_E0.tif").write_bytes(b"half a fr")
    before = Session.open(folder)
    assert [frame.role for frame in before.frames] == ["dark"]
    said = "line was interrupted"
    assert any(said in text and "journal.jsonl" in text for text in map(str, before.warnings))
    found = verify_session(folder)
    assert found.ok
    assert len(found.warnings) == 3
    with SessionWriter.reopen(folder) as writer:
        assert [shot.file for shot in writer.missing] == ["L00_E0.tif", "L01_E0.tif", "L02_E0.tif"]
        for shot in writer.missing:
            writer.write_frame(shot, picture(7))
        writer.complete()
    event = Session.open(folder).events[0]
    assert event.details["torn"] == torn.decode()
    assert event.details["unrecorded"] == ["derived/unrecorded/000_L00_E0.tif"]
    assert (folder / "derived/unrecorded/000_L00_E0.tif").read_bytes() == orphan
    assert not (folder / "frames" / ".part-L01_E0.tif").exists()
    after = verify_session(folder)
    assert (after.ok, after.complete, after.warnings) == (True, True, ())


def test_an_intact_line_without_its_newline_counts(tmp_path: Path) -> None:
    folder = tmp_path / "s"
    with SessionWriter.create(folder, manifest()) as writer:
        writer.write_frame(writer.missing[0], picture(0))
    journal = folder / "journal.jsonl"
    journal.write_bytes(journal.read_bytes()[:-1])
    assert len(Session.open(folder).frames) == 1
    codes = [notice.code for notice in Session.open(folder).warnings]
    assert codes == ["journal-line-unterminated"]
    with SessionWriter.reopen(folder) as writer:
        assert len(writer.missing) == 3
        write_all(writer)
        writer.complete()
    assert verify_session(folder).ok


def test_a_recording_that_ended_before_its_first_line_can_be_reopened(tmp_path: Path) -> None:
    folder = tmp_path / "s"
    SessionWriter.create(folder, manifest()).close()
    (folder / "journal.jsonl").unlink()
    assert [notice.code for notice in Session.open(folder).warnings] == ["journal-empty"]
    with SessionWriter.reopen(folder) as writer:
        write_all(writer)
        writer.complete()
    assert verify_session(folder).ok


def test_a_folder_that_is_not_a_session_cannot_be_reopened(tmp_path: Path) -> None:
    with pytest.raises(MissingPathError):
        SessionWriter.reopen(tmp_path / "none")
    with pytest.raises(DataError, match="not a session"):
        SessionWriter.reopen(tmp_path)
    (tmp_path / "file").touch()
    with pytest.raises(DataError, match="not a session"):
        SessionWriter.reopen(tmp_path / "file")


def test_a_frame_file_that_was_lost_is_not_replaced_under_its_name(tmp_path: Path) -> None:
    folder = tmp_path / "s"
    with SessionWriter.create(folder, manifest()) as writer:
        shot = writer.missing[0]
        writer.write_frame(shot, picture(0))
    (folder / "frames" / "D_100us.tif").unlink()
    with SessionWriter.reopen(folder) as writer:
        assert writer.write_frame(shot, picture(1)).file == "frames/D_100us_R1.tif"


def test_times_are_those_of_the_clock(tmp_path: Path) -> None:
    moment = datetime(2026, 5, 6, 7, 8, 9, 10, tzinfo=UTC)
    with SessionWriter.create(tmp_path / "s", manifest(), clock=lambda: moment) as writer:
        line = writer.write_event("note")
    assert isinstance(line, EventLine)
    assert line.time_utc == "2026-05-06T07:08:09.000010+00:00"
