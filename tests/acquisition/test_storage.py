from __future__ import annotations

import errno
import os
import stat
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from acquisition import (
    DataError,
    Lights,
    Session,
    StorageError,
    import_frames,
    read_image,
    verify_session,
    write_durably,
    write_png,
)
from acquisition.exports import Caption
from acquisition.exports.captioned_images import write_captioned_exr, write_captioned_png
from acquisition.exports.tables import write_diligent_tables
from acquisition.files import part_files as _part_files
from acquisition.files import storage as _storage
from acquisition.imports import read_import
from acquisition.pixels import read_raw
from acquisition.session import SessionWriter, SoftwareRecord
from tests.acquisition import small_session

PIXELS = np.arange(48, dtype=np.uint16).reshape(6, 8)
CAPTION = Caption(
    small_session.manifest((3, 4), 12, software=SoftwareRecord(name="program", version="1"))
)
manifest = partial(small_session.manifest, (6, 8), 12, plan=small_session.PLAN)


def test_a_session_is_recorded_without_fsync_of_folders(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = os.fsync

    def files_only(descriptor: int) -> None:
        if stat.S_ISDIR(os.fstat(descriptor).st_mode):
            raise OSError(errno.EINVAL, os.strerror(errno.EINVAL))
        real(descriptor)

    monkeypatch.setattr(os, "fsync", files_only)
    with SessionWriter.create(tmp_path / "s", manifest()) as writer:
        for shot in writer.missing:
            writer.write_frame(shot, PIXELS)
        writer.complete()
    assert verify_session(tmp_path / "s").ok


def test_a_failing_fsync_of_a_folder_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def failing(descriptor: int) -> None:
        if stat.S_ISDIR(os.fstat(descriptor).st_mode):
            raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr(os, "fsync", failing)
    with pytest.raises(StorageError, match="the disk fails"):
        write_durably(tmp_path / "a", b"data")


def test_nothing_is_written_as_text(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Windows writes a carriage return before each newline unless a file is opened as binary."""
    binary = 0o100000  # O_LARGEFILE here, which has no effect
    for module in (_storage, _part_files):
        monkeypatch.setattr(module, "BINARY", binary)
    real = os.open
    asked: list[int] = []

    def logged(path: Any, flags: int, *mode: int) -> int:
        if flags & os.O_WRONLY:
            asked.append(flags)
        return real(path, flags, *mode)

    monkeypatch.setattr(os, "open", logged)
    with SessionWriter.create(tmp_path / "s", manifest()) as writer:
        writer.write_frame(writer.missing[0], PIXELS)
    assert len(asked) >= 2  # the journal and a frame
    assert all(flags & binary for flags in asked)


def test_a_png_that_does_not_read_back_replaces_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_captioned_png(tmp_path / "a.png", PIXELS, CAPTION)
    before = (tmp_path / "a.png").read_bytes()
    real = os.write
    # A disk that stores another image, whose file is intact.
    monkeypatch.setattr(
        os, "write", lambda descriptor, data: real(descriptor, before) * 0 + len(data)
    )
    with pytest.raises(StorageError, match="does not read back"):
        write_captioned_png(tmp_path / "a.png", PIXELS[::-1], CAPTION)
    monkeypatch.undo()
    assert [path.name for path in tmp_path.iterdir()] == ["a.png"]
    assert (tmp_path / "a.png").read_bytes() == before


def test_normals_that_the_disk_refuses_leave_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = os.write
    lights = Lights(directions=np.array([[0.0, 0.0, 1.0]]))

    def full(descriptor: int, data: Any) -> int:
        if os.readlink(f"/proc/self/fd/{descriptor}").endswith("Normal_gt.mat"):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return real(descriptor, data)

    monkeypatch.setattr(os, "write", full)
    with pytest.raises(StorageError, match=r"Normal_gt\.mat: cannot write: No space left"):
        write_diligent_tables(tmp_path, ["001.png"], lights, np.zeros((2, 2, 3), np.float32))
    assert not any(path.name.startswith(".") for path in tmp_path.iterdir())


@pytest.fixture
def latin(tmp_path: Path) -> Path:
    """Return a folder whose name is not UTF-8, as on old disks."""
    folder = Path(os.fsdecode(os.fsencode(tmp_path) + b"/caf\xe9"))
    try:
        folder.mkdir()
    except OSError:
        pytest.skip("this file system only allows names in UTF-8")
    return folder


def test_names_that_image_libraries_cannot_open_are_reported(latin: Path) -> None:
    (latin / "a.png").write_bytes(b"\x89PNG\r\n\x1a\n")
    (latin / "a.dng").write_bytes(b"x")
    for read in (
        lambda: read_image(latin / "a.png"),
        lambda: read_raw(latin / "a.dng"),
        lambda: write_png(latin / "b.png", PIXELS),
        lambda: write_captioned_png(latin / "b.png", PIXELS, CAPTION),
        lambda: write_captioned_exr(latin / "b.exr", PIXELS.astype(np.float32), CAPTION, {}),
    ):
        with pytest.raises(DataError, match=r"not UTF-8: rename the file or its folder"):
            read()
    assert sorted(path.name for path in latin.iterdir()) == ["a.dng", "a.png"]


def test_a_session_whose_frames_could_not_be_read_is_not_created(latin: Path) -> None:
    with pytest.raises(DataError, match="not UTF-8"):
        SessionWriter.create(latin / "s", manifest())
    assert list(latin.iterdir()) == []


def test_an_import_keeps_strange_names(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    for number in range(2):
        write_png(tmp_path / "in" / f"日本\n{number}.png", PIXELS)
    import_frames(read_import(tmp_path / "in"), tmp_path / "out")
    session = Session.open(tmp_path / "out")
    assert [frame.line.origin for frame in session.frames] == ["日本\n0.png", "日本\n1.png"]
    assert verify_session(tmp_path / "out").ok
