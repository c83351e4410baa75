"""The rests of a recording that was cut off, cleared away before it goes on."""

from __future__ import annotations

import os
from itertools import count
from pathlib import Path

from acquisition._errors import DataError
from acquisition._session.session import DERIVED, FRAMES, leaves
from acquisition._storage import disk, is_part, make_folder, sync_folder


def set_aside(folder: Path, recorded: set[str]) -> list[str]:
    """Move files without a line out of ``frames/``, delete rests of unfinished writes.

    Parameters
    ----------
    folder
        The session, locked.
    recorded
        Names of the files that have a line.

    Returns
    -------
    list of str
        Where the files lie now, relative to the session.

    Raises
    ------
    DataError
        If ``frames/`` leads out of the session.
    StorageError
        If the disk refuses.
    """
    frames, shelf = folder / FRAMES, folder / DERIVED / "unrecorded"
    if leaves(frames, folder):
        raise DataError(f"{frames}: is a link that leaves the session; put the folder itself there")
    make_folder(frames)
    aside: list[str] = []
    with disk(frames, "clear up"):
        for path in sorted(frames.iterdir()):
            if path.name in recorded:
                continue
            if is_part(path):
                path.unlink()
                continue
            make_folder(shelf)
            target = next(
                free
                for number in count()
                if not (free := shelf / f"{number:03d}_{path.name}").exists()
            )
            os.rename(path, target)
            sync_folder(shelf)
            aside.append(target.relative_to(folder).as_posix())
        sync_folder(frames)
    return aside
