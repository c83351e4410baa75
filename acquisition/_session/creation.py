"""A session begun: its folder, ``session.toml`` and the first line of its journal."""

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
    """Make a session in a new or empty folder and take it for this process alone.

    Returns
    -------
    journal
        Open.
    lock
        Descriptor that holds the lock until it is closed.

    Raises
    ------
    DataError, StorageError
        As `SessionWriter.create`. The lock is free then.
    """
    manifest.check_current(folder)
    library_path(folder)  # else its frames could not be read
    data = to_toml(manifest)
    make_folder(folder)
    lock = lock_folder(folder)
    try:
        with disk(folder, "list the folder"):
            found = sorted(path.name for path in folder.iterdir())
        # The rest of a creation that was killed is no content.
        if set(found) - {part_path(Path(MANIFEST)).name}:
            raise StorageError(
                f"{folder}: is not empty (it holds {found[-1]}); choose a new folder"
            )
        write_durably(folder / MANIFEST, data)
        make_folder(folder / FRAMES)
        journal = JournalFile.begin(folder / JOURNAL, sha256_of(data), clock)
    except BaseException:
        os.close(lock)
        raise
    return journal, lock
