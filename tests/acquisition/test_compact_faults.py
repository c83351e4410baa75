"""Compaction on a disk that refuses, and in a process that dies: nothing is lost."""

from __future__ import annotations

import errno
import os
import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from acquisition import CapturePlan, Session, StorageError, verify_session
from acquisition.plan import PlannedShot
from acquisition.session import SessionWriter, compact_session
from rig import Notice
from tests.acquisition.dying import dying
from tests.acquisition.small_session import PLAN, names, picture, whole, write
from tests.forked import ForkServer

# A dark frame and a light.
SHORT = PLAN.changed(leds=(0,))
CALLS = ("write", "fsync", "replace", "unlink")
_FULL = OSError(errno.ENOSPC, "No space left on device")


@pytest.mark.parametrize(
    ("plan", "error"),
    [
        pytest.param(SHORT, _FULL, id="planned-full"),
        pytest.param(None, KeyboardInterrupt(), id="free-ctrl-c", marks=pytest.mark.slow),
        pytest.param(None, _FULL, id="free-full", marks=pytest.mark.slow),
        pytest.param(SHORT, KeyboardInterrupt(), id="planned-ctrl-c", marks=pytest.mark.slow),
    ],
)
def test_a_refusal_or_an_interrupt_at_any_call_to_the_disk(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    plan: CapturePlan | None,
    error: BaseException,
) -> None:
    original = write(tmp_path / "original", plan=plan)
    left = [0]

    def failing(real: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **options: Any) -> Any:
            left[0] -= 1
            if left[0] == 0:
                raise error
            return real(*arguments, **options)

        return call

    compacted = [name.replace(".tif", ".z.tif") for name in names(original)]
    fails_at, restored = 0, 0
    while True:
        fails_at += 1
        folder = tmp_path / f"s{fails_at}"
        shutil.copytree(original, folder)
        with monkeypatch.context() as patch:
            for name in CALLS:
                patch.setattr(os, name, failing(getattr(os, name)))
            left[0] = fails_at
            message = str(folder)
            try:
                compact_session(folder)
                break
            except StorageError as caught:
                message = str(caught)
            except KeyboardInterrupt:
                assert isinstance(error, KeyboardInterrupt)
        assert str(folder) in message
        assert "\n" not in message
        restored += whole(folder)
        compact_session(folder)
        assert whole(folder)
        assert verify_session(folder).warnings == ()
        assert names(folder) == compacted
    assert fails_at > 20
    # COMPLETE was restored whenever the end of the journal was known.
    assert restored > fails_at // 2


def test_a_full_disk(tmp_path: Path, forks: ForkServer) -> None:
    """A real refusal of the operating system: the first compressed file exceeds a size limit."""
    folder = write(tmp_path / "s")
    code = """
import resource, signal, sys
from acquisition.session import compact_session
from acquisition import StorageError
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (300, 300))
try:
    compact_session(sys.argv[1])
except StorageError as error:
    print(error)
"""
    files = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    done = forks.run(code, folder)
    assert done.returncode == 0
    assert "D_100us.z.tif: cannot write" in done.out
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == files


PROGRAM = "from acquisition.session import compact_session as act"


@pytest.fixture(scope="module")
def died(forks: ForkServer) -> Iterator[Callable[..., bool]]:
    with dying(forks, PROGRAM, *CALLS, "mkdir") as died:
        yield died


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="forks processes")
@pytest.mark.parametrize(
    "plan",
    [pytest.param(PLAN, id="planned"), pytest.param(None, id="free", marks=pytest.mark.slow)],
)
@pytest.mark.parametrize("complete", [True, False], ids=["complete", "incomplete"])
def test_death_at_every_call_to_the_disk(
    died: Callable[..., bool], tmp_path: Path, plan: CapturePlan | None, complete: bool
) -> None:
    """One process per call, killed within a write. Another compaction completes the session."""
    original = write(tmp_path / "original", plan=plan, complete=complete)
    frames = len(Session.open(original).recorded)
    killed, dies_at, cut_off = True, 0, 0
    while killed:
        dies_at += 1
        folder = tmp_path / f"s{dies_at}"
        shutil.copytree(original, folder)
        killed = died(str(folder), dies_at=dies_at)
        cut_off += complete and not whole(folder)
        done = compact_session(folder)
        assert done.complete is complete
        assert whole(folder) is complete
        assert verify_session(folder).warnings == ()
        assert len(names(folder)) == frames
        assert all(name.endswith(".z.tif") for name in names(folder))
    assert dies_at > 6 * frames
    assert not complete or cut_off > 6


def test_resuming_a_capture_after_a_compaction_that_died_makes_it_complete(
    died: Callable[..., bool], tmp_path: Path
) -> None:
    folder = write(tmp_path / "s")
    assert died(str(folder), dies_at=16)
    assert not whole(folder)
    with SessionWriter.reopen(folder) as writer:
        assert writer.missing == ()
        writer.complete()
    assert whole(folder)
    compact_session(folder)
    assert whole(folder)
    assert not (folder / "derived" / "COMPLETE").exists()


def test_an_interrupted_compaction_is_reported(tmp_path: Path) -> None:
    folder = write(tmp_path / "s")
    (folder / "derived").mkdir(exist_ok=True)
    (folder / "COMPLETE").rename(folder / "derived" / "COMPLETE")
    notice = Notice(
        "compaction-interrupted",
        "a compaction was interrupted: compact the session again",
        where=str(folder),
    )
    assert verify_session(folder).warnings == (notice,)
    assert Session.open(folder).warnings == (notice,)
    compact_session(folder)
    assert verify_session(folder).warnings == ()
    assert whole(folder)


def test_a_wrong_copy_of_complete_does_not_complete_the_session(tmp_path: Path) -> None:
    folder = write(tmp_path / "s", plan=None, complete=False)
    (folder / "derived").mkdir()
    (folder / "derived" / "COMPLETE").write_text("0" * 64 + "  journal.jsonl\n")
    assert not compact_session(folder).complete
    assert not whole(folder)


@pytest.mark.parametrize("since", ["frame", "event"])
def test_a_copy_of_complete_older_than_a_frame_does_not_complete_the_session(
    tmp_path: Path, since: str
) -> None:
    folder = write(tmp_path / "s", plan=None)
    mark = (folder / "COMPLETE").read_bytes()
    (folder / "COMPLETE").unlink()
    with SessionWriter.reopen(folder) as writer:
        if since == "frame":
            writer.write_frame(PlannedShot("light", 2, 0, 0, None), picture(3))
        else:
            writer.write_event("interrupted", reason="Ctrl-C")
    (folder / "derived").mkdir()
    (folder / "derived" / "COMPLETE").write_bytes(mark)
    assert not compact_session(folder).complete
    assert not whole(folder)
