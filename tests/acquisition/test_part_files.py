"""Temporary files: nothing with their name is followed, overwritten or waited for."""

from __future__ import annotations

import os
import sys
import threading
from pathlib import Path

import pytest

from acquisition import StorageError, write_durably
from acquisition.files import part_files as _part_files
from acquisition.files import part_path
from acquisition.files.part_files import Part
from acquisition.files.storage import open_binary, published, read_back, read_file, write_whole
from tests.acquisition.planted import PLANTED, Plant, unharmed
from tests.cases import cases
from tests.forked import ForkServer

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="needs links and pipes")


@cases("plant", PLANTED)
@pytest.mark.parametrize("name", ["a", ".part-a"], ids=["final", "temporary"])
def test_anything_with_the_name_is_replaced_and_never_followed(
    tmp_path: Path, victim: Path, plant: Plant, name: str
) -> None:
    plant(tmp_path / name, victim)
    write_durably(tmp_path / "a", b"first ", b"second")
    assert not (tmp_path / "a").is_symlink()
    assert (tmp_path / "a").read_bytes() == b"first second"
    assert (tmp_path / "a").stat().st_nlink == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "elsewhere"]
    assert unharmed(victim)


@cases("plant", PLANTED)
def test_a_file_created_under_the_name_at_the_last_moment_is_replaced(
    tmp_path: Path, victim: Path, plant: Plant, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another program is faster three times in a row."""
    real, part = os.open, tmp_path / ".part-a"
    left = [3]

    def raced(path: object, flags: int, *mode: int) -> int:
        if path == part and flags & os.O_CREAT and left[0]:
            left[0] -= 1
            plant(part, victim)
        return real(path, flags, *mode)  # type: ignore[arg-type]

    monkeypatch.setattr(os, "open", raced)
    write_durably(tmp_path / "a", b"data")
    assert left == [0]
    assert read_file(tmp_path / "a", follow=False) == b"data"
    assert unharmed(victim)


def test_a_link_that_replaces_the_temporary_file_is_not_published(
    tmp_path: Path, victim: Path
) -> None:
    (tmp_path / "a").write_bytes(b"old")

    def replaced() -> None:
        with published(tmp_path / "a") as part:
            write_whole(part.descriptor, b"new")
            part.path.unlink()
            part.path.symlink_to(victim)

    with pytest.raises(StorageError, match=r"\.part-a: was replaced by another program"):
        replaced()
    assert (tmp_path / "a").read_bytes() == b"old"
    assert unharmed(victim)


@pytest.mark.parametrize("name", ["a", ".part-a"])
def test_a_folder_in_the_way_is_named(tmp_path: Path, name: str) -> None:
    (tmp_path / name).mkdir()
    (tmp_path / name / "theirs").write_bytes(b"x")
    with pytest.raises(StorageError, match=r"/(\.part-)?a: .*(folder).*move it away") as caught:
        write_durably(tmp_path / "a", b"data")
    assert "\n" not in str(caught.value)
    assert (tmp_path / name / "theirs").read_bytes() == b"x"
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_writers_of_one_file_take_turns(tmp_path: Path) -> None:
    """Threads replace processes here: each open file has its own lock."""
    path, length = tmp_path / "a", 200_000
    errors: list[BaseException] = []

    def write(letter: bytes) -> None:
        try:
            for _ in range(20):
                write_durably(path, letter * length, letter * length)
        except BaseException as error:  # noqa: BLE001 - reported by the main thread
            errors.append(error)

    threads = [threading.Thread(target=write, args=(bytes([65 + n]),)) for n in range(4)]
    for thread in threads:
        thread.start()
    while any(thread.is_alive() for thread in threads):
        if path.exists():
            data = path.read_bytes()
            assert data == data[:1] * (2 * length)
    for thread in threads:
        thread.join()
    assert errors == []
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


def test_a_writer_that_does_not_end_is_reported_and_left_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_part_files, "_TURN_S", 0.05)
    with published(tmp_path / "a") as part:
        with pytest.raises(StorageError, match="/a: another process is writing it: wait"):
            write_durably(tmp_path / "a", b"other")
        write_whole(part.descriptor, b"mine")
    assert (tmp_path / "a").read_bytes() == b"mine"


def test_the_file_of_a_killed_process_is_removed_by_the_next_write(
    tmp_path: Path, forks: ForkServer
) -> None:
    code = """
import os, sys
from pathlib import Path
from acquisition.files.storage import published, write_whole
with published(Path(sys.argv[1])) as part:
    write_whole(part.descriptor, b"half")
    os.kill(os.getpid(), 9)
"""
    assert forks.run(code, tmp_path / "a").returncode == -9
    assert [path.name for path in tmp_path.iterdir()] == [".part-a"]
    write_durably(tmp_path / "a", b"whole")
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


def test_files_are_written_on_a_file_system_without_locks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import fcntl

    def unsupported(descriptor: int, operation: int) -> None:
        raise OSError(95, "Operation not supported")

    monkeypatch.setattr(fcntl, "flock", unsupported)
    part_path(tmp_path / "a").write_bytes(b"rest")
    write_durably(tmp_path / "a", b"data")
    assert (tmp_path / "a").read_bytes() == b"data"


@pytest.mark.parametrize("planted", ["pipe", "device", "link"])
def test_only_regular_files_are_opened(tmp_path: Path, victim: Path, planted: str) -> None:
    PLANTED[planted](tmp_path / "a", victim)
    for read in (read_back, lambda path: read_file(path, follow=False)):
        with pytest.raises(OSError, match=r"regular|symbolic|Too many"):
            read(tmp_path / "a")
    with pytest.raises(OSError, match=r"."):
        open_binary(tmp_path / "a", os.O_WRONLY | os.O_APPEND)
    if planted == "link":
        assert read_file(tmp_path / "a") == b"mine"
    else:
        with pytest.raises(OSError, match="not a regular file"):
            read_file(tmp_path / "a")
    assert unharmed(victim)


def test_the_descriptor_is_closed_after_an_interrupt(tmp_path: Path) -> None:
    parts: list[Part] = []

    def interrupted() -> None:
        with published(tmp_path / "a") as part:
            parts.append(part)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert parts[0].descriptor == -1
    assert list(tmp_path.iterdir()) == []
