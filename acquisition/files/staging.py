"""Folders whose files appear together; readers refuse them until all files are there."""

from __future__ import annotations

import os
import shutil
import stat
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from acquisition._errors import DataError
from acquisition.files.storage import disk, lock_folder, make_folder, sync_folder
from rig.host import filesystem

_STAGING: Final = ".part-files"
_WRITING: Final = "writing files into it"


@contextmanager
def staged(folder: Path, replaced: Iterable[Path] = ()) -> Iterator[Path]:
    """Provide a hidden folder to write files to; at the end they move into ``folder``.

    While the hidden folder exists, because the files are being written or because the write was
    interrupted, `check_staging_finished` refuses ``folder``. The hidden folder is inside
    ``folder``, because a rename cannot move files to another disk; ``folder`` may exist, contain
    other files, or be the root of a disk. The next call removes the files that a killed process
    left.

    Parameters
    ----------
    folder
        Created with its parents if it does not exist. Files of the same names are replaced.
    replaced
        Files to remove once the new ones are complete, before they appear.

    Raises
    ------
    StorageError
        If the disk refuses a write, or another process is writing files into the same folder.

    Examples
    --------
    >>> from pathlib import Path
    >>> from acquisition.files import staged
    >>> with staged(Path("result")) as folder:
    ...     _ = (folder / "a.txt").write_text("first")
    ...     _ = (folder / "b.txt").write_text("second")
    >>> sorted(path.name for path in Path("result").iterdir())
    ['a.txt', 'b.txt']
    """
    make_folder(folder)
    place = folder / _STAGING
    with disk(folder, "write"):
        _clear(place)
        filesystem.mkdir(place, 0o700)
    try:
        lock = lock_folder(place, _WRITING)
    except BaseException:
        with suppress(OSError):
            filesystem.rmdir(place)
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
                filesystem.replace(path, folder / path.name)
            sync_folder(folder)
            filesystem.rmdir(place)
            sync_folder(folder)
    finally:
        filesystem.close(lock)


def check_staging_finished(folder: Path) -> None:
    """Refuse a folder if its files are still being written or writing them was interrupted.

    Raises
    ------
    DataError
        If its files are not all there.
    """
    if os.path.lexists(folder / _STAGING) or folder.absolute().name == _STAGING:
        raise DataError(
            f"{folder}: is incomplete: its files are still being written, or writing was "
            "interrupted: wait, or create them again"
        )


def _clear(place: Path) -> None:
    """Remove the hidden folder of a killed process, or anything else with its name."""
    with suppress(FileNotFoundError):
        if not stat.S_ISDIR(place.lstat().st_mode):
            filesystem.unlink(place)
            return
        lock = lock_folder(place, _WRITING)
        try:
            shutil.rmtree(place)
        finally:
            filesystem.close(lock)
