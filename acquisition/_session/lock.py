"""One process at a time writes into a session."""

from __future__ import annotations

from pathlib import Path

from acquisition._errors import DataError, MissingPathError
from acquisition._storage import lock_folder


def lock_session(folder: Path) -> int:
    """Take a session that is there for this process alone.

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
        If another process writes into it.
    """
    if not folder.exists():
        raise MissingPathError(f"{folder}: no such folder")
    if not folder.is_dir():
        raise DataError(f"{folder}: is not a session: it is a file")
    return lock_folder(folder)
