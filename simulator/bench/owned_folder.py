"""Temporary folders that are removed soon after their owner ends, even if it is killed.

The owner holds a lock (flock) on a file in the folder. The system releases the lock when the owner
ends, in any way. A process that makes a folder of the same kind removes the folders whose locks are
free.

The folder for temporary files may be writable for all users. A folder is therefore removed only if
it belongs to this user and no other user may write to it. Links are never followed, and the folder
that was checked is the folder that is removed.
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
# Age at which a folder without a lock file is removed: its program was killed while it made it.
_HALF_MADE_S = 60.0


class OwnedFolder:
    """New temporary folder, removed by `close`, at interpreter exit, or by a later process.

    Parameters
    ----------
    prefix
        Start of its name, which identifies the kind of folder.
    parent
        Folder that contains it; the default is the system's folder for temporary files.

    Attributes
    ----------
    path : Path
        Path of the folder.

    Raises
    ------
    OSError
        If the folder cannot be made.
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
            raise OSError(f"{where}: no temporary folder could be locked in {_ATTEMPTS} attempts")
        self._remove = weakref.finalize(self, _remove, self.path, lock, os.getpid())

    @property
    def open(self) -> bool:
        """Whether the folder has not been removed by `close`."""
        return self._remove.alive

    def close(self) -> None:
        """Remove the folder; closing twice does nothing."""
        self._remove()


def remove_abandoned(prefix: str, where: Path) -> None:
    """Remove the folders of a kind whose owners have ended; skip those that cannot be removed.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> from simulator.bench import remove_abandoned
    >>> remove_abandoned("my-bench-", Path(tempfile.gettempdir()))
    """
    if fcntl is None:
        return
    with suppress(OSError), _opened(where) as place:
        for name in os.listdir(place):
            if name.startswith(prefix):
                with suppress(OSError):
                    _remove_if_abandoned(name, place)


def _own(folder: Path) -> int | None:
    """Lock a new folder; return None if another process removed it as abandoned."""
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
    except OSError:  # a file system without locks: its folders are never treated as abandoned
        os.unlink(folder / _LOCK)
        return lock
    os.close(lock)
    return None


def _remove_if_abandoned(name: str, place: int) -> None:
    with _opened(name, place) as folder:
        info = os.fstat(folder)
        if info.st_uid != os.geteuid() or stat.S_IMODE(info.st_mode) & 0o022:
            return
        try:
            lock = os.open(_LOCK, os.O_RDWR | os.O_NOFOLLOW | os.O_CLOEXEC, dir_fd=folder)
        except FileNotFoundError:
            if time.time() - info.st_mtime > _HALF_MADE_S:
                os.rmdir(name, dir_fd=place)  # only if it is empty
            return
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            # Check that the name still refers to this folder, and the folder to this lock file.
            here = os.stat(_LOCK, dir_fd=folder, follow_symlinks=False)
            there = os.stat(name, dir_fd=place, follow_symlinks=False)
            if os.path.samestat(os.fstat(lock), here) and os.path.samestat(info, there):
                shutil.rmtree(name, dir_fd=place)
        finally:
            os.close(lock)


@contextmanager
def _opened(path: Path | str, place: int | None = None) -> Iterator[int]:
    # The parent may be a link, as /tmp is on some systems; the folders in it may not.
    follow = 0 if place is None else os.O_NOFOLLOW
    folder = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC | follow, dir_fd=place)
    try:
        yield folder
    finally:
        os.close(folder)


def _remove(folder: Path, lock: int, owner: int) -> None:
    # A process that was forked from the owner has a copy of the finalizer but does not own the
    # folder.
    if os.getpid() == owner:
        shutil.rmtree(folder, ignore_errors=True)
    if lock >= 0:
        os.close(lock)
