"""The folder of a batch, which one process at a time writes."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import acquisition
from sgp._batch.state import States
from sgp._exit import UsageError
from sgp._output import check_folder

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]


@contextmanager
def batch_folder(out: Path) -> Iterator[States]:
    """Create the folder of a batch or continue one; others are refused as long as this is open.

    Raises
    ------
    UsageError
        If the folder contains something else, or another batch is writing into it.
    StorageError
        If it cannot be created.
    """
    states = States(out / "state")
    if not states.folder.is_dir():
        check_folder(out)
    acquisition.make_folder(states.folder)
    place = os.open(states.folder, os.O_RDONLY | os.O_CLOEXEC)
    try:
        if fcntl is not None:
            _lock(place, out)
        for folder in (out, states.folder):
            acquisition.remove_part_files(folder)
        yield states
    finally:
        os.close(place)


def _lock(place: int, out: Path) -> None:
    try:
        fcntl.flock(place, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise UsageError(
            f"another batch is writing into {out}: wait until it has ended, or choose another --out"
        ) from None
    except OSError:
        pass  # some file systems do not support locks
