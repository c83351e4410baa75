"""Temporary files: always newly created, one writer at a time."""

from __future__ import annotations

import os
import stat
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from acquisition._errors import StorageError
from rig.host import clock, filesystem

if sys.platform == "win32":
    BINARY = os.O_BINARY
    NO_WAIT = NO_LINK = 0
else:
    import fcntl

    BINARY = 0
    NO_WAIT = os.O_NONBLOCK  # opening a pipe would wait for its other end
    NO_LINK = os.O_NOFOLLOW | NO_WAIT

_PART = ".part-"
# How long to wait for another process that is writing the same file.
_TURN_S = 10.0
_PAUSE_S = 0.01


def part_path(path: Path) -> Path:
    """Return the temporary path, in the same folder, under which a file is written.

    Examples
    --------
    >>> from pathlib import Path
    >>> from acquisition.files import part_path
    >>> part_path(Path("result/owl.png")).parent.name
    'result'
    """
    return path.with_name(_PART + path.name)


def is_hidden(path: Path) -> bool:
    """Return whether a file is hidden, as part files are; no file of a session is."""
    return path.name.startswith(".")


def is_part_file(path: Path) -> bool:
    """Return whether a file has the name of a part file, a temporary file of a write.

    Examples
    --------
    >>> from pathlib import Path
    >>> from acquisition.files import is_part_file
    >>> is_part_file(Path("owl.png"))
    False
    """
    return path.name.startswith(_PART)


class Part:
    """The temporary file of a path: a new file that this process alone writes.

    Anything else with its name is removed first: the file of a write that was killed, a link, a
    pipe. Nothing is followed or overwritten, even if something takes the name at the same moment.
    If another process is writing the same file, it holds a lock on it, and this one waits.

    Parameters
    ----------
    path
        File to write.

    Raises
    ------
    StorageError
        If a folder has the name, or the other process does not finish.
    OSError
        If the operating system refuses.
    """

    def __init__(self, path: Path) -> None:
        self.path = part_path(path)
        self.descriptor = -1
        patience = clock.monotonic() + _TURN_S
        while not self._create():
            if clock.monotonic() > patience:
                raise StorageError(
                    f"{path}: another process is writing it: wait for it to end, or choose another "
                    "name"
                )
            if not clear(self.path):
                clock.sleep(_PAUSE_S)

    def is_there(self) -> bool:
        """Return whether the file still has its name."""
        return self.descriptor >= 0 and _is_at(self.descriptor, self.path)

    def close(self) -> None:
        """Close the file and release the lock; harmless if repeated."""
        if self.descriptor >= 0:
            filesystem.close(self.descriptor)
            self.descriptor = -1

    def _create(self) -> bool:
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | NO_LINK | BINARY
        try:
            self.descriptor = filesystem.open_file(self.path, flags, 0o666)
        except FileExistsError:
            return False
        # Another process may have removed it as abandoned before it was locked.
        if lock_file(self.descriptor) and self.is_there():
            return True
        self.close()
        return False


def clear(part: Path) -> bool:
    """Remove a temporary file; return False if a process is writing it."""
    with suppress(FileNotFoundError):
        kind = part.lstat().st_mode
        if stat.S_ISDIR(kind):
            raise StorageError(
                f"{part}: this folder is in the way of a temporary file: move it away"
            )
        if stat.S_ISREG(kind):
            return _clear_abandoned(part)
        filesystem.unlink(part)
    return True


def _clear_abandoned(part: Path) -> bool:
    try:
        descriptor = filesystem.open_file(part, os.O_WRONLY | NO_LINK | BINARY)
    except PermissionError:  # removing a file requires permission on its folder only
        filesystem.unlink(part)
        return True
    try:
        # If a third process was faster, the name now belongs to another file.
        free = lock_file(descriptor)
        if free and _is_at(descriptor, part):
            filesystem.unlink(part)
        return free
    finally:
        filesystem.close(descriptor)


def _is_at(descriptor: int, path: Path) -> bool:
    """Return whether a path refers to an open file."""
    with suppress(FileNotFoundError):
        return os.path.samestat(os.fstat(descriptor), path.lstat())
    return False


@contextmanager
def temporary(path: Path) -> Iterator[Part]:
    """Provide a temporary file to write to, and remove it at the end.

    Raises
    ------
    StorageError, OSError
        As `Part`.
    """
    part = Part(path)
    try:
        yield part
    finally:
        # If the process is killed here, the next write to the same path removes the file.
        with suppress(OSError):
            if part.is_there():
                filesystem.unlink(part.path)
        part.close()


def lock_file(descriptor: int) -> bool:
    """Lock a file for this process alone; return False if another process holds it."""
    if sys.platform != "win32":
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        except OSError:  # the file system does not support locks
            pass
    return True
