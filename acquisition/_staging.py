"""Folders whose files appear together, and are refused until they all have."""

from __future__ import annotations

import os
import shutil
import stat
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from acquisition._errors import DataError
from acquisition._storage import disk, lock_folder, make_folder, sync_folder

_STAGING: Final = ".part-files"
_WRITING: Final = "writing files into it"


@contextmanager
def staged(folder: Path, replaced: Iterable[Path] = ()) -> Iterator[Path]:
    """Give a hidden folder to write files in; at the end they move into ``folder``.

    While the hidden folder is there, because the files are being written or because that was cut
    off, `check_whole` refuses ``folder``. It lies inside it: a rename reaches no other disk, and
    ``folder`` may exist, hold other files, or be a disk of its own. What a killed process left is
    removed by the next.

    Parameters
    ----------
    folder
        Created with its parents where it does not exist. Files of the same names are replaced.
    replaced
        Files to remove when the new ones are whole, before they appear.

    Raises
    ------
    StorageError
        If the disk refuses, or another process is writing files into the same folder.
    """
    make_folder(folder)
    place = folder / _STAGING
    with disk(folder, "write"):
        _clear(place)
        place.mkdir(mode=0o700)
    try:
        lock = lock_folder(place, _WRITING)
    except BaseException:
        with suppress(OSError):
            place.rmdir()
        raise
    try:
        try:
            yield place
        except BaseException:
            shutil.rmtree(place, ignore_errors=True)
            raise
        with disk(folder, "write"):
            for path in replaced:
                path.unlink(missing_ok=True)
            for path in sorted(place.iterdir()):
                os.replace(path, folder / path.name)
            sync_folder(folder)
            place.rmdir()
            sync_folder(folder)
    finally:
        os.close(lock)


def check_whole(folder: Path) -> None:
    """Refuse a folder into which files are being written, or were until that was cut off.

    Raises
    ------
    DataError
        If it is one.
    """
    if os.path.lexists(folder / _STAGING) or folder.absolute().name == _STAGING:
        raise DataError(
            f"{folder}: is not whole: its files are still being written, or that was cut off: "
            "wait, or make them again"
        )


def _clear(place: Path) -> None:
    """Remove what a killed process left, or whatever else has its name."""
    with suppress(FileNotFoundError):
        if not stat.S_ISDIR(place.lstat().st_mode):
            place.unlink()
            return
        lock = lock_folder(place, _WRITING)
        try:
            shutil.rmtree(place)
        finally:
            os.close(lock)
