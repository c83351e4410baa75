"""Checks that commands with ``--memory`` have in common."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from acquisition.files import BandStore
from tests.sgp.test_cli_memory import check_equal, stop


def check_continued(
    sgp: Callable[..., Any],
    monkeypatch: pytest.MonkeyPatch,
    folder: Path,
    command: list[Any],
    limit: str,
    work: str,
    *,
    other: tuple[Any, ...],
    reason: str,
) -> list[tuple[str, slice]]:
    """Stop a command by a full disk and by Ctrl-C, and let it continue with more memory.

    Parameters
    ----------
    folder
        Folder for the results.
    command, limit
        The command, and a limit of memory for bands.
    work
        Name of the folder of unfinished maps.
    other, reason
        Options of a command that does not continue these maps, and what the error says about them.

    Returns
    -------
    list
        What was completed, without what was interrupted.
    """
    assert sgp(*command, "--out", folder / "whole").code == 0
    done: list[tuple[str, slice]] = []
    complete = BandStore.complete

    def noted(store: BandStore, step: str, rows: slice) -> None:
        complete(store, step, rows)
        done.append((step, rows))

    monkeypatch.setattr(BandStore, "complete", noted)
    out = folder / "out"
    full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    for error, code in ((full, 3), (KeyboardInterrupt(), 130)):
        with monkeypatch.context() as patched:
            patched.setattr(BandStore, "complete", stop(error, 1))
            answer = sgp(*command, "--out", out, "--memory", limit)
        assert answer.code == code, answer.err
        assert [path.name for path in out.iterdir()] == [work]
    assert len(done) == 2
    line = sgp(*command, *other, "--out", out, "--memory", limit).error_line(2)
    assert f"differs in {reason}: repeat that" in line
    with monkeypatch.context() as patched:  # while the files of the result are written
        patched.setattr("processing.maps.normal_map_files.write_mask", stop(full, 0))
        assert sgp(*command, "--out", out, "--memory", limit).code == 3
    assert len(list(out.iterdir())) > 1
    assert sgp(*command, "--out", out, "--memory", "1G").code == 0
    named = [(step, row) for step, rows in done for row in range(rows.start, rows.stop)]
    assert sorted(named) == sorted(set(named))
    check_equal(out, folder / "whole")
    return done


def check_needs_whole(sgp: Callable[..., Any], words: list[Any], limit: str, option: str) -> None:
    """Check that an option that needs complete maps is named, with the memory that suffices."""
    line = sgp(*words, "--memory", limit).error_line(2)
    assert f"with {option}, which needs the complete maps: give --memory " in line
    stated = line.split("give --memory ")[1].split(",")[0]
    assert sgp(*words, "--memory", stated).code == 0
