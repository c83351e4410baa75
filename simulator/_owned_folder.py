"""Temporary folders that do not outlive their owner for long, even where it is killed.

The owner holds a lock (flock) on a file in the folder. The system releases the lock when the owner
ends, however it ends. Whoever makes the next folder of the same kind removes those that nobody owns
any more.

The place for temporary files may be writable for everybody. So a folder is removed only if it
belongs to this user and nobody else may write into it, links are never followed, and the one that
was looked at is the one that is removed.
"""

from __future__ import annotations

import os
import shutil
import stat
import tempfile
import time
import weakref
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows: folders of killed programs stay
    fcntl = None  # type: ignore[assignment]

_LOCK = ".owner"
_ATTEMPTS = 10
# A folder without a lock file was left by a program that was killed as it made it.
_HALF_MADE_S = 60.0


class OwnedFolder:
    """A new temporary folder, which is removed on `close`, at interpreter exit, or by a successor.

    Parameters
    ----------
    prefix
        Start of its name, which says what kind of folder it is.
    parent
        Where it is made; by default the place for temporary files.

    Attributes
    ----------
    path : Path
        The folder.

    Raises
    ------
    OSError
        If it cannot be made.
    """

    def __init__(self, prefix: str, parent: Path | None = None) -> None:
        where = Path(tempfile.gettempdir() if parent is None else parent)
        remove_abandoned(prefix, where)
        for _ in range(_ATTEMPTS):
            self.path = Path(tempfile.mkdtemp(prefix=prefix, dir=where))
            lock = _own(self.path)
            if lock is not None:
                break
        else:
            raise OSError(f"{where}: no temporary folder can be kept there")
        self._remove = weakref.finalize(self, _remove, self.path, lock, os.getpid())

    @property
    def open(self) -> bool:
        """Whether the folder has not been removed by `close`."""
        return self._remove.alive

    def close(self) -> None:
        """Remove the folder; closing twice does nothing."""
        self._remove()


def remove_abandoned(prefix: str, where: Path) -> None:
    """Remove the folders of a kind whose owners have ended; what cannot be removed stays."""
    if fcntl is None:
        return
    with suppress(OSError), _opened(where) as place:
        for name in os.listdir(place):
            if name.startswith(prefix):
                with suppress(OSError):
                    _remove_if_abandoned(name, place)


def _own(folder: Path) -> int | None:
    """Take the lock of a new folder; None if somebody took it for abandoned."""
    if fcntl is None:
        return -1
    flags = os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
    try:
        lock = os.open(folder / _LOCK, flags, 0o600)
    except FileNotFoundError:
        return None
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if os.path.samestat(os.fstat(lock), os.lstat(folder / _LOCK)):
            return lock
    except (BlockingIOError, FileNotFoundError):
        pass
    except OSError:  # a file system without locks: such folders are never found abandoned
        os.unlink(folder / _LOCK)
        return lock
    os.close(lock)
    return None


def _remove_if_abandoned(name: str, place: int) -> None:
    with _opened(name, place) as folder:
        found = os.fstat(folder)
        if found.st_uid != os.geteuid() or stat.S_IMODE(found.st_mode) & 0o022:
            return
        try:
            lock = os.open(_LOCK, os.O_RDWR | os.O_NOFOLLOW | os.O_CLOEXEC, dir_fd=folder)
        except FileNotFoundError:
            if time.time() - found.st_mtime > _HALF_MADE_S:
                os.rmdir(name, dir_fd=place)  # only if it is empty
            return
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            # Still the file that its owner would lock, in the folder of that name.
            here = os.stat(_LOCK, dir_fd=folder, follow_symlinks=False)
            there = os.stat(name, dir_fd=place, follow_symlinks=False)
            if os.path.samestat(os.fstat(lock), here) and os.path.samestat(found, there):
                shutil.rmtree(name, dir_fd=place)
        finally:
            os.close(lock)


@contextmanager
def _opened(path: Path | str, place: int | None = None) -> Iterator[int]:
    # The place itself may be a link, such as /tmp on some systems; what lies in it may not.
    follow = 0 if place is None else os.O_NOFOLLOW
    folder = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC | follow, dir_fd=place)
    try:
        yield folder
    finally:
        os.close(folder)


def _remove(folder: Path, lock: int, owner: int) -> None:
    # A process that was forked from the owner has a copy of this, and does not own the folder.
    if os.getpid() == owner:
        shutil.rmtree(folder, ignore_errors=True)
    if lock >= 0:
        os.close(lock)
