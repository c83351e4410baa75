"""The lock of a session: only one process at a time may write."""

from __future__ import annotations

from pathlib import Path

from acquisition._errors import DataError, MissingPathError
from acquisition._storage import lock_folder


def lock_session(folder: Path) -> int:
    """Lock an existing session for this process alone.

    Returns
    -------
    int
        Descriptor that holds the lock until it is closed.

    Raises
    ------
    MissingPathError
        If the folder does not exist.
    DataError
        If it is a file.
    StorageError
        If another process is writing to it.
    """
    if not folder.exists():
        raise MissingPathError(f"{folder}: no such folder")
    if not folder.is_dir():
        raise DataError(f"{folder}: is not a session: it is a file")
    return lock_folder(folder)
