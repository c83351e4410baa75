"""Links and pipes under the names that are written next: files outside are never touched.

tests/sgp/test_planted_links.py plants links at every name that is written; the tests here cover
cases that were found first and cases that only a race can reach.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from acquisition import DataError, Session, StorageError, verify_session
from acquisition.session import SessionWriter, compact_session
from tests.acquisition.planted import PLANTED, Plant, unharmed
from tests.acquisition.small_session import PLAN, manifest, picture
from tests.cases import cases

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="needs links and pipes")

LINKS = {name: PLANTED[name] for name in ("link", "hard_link", "pipe")}


def started(folder: Path, frames: int) -> Path:
    """Start a session and write the given number of its three frames."""
    with SessionWriter.create(folder, manifest(plan=PLAN)) as writer:
        for index, shot in enumerate(PLAN.shots()[:frames]):
            writer.write_frame(shot, picture(index))
        if frames == 3:
            writer.complete()
    return folder


def finish(folder: Path) -> None:
    with SessionWriter.reopen(folder) as writer:
        for shot in writer.missing:
            writer.write_frame(shot, picture(PLAN.shots().index(shot)))
        writer.complete()


def whole(folder: Path) -> None:
    found = verify_session(folder)
    assert (found.problems, found.complete) == ((), True)
    for index, frame in enumerate(Session.open(folder).recorded):
        assert not frame.path.is_symlink()
        np.testing.assert_array_equal(frame.read(), picture(index))


@cases("plant", LINKS)
@pytest.mark.parametrize(
    "name",
    [".part-journal.jsonl", ".part-COMPLETE", "frames/.part-L00_E0.tif", "frames/L00_E0.tif"],
)
def test_reopening(tmp_path: Path, victim: Path, name: str, plant: Plant) -> None:
    folder = started(tmp_path / "s", 1)
    plant(folder / name, victim)
    finish(folder)
    whole(folder)
    assert unharmed(victim)


@cases("plant", LINKS)
def test_creating(tmp_path: Path, victim: Path, plant: Plant) -> None:
    (tmp_path / "s").mkdir()
    plant(tmp_path / "s" / ".part-session.toml", victim)
    whole(started(tmp_path / "s", 3))
    assert unharmed(victim)


@cases("plant", LINKS)
@pytest.mark.parametrize(
    "name",
    [
        "frames/.part-L01_E0.z.tif",
        "frames/L01_E0.z.tif",
        ".part-COMPLETE",
        ".part-journal.jsonl",
        "derived/.part-COMPLETE",
        "derived/COMPLETE",
    ],
)
def test_compacting(tmp_path: Path, victim: Path, name: str, plant: Plant) -> None:
    folder = started(tmp_path / "s", 3)
    (folder / "derived").mkdir()
    plant(folder / name, victim)
    assert compact_session(folder).compacted == 3
    whole(folder)
    assert unharmed(victim)


@cases("plant", LINKS)
def test_an_original_stays_until_its_copy_was_read_back(
    tmp_path: Path, victim: Path, plant: Plant, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another program replaces the new file by a link right after its rename."""
    folder = started(tmp_path / "s", 3)
    originals = {path: path.read_bytes() for path in (folder / "frames").iterdir()}
    real = os.replace

    def raced(old: Any, new: Any) -> None:
        real(old, new)
        if Path(new).name == "L00_E0.z.tif":
            Path(new).unlink()
            plant(Path(new), victim)

    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", raced)
        with pytest.raises(StorageError, match=r"L00_E0\.z\.tif: "):
            compact_session(folder)
    assert (folder / "frames/L00_E0.tif").read_bytes() == originals[folder / "frames/L00_E0.tif"]
    assert compact_session(folder).compacted == 2
    whole(folder)
    assert unharmed(victim)


def test_a_link_to_an_equal_file_is_not_a_copy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The bytes are right, but they are in a file outside the session."""
    folder = started(tmp_path / "s", 3)
    real = os.replace

    def raced(old: Any, new: Any) -> None:
        real(old, new)
        if Path(new).name == "L00_E0.z.tif":
            Path(new).rename(tmp_path / "copy.tif")
            Path(new).symlink_to(tmp_path / "copy.tif")

    monkeypatch.setattr(os, "replace", raced)
    with pytest.raises(StorageError, match=r"L00_E0\.z\.tif: cannot read back"):
        compact_session(folder)
    assert (folder / "frames/L00_E0.tif").is_file()


def test_the_target_of_a_link_at_derived_is_never_removed(tmp_path: Path) -> None:
    """Compaction removes derived/COMPLETE, which may belong to another session."""
    other = tmp_path / "other"
    other.mkdir()
    (other / "COMPLETE").write_bytes(b"theirs")
    folder = started(tmp_path / "s", 3)
    (folder / "derived").symlink_to(other)
    with pytest.raises(DataError, match="derived: is a link that leaves the session"):
        compact_session(folder)
    assert (other / "COMPLETE").read_bytes() == b"theirs"
    assert verify_session(folder).complete
    (folder / "derived").unlink()
    compact_session(folder)
    (folder / "derived").rmdir()
    (folder / "derived").symlink_to(other)
    assert compact_session(folder).compacted == 0
    assert (other / "COMPLETE").read_bytes() == b"theirs"


def test_a_journal_that_becomes_a_link_while_it_is_opened_is_not_written(
    tmp_path: Path, victim: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = started(tmp_path / "s", 1)
    real = os.replace

    def raced(old: Any, new: Any) -> None:
        real(old, new)
        if Path(new).name == "journal.jsonl":
            Path(new).rename(tmp_path / "kept")
            Path(new).symlink_to(victim)

    monkeypatch.setattr(os, "replace", raced)
    with pytest.raises(StorageError, match=r"journal\.jsonl: cannot open"):
        SessionWriter.reopen(folder)
    assert unharmed(victim)
