"""The disk under a capture: writes that survive a power cut, one writer per folder, clear errors.

All that is particular to a system is here: `flock` and the fsync of a folder, which Windows does
not have in this form and where they are left out, and the flag of files that are no text.
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

from acquisition._errors import DataError, SessionInUseError, StorageError

if sys.platform == "win32":
    _BINARY = os.O_BINARY
else:
    import fcntl

    _BINARY = 0

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


@contextmanager
def published(path: Path) -> Iterator[Path]:
    """Give a temporary name to write to; then the file is made durable and gets its own.

    fsync, rename, fsync of the folder: there is the old file, or none, or the new one, never a
    part of it. After an error inside the block nothing new is there.
    """
    part = part_path(path)
    try:
        yield part
        with disk(path, "write"):
            # Read-write, because Windows refuses to flush a file opened for reading.
            descriptor = os.open(part, os.O_RDWR)
            try:
                os.fsync(descriptor)
            finally:
                os.close(descriptor)
            os.replace(part, path)
            sync_folder(path.parent)
    except BaseException:
        with suppress(OSError):
            part.unlink(missing_ok=True)
        raise


def write_durably(path: Path, data: bytes) -> None:
    """Write a whole small file, or leave what was there."""
    with published(path) as part, disk(path, "write"):
        part.write_bytes(data)


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


def open_binary(path: Path, flags: int) -> int:
    """Open a file as `os.open` does, for bytes: Windows would put a 13 before each 10 of a text."""
    return os.open(path, flags | _BINARY, 0o666)


def append_durably(descriptor: int, path: Path, data: bytes) -> None:
    """Append to an open file and fsync it. After an error the end of the file is not known."""
    with disk(path, "append"):
        write_whole(descriptor, data)
        os.fsync(descriptor)


def write_whole(descriptor: int, data: bytes | memoryview) -> None:
    """Write all of the bytes: a system may take them in pieces."""
    view = memoryview(data)
    while view:
        view = view[os.write(descriptor, view) :]


def make_folder(folder: Path) -> None:
    """Create a folder and its parents durably; one that exists is fine."""
    with disk(folder, "create the folder"):
        new = [parent for parent in (folder, *folder.parents) if not parent.exists()]
        folder.mkdir(parents=True, exist_ok=True)
        for made in new:
            sync_folder(made.parent)


def sync_folder(folder: Path) -> None:
    """Make names in a folder durable (on POSIX a rename is not, until its folder is synced).

    Some file systems, mostly of networks, know no fsync of a folder and say so: there is nothing
    more to ask of them.
    """
    if sys.platform == "win32":
        return
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno != errno.EINVAL:
            raise
    finally:
        os.close(descriptor)


def lock_folder(folder: Path) -> int:
    """Take a folder for this process alone until the descriptor returned is closed.

    The lock is advisory, on the folder itself, and ends with the process however it dies.

    Raises
    ------
    SessionInUseError
        If another writer holds it.
    StorageError
        If the file system knows no locks.
    """
    if sys.platform == "win32":
        return os.open(os.devnull, os.O_RDONLY)
    with disk(folder, "lock"):
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(descriptor)
            raise SessionInUseError(
                f"{folder}: another process is recording into this session; "
                "wait for it to end or choose another folder"
            ) from None
        except BaseException:
            os.close(descriptor)
            raise
    return descriptor


def library_path(path: Path) -> str:
    """Return a path as the image libraries take it: as text in UTF-8.

    Raises
    ------
    DataError
        If it is none, as names from old disks may be.
    """
    text = str(path)
    try:
        text.encode()
    except UnicodeEncodeError:
        raise DataError(
            f"{ascii(text)[1:-1]}: the name is no UTF-8: rename the file or its folder"
        ) from None
    return text


def sha256_of(data: bytes | memoryview) -> str:
    """Return the SHA-256 of bytes as 64 lower-case hexadecimal digits."""
    return hashlib.sha256(data).hexdigest()
