"""A disk that refuses any one call: LEDs off, an error in one line, an intact session."""

from __future__ import annotations

import errno
import os
from pathlib import Path
from typing import Any

import pytest

from acquisition import CapturePlan, StorageError, record, resume, verify_session
from tests.acquisition.fake_bench import LABELS, Bench, rig_on
from tests.quick_sample import quick

SHORT = CapturePlan(repeat=False, leds=(3, 0), exposures_us=(200.0,), ambient=True)


class Refusing:
    """A system call that fails the nth time, and optionally at all later times."""

    def __init__(self, call: str, nth: int, forever: bool) -> None:
        self._real = getattr(os, call)
        self._nth = nth
        self._forever = forever
        self.calls = 0

    def __call__(self, *arguments: Any) -> Any:
        self.calls += 1
        if self.calls == self._nth or (self._forever and self.calls > self._nth > 0):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return self._real(*arguments)


def recorded(folder: Path, call: str, nth: int, forever: bool) -> tuple[int, Bench]:
    """Record on a disk that refuses one call; return the number of calls and the bench."""
    bench, refusing = Bench(), Refusing(call, nth, forever)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, call, refusing)
        if nth:
            with pytest.raises(StorageError, match="No space left"):
                record(rig_on(bench), SHORT, folder, LABELS)
        else:
            record(rig_on(bench), SHORT, folder, LABELS)
    return refusing.calls, bench


@pytest.mark.parametrize("forever", quick([False, True], every=2))
@pytest.mark.parametrize("call", ["write", "fsync", "replace"])
def test_no_recorded_frame_is_lost_whichever_call_the_disk_refuses(
    tmp_path: Path, call: str, forever: bool
) -> None:
    calls, _ = recorded(tmp_path / "sound", call, 0, forever)
    assert calls > 4
    for nth in range(1, calls + 1):
        folder = tmp_path / str(nth)
        _, bench = recorded(folder, call, nth, forever)
        assert bench.led is None
        if not (folder / "session.toml").exists():
            record(rig_on(Bench()), SHORT, folder, LABELS)  # the folder counts as empty
            continue
        found = verify_session(folder)
        assert found.problems == ()
        if not found.complete:
            resume(rig_on(Bench()), folder)
        found = verify_session(folder)
        assert (found.problems, found.complete) == ((), True)
