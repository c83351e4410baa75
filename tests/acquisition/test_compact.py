"""Compaction: pixels stay the same, and no crash or full disk loses a frame or looks like damage.

The processes that are killed are forked from a server that has imported all modules.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from acquisition import (
    CapturePlan,
    DataError,
    MissingPathError,
    Session,
    StorageError,
    read_image,
    read_source,
    verify_session,
)
from acquisition.files.storage import lock_folder
from acquisition.pixels.compact_tiff import deflate_tiff
from acquisition.plan import PlannedShot
from acquisition.session import SessionWriter, compact_session
from acquisition.session import compact as _compact
from rig.arrays import UInt16
from tests.acquisition.small_session import PLAN, SHAPE, manifest, names, picture, whole, write


def noise() -> UInt16:
    return np.random.default_rng(9).integers(0, 65536, SHAPE).astype(np.uint16)


@pytest.mark.parametrize("plan", [pytest.param(PLAN, id="planned"), pytest.param(None, id="free")])
def test_a_complete_session_gets_smaller_and_stays_complete(
    tmp_path: Path, plan: CapturePlan | None
) -> None:
    folder = write(tmp_path / "s", plan=plan)
    before = verify_session(folder)
    hashes = [frame.line.pixels_sha256 for frame in Session.open(folder).frames]
    reports: list[tuple[str, int, int]] = []
    done = compact_session(folder, on_progress=lambda *report: reports.append(report))
    assert whole(folder)
    after = verify_session(folder)
    assert (done.frames, done.compacted, done.complete) == (3, 3, True)
    assert (done.bytes_before, done.bytes_after) == (before.bytes, after.bytes)
    assert after.bytes < 0.7 * before.bytes
    assert after.warnings == ()
    assert reports == [("compacting", n, 3) for n in (1, 2, 3)]
    assert names(folder) == ["D_100us.z.tif", "L00_E0.z.tif", "L01_E0.z.tif"]
    session = Session.open(folder)
    assert [frame.line.pixels_sha256 for frame in session.frames] == hashes
    assert [event.event for event in session.events] == ["reopened", *["compacted"] * 3]
    assert read_source(folder).light_ids == ("L00", "L01")
    assert not (folder / "derived" / "COMPLETE").exists()


def test_a_second_compaction_changes_nothing(tmp_path: Path) -> None:
    folder = write(tmp_path / "s")
    compact_session(folder)
    files = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    again = compact_session(folder)
    assert (again.compacted, again.complete) == (0, True)
    assert again.bytes_before == again.bytes_after
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == files


def test_a_frame_that_was_damaged_since_its_compaction_is_named(tmp_path: Path) -> None:
    folder = write(tmp_path / "s")
    compact_session(folder)
    damaged = sorted((folder / "frames").glob("*.z.tif"))[1]
    data = bytearray(damaged.read_bytes())
    data[-1] ^= 1
    damaged.write_bytes(data)
    with pytest.raises(DataError, match=f"{damaged.name}: was changed since"):
        compact_session(folder)


def test_an_incomplete_session_stays_so_and_can_be_finished(tmp_path: Path) -> None:
    folder = write(tmp_path / "s", complete=False)
    done = compact_session(folder)
    assert (done.compacted, done.complete) == (2, False)
    assert not whole(folder)
    with SessionWriter.reopen(folder) as writer:
        (shot,) = writer.missing
        writer.write_frame(shot, picture(2))
        writer.complete()
    assert names(folder) == ["D_100us.z.tif", "L00_E0.z.tif", "L01_E0.tif"]
    assert compact_session(folder).compacted == 1
    assert whole(folder)


def test_a_retake_after_compaction_gets_a_name_of_its_own(tmp_path: Path) -> None:
    folder = write(tmp_path / "s", complete=False)
    compact_session(folder)
    with SessionWriter.reopen(folder) as writer:
        writer.write_frame(PLAN.shots()[0], picture(2))
    compact_session(folder)
    assert names(folder) == ["D_100us.z.tif", "D_100us_R1.z.tif", "L00_E0.z.tif"]
    assert not whole(folder)


def test_frames_that_do_not_get_smaller_keep_their_file(tmp_path: Path) -> None:
    folder = tmp_path / "s"
    with SessionWriter.create(folder, manifest()) as writer:
        writer.write_frame(PlannedShot("light", 0, 0, 0, None), noise())
        writer.complete()
    files = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    assert compact_session(folder).compacted == 0
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == files


def test_folders_that_cannot_be_compacted(tmp_path: Path) -> None:
    with pytest.raises(MissingPathError, match="no such folder"):
        compact_session(tmp_path / "none")
    (tmp_path / "file").write_text("")
    with pytest.raises(DataError, match="it is a file"):
        compact_session(tmp_path / "file")
    (tmp_path / "empty").mkdir()
    with pytest.raises(DataError, match="is not a session"):
        compact_session(tmp_path / "empty")


def test_while_another_process_has_the_session_nothing_is_touched(tmp_path: Path) -> None:
    folder = write(tmp_path / "s")
    lock = lock_folder(folder)
    try:
        with pytest.raises(StorageError, match="another process"):
            compact_session(folder)
    finally:
        os.close(lock)
    assert whole(folder)


@pytest.mark.parametrize(
    "spoil",
    [
        pytest.param(lambda data: data[:-1] + bytes([data[-1] ^ 1]), id="pixel"),
        pytest.param(lambda data: data[:4] + data[4:5] + data[5:-8], id="short"),
        pytest.param(lambda data: data + b"\0", id="same-pixels-longer-file"),
        pytest.param(None, id="gone"),
    ],
)
def test_a_damaged_frame_is_named_and_nothing_else_suffers(
    tmp_path: Path, spoil: Callable[[bytes], bytes] | None
) -> None:
    folder = write(tmp_path / "s")
    frame = folder / "frames" / "L01_E0.tif"
    data = frame.read_bytes()
    frame.unlink()
    if spoil is not None:
        frame.write_bytes(spoil(data))
    with pytest.raises(DataError, match=r"L01_E0\.tif"):
        compact_session(folder)
    assert verify_session(folder).complete
    assert [problem.split(":")[0] for problem in verify_session(folder).problems] == [str(frame)]
    frame.write_bytes(data)
    assert compact_session(folder).compacted == 1
    assert whole(folder)


def test_a_file_that_does_not_read_back_is_never_recorded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = write(tmp_path / "s")
    files = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    real = deflate_tiff
    monkeypatch.setattr(_compact, "deflate_tiff", lambda pixels: real(pixels ^ np.uint16(1)))
    with pytest.raises(StorageError, match=r"D_100us\.z\.tif: the data read back differ"):
        compact_session(folder)
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == files


def test_the_old_file_stays_if_the_new_one_is_damaged(tmp_path: Path) -> None:
    """A crash left both files, and the new one was damaged later: the old one must be kept."""
    folder = write(tmp_path / "s", complete=False)
    old = (folder / "frames" / "L00_E0.tif").read_bytes()
    compact_session(folder)
    (folder / "frames" / "L00_E0.tif").write_bytes(old)
    new = folder / "frames" / "L00_E0.z.tif"
    new.write_bytes(new.read_bytes()[:-1])
    with pytest.raises(DataError, match=r"L00_E0\.z\.tif"):
        compact_session(folder)
    assert (folder / "frames" / "L00_E0.tif").read_bytes() == old


@given(
    st.tuples(st.integers(1, 150), st.integers(1, 40), st.sampled_from([1, 3])),
    st.sampled_from([1, 255, 4095, 65535]),
    st.integers(0, 2**32 - 1),
)
def test_every_image_reads_back_from_the_compressed_file(
    tmp_path_factory: pytest.TempPathFactory,
    shape: tuple[int, int, int],
    largest: int,
    seed: int,
) -> None:
    pixels = np.random.default_rng(seed).integers(0, largest, shape, endpoint=True)
    image = pixels.astype(np.uint16)
    image = image[..., 0] if shape[2] == 1 else image
    path = tmp_path_factory.mktemp("tiff") / "a.tif"
    path.write_bytes(deflate_tiff(image))
    np.testing.assert_array_equal(read_image(path), image)
    # Another reader, with another order of the colours.
    other = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(other, image if image.ndim == 2 else image[..., ::-1])
