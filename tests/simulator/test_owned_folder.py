"""Temporary folders of programs that were killed are removed by the next one, and no others."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from simulator.bench import OwnedFolder, remove_abandoned
from simulator.bench.owned_folder import _LOCK
from simulator.led_board import VirtualBoard

# Makes a folder, prints its path, and waits to be killed.
OWNER = """
import sys, time
from pathlib import Path
from simulator.bench import OwnedFolder
folder = OwnedFolder("sgp-test-", Path(sys.argv[1]))
(folder.path / "deep" / "er").mkdir(parents=True)
(folder.path / "deep" / "er" / "file").write_text("x")
print(folder.path, flush=True)
time.sleep(1000)
"""


class Owner:
    """A process that owns a folder."""

    def __init__(self, place: Path) -> None:
        command = [sys.executable, "-P", "-c", OWNER, str(place)]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        self.path = Path(self.process.stdout.readline().strip())

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()
        assert self.process.stdout is not None
        self.process.stdout.close()


@pytest.fixture
def owner(tmp_path):
    owner = Owner(tmp_path)
    yield owner
    owner.kill()


def test_a_folder_is_removed_with_its_owner(tmp_path):
    folder = OwnedFolder("sgp-test-", tmp_path)
    assert folder.open
    assert folder.path.parent == tmp_path
    (folder.path / "file").write_text("x")
    folder.close()
    folder.close()
    assert not folder.open
    assert list(tmp_path.iterdir()) == []


def test_a_folder_is_removed_with_the_last_reference(tmp_path):
    OwnedFolder("sgp-test-", tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_the_folder_of_a_killed_owner_is_removed_by_the_next_one(tmp_path, owner):
    owner.kill()
    assert (owner.path / "deep" / "er" / "file").exists()
    folder = OwnedFolder("sgp-test-", tmp_path)
    assert list(tmp_path.iterdir()) == [folder.path]
    folder.close()


def test_the_folder_of_a_living_owner_stays(tmp_path, owner):
    with_own = OwnedFolder("sgp-test-", tmp_path)
    remove_abandoned("sgp-test-", tmp_path)
    assert {owner.path, with_own.path} == set(tmp_path.iterdir())
    assert (owner.path / "deep" / "er" / "file").exists()
    with_own.close()


def test_other_kinds_of_folders_stay(tmp_path, owner):
    owner.kill()
    remove_abandoned("sgp-other-", tmp_path)
    assert owner.path.exists()


def abandoned(folder: Path) -> Path:
    """A folder of an owner that was killed."""
    folder.mkdir(mode=0o700)
    (folder / _LOCK).touch(mode=0o600)
    (folder / "file").write_text("x")
    return folder


def linked(place: Path) -> None:
    (place / "sgp-test-link").symlink_to(abandoned(place / "victim"))


def lock_linked(place: Path) -> None:
    folder = place / "sgp-test-1"
    folder.mkdir(mode=0o700)
    (place / "victim").write_text("x")
    (folder / _LOCK).symlink_to(place / "victim")


def writable_by_others(place: Path) -> None:
    abandoned(place / "sgp-test-1").chmod(0o777)


def without_lock(place: Path) -> None:
    (place / "sgp-test-1").mkdir(mode=0o700)
    (place / "sgp-test-1" / "file").write_text("x")


def a_file(place: Path) -> None:
    (place / "sgp-test-1").write_text("x")


def just_begun(place: Path) -> None:
    (place / "sgp-test-1").mkdir(mode=0o700)


@pytest.mark.parametrize(
    "make", [linked, lock_linked, writable_by_others, without_lock, a_file, just_begun]
)
def test_anything_not_certainly_abandoned_stays(tmp_path, make):
    make(tmp_path)
    before = sorted(tmp_path.rglob("*"))
    remove_abandoned("sgp-test-", tmp_path)
    assert sorted(tmp_path.rglob("*")) == before


def test_links_in_an_abandoned_folder_are_not_followed(tmp_path):
    victim = tmp_path / "victim"
    victim.mkdir()
    (victim / "file").write_text("x")
    folder = abandoned(tmp_path / "sgp-test-1")
    (folder / "link").symlink_to(victim)
    remove_abandoned("sgp-test-", tmp_path)
    assert not folder.exists()
    assert (victim / "file").exists()


def test_a_folder_of_another_user_stays(tmp_path, monkeypatch):
    folder = abandoned(tmp_path / "sgp-test-1")
    monkeypatch.setattr(os, "geteuid", lambda: os.getuid() + 1)
    remove_abandoned("sgp-test-", tmp_path)
    assert folder.exists()


def test_an_empty_folder_that_was_never_owned_is_removed_later(tmp_path):
    folder = tmp_path / "sgp-test-1"
    folder.mkdir(mode=0o700)
    long_ago_s = time.time() - 3600
    os.utime(folder, (long_ago_s, long_ago_s))
    remove_abandoned("sgp-test-", tmp_path)
    assert not folder.exists()


def test_a_forked_process_does_not_remove_the_folder(tmp_path):
    folder = OwnedFolder("sgp-test-", tmp_path)
    pid = os.fork()
    if pid == 0:
        folder.close()
        os._exit(0)
    os.waitpid(pid, 0)
    assert folder.path.exists()
    remove_abandoned("sgp-test-", tmp_path)
    assert folder.path.exists()
    folder.close()


def test_no_folder_is_lost_if_many_processes_start_at_once(tmp_path):
    """Each process removes abandoned folders while the others make theirs."""
    owners = [Owner(tmp_path) for _ in range(3)]
    for _ in range(2):
        abandoned(tmp_path / f"sgp-test-dead{_}")
    owners += [Owner(tmp_path) for _ in range(3)]
    try:
        assert {owner.path for owner in owners} == set(tmp_path.iterdir())
    finally:
        for owner in owners:
            owner.kill()


def test_the_folder_of_a_board_killed_with_its_host_is_removed(tmp_path, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    program = (
        "import os, signal, simulator\n"
        "board = simulator.led_board.VirtualBoard(4)\n"
        "os.kill(board.pid, signal.SIGKILL)\n"
        "os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    subprocess.run([sys.executable, "-P", "-c", program], check=False)
    assert len(list(tmp_path.glob("sgp-board-*"))) == 1
    with VirtualBoard(4) as board:
        assert [board.bench_state_path.parent] == list(tmp_path.glob("sgp-board-*"))
    assert list(tmp_path.iterdir()) == []
