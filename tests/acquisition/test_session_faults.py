"""Disks that refuse, and interrupts at the wrong moment: recorded frames stay intact."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from acquisition import (
    CapturePlan,
    DataError,
    Session,
    StorageError,
    read_image,
    verify_session,
)
from acquisition.files import storage
from acquisition.session import SessionWriter
from tests.acquisition import small_session

PLAN = CapturePlan(leds=(0, 1, 2), exposures_us=(100.0,))
manifest = partial(small_session.manifest, (6, 8), 12, plan=PLAN)
picture = partial(small_session.picture, shape=(6, 8), above=4096)


def write_all(writer: SessionWriter, start: int = 0) -> None:
    for index, shot in enumerate(writer.missing, start):
        writer.write_frame(shot, picture(index))


@pytest.mark.parametrize("call", ["write", "fsync", "replace"])
@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EROFS, errno.EIO])
def test_a_disk_that_refuses(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: str, code: int
) -> None:
    folder = tmp_path / "s"
    real = getattr(os, call)
    left = [99]

    def failing(*arguments: Any) -> Any:
        left[0] -= 1
        if left[0] < 0:
            raise OSError(code, os.strerror(code))
        return real(*arguments)

    monkeypatch.setattr(os, call, failing)
    recorded = 0
    with SessionWriter.create(folder, manifest()) as writer:
        shots = writer.missing
        writer.write_frame(shots[0], picture(0))
        left[0] = {"write": 0, "fsync": 2, "replace": 1}[call]
        with pytest.raises(StorageError) as caught:
            write_all(writer, 1)
        message = str(caught.value)
        assert str(folder) in message
        assert os.strerror(code) in message
        assert "\n" not in message
        left[0] = 99
        recorded = len(Session.open(folder).frames)
    found = verify_session(folder)
    assert found.ok
    assert not found.complete
    for index, frame in enumerate(Session.open(folder).frames):
        np.testing.assert_array_equal(frame.read(), picture(index))
    with SessionWriter.reopen(folder) as writer:
        assert len(writer.missing) == 5 - recorded
        for shot in writer.missing:
            writer.write_frame(shot, picture(shots.index(shot)))
        writer.complete()
    assert verify_session(folder).ok


def test_the_file_of_a_write_that_failed_late_is_kept_outside_the_complete_session(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The folder is not flushed after the rename, and the program tries again."""
    folder = tmp_path / "s"
    with SessionWriter.create(folder, manifest()) as writer:
        shot, *others = writer.missing
        with monkeypatch.context() as failing:
            failing.setattr(storage, "sync_folder", lambda folder: os.fsync(-1))
            with pytest.raises(StorageError):
                writer.write_frame(shot, picture(9))
        write_all(writer)
        writer.complete()
    assert verify_session(folder).ok
    assert len(list((folder / "frames").iterdir())) == 1 + len(others)
    (kept,) = (folder / "derived" / "unrecorded").iterdir()
    np.testing.assert_array_equal(read_image(kept), picture(9))


def test_a_write_that_ends_after_the_session_was_completed_leaves_it_sound(tmp_path: Path) -> None:
    folder, writer = tmp_path / "s", SessionWriter.create(tmp_path / "s", manifest())
    shot = writer.missing[0]
    write_all(writer)
    with pytest.raises(StorageError, match="is closed"):
        writer.write_frame(shot, picture(9), before_line=writer.complete)
    assert verify_session(folder).ok
    assert verify_session(folder).complete


def test_no_line_is_appended_after_a_partly_written_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "s"
    real = os.write
    calls = [0]
    journal = 0

    def half(descriptor: int, data: Any) -> int:
        if os.fstat(descriptor).st_ino != journal:
            return real(descriptor, data)
        calls[0] += 1
        if calls[0] == 2:
            raise OSError(errno.ENOSPC, "full")
        return real(descriptor, bytes(data)[: len(data) // 2])

    with SessionWriter.create(folder, manifest()) as writer:
        shots = writer.missing
        writer.write_frame(shots[0], picture(0))
        journal = (folder / "journal.jsonl").stat().st_ino
        monkeypatch.setattr(os, "write", half)
        with pytest.raises(StorageError, match="cannot append"):
            writer.write_frame(shots[1], picture(1))
        monkeypatch.undo()
        with pytest.raises(StorageError, match="reopen the session"):
            writer.write_frame(shots[1], picture(1))
        with pytest.raises(StorageError, match="reopen the session"):
            writer.write_event("failed")
    assert len(Session.open(folder).frames) == 1
    with SessionWriter.reopen(folder) as writer:
        for shot in writer.missing:
            writer.write_frame(shot, picture(3))
        writer.complete()
    assert verify_session(folder).ok


def test_ctrl_c_between_a_line_and_its_acknowledgement_leaves_a_sound_session(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "s"
    real = os.fsync
    with SessionWriter.create(folder, manifest()) as writer:
        shot = writer.missing[0]
        journal = (folder / "journal.jsonl").stat().st_ino

        def interrupted(descriptor: int) -> None:
            real(descriptor)
            if os.fstat(descriptor).st_ino == journal:
                raise KeyboardInterrupt

        monkeypatch.setattr(os, "fsync", interrupted)
        with pytest.raises(KeyboardInterrupt):
            writer.write_frame(shot, picture(0))
        monkeypatch.undo()
        with pytest.raises(StorageError, match="reopen"):
            writer.write_event("interrupted")
    assert [frame.line.key for frame in Session.open(folder).frames] == [shot.key]
    assert verify_session(folder).ok


def test_changes_of_the_journal_by_another_program_are_detected(tmp_path: Path) -> None:
    folder = tmp_path / "s"
    with SessionWriter.create(folder, manifest()) as writer:
        write_all(writer)
        with (folder / "journal.jsonl").open("ab") as file:
            file.write(b"{}\n")
        with pytest.raises(StorageError, match="another program"):
            writer.complete()
    assert not (folder / "COMPLETE").exists()


def test_a_frame_is_on_disk_under_its_name_before_its_line_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The order matters after a power cut, which a killed process cannot simulate."""
    folder = tmp_path / "s"
    log: list[tuple[str, object]] = []
    write, fsync, replace = os.write, os.fsync, os.replace

    def logged_write(descriptor: int, data: Any) -> int:
        log.append(("write", os.fstat(descriptor).st_ino))
        return write(descriptor, data)

    def logged_fsync(descriptor: int) -> None:
        log.append(("fsync", os.fstat(descriptor).st_ino))
        fsync(descriptor)

    def logged_replace(old: Path, new: Path) -> None:
        log.append(("rename", Path(new).name))
        replace(old, new)

    with SessionWriter.create(folder, manifest()) as writer:
        monkeypatch.setattr(os, "write", logged_write)
        monkeypatch.setattr(os, "fsync", logged_fsync)
        monkeypatch.setattr(os, "replace", logged_replace)
        line = writer.write_frame(writer.missing[0], picture(0))
        file, journal = folder / line.file, folder / "journal.jsonl"
        assert log[-5:] == [
            ("fsync", file.stat().st_ino),
            ("rename", file.name),
            ("fsync", file.parent.stat().st_ino),
            ("write", journal.stat().st_ino),
            ("fsync", journal.stat().st_ino),
        ]
        write_all(writer)
        log.clear()
        writer.complete()
        assert log[-4:] == [
            ("write", (folder / "COMPLETE").stat().st_ino),
            ("fsync", (folder / "COMPLETE").stat().st_ino),
            ("rename", "COMPLETE"),
            ("fsync", folder.stat().st_ino),
        ]


def interrupted(folder: Path) -> Path:
    """Leave a session whose first frame was written but has no line."""
    with SessionWriter.create(folder, manifest()) as writer:
        writer.write_frame(writer.missing[0], picture(0))
    journal = folder / "journal.jsonl"
    journal.write_bytes(journal.read_bytes()[:-30])
    return folder


def test_nothing_is_set_aside_outside_the_session(tmp_path: Path) -> None:
    folder = interrupted(tmp_path / "s")
    outside = tmp_path / "outside"
    outside.mkdir()
    (folder / "derived").symlink_to(outside)
    with pytest.raises(DataError, match="derived/unrecorded: is a link that leaves the session"):
        SessionWriter.reopen(folder)
    assert list(outside.iterdir()) == []
    assert (folder / "frames" / "D_100us.tif").exists()


def test_a_hidden_folder_among_the_frames_is_ignored(tmp_path: Path) -> None:
    """File managers and indexers create hidden folders."""
    folder = interrupted(tmp_path / "s")
    (folder / "frames" / ".thumbnails").mkdir()
    (folder / "frames" / ".thumbnails" / "a.png").write_bytes(b"small")
    with SessionWriter.reopen(folder) as writer:
        write_all(writer)
        writer.complete()
    assert (folder / "frames" / ".thumbnails" / "a.png").read_bytes() == b"small"
    found = verify_session(folder)
    assert (found.ok, found.complete, found.warnings) == (True, True, ())


def lost(path: Path) -> None:
    path.unlink()


def shortened(path: Path) -> None:
    os.truncate(path, 100)


@pytest.mark.parametrize("harm", [lost, shortened])
def test_a_recording_that_lost_a_frame_is_not_declared_complete(
    tmp_path: Path, harm: Callable[[Path], None]
) -> None:
    """Disks that ignore fsync lose files in a power cut; the operator can still retake the shot."""
    folder = tmp_path / "s"
    with SessionWriter.create(folder, manifest()) as writer:
        first = writer.write_frame(writer.missing[0], picture(0))
    kept = (folder / first.file).read_bytes()
    harm(folder / first.file)
    with SessionWriter.reopen(folder) as writer:
        write_all(writer, 1)
        with pytest.raises(
            DataError, match=r"D_100us\.tif: (has 100 bytes|is in the journal but not there)"
        ):
            writer.complete()
    assert not (folder / "COMPLETE").exists()
    (folder / first.file).write_bytes(kept)
    with SessionWriter.reopen(folder) as writer:
        assert writer.missing == ()
        writer.complete()
    assert verify_session(folder).ok
