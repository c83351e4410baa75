"""Damaged recorded frames: named, never completed, and retaken on request."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from acquisition import (
    CapturePlan,
    DataError,
    RecordingHooks,
    Session,
    StorageError,
    read_source,
    record,
    resume,
    verify_session,
)
from acquisition.engine import check_resume
from acquisition.session import Echo, Manifest, SessionWriter, compact_session, damaged_frames
from acquisition.session import frame_proofs as _frame_proofs
from rig import Rig
from rig.host import clock
from tests.acquisition.fake_bench import LABELS, PLAN, Bench, cut, events_of, flip, rig_on, seen
from tests.acquisition.mutants import rows_of, seal
from tests.quick_sample import quick

# PLAN has LEDs 3, 0, 5 at 200 and 50 us, with dark and ambient frames: ten shots.


def flipped(*names: str) -> Callable[[Path], None]:
    return lambda folder: [flip(folder / "frames" / name) for name in names] and None


def lost(name: str) -> Callable[[Path], None]:
    return lambda folder: (folder / "frames" / name).unlink()


def shortened(name: str) -> Callable[[Path], None]:
    return lambda folder: os.truncate(folder / "frames" / name, 100)


def swapped(one: str, other: str) -> Callable[[Path], None]:
    def harm(folder: Path) -> None:
        frames = folder / "frames"
        (frames / one).rename(frames / "x")
        (frames / other).rename(frames / one)
        (frames / "x").rename(frames / other)

    return harm


def linked_out(name: str) -> Callable[[Path], None]:
    def harm(folder: Path) -> None:
        (folder / "frames" / name).rename(folder.parent / "elsewhere.tif")
        (folder / "frames" / name).symlink_to(folder.parent / "elsewhere.tif")

    return harm


def a_folder(name: str) -> Callable[[Path], None]:
    def harm(folder: Path) -> None:
        (folder / "frames" / name).unlink()
        (folder / "frames" / name).mkdir()

    return harm


def other_figures(folder: Path) -> None:
    """Change the grey values in a line, with valid hashes."""
    rows = rows_of(folder)
    row = next(row for row in rows if row.get("file") == "frames/L03_E0.tif")
    row["percentiles_dn"]["50"] += 1
    seal(folder, rows)


def two_of_one_file(folder: Path) -> None:
    """Make two lines name one file; the other file has no line."""
    rows = rows_of(folder)
    by_file = {row["file"]: row for row in rows if row["kind"] == "frame"}
    for key in ("file", "bytes", "file_sha256", "pixels_sha256"):
        by_file["frames/L00_E0.tif"][key] = by_file["frames/L03_E0.tif"][key]
    seal(folder, rows)


def two_by_case(folder: Path) -> None:
    """Make two names equal except for case: some file systems treat them as one."""
    rows = rows_of(folder)
    next(row for row in rows if row.get("file") == "frames/L00_E0.tif")["file"] = (
        "frames/l03_e0.tif"
    )
    (folder / "frames/L00_E0.tif").rename(folder / "frames/l03_e0.tif")
    seal(folder, rows)


HARMS = [
    pytest.param(flipped("L03_E0.tif"), ["L03_E0.tif"], id="bit flipped"),
    pytest.param(swapped("L03_E0.tif", "L00_E0.tif"), ["L03_E0.tif", "L00_E0.tif"], id="swapped"),
    pytest.param(lost("L00_E0.tif"), ["L00_E0.tif"], id="lost"),
    pytest.param(shortened("L00_E0.tif"), ["L00_E0.tif"], id="shortened"),
    pytest.param(flipped("D_200us.tif", "A_200us.tif"), ["D_200us.tif", "A_200us.tif"], id="dark"),
    pytest.param(linked_out("L03_E0.tif"), ["L03_E0.tif"], id="link"),
    pytest.param(a_folder("L03_E0.tif"), ["L03_E0.tif"], id="folder"),
    pytest.param(other_figures, ["L03_E0.tif"], id="figures"),
    pytest.param(two_of_one_file, ["L03_E0.tif", "L03_E0.tif"], id="one file"),
    pytest.param(two_by_case, ["L03_E0.tif", "l03_e0.tif"], id="one file by case"),
]


@pytest.mark.parametrize("at", [8, pytest.param(11, marks=pytest.mark.slow)])
@pytest.mark.parametrize(("harm", "names"), quick(HARMS, every=2))
def test_damage_is_named_and_retaken_only_on_request(
    rig: Rig,
    bench: Bench,
    tmp_path: Path,
    harm: Callable[[Path], None],
    names: list[str],
    at: int,
) -> None:
    folder = tmp_path / "s"
    if at > 10:
        record(rig, PLAN, folder, LABELS)
        (folder / "COMPLETE").unlink()  # killed just before
        bench.shots.clear()
    else:
        cut(rig, bench, folder, at)
    harm(folder)
    missing = max(0, 11 - at)
    found = verify_session(folder)
    assert list(found.damaged) == names
    assert {one.frame.path.name for one in damaged_frames(folder)} == set(names)
    reported: list[str] = []
    with pytest.raises(DataError) as caught:
        resume(rig, folder, hooks=RecordingHooks(on_damage=reported.append))
    assert any(name in str(caught.value) for name in names)
    assert "\n" not in str(caught.value)
    assert not (folder / "COMPLETE").exists()
    assert bench.led is None
    # Contradictions in the journal are known before the first shot, damaged files are not.
    assert len(bench.shots) in (0, missing)
    assert not reported or len(reported) == len(names)
    before = {
        path.name: path.is_symlink() or path.is_dir() or path.read_bytes() for path in kept(folder)
    }
    bench.shots.clear()
    left = len(Session.open(folder, damaged_frames=True).missing)
    events: list[tuple[str, Any]] = []
    session = resume(
        rig,
        folder,
        retake_damaged=True,
        hooks=RecordingHooks(on_event=lambda name, details: events.append((name, details))),
    )
    assert session.complete
    assert len(bench.shots) == left + len(names)
    assert [name for name, _ in events].count("set_aside") == len(names)
    for _, details in events:
        if details.get("kept"):
            path = folder / details["kept"]
            assert path.is_symlink() or path.exists()
            if path.is_file() and not path.is_symlink():
                assert path.read_bytes() == before[Path(details["file"]).name]
    for frame in session.frames:
        expected = seen(frame.led, PLAN.exposures_us[frame.bracket])
        np.testing.assert_array_equal(frame.read(), expected)
        assert frame.path.name not in names
    found = verify_session(folder)
    assert (found.problems, found.complete, list(found.set_aside)) == ((), True, names)
    assert len(read_source(folder).frames) == 10
    # It can be continued like any other session.
    assert compact_session(folder).complete
    assert verify_session(folder).ok


def kept(folder: Path) -> list[Path]:
    return sorted((folder / "frames").iterdir())


def test_a_complete_session_is_reopened_only_for_damage(
    rig: Rig, bench: Bench, tmp_path: Path
) -> None:
    folder = tmp_path / "s"
    record(rig, PLAN, folder, LABELS)
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    with pytest.raises(DataError, match="is complete"):
        resume(rig, folder, retake_damaged=True)
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before
    flip(folder / "frames/L05_E1.tif")
    with pytest.raises(DataError, match="is complete"):
        resume(rig, folder)
    assert (folder / "COMPLETE").exists()
    bench.shots.clear()
    assert resume(rig, folder, retake_damaged=True).complete
    assert bench.shots == [5]
    assert verify_session(folder).ok


def test_frames_that_do_not_count_are_set_aside_and_not_retaken(
    rig: Rig, bench: Bench, tmp_path: Path
) -> None:
    """A rejected take and a replaced one have lines, too, and their files are damaged."""
    folder = tmp_path / "s"
    bench.albedo = 30.0
    bench.on_trigger = lambda number: setattr(bench, "albedo", 1.0 if number > 5 else 30.0)
    record(rig, PLAN.changed(retakes=1, max_clipped_fraction=0.2), folder, LABELS)
    (folder / "COMPLETE").unlink()
    session = Session.open(folder)
    (rejected,) = (f for f in session.recorded if f.line.status == "rejected")
    with SessionWriter.reopen(folder) as writer:
        again = next(shot for shot in PLAN.shots() if shot.file == "L00_E0.tif")
        writer.write_frame(again, np.full((7, 10), 500, np.uint16), echo=Echo(seq=1, led=again.led))
    replaced = folder / "frames/L00_E0.tif"
    for path in (rejected.path, replaced):
        flip(path)
    bench.shots.clear()
    session = resume(rig, folder, retake_damaged=True)
    assert (session.complete, bench.shots) == (True, [])
    assert {one.frame.path for one in session.set_aside} == {rejected.path, replaced}
    assert verify_session(folder).ok


def test_a_replaced_take_stays_replaced(tmp_path: Path) -> None:
    """Its replacement is damaged, but the first take stays replaced."""
    camera = {"width": 10, "height": 7, "bit_depth": 12}
    plan = CapturePlan(repeat=False, leds=(0,), exposures_us=(100.0,), dark=False)
    manifest = Manifest.begin(tmp_path, plan=plan, camera=camera)
    folder = tmp_path / "s"
    with SessionWriter.create(folder, manifest) as writer:
        (shot,) = writer.missing
        for value in (1, 2):
            writer.write_frame(shot, np.full((7, 10), value, np.uint16))
    flip(folder / "frames/L00_E0_R1.tif")
    with SessionWriter.reopen(folder, set_aside_damaged=True) as writer:
        assert writer.missing == (shot,)
        assert (writer.shots.demanded, Session.open(folder).frames) == (1, ())
        line = writer.write_frame(
            shot, np.full((7, 10), 3, np.uint16), echo=Echo(seq=1, led=shot.led)
        )
        assert line.file == "frames/L00_E0_R2.tif"
        writer.complete()
    assert [int(frame.read()[0, 0]) for frame in Session.open(folder).frames] == [3]
    assert verify_session(folder).ok


def test_a_damaged_frame_of_an_led_that_died_since_is_left_out(
    rig: Rig, bench: Bench, tmp_path: Path
) -> None:
    folder = cut(rig, bench, tmp_path / "s", 9)
    flip(folder / "frames/L00_E0.tif")
    with rig_on(bench, dead_leds=(0, 4)) as knowing:
        found = damaged_frames(folder)
        _, _, shots = check_resume(knowing, folder, damaged=found)
        assert [shot.led for shot in shots] == [5]
        session = resume(knowing, folder, retake_damaged=True)
        assert bench.shots == [shot.led for shot in shots]
        assert session.complete
        assert [shot.file for shot in session.left_out] == ["L00_E0.tif", "L00_E1.tif"]
        assert verify_session(folder).ok
        # Once the LED is left out, its damaged frames are left out, too.
        flip(folder / "frames/L03_E0.tif")
        assert resume(knowing, folder, retake_damaged=True).complete
    assert verify_session(folder).ok


def test_dark_frames_are_retaken_before_the_lights_that_they_judge(
    rig: Rig, bench: Bench, tmp_path: Path
) -> None:
    folder = cut(rig, bench, tmp_path / "s", 6)
    flip(folder / "frames/A_200us.tif")
    flip(folder / "frames/D_50us.tif")
    resume(rig, folder, retake_damaged=True)
    assert bench.shots == [None, None, 0, 5, 3, 0, 5]


# ---------------------------------------------------------------- reading back


def test_complete_reads_frames_of_other_processes(
    rig: Rig, bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = cut(rig, bench, tmp_path / "s", 8)
    read: list[str] = []
    real = _frame_proofs.frame_damage

    def noted(frame: Any, camera: Any) -> Any:
        read.append(frame.path.name)
        return real(frame, camera)

    monkeypatch.setattr(_frame_proofs, "frame_damage", noted)
    with SessionWriter.reopen(folder) as writer:
        assert writer.proofs.checked == (0, 7)
        earlier = [frame.path.name for frame in Session.open(folder).recorded]
        assert writer.proofs.check_next()
        assert (read, writer.proofs.checked) == (earlier[:1], (1, 7))
        for shot in writer.missing:
            pixels = seen(shot.led, shot.exposure_us or 0)
            writer.write_frame(shot, pixels, echo=Echo(seq=1, led=shot.led))
        # One file changed after writing, one after reading: each is read once more.
        (folder / "frames/L05_E1.tif").touch()
        (folder / "frames" / earlier[0]).touch()
        writer.complete()
    assert read == [*earlier, earlier[0], "L05_E1.tif"]


@pytest.mark.parametrize("name", ["D_200us.tif", "L05_E1.tif"])
def test_a_frame_that_is_damaged_while_the_writer_is_open_is_detected(
    rig: Rig, bench: Bench, tmp_path: Path, name: str
) -> None:
    """Both frames that were read back and frames that this process wrote."""
    folder = cut(rig, bench, tmp_path / "s", 8)
    with SessionWriter.reopen(folder) as writer:
        while writer.proofs.check_next():
            pass
        for shot in writer.missing:
            pixels = seen(shot.led, shot.exposure_us or 0)
            writer.write_frame(shot, pixels, echo=Echo(seq=1, led=shot.led))
        time.sleep(0.02)  # timestamps of file systems are coarse
        flip(folder / "frames" / name)
        with pytest.raises(DataError, match=f"{name}: was changed since it was recorded"):
            writer.complete()
    assert not (folder / "COMPLETE").exists()


def test_earlier_frames_are_read_while_the_writers_are_idle(
    rig: Rig, bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = cut(rig, bench, tmp_path / "s", 8)
    flip(folder / "frames/D_50us.tif")
    reported: list[str] = []
    threads: set[str] = set()
    real = _frame_proofs.frame_damage

    def noted(frame: Any, camera: Any) -> Any:
        threads.add(threading.current_thread().name)
        return real(frame, camera)

    monkeypatch.setattr(_frame_proofs, "frame_damage", noted)
    bench.on_trigger = lambda number: time.sleep(0.05)
    with pytest.raises(DataError, match=r"D_50us\.tif: was changed since it was recorded"):
        resume(
            rig,
            folder,
            hooks=RecordingHooks(
                on_damage=lambda text: reported.append(f"{len(bench.shots)} {text}")
            ),
        )
    # It is reported while shots are taken, and the recording continues.
    assert len(reported) == 1
    assert int(reported[0].partition(" ")[0]) < len(bench.shots) == 3
    assert all(name.startswith("writer") for name in threads)
    session = Session.open(folder)
    assert (len(session.missing), session.complete) == (0, False)
    assert events_of(session)[-1].event == "failed"
    assert "D_50us.tif" in str(events_of(session)[-1].details["reason"])


@pytest.mark.usefixtures("world")
def test_a_disk_that_does_not_return_frames_is_reported(
    rig: Rig, bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = cut(rig, bench, tmp_path / "s", 8)
    monkeypatch.setattr(_frame_proofs, "frame_damage", lambda frame, camera: clock.sleep(5))
    with pytest.raises(StorageError, match="reading a frame back has taken"):
        resume(rig, folder, stall_s=0.5)
    assert not Session.open(folder).complete
