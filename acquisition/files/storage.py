"""Disk access: writes that survive a power cut, one writer per folder, clear errors.

All code that depends on the operating system is here and in `acquisition.files.part_files`: locks,
the fsync of a folder, opening without following links (Windows has none of these in this form, so
they are left out there), and the flag for binary files.
"""

from __future__ import annotations

import errno
import hashlib
import os
import stat
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from acquisition._errors import DataError, SessionInUseError, StorageError
from acquisition.files.part_files import BINARY, NO_LINK, NO_WAIT, Part, clear, temporary
from acquisition.files.part_files import is_hidden as is_hidden
from acquisition.files.part_files import is_part_file as is_part_file
from acquisition.files.part_files import part_path as part_path
from rig import SgpError
from rig.files import note_read
from rig.host import filesystem

if sys.platform != "win32":
    import fcntl

_HINTS = {
    errno.ENOSPC: "free space on this disk, then try again",
    errno.EDQUOT: "the quota is used up: free space, then try again",
    errno.EFBIG: "the limit on file sizes is reached: raise it, then try again",
    errno.EROFS: "the disk is read-only: mount it writable or choose another folder",
    errno.EACCES: "permission is missing: choose a folder that you can write to",
    errno.EPERM: "permission is missing: choose a folder that you can write to",
    errno.EIO: "the disk fails: copy its files and use another disk",
    errno.ENOENT: "the folder does not exist: create it or choose another one",
    errno.ENOTDIR: "part of the path is a file, not a folder: choose another folder",
    errno.EISDIR: "a folder has this name: move it away or choose another name",
    errno.EEXIST: "another file has this name: move it away or choose another name",
    errno.ELOOP: "a link has this name: move it away or choose another name",
    errno.ENAMETOOLONG: "the name is too long: choose a shorter one",
}


def storage_error(path: Path, action: str, error: OSError) -> StorageError:
    """Return a StorageError that names path, action, reason and remedy of an OSError.

    Examples
    --------
    >>> import errno
    >>> from pathlib import Path
    >>> from acquisition.files import storage_error
    >>> str(storage_error(Path("owl.png"), "write", OSError(errno.ENOSPC, "disk is full")))
    'owl.png: cannot write: disk is full; free space on this disk, then try again'
    """
    hint = _HINTS.get(error.errno or 0, "check the disk and the folder")
    return StorageError(f"{path}: cannot {action}: {error.strerror or error}; {hint}")


@contextmanager
def disk(path: Path, action: str) -> Iterator[None]:
    """Turn an OSError inside the block into a StorageError that names path, action and remedy."""
    try:
        yield
    except SgpError:
        raise
    except OSError as error:
        raise storage_error(path, action, error) from error


def _always() -> None:
    """Allow every file."""


_permission: Callable[[], None] = _always


@contextmanager
def publishing_if(permission: Callable[[], None]) -> Iterator[None]:
    """Ask for permission before each file that this process publishes in the block.

    A worker that was suspended can so find out that another one has done its work in between.

    Parameters
    ----------
    permission
        Raises an error to refuse; called by whichever thread writes a file.

    Examples
    --------
    >>> from pathlib import Path
    >>> from acquisition import write_durably
    >>> from acquisition.files import publishing_if
    >>> with publishing_if(lambda: print("may I?")):
    ...     write_durably(Path("notes.txt"), b"owl")
    may I?
    """
    global _permission  # all writers of this process, whatever their thread
    before, _permission = _permission, permission
    try:
        yield
    finally:
        _permission = before


def check_publishing() -> None:
    """Ask for the permission of `publishing_if` to replace or remove the files of a result.

    Examples
    --------
    >>> from acquisition.files import check_publishing
    >>> check_publishing()
    """
    _permission()


@contextmanager
def published(path: Path) -> Iterator[Part]:
    """Provide a temporary file to write to; at the end make it durable and rename it.

    fsync, rename, fsync of the folder: at any time the path holds the complete old file, no file,
    or the complete new file. After an error inside the block the new file does not appear. If the
    path is a link, the link is replaced, not its target.
    """
    with ExitStack() as kept:
        with disk(path, "write"):
            part = kept.enter_context(temporary(path))
        yield part
        with disk(path, "write"):
            filesystem.fsync(part.descriptor)
            check_publishing()
            if not part.is_there():
                raise StorageError(f"{part.path}: was replaced by another program: try again")
            if sys.platform == "win32":  # Windows cannot rename an open file
                part.close()
            filesystem.replace(part.path, path)
            sync_folder(path.parent)


def write_durably(path: Path, *pieces: bytes | memoryview) -> None:
    r"""Write a complete file, or leave the old one unchanged.

    Parameters
    ----------
    path
        File to create or replace; a link is replaced, not followed. Its folder must exist.
    pieces
        Content of the file, in order.

    Raises
    ------
    StorageError
        If the disk refuses the write.

    Examples
    --------
    >>> from pathlib import Path
    >>> from acquisition import write_durably
    >>> write_durably(Path("notes.txt"), b"first line\n", b"second line\n")
    >>> Path("notes.txt").read_bytes()
    b'first line\nsecond line\n'
    """
    write_pieces(path, pieces)


def write_pieces(path: Path, pieces: Iterable[bytes | memoryview]) -> None:
    r"""Write a file like `write_durably`, whose pieces may be made one after the other.

    Parameters
    ----------
    path
        The file.
    pieces
        Its content in order; a generator is advanced while the file is written.

    Raises
    ------
    StorageError
        If the disk refuses it; an earlier file of that name is unchanged.

    Examples
    --------
    >>> from pathlib import Path
    >>> from acquisition.files import write_pieces
    >>> write_pieces(Path("squares.txt"), (f"{n * n}\n".encode() for n in range(3)))
    >>> Path("squares.txt").read_text().split()
    ['0', '1', '4']
    """
    with published(path) as part, disk(path, "write"):
        for piece in pieces:
            write_whole(part.descriptor, piece)


def remove_part_files(folder: Path) -> None:
    """Remove the part files in a folder that no process is writing.

    Raises
    ------
    StorageError
        If the disk refuses to remove one.

    Examples
    --------
    >>> from pathlib import Path
    >>> from acquisition.files import remove_part_files
    >>> remove_part_files(Path("."))
    """
    with disk(folder, "remove temporary files"):
        for path in folder.iterdir():
            if is_part_file(path) and (path.is_symlink() or not path.is_dir()):
                clear(path)


def read_file(path: Path, *, follow: bool = True) -> bytes:
    """Return the bytes of a regular file.

    Parameters
    ----------
    path
        The file.
    follow
        If False, refuse a link.

    Raises
    ------
    OSError
        If it cannot be read, or is not a regular file: reading a pipe or device might never end.
    """
    if follow and not stat.S_ISREG(path.stat().st_mode):  # opening a device may trigger it
        raise _irregular(path)
    with os.fdopen(_open(path, os.O_RDONLY | (NO_WAIT if follow else NO_LINK)), "rb") as file:
        return file.read()


def read_back(path: Path) -> bytes:
    """Return the bytes of a file that was just written, from the disk if the system allows it.

    Raises
    ------
    OSError
        If it cannot be read, or is a link, a pipe or a device.
    """
    with os.fdopen(open_binary(path, os.O_RDONLY), "rb") as file:
        if hasattr(os, "posix_fadvise"):  # the system drops its cached copy
            os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)
        return file.read()


def open_binary(path: Path, flags: int) -> int:
    """Open a regular file as `os.open` does, in binary mode on Windows, too.

    Raises
    ------
    OSError
        If it cannot be opened, or is a link, a pipe or a device.
    """
    return _open(path, flags | NO_LINK)


def _open(path: Path, flags: int) -> int:
    descriptor = filesystem.open_file(path, flags | BINARY, 0o666)
    if stat.S_ISREG(note_read(path, descriptor).st_mode):
        return descriptor
    filesystem.close(descriptor)
    raise _irregular(path)


def _irregular(path: Path) -> OSError:
    return OSError(errno.EINVAL, "not a regular file", str(path))


def append_durably(descriptor: int, path: Path, data: bytes) -> None:
    """Append to an open file and fsync it. After an error the end of the file is unknown."""
    with disk(path, "append"):
        write_whole(descriptor, data)
        filesystem.fsync(descriptor)


def write_whole(descriptor: int, data: bytes | memoryview) -> None:
    """Write all bytes: the system may accept only some of them per call."""
    view = memoryview(data)
    while view:
        view = view[filesystem.write(descriptor, view) :]


def write_whole_at(descriptor: int, data: memoryview, offset: int) -> None:
    """Write all bytes at an offset of an open file."""
    done = 0
    while done < len(data):
        done += filesystem.write_at(descriptor, data[done:], offset + done)


def make_folder(folder: Path) -> None:
    """Create a folder and its parents durably; do nothing if it exists.

    Examples
    --------
    >>> from pathlib import Path
    >>> from acquisition import make_folder
    >>> make_folder(Path("recordings/owl"))
    >>> Path("recordings/owl").is_dir()
    True
    """
    with disk(folder, "create the folder"):
        new = [parent for parent in (folder, *folder.parents) if not parent.exists()]
        for parent in reversed(new):
            with suppress(FileExistsError):  # another program was faster
                filesystem.mkdir(parent)
        if not folder.is_dir():
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(folder))
        # All parents: a program that created one may have been killed before its name was durable.
        # Folders that cannot be read were not created by it.
        for parent in folder.absolute().parents:
            with suppress(PermissionError):
                sync_folder(parent)


def sync_folder(folder: Path) -> None:
    """Make names in a folder durable: on POSIX a rename is durable only after this.

    Some file systems, mostly network file systems, report that they do not support fsync of a
    folder; this is ignored.
    """
    if sys.platform == "win32":
        return
    descriptor = filesystem.open_file(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        filesystem.fsync(descriptor)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.EROFS):
            raise
    finally:
        filesystem.close(descriptor)


def lock_folder(folder: Path, doing: str = "recording into this session") -> int:
    """Lock a folder for this process alone until the returned descriptor is closed.

    The lock is advisory and on the folder itself; it ends with the process even if that is killed.
    ``doing`` is the activity that the error message attributes to the other process.

    Raises
    ------
    SessionInUseError
        If another process holds the lock.
    StorageError
        If the file system does not support locks.
    """
    if sys.platform == "win32":
        return filesystem.open_file(os.devnull, os.O_RDONLY)
    with disk(folder, "lock"):
        descriptor = filesystem.open_file(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            filesystem.close(descriptor)
            raise SessionInUseError(
                f"{folder}: another process is {doing}; wait for it to end or choose another folder"
            ) from None
        except BaseException:
            filesystem.close(descriptor)
            raise
    return descriptor


def library_path(path: Path) -> str:
    """Return a path as text that can be encoded in UTF-8, as the image libraries require it.

    Raises
    ------
    DataError
        If it cannot be encoded, which happens with names from old disks.
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
