"""Creation of a session: its folder, ``session.toml`` and the first line of its journal."""

from __future__ import annotations

import os
from pathlib import Path

from acquisition._errors import StorageError
from acquisition._session.journal_file import Clock, JournalFile
from acquisition._session.layout import FRAMES, JOURNAL, MANIFEST
from acquisition._session.manifest import Manifest
from acquisition._storage import (
    disk,
    library_path,
    lock_folder,
    make_folder,
    part_path,
    sha256_of,
    write_durably,
)
from acquisition._toml import to_toml


def begin(folder: Path, manifest: Manifest, clock: Clock) -> tuple[JournalFile, int]:
    """Create a session in a new or empty folder and lock it for this process.

    Returns
    -------
    journal
        The open journal.
    lock
        Descriptor that holds the lock until it is closed.

    Raises
    ------
    DataError, StorageError
        As for `SessionWriter.create`. The lock is released.
    """
    manifest.check_current(folder)
    library_path(folder)  # the image libraries require a UTF-8 path
    data = to_toml(manifest)
    make_folder(folder)
    lock = lock_folder(folder)
    try:
        with disk(folder, "list the folder"):
            names = sorted(path.name for path in folder.iterdir())
        # A temporary file of a creation that was killed does not count.
        if set(names) - {part_path(Path(MANIFEST)).name}:
            raise StorageError(
                f"{folder}: is not empty (it contains {names[-1]}); choose a new folder"
            )
        write_durably(folder / MANIFEST, data)
        make_folder(folder / FRAMES)
        journal = JournalFile.begin(folder / JOURNAL, sha256_of(data), clock)
    except BaseException:
        os.close(lock)
        raise
    return journal, lock
