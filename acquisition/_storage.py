"""The disk under a capture: writes that survive a power cut, one writer per folder, clear errors.

All that is particular to a system is here and in `acquisition._part_files`: locks, the fsync of a
folder and opening without following links, which Windows does not have in this form and where they
are left out, and the flag of files that are no text.
"""

from __future__ import annotations

import errno
import hashlib
import os
import stat
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from acquisition._errors import DataError, MissingPathError, SessionInUseError, StorageError
from acquisition._part_files import BINARY, NO_LINK, NO_WAIT, Part, clear, temporary
from acquisition._part_files import is_part as is_part
from acquisition._part_files import is_rest as is_rest
from acquisition._part_files import part_path as part_path

if sys.platform != "win32":
    import fcntl

_HINTS = {
    errno.ENOSPC: "free space on this disk, then try again",
    errno.EDQUOT: "the quota is used up: free space, then try again",
    errno.EFBIG: "the limit on file sizes is reached: raise it, then try again",
    errno.EROFS: "the disk is read-only: mount it writable or choose another folder",
    errno.EACCES: "permission is missing: choose a folder you may write to",
    errno.EPERM: "permission is missing: choose a folder you may write to",
    errno.EIO: "the disk fails: copy what is there and use another disk",
    errno.ENOENT: "the folder does not exist: create it or choose another one",
    errno.ENOTDIR: "a file stands where a folder is needed: choose another folder",
    errno.EISDIR: "a folder has this name: move it away or choose another name",
    errno.EEXIST: "something else has this name: move it away or choose another name",
    errno.ELOOP: "a link has this name: move it away or choose another name",
    errno.ENAMETOOLONG: "the name is too long: choose a shorter one",
}


def refusal(path: Path, action: str, error: OSError) -> StorageError:
    """Return what the system refused as an error that names path, action, reason and remedy."""
    hint = _HINTS.get(error.errno or 0, "check the disk and the folder")
    return StorageError(f"{path}: cannot {action}: {error.strerror or error}; {hint}")


@contextmanager
def disk(path: Path, action: str) -> Iterator[None]:
    """Turn an OSError inside the block into a StorageError that names path, action and remedy."""
    try:
        yield
    except (MissingPathError, StorageError):
        raise
    except OSError as error:
        raise refusal(path, action, error) from error


@contextmanager
def published(path: Path) -> Iterator[Part]:
    """Give a temporary file to write to; then it is made durable and gets its own name.

    fsync, rename, fsync of the folder: there is the old file, or none, or the new one, never a
    part of it. After an error inside the block nothing new is there. Where the name is a link, the
    link is replaced, not the file that it points to.
    """
    with ExitStack() as kept:
        with disk(path, "write"):
            part = kept.enter_context(temporary(path))
        yield part
        with disk(path, "write"):
            os.fsync(part.descriptor)
            if not part.is_there():
                raise StorageError(f"{part.path}: was replaced by another program: try again")
            if sys.platform == "win32":  # where no file that is open can be renamed
                part.close()
            os.replace(part.path, path)
            sync_folder(path.parent)


def write_durably(path: Path, *pieces: bytes | memoryview) -> None:
    """Write a whole file, or leave what was there.

    Parameters
    ----------
    path
        File to create or replace; a link is replaced, not followed. Its folder exists.
    pieces
        What it is to hold, one after the other.

    Raises
    ------
    StorageError
        If the disk refuses.
    """
    with published(path) as part, disk(path, "write"):
        for piece in pieces:
            write_whole(part.descriptor, piece)


def remove_rests(folder: Path) -> None:
    """Remove the temporary files in a folder that no process is writing any more.

    Raises
    ------
    StorageError
        If the disk refuses.
    """
    with disk(folder, "clear up"):
        for path in folder.iterdir():
            if is_rest(path) and (path.is_symlink() or not path.is_dir()):
                clear(path)


def read_file(path: Path, *, follow: bool = True) -> bytes:
    """Return the bytes of a regular file.

    Parameters
    ----------
    path
        The file.
    follow
        False refuses a link.

    Raises
    ------
    OSError
        If it cannot be read; also where reading might never end, as of pipes and devices.
    """
    if follow and not stat.S_ISREG(path.stat().st_mode):  # to open a device may set it off
        raise _irregular(path)
    with os.fdopen(_open(path, os.O_RDONLY | (NO_WAIT if follow else NO_LINK)), "rb") as file:
        return file.read()


def read_back(path: Path) -> bytes:
    """Return the bytes of a file that was just written: from the disk, where one can ask for that.

    Raises
    ------
    OSError
        If it cannot be read, or is no regular file but a link, a pipe or a device.
    """
    with os.fdopen(open_binary(path, os.O_RDONLY), "rb") as file:
        if hasattr(os, "posix_fadvise"):  # the system forgets its copy of what is on the disk
            os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)
        return file.read()


def open_binary(path: Path, flags: int) -> int:
    """Open a regular file as `os.open` does, for bytes: Windows would put a 13 before each 10.

    Raises
    ------
    OSError
        If it cannot be opened, also where it is a link, a pipe or a device.
    """
    return _open(path, flags | NO_LINK)


def _open(path: Path, flags: int) -> int:
    descriptor = os.open(path, flags | BINARY, 0o666)
    if stat.S_ISREG(os.fstat(descriptor).st_mode):
        return descriptor
    os.close(descriptor)
    raise _irregular(path)


def _irregular(path: Path) -> OSError:
    return OSError(errno.EINVAL, "not a regular file", str(path))


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


def lock_folder(folder: Path, doing: str = "recording into this session") -> int:
    """Take a folder for this process alone until the descriptor returned is closed.

    The lock is advisory, on the folder itself, and ends with the process however it dies. ``doing``
    is what the message says that another process does.

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
                f"{folder}: another process is {doing}; wait for it to end or choose another folder"
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
            f"{ascii(text)[1:-1]}: the name is not UTF-8: rename the file or its folder"
        ) from None
    return text


def sha256_of(data: bytes | memoryview) -> str:
    """Return the SHA-256 of bytes as 64 lower-case hexadecimal digits."""
    return hashlib.sha256(data).hexdigest()
