"""The disk under a capture: writes that survive a power cut, one writer per folder, clear errors.

All that is particular to POSIX is here: `flock` and the fsync of a folder. Windows has neither in
this form; there the lock and the folder fsync are left out.
"""

from __future__ import annotations

import errno
import hashlib
import os
import stat
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from acquisition._errors import StorageError

if sys.platform != "win32":
    import fcntl

_PART = ".part-"

_HINTS = {
    errno.ENOSPC: "free space on this disk, then resume",
    errno.EDQUOT: "the quota is used up: free space, then resume",
    errno.EFBIG: "the limit on file sizes is reached: raise it, then resume",
    errno.EROFS: "the disk is read-only: mount it writable or choose another folder",
    errno.EACCES: "permission is missing: choose a folder you may write to",
    errno.EPERM: "permission is missing: choose a folder you may write to",
    errno.EIO: "the disk fails: copy what is there and use another disk",
}


@contextmanager
def disk(path: Path, action: str) -> Iterator[None]:
    """Turn an OSError inside the block into a StorageError that names path, action and remedy."""
    try:
        yield
    except OSError as error:
        hint = _HINTS.get(error.errno or 0, "check the disk and the folder")
        reason = error.strerror or str(error)
        raise StorageError(f"{path}: cannot {action}: {reason}; {hint}") from error


def part_path(path: Path) -> Path:
    """Return the temporary name under which a file is written before it is published.

    Hidden, in the same folder, and with the same suffix, from which image writers choose a format.
    """
    return path.with_name(_PART + path.name)


def is_part(path: Path) -> bool:
    """Tell whether a file is the rest of a write that never finished."""
    return path.name.startswith(".")


def publish(part: Path, path: Path) -> None:
    """Make a finished temporary file durable under its own name: fsync, rename, fsync of folder."""
    with disk(path, "write"):
        # Read-write, because Windows refuses to flush a file opened for reading.
        descriptor = os.open(part, os.O_RDWR)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
        os.replace(part, path)
        sync_folder(path.parent)


def write_durably(path: Path, data: bytes) -> None:
    """Write a whole small file, or leave what was there: the old file or none, never a part."""
    part = part_path(path)
    try:
        with disk(path, "write"):
            part.write_bytes(data)
        publish(part, path)
    except BaseException:
        with suppress(OSError):
            part.unlink(missing_ok=True)
        raise


def read_file(path: Path) -> bytes:
    """Return the bytes of a regular file, links followed.

    Raises
    ------
    OSError
        If it cannot be read; also where reading might never end, as of pipes and devices.
    """
    if not stat.S_ISREG(path.stat().st_mode):
        raise OSError(errno.EINVAL, "not a regular file", str(path))
    return path.read_bytes()


def append_durably(descriptor: int, path: Path, data: bytes) -> None:
    """Append to an open file and fsync it. After an error the end of the file is not known."""
    with disk(path, "append"):
        view = memoryview(data)
        while view:
            view = view[os.write(descriptor, view) :]
        os.fsync(descriptor)


def make_folder(folder: Path) -> None:
    """Create a folder and its parents durably; one that exists is fine."""
    with disk(folder, "create the folder"):
        new = [parent for parent in (folder, *folder.parents) if not parent.exists()]
        folder.mkdir(parents=True, exist_ok=True)
        for made in new:
            sync_folder(made.parent)


def sync_folder(folder: Path) -> None:
    """Make names in a folder durable (on POSIX a rename is not, until its folder is synced)."""
    if sys.platform == "win32":
        return
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def lock_folder(folder: Path) -> int:
    """Take a folder for this process alone until the descriptor returned is closed.

    The lock is advisory, on the folder itself, and ends with the process however it dies.

    Raises
    ------
    StorageError
        If another writer holds it, or the file system knows no locks.
    """
    if sys.platform == "win32":
        return os.open(os.devnull, os.O_RDONLY)
    with disk(folder, "lock"):
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(descriptor)
            raise StorageError(
                f"{folder}: another process is recording into this session; "
                "wait for it to end or choose another folder"
            ) from None
        except BaseException:
            os.close(descriptor)
            raise
    return descriptor


def sha256_of(data: bytes | memoryview) -> str:
    """Return the SHA-256 of bytes as 64 lower-case hexadecimal digits."""
    return hashlib.sha256(data).hexdigest()
